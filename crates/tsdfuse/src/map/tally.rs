//! What a map holds, counted block by block, without the map.

use glam::IVec3;
use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;

use super::{
    block::Block,
    error::{MapError, check_block},
    shard::Region,
};
use crate::{
    index::{BlockIndex, RegionIndex, SHARDS, shard_of, voxel_at},
    memory::slabs_bytes,
};

/// Counts what a map holds while its blocks go by, each once: of a file that is larger than memory, for instance. It keeps one
/// number per region.
#[derive(Clone, Debug)]
pub struct Tally {
    blocks: usize,
    observed_voxels: usize,
    extent: Option<[IVec3; 2]>,
    /// The blocks of each region, in the tables that the map would have.
    shards: Vec<HashMap<IVec3, u32, FxBuildHasher>>,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            blocks: 0,
            observed_voxels: 0,
            extent: None,
            shards: vec![HashMap::default(); SHARDS],
        }
    }
}

impl Tally {
    /// Counts a block.
    ///
    /// # Errors
    /// [`MapError`] if the block lies outside of the grid, or holds sums that no observations have. It is not counted then.
    pub fn add(&mut self, index: BlockIndex, block: &Block) -> Result<(), MapError> {
        check_block(index, block)?;
        self.blocks += 1;
        *self.shards[shard_of(index)]
            .entry(RegionIndex::of(index).0)
            .or_default() += 1;
        for (number, _) in (0..).zip(&block.voxels).filter(|(_, voxel)| voxel.weight_sum > 0) {
            self.observed_voxels += 1;
            let voxel = voxel_at(index, number);
            let [low, high] = self.extent.unwrap_or([voxel; 2]);
            self.extent = Some([low.min(voxel), high.max(voxel)]);
        }
        Ok(())
    }

    /// [`VoxelMap::block_count`](super::VoxelMap::block_count) of the map.
    pub fn blocks(&self) -> usize {
        self.blocks
    }

    /// [`VoxelMap::observed_voxel_count`](super::VoxelMap::observed_voxel_count) of the map.
    pub fn observed_voxels(&self) -> usize {
        self.observed_voxels
    }

    /// The lowest and the highest index of observed voxels, along each axis.
    pub fn extent(&self) -> Option<[IVec3; 2]> {
        self.extent
    }

    /// [`VoxelMap::memory_bytes`](super::VoxelMap::memory_bytes) of the map once these blocks are put in.
    pub fn memory_bytes(&self) -> usize {
        let shard = |regions: &HashMap<IVec3, u32, FxBuildHasher>| {
            let blocks = regions
                .values()
                .map(|blocks| slabs_bytes(*blocks as usize))
                .sum::<usize>();
            blocks + regions.allocation_size() + regions.len() * size_of::<Region>()
        };
        self.shards.iter().map(shard).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MapConfig, VoxelMap, map::Voxel};

    #[test]
    fn a_tally_is_what_the_map_says() {
        let observed = Voxel {
            weight_sum: 5,
            ..Voxel::default()
        };
        let (mut map, mut tally) = (VoxelMap::new(MapConfig::default()).unwrap(), Tally::default());
        assert_eq!((tally.extent(), tally.memory_bytes()), (None, map.memory_bytes()));
        for i in 0..5000 {
            // Many regions; in some of them, more than one slab of blocks.
            let index = BlockIndex(IVec3::new(i % 50 - 7, i / 50 % 20, 8 * (i / 1000)));
            let mut block = Block::EMPTY;
            block.voxels[i as usize % 512] = observed;
            block.voxels[7] = observed;
            tally.add(index, &block).unwrap();
            map.insert_block(index, block).unwrap();
        }
        assert_eq!(
            (tally.blocks(), tally.observed_voxels(), tally.memory_bytes()),
            (map.block_count(), map.observed_voxel_count(), map.memory_bytes())
        );
        // Voxel 7 is the last along x of its block's first row.
        assert_eq!(
            tally.extent(),
            Some([IVec3::new(-56, 0, 0), IVec3::new(8 * 42 + 7, 8 * 19 + 7, 8 * 32 + 7)])
        );
        let outside = BlockIndex(IVec3::MAX);
        assert_eq!(
            tally.add(outside, &Block::EMPTY),
            map.insert_block(outside, Block::EMPTY)
        );
        assert_eq!(tally.blocks(), map.block_count());
    }
}
