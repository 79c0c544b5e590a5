//! Regions on their own: taken out of a map, kept elsewhere, put in again. Blocks do not move in memory.

use std::sync::Arc;

use super::{
    block::Block,
    error::{MapError, check_block},
    shard::{NO_SLOT, Region},
    voxel_map::VoxelMap,
};
use crate::{
    index::{BlockIndex, REGION_BLOCKS, RegionIndex, block_of_region, in_region, shard_of_region},
    memory::{Pool, SLAB_BLOCKS, Slab},
};

/// Where the memory of a map's blocks comes from; for making regions on another thread.
#[derive(Clone, Debug, Default)]
pub struct BlockPool(Arc<Pool>);

/// The blocks of a region, outside of any map. Once it is dropped, maps of its pool use its memory again.
#[derive(Debug)]
pub struct RegionBlocks {
    index: RegionIndex,
    /// The blocks' numbers in the region, as they lie in memory.
    numbers: Vec<u16>,
    slabs: Vec<Slab>,
    pool: Arc<Pool>,
}

impl RegionBlocks {
    /// A region without blocks.
    pub fn new(index: RegionIndex, pool: &BlockPool) -> Self {
        Self {
            index,
            numbers: Vec::new(),
            slabs: Vec::new(),
            pool: Arc::clone(&pool.0),
        }
    }

    /// Which one it is.
    pub fn index(&self) -> RegionIndex {
        self.index
    }

    /// How many blocks it has.
    pub fn block_count(&self) -> usize {
        self.numbers.len()
    }

    /// Its blocks, in no particular order.
    pub fn blocks(&self) -> impl Iterator<Item = (BlockIndex, &Block)> {
        let blocks = self.slabs.iter().flat_map(|slab| slab.iter());
        let number = |&number| block_of_region(self.index.0, usize::from(number));
        self.numbers.iter().map(number).zip(blocks)
    }

    /// Adds a block.
    ///
    /// # Errors
    /// [`MapError`], as [`VoxelMap::insert_block`] has it; also if the block is none of the region's.
    pub fn insert(&mut self, index: BlockIndex, block: &Block) -> Result<(), MapError> {
        check_block(index, block)?;
        let (region, number) = in_region(index);
        if region != self.index.0 {
            return Err(MapError::Outside { block: index });
        }
        let number = number as u16;
        if self.numbers.contains(&number) {
            return Err(MapError::Occupied { block: index });
        }
        let at = self.numbers.len();
        if at.is_multiple_of(SLAB_BLOCKS) {
            self.slabs.push(self.pool.slab()?);
        }
        self.numbers.push(number);
        self.slabs[at / SLAB_BLOCKS][at % SLAB_BLOCKS].clone_from(block);
        Ok(())
    }
}

impl Drop for RegionBlocks {
    fn drop(&mut self) {
        self.pool.give_back(self.slabs.drain(..));
    }
}

impl VoxelMap {
    /// Where regions that are put into this map have their memory.
    pub fn pool(&self) -> BlockPool {
        BlockPool(Arc::clone(&self.pool))
    }

    /// Takes a region out of the map, if it holds blocks; their memory goes along.
    pub fn take_region(&mut self, index: RegionIndex) -> Option<RegionBlocks> {
        let shard = &mut self.shards[shard_of_region(index.0)];
        let number = shard.numbers.remove(&index.0)?;
        let region = shard.regions.swap_remove(number as usize);
        if let Some(moved) = shard.regions.get(number as usize) {
            shard.numbers.insert(moved.index, number);
        }
        let mut there: Vec<(u32, u16)> = region.there().map(|(number, slot)| (slot, number as u16)).collect();
        // Slabs in any order; within each, its blocks in theirs, the one that is not full last.
        there.sort_unstable_by_key(|&(slot, _)| (is_in_last_slab(&region, slot), slot));
        let firsts = there
            .iter()
            .map(|(slot, _)| *slot)
            .filter(|slot| (*slot as usize).is_multiple_of(SLAB_BLOCKS));
        let slabs = firsts.filter_map(|first| shard.blocks.take(first)).collect();
        (region.blocks > 0).then(|| RegionBlocks {
            index,
            numbers: there.into_iter().map(|(_, number)| number).collect(),
            slabs,
            pool: Arc::clone(&self.pool),
        })
    }

    /// Puts in a region that was taken out, or made with this map's pool.
    ///
    /// # Errors
    /// [`MapError::Occupied`] if the map has blocks there; it is as before then.
    pub fn put_region(&mut self, mut region: RegionBlocks) -> Result<(), MapError> {
        let RegionIndex(index) = region.index;
        let shard = &mut self.shards[shard_of_region(index)];
        let number = shard.number_or_insert(index)?;
        let known = &mut shard.regions[number];
        if let Some((number, _)) = known.there().next() {
            let block = block_of_region(index, number);
            return Err(MapError::Occupied { block });
        }
        let firsts: Vec<u32> = region.slabs.drain(..).map(|slab| shard.blocks.put(slab)).collect();
        for (i, &number) in region.numbers.iter().enumerate() {
            let slot = firsts[i / SLAB_BLOCKS] + (i % SLAB_BLOCKS) as u32;
            known.slots[usize::from(number) % REGION_BLOCKS] = slot;
            known.last = slot;
        }
        known.blocks = region.numbers.len() as u32;
        Ok(())
    }
}

impl VoxelMap {
    /// Forgets regions that could have got a block but did not.
    pub fn forget_empty_regions(&mut self) {
        for shard in &mut self.shards {
            shard.regions.retain(|region| region.blocks > 0);
            shard.numbers = (0..).zip(&shard.regions).map(|(n, region)| (region.index, n)).collect();
        }
    }
}

/// Whether a block lies in the slab that takes the region's next one.
fn is_in_last_slab(region: &Region, slot: u32) -> bool {
    region.last != NO_SLOT && slot / SLAB_BLOCKS as u32 == region.last / SLAB_BLOCKS as u32
}
