//! The engine under the methods: items (returns, surfels, pixels) scatter updates over voxels.
//!
//! Two passes, no locks, no atomics, the same bits on any number of threads:
//!
//! ```text
//!   items ─┬─ lane 0 ─▶ bucket per shard: [block, block, …] [update, update, …]     pass 1: threads own lanes
//!          ├─ lane 1 ─▶ …
//!          └─ lane …
//!   shard 0 ◀─ its bucket of every lane                                             pass 2: threads own shards
//!   shard 1 ◀─ …
//! ```
//!
//! Pass 1 runs the method and writes each update as one packed `u64` to the bucket of the shard that holds the voxel's block.
//! A lane names each block once; an update refers to it by number. Pass 2 finds those blocks in the table (or makes them) and
//! adds. Buckets are written and read as streams; the random accesses of pass 2 do not depend on each other, so that the CPU
//! overlaps their cache misses. Sums are integers: their order is of no consequence.

use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;

use super::{Integration, Skipped};
use crate::{
    index::{BlockIndex, local_number},
    map::{SHARDS, Shard, VoxelMap, WEIGHT_SCALE, fixed, shard_of},
};

/// Pieces of a scan: enough to balance the load of many threads.
const LANES: usize = 32;

/// Buffers of the engine, kept from scan to scan.
#[derive(Debug)]
pub(crate) struct Scatter {
    lanes: Vec<Lane>,
}

impl Default for Scatter {
    fn default() -> Self {
        Self {
            lanes: (0..LANES).map(|_| Lane::default()).collect(),
        }
    }
}

impl Scatter {
    /// Lets each of `items` items write its updates, then adds them to the map.
    ///
    /// `method` is called once per item, on any thread; what it returns tells why an item was skipped, if it was.
    pub(crate) fn run(
        &mut self,
        map: &mut VoxelMap,
        items: usize,
        method: impl Fn(usize, &mut Lane) -> Result<(), Skip> + Sync,
    ) -> Integration {
        let (stamp, limit) = map.begin_integration();
        self.lanes.par_iter_mut().enumerate().for_each(|(k, lane)| {
            lane.clear();
            for i in items * k / LANES..items * (k + 1) / LANES {
                let done = method(i, lane);
                lane.counts.count(done);
            }
        });
        let lanes = &self.lanes;
        let touched: Vec<Vec<BlockIndex>> = map
            .shards
            .par_iter_mut()
            .enumerate()
            .map(|(s, shard)| add_to_shard(shard, lanes.iter().map(|lane| &lane.buckets[s]), stamp, limit))
            .collect();
        let mut done = Integration {
            updated_blocks: touched.concat(),
            ..Default::default()
        };
        self.lanes.iter().for_each(|lane| lane.counts.add_to(&mut done));
        done
    }
}

/// Why an item made no update.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Skip {
    OutsideGrid,
    WithoutNormal,
    WithoutWeight,
}

/// What became of the items of one lane.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    fused: u64,
    skipped: Skipped,
}

impl Counts {
    pub(super) fn count(&mut self, done: Result<(), Skip>) {
        match done {
            Ok(()) => self.fused += 1,
            Err(Skip::OutsideGrid) => self.skipped.outside_grid += 1,
            Err(Skip::WithoutNormal) => self.skipped.without_normal += 1,
            Err(Skip::WithoutWeight) => self.skipped.without_weight += 1,
        }
    }

    pub(super) fn add_to(&self, done: &mut Integration) {
        done.skipped += self.skipped;
        done.fused_returns += self.fused;
    }
}

/// Pass 2: adds the updates that all lanes hold for one shard.
fn add_to_shard<'a>(
    shard: &mut Shard,
    buckets: impl Iterator<Item = &'a Bucket>,
    stamp: u32,
    limit: u32,
) -> Vec<BlockIndex> {
    let mut touched = Vec::new();
    let mut slots = Vec::new();
    let mut heavy = Vec::new();
    for bucket in buckets {
        slots.clear();
        for &index in &bucket.blocks {
            let slot = shard.slot_or_insert(index);
            if shard.touch(slot, stamp) {
                touched.push(index);
            }
            slots.push(slot);
        }
        let blocks = shard.blocks_mut();
        for update in &bucket.updates {
            let slot = slots[update.block()];
            let voxel = &mut blocks[slot as usize].voxels[update.voxel()];
            voxel.add(update.weight(), update.distance());
            if voxel.weight_sum > limit && heavy.last() != Some(&slot) {
                heavy.push(slot);
            }
        }
    }
    heavy.sort_unstable();
    heavy.dedup();
    heavy.iter().for_each(|&slot| shard.limit_weights(slot, limit));
    touched
}

/// One update, packed: number of the block in its bucket (22 bits), voxel in the block (9), weight (16), weighted distance (17).
///
/// 2²² blocks in one bucket would be 16 GiB of map touched by a 2048th part of a scan.
#[derive(Clone, Copy, Debug)]
struct Update(u64);

impl Update {
    /// `distance` in [−weight, weight], `weight` in 1..=[`WEIGHT_SCALE`].
    #[inline]
    fn new(block: u32, voxel: usize, weight: u32, distance: i32) -> Self {
        let distance = (distance + WEIGHT_SCALE as i32) as u64;
        Self(u64::from(block) << 42 | (voxel as u64) << 33 | u64::from(weight) << 17 | distance)
    }
    #[inline]
    fn block(self) -> usize {
        (self.0 >> 42) as usize
    }
    #[inline]
    fn voxel(self) -> usize {
        (self.0 >> 33) as usize & 511
    }
    #[inline]
    fn weight(self) -> u32 {
        (self.0 >> 17) as u32 & 0xffff
    }
    #[inline]
    fn distance(self) -> i32 {
        (self.0 & 0x1_ffff) as i32 - WEIGHT_SCALE as i32
    }
}

/// The updates that one lane holds for one shard.
#[derive(Debug, Default)]
struct Bucket {
    blocks: Vec<BlockIndex>,
    updates: Vec<Update>,
}

/// Where a block's updates go: shard (6 bits) and number in that bucket (26 bits).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Address(u32);

impl Address {
    const NONE: Self = Self(u32::MAX);
    fn new(shard: usize, number: usize) -> Self {
        Self((number * SHARDS + shard) as u32)
    }
    #[inline]
    fn shard(self) -> usize {
        self.0 as usize % SHARDS
    }
    #[inline]
    fn number(self) -> u32 {
        self.0 / SHARDS as u32
    }
}

/// Edge, in blocks, of the neighbourhood whose addresses a lane keeps at hand while one item is processed.
const NEAR: i32 = 4;

/// One piece of a scan on its way into the map: what a method writes its updates to.
#[derive(Debug)]
pub(crate) struct Lane {
    addresses: HashMap<BlockIndex, Address, FxBuildHasher>,
    buckets: Vec<Bucket>,
    near_corner: IVec3,
    near: [Address; (NEAR * NEAR * NEAR) as usize],
    counts: Counts,
}

impl Default for Lane {
    fn default() -> Self {
        Self {
            addresses: HashMap::default(),
            buckets: (0..SHARDS).map(|_| Bucket::default()).collect(),
            near_corner: IVec3::ZERO,
            near: [Address::NONE; (NEAR * NEAR * NEAR) as usize],
            counts: Counts::default(),
        }
    }
}

impl Lane {
    fn clear(&mut self) {
        self.addresses.clear();
        for bucket in &mut self.buckets {
            bucket.blocks.clear();
            bucket.updates.clear();
        }
        self.near.fill(Address::NONE);
        self.counts = Counts::default();
    }

    /// Prepares for updates at and above `lowest_voxel`: keeps the addresses of the blocks from there on at hand.
    #[inline]
    pub(crate) fn approach(&mut self, lowest_voxel: IVec3) {
        let corner = BlockIndex::of(lowest_voxel).0;
        if corner != self.near_corner {
            self.near_corner = corner;
            self.near.fill(Address::NONE);
        }
    }

    /// Writes one update: distance over μ (clamped to ±1) and weight (clamped to 0..=1; too little is no update).
    #[inline(always)]
    pub(crate) fn update(&mut self, voxel: IVec3, distance: f32, weight: f32) {
        let (weight, distance) = fixed(distance, weight);
        if weight > 0 {
            let address = self.address(BlockIndex::of(voxel));
            let update = Update::new(address.number(), local_number(voxel), weight as u32, distance);
            self.buckets[address.shard()].updates.push(update);
        }
    }

    #[inline]
    fn address(&mut self, block: BlockIndex) -> Address {
        let d = block.0 - self.near_corner;
        if (d.x | d.y | d.z) as u32 >= NEAR as u32 {
            return self.find(block);
        }
        let near = (d.x + NEAR * (d.y + NEAR * d.z)) as usize;
        if self.near[near] == Address::NONE {
            self.near[near] = self.find(block);
        }
        self.near[near]
    }

    fn find(&mut self, block: BlockIndex) -> Address {
        *self.addresses.entry(block).or_insert_with(|| {
            let shard = shard_of(block);
            let blocks = &mut self.buckets[shard].blocks;
            blocks.push(block);
            Address::new(shard, blocks.len() - 1)
        })
    }
}
