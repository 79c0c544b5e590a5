//! Looking up many blocks that are near each other.

use glam::IVec3;

use super::{
    block::{Block, Voxel},
    voxel_map::VoxelMap,
};
use crate::index::{BlockIndex, hash, local_number};

/// How many blocks are remembered.
const BLOCKS: usize = 512;

/// A map, and the blocks of it that were looked up last.
pub(crate) struct Recent<'a> {
    map: &'a VoxelMap,
    blocks: Box<[(BlockIndex, Option<&'a Block>); BLOCKS]>,
}

impl<'a> Recent<'a> {
    pub(crate) fn new(map: &'a VoxelMap) -> Self {
        Self {
            map,
            // No map has such a block.
            blocks: Box::new([(BlockIndex(IVec3::MIN), None); BLOCKS]),
        }
    }

    #[inline]
    pub(crate) fn block(&mut self, index: BlockIndex) -> Option<&'a Block> {
        let known = &mut self.blocks[hash(index.0) as usize % BLOCKS];
        if known.0 != index {
            *known = (index, self.map.block(index));
        }
        known.1
    }

    #[inline]
    pub(super) fn voxel(&mut self, voxel: IVec3) -> Voxel {
        let block = self.block(BlockIndex::of(voxel));
        block.map_or(Voxel::default(), |block| block.voxels[local_number(voxel)])
    }
}
