//! One part of the block table: regions by hash, and the blocks of each.
//!
//! The table is split into [`SHARDS`](crate::index::SHARDS) parts by the spatial hash (5.1). Only one thread at a time touches a
//! part, so there are neither locks nor atomics (see [`crate::fuse`]).

use std::sync::Arc;

use glam::IVec3;
use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;

use super::block::Voxel;
use crate::{
    index::{BLOCK_VOXELS, BlockIndex, REGION_BLOCKS, block_of_region, in_region},
    memory::{Blocks, Near, OutOfMemory, Pool, SLAB_BLOCKS},
};

/// The slot of a block that is not there.
pub(crate) const NO_SLOT: u32 = u32::MAX;

/// One part of the block table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shard {
    /// The number of each region that holds a block, or could have got one.
    pub(super) numbers: HashMap<IVec3, u32, FxBuildHasher>,
    pub(super) regions: Vec<Region>,
    pub(super) blocks: Blocks,
}

/// Where the blocks of a region are: neighbours are found without hashing, and near each other in memory.
#[derive(Clone, Debug)]
pub(super) struct Region {
    pub(super) index: IVec3,
    /// The slots of its blocks, or [`NO_SLOT`].
    pub(super) slots: [u32; REGION_BLOCKS],
    /// How many there are, and the slot of the one that was made last. They lie in slabs that are this region's alone.
    pub(super) blocks: u32,
    pub(super) last: u32,
    /// The integration that updated it last, and a bit for each block that it updated.
    stamp: u32,
    updated: [u64; REGION_BLOCKS / 64],
}

impl Region {
    fn new(index: IVec3) -> Self {
        Self {
            index,
            slots: [NO_SLOT; REGION_BLOCKS],
            blocks: 0,
            last: NO_SLOT,
            stamp: 0,
            updated: [0; REGION_BLOCKS / 64],
        }
    }

    /// The slot of a block, which is made if it is not there.
    #[inline]
    fn slot_or_insert(
        &mut self,
        block: usize,
        push: impl FnOnce() -> Result<u32, OutOfMemory>,
    ) -> Result<u32, OutOfMemory> {
        let slot = &mut self.slots[block];
        if *slot == NO_SLOT {
            self.last = if (self.blocks as usize).is_multiple_of(SLAB_BLOCKS) {
                push()?
            } else {
                self.last + 1
            };
            self.blocks += 1;
            *slot = self.last;
        }
        Ok(*slot)
    }

    /// The slot of a block that is updated now, as [`Self::slot_or_insert`] and [`Self::touch`] do.
    #[inline]
    fn slot_to_update(
        &mut self,
        block: usize,
        touched: &mut Vec<BlockIndex>,
        push: impl FnOnce() -> Result<u32, OutOfMemory>,
    ) -> Result<u32, OutOfMemory> {
        let slot = self.slot_or_insert(block, push)?;
        self.touch(block, touched);
        Ok(slot)
    }

    /// Counts a block among those that are updated; the first time, it is added to `touched`.
    #[inline]
    fn touch(&mut self, block: usize, touched: &mut Vec<BlockIndex>) {
        let (word, bit) = (&mut self.updated[block / 64], 1 << (block % 64));
        if *word & bit == 0 {
            *word |= bit;
            touched.push(block_of_region(self.index, block));
        }
    }

    /// Its blocks: numbers in the region, and slots.
    pub(super) fn there(&self) -> impl Iterator<Item = (usize, u32)> {
        let slots = self.slots.iter().copied().enumerate();
        slots.filter(|(_, slot)| *slot != NO_SLOT)
    }
}

/// A region that is being updated.
pub(crate) struct OpenRegion<'a> {
    region: &'a mut Region,
    near: Near<'a>,
    touched: &'a mut Vec<BlockIndex>,
}

/// Voxels of a region have numbers: that of the block in the region, then that of the voxel in the block (9 bits).
impl OpenRegion<'_> {
    /// Fetches a voxel from memory; its block is made if it is not there.
    #[inline(always)]
    pub(crate) fn fetch(&mut self, place: u32) -> Result<(), OutOfMemory> {
        let (block, voxel) = (
            place as usize / BLOCK_VOXELS % REGION_BLOCKS,
            place as usize % BLOCK_VOXELS,
        );
        if self.near.prefetch(block, voxel) {
            return Ok(());
        }
        self.find(block)
    }

    #[inline(never)]
    fn find(&mut self, block: usize) -> Result<(), OutOfMemory> {
        let slot = self.region.slot_to_update(block, self.touched, || self.near.push())?;
        self.near.insert(block, slot);
        Ok(())
    }

    /// A voxel, if it was fetched.
    #[inline(always)]
    pub(crate) fn voxel(&mut self, place: u32) -> Option<&mut Voxel> {
        self.near
            .voxel(place as usize / BLOCK_VOXELS, place as usize % BLOCK_VOXELS)
    }
}

impl Shard {
    /// An empty one, whose blocks come from a pool.
    pub(super) fn of(pool: &Arc<Pool>) -> Self {
        Self {
            blocks: Blocks::of(pool),
            ..Self::default()
        }
    }

    /// The slot of a block, which is made if it is not there.
    pub(crate) fn slot_or_insert(&mut self, index: BlockIndex) -> Result<u32, OutOfMemory> {
        let (region, block) = in_region(index);
        let number = self.number_or_insert(region)?;
        self.regions[number].slot_or_insert(block, || self.blocks.push())
    }

    /// The number of a region, which is made if it is not there.
    pub(super) fn number_or_insert(&mut self, index: IVec3) -> Result<usize, OutOfMemory> {
        if let Some(&number) = self.numbers.get(&index) {
            return Ok(number as usize);
        }
        let reserved = self.regions.try_reserve(1).is_ok() && self.numbers.try_reserve(1).is_ok();
        if !reserved {
            return Err(self.blocks.exhausted());
        }
        let number = self.regions.len();
        self.regions.push(Region::new(index));
        self.numbers.insert(index, number as u32);
        Ok(number)
    }

    /// The slot of a block, if it is there.
    #[inline]
    pub(super) fn slot(&self, index: BlockIndex) -> Option<u32> {
        let (region, block) = in_region(index);
        let slot = self.region(region)?[block];
        (slot != NO_SLOT).then_some(slot)
    }

    /// The number of a region that integration number `stamp` updates.
    pub(crate) fn region_to_update(&mut self, index: IVec3, stamp: u32) -> Result<usize, OutOfMemory> {
        let number = self.number_or_insert(index)?;
        let region = &mut self.regions[number];
        if region.stamp != stamp {
            region.stamp = stamp;
            region.updated = [0; REGION_BLOCKS / 64];
        }
        Ok(number)
    }

    /// The slot of a block that this integration now updates; the first time, the block is added to `touched`.
    pub(crate) fn slot_to_update(
        &mut self,
        number: usize,
        block: usize,
        touched: &mut Vec<BlockIndex>,
    ) -> Result<u32, OutOfMemory> {
        self.regions[number].slot_to_update(block, touched, || self.blocks.push())
    }

    /// A region that integration number `stamp` updates, for many updates; blocks that it now updates are added to `touched`.
    pub(crate) fn open<'a>(
        &'a mut self,
        index: IVec3,
        stamp: u32,
        touched: &'a mut Vec<BlockIndex>,
    ) -> Result<OpenRegion<'a>, OutOfMemory> {
        let number = self.region_to_update(index, stamp)?;
        Ok(OpenRegion {
            region: &mut self.regions[number],
            near: Near::new(&mut self.blocks),
            touched,
        })
    }

    /// Counts a block among those that integration number `stamp` updated.
    pub(crate) fn mark_updated(&mut self, index: BlockIndex, stamp: u32) {
        let (region, block) = in_region(index);
        if let Some(&number) = self.numbers.get(&region) {
            let region = &mut self.regions[number as usize];
            if region.stamp != stamp {
                (region.stamp, region.updated) = (stamp, [0; REGION_BLOCKS / 64]);
            }
            region.updated[block / 64] |= 1 << (block % 64);
        }
    }

    /// All blocks of some regions: indices, slots, and whether integration number `stamp` updated them.
    pub(crate) fn blocks_of(
        &self,
        stamp: u32,
        is_wanted: impl Fn(IVec3) -> bool,
    ) -> impl Iterator<Item = (BlockIndex, u32, bool)> {
        let regions = self.regions.iter().filter(move |region| is_wanted(region.index));
        regions.flat_map(move |region| {
            region.there().map(move |(number, slot)| {
                let is_updated = region.stamp == stamp && region.updated[number / 64] >> (number % 64) & 1 == 1;
                (block_of_region(region.index, number), slot, is_updated)
            })
        })
    }

    /// The indices of all blocks, in any order.
    pub(crate) fn indices(&self) -> impl Iterator<Item = BlockIndex> {
        let regions = self.regions.iter();
        regions.flat_map(|region| region.there().map(|(number, _)| block_of_region(region.index, number)))
    }

    pub(super) fn block_count(&self) -> usize {
        self.regions.iter().map(|region| region.blocks as usize).sum()
    }

    /// The slots of a region's blocks, or [`NO_SLOT`]; `None` if it never had any.
    #[inline]
    pub(crate) fn region(&self, region: IVec3) -> Option<&[u32; REGION_BLOCKS]> {
        self.numbers.get(&region).map(|&n| &self.regions[n as usize].slots)
    }

    /// All blocks, by slot.
    #[inline]
    pub(crate) fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// All blocks, by slot.
    #[inline]
    pub(crate) fn blocks_mut(&mut self) -> &mut Blocks {
        &mut self.blocks
    }

    /// Limits the weights in one block.
    pub(crate) fn limit_weights(&mut self, slot: u32, max_sum: u32) {
        self.blocks[slot as usize]
            .voxels
            .iter_mut()
            .for_each(|v| v.limit(max_sum));
    }
}
