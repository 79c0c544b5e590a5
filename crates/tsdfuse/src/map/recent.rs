//! Looking up many blocks that are near each other.

use glam::IVec3;

use super::{
    block::{Block, Voxel},
    voxel_map::VoxelMap,
};
use crate::index::{BlockIndex, local_number};

/// A map, and the blocks of it that were looked up last.
pub(crate) struct Recent<'a> {
    map: &'a VoxelMap,
    blocks: [(BlockIndex, Option<&'a Block>); 64],
}

impl<'a> Recent<'a> {
    pub(crate) fn new(map: &'a VoxelMap) -> Self {
        Self {
            map,
            // No map has such a block.
            blocks: [(BlockIndex(IVec3::MIN), None); 64],
        }
    }

    #[inline]
    pub(crate) fn block(&mut self, index: BlockIndex) -> Option<&'a Block> {
        let low = index.0 & 3;
        let known = &mut self.blocks[(low.x | low.y << 2 | low.z << 4) as usize % 64];
        if known.0 != index {
            *known = (index, self.map.block(index));
        }
        known.1
    }

    #[inline]
    pub(crate) fn voxel(&mut self, voxel: IVec3) -> Voxel {
        let block = self.block(BlockIndex::of(voxel));
        block.map_or(Voxel::default(), |block| block.voxels[local_number(voxel)])
    }
}
