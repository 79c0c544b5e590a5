//! A map that needs more memory than there is ends with an error, and what it has stays.

use std::process::Command;

use tsdfuse::fuse::{FuseConfig, FuseError, Method};
use tsdfuse::glam::Vec3;
use tsdfuse::index::BlockIndex;
use tsdfuse::map::{Block, MapError, OutOfMemory, Voxel};
use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, SensorModel, VoxelMap, glam};

use crate::common;

fn map() -> VoxelMap {
    VoxelMap::new(MapConfig {
        voxel_size_m: 0.02,
        truncation_m: 0.1,
        ..Default::default()
    })
    .unwrap()
}

fn block(x: i32) -> (BlockIndex, Block) {
    let mut block = Block::EMPTY;
    block.voxels[7] = Voxel {
        weight_sum: 5,
        distance_sum: x % 5,
    };
    (BlockIndex(glam::IVec3::X * x), block)
}

#[test]
fn both_engines_stop_at_the_limit_and_go_on_with_more() {
    let config = FuseConfig::default();
    for method in [Method::Raycast, Method::Surfels] {
        let fuse = |map: &mut VoxelMap| method.build(&config, None).integrate(map, &common::scan(0, 30_000));
        let mut whole = map();
        fuse(&mut whole).unwrap();
        let needed = whole.block_count() * size_of::<Block>();
        assert!(needed > 4 << 20, "{needed}");

        let mut limited = map();
        limited.set_memory_limit(needed / 4);
        let error = fuse(&mut limited).unwrap_err();
        let limit_bytes = needed / 4;
        assert_eq!(error, FuseError::OutOfMemory(OutOfMemory::Limit { limit_bytes }));
        assert!(limited.block_count() * size_of::<Block>() <= limit_bytes);
        // What is there can be read, and made room for.
        assert!(limited.block_indices().iter().all(|&b| limited.block(b).is_some()));
        let regions = limited.regions();
        assert!(method != Method::Raycast || regions.len() > 1);
        regions.into_iter().for_each(|region| drop(limited.take_region(region)));
        limited.set_memory_limit(usize::MAX);
        fuse(&mut limited).unwrap();
        assert!(limited == whole, "{}", method.name());
    }
}

#[test]
fn blocks_from_elsewhere_are_refused_beyond_the_limit() {
    let (mut map, mut other) = (map(), map());
    map.set_memory_limit(4 * 32 * 1024);
    let refused = (0..)
        .map(|x| block(64 * x))
        .find_map(|(i, block)| map.insert_block(i, block).err());
    let limit_bytes = 4 * 32 * 1024;
    let full = OutOfMemory::Limit { limit_bytes };
    assert_eq!((refused, map.block_count()), (Some(MapError::OutOfMemory(full)), 4));
    assert_eq!(full.to_string(), "the map needs more than 0.1 MiB, its memory limit");
    let (index, block) = block(64 * 9);
    other.insert_block(index, block).unwrap();
    assert_eq!(map.merge(&other), Err(MapError::OutOfMemory(full)));
}

/// Set for the children below, which run with a limited address space.
const CHILD: &str = "TSDFUSE_TEST_CHILD";

/// Runs a test of this file in a child process that may have 1.2 GB of address space, and returns what it prints.
fn in_child(test: &str, value: &str) -> String {
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 1200000; exec \"$@\"", "sh"])
        .arg(std::env::current_exe().unwrap())
        .args([
            "--exact",
            &format!("memory::{test}"),
            "--nocapture",
            "--test-threads",
            "1",
        ])
        .env(CHILD, value)
        .env("RAYON_NUM_THREADS", "2")
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
#[cfg(target_os = "linux")]
fn an_address_space_that_is_used_up_is_an_error() {
    if let Ok(limit) = std::env::var(CHILD) {
        let mut map = map();
        assert!(map.memory_limit() < 1_200_000 << 10, "{}", map.memory_limit());
        if limit == "none" {
            map.set_memory_limit(usize::MAX);
        }
        let refused = (0..)
            .map(|x| block(8 * x))
            .find_map(|(i, block)| map.insert_block(i, block).err());
        println!("{}", refused.unwrap());
        // There is still room for other things.
        let mut small = VoxelMap::new(*map.config()).unwrap();
        Raycast::default().integrate(&mut small, &common::scan(0, 100)).unwrap();
        return;
    }
    for (limit, told) in [
        ("none", "needs more memory than the system gives"),
        ("default", "its memory limit"),
    ] {
        let printed = in_child("an_address_space_that_is_used_up_is_an_error", limit);
        assert!(printed.contains(told), "{printed}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_room_in_voxels_of_a_tenth_of_a_millimetre_is_an_error_with_each_method() {
    if std::env::var(CHILD).is_err() {
        let printed = in_child(
            "a_room_in_voxels_of_a_tenth_of_a_millimetre_is_an_error_with_each_method",
            "",
        );
        let refused = printed.matches("or voxels are too small").count();
        assert!(
            printed.matches("its memory limit").count() + refused >= 7 && refused <= 1,
            "{printed}"
        );
        return;
    }
    let scan = rings();
    for &method in Method::ALL {
        let mut map = VoxelMap::new(MapConfig {
            voxel_size_m: 1e-4,
            truncation_m: 60e-4,
            ..Default::default()
        })
        .unwrap();
        map.set_memory_limit(256 << 20);
        let mut integrator = method.build(&FuseConfig::default(), Some(&sensor()));
        let done = integrator.integrate(&mut map, &scan);
        let done = done.and_then(|_| integrator.finish(&mut map));
        println!(
            "{}: {}",
            method.name(),
            done.map_or_else(|e| e.to_string(), |_| "done".to_owned())
        );
    }
}

fn sensor() -> SensorModel {
    let elevations_deg = (0..16).map(|ring| 2.0 * ring as f32 - 15.0).collect();
    SensorModel::from_beams("sixteen", elevations_deg, 1800, (0.1, 100.0)).unwrap()
}

/// A room of 6 × 5 × 3 m, as a sensor with rings sees it.
fn rings() -> Scan {
    let all = (0..1800).flat_map(|column| (0..16).map(move |ring| (column, ring)));
    let point = |(column, ring): (u16, u16)| {
        let azimuth = -std::f32::consts::TAU * (f32::from(column) + 0.5) / 1800.0;
        let elevation = (2.0 * f32::from(ring) - 15.0).to_radians();
        let direction = Vec3::new(
            elevation.cos() * azimuth.cos(),
            elevation.cos() * azimuth.sin(),
            elevation.sin(),
        );
        direction * (Vec3::new(3.0, 2.5, 1.5) / direction.abs()).min_element()
    };
    Scan {
        points: all.clone().map(point).collect(),
        rings: Some(all.map(|(_, ring)| ring).collect()),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}
