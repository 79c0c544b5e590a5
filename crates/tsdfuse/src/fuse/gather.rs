//! The engine under methods that look from the voxels: items (pixels, surfels) name blocks, blocks gather updates.
//!
//! ```text
//!   items ─┬─ lane 0 ─▶ bucket per shard: [(block, tag), …]                   pass 1: threads own lanes
//!          └─ lane …
//!   shard 0 ◀─ its bucket of every lane, sorted: block ─▶ its tags ─▶ 512 voxels     pass 2: threads own shards
//! ```
//!
//! The twin of [`super::scatter`] for methods in which many items touch one voxel or one item touches many: what a voxel gets is
//! worked out where it lies, and a block is written once. The same bits on any number of threads: sums are integers, and the
//! tags of a block come in order.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    Integration,
    centers::ROW,
    scatter::{Counts, Skip},
};
use crate::{
    index::{BLOCK_VOXELS, BlockIndex},
    map::{Block, SHARDS, Shard, VoxelMap, fixed, shard_of},
};

/// Pieces of a scan: enough to balance the load of many threads.
const LANES: usize = 32;

/// Buffers of the engine, kept from scan to scan.
#[derive(Debug)]
pub(crate) struct Gather {
    lanes: Vec<Near>,
    /// Per shard: the blocks that items named, sorted.
    named: Vec<Vec<Named>>,
}

impl Default for Gather {
    fn default() -> Self {
        Self {
            lanes: (0..LANES).map(|_| Near::default()).collect(),
            named: vec![Vec::new(); SHARDS],
        }
    }
}

/// A block, and the tag with which it was named.
pub(crate) type Named = (BlockIndex, u32);

/// Which blocks an item may touch: what pass 1 writes to.
#[derive(Debug)]
pub(crate) struct Near {
    buckets: Vec<Vec<Named>>,
    counts: Counts,
}

impl Default for Near {
    fn default() -> Self {
        Self {
            buckets: vec![Vec::new(); SHARDS],
            counts: Counts::default(),
        }
    }
}

impl Near {
    /// Names a block, with what its update wants to know: the number of the item, or always 0. Twice the same counts once.
    #[inline]
    pub(crate) fn block(&mut self, block: BlockIndex, tag: u32) {
        let bucket = &mut self.buckets[shard_of(block)];
        if bucket.last() != Some(&(block, tag)) {
            bucket.push((block, tag));
        }
    }
}

/// The updates of one block in one scan.
#[derive(Debug)]
pub(crate) struct Updates {
    weights: [i32; BLOCK_VOXELS],
    distances: [i32; BLOCK_VOXELS],
    /// A bit for each row, y + 8 z, whose sums may not be 0.
    rows: u64,
}

/// A block's updates are added up for so many names at a time: the sums, of at most 2⁶ updates a name and 2¹⁵ an update, are
/// at most 2²⁹.
const NAMES: usize = 1 << 8;

impl Updates {
    const NONE: Self = Self {
        weights: [0; BLOCK_VOXELS],
        distances: [0; BLOCK_VOXELS],
        rows: 0,
    };

    /// Adds an update to the voxel with number `local`: distance over μ (clamped to ±1) and weight (clamped to 0..=1; too
    /// little is no update).
    #[inline(always)]
    pub(crate) fn add(&mut self, local: usize, distance: f32, weight: f32) {
        let (weight, distance) = fixed(distance, weight);
        self.rows |= 1 << (local / ROW);
        self.weights[local] += weight;
        self.distances[local] += distance;
    }

    /// Adds an update to each of the eight voxels of a row, `row` = y + 8 z, or none where the weight is 0. `update` gets the
    /// voxel's x, 0…7, and returns distance and weight as for [`Updates::add`].
    #[inline(always)]
    pub(crate) fn add_row(&mut self, row: usize, update: impl Fn(f32) -> (f32, f32)) {
        self.rows |= 1 << row;
        let voxels = ROW * row..ROW * (row + 1);
        let sums = self.weights[voxels.clone()].iter_mut().zip(&mut self.distances[voxels]);
        for (x, (weights, distances)) in sums.enumerate() {
            let (distance, weight) = update(x as f32);
            let (weight, distance) = fixed(distance, weight);
            *weights += weight;
            *distances += distance;
        }
    }

    /// The voxels of the rows that may have sums, by rows.
    fn row_ranges(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let mut left = self.rows;
        std::iter::from_fn(move || {
            let row = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (row < 64).then(|| ROW * row..ROW * (row + 1))
        })
    }

    fn clear(&mut self) {
        for row in self.row_ranges() {
            self.weights[row.clone()].fill(0);
            self.distances[row].fill(0);
        }
        self.rows = 0;
    }

    fn is_empty(&self) -> bool {
        self.row_ranges().all(|row| self.weights[row].iter().all(|&w| w == 0))
    }

    /// Adds the sums to a block; whether a voxel's weight is now beyond `limit`.
    fn add_to(&self, block: &mut Block, limit: u32) -> bool {
        let mut over = false;
        for row in self.row_ranges() {
            let sums = self.weights[row.clone()].iter().zip(&self.distances[row.clone()]);
            for (voxel, (&weight, &distance)) in block.voxels[row].iter_mut().zip(sums) {
                voxel.add_sums(weight, distance);
                over |= voxel.weight_sum > limit;
            }
        }
        over
    }
}

impl Gather {
    /// Lets each of `items` items name the blocks it may touch, then updates those blocks, and the blocks of the map that
    /// are `visible` although no item named them.
    ///
    /// `update` is called once per block, with what named it, sorted by tag, on any thread (and again for each further 256
    /// names). It updates a voxel at most 64 times for each name. Blocks are made only if they get an update.
    pub(crate) fn run(
        &mut self,
        map: &mut VoxelMap,
        items: usize,
        near: impl Fn(usize, &mut Near) -> Result<(), Skip> + Sync,
        visible: impl Fn(BlockIndex) -> bool + Sync,
        update: impl Fn(BlockIndex, &[Named], &mut Updates) + Sync,
    ) -> Integration {
        let (stamp, limit) = map.begin_integration();
        self.lanes.par_iter_mut().enumerate().for_each(|(k, lane)| {
            lane.counts = Counts::default();
            lane.buckets.iter_mut().for_each(Vec::clear);
            for i in items * k / LANES..items * (k + 1) / LANES {
                let done = near(i, lane);
                lane.counts.count(done);
            }
        });
        let lanes = &self.lanes;
        let shards = map.shards.par_iter_mut().zip(&mut self.named).enumerate();
        let touched: Vec<Vec<BlockIndex>> = shards
            .map(|(s, (shard, named))| {
                named.clear();
                lanes.iter().for_each(|lane| named.extend(&lane.buckets[s]));
                named.sort_unstable();
                named.dedup();
                update_shard(shard, named, &visible, &update, (stamp, limit))
            })
            .collect();
        let mut done = Integration {
            updated_blocks: touched.concat(),
            ..Default::default()
        };
        self.lanes.iter().for_each(|lane| lane.counts.add_to(&mut done));
        done
    }
}

/// Pass 2 for one shard.
fn update_shard(
    shard: &mut Shard,
    named: &[Named],
    visible: impl Fn(BlockIndex) -> bool,
    update: impl Fn(BlockIndex, &[Named], &mut Updates),
    (stamp, limit): (u32, u32),
) -> Vec<BlockIndex> {
    let mut touched = Vec::new();
    let mut updates = Updates::NONE;
    let mut visit = |shard: &mut Shard, block: BlockIndex, items: &[Named]| {
        updates.clear();
        update(block, items, &mut updates);
        if updates.is_empty() {
            return;
        }
        let slot = shard.slot_or_insert(block);
        if shard.touch(slot, stamp) {
            touched.push(block);
        }
        if updates.add_to(&mut shard.blocks_mut()[slot as usize], limit) {
            shard.limit_weights(slot, limit);
        }
    };
    let seen: Vec<BlockIndex> = shard.indices().iter().copied().filter(|&b| visible(b)).collect();
    for items in named.chunk_by(|a, b| a.0 == b.0) {
        items.chunks(NAMES).for_each(|items| visit(shard, items[0].0, items));
    }
    for block in seen {
        if named.binary_search_by_key(&block, |n| n.0).is_err() {
            visit(shard, block, &[]);
        }
    }
    touched
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{MapConfig, WEIGHT_SCALE};
    use glam::IVec3;

    /// A map after 1000 items updated two blocks; the second one with nothing.
    fn gathered(max_weight: f32, by_row: bool) -> (VoxelMap, Integration) {
        let mut map = VoxelMap::new(MapConfig {
            max_weight,
            ..Default::default()
        })
        .unwrap();
        let [full, empty] = [0, 1].map(|x| BlockIndex(IVec3::new(x, -2, 3)));
        let done = Gather::default().run(
            &mut map,
            1000,
            |i, near| {
                near.block(full, i as u32);
                near.block(empty, i as u32);
                Ok(())
            },
            |_| false,
            |block, names, updates| {
                for &(_, tag) in names {
                    let weight = if block == full { tag as f32 / 1000.0 } else { 0.0 };
                    let update = |x: f32| (x / 4.0 - 1.0, weight);
                    match by_row {
                        true => updates.add_row(5, update),
                        false => (0..8).for_each(|x| {
                            let (distance, weight) = update(x as f32);
                            updates.add(40 + x, distance, weight);
                        }),
                    }
                }
            },
        );
        (map, done)
    }

    #[test]
    fn sums_are_exact_however_many_names_a_block_has() {
        let (map, done) = gathered(1e4, true);
        let block = BlockIndex(IVec3::new(0, -2, 3));
        assert_eq!((done.updated_blocks, map.block_count()), (vec![block], 1));
        for (local, voxel) in map.block(block).unwrap().voxels.iter().enumerate() {
            let (mut weights, mut distances) = (0, 0);
            if (40..48).contains(&local) {
                for tag in 0..1000 {
                    let (weight, distance) = fixed((local - 40) as f32 / 4.0 - 1.0, tag as f32 / 1000.0);
                    (weights, distances) = (weights + weight as u32, distances + distance);
                }
                assert!(weights > 499 * WEIGHT_SCALE);
            }
            assert_eq!((voxel.weight_sum, voxel.distance_sum), (weights, distances));
        }
        assert!(map == gathered(1e4, false).0);
    }

    #[test]
    fn the_weight_is_limited_and_the_distance_kept() {
        let (map, _) = gathered(100.0, true);
        let block = map.block(BlockIndex(IVec3::new(0, -2, 3))).unwrap();
        for (x, voxel) in block.voxels[40..48].iter().enumerate() {
            assert_eq!(voxel.weight(), 100.0);
            assert!((voxel.distance().unwrap() - (x as f32 / 4.0 - 1.0)).abs() < 1e-4);
        }
    }
}
