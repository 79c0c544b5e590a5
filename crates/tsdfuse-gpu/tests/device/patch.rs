//! Surface patches on the device, against the CPU.

use tsdfuse::{
    MapConfig, Pose, Scan, SensorModel, VoxelMap,
    fuse::{FuseConfig, Method, PatchConfig},
    glam::{DQuat, DVec3, Vec3},
    scan::PoseAt,
    sensor::{Pixel, Projection},
};
use tsdfuse_gpu::{DeviceMap, Fuser, PoolConfig};

use crate::{
    common::scan,
    compare::{PLANES, assert_agrees, differing, voxels},
    fusing::{assert_same_counts_but, new_map, on_cpu, on_gpu, straightened, sweeps},
    gpu,
    map::SMALL,
};

const POOL: PoolConfig = PoolConfig {
    first_blocks: 3000,
    page_blocks: 8192,
    pages: 3,
};

fn assert_the_same(scans: &[Scan], config: &FuseConfig, sensor: Option<&SensorModel>, what: &str) {
    let Some(gpu) = gpu() else { return };
    let (want, cpu) = on_cpu(scans, Method::Patch, config, MapConfig::default(), sensor);
    let (got, device) = on_gpu(scans, Method::Patch, config, new_map(gpu, POOL), sensor);
    assert_agrees(&got, &want, PLANES, what);
    // Where a plane is one on one side only, so are its links.
    assert_same_counts_but(PLANES.share, &device, &cpu);
    assert_eq!(got.integrations(), want.integrations());
}

fn with(patch: PatchConfig) -> FuseConfig {
    FuseConfig {
        patch,
        ..Default::default()
    }
}

#[test]
fn a_street_from_a_moving_sensor() {
    let (scans, sensor) = sweeps(2);
    assert_the_same(&scans, &FuseConfig::default(), Some(&sensor), "patch, street");
}

#[test]
fn without_beams_a_grid_serves() {
    let scans: Vec<Scan> = (0..3).map(|n| scan(n, 6000)).collect();
    assert_the_same(&scans, &FuseConfig::default(), None, "patch, no beams");
}

/// Uniform in [0, 1). Without noise, which half of a window is the flattest is a matter of rounding.
fn random(i: usize) -> f64 {
    let mixed = (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (mixed >> 40) as f64 / (1_u64 << 24) as f64
}

/// A sensor of 24 beams in a room of 8 × 6 × 3 m, in front of a screen or not; in a sweep of 0.1 s it moves to these poses one
/// after the other (its own axes).
fn room_scan(number: usize, has_screen: bool, moved: &[Pose]) -> (Scan, SensorModel) {
    let elevations = (0..24).map(|ring| ring as f32 * 2.0 - 24.0).collect();
    let sensor = SensorModel::from_beams("room", elevations, 480, (0.1, 100.0)).unwrap();
    let projection = Projection::new(&sensor);
    let pose = Pose {
        rotation: DQuat::from_rotation_z(0.01 * number as f64),
        translation: DVec3::new(0.02 * number as f64, 0.1, 0.05),
    };
    let moved_count = moved.len() as f64;
    let mut scan = Scan {
        name: format!("room {number}"),
        pose: Some(pose),
        motion: (1..)
            .zip(moved)
            .map(|(n, &moved)| PoseAt {
                pose: pose * moved,
                secs: 0.1 / moved_count * f64::from(n),
            })
            .collect(),
        times: Some(Vec::new()),
        ..Default::default()
    };
    let sweep = scan.sweep();
    let cells = (0..24 * 480).filter(|i| i % 23 != 5);
    let point = |i: usize| {
        let (row, column) = ((i % 24) as f64, (i / 24) as f64);
        // It begins on its right, so that what is ahead comes late.
        let secs = 0.1 * (column / 480.0 + 0.75).fract();
        let world_from_sensor = sweep.as_ref().map_or(pose, |sweep| sweep.at(secs));
        let position = world_from_sensor.translation;
        let direction = projection.direction(Pixel { row, column });
        let ray = world_from_sensor.rotation * direction;
        let wall = ray.signum() * DVec3::new(4.0, 3.0, 1.5);
        let mut range = ((wall - position) / ray).min_element();
        let screen = (2.0 - position.x) / ray.x;
        let hit = position + ray * screen;
        if has_screen && screen > 0.0 && hit.y.abs() < 0.8 && hit.z.abs() < 0.7 {
            range = screen;
        }
        let noise = 0.03 * (random(30 * i + number) - 0.5);
        (((direction * (range + noise)).as_vec3(), (i % 24) as u16), secs as f32)
    };
    let ((points, rings), times): ((Vec<_>, Vec<_>), Vec<_>) = cells.map(point).unzip();
    (scan.points, scan.rings, scan.times) = (points, Some(rings), Some(times));
    (scan, sensor)
}

/// A screen that is there in the first two scans only.
fn screen(count: usize, moved: &[Pose]) -> (Vec<Scan>, SensorModel) {
    let (scans, mut sensors): (Vec<_>, Vec<_>) = (0..count).map(|n| room_scan(n, n < 2, moved)).unzip();
    (scans, sensors.remove(0))
}

fn assert_erases_alike(moved: &[Pose], what: &str) {
    let Some(gpu) = gpu() else { return };
    let (scans, sensor) = screen(7, moved);
    assert_the_same(&scans, &FuseConfig::default(), Some(&sensor), what);
    // It was: without erasing the map is another one.
    let carved = on_gpu(
        &scans,
        Method::Patch,
        &FuseConfig::default(),
        new_map(gpu, POOL),
        Some(&sensor),
    )
    .0;
    let kept = with(PatchConfig {
        carve: false,
        ..Default::default()
    });
    let kept = on_gpu(&scans, Method::Patch, &kept, new_map(gpu, POOL), Some(&sensor)).0;
    let share = differing(&voxels(&carved), &voxels(&kept), PLANES);
    assert!(share > 0.005, "{share}");
}

#[test]
fn what_moved_on_is_erased_alike() {
    assert_erases_alike(&[], "patch, a screen");
}

#[test]
fn what_moved_on_is_erased_alike_by_a_sensor_that_moves() {
    let moved = Pose {
        rotation: DQuat::from_rotation_z(0.18) * DQuat::from_rotation_x(-0.03),
        translation: DVec3::new(0.8, -0.6, 0.1),
    };
    assert_erases_alike(&[moved], "patch, a screen, moving sensor");
}

#[test]
fn what_moved_on_is_erased_alike_by_a_sensor_on_a_winding_way() {
    let Some(gpu) = gpu() else { return };
    let at = |x: f64, yaw: f64| Pose {
        rotation: DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(-0.2 * yaw),
        translation: DVec3::new(x, 0.4 * yaw, 0.1 * x),
    };
    let way = [at(0.1, 0.08), at(0.0, -0.02), at(0.3, 0.1), at(0.4, 0.03)];
    assert_erases_alike(&way, "patch, a screen, winding way");
    // The poses between are not ignored.
    let (scans, sensor) = screen(2, &way);
    let straight: Vec<Scan> = scans.iter().cloned().map(straightened).collect();
    let run = |scans: &[Scan]| {
        let config = FuseConfig::default();
        voxels(&on_gpu(scans, Method::Patch, &config, new_map(gpu, POOL), Some(&sensor)).0)
    };
    assert!(differing(&run(&scans), &run(&straight), PLANES) > 0.3);
}

/// A wall 4 m ahead with a window, 1.6 × 0.6 m, whose pane is elsewhere; the sensor is pitched.
fn window_scan(pane_m: f64, pitch_deg: f64) -> (Scan, SensorModel) {
    let elevations = vec![-15.0, -10.0, -5.0, 5.0, 10.0, 15.0];
    let sensor = SensorModel::from_beams("window", elevations, 1024, (0.1, 100.0)).unwrap();
    let projection = Projection::new(&sensor);
    let rotation = DQuat::from_rotation_y(pitch_deg.to_radians());
    let beams = (-100..=100).flat_map(|column: i32| (0..6_u16).map(move |ring| (ring, column.rem_euclid(1024))));
    let point = |(ring, column): (u16, i32)| {
        let number = 1024 * usize::from(ring) + column as usize + (9000.0 * pitch_deg.abs()) as usize;
        let (row, column) = (f64::from(ring), f64::from(column));
        let direction = projection.direction(Pixel { row, column });
        let ray = rotation * direction;
        let at = ray * (4.0 / ray.x);
        let is_window = at.y.abs() < 0.8 && at.z.abs() < 0.3;
        let range = if is_window { pane_m } else { 4.0 } / ray.x;
        let noise = 0.02 * (random(number) - 0.5);
        ((direction * (range + noise)).as_vec3(), ring)
    };
    let (points, rings) = beams.map(point).unzip();
    let scan = Scan {
        points,
        rings: Some(rings),
        pose: Some(Pose {
            rotation,
            ..Pose::IDENTITY
        }),
        ..Scan::default()
    };
    (scan, sensor)
}

#[test]
fn wide_links_are_not_made_before_nor_behind_what_is_known() {
    // A pane that lies back, and one that stands out.
    for pane_m in [4.2, 3.8] {
        // Two rings pass above and below it, …
        let (across, sensor) = window_scan(pane_m, 0.0);
        // … and those of these scans meet it.
        let mut scans: Vec<Scan> = (2..=8).map(|down| window_scan(pane_m, -f64::from(down)).0).collect();
        let linked = |scans: &[Scan]| {
            let config = FuseConfig::default();
            let map = on_cpu(scans, Method::Patch, &config, MapConfig::default(), Some(&sensor)).0;
            let places = (-5..=5).map(|y| DVec3::new(4.0, 0.1 * f64::from(y), 0.0));
            let near = |place: DVec3| map.sample(place).is_some_and(|sample| sample.distance_m.abs() < 0.05);
            places.filter(|&place| near(place)).count()
        };
        assert_eq!(linked(std::slice::from_ref(&across)), 11);
        scans.push(across);
        assert_eq!(linked(&scans), 0, "{pane_m} m");
        assert_the_same(&scans, &FuseConfig::default(), Some(&sensor), "patch, a window");
    }
}

#[test]
fn other_windows_noise_and_gaps() {
    let Some(gpu) = gpu() else { return };
    let (scans, sensor) = screen(2, &[]);
    for patch in [
        PatchConfig {
            window_m: 0.3,
            noise_m: 0.02,
            ..Default::default()
        },
        PatchConfig {
            window_m: 0.03,
            max_gap_m: 0.0,
            ..Default::default()
        },
    ] {
        assert_the_same(&scans, &with(patch), Some(&sensor), "patch, other options");
    }
    // Nor would it be the same with another noise than the scans' own.
    let run = |noise_m| {
        let config = with(PatchConfig {
            noise_m,
            ..Default::default()
        });
        voxels(&on_gpu(&scans, Method::Patch, &config, new_map(gpu, POOL), Some(&sensor)).0)
    };
    assert!(differing(&run(0.0), &run(0.03), PLANES) > PLANES.share);
}

#[test]
fn the_same_bits_however_often_the_map_grew_and_whoever_began_it() {
    let Some(gpu) = gpu() else { return };
    let (scans, sensor) = screen(4, &[]);
    let config = FuseConfig::default();
    let run = |device: DeviceMap, scans: &[Scan]| on_gpu(scans, Method::Patch, &config, device, Some(&sensor));
    let (first, reports) = run(new_map(gpu, POOL), &scans);
    let (grown, again) = run(new_map(gpu, SMALL), &scans);
    assert!(grown == first && again == reports);
    // Taken down and up again in between, by the same turns.
    let (half, _) = run(new_map(gpu, POOL), &scans[..2]);
    let continued = run(DeviceMap::upload(gpu, &half, POOL).unwrap(), &scans[2..]).0;
    assert!(continued == first && continued.integrations() == 4);
    assert!(half != first);
}

#[test]
fn scans_that_are_repeated_have_images_of_their_own() {
    let Some(gpu) = gpu() else { return };
    // Without beams, images are as large as clouds; each of these needs larger buffers, and room in the map.
    let scans: Vec<Scan> = (0..3).map(|n| scan(n, 1000 << (2 * n))).collect();
    let run = |pool| on_gpu(&scans, Method::Patch, &FuseConfig::default(), new_map(gpu, pool), None);
    let (large, small) = (run(POOL), run(SMALL));
    assert!(large.0 == small.0 && large.1 == small.1);
}

#[test]
fn empty_scans_and_invalid_returns_do_no_harm() {
    let Some(gpu) = gpu() else { return };
    let (mut scans, sensor) = screen(1, &[]);
    let nowhere = Scan {
        name: "nowhere".into(),
        points: vec![Vec3::NAN; 9],
        rings: Some(vec![0; 9]),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let empty = Scan {
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    scans.extend([empty, nowhere]);
    let mut fuser = Fuser::new(new_map(gpu, POOL), Method::Patch, &FuseConfig::default(), Some(&sensor)).unwrap();
    let mut done = Vec::new();
    for scan in &scans {
        done.extend(fuser.integrate(scan).unwrap());
    }
    done.extend(fuser.finish().unwrap());
    let lost: Vec<u64> = done.iter().map(|d| d.skipped.outside_grid).collect();
    assert_eq!(lost, [0, 0, 9]);
    let (want, _): (VoxelMap, _) = on_cpu(
        &scans,
        Method::Patch,
        &FuseConfig::default(),
        MapConfig::default(),
        Some(&sensor),
    );
    assert_agrees(
        &fuser.map().download().unwrap(),
        &want,
        PLANES,
        "patch, after invalid scans",
    );
}
