//! Roldão's method against a literal implementation, and what its statistics promise: any split of a log, any number of
//! threads and any place in the world give the same planes.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use std::collections::BTreeSet;

use common::{Voxels, assert_agrees, observed, scan};
use serde::{
    Deserialize,
    de::value::{Error, StrDeserializer},
};
use tsdfuse::{
    Integration, Integrator, MapConfig, Pose, Roldao, Scan, VoxelMap,
    fuse::{RoldaoConfig, RoldaoForm as Form},
    glam::{DMat3, DQuat, DVec3, IVec3, Vec3},
    scan::PoseAt,
};

const FORMS: [Form; 2] = [Form::Streaming, Form::Batch];

/// Large voxels, so that few points fill them; lengths are whole in binary, so that shifts are exact.
const MAP: MapConfig = MapConfig {
    voxel_size_m: 0.125,
    truncation_m: 0.5,
    max_weight: 100.0,
};

fn config(form: Form) -> RoldaoConfig {
    RoldaoConfig {
        form,
        min_points: 6,
        max_level: 4,
        min_density: 0.01,
        ..Default::default()
    }
}

fn fuse_with(scans: &[Scan], config: RoldaoConfig) -> (VoxelMap, Vec<Integration>) {
    let mut map = VoxelMap::new(MAP).unwrap();
    let mut method = Roldao::new(config);
    let mut done: Vec<_> = scans.iter().map(|s| method.integrate(&mut map, s).unwrap()).collect();
    done.push(method.finish(&mut map));
    (map, done)
}

fn fuse(scans: &[Scan], form: Form) -> VoxelMap {
    fuse_with(scans, config(form)).0
}

/// A scan during which the sensor moves and turns.
fn moving(number: usize, rays: usize) -> Scan {
    let still = scan(number, rays);
    let turn = DQuat::from_rotation_z(0.1) * DQuat::from_rotation_x(0.05);
    let pose = Pose {
        rotation: still.pose.unwrap().rotation * turn,
        translation: still.pose.unwrap().translation + DVec3::new(0.4, -0.2, 0.1),
    };
    Scan {
        times: Some((0..rays).map(|i| 0.1 * i as f32 / rays as f32).collect()),
        motion: vec![PoseAt { pose, secs: 0.1 }],
        ..still
    }
}

/// Eigenvalues, descending, with their vectors: Jacobi's rotations.
fn eigen(mut m: DMat3) -> [(f64, DVec3); 3] {
    let mut vectors = DMat3::IDENTITY;
    for _ in 0..20 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if m.col(q)[p] != 0.0 {
                let theta = 0.5 * (2.0 * m.col(q)[p]).atan2(m.col(q)[q] - m.col(p)[p]);
                let mut turn = DMat3::IDENTITY;
                turn.col_mut(p)[p] = theta.cos();
                turn.col_mut(q)[q] = theta.cos();
                turn.col_mut(q)[p] = theta.sin();
                turn.col_mut(p)[q] = -theta.sin();
                m = turn.transpose() * m * turn;
                vectors *= turn;
            }
        }
    }
    let mut all = [0, 1, 2].map(|i| (m.col(i)[i], vectors.col(i)));
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all
}

/// The formulas as they stand, for every vertex near a point, from all points, in f64.
fn literal(scans: &[Scan], config: RoldaoConfig) -> Voxels {
    let (k, mu) = (MAP.voxel_size_m, MAP.truncation_m);
    let placed = |scan: &Scan| -> Vec<(IVec3, DVec3, DVec3)> {
        let trajectory = scan.sweep();
        let pose = |i: usize| {
            trajectory
                .as_ref()
                .map_or(scan.pose.unwrap(), |t| t.at(f64::from(scan.times.as_ref().unwrap()[i])))
        };
        let points = scan.points.iter().enumerate().map(|(i, p)| {
            let p = pose(i).transform_point(p.as_dvec3());
            // The cell's corners are the voxels' centres.
            ((p / k + 0.5).floor().as_ivec3(), p, pose(i).translation)
        });
        points.collect()
    };
    let groups: Vec<_> = match config.form {
        Form::Streaming => scans.iter().map(placed).collect(),
        Form::Batch => vec![scans.iter().flat_map(placed).collect()],
    };
    let reach = config.max_level as i32;
    let mut sums = Voxels::new();
    for points in groups {
        let near = |cell: IVec3| {
            let all = || -reach..reach;
            all()
                .flat_map(move |z| all().flat_map(move |y| all().map(move |x| (cell + IVec3::new(x, y, z)).to_array())))
        };
        let vertices: BTreeSet<_> = points.iter().flat_map(|p| near(p.0)).collect();
        for index in vertices {
            let v = (IVec3::from(index).as_dvec3() + 0.5) * k;
            for level in 1..=reach {
                let (low, high) = (IVec3::from(index) - level + 1, IVec3::from(index) + level);
                let inside = |cell: IVec3| cell.cmpge(low).all() && cell.cmple(high).all();
                let of: Vec<_> = points.iter().filter(|p| inside(p.0)).collect();
                if of.len() < config.min_points as usize {
                    continue; // (4.4)
                }
                let n = of.len() as f64;
                let mean = of.iter().map(|p| p.1).sum::<DVec3>() / n;
                let sensor = of.iter().map(|p| p.2).sum::<DVec3>() / n;
                let mut covariance = DMat3::ZERO;
                for (_, p, _) in of {
                    let d = *p - mean;
                    covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (1.0 / n);
                }
                let [(l1, e1), (l2, e2), (_, e3)] = eigen(covariance);
                let least = (config.min_spread_m).max(0.01 * k);
                if l2 < least * least {
                    continue;
                }
                let (a, b) = ((v - mean).dot(e1), (v - mean).dot(e2));
                let density = (-0.5 * (a * a / l1 + b * b / l2)).exp() / (std::f64::consts::TAU * (l1 * l2).sqrt());
                if density * k * k < config.min_density {
                    continue; // (4.6)
                }
                let normal = if e3.dot(sensor - mean) > 0.0 { e3 } else { -e3 }; // (4.5)
                let distance = normal.dot(v - mean); // (4.7)
                if distance.abs() <= mu {
                    let sum = sums.entry(index).or_default();
                    *sum = (sum.0 + 1.0, sum.1 + distance / mu);
                }
                break;
            }
        }
    }
    sums.into_iter().map(|(v, (w, s))| (v, (w, s / w))).collect()
}

#[test]
fn both_forms_are_what_their_formulas_say() {
    let scans = [scan(0, 1500), moving(1, 1500)];
    for form in FORMS {
        for config in [
            config(form),
            RoldaoConfig {
                min_points: 8,
                max_level: 3,
                min_density: 0.025,
                min_spread_m: 0.05,
                ..config(form)
            },
        ] {
            let map = fuse_with(&scans, config).0;
            assert!(map.observed_voxel_count() > 5_000, "{}", map.observed_voxel_count());
            assert_agrees(&map, &literal(&scans, config), 0.002, &format!("{config:?}"));
        }
    }
}

#[test]
fn threads_change_no_bit() {
    let scans = [scan(0, 3000), moving(1, 3000), scan(2, 3000)];
    for form in FORMS {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (map, mut done) = fuse_with(&scans, config(form));
                done.iter_mut().for_each(|d| (d.prepare_secs, d.find_secs) = (0.0, 0.0));
                (map, done)
            })
        };
        let one = run(1);
        assert!(one.0.block_count() > 100);
        for threads in [2, 7] {
            assert!(run(threads) == one, "{form:?}, {threads} threads");
        }
        assert!(fuse(&scans[..2], form) != one.0, "the comparison sees no lost scan");
    }
}

#[test]
fn a_batch_is_the_same_however_its_points_come() {
    let whole = [scan(0, 2000), moving(1, 2000)];
    let parts = whole.iter().flat_map(|s| {
        (0..s.points.len()).step_by(300).map(|start| {
            let range = start..(start + 300).min(s.points.len());
            Scan {
                points: s.points[range.clone()].to_vec(),
                times: s.times.as_ref().map(|t| t[range].to_vec()),
                ..s.clone()
            }
        })
    });
    let mut parts: Vec<_> = parts.collect();
    let map = fuse(&whole, Form::Batch);
    assert!(fuse(&parts, Form::Batch) == map);
    parts.reverse();
    assert!(fuse(&parts, Form::Batch) == map, "the other way round");
    assert!(
        fuse(&parts[1..], Form::Batch) != map,
        "the comparison sees no lost part"
    );
}

#[test]
fn a_batch_is_written_at_its_end_and_once() {
    let scans = [scan(0, 2000), scan(1, 2000)];
    let mut map = VoxelMap::new(MAP).unwrap();
    let mut method = Roldao::new(config(Form::Batch));
    for scan in &scans {
        let done = method.integrate(&mut map, scan).unwrap();
        assert_eq!((done.fused_returns, done.updated_blocks.len()), (2000, 0));
        assert_eq!(map.block_count(), 0);
    }
    let mut updated = method.finish(&mut map).updated_blocks;
    updated.sort();
    assert_eq!(updated, map.block_indices());
    assert!(map == fuse(&scans, Form::Batch));
    let written = map.clone();
    assert_eq!(method.finish(&mut map).updated_blocks.len(), 0);
    assert!(map == written);
}

#[test]
fn the_map_moves_with_the_data() {
    let shift = DVec3::new(500_000.0, 5_400_000.0, 300.0); // whole blocks of 1 m, UTM-sized
    let near = [scan(0, 2000), moving(1, 2000)];
    let mut far = near.clone();
    for scan in &mut far {
        scan.pose.as_mut().unwrap().translation += shift;
        scan.motion.iter_mut().for_each(|m| m.pose.translation += shift);
    }
    let voxels = (shift / MAP.voxel_size_m).as_ivec3();
    for form in FORMS {
        let moved = |map: &VoxelMap, by: IVec3| -> Voxels {
            let all = observed(map).into_iter();
            all.map(|(v, f)| ((IVec3::from(v) + by).to_array(), f)).collect()
        };
        let (here, there) = (moved(&fuse(&near, form), voxels), moved(&fuse(&far, form), IVec3::ZERO));
        assert!(here.len() > 5_000);
        assert_eq!(here, there, "{form:?}");
    }
}

#[test]
fn hostile_returns_are_skipped_and_counted() {
    let bad = [
        Vec3::NAN,
        Vec3::ZERO,
        Vec3::new(f32::INFINITY, 0.0, 0.0),
        Vec3::splat(f32::MAX),
        Vec3::splat(-3e9),
        Vec3::new(1.0, f32::NAN, 2.0),
    ];
    for form in FORMS {
        let good = scan(0, 2000);
        let mut mixed = good.clone();
        bad.iter().for_each(|&p| mixed.points.insert(777, p));
        let (map, done) = fuse_with(std::slice::from_ref(&mixed), config(form));
        assert_eq!(
            (done[0].skipped.outside_grid, done[0].fused_returns),
            (bad.len() as u64, 2000)
        );
        assert!(map == fuse(&[good], form));
        let lost = Scan {
            name: "lost".into(),
            points: vec![Vec3::X],
            pose: Some(Pose {
                translation: DVec3::splat(1e12),
                ..Pose::IDENTITY
            }),
            ..Default::default()
        };
        let error = Roldao::new(config(form)).integrate(&mut VoxelMap::new(MAP).unwrap(), &lost);
        let error = error.unwrap_err().to_string();
        assert!(error.contains("lost") && error.contains("outside"), "{error}");
    }
}

#[test]
fn points_on_a_line_or_in_a_heap_make_no_plane() {
    let line = (0..200).map(|i| Vec3::new(2.0, -1.0 + 0.01 * i as f32, 0.3));
    let heap = std::iter::repeat_n(Vec3::new(1.0, -2.0, 0.7), 100_000);
    for points in [line.collect::<Vec<_>>(), heap.collect()] {
        for form in FORMS {
            let scan = Scan {
                points: points.clone(),
                pose: Some(Pose::IDENTITY),
                ..Default::default()
            };
            assert_eq!(fuse(&[scan], form).block_count(), 0);
        }
    }
}

#[test]
fn a_sensor_on_the_floor_sees_the_floor_from_above() {
    // A drone before take-off: 3 cm above a floor that is even to 2 mm.
    let at = DVec3::new(0.4, -0.3, 0.03);
    let mut points = Vec::new();
    for i in 0..4000 {
        let (r, angle) = (0.3 + 1.7 * (i as f64 / 4000.0), i as f64 * 2.399_963);
        let noise = 0.002 * ((i * 7919) % 1000) as f64 / 1000.0;
        points.push(DVec3::new(r * angle.cos(), r * angle.sin(), noise - at.z).as_vec3());
    }
    let pose = Pose {
        translation: at,
        ..Pose::IDENTITY
    };
    let scan = Scan {
        points,
        pose: Some(pose),
        ..Default::default()
    };
    for form in FORMS {
        let voxels = observed(&fuse(std::slice::from_ref(&scan), form));
        assert!(voxels.len() > 1000);
        for (v, (_, f)) in voxels {
            let z = (f64::from(v[2]) + 0.5) * MAP.voxel_size_m;
            assert!((f * MAP.truncation_m - z).abs() < 0.01, "{form:?} {v:?}: {f}");
        }
    }
}

#[test]
fn the_paper_form_is_the_default_and_the_old_name_of_the_other_is_read() {
    assert_eq!(RoldaoConfig::default().form, Form::Batch);
    let read = |name| Form::deserialize(StrDeserializer::<Error>::new(name)).ok();
    let read = ["batch", "streaming", "scan", "stream"].map(read);
    assert_eq!(
        read,
        [Some(Form::Batch), Some(Form::Streaming), Some(Form::Streaming), None]
    );
}

#[test]
fn options_without_sense_are_refused() {
    let with = |f: fn(&mut RoldaoConfig)| {
        let mut c = RoldaoConfig::default();
        f(&mut c);
        c.validate().err().map(|e| e.to_string())
    };
    assert_eq!(with(|_| ()), None);
    assert!(with(|c| c.min_points = 2).unwrap().contains("min_points"));
    assert!(with(|c| c.max_level = 0).unwrap().contains("max_level"));
    assert!(with(|c| c.max_level = 9).unwrap().contains("max_level"));
    assert!(with(|c| c.min_density = f64::NAN).unwrap().contains("min_density"));
    assert!(with(|c| c.min_spread_m = -1.0).unwrap().contains("min_spread_m"));
}
