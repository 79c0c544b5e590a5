//! What a scan can touch, before it is fused.

use tsdfuse::{
    Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap,
    fuse::{FuseConfig, Method, RoldaoForm},
    glam::{DQuat, DVec3, IVec3, Vec3},
    index::RegionIndex,
    scan::PoseAt,
};

/// Walls: 60 m ahead, 4 m to the left, 9 m to the right.
fn scan() -> Scan {
    let directions = (0..3600).map(|i| (f64::from(i) + 0.5).to_radians() / 10.0);
    let points = directions.flat_map(|azimuth| {
        let (sin, cos) = azimuth.sin_cos();
        let ahead = if cos > 0.0 { 60.0 / cos } else { 1.5 };
        let beside = if sin > 0.0 { 4.0 / sin } else { -9.0 / sin };
        let range = ahead.min(beside);
        (-3..4).map(move |z| Vec3::new((range * cos) as f32, (range * sin) as f32, 0.3 * z as f32))
    });
    Scan {
        points: points.collect(),
        pose: Some(Pose {
            rotation: DQuat::from_rotation_z(0.7),
            translation: DVec3::new(691_000.0, 5_335_000.0, 520.0),
        }),
        ..Default::default()
    }
}

/// The default options, with which all methods fuse scan by scan.
fn scan_by_scan() -> FuseConfig {
    let mut config = FuseConfig::default();
    config.roldao.form = RoldaoForm::Streaming;
    config
}

#[test]
fn all_that_is_updated_lies_within_reach_and_little_else() {
    let scan = scan();
    for method in [Method::Raycast, Method::Surfels, Method::Roldao] {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let mut integrator = method.build(&scan_by_scan(), None);
        let reach = integrator.reach(map.config(), &scan).unwrap();
        let done = integrator.integrate(&mut map, &scan).unwrap();
        assert!(!done.updated_blocks.is_empty(), "{method:?}");
        let grid = map.grid();
        for &block in &done.updated_blocks {
            assert!(reach.touches(RegionIndex::of(block), grid), "{method:?}: {block:?}");
        }
        // The middle of each ray, too, and a metre to all sides of its end.
        let region = |p: DVec3| RegionIndex((p / 3.2).floor().as_ivec3());
        for p in scan.points_in_world().unwrap() {
            assert!(reach.touches(region(0.5 * (p + reach.center)), grid));
            assert!(
                [DVec3::X, DVec3::Y, DVec3::Z]
                    .iter()
                    .all(|&d| reach.touches(region(p + d), grid))
            );
            assert!(
                [DVec3::X, DVec3::Y, DVec3::Z]
                    .iter()
                    .all(|&d| reach.touches(region(p - d), grid))
            );
        }
        // Of the ball about the sensor, it is a small part.
        let first = region(reach.center).0;
        let ball = (-25..25).flat_map(|y| (-25..25).map(move |x| RegionIndex(first + IVec3::new(x, y, 0))));
        let share = ball.filter(|&region| reach.touches(region, grid)).count();
        assert!((50..900).contains(&share), "{method:?}: {share}");
        // Moved along with the sensor.
        let moved = reach.at(reach.center + DVec3::X * 320.0);
        let there = RegionIndex(first + IVec3::new(100, 0, 0));
        assert!(moved.touches(there, grid) && !reach.touches(there, grid));
    }
}

#[test]
fn each_method_reaches_as_far_beside_the_returns_as_it_says() {
    let scan = scan();
    let far = |method: Method, set: fn(&mut FuseConfig)| {
        let mut config = FuseConfig::default();
        set(&mut config);
        let map = MapConfig::default();
        let reach = method.build(&config, None).reach(&map, &scan).unwrap();
        // Regions beyond the wall 60 m ahead that are still touched.
        let grid = VoxelMap::new(map).unwrap().grid();
        let ahead = scan.pose.unwrap().rotation * DVec3::X;
        let beyond = (0..1000).find(|&k| {
            let place = reach.center + ahead * (60.0 + f64::from(k));
            !reach.touches(RegionIndex((place / 3.2).floor().as_ivec3()), grid)
        });
        beyond.unwrap()
    };
    let rays = far(Method::Raycast, |_| ());
    assert!(far(Method::Patch, |c| c.patch.max_gap_m = 20.0) > rays + 40);
    assert!(far(Method::Surfels, |c| c.surfel.finest_cell_m = 20.0) > rays + 40);
    let mut twisted = scan.clone();
    twisted.times = Some(vec![0.0]);
    for &method in Method::ALL {
        let integrator = method.build(&FuseConfig::default(), None);
        assert!(integrator.reach(&MapConfig::default(), &twisted).is_err(), "{method:?}");
    }
}

#[test]
fn whether_a_method_needs_the_sensor_is_whether_its_map_depends_on_it() {
    let needs = |method: Method| method.build(&FuseConfig::default(), None).needs_sensor();
    let without: Vec<&str> = Method::ALL.iter().filter(|m| !needs(**m)).map(|m| m.name()).collect();
    assert_eq!(without, ["raycast", "depth", "roldao"]);
}

/// A sensor that swings out and back within its sweep is far away only in the middle of it.
#[test]
fn all_poses_of_a_sweep_count() {
    let mut scan = scan();
    let home = scan.pose.unwrap();
    let n = scan.points.len() as f32;
    scan.times = Some((0..scan.points.len()).map(|i| 0.1 * i as f32 / n).collect());
    let at = |secs, y| PoseAt {
        secs,
        pose: Pose {
            translation: home.translation + DVec3::Y * y,
            ..home
        },
    };
    scan.motion = vec![at(0.025, 10.0), at(0.05, 20.0), at(0.075, 10.0), at(0.1, 0.0)];
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut raycast = Raycast::default();
    let reach = raycast.reach(map.config(), &scan).unwrap();
    let done = raycast.integrate(&mut map, &scan).unwrap();
    let grid = map.grid();
    let outside = |reach: &tsdfuse::Reach| {
        let blocks = done.updated_blocks.iter();
        blocks
            .filter(|&&block| !reach.touches(RegionIndex::of(block), grid))
            .count()
    };
    assert_eq!(outside(&reach), 0);
    // It would not do without the poses in the middle.
    scan.motion = vec![at(0.1, 0.0)];
    assert!(outside(&raycast.reach(map.config(), &scan).unwrap()) > 0);
}

#[test]
fn a_scan_without_a_pose_reaches_nothing_and_is_not_fused() {
    let nowhere = Scan {
        name: "lost.pcd".into(),
        pose: None,
        ..scan()
    };
    for &method in Method::ALL {
        let (mut map, options) = (VoxelMap::new(MapConfig::default()).unwrap(), FuseConfig::default());
        let told = "lost.pcd: has no pose, so it cannot be placed in the world";
        let reach = method.build(&options, None).reach(map.config(), &nowhere);
        assert_eq!(reach.unwrap_err().to_string(), told);
        let mut scan = nowhere.clone();
        if method == Method::Depth {
            scan.camera = Some(tsdfuse::sensor::Pinhole::with_fov(80, 60, 1.1));
        }
        let sensor = tsdfuse::sensor::model("vlp16");
        let fused = method.build(&options, sensor.as_ref()).integrate(&mut map, &scan);
        assert_eq!(fused.unwrap_err().to_string(), told, "{method:?}");
        assert_eq!(map.block_count(), 0);
    }
}
