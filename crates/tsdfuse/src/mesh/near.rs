//! Finding a block's neighbours, and keeping something beside each block.

use glam::IVec3;
use rayon::prelude::*;

use crate::{
    index::{BlockIndex, REGION_BITS, REGION_BLOCKS, SHARDS, in_region, shard_of_region},
    map::{Block, NO_SLOT, Shard, VoxelMap},
};

/// Something for a block and each of its neighbours; the neighbour at offset (x, y, z) − 1 has number x + 3y + 9z.
pub(crate) type Near<T> = [Option<T>; 27];

/// The number in [`Near`] of the block itself.
pub(crate) const OWN: usize = 13;

/// The numbers in [`Near`] of the blocks that hold the corners of a block's cells: the block itself, and those after it along one
/// axis or more, as corners are numbered in [`super::cube`].
pub(crate) const CORNERS: [usize; 8] = [13, 14, 16, 17, 22, 23, 25, 26];

/// From a block to the one with this number in [`Near`].
#[inline(always)]
pub(crate) fn offset_to(number: usize) -> IVec3 {
    let n = number as i32;
    IVec3::new(n % 3, n / 3 % 3, n / 9) - 1
}

/// Where a block is in the map. It stays there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) shard: u32,
    pub(crate) slot: u32,
}

impl Place {
    /// The block that is there.
    #[inline(always)]
    pub(crate) fn block(self, map: &VoxelMap) -> &Block {
        &map.shards[self.shard as usize].blocks()[self.slot as usize]
    }
}

/// Finds blocks and their neighbours, without hashing as long as those asked for lie in one region of the map.
pub(crate) struct Finder<'a> {
    map: &'a VoxelMap,
    region: Option<IVec3>,
    /// The shards of that region and of those about it, and the slots of their blocks.
    regions: Near<(u32, &'a [u32; REGION_BLOCKS])>,
}

impl<'a> Finder<'a> {
    pub(crate) fn new(map: &'a VoxelMap) -> Self {
        Self {
            map,
            region: None,
            regions: [None; 27],
        }
    }

    /// Where a block and its neighbours are.
    #[inline]
    pub(crate) fn near(&mut self, index: BlockIndex) -> Near<Place> {
        let (region, _) = in_region(index);
        if self.region != Some(region) {
            self.region = Some(region);
            for (n, known) in self.regions.iter_mut().enumerate() {
                let region = region + offset_to(n);
                let shard = shard_of_region(region);
                *known = self.map.shards[shard].region(region).map(|slots| (shard as u32, slots));
            }
        }
        // From the first block of the first of the 27 regions.
        let first = index.0 - ((region - 1) << REGION_BITS) - 1;
        let mut near = [None; 27];
        for (n, place) in near.iter_mut().enumerate() {
            let block = first + offset_to(n) + 1;
            let (at, number) = in_region(BlockIndex(block));
            if let Some((shard, slots)) = self.regions[(at.x + 3 * at.y + 9 * at.z) as usize % 27] {
                let slot = slots[number];
                *place = (slot != NO_SLOT).then_some(Place { shard, slot });
            }
        }
        near
    }
}

/// A value for each block of a map.
#[derive(Clone, Debug)]
pub(crate) struct PerBlock<T> {
    /// By shard and slot.
    pub(crate) shards: Vec<Vec<T>>,
}

impl<T: Send + Default> PerBlock<T> {
    /// Computes it for all blocks of a map.
    pub(crate) fn of_all(map: &VoxelMap, of: impl Fn(&Block) -> T + Sync) -> Self {
        let shard = |shard: &Shard| {
            let slots = (0..shard.blocks().len()).into_par_iter();
            slots
                .map(|slot| shard.blocks().get(slot).map(&of).unwrap_or_default())
                .collect()
        };
        Self {
            shards: map.shards.par_iter().map(shard).collect(),
        }
    }
}

impl<T: Clone> PerBlock<T> {
    /// Makes room for blocks that were added to the map.
    pub(crate) fn grow(&mut self, map: &VoxelMap, value: &T) {
        for (values, shard) in self.shards.iter_mut().zip(&map.shards) {
            values.resize(shard.blocks().len(), value.clone());
        }
    }
}

impl<T> Default for PerBlock<T> {
    fn default() -> Self {
        Self {
            shards: (0..SHARDS).map(|_| Vec::new()).collect(),
        }
    }
}

impl<T> PerBlock<T> {
    /// Memory used, in bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.shards.iter().map(|s| s.capacity() * size_of::<T>()).sum()
    }

    /// Maps each value.
    pub(crate) fn map<U>(&self, of: impl Fn(&T) -> U) -> PerBlock<U> {
        PerBlock {
            shards: self.shards.iter().map(|s| s.iter().map(&of).collect()).collect(),
        }
    }

    #[inline(always)]
    pub(crate) fn get(&self, Place { shard, slot }: Place) -> Option<&T> {
        self.shards[shard as usize].get(slot as usize)
    }

    #[inline(always)]
    pub(crate) fn get_mut(&mut self, Place { shard, slot }: Place) -> Option<&mut T> {
        self.shards[shard as usize].get_mut(slot as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_those_of_the_map() {
        let mut map = VoxelMap::new(crate::MapConfig::default()).unwrap();
        // A cube over the borders of eight regions, with every fifth block missing.
        let cube = || -5..=4;
        let all = cube().flat_map(|z| cube().flat_map(move |y| cube().map(move |x| BlockIndex(IVec3::new(x, y, z)))));
        let all: Vec<BlockIndex> = all.collect();
        for &index in all.iter().filter(|b| b.0.dot(IVec3::new(1, 2, 3)) % 5 != 0) {
            map.shards[crate::index::shard_of(index)].slot_or_insert(index).unwrap();
        }
        let mut finder = Finder::new(&map);
        let mut seen = [0; 2];
        for index in all {
            for (n, place) in finder.near(index).into_iter().enumerate() {
                let expected = map.block(BlockIndex(index.0 + offset_to(n)));
                assert!(match (place, expected) {
                    (Some(place), Some(block)) => std::ptr::eq(place.block(&map), block),
                    (None, None) => true,
                    _ => false,
                });
                seen[usize::from(place.is_some())] += 1;
            }
        }
        assert!(seen.iter().all(|&n| n > 5000), "{seen:?}");
    }
}
