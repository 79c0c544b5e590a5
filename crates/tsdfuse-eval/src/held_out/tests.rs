use std::f64::consts::PI;

use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::scan::{PoseAt, RangeLimits};
use tsdfuse::{Integrator, MapConfig, Pose, Raycast, VoxelMap};
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};

use super::*;

/// A wall of 3 m × 3 m at this distance ahead.
fn wall(x: f32) -> impl Iterator<Item = Vec3> {
    let grid = (-50..50).flat_map(|y| (-50..50).map(move |z| (y as f32, z as f32)));
    grid.map(move |(y, z)| Vec3::new(x, 0.03 * y + 0.01, 0.03 * z + 0.01))
}

fn scan(points: impl Iterator<Item = Vec3>) -> Scan {
    Scan {
        points: points.collect(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}

fn map_of(scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    for scan in scans {
        Raycast::default().integrate(&mut map, scan).unwrap();
    }
    map
}

fn held_out(map: &VoxelMap, scan: &Scan) -> HeldOut {
    let mut collector = Collector::new(0.2);
    collector
        .add(&Renderer::new(map, &Default::default()).unwrap(), scan)
        .unwrap();
    collector.result().unwrap()
}

#[test]
fn a_plane_is_predicted_up_to_the_noise_of_its_ranges() {
    let sigma_m = 0.02;
    let plane = scene::by_name("plane", 0).unwrap();
    let poses = path::by_name("orbit", &plane, 20).unwrap();
    let config = SimulatorConfig {
        noise: NoiseModel {
            range_sigma_m: sigma_m,
            ..NoiseModel::none()
        },
        ..Default::default()
    };
    let sensor = tsdfuse::sensor::model("os0-128").unwrap();
    let simulator = Simulator::new(plane, sensor, poses, config).unwrap();
    let near = |mut scan: Scan, max_range_m| {
        scan.drop_invalid(&RangeLimits {
            max_range_m,
            ..Default::default()
        });
        scan
    };
    let fused: Vec<Scan> = (0..20)
        .filter(|&i| i % 10 != 5)
        .filter_map(|i| simulator.nth_scan(i))
        .collect();
    let map = map_of(&fused);
    // Where rays do not graze the plane: there the error of the map is divided by the sine of a small angle.
    let result = held_out(&map, &near(simulator.nth_scan(5).unwrap(), 4.0));
    assert!(result.returns > 10_000 && result.hit_rate > 0.999, "{result:?}");
    assert!(
        (result.error.unwrap().mean_m / (sigma_m * (2.0 / PI).sqrt()) - 1.0).abs() < 0.1,
        "{result:?}"
    );
    assert!(
        (result.error.unwrap().p95_m / (1.96 * sigma_m) - 1.0).abs() < 0.1,
        "{result:?}"
    );
    assert!(result.bias_m.abs() < 0.002, "{result:?}");
}

/// The canary: what is wrong by 10 cm shows 10 cm, in either direction.
#[test]
fn a_map_that_is_off_shows_by_how_much() {
    let map = map_of(&[scan(wall(4.0))]);
    for shift_m in [0.0, 0.1, -0.1] {
        let mut moved = scan(wall(4.0));
        moved.pose.as_mut().unwrap().translation.x = shift_m;
        let result = held_out(&map, &moved);
        // The borders of the wall are seen past.
        assert!(
            result.hit_rate > 0.9 && result.false_surface == 0.0,
            "{shift_m}: {result:?}"
        );
        assert!((result.bias_m + shift_m).abs() < 0.012, "{shift_m}: {result:?}");
        assert!(
            (result.error.unwrap().median_m - shift_m.abs()).abs() < 0.012,
            "{shift_m}: {result:?}"
        );
    }
}

#[test]
fn surface_in_front_is_false_and_surface_that_is_not_there_is_missing() {
    let both = map_of(&[scan(wall(4.0)), scan(wall(2.0).filter(|p| p.y < 0.0 && p.y > -0.7))]);
    let result = held_out(&both, &scan(wall(4.0)));
    // The small wall hides the right half of the large one, which is seen to 1.5 m aside.
    assert!((result.false_surface - 0.45).abs() < 0.03, "{result:?}");
    assert!(result.missing < 0.05, "{result:?}");
    let cap = result.false_surface + result.missing;
    let wanted = cap * 0.2 + result.hit_rate * result.error.unwrap().mean_m;
    assert!((result.capped_error_m - wanted).abs() < 1e-9);

    let result = held_out(&map_of(&[scan(wall(4.0))]), &scan(wall(2.0)));
    assert_eq!((result.missing, result.error, result.capped_error_m), (1.0, None, 0.2));
    assert!((result.hit_rate + result.false_surface).abs() < 1e-12);
    assert!(Collector::new(0.2).result().is_none());
}

#[test]
fn each_return_is_looked_for_from_where_the_sensor_was() {
    let map = map_of(&[scan(wall(4.0))]);
    // The sensor goes 1 m ahead while it scans; half-way through it is 3.5 m from the wall.
    let points = wall(4.0)
        .enumerate()
        .map(|(i, p)| (p - Vec3::X * (i as f32 / 1e4), i as f32 / 1e5));
    let (points, times): (Vec<_>, Vec<_>) = points.unzip();
    let mut moving = Scan {
        points,
        times: Some(times),
        pose: Some(Pose::IDENTITY),
        motion: vec![PoseAt {
            pose: Pose {
                translation: DVec3::X,
                ..Pose::IDENTITY
            },
            secs: 0.1,
        }],
        ..Default::default()
    };
    let result = held_out(&map, &moving);
    assert!(
        result.hit_rate > 0.9 && result.error.unwrap().median_m < 0.012,
        "{result:?}"
    );
    moving.motion.clear();
    let still = held_out(&map, &moving);
    assert!(still.hit_rate < 0.3, "{still:?}");
}
