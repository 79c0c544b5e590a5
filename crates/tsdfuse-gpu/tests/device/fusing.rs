//! Scans fused on the device, against the CPU.

use tsdfuse::{
    MapConfig, Pose, Scan, SensorModel, VoxelMap,
    fuse::{Distance, FuseConfig, FuseError, Method, RaycastConfig},
    glam::{DQuat, DVec3, Vec3},
    index::BlockIndex,
    scan::PoseAt,
    sensor::Pinhole,
};
use tsdfuse_gpu::{DeviceMap, Fused, Fuser, Gpu, GpuError, PoolConfig};
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

use crate::{
    common::scan,
    compare::{ROUNDING, assert_agrees, differing, voxels},
    gpu,
    map::{LARGE, SMALL},
};

pub(crate) fn on_cpu(
    scans: &[Scan],
    method: Method,
    config: &FuseConfig,
    map: MapConfig,
    sensor: Option<&SensorModel>,
) -> (VoxelMap, Vec<Fused>) {
    let mut map = VoxelMap::new(map).unwrap();
    let mut integrator = method.build(config, sensor);
    let mut fuse = |scan: &Scan| {
        let mut done = integrator.integrate(&mut map, scan).unwrap();
        done.updated_blocks.sort_unstable();
        Fused {
            name: scan.name.clone(),
            updated_blocks: done.updated_blocks,
            fused_returns: done.fused_returns,
            skipped: done.skipped,
        }
    };
    let done = scans.iter().map(&mut fuse).collect();
    (map, done)
}

pub(crate) fn on_gpu(
    scans: &[Scan],
    method: Method,
    config: &FuseConfig,
    map: DeviceMap,
    sensor: Option<&SensorModel>,
) -> (VoxelMap, Vec<Fused>) {
    let mut fuser = Fuser::new(map, method, config, sensor).unwrap();
    let mut done = Vec::new();
    for scan in scans {
        done.extend(fuser.integrate(scan).unwrap());
    }
    done.extend(fuser.finish().unwrap());
    (fuser.map().download().unwrap(), done)
}

/// Some pages, and little room at first.
const STREET: PoolConfig = PoolConfig {
    first_blocks: 3000,
    page_blocks: 8192,
    pages: 3,
};

pub(crate) fn new_map(gpu: &Gpu, pool: PoolConfig) -> DeviceMap {
    DeviceMap::new(gpu, MapConfig::default(), pool).unwrap()
}

/// Scans of a sensor that turns and moves while it measures, and whose last two returns are none.
fn moving_scans(count: usize) -> Vec<Scan> {
    let moving = |n: usize| {
        let still = scan(n, 4000);
        let pose = Pose {
            rotation: still.pose.unwrap().rotation * DQuat::from_rotation_z(0.15) * DQuat::from_rotation_x(-0.05),
            translation: still.pose.unwrap().translation + DVec3::new(0.3, -0.1, 0.05),
        };
        let mut times: Vec<f32> = (0..4000).map(|i| -0.02 + 0.12 * i as f32 / 4000.0).collect();
        times.extend([0.0, f32::NAN]);
        let mut points = still.points;
        points.extend([Vec3::new(f32::NAN, 1.0, 0.0), Vec3::X]);
        Scan {
            points,
            times: Some(times),
            motion: vec![PoseAt { pose, secs: 0.1 }],
            ..still
        }
    };
    (0..count).map(moving).collect()
}

/// The same sensor with four more poses, two segments of which are turns that the straight line between its ends leaves out.
fn winding(mut scan: Scan) -> Scan {
    let own = scan.pose.unwrap();
    let at = |secs, x, y, yaw, roll| PoseAt {
        secs,
        pose: own
            * Pose {
                rotation: DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(roll),
                translation: DVec3::new(x, y, 0.3 * x),
            },
    };
    scan.motion = vec![
        at(-0.01, -0.05, 0.1, -0.1, 0.02),
        at(0.03, 0.2, 0.05, 0.15, -0.05),
        at(0.06, 0.1, -0.2, -0.1, 0.1),
        at(0.1, 0.4, -0.1, 0.2, 0.0),
    ];
    scan
}

/// The same scan with the last of its poses alone.
pub(crate) fn straightened(mut scan: Scan) -> Scan {
    scan.motion.drain(..scan.motion.len() - 1);
    scan
}

#[test]
fn a_sweep_with_five_poses_agrees_with_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let config = FuseConfig::default();
    let (rooms, (streets, sensor)) = (moving_scans(3), sweeps(2));
    let rooms: Vec<Scan> = rooms.into_iter().map(winding).collect();
    let streets: Vec<Scan> = streets.into_iter().map(winding).collect();
    for (method, scans, sensor) in [
        (Method::Raycast, &rooms, None),
        (Method::Normals, &streets, Some(&sensor)),
        (Method::Cylindrical, &streets, Some(&sensor)),
    ] {
        let (want, cpu) = on_cpu(scans, method, &config, MapConfig::default(), sensor);
        let (got, device) = on_gpu(scans, method, &config, new_map(gpu, STREET), sensor);
        assert_agrees(&got, &want, ROUNDING, &format!("five poses, {}", method.name()));
        assert_same_counts(&device, &cpu);
        // The poses between are not ignored.
        let straight: Vec<Scan> = scans.iter().cloned().map(straightened).collect();
        let (other, _) = on_gpu(&straight, method, &config, new_map(gpu, STREET), sensor);
        assert!(differing(&voxels(&other), &voxels(&want), ROUNDING) > 0.3);
    }
}

pub(crate) fn assert_same_counts(device: &[Fused], cpu: &[Fused]) {
    assert_same_counts_but(0.0, device, cpu);
}

/// Blocks that are only in the first of two sorted lists.
fn only_in_first(a: &[BlockIndex], b: &[BlockIndex]) -> usize {
    a.iter().filter(|index| b.binary_search(index).is_err()).count()
}

/// One updated block, or a share of them, may be missing, and as many may be extra.
pub(crate) fn assert_same_counts_but(share: f64, device: &[Fused], cpu: &[Fused]) {
    assert_eq!(device.len(), cpu.len());
    for (a, b) in device.iter().zip(cpu) {
        assert_eq!(
            (&a.name, a.fused_returns, a.skipped),
            (&b.name, b.fused_returns, b.skipped)
        );
        let (a, b) = (a.updated_blocks.as_slice(), b.updated_blocks.as_slice());
        assert!(a.is_sorted_by(|a, b| a < b), "each block once");
        let few = 1.max((share * b.len() as f64) as usize);
        let apart = [only_in_first(a, b), only_in_first(b, a)];
        assert!(apart.iter().all(|&n| n <= few), "{apart:?} of {} blocks", b.len());
        // Missing blocks are seen from both sides.
        if let Some(fewer) = a.get(2 * few + 1..) {
            assert!(only_in_first(b, fewer) > few);
        }
        if let Some(fewer) = b.get(2 * few + 1..) {
            assert!(only_in_first(a, fewer) > few);
        }
    }
}

#[test]
fn both_forms_of_raycasting_agree_with_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let still: Vec<_> = (0..6).map(|n| scan(n, 3000)).collect();
    for distance in [Distance::Euclidean, Distance::Projective] {
        let config = FuseConfig {
            raycast: RaycastConfig { distance },
            ..Default::default()
        };
        for scans in [&still, &moving_scans(3)] {
            let (want, cpu) = on_cpu(scans, Method::Raycast, &config, MapConfig::default(), None);
            let (got, device) = on_gpu(scans, Method::Raycast, &config, new_map(gpu, LARGE), None);
            assert_agrees(&got, &want, ROUNDING, &format!("{distance:?}"));
            assert_same_counts(&device, &cpu);
        }
    }
}

#[test]
fn far_from_the_origin_and_with_other_voxels() {
    let Some(gpu) = gpu() else { return };
    let mut far = scan(2, 3000);
    far.pose.as_mut().unwrap().translation += DVec3::new(465_432.1, 5_512_345.6, -123.4);
    let config = FuseConfig::default();
    for truncation_m in [0.021, 0.1, 0.6] {
        let map = MapConfig {
            voxel_size_m: 0.02,
            truncation_m,
            ..Default::default()
        };
        let scans = [far.clone()];
        let (want, _) = on_cpu(&scans, Method::Raycast, &config, map, None);
        let device = DeviceMap::new(gpu, map, LARGE).unwrap();
        let (got, _) = on_gpu(&scans, Method::Raycast, &config, device, None);
        assert_agrees(&got, &want, ROUNDING, &format!("truncation {truncation_m}"));
    }
}

#[test]
fn two_runs_give_the_same_bits_however_often_the_map_had_to_grow() {
    let Some(gpu) = gpu() else { return };
    let scans = moving_scans(6);
    let run = |pool| {
        on_gpu(
            &scans,
            Method::Raycast,
            &FuseConfig::default(),
            new_map(gpu, pool),
            None,
        )
    };
    let (first, reports) = run(LARGE);
    assert!(first.block_count() > 1000);
    for _ in 0..2 {
        let (grown, again) = run(SMALL);
        assert!(grown == first);
        assert_eq!(again, reports);
    }
    // The comparison sees a scan less.
    let fewer = on_gpu(
        &scans[1..],
        Method::Raycast,
        &FuseConfig::default(),
        new_map(gpu, SMALL),
        None,
    );
    assert!(fewer.0 != first);
}

/// The blocks that differ between two maps.
fn changed(before: &VoxelMap, after: &VoxelMap) -> Vec<BlockIndex> {
    let mut all = after.block_indices();
    all.retain(|&index| before.block(index) != after.block(index));
    all
}

#[test]
fn updated_blocks_are_those_that_changed_also_with_many_scans_in_flight() {
    let Some(gpu) = gpu() else { return };
    let (sweeps, sensor) = sweeps(3);
    let rooms = moving_scans(6);
    for (method, scans, sensor) in [(Method::Raycast, &rooms, None), (Method::Patch, &sweeps, Some(&sensor))] {
        let config = FuseConfig::default();
        // One scan after the other, each with all of the map before and after it.
        let mut fuser = Fuser::new(new_map(gpu, LARGE), method, &config, sensor).unwrap();
        let mut before = fuser.map().download().unwrap();
        let mut want = Vec::new();
        for scan in scans {
            let mut done = fuser.integrate(scan).unwrap();
            done.extend(fuser.finish().unwrap());
            let after = fuser.map().download().unwrap();
            let updated = &done[0].updated_blocks;
            let changed = changed(&before, &after);
            assert_eq!(only_in_first(&changed, updated), 0, "{method:?}, {}", done[0].name);
            // Free space can erase exactly what the scan itself has added.
            let unchanged = only_in_first(updated, &changed);
            let most = if method == Method::Patch {
                updated.len() / 1000
            } else {
                0
            };
            assert!(unchanged <= most, "{method:?}, {}: {unchanged}", done[0].name);
            want.append(&mut done);
            before = after;
        }
        assert!(want.iter().all(|scan| scan.updated_blocks.len() > 100));
        // More than are expected of the first scan, so the rest of its list is read later.
        assert!(want[0].updated_blocks.len() > 512, "{}", want[0].updated_blocks.len());
        // All at once, in a map that grows and makes scans repeat.
        let small = PoolConfig {
            first_blocks: 40,
            page_blocks: 8192,
            pages: 3,
        };
        let (map, got) = on_gpu(scans, method, &config, new_map(gpu, small), sensor);
        assert_eq!(got, want);
        assert!(map == before);
    }
}

#[test]
fn a_copy_of_the_map_follows_by_its_updated_blocks() {
    let Some(gpu) = gpu() else { return };
    let mut fuser = Fuser::new(new_map(gpu, SMALL), Method::Raycast, &FuseConfig::default(), None).unwrap();
    let mut copy = std::collections::BTreeMap::new();
    let mut follow = |fuser: &Fuser, done: Vec<Fused>| {
        for scan in done {
            let blocks = fuser.map().download_blocks(&scan.updated_blocks).unwrap();
            assert_eq!(blocks.len(), scan.updated_blocks.len());
            copy.extend(blocks);
        }
        copy.len()
    };
    for scan in moving_scans(6) {
        let done = fuser.integrate(&scan).unwrap();
        follow(&fuser, done);
    }
    let done = fuser.finish().unwrap();
    assert!(follow(&fuser, done) > 1000);
    let map = fuser.map().download().unwrap();
    assert_eq!(copy.len(), map.block_count());
    assert!(copy.iter().all(|(&index, block)| map.block(index) == Some(block)));
}

#[test]
fn fusing_goes_on_in_a_map_that_the_cpu_began() {
    let Some(gpu) = gpu() else { return };
    let (scans, config) = (moving_scans(4), FuseConfig::default());
    let (half, _) = on_cpu(&scans[..2], Method::Raycast, &config, MapConfig::default(), None);
    let (want, _) = on_cpu(&scans, Method::Raycast, &config, MapConfig::default(), None);
    let device = DeviceMap::upload(gpu, &half, SMALL).unwrap();
    let (got, _) = on_gpu(&scans[2..], Method::Raycast, &config, device, None);
    assert_agrees(&got, &want, ROUNDING, "half and half");
}

#[test]
fn weights_are_limited_after_each_scan_as_the_cpu_does() {
    let Some(gpu) = gpu() else { return };
    let (scans, config) = (moving_scans(5), FuseConfig::default());
    let limited = MapConfig {
        max_weight: 1.5,
        ..Default::default()
    };
    // Scan by scan: the sums of one scan alone, added and limited by the CPU's own formula.
    let mut want = VoxelMap::new(limited).unwrap();
    for scan in &scans {
        let (alone, _) = on_gpu(
            std::slice::from_ref(scan),
            Method::Raycast,
            &config,
            new_map(gpu, SMALL),
            None,
        );
        let mut next = VoxelMap::new(limited).unwrap();
        let mut all: Vec<_> = want.block_indices().into_iter().chain(alone.block_indices()).collect();
        all.sort();
        all.dedup();
        for index in all {
            let blocks = [want.block(index), alone.block(index)];
            let mut sum = blocks[0].or(blocks[1]).unwrap().clone();
            if let [Some(a), Some(b)] = blocks {
                for (v, (a, b)) in sum.voxels.iter_mut().zip(a.voxels.iter().zip(&b.voxels)) {
                    v.weight_sum = a.weight_sum + b.weight_sum;
                    v.distance_sum = a.distance_sum + b.distance_sum;
                }
            }
            for v in &mut sum.voxels {
                let max = limited.max_weight_sum();
                if v.weight_sum > max {
                    v.distance_sum = (i64::from(v.distance_sum) * i64::from(max) / i64::from(v.weight_sum)) as i32;
                    v.weight_sum = max;
                }
            }
            next.insert_block(index, sum).unwrap();
        }
        want = next;
    }
    let device = DeviceMap::new(gpu, limited, SMALL).unwrap();
    let (got, _) = on_gpu(&scans, Method::Raycast, &config, device, None);
    assert!(got == want);
    let most = voxels(&got)
        .values()
        .filter(|v| v.weight_sum == limited.max_weight_sum())
        .count();
    assert!(most > 1000, "{most}");
}

#[test]
fn a_crowd_of_returns_in_one_voxel_overflows_nothing() {
    let Some(gpu) = gpu() else { return };
    let crowd = Scan {
        name: "crowd".into(),
        points: vec![Vec3::new(0.8, 0.01, 0.01); 150_000],
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let config = FuseConfig::default();
    let (want, _) = on_cpu(
        std::slice::from_ref(&crowd),
        Method::Raycast,
        &config,
        MapConfig::default(),
        None,
    );
    let (got, device) = on_gpu(&[crowd], Method::Raycast, &config, new_map(gpu, SMALL), None);
    assert_eq!(device[0].fused_returns, 150_000);
    let (a, b) = (voxels(&got), voxels(&want));
    assert_eq!(differing(&a, &b, ROUNDING), 0.0);
    assert!(a.values().any(|v| v.weight_sum == 1 << 30));
}

#[test]
fn a_scan_that_cannot_be_fused_changes_nothing_and_others_follow() {
    let Some(gpu) = gpu() else { return };
    let good = scan(0, 1000);
    let mut fuser = Fuser::new(new_map(gpu, SMALL), Method::Raycast, &FuseConfig::default(), None).unwrap();
    let outside = Scan {
        pose: Some(Pose {
            translation: DVec3::splat(1e12),
            ..Default::default()
        }),
        ..good.clone()
    };
    let torn = Scan {
        rings: Some(vec![0; 3]),
        ..good.clone()
    };
    let nowhere = Scan {
        pose: None,
        ..good.clone()
    };
    for bad in [&outside, &torn, &nowhere] {
        let told = fuser.integrate(bad).unwrap_err();
        assert!(matches!(
            told,
            GpuError::Fuse(FuseError::OutsideGrid { .. } | FuseError::Scan(_))
        ));
        assert!(told.is_bad_scan() && !told.is_full());
    }
    let nothing = Scan {
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mut done = fuser.integrate(&nothing).unwrap();
    done.extend(fuser.integrate(&good).unwrap());
    done.extend(fuser.finish().unwrap());
    assert_eq!(done.iter().map(|d| d.fused_returns).collect::<Vec<_>>(), [0, 1000]);
    let (want, _) = on_cpu(
        &[good],
        Method::Raycast,
        &FuseConfig::default(),
        MapConfig::default(),
        None,
    );
    assert_agrees(&fuser.map().download().unwrap(), &want, ROUNDING, "after bad scans");
}

#[test]
fn a_full_device_says_so_and_keeps_the_scans_before() {
    let Some(gpu) = gpu() else { return };
    let scans = moving_scans(6);
    // Two pages of 512 blocks; the first scan has room.
    let pool = PoolConfig {
        first_blocks: 512,
        page_blocks: 512,
        pages: 2,
    };
    let small = scan(1, 300);
    let mut fuser = Fuser::new(new_map(gpu, pool), Method::Raycast, &FuseConfig::default(), None).unwrap();
    fuser.integrate(&small).unwrap();
    let kept = fuser.finish().unwrap();
    assert_eq!(kept[0].fused_returns, 300);
    let failed = scans.iter().map(|scan| fuser.integrate(scan)).find_map(Result::err);
    let error = failed.or_else(|| fuser.finish().err()).unwrap();
    assert!(error.is_full() && !error.is_bad_scan());
    let told = error.to_string();
    assert_eq!(
        told,
        "the map needs more than 1024 blocks, which is all that this GPU can hold"
    );
    // And again, whatever comes next.
    assert!(fuser.finish().unwrap().is_empty());
    fuser.integrate(&small).unwrap();
    assert_eq!(fuser.finish().unwrap_err().to_string(), told);
    let (want, _) = on_cpu(
        &[small],
        Method::Raycast,
        &FuseConfig::default(),
        MapConfig::default(),
        None,
    );
    assert_agrees(&fuser.map().download().unwrap(), &want, ROUNDING, "a full device");
}

/// Sweeps of a simulated sensor that moves through a street, with noise.
pub(crate) fn sweeps(count: usize) -> (Vec<Scan>, SensorModel) {
    let street = scene::by_name("street", 0).unwrap();
    let sensor = tsdfuse::sensor::model("vlp16").unwrap();
    let poses = path::by_name("vehicle", &street, 40).unwrap()[..count].to_vec();
    let config = SimulatorConfig {
        motion: true,
        ..Default::default()
    };
    let simulator = Simulator::new(street, sensor.clone(), poses, config).unwrap();
    let mut scans: Vec<_> = simulator.scans().collect();
    scans.iter_mut().for_each(|scan| scan.drop_invalid(&Default::default()));
    (scans, sensor)
}

#[test]
fn methods_that_know_the_beams_agree_with_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let (scans, sensor) = sweeps(3);
    assert!(scans.iter().all(|s| s.points.len() > 10_000 && s.sweep().is_some()));
    for method in [Method::Normals, Method::Cylindrical] {
        let config = FuseConfig::default();
        let (want, cpu) = on_cpu(&scans, method, &config, MapConfig::default(), Some(&sensor));
        let (got, device) = on_gpu(&scans, method, &config, new_map(gpu, STREET), Some(&sensor));
        assert_agrees(&got, &want, ROUNDING, method.name());
        assert_same_counts(&device, &cpu);
    }
}

#[test]
fn kernels_are_timed_where_the_device_has_a_clock() {
    let Some(_) = gpu() else { return };
    let own = Gpu::open(None).unwrap(); // others would be timed too
    if !own.record_timeline() {
        eprintln!("skipped: this device has no clock");
        return;
    }
    let mut fuser = Fuser::new(new_map(&own, SMALL), Method::Raycast, &FuseConfig::default(), None).unwrap();
    fuser.integrate(&scan(0, 30)).unwrap();
    fuser.finish().unwrap();
    let stages = own.timeline().unwrap();
    let names: Vec<_> = stages.iter().map(|stage| stage.name).collect();
    assert!(names.starts_with(&["allocate", "fuse", "limit_weights"]), "{names:?}");
    assert!(
        stages.iter().all(|stage| (0.0..60.0).contains(&stage.seconds)),
        "{stages:?}"
    );
    assert!(stages.iter().any(|stage| stage.seconds > 0.0));
    assert_eq!(own.timeline().unwrap(), []);
}

/// Images of a depth camera in the room, with holes.
fn images(count: usize) -> Vec<Scan> {
    let camera = Pinhole::with_fov(80, 60, 1.1);
    let half = DVec3::new(3.0, 2.5, 1.5);
    let image = |n: usize| {
        let pose = scan(n, 1).pose.unwrap();
        let pixels = (0..camera.pixels()).filter(|i| i % 17 != 0);
        let points = pixels.map(|i| {
            let ray = camera.ray((i % 80) as f32, (i / 80) as f32);
            let in_world = pose.rotation * ray.as_dvec3();
            let wall = in_world.signum() * half;
            let depth = ((wall - pose.translation) / in_world).min_element();
            ray * (depth as f32 + 0.01 * (i % 7) as f32)
        });
        let hidden = (0..camera.pixels())
            .step_by(11)
            .map(|i| camera.ray((i % 80) as f32, (i / 80) as f32) * 9.0);
        let outside = [-Vec3::X, Vec3::NAN, Vec3::new(1.0, 3.0, 0.0)];
        Scan {
            name: format!("image {n}"),
            points: outside.into_iter().chain(hidden).chain(points).collect(),
            pose: Some(pose),
            camera: Some(camera),
            ..Default::default()
        }
    };
    (0..count).map(image).collect()
}

#[test]
fn depth_images_agree_with_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let (scans, config) = (images(4), FuseConfig::default());
    let (want, cpu) = on_cpu(&scans, Method::Depth, &config, MapConfig::default(), None);
    let (got, device) = on_gpu(&scans, Method::Depth, &config, new_map(gpu, SMALL), None);
    assert_agrees(&got, &want, ROUNDING, "depth");
    assert_same_counts(&device, &cpu);
    // What is no image is refused.
    let mut fuser = Fuser::new(new_map(gpu, SMALL), Method::Depth, &config, None).unwrap();
    let told = fuser.integrate(&scan(0, 10)).unwrap_err();
    assert!(matches!(told, GpuError::Fuse(FuseError::Image { .. })), "{told}");
}
