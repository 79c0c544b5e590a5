//! The map: its configuration, its blocks, and how many scans were fused into it.

use std::sync::Arc;

use glam::IVec3;
use rayon::prelude::*;

use super::{
    block::{Block, Voxel},
    config::MapConfig,
    error::{MapError, check_block},
    shard::{NO_SLOT, Region, Shard},
};
use crate::{
    index::{BlockIndex, Grid, RegionIndex, SHARDS, block_of_region, local_number, shard_of, shard_of_region},
    memory::Pool,
};

/// A truncated signed distance field: for each voxel near an observed surface, the signed distance from its centre to that surface,
/// positive on the side that was seen, and how much that was observed (its weight).
///
/// - *Fill it* with an [`Integrator`](crate::Integrator), scan by scan, or voxel by voxel with [`Self::update`].
/// - *Ask it:* [`Self::sample`] and [`Self::sample_all`] for the distance at any point, [`Self::voxels`] and [`Self::blocks`] for
///   all that was observed, [`Self::dense`] for a box as arrays; [`mesh::extract`](crate::mesh::extract) for its surface,
///   [`Renderer`](crate::Renderer) for rays and views.
/// - *Change it:* [`Self::cropped`], [`Self::resampled`], [`Self::transformed`], [`Self::merge`].
///
/// Voxels are stored in blocks of 8³, and blocks only where something was observed; see [`crate::index`] for how they are numbered.
///
/// ```
/// use tsdfuse::map::{MapConfig, VoxelMap};
/// let map = VoxelMap::new(MapConfig { voxel_size_m: 0.05, truncation_m: 0.20, ..Default::default() })?;
/// assert_eq!(map.block_count(), 0);
/// # Ok::<(), tsdfuse::map::MapError>(())
/// ```
#[derive(Clone, Debug)]
pub struct VoxelMap {
    pub(super) config: MapConfig,
    pub(crate) shards: Vec<Shard>,
    pub(super) pool: Arc<Pool>,
    pub(super) integrations: u32,
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
    /// have. [`MapError::OutOfMemory`] if there is no memory for it. The map is as before then.
    pub fn insert_block(&mut self, index: BlockIndex, block: Block) -> Result<(), MapError> {
        check_block(index, &block)?;
        let shard = &mut self.shards[shard_of(index)];
        if shard.slot(index).is_some() {
            return Err(MapError::Occupied { block: index });
        }
        let slot = shard.slot_or_insert(index)?;
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

    /// Bytes that the blocks of this map may take.
    pub fn memory_limit(&self) -> usize {
        self.pool.limit()
    }

    /// Limits the memory for blocks; `usize::MAX` is no limit. Without a call, the limit is three quarters of the memory that the
    /// process can have: of the machine, the container, or `ulimit -v`.
    ///
    /// What needs more ends with an error: [`FuseError::OutOfMemory`](crate::fuse::FuseError::OutOfMemory) or
    /// [`MapError::OutOfMemory`]. Blocks that are there stay. The limit holds for all of the map's [`BlockPool`](super::BlockPool),
    /// so also for regions that are outside of it. It neither counts the table of blocks, which is small beside them, nor does it
    /// apply to making a clone.
    pub fn set_memory_limit(&mut self, bytes: usize) {
        self.pool.set_limit(bytes);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{index::BLOCK_VOXELS, map::block::MAX_WEIGHT_SUM};

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
}
