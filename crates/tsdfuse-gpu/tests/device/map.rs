//! The map moves to the device and back, exactly.

use tsdfuse::{
    Integrator, MapConfig, Raycast, VoxelMap,
    glam::IVec3,
    index::{BLOCK_VOXELS, BlockIndex},
    map::{Block, Voxel},
};
use tsdfuse_gpu::{DeviceMap, GpuError, PoolConfig};

use crate::{common::scan, gpu};

/// Small pages: many of them, and little room at first.
pub(crate) const SMALL: PoolConfig = PoolConfig {
    first_blocks: 40,
    page_blocks: 600, // 512
    pages: 4,
};

/// Room for all at once.
pub(crate) const LARGE: PoolConfig = PoolConfig {
    first_blocks: 30_000,
    page_blocks: 1 << 18,
    pages: 1,
};

pub(crate) fn room() -> VoxelMap {
    room_of(3000)
}

/// A room seen by four scans of some returns.
pub(crate) fn room_of(returns: usize) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    for n in 0..4 {
        Raycast::default().integrate(&mut map, &scan(n, returns)).unwrap();
    }
    map
}

#[test]
fn a_map_comes_back_as_it_went() {
    let Some(gpu) = gpu() else { return };
    let map = room();
    for pool in [LARGE, SMALL] {
        let device = DeviceMap::upload(gpu, &map, pool).unwrap();
        assert_eq!(device.block_count().unwrap() as usize, map.block_count());
        assert!(device.capacity() as usize >= map.block_count());
        assert!(device.memory_bytes() > 4096 * map.block_count() as u64);
        let back = device.download().unwrap();
        assert!(back == map);
        // The comparison sees one block less.
        let mut fewer = VoxelMap::new(*map.config()).unwrap();
        for &index in &map.block_indices()[1..] {
            fewer.insert_block(index, map.block(index).unwrap().clone()).unwrap();
        }
        assert!(DeviceMap::upload(gpu, &fewer, pool).unwrap().download().unwrap() != map);
    }
}

#[test]
fn an_empty_map_is_one_on_the_device_too() {
    let Some(gpu) = gpu() else { return };
    let device = DeviceMap::new(gpu, MapConfig::default(), SMALL).unwrap();
    assert!(device.download().unwrap() == VoxelMap::new(MapConfig::default()).unwrap());
    let bad = MapConfig {
        voxel_size_m: 0.0,
        ..Default::default()
    };
    assert!(matches!(DeviceMap::new(gpu, bad, SMALL), Err(GpuError::Map(_))));
}

#[test]
fn chosen_blocks_come_back_in_their_order() {
    let Some(gpu) = gpu() else { return };
    let map = room();
    let there = map.block_indices();
    let absent = BlockIndex(IVec3::new(9999, -9999, 7));
    assert!(!there.contains(&absent));
    // More than one batch, backwards, and some twice.
    let wanted: Vec<BlockIndex> = there.iter().rev().cycle().copied().take(5000).collect();
    for pool in [LARGE, SMALL] {
        let device = DeviceMap::upload(gpu, &map, pool).unwrap();
        let mut asked = wanted.clone();
        asked.insert(7, absent);
        let got = device.download_blocks(&asked).unwrap();
        assert!(got.iter().map(|(index, _)| index).eq(&wanted));
        assert!(got.iter().all(|(index, block)| map.block(*index) == Some(block)));
        // The comparison sees blocks change places.
        let neighbours = got.iter().zip(&got[1..]);
        assert!(neighbours.filter(|(a, b)| map.block(a.0) != Some(&b.1)).count() > 4000);
        assert!(device.download_blocks(&[]).unwrap().is_empty());
        assert!(device.download_blocks(&[absent]).unwrap().is_empty());
    }
}

#[test]
fn extreme_sums_and_places_survive() {
    let Some(gpu) = gpu() else { return };
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let far = (1 << 28) - 2;
    for (n, at) in [[0, 0, 0], [-1, -1, -1], [far, -far, 7], [-far, far, -far]]
        .into_iter()
        .enumerate()
    {
        let mut voxels = [Voxel::default(); BLOCK_VOXELS];
        voxels[n] = Voxel {
            weight_sum: 1 << 30,
            distance_sum: -(1 << 30),
        };
        voxels[511] = Voxel {
            weight_sum: 1 << 30,
            distance_sum: 1 << 30,
        };
        map.insert_block(BlockIndex(IVec3::from(at)), Block { voxels }).unwrap();
    }
    assert!(DeviceMap::upload(gpu, &map, SMALL).unwrap().download().unwrap() == map);
}

#[test]
fn a_map_that_does_not_fit_is_refused_in_one_sentence() {
    let Some(gpu) = gpu() else { return };
    let tiny = PoolConfig {
        first_blocks: 1,
        page_blocks: 2,
        pages: 3,
    };
    let told = DeviceMap::upload(gpu, &room(), tiny).unwrap_err().to_string();
    assert!(told.starts_with("the map needs more than 6 blocks"), "{told}");
}
