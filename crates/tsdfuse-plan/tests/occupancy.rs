//! Free space against brute force along each ray.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // test helpers

use std::collections::BTreeMap;

use proptest::prelude::*;
use tsdfuse::glam::{DQuat, DVec3, IVec3, Vec3};
use tsdfuse::{Pose, Scan};
use tsdfuse_plan::occupancy::{Occupancy, OccupancyConfig, State};

fn scan_of(pose: Pose, points: Vec<Vec3>) -> Scan {
    Scan {
        points,
        pose: Some(pose),
        ..Default::default()
    }
}

/// A scan of a sphere's inside, by many rays.
fn all_around(radius_m: f32, count: i32) -> Vec<Vec3> {
    let point = |i: i32| {
        let (z, turn) = (1.0 - 2.0 * (i as f32 + 0.5) / count as f32, i as f32 * 2.399_963);
        let side = (1.0 - z * z).sqrt();
        radius_m * Vec3::new(side * turn.cos(), side * turn.sin(), z)
    };
    (0..count).map(point).collect()
}

/// The voxels of each ray, by many small steps.
fn stepped(scan: &Scan, config: &OccupancyConfig) -> BTreeMap<[i32; 3], bool> {
    let mut seen = BTreeMap::new();
    for (pose, point) in scan.poses().unwrap().zip(&scan.points) {
        let way = pose.rotation * point.as_dvec3();
        let share = (config.max_range_m / way.length()).min(1.0);
        let steps = 4000;
        for i in 0..=steps {
            let at = pose.translation + way * share * f64::from(i) / f64::from(steps);
            let voxel = (at / config.voxel_size_m).floor().as_ivec3().to_array();
            *seen.entry(voxel).or_default() |= i == steps && share == 1.0;
        }
    }
    seen
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn rays_touch_the_voxels_that_small_steps_find(
        points in prop::collection::vec((-9.0..9.0_f32, -9.0..9.0_f32, -3.0..3.0_f32), 1..12),
        origin in (-5.0..5.0_f64, -5.0..5.0_f64, -1.0..1.0_f64),
        turn in -3.0..3.0_f64,
        max_range_m in 2.0..15.0_f64,
    ) {
        let config = OccupancyConfig { voxel_size_m: 0.3, max_range_m };
        let pose = Pose { rotation: DQuat::from_rotation_z(turn), translation: DVec3::from(origin) };
        let scan = scan_of(pose, points.iter().map(|&point| Vec3::from(point)).collect());
        let mut occupancy = Occupancy::new(config).unwrap();
        occupancy.integrate(&scan).unwrap();
        let known: BTreeMap<[i32; 3], bool> =
            occupancy.known().map(|(voxel, state)| (voxel.to_array(), state == State::Occupied)).collect();
        let expected = stepped(&scan, &config);
        // Small steps miss corners that a ray cuts by less than a step.
        for (voxel, is_hit) in &expected {
            prop_assert_eq!(known.get(voxel), Some(is_hit), "{:?}", voxel);
        }
        prop_assert!(known.len() <= expected.len() + 2 + expected.len() / 20, "{} {}", known.len(), expected.len());
    }
}

#[test]
fn inside_is_free_the_wall_is_occupied_and_beyond_is_unknown() {
    let mut occupancy = Occupancy::new(OccupancyConfig::default()).unwrap();
    let scan = scan_of(Pose::IDENTITY, all_around(4.0, 60_000));
    occupancy.integrate(&scan).unwrap();
    let at = |radius: f64| occupancy.at(DVec3::new(0.6, 0.64, 0.48).normalize() * radius);
    assert_eq!(
        (at(1.0), at(3.5), at(4.0), at(4.6)),
        (State::Free, State::Free, State::Occupied, State::Unknown)
    );
    assert_eq!(occupancy.at(DVec3::INFINITY), State::Unknown);
    // The wall goes away: after some scans the space is free up to the one behind.
    let behind = scan_of(Pose::IDENTITY, all_around(6.0, 120_000));
    for _ in 0..4 {
        occupancy.integrate(&behind).unwrap();
    }
    assert_eq!(occupancy.at(DVec3::new(0.6, 0.64, 0.48).normalize() * 4.0), State::Free);
}

#[test]
fn any_number_of_threads_tells_the_same() {
    let scan = scan_of(Pose::IDENTITY, all_around(7.0, 5_000));
    let of = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut occupancy = Occupancy::new(OccupancyConfig::default()).unwrap();
        pool.install(|| (0..3).for_each(|_| occupancy.integrate(&scan).unwrap()));
        occupancy
    };
    let one = of(1);
    assert!(one == of(2) && one == of(5) && one.known().count() > 10_000);
}

/// A room with one open side: the frontier is there.
#[test]
fn frontiers_are_where_the_unknown_begins() {
    let mut occupancy = Occupancy::new(OccupancyConfig {
        max_range_m: 5.0,
        ..OccupancyConfig::default()
    })
    .unwrap();
    // A box around the sensor, 6 m × 6 m × 3 m; no wall towards +x, where rays end after 5 m.
    let to_box = |point: Vec3| {
        let reach = [
            3.0 / point.y.abs(),
            1.5 / point.z.abs(),
            if point.x < 0.0 { 3.0 / -point.x } else { f32::INFINITY },
        ];
        point * reach.into_iter().fold(20.0, f32::min)
    };
    let points = all_around(1.0, 200_000).into_iter().map(to_box).collect();
    occupancy.integrate(&scan_of(Pose::IDENTITY, points)).unwrap();
    let frontiers = occupancy.frontiers(-1.0, 1.0, 20);
    assert!(
        frontiers[0].center.x > 2.5 && frontiers[0].center.y.abs() < 0.5,
        "{:?}",
        frontiers[0].center
    );
    for frontier in &frontiers {
        assert!(frontier.voxels.len() >= 20 && frontier.voxels.is_sorted_by_key(tsdfuse::glam::IVec3::to_array));
        assert!(
            frontier
                .voxels
                .iter()
                .all(|voxel| occupancy.state(*voxel) == State::Free)
        );
    }
    assert!(occupancy.frontiers(50.0, 60.0, 1).is_empty());
}

#[test]
fn a_slice_is_occupied_where_any_voxel_of_the_column_is() {
    let mut occupancy = Occupancy::new(OccupancyConfig {
        voxel_size_m: 1.0,
        max_range_m: 20.0,
    })
    .unwrap();
    let pose = Pose {
        translation: DVec3::new(0.5, 0.5, 0.5),
        ..Pose::IDENTITY
    };
    let scan = scan_of(pose, vec![Vec3::new(5.0, 0.0, 0.0), Vec3::new(0.0, 3.0, 0.0)]);
    occupancy.integrate(&scan).unwrap();
    assert_eq!(occupancy.bounds(), Some((IVec3::ZERO, IVec3::new(5, 3, 0))));
    let slice = occupancy.slice(0.0, 1.0).unwrap();
    assert_eq!((slice.width, slice.height, slice.origin.to_array()), (6, 4, [0.0, 0.0]));
    let row: Vec<State> = slice.cells[..6].to_vec();
    assert_eq!(row, [vec![State::Free; 5], vec![State::Occupied]].concat());
    assert_eq!(
        (slice.cells[6], slice.cells[7], slice.cells[18]),
        (State::Free, State::Unknown, State::Occupied)
    );
    let costs = slice.costs(2.0);
    assert_eq!(costs[..6], [0, 0, 0, 0, 49, 100].map(Some));
    assert_eq!((costs[12], costs[7]), (Some(49), None));
    assert!(occupancy.slice(3.0, 4.0).is_none());
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let told = |voxel_size_m, max_range_m| {
        let config = OccupancyConfig {
            voxel_size_m,
            max_range_m,
        };
        Occupancy::new(config).unwrap_err().to_string()
    };
    assert_eq!(told(-1.0, 2.0), "voxel_size_m = -1: 1 mm to 1 km");
    assert_eq!(
        told(0.2, f64::NAN),
        "max_range_m = NaN: more than 0, and less than 100,000 voxels"
    );
    assert_eq!(
        told(0.2, 1e9),
        "max_range_m = 1000000000: more than 0, and less than 100,000 voxels"
    );
}

#[test]
fn an_array_holds_what_is_known() {
    let mut occupancy = Occupancy::new(OccupancyConfig::default()).unwrap();
    let nothing = occupancy.dense().unwrap();
    assert_eq!((nothing.size, nothing.get(IVec3::ZERO)), ([0; 3], None));
    occupancy
        .integrate(&scan_of(Pose::IDENTITY, all_around(2.0, 5000)))
        .unwrap();
    let dense = occupancy.dense().unwrap();
    assert_eq!(dense.values.len(), dense.size.iter().product());
    let end = dense.low + IVec3::from(dense.size.map(|edge| edge as i32));
    for voxel in [
        dense.low - 1,
        dense.low,
        end - 1,
        end,
        IVec3::ZERO,
        IVec3::splat(i32::MAX),
    ] {
        let is_inside = voxel.cmpge(dense.low).all() && voxel.cmplt(end).all();
        assert_eq!(
            dense.get(voxel).copied(),
            is_inside.then(|| occupancy.state(voxel)),
            "{voxel}"
        );
    }
    let known = dense.values.iter().filter(|state| **state != State::Unknown).count();
    assert_eq!(known, occupancy.known().count());
    // Two places far apart make too large a box.
    let far = Pose {
        translation: DVec3::new(1e6, 1e6, 0.0),
        ..Pose::IDENTITY
    };
    occupancy.integrate(&scan_of(far, all_around(2.0, 10))).unwrap();
    assert!(occupancy.dense().unwrap_err().to_string().contains("no more than"));
}
