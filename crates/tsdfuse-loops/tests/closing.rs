//! Trajectories through simple worlds of walls, whose loops are closed or must not be.
#![allow(clippy::unwrap_used)]

use std::collections::HashMap;
use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use tsdfuse::{Pose, Scan};
use tsdfuse_io::g2o;
use tsdfuse_loops::{Closer, Edge, LocalMap, LoopConfig, Places, PoseGraph};
use tsdfuse_odometry::{Quality, SurfacePoint};

mod random;
use random::Random;

/// How far the sensor sees, metres.
const RANGE: f64 = 9.0;

/// Points of an upright rectangle, or of one that lies.
fn plane(points: &mut Vec<DVec3>, from: DVec3, along: DVec3, up: DVec3) {
    let steps = |v: DVec3| (v.length() / 0.12).ceil() as usize;
    for i in 0..steps(along) {
        for j in 0..steps(up) {
            points.push(from + along * (i as f64 / steps(along) as f64) + up * (j as f64 / steps(up) as f64));
        }
    }
}

/// The sides and the top of a box.
fn body(points: &mut Vec<DVec3>, at: DVec3, size: DVec3) {
    let (x, y, z) = (DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z);
    plane(points, at, x, z);
    plane(points, at + y, x, z);
    plane(points, at, y, z);
    plane(points, at + x, y, z);
    plane(points, at + z, x, y);
}

/// A ring of corridors with things at the walls that differ from place to place: 20 m a side.
fn ring(seed: u64) -> Vec<DVec3> {
    let mut points = Vec::new();
    let mut random = Random(seed);
    for (half, _) in [(8.8, 0), (11.2, 1)] {
        let corner = DVec3::new(-half, -half, 0.0);
        for (from, along) in [
            (corner, DVec3::X),
            (corner, DVec3::Y),
            (-corner, -DVec3::X),
            (-corner, -DVec3::Y),
        ] {
            plane(&mut points, from.with_z(0.0), along * 2.0 * half, DVec3::Z * 2.5);
        }
    }
    plane(
        &mut points,
        DVec3::new(-11.2, -11.2, 0.0),
        DVec3::X * 22.4,
        DVec3::Y * 22.4,
    );
    for side in 0..4 {
        let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2 * f64::from(side));
        let mut x = -8.0;
        while x < 8.0 {
            let mut own = Vec::new();
            let size = DVec3::new(
                0.4 + random.next(),
                0.2 + 0.3 * random.next(),
                0.5 + 1.5 * random.next(),
            );
            let y = if random.next() < 0.5 { 8.8 } else { 11.2 - size.y };
            body(&mut own, DVec3::new(x, y, 0.0), size);
            points.extend(own.into_iter().map(|p| turn * p));
            x += 1.5 + 2.0 * random.next();
        }
    }
    points
}

/// What a sensor sees from a pose.
fn scan(world: &[DVec3], truth: &Pose, random: &mut Random) -> Scan {
    let back = truth.inverse();
    let near = world.iter().filter(|p| p.distance(truth.translation) < RANGE);
    let mut noise = || (random.next() - 0.5) * 0.02;
    let points: Vec<Vec3> = near
        .map(|p| (back.transform_point(*p) + DVec3::new(noise(), noise(), noise())).as_vec3())
        .collect();
    Scan {
        points,
        ..Scan::default()
    }
}

fn good() -> Quality {
    Quality {
        covered: 1.0,
        matched: 1.0,
        position_sigma_m: 0.001,
        ..Quality::default()
    }
}

/// Along the middle of the ring, 1.2 laps, a scan every 0.4 m.
fn around() -> Vec<Pose> {
    let corners = [(-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)];
    (0..240)
        .map(|i| {
            let s = f64::from(i) * 0.4 % 80.0;
            let side = (s / 20.0) as usize;
            let (a, b) = (corners[side], corners[(side + 1) % 4]);
            let share = s % 20.0 / 20.0;
            Pose {
                rotation: DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2 * side as f64),
                translation: DVec3::new(a.0 + (b.0 - a.0) * share, a.1 + (b.1 - a.1) * share, 1.2),
            }
        })
        .collect()
}

/// The same as odometry might have it.
fn drifted(truth: &[Pose]) -> Vec<Pose> {
    let drift = Pose {
        rotation: DQuat::from_scaled_axis(DVec3::new(1e-5, -2e-5, 1.2e-4)),
        translation: DVec3::new(0.0008, -0.0005, 0.0004),
    };
    let mut poses = vec![truth[0]];
    for pair in truth.windows(2) {
        let step = pair[0].inverse() * pair[1] * drift;
        poses.push(poses[poses.len() - 1] * step);
    }
    poses
}

fn closed(world: &[DVec3], truth: &[Pose], odometry: &[Pose]) -> Closer {
    let mut closer = Closer::new(LoopConfig::default());
    let mut random = Random(3);
    for (truth, odometry) in truth.iter().zip(odometry) {
        let scan = Scan {
            pose: Some(*odometry),
            ..scan(world, truth, &mut random)
        };
        closer.push(&scan, &good());
    }
    closer.finish();
    closer
}

#[test]
fn a_ring_that_does_not_meet_is_closed() {
    let (world, truth) = (ring(7), around());
    let odometry = drifted(&truth);
    let closer = closed(&world, &truth, &odometry);
    let worst = |pose: &dyn Fn(usize) -> Pose| {
        let off = (0..truth.len()).map(|i| pose(i).translation.distance(truth[i].translation));
        off.fold(0.0, f64::max)
    };
    let (open, done) = (worst(&|i| odometry[i]), worst(&|i| closer.pose(i)));
    assert!(closer.closures().len() > 2, "{:?}", closer.closures());
    assert!(open > 0.3 && done < 0.4 * open, "{open} {done} {:?}", closer.closures());
    assert!(
        closer
            .closures()
            .iter()
            .all(|c| !c.is_doubted && c.rms_m < c.rms_before_m)
    );
    // The same scan at both ends of the loop.
    let between = closer.pose(0).inverse() * closer.pose(200);
    assert!(between.translation.length() < 0.03, "{between:?}");
    // As often as one likes.
    let again = closed(&world, &truth, &odometry);
    assert!((0..truth.len()).all(|i| again.pose(i) == closer.pose(i)));
}

/// Two rooms alike, 60 m from each other, and a hall between them.
fn rooms() -> Vec<DVec3> {
    let mut points = Vec::new();
    for x in [0.0, 60.0] {
        let mut random = Random(11);
        for (from, along) in [
            (DVec3::new(-4.0, -5.0, 0.0), DVec3::X * 8.0),
            (DVec3::new(-4.0, 5.0, 0.0), DVec3::X * 8.0),
            (DVec3::new(-4.0, 1.5, 0.0), DVec3::Y * 3.5),
            (DVec3::new(-4.0, -5.0, 0.0), DVec3::Y * 3.5),
            (DVec3::new(4.0, 1.5, 0.0), DVec3::Y * 3.5),
            (DVec3::new(4.0, -5.0, 0.0), DVec3::Y * 3.5),
        ] {
            plane(&mut points, from + DVec3::X * x, along, DVec3::Z * 2.5);
        }
        for _ in 0..8 {
            let at = DVec3::new(
                x - 3.5 + 6.0 * random.next(),
                if random.next() < 0.5 { -4.5 } else { 3.2 },
                0.0,
            );
            body(
                &mut points,
                at,
                DVec3::new(0.5 + random.next(), 0.5 + random.next(), 0.5 + 1.5 * random.next()),
            );
        }
    }
    let mut random = Random(5);
    for y in [-1.5, 1.5] {
        plane(&mut points, DVec3::new(4.0, y, 0.0), DVec3::X * 52.0, DVec3::Z * 2.5);
    }
    let mut x = 6.0;
    while x < 54.0 {
        let y = if random.next() < 0.5 { -1.5 } else { 1.1 };
        body(
            &mut points,
            DVec3::new(x, y, 0.0),
            DVec3::new(0.3 + random.next(), 0.4, 0.5 + 1.5 * random.next()),
        );
        x += 1.0 + 3.0 * random.next();
    }
    plane(
        &mut points,
        DVec3::new(-4.0, -5.0, 0.0),
        DVec3::X * 68.0,
        DVec3::Y * 10.0,
    );
    points
}

fn at(x: f64) -> Pose {
    Pose {
        rotation: DQuat::from_rotation_z(0.1 * (0.5 * x).sin()),
        translation: DVec3::new(x, 0.3 * (0.3 * x).sin(), 1.2),
    }
}

/// What is seen along a part of the way, in the frame of a pose.
fn seen(world: &[DVec3], from: f64, to: f64, frame: &Pose) -> LocalMap {
    let mut random = Random(9);
    let mut points = Vec::new();
    let mut x = from;
    while x < to {
        let truth = at(x);
        for p in scan(world, &truth, &mut random).points {
            let there = frame.inverse().transform_point(truth.transform_point(p.as_dvec3()));
            points.push(SurfacePoint::seen(there.as_vec3(), p));
        }
        x += 0.4;
    }
    LocalMap::new(&points)
}

#[test]
fn two_rooms_alike_stay_two() {
    let world = rooms();
    let truth: Vec<Pose> = (-8..158).map(|i| at(f64::from(i) * 0.4)).collect();
    // They do look alike:
    let room = |x: f64| {
        let frame = Pose {
            translation: DVec3::X * x,
            ..Pose::IDENTITY
        };
        let seen = seen(&world, x - 3.0, x + 3.0, &frame);
        let inside = |p: &&SurfacePoint| p.at.x.abs() < 4.3 && p.at.y.abs() < 5.3;
        LocalMap::new(&seen.points().iter().filter(inside).copied().collect::<Vec<_>>())
    };
    let mut places = Places::default();
    places.add(room(0.0));
    let alike = places.verify(&room(60.0), 0, &Pose::IDENTITY);
    assert!(alike.is_some());
    // But odometry cannot have been wrong by sixty metres.
    let closer = closed(&world, &truth, &drifted(&truth));
    assert_eq!(closer.closures(), []);
}

#[test]
fn a_place_is_found_without_any_idea_where_it_is() {
    let world = rooms();
    let mut places = Places::default();
    let middles: Vec<f64> = (0..8).map(|i| 4.0 + 6.0 * f64::from(i)).collect();
    for &x in &middles {
        places.add(seen(&world, x - 4.0, x + 4.0, &at(x)));
    }
    // Another way of looking at it: turned, lower, from a bit farther on.
    let turned = Pose {
        rotation: DQuat::from_rotation_z(2.5),
        translation: DVec3::new(0.3, -0.2, 0.4),
    };
    let frame = at(23.0) * turned;
    let found = places.find(&seen(&world, 19.0, 27.0, &frame), 0..middles.len());
    // A hall has parts that look alike; the right one is among those that were found.
    let off = found.iter().map(|found| {
        let off = (at(middles[found.place]) * found.pose).inverse() * frame;
        off.translation.length() + off.rotation.to_scaled_axis().length()
    });
    let best = off.fold(f64::INFINITY, f64::min);
    assert!(best < 0.05, "{best} {found:?}");
}

/// A graph that another program solved (`data/graph.py`, by scipy, with derivatives by differences).
#[test]
fn the_optimum_is_that_of_another_solver() {
    let read = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
        g2o::read(path).unwrap()
    };
    let (begin, optimum) = (read("graph.g2o"), read("optimum.g2o"));
    let place: HashMap<u64, usize> = begin.nodes.iter().enumerate().map(|(n, (id, _))| (*id, n)).collect();
    let edges = begin.edges.iter().map(|edge| Edge {
        from: place[&edge.from],
        to: place[&edge.to],
        measured: edge.measured,
        information: Edge::information_of(&edge.information),
        is_closure: false,
    });
    let mut graph = PoseGraph {
        nodes: begin.nodes.iter().map(|(_, pose)| *pose).collect(),
        edges: edges.collect(),
        ..PoseGraph::default()
    };
    let done = graph.optimize();
    assert!((done.cost_before / 50_677.776_136 - 1.0).abs() < 1e-6, "{done:?}");
    assert!((done.cost / 25.145_012_922 - 1.0).abs() < 1e-7, "{done:?}");
    for (own, (_, theirs)) in graph.nodes.iter().zip(&optimum.nodes) {
        let off = theirs.inverse() * *own;
        assert!(
            off.translation.length() < 1e-5 && off.rotation.to_scaled_axis().length() < 1e-5,
            "{off:?}"
        );
    }
}
