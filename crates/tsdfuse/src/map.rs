//! The map: voxel blocks in a hash table, each voxel two integer sums.
//!
//! A voxel holds S_w = Σ w and S_f = Σ w·f over all its updates, in fixed point, so that the update rule (3.5)(3.6)
//!
//! ```text
//!   F ← (W·F + Σ w f) / (W + Σ w),     W ← min(W + Σ w, W_max)
//! ```
//!
//! is a pair of integer additions: the same bits in any order, on any number of threads. F = S_f / S_w is derived when read.
//!
//! The table is split into [`SHARDS`] parts by the spatial hash (5.1); a part is only ever touched by one thread at a time,
//! so that there are neither locks nor atomics (see [`crate::fuse`]).

mod crop;
mod merge;
mod region;
mod warp;

use std::sync::Arc;

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;
use serde::{Deserialize, Serialize};

pub use region::{BlockPool, RegionBlocks};

use crate::{
    index::{BLOCK_VOXELS, BlockIndex, Grid, RegionIndex, local_number, round},
    memory::{Blocks, Pool, SLAB_BLOCKS},
};

/// Fixed-point scale of weights and of weighted distances: an update of weight 1 adds 32 768. A weight of 0.01 (a return at
/// 100 m) still adds 328, and moves S_f in steps of 1/328 of the truncation.
pub const WEIGHT_SCALE: u32 = 1 << 15;

/// The largest weight a voxel can hold: 32 768 observations of weight 1, or 800 000 at 25 m. What comes after is averaged as
/// `max_weight` says: F stays a running mean, the weight stays.
pub const MAX_WEIGHT: f32 = (1 << 15) as f32;

const MAX_WEIGHT_SUM: u32 = (MAX_WEIGHT as u32) * WEIGHT_SCALE;
// One update more fits both sums.
const _: () = assert!(MAX_WEIGHT_SUM as u64 + WEIGHT_SCALE as u64 <= i32::MAX as u64);

/// Blocks farther out are refused by [`VoxelMap::insert_block`]: ±107 000 km at 5 cm.
const MAX_BLOCK: u32 = (1 << 28) - 2;

/// Parts of the block table.
pub const SHARDS: usize = 64;

/// Blocks come in regions, cubes of 8³ of them, that lie in one shard: by this many bits of a voxel's coordinates.
pub(crate) const REGION_SHIFT: u32 = 6;

/// Blocks in a region.
pub(crate) const REGION_BLOCKS: usize = 512;

/// Bits of a block's coordinate within its region.
pub(crate) const REGION_BITS: u32 = REGION_SHIFT - 3;

/// Size of voxels and of the band around the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapConfig {
    /// κ, the edge of a voxel.
    pub voxel_size_m: f64,
    /// μ, half the width of the band around the surface in which distances are stored.
    pub truncation_m: f64,
    /// W_max: weights are limited to this, so that the map follows changes. At most [`MAX_WEIGHT`], which is the default.
    pub max_weight: f32,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.05,
            truncation_m: 0.20,
            max_weight: MAX_WEIGHT,
        }
    }
}

/// Why a map cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapError {
    /// A length must be positive and finite.
    #[error("{name} must be a positive length in metres, not {value}")]
    Length {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The band must hold at least one voxel on each side of the surface, and not thousands.
    #[error("the truncation ({truncation_m} m) must be between 1 and 64 voxels ({voxel_size_m} m each)")]
    Truncation {
        /// μ.
        truncation_m: f64,
        /// κ.
        voxel_size_m: f64,
    },
    /// Zero would never remember, more does not fit.
    #[error("max_weight must be above 0 and at most {MAX_WEIGHT}, not {0}")]
    MaxWeight(f32),
    /// A block can be put into a map once.
    #[error("block {:?} is there already", block.0.to_array())]
    Occupied {
        /// Which.
        block: BlockIndex,
    },
    /// Voxels of the block or of its neighbours would have no 32-bit coordinates.
    #[error("block {:?} lies outside of the grid", block.0.to_array())]
    Outside {
        /// Which.
        block: BlockIndex,
    },
    /// The sums are not those of any observations.
    #[error("block {:?}: voxel {number} cannot hold a weight of {} and a distance of {}", block.0.to_array(), voxel.weight_sum, voxel.distance_sum)]
    Voxel {
        /// The voxel's block.
        block: BlockIndex,
        /// Its [`local_number`].
        number: usize,
        /// Its sums.
        voxel: Voxel,
    },
    /// Maps can be put together only if their voxels mean the same.
    #[error("the maps differ in {name}: {a} and {b}")]
    Differ {
        /// The field.
        name: &'static str,
        /// Its value in one map.
        a: f64,
        /// And in the other.
        b: f64,
    },
    /// A box has its lower corner below its upper one.
    #[error("the box from {low} to {high} holds nothing")]
    Box {
        /// The lower corner.
        low: DVec3,
        /// The upper one.
        high: DVec3,
    },
}

impl MapConfig {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`MapError`] names the field and its value.
    pub fn validate(&self) -> Result<(), MapError> {
        for (name, value) in [("voxel_size_m", self.voxel_size_m), ("truncation_m", self.truncation_m)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(MapError::Length { name, value });
            }
        }
        if !(1.0..=64.0).contains(&(self.truncation_m / self.voxel_size_m + 1e-9)) {
            return Err(MapError::Truncation {
                truncation_m: self.truncation_m,
                voxel_size_m: self.voxel_size_m,
            });
        }
        if !(self.max_weight > 0.0 && self.max_weight <= MAX_WEIGHT) {
            return Err(MapError::MaxWeight(self.max_weight));
        }
        Ok(())
    }

    /// Checks that voxels of two maps mean the same.
    ///
    /// # Errors
    /// [`MapError::Differ`] names the first field that differs.
    pub fn check_same(&self, other: &Self) -> Result<(), MapError> {
        let fields = [
            ("voxel_size_m", self.voxel_size_m, other.voxel_size_m),
            ("truncation_m", self.truncation_m, other.truncation_m),
            ("max_weight", self.max_weight.into(), other.max_weight.into()),
        ];
        match fields.into_iter().find(|(_, a, b)| a != b) {
            Some((name, a, b)) => Err(MapError::Differ { name, a, b }),
            None => Ok(()),
        }
    }

    /// The largest weight sum (fixed point, [`WEIGHT_SCALE`]) that a voxel holds: [`Self::max_weight`].
    pub fn max_weight_sum(&self) -> u32 {
        ((f64::from(self.max_weight) * f64::from(WEIGHT_SCALE)).round() as u32).max(1)
    }

    /// μ/κ, the truncation in voxels.
    pub fn truncation_vox(&self) -> f32 {
        (self.truncation_m / self.voxel_size_m) as f32
    }
}

/// One voxel: fixed-point sums of weights and of weighted distances. All zero: never observed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Voxel {
    /// S_w·[`WEIGHT_SCALE`].
    pub weight_sum: u32,
    /// S_f·[`WEIGHT_SCALE`]; its magnitude never exceeds `weight_sum`.
    pub distance_sum: i32,
}

impl Voxel {
    /// W, the accumulated weight.
    #[inline]
    pub fn weight(self) -> f32 {
        self.weight_sum as f32 * (1.0 / WEIGHT_SCALE as f32)
    }

    /// F in [−1, 1]: the distance over the truncation, positive in front of the surface. `None` if never observed.
    #[inline]
    pub fn distance(self) -> Option<f32> {
        (self.weight_sum > 0).then(|| self.distance_sum as f32 / self.weight_sum as f32)
    }

    /// Adds the sums of many updates at once, |distance| ≤ weight ≤ 2²⁹. Neither sum can overflow if the voxel is brought back
    /// below its limit at once ([`Shard::limit_weights`]).
    #[inline]
    pub(crate) fn add_sums(&mut self, weight: i32, distance: i32) {
        self.weight_sum += weight as u32;
        self.distance_sum += distance;
    }

    /// Whether observations can sum up to this.
    fn is_possible(self) -> bool {
        self.weight_sum <= MAX_WEIGHT_SUM && self.distance_sum.unsigned_abs() <= self.weight_sum
    }

    /// Limits the weight to `max_sum` (fixed point), keeping F.
    #[inline]
    pub(crate) fn limit(&mut self, max_sum: u32) {
        if self.weight_sum > max_sum {
            let scaled = i64::from(self.distance_sum) * i64::from(max_sum) / i64::from(self.weight_sum);
            *self = Self {
                weight_sum: max_sum,
                distance_sum: scaled as i32,
            };
        }
    }
}

/// 8×8×8 voxels, in the order of [`local_number`].
#[repr(align(64))]
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// The voxels.
    pub voxels: [Voxel; BLOCK_VOXELS],
}

impl Block {
    /// Never observed.
    pub const EMPTY: Self = Self {
        voxels: [Voxel {
            weight_sum: 0,
            distance_sum: 0,
        }; BLOCK_VOXELS],
    };

    /// Whether any voxel was observed.
    pub fn is_observed(&self) -> bool {
        self.voxels.iter().any(|v| v.weight_sum > 0)
    }
}

/// Of a block that is not there.
pub(crate) const NO_SLOT: u32 = u32::MAX;

/// The region of a block, and the block's number in it.
#[inline(always)]
pub(crate) fn in_region(BlockIndex(b): BlockIndex) -> (IVec3, usize) {
    let within = b & ((1 << REGION_BITS) - 1);
    let number = within.x | within.y << REGION_BITS | within.z << (2 * REGION_BITS);
    (b >> REGION_BITS, number as usize % REGION_BLOCKS)
}

/// The block with a number in a region: the inverse of [`in_region`].
pub(crate) fn block_of_region(region: IVec3, number: usize) -> BlockIndex {
    let n = number as i32;
    let within = IVec3::new(n, n >> REGION_BITS, n >> (2 * REGION_BITS)) & ((1 << REGION_BITS) - 1);
    BlockIndex((region << REGION_BITS) + within)
}

/// One part of the block table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shard {
    /// The number of each region that holds a block, or could have got one.
    numbers: HashMap<IVec3, u32, FxBuildHasher>,
    regions: Vec<Region>,
    blocks: Blocks,
}

/// Where the blocks of a region are: neighbours are found without hashing, and near each other in memory.
#[derive(Clone, Debug)]
struct Region {
    index: IVec3,
    /// The slots of its blocks, or [`NO_SLOT`].
    slots: [u32; REGION_BLOCKS],
    /// How many there are, and the slot of the one that was made last. They lie in slabs that are this region's alone.
    blocks: u32,
    last: u32,
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
    fn slot_or_insert(&mut self, block: usize, blocks: &mut Blocks) -> u32 {
        let slot = &mut self.slots[block];
        if *slot == NO_SLOT {
            self.last = match (self.blocks as usize).is_multiple_of(SLAB_BLOCKS) {
                true => blocks.push(),
                false => self.last + 1,
            };
            self.blocks += 1;
            *slot = self.last;
        }
        *slot
    }

    /// Its blocks: numbers in the region, and slots.
    fn there(&self) -> impl Iterator<Item = (usize, u32)> {
        let slots = self.slots.iter().copied().enumerate();
        slots.filter(|(_, slot)| *slot != NO_SLOT)
    }
}

impl Shard {
    /// An empty one, whose blocks come from a pool.
    fn of(pool: &Arc<Pool>) -> Self {
        Self {
            blocks: Blocks::of(pool),
            ..Self::default()
        }
    }

    /// The slot of a block, which is made if it is not there.
    pub(crate) fn slot_or_insert(&mut self, index: BlockIndex) -> u32 {
        let (region, block) = in_region(index);
        let number = self.number_or_insert(region);
        self.regions[number].slot_or_insert(block, &mut self.blocks)
    }

    /// The number of a region, which is made if it is not there.
    fn number_or_insert(&mut self, index: IVec3) -> usize {
        *self.numbers.entry(index).or_insert_with(|| {
            self.regions.push(Region::new(index));
            (self.regions.len() - 1) as u32
        }) as usize
    }

    /// The slot of a block, if it is there.
    #[inline]
    fn slot(&self, index: BlockIndex) -> Option<u32> {
        let (region, block) = in_region(index);
        let slot = self.region(region)?[block];
        (slot != NO_SLOT).then_some(slot)
    }

    /// The number of a region that integration number `stamp` updates.
    pub(crate) fn region_to_update(&mut self, index: IVec3, stamp: u32) -> usize {
        let number = self.number_or_insert(index);
        let region = &mut self.regions[number];
        if region.stamp != stamp {
            region.stamp = stamp;
            region.updated = [0; REGION_BLOCKS / 64];
        }
        number
    }

    /// The slot of a block that this integration now updates; the first time, the block is added to `touched`.
    pub(crate) fn slot_to_update(&mut self, number: usize, block: usize, touched: &mut Vec<BlockIndex>) -> u32 {
        let region = &mut self.regions[number];
        let slot = region.slot_or_insert(block, &mut self.blocks);
        let (word, bit) = (&mut region.updated[block / 64], 1 << (block % 64));
        if *word & bit == 0 {
            *word |= bit;
            touched.push(block_of_region(region.index, block));
        }
        slot
    }

    /// Visits all blocks of some regions, and tells of each whether integration number `stamp` updated it.
    pub(crate) fn for_each_block_mut(
        &mut self,
        stamp: u32,
        is_wanted: impl Fn(IVec3) -> bool,
        mut visit: impl FnMut(BlockIndex, bool, &mut Block),
    ) {
        for region in self.regions.iter().filter(|region| is_wanted(region.index)) {
            for (number, slot) in region.there() {
                let updated = region.stamp == stamp && region.updated[number / 64] >> (number % 64) & 1 == 1;
                visit(
                    block_of_region(region.index, number),
                    updated,
                    &mut self.blocks[slot as usize],
                );
            }
        }
    }

    /// The indices of all blocks, in any order.
    pub(crate) fn indices(&self) -> impl Iterator<Item = BlockIndex> {
        let regions = self.regions.iter();
        regions.flat_map(|region| region.there().map(|(number, _)| block_of_region(region.index, number)))
    }

    fn block_count(&self) -> usize {
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

/// A truncated signed distance field in voxel blocks.
///
/// ```
/// use tsdfuse::map::{MapConfig, VoxelMap};
/// let map = VoxelMap::new(MapConfig { voxel_size_m: 0.05, truncation_m: 0.20, ..Default::default() })?;
/// assert_eq!(map.block_count(), 0);
/// # Ok::<(), tsdfuse::map::MapError>(())
/// ```
#[derive(Clone, Debug)]
pub struct VoxelMap {
    config: MapConfig,
    pub(crate) shards: Vec<Shard>,
    pool: Arc<Pool>,
    integrations: u32,
}

impl VoxelMap {
    /// An empty map.
    ///
    /// # Errors
    /// [`MapError`] if the configuration makes no sense.
    pub fn new(config: MapConfig) -> Result<Self, MapError> {
        config.validate()?;
        let pool = Arc::default();
        Ok(Self {
            config,
            shards: (0..SHARDS).map(|_| Shard::of(&pool)).collect(),
            pool,
            integrations: 0,
        })
    }

    /// Puts in a block that was made elsewhere: read from a file, for instance.
    ///
    /// # Errors
    /// [`MapError`] names the block if it is there already, lies outside of the grid, or holds sums that no observations
    /// have; the map is as before then.
    pub fn insert_block(&mut self, index: BlockIndex, block: Block) -> Result<(), MapError> {
        check_block(index, &block)?;
        let shard = &mut self.shards[shard_of(index)];
        if shard.slot(index).is_some() {
            return Err(MapError::Occupied { block: index });
        }
        let slot = shard.slot_or_insert(index);
        shard.blocks[slot as usize] = block;
        Ok(())
    }

    /// Numbers the integration that begins, and tells it the limit of weights in fixed point.
    pub(crate) fn begin_integration(&mut self) -> (u32, u32) {
        self.integrations = self.integrations.wrapping_add(1).max(1);
        (self.integrations, self.config.max_weight_sum())
    }

    /// How many scans (or images made of scans) were fused so far. Methods that do something once in so many scans go by
    /// it, so that a map that is continued elsewhere must take it along.
    pub fn integrations(&self) -> u32 {
        self.integrations
    }

    /// Continues to count integrations from this number.
    pub fn set_integrations(&mut self, integrations: u32) {
        self.integrations = integrations;
    }

    /// What the map was made with.
    pub fn config(&self) -> &MapConfig {
        &self.config
    }

    /// The voxel grid.
    pub fn grid(&self) -> Grid {
        Grid::new(self.config.voxel_size_m)
    }

    /// The block with this index, if any of its voxels was ever observed.
    #[inline]
    pub fn block(&self, index: BlockIndex) -> Option<&Block> {
        let shard = &self.shards[shard_of(index)];
        shard.slot(index).map(|slot| &shard.blocks[slot as usize])
    }

    /// The voxel with this index; the empty voxel where nothing was observed.
    pub fn voxel(&self, voxel: IVec3) -> Voxel {
        self.block(BlockIndex::of(voxel))
            .map_or_else(Voxel::default, |b| b.voxels[local_number(voxel)])
    }

    /// The indices of all blocks, sorted.
    pub fn block_indices(&self) -> Vec<BlockIndex> {
        let mut all: Vec<_> = self.shards.iter().flat_map(Shard::indices).collect();
        all.par_sort_unstable();
        all
    }

    /// The regions that hold blocks, sorted.
    pub fn regions(&self) -> Vec<RegionIndex> {
        let all = self.shards.iter().flat_map(|s| &s.regions);
        let mut all: Vec<_> = all.filter(|r| r.blocks > 0).map(|r| RegionIndex(r.index)).collect();
        all.par_sort_unstable();
        all
    }

    /// The blocks of a region, sorted.
    pub fn blocks_of(&self, RegionIndex(region): RegionIndex) -> impl Iterator<Item = (BlockIndex, &Block)> {
        let shard = &self.shards[shard_of_region(region)];
        let slots = (0..).zip(shard.region(region).into_iter().flatten());
        slots
            .filter(|(_, slot)| **slot != NO_SLOT)
            .map(move |(number, &slot)| (block_of_region(region, number), &shard.blocks[slot as usize]))
    }

    /// How many blocks hold observations.
    pub fn block_count(&self) -> usize {
        self.shards.iter().map(Shard::block_count).sum()
    }

    /// How many voxels were observed.
    pub fn observed_voxel_count(&self) -> usize {
        let observed = |b: &Block| b.voxels.iter().filter(|v| v.weight_sum > 0).count();
        self.shards
            .par_iter()
            .map(|s| s.blocks.iter().map(observed).sum::<usize>())
            .sum()
    }

    /// Bytes held by blocks and their table.
    pub fn memory_bytes(&self) -> usize {
        let shard = |s: &Shard| {
            let table = s.numbers.allocation_size() + s.regions.len() * size_of::<Region>();
            s.blocks.memory_bytes() + table
        };
        self.shards.iter().map(shard).sum()
    }
}

impl PartialEq for VoxelMap {
    /// The same configuration and the same voxels, bit for bit; the order in which blocks came does not matter.
    fn eq(&self, other: &Self) -> bool {
        let indices = self.block_indices();
        self.config == other.config
            && indices == other.block_indices()
            && indices.par_iter().all(|&i| self.block(i) == other.block(i))
    }
}

/// Whether a block lies within the grid, and observations can sum up to its voxels.
fn check_block(index: BlockIndex, block: &Block) -> Result<(), MapError> {
    if index.0.to_array().iter().any(|i| i.unsigned_abs() > MAX_BLOCK) {
        return Err(MapError::Outside { block: index });
    }
    match block.voxels.iter().enumerate().find(|(_, v)| !v.is_possible()) {
        Some((number, &voxel)) => Err(MapError::Voxel {
            block: index,
            number,
            voxel,
        }),
        None => Ok(()),
    }
}

/// The part of the table that holds a block: the hash of voxel block hashing (5.1), of the region it lies in, so that
/// what touches one block and its neighbours mostly touches one shard.
#[inline]
pub(crate) fn shard_of(BlockIndex(b): BlockIndex) -> usize {
    shard_of_region(b >> REGION_BITS)
}

/// As [`shard_of`], for all blocks of a region.
#[inline]
pub(crate) fn shard_of_region(region: IVec3) -> usize {
    hash(region) as usize % SHARDS
}

/// The hash of (5.1).
#[inline(always)]
pub(crate) fn hash(v: IVec3) -> i32 {
    v.x.wrapping_mul(73_856_093) ^ v.y.wrapping_mul(19_349_669) ^ v.z.wrapping_mul(83_492_791)
}

/// The fixed-point form of an update: weight (clamped to 0..=1; 0 is no update) and weighted distance (clamped to ±1).
#[inline(always)]
pub(crate) fn fixed(distance: f32, weight: f32) -> (i32, i32) {
    let weight = round(weight.clamp(0.0, 1.0) * WEIGHT_SCALE as f32);
    (weight, round(distance.clamp(-1.0, 1.0) * weight as f32))
}

/// The smallest weight sum that makes a weight of at least `min_weight`.
pub(crate) fn min_weight_sum(min_weight: f32) -> u32 {
    (min_weight.max(0.0) * WEIGHT_SCALE as f32).ceil() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_without_sense_are_refused() {
        let with = |f: fn(&mut MapConfig)| {
            let mut c = MapConfig::default();
            f(&mut c);
            VoxelMap::new(c).err().map(|e| e.to_string())
        };
        assert_eq!(with(|_| ()), None);
        assert!(with(|c| c.voxel_size_m = 0.0).unwrap().contains("voxel_size_m"));
        assert!(with(|c| c.truncation_m = f64::NAN).unwrap().contains("truncation_m"));
        assert!(
            with(|c| c.truncation_m = 0.01)
                .unwrap()
                .contains("between 1 and 64 voxels")
        );
        assert!(with(|c| c.max_weight = 1e9).unwrap().contains("max_weight"));
    }

    #[test]
    fn blocks_are_put_in_once_and_only_with_sums_that_observations_have() {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let with = |weight_sum, distance_sum| {
            let mut block = Block {
                voxels: [Voxel::default(); BLOCK_VOXELS],
            };
            block.voxels[77] = Voxel {
                weight_sum,
                distance_sum,
            };
            block
        };
        let at = |x| BlockIndex(IVec3::new(x, -2, 3));
        for (x, block) in [(0, with(MAX_WEIGHT_SUM, -(MAX_WEIGHT_SUM as i32))), (1, with(5, 5))] {
            map.insert_block(at(x), block.clone()).unwrap();
            assert_eq!(map.block(at(x)), Some(&block));
        }
        let whole = map.clone();
        let mut refused = |x, block| map.insert_block(at(x), block).unwrap_err().to_string();
        assert_eq!(refused(1, with(1, 0)), "block [1, -2, 3] is there already");
        assert_eq!(
            refused(i32::MIN, with(1, 0)),
            "block [-2147483648, -2, 3] lies outside of the grid"
        );
        for (weight, distance) in [
            (0, 1),
            (5, 6),
            (5, -6),
            (5, i32::MIN),
            (MAX_WEIGHT_SUM + 1, 0),
            (u32::MAX, 0),
        ] {
            let told = refused(2, with(weight, distance));
            assert!(
                told.starts_with("block [2, -2, 3]: voxel 77 cannot hold a weight of "),
                "{told}"
            );
        }
        assert_eq!((map.block_count(), &map), (2, &whole));
    }

    #[test]
    fn observations_beyond_the_limit_keep_a_running_mean() {
        let mut v = Voxel::default();
        let add = |v: &mut Voxel, weight: u32, distance: i32| {
            v.add_sums(weight as i32, distance);
            v.limit(MAX_WEIGHT_SUM);
        };
        let (near, far) = (WEIGHT_SCALE as i32 / 4, WEIGHT_SCALE as i32 / 2);
        for i in 0..300_000 {
            add(&mut v, WEIGHT_SCALE, if i % 2 == 0 { near } else { far });
        }
        assert_eq!(v.weight(), MAX_WEIGHT);
        assert!((v.distance().unwrap() - 0.375).abs() < 1e-3, "{v:?}");
        // A small weight still moves a full voxel.
        let before = v.distance_sum;
        (0..1000).for_each(|_| add(&mut v, WEIGHT_SCALE / 100, -(WEIGHT_SCALE as i32) / 100));
        assert!(v.distance_sum < before);
    }

    #[test]
    fn limiting_the_weight_keeps_the_distance() {
        let mut v = Voxel {
            weight_sum: 3_000_000,
            distance_sum: -1_500_000,
        };
        v.limit(1000);
        assert_eq!(
            v,
            Voxel {
                weight_sum: 1000,
                distance_sum: -500
            }
        );
        v.limit(2000);
        assert_eq!(v.weight_sum, 1000);
    }
}
