//! Maps for tests.

use glam::{IVec3, Vec3};

use super::{Block, MapConfig, Voxel, VoxelMap, WEIGHT_SCALE};
use crate::index::{BlockIndex, voxel_at};

/// A map of 5 cm voxels with the blocks from one to another, not including it. Each voxel less than 10 cm from the surface was observed 20 times, at
/// this height above it.
pub(crate) fn map_of(first: IVec3, end: IVec3, height_m: impl Fn(Vec3) -> f32) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let (grid, truncation_m) = (map.grid(), map.config().truncation_m as f32);
    let size = end - first;
    for n in 0..size.element_product() {
        let index = BlockIndex(first + IVec3::new(n % size.x, n / size.x % size.y, n / (size.x * size.y)));
        let mut block = Block::EMPTY;
        for (i, voxel) in block.voxels.iter_mut().enumerate() {
            let height_m = height_m(grid.center(voxel_at(index, i)).as_vec3());
            if height_m.abs() < 0.1 {
                let weight_sum = 20 * WEIGHT_SCALE;
                *voxel = Voxel {
                    weight_sum,
                    distance_sum: (height_m / truncation_m * weight_sum as f32) as i32,
                };
            }
        }
        map.replace_block(index, block).unwrap();
    }
    map
}
