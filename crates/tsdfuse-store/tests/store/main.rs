//! Maps that are fused with little memory, and what a store holds after a crash, on a full disk and when it is damaged.

#![allow(clippy::unwrap_used)] // test helpers

mod damage;
mod disk;
mod paging;

use std::path::Path;

use tsdfuse::fuse::{FuseConfig, Method, RoldaoConfig, RoldaoForm};
use tsdfuse::scan::RangeLimits;
use tsdfuse::{MapConfig, Scan, SensorModel, VoxelMap};
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};
use tsdfuse_store::PagedMap;

const LITTLE: Option<usize> = Some(1 << 20);

fn config() -> MapConfig {
    MapConfig {
        voxel_size_m: 0.05,
        truncation_m: 0.2,
        max_weight: 5.0,
    }
}

/// A drive through a street and back, by a sensor that sees as far as a lamp.
fn drive() -> (SensorModel, Vec<Scan>) {
    let street = scene::by_name("street", 3).unwrap();
    let sensor = tsdfuse::sensor::model("vlp16").unwrap();
    let config = SimulatorConfig {
        noise: NoiseModel::none(),
        ..Default::default()
    };
    let poses = path::default_for(&street, 24);
    let simulator = Simulator::new(street, sensor.clone(), poses, config).unwrap();
    let mut scans: Vec<Scan> = simulator.scans().collect();
    for scan in &mut scans {
        scan.drop_invalid(&RangeLimits {
            min_range_m: 0.5,
            max_range_m: 7.0,
        });
    }
    let back: Vec<Scan> = scans.iter().rev().cloned().collect();
    scans.extend(back);
    (sensor, scans)
}

/// Fuses scans with the whole map in memory.
fn fused(method: Method, sensor: &SensorModel, scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(config()).unwrap();
    let mut integrator = method.build(&streaming(), Some(sensor));
    for scan in scans {
        integrator.integrate(&mut map, scan).unwrap();
    }
    map
}

/// Options with which all methods fuse scan by scan.
fn streaming() -> FuseConfig {
    FuseConfig {
        roldao: RoldaoConfig {
            form: RoldaoForm::Streaming,
            ..Default::default()
        },
        ..Default::default()
    }
}

/// Fuses scans with little of the map in memory, commits after some of them (counted from 1), and tells how often
/// something was evicted.
fn fused_with_little(
    paged: &mut PagedMap,
    method: Method,
    sensor: &SensorModel,
    scans: &[Scan],
    commits: &[usize],
) -> usize {
    let mut integrator = method.build(&streaming(), Some(sensor));
    let (mut evicted, mut before) = (0, paged.map_in_memory().block_count());
    for (number, scan) in (1..).zip(scans) {
        if let Some(next) = scans.get(number) {
            paged.prefetch(next.pose.unwrap().translation).unwrap();
        }
        paged.integrate(&mut *integrator, scan).unwrap();
        let after = paged.map_in_memory().block_count();
        evicted += usize::from(after < before);
        before = after;
        if commits.contains(&number) {
            paged.commit(number.to_string().as_bytes()).unwrap();
        }
    }
    evicted
}

fn new_store(path: &Path) -> PagedMap {
    let map = VoxelMap::new(config()).unwrap();
    PagedMap::create(path, map, b"new", LITTLE).unwrap()
}

/// All of a map, in memory.
fn whole(mut paged: PagedMap) -> VoxelMap {
    all_of(&mut paged).unwrap()
}

/// As [`whole`], of a store that may be damaged.
fn all_of(paged: &mut PagedMap) -> tsdfuse_store::Result<VoxelMap> {
    let mut map = VoxelMap::new(*paged.config()).unwrap();
    map.set_integrations(paged.integrations());
    paged.for_each_region(|part, region| {
        for (index, block) in part.blocks_of(region) {
            map.insert_block(index, block.clone()).unwrap();
        }
        Ok::<_, tsdfuse_store::StoreError>(())
    })?;
    Ok(map)
}
