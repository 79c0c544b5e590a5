//! Sets of blocks that were updated.

use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;

use super::{
    near::{Near, Place, offset_to},
    neighbourhood::{around, bits_about},
    signs::{Bits, NO_BITS},
};
use crate::{
    index::{BlockIndex, REGION_BLOCKS, block_of_region, in_region, shard_of_region},
    map::{NO_SLOT, VoxelMap},
};

/// A set of blocks: a bit for each one of a region.
pub(super) type Blocks = HashMap<IVec3, Bits, FxBuildHasher>;
const _: () = assert!(REGION_BLOCKS == 8 * 64);

/// Puts a block into a set.
pub(super) fn insert(blocks: &mut Blocks, index: BlockIndex) {
    let (region, number) = in_region(index);
    blocks.entry(region).or_default()[number / 64 % 8][number / 8 % 8] |= 1 << (number % 8);
}

/// A block that was updated, or a neighbour of such.
pub(super) struct Candidate {
    pub(super) index: BlockIndex,
    pub(super) place: Place,
    /// Which of the blocks about it were updated: bits, as numbered in [`super::near::Near`].
    pub(super) updated: u32,
}

/// The blocks of the map that were updated, and their neighbours.
pub(super) fn candidates(map: &VoxelMap, updated: &Blocks) -> Vec<Candidate> {
    let about = updated
        .keys()
        .flat_map(|&region| (0..27).map(move |n| region + offset_to(n)));
    let mut regions: Vec<IVec3> = about.collect();
    regions.sort_unstable_by_key(IVec3::to_array);
    regions.dedup();
    let of_region = |region: IVec3| {
        let shard = shard_of_region(region);
        let slots = map.shards[shard].region(region);
        let near: Near<&Bits> = std::array::from_fn(|n| updated.get(&(region + offset_to(n))));
        let rows = around(|n| near[n].unwrap_or(&NO_BITS));
        let there = slots
            .into_iter()
            .flatten()
            .enumerate()
            .filter(|(_, slot)| **slot != NO_SLOT);
        there.filter_map(move |(number, &slot)| {
            let updated = bits_about(&rows, number);
            (updated != 0).then_some(Candidate {
                index: block_of_region(region, number),
                place: Place {
                    shard: shard as u32,
                    slot,
                },
                updated,
            })
        })
    };
    regions.into_par_iter().flat_map_iter(of_region).collect()
}

/// The slots of those blocks of a region that are there.
pub(super) fn existing(slots: Option<&[u32; REGION_BLOCKS]>, bits: &Bits) -> impl Iterator<Item = usize> {
    let there = slots.into_iter().flatten().enumerate();
    there
        .filter(|&(number, &slot)| bits[number / 64][number / 8 % 8] >> (number % 8) & 1 == 1 && slot != NO_SLOT)
        .map(|(_, &slot)| slot as usize)
}
