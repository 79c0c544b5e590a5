//! Surface patches: where they lie, what lies between them, and what is erased.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use tsdfuse::{
    Integrator, MapConfig, Pose, Scan, SensorModel, VoxelMap,
    fuse::{FuseError, Patch, PatchConfig},
    glam::{DQuat, DVec3, IVec3, Vec3},
    mesh,
    scan::PoseAt,
};

/// Sixteen lasers, as a VLP-16.
fn sensor() -> SensorModel {
    tsdfuse::sensor::model("vlp16").unwrap()
}

/// What a sensor at some place sees of a floor at z = 0 and of boxes that stand on it, with noise.
fn scan(position: DVec3, boxes: &[(DVec3, DVec3)]) -> Scan {
    let pose = Pose {
        translation: position,
        ..Pose::IDENTITY
    };
    sweep(pose, None, boxes)
}

/// The same of a sensor that moves while it turns once in 0.1 s: `pose` is in the middle of this.
fn sweep(pose: Pose, motion: Option<PoseAt>, boxes: &[(DVec3, DVec3)]) -> Scan {
    let sensor = sensor();
    let (mut rings, mut times) = (Vec::new(), Vec::new());
    let mut scan = Scan {
        pose: Some(pose),
        motion: motion.into_iter().collect(),
        times: Some(Vec::new()),
        ..Default::default()
    };
    let trajectory = scan.sweep();
    for (ring, elevation) in sensor.elevations_deg.iter().enumerate() {
        for column in 0..sensor.columns {
            let turn = (f64::from(column) + 0.5) / f64::from(sensor.columns);
            let (azimuth, secs) = (-std::f64::consts::TAU * turn, 0.1 * (turn - 0.5));
            let world_from_sensor = trajectory.as_ref().map_or(pose, |trajectory| trajectory.at(secs));
            let position = world_from_sensor.translation;
            let (sin_e, cos_e) = f64::from(*elevation).to_radians().sin_cos();
            let in_sensor = DVec3::new(cos_e * azimuth.cos(), cos_e * azimuth.sin(), sin_e);
            let direction = world_from_sensor.rotation * in_sensor;
            let floor = if direction.z < 0.0 {
                -position.z / direction.z
            } else {
                f64::INFINITY
            };
            let hit = boxes.iter().fold(floor, |nearest, (low, high)| {
                let (a, b) = ((low - position) / direction, (high - position) / direction);
                let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
                if enter > 0.0 && enter < leave {
                    nearest.min(enter)
                } else {
                    nearest
                }
            });
            if hit < 30.0 {
                let noise = ((u64::from(column) * 7919 + ring as u64 * 104_729) % 1000) as f64 / 1000.0 - 0.5;
                scan.points.push((in_sensor * (hit + 0.06 * noise)).as_vec3());
                rings.push(ring as u16);
                times.push(secs as f32);
            }
        }
    }
    scan.rings = Some(rings);
    scan.times = Some(times);
    scan
}

fn fused(config: PatchConfig, sensor: Option<SensorModel>, scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut patch = Patch::new(config, sensor);
    for scan in scans {
        patch.integrate(&mut map, scan).unwrap();
    }
    map
}

/// The share of the places on a ring about the sensor that have floor near them.
fn floor_covered(map: &VoxelMap, radius: f64) -> f64 {
    let mesh = mesh::extract(map).unwrap();
    let near = |place: DVec3| mesh.vertices.iter().any(|v| v.distance(place) < 0.05);
    let places = (0..60).map(|k| {
        DVec3::new(
            (f64::from(k) * 0.1).cos() * radius,
            (f64::from(k) * 0.1).sin() * radius,
            0.0,
        )
    });
    places.filter(|place| near(*place)).count() as f64 / 60.0
}

#[test]
fn noise_is_averaged_out_on_grazing_planes() {
    let scans: Vec<Scan> = (0..3)
        .map(|k| scan(DVec3::new(0.3 * f64::from(k), 0.0, 1.8), &[]))
        .collect();
    let mesh = mesh::extract(&fused(PatchConfig::default(), Some(sensor()), &scans)).unwrap();
    let within: Vec<f64> = mesh
        .vertices
        .iter()
        .filter(|v| v.length() < 12.0)
        .map(|v| v.z.abs())
        .collect();
    let mean = within.iter().sum::<f64>() / within.len() as f64;
    // Ranges are off by 15 mm in the mean.
    assert!(
        within.len() > 10_000 && mean < 0.003,
        "{} vertices, {mean} m",
        within.len()
    );
}

#[test]
fn gaps_between_rings_are_closed_as_far_as_is_asked_for() {
    let scans = [scan(DVec3::new(0.0, 0.0, 1.8), &[])];
    let with = |max_gap_m| {
        let config = PatchConfig {
            max_gap_m,
            ..Default::default()
        };
        fused(config, Some(sensor()), &scans)
    };
    // The rings at 6.7 and 7.8 m, 0.26 m apart as the sensor sees them, those at 7.8 and 9.3 m, 0.30 m.
    let (closed, open) = (with(0.4), with(0.0));
    assert_eq!((floor_covered(&closed, 7.3), floor_covered(&closed, 8.5)), (1.0, 1.0));
    assert_eq!(floor_covered(&open, 7.3), 0.0);
    assert!(floor_covered(&open, 7.78) > 0.8);
    // Planes that agree are linked over four times as much.
    let some = with(0.07);
    assert_eq!((floor_covered(&some, 7.3), floor_covered(&some, 8.5)), (1.0, 0.0));
}

#[test]
fn nothing_is_closed_between_a_box_and_the_floor_behind() {
    let block = (DVec3::new(4.0, -1.0, 0.0), DVec3::new(5.0, 1.0, 1.2));
    let map = fused(
        PatchConfig::default(),
        Some(sensor()),
        &[scan(DVec3::new(0.0, 0.0, 1.8), &[block])],
    );
    let mesh = mesh::extract(&map).unwrap();
    let off = |v: &DVec3| {
        let outside = (*v - v.clamp(block.0, block.1)).length();
        let inside = (*v - block.0).min(block.1 - *v).min_element().max(0.0);
        v.z.abs().min(outside.max(inside))
    };
    let worst = mesh.vertices.iter().map(off).fold(0.0, f64::max);
    assert!(mesh.vertices.len() > 1000 && worst < 0.12, "{worst}");
}

/// Of two boxes, one is there in the first four scans only; in each scan the sensor moves by `moved` (its own axes).
fn assert_erases_what_moved_on(moved: Option<Pose>) {
    let standing = (DVec3::new(8.0, 3.0, 0.0), DVec3::new(9.0, 4.0, 1.5));
    let visitor = (DVec3::new(6.0, -2.0, 0.3), DVec3::new(7.5, -0.5, 1.6));
    let scan = |k: i32| {
        let pose = Pose {
            translation: DVec3::new(0.2 * f64::from(k), 0.0, 1.8),
            ..Pose::IDENTITY
        };
        let motion = moved.map(|moved| PoseAt {
            pose: pose * moved,
            secs: 0.1,
        });
        sweep(pose, motion, &[standing, visitor][..if k < 4 { 2 } else { 1 }])
    };
    let scans: Vec<Scan> = (0..16).map(scan).collect();
    let faces = |carve: bool| {
        let config = PatchConfig {
            carve,
            ..Default::default()
        };
        let mesh = mesh::extract(&fused(config, Some(sensor()), &scans)).unwrap();
        let of = |(low, high): (DVec3, DVec3)| {
            let margin = DVec3::new(0.15, 0.15, -0.15);
            let inside = |v: &DVec3| v.cmpge(low - margin).all() && v.cmple(high + margin.abs()).all();
            mesh.vertices.iter().filter(|v| inside(v)).count() as f64
        };
        (of(standing), of(visitor))
    };
    let ((standing, erased), (standing_before, visitor)) = (faces(true), faces(false));
    assert!(visitor > 500.0 && erased < 0.1 * visitor, "{erased} of {visitor}");
    assert!(
        standing_before > 500.0 && standing > 0.97 * standing_before,
        "{standing} of {standing_before}"
    );
}

#[test]
fn what_moved_on_is_erased_and_what_stays_is_not() {
    assert_erases_what_moved_on(None);
}

#[test]
fn a_sensor_that_moves_erases_as_well() {
    assert_erases_what_moved_on(Some(Pose {
        rotation: DQuat::from_rotation_z(0.18) * DQuat::from_rotation_y(0.03),
        translation: DVec3::new(1.0, -0.2, 0.05),
    }));
}

#[test]
fn blocks_that_changed_are_told_once() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut patch = Patch::new(PatchConfig::default(), Some(sensor()));
    let visitor = (DVec3::new(5.0, -1.0, 0.3), DVec3::new(6.0, 1.0, 1.6));
    let mut erased = false;
    for k in 0..10 {
        let boxes = if k < 3 { vec![visitor] } else { vec![] };
        let before = map.clone();
        let done = patch
            .integrate(&mut map, &scan(DVec3::new(0.0, 0.0, 1.8), &boxes))
            .unwrap();
        let mut told = done.updated_blocks.clone();
        told.sort();
        let twice = told.windows(2).any(|pair| pair[0] == pair[1]);
        assert!(!twice);
        let changed = map
            .block_indices()
            .into_iter()
            .filter(|&i| map.block(i) != before.block(i));
        assert!(changed.into_iter().all(|i| told.binary_search(&i).is_ok()));
        erased |= map.observed_voxel_count() < before.observed_voxel_count();
    }
    assert!(erased);
}

/// What a 16-beam sensor sees of a rough wall at 5 m: no planes, 17 cm from ring to ring. On its left half returns are much nearer in every
/// second ring.
fn rough_wall() -> Scan {
    let sensor = sensor();
    let mut scan = Scan {
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mut rings = Vec::new();
    for (ring, elevation) in sensor.elevations_deg.iter().enumerate() {
        for column in 0..sensor.columns {
            let azimuth = -std::f32::consts::TAU * (column as f32 + 0.5) / sensor.columns as f32;
            if azimuth.cos() > 0.8 {
                let (sin_e, cos_e) = elevation.to_radians().sin_cos();
                let direction = Vec3::new(cos_e * azimuth.cos(), cos_e * azimuth.sin(), sin_e);
                let rough = ((column * 7919 + ring as u32 * 104_729) % 1000) as f32 / 1000.0 - 0.5;
                let nearer = if azimuth.sin() > 0.0 && ring % 2 == 0 { 1.5 } else { 0.0 };
                scan.points.push(direction * (5.0 / direction.x + 0.3 * rough - nearer));
                rings.push(ring as u16);
            }
        }
    }
    scan.rings = Some(rings);
    scan
}

#[test]
fn rays_without_planes_are_linked_where_no_depth_lies_between() {
    let map = |max_gap_m| {
        let config = PatchConfig {
            max_gap_m,
            ..Default::default()
        };
        fused(config, Some(sensor()), &[rough_wall()])
    };
    // In the middle between two rings, along the right half of the wall or its left.
    let covered = |map: &VoxelMap, side: f64| {
        let heights = (-3..3).map(|k| 5.0 * f64::from(2 * k).to_radians().tan());
        let places = heights.flat_map(|z| (20..200).map(move |k| DVec3::new(0.0, 0.01 * side * f64::from(k), z)));
        let observed = |place: DVec3| {
            (60..105).any(|k| {
                let place = place + DVec3::X * 0.05 * f64::from(k);
                map.voxel((place / 0.05).floor().as_ivec3()).weight_sum > 0
            })
        };
        let (seen, all) = places.fold((0, 0), |(seen, all), p| (seen + i32::from(observed(p)), all + 1));
        f64::from(seen) / f64::from(all)
    };
    let (linked, open) = (map(1.0), map(0.0));
    assert!(covered(&linked, -1.0) > 0.9, "{}", covered(&linked, -1.0));
    assert!(covered(&open, -1.0) < 0.6, "{}", covered(&open, -1.0));
    // Nothing between what is near and what is far.
    let (left, left_open) = (covered(&linked, 1.0), covered(&open, 1.0));
    assert!(left < left_open + 0.1, "{left} {left_open}");
}

#[test]
fn a_thin_board_stays_while_rays_pass_behind_it() {
    // Seen from above at first, then from below, by rays some of which pass just under it and end on a wall. Whichever side they come
    // from, two thirds of it would be left.
    let board = (DVec3::new(3.0, -1.0, 1.0), DVec3::new(4.0, 1.0, 1.02));
    let wall = (DVec3::new(8.0, -4.0, 0.0), DVec3::new(9.0, 4.0, 3.0));
    let from = |z: f64| scan(DVec3::new(0.0, 0.0, z), &[board, wall]);
    let above: Vec<Scan> = (0..4).map(|k| from(1.6 + 0.02 * f64::from(k))).collect();
    let mut scans = above.clone();
    scans.extend((0..40).map(|k| from(0.5 + 0.005 * f64::from(k))));
    let top = |scans: &[Scan], carve: bool| {
        let config = PatchConfig {
            carve,
            ..Default::default()
        };
        let mesh = mesh::extract(&fused(config, Some(sensor()), scans)).unwrap();
        let near = |v: &&DVec3| v.cmpgt(board.0 - 0.06).all() && v.cmplt(board.1 + 0.06).all();
        mesh.vertices.iter().filter(near).count() as f64
    };
    let (kept, all) = (top(&scans, true), top(&scans, false));
    assert!(top(&above, false) > 200.0 && kept > 0.75 * all, "{kept} of {all}");
}

#[test]
fn scans_without_beams_are_fused_as_well() {
    let scans: Vec<Scan> = (0..3).map(|k| common::scan(k, 60_000)).collect();
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut patch = Patch::new(PatchConfig::default(), None);
    for scan in &scans {
        let done = patch.integrate(&mut map, scan).unwrap();
        assert_eq!(done.fused_returns, 60_000);
    }
    let mesh = mesh::extract(&map).unwrap();
    let half = DVec3::new(3.0, 2.5, 1.5);
    // Noise goes from 0 to 2 cm; away from edges.
    let walls: Vec<f64> = mesh
        .vertices
        .iter()
        .map(|v| (half - v.abs()).abs())
        .filter(|d| d.to_array().iter().filter(|d| **d < 0.3).count() == 1)
        .map(DVec3::min_element)
        .collect();
    let mean = walls.iter().sum::<f64>() / walls.len() as f64;
    assert!(walls.len() > 20_000 && mean < 0.02, "{} {mean}", walls.len());
}

#[test]
fn threads_change_no_bit() {
    let visitor = (DVec3::new(5.0, -1.0, 0.3), DVec3::new(6.0, 1.0, 1.6));
    let mut scans = vec![scan(DVec3::new(0.0, 0.0, 1.8), &[visitor]); 2];
    scans.extend((0..6).map(|k| scan(DVec3::new(0.1 * f64::from(k), 0.0, 1.8), &[])));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fused(PatchConfig::default(), Some(sensor()), &scans))
    };
    let maps = [1, 2, 7].map(with);
    assert!(maps[0] == maps[1] && maps[0] == maps[2]);
    assert!(maps[0] != fused(PatchConfig::default(), Some(sensor()), &scans[1..]));
}

#[test]
fn a_shifted_world_has_a_shifted_map() {
    let scans = [scan(DVec3::new(0.1, 0.2, 1.8), &[])];
    let moved: Vec<Scan> = scans
        .iter()
        .map(|scan| {
            let mut scan = scan.clone();
            scan.pose.as_mut().unwrap().translation += DVec3::new(409_600.0, -819_200.0, 102.4);
            scan
        })
        .collect();
    let [here, there] = [&scans[..], &moved].map(|scans| fused(PatchConfig::default(), Some(sensor()), scans));
    let shift = IVec3::new(8_192_000, -16_384_000, 2048) / 8;
    let indices = here.block_indices();
    assert_eq!(indices.len(), there.block_count());
    assert!(
        indices
            .iter()
            .all(|i| here.block(*i) == there.block(tsdfuse::index::BlockIndex(i.0 + shift)))
    );
}

#[test]
fn hostile_scans_and_options_are_refused_or_counted() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut patch = Patch::new(PatchConfig::default(), None);
    let odd = Scan {
        points: vec![Vec3::NAN, Vec3::ZERO, Vec3::INFINITY, Vec3::splat(f32::MAX), Vec3::X],
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let done = patch.integrate(&mut map, &odd).unwrap();
    assert_eq!((done.fused_returns, done.skipped.outside_grid), (1, 4));
    let none = Scan {
        points: vec![Vec3::NAN; 3],
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    assert!(matches!(
        patch.integrate(&mut map, &none),
        Err(FuseError::Unorganized { .. })
    ));
    let empty = Scan {
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    assert_eq!(patch.integrate(&mut map, &empty).unwrap().fused_returns, 0);
    for (name, config) in [
        (
            "window_m",
            PatchConfig {
                window_m: 0.0,
                ..Default::default()
            },
        ),
        (
            "noise_m",
            PatchConfig {
                noise_m: f32::NAN,
                ..Default::default()
            },
        ),
        (
            "max_gap_m",
            PatchConfig {
                max_gap_m: -1.0,
                ..Default::default()
            },
        ),
    ] {
        assert!(config.validate().unwrap_err().to_string().contains(name));
    }
    assert_eq!(PatchConfig::default().validate(), Ok(()));
}
