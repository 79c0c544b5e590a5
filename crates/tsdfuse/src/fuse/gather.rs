//! The engine for everything but thin lines: items (returns, pixels, surfels) name the blocks that they may touch, and each block gathers
//! the updates of the items that named it.
//!
//! ```text
//!   returns ─┬─ piece 0 ─▶ per shard: items, blocks, and names (which block, which item)  pass 1: threads own pieces
//!            └─ piece …
//!   shard 0 ◀─ the items of every piece, by block ─▶ 512 sums ─▶ the block in the map      pass 2: threads own shards
//!   shard …
//! ```
//!
//! Memory access dominates the cost of fusing: a scan updates a million voxels all over a large map. So the updates of a block are
//! summed up in the CPU's first-level cache, and the block in the map is written once, only the rows (cache lines) that changed. A
//! row is also what a vector register holds: methods compute eight voxels at once. What pass 2 needs to know of an item is copied along
//! in streams, since looking it up elsewhere would miss the cache each time.
//!
//! No locks, no atomics, no `unsafe`. The same bits on any number of threads: sums are integers, the items of a block come in
//! order, and blocks are made by the thread that owns their shard.

use std::ops::Range;
use std::time::Instant;

use fearless_simd::{Level, Simd, dispatch, f32x8, i32x8, mask32x8, prelude::*};
use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;

use super::{
    Integration,
    engine::{Counts, PIECES, Skip, fixed_row},
};
use crate::{
    index::{BLOCK_EDGE, BLOCK_VOXELS, BlockIndex, SHARDS, in_region, shard_of},
    map::{Block, OutOfMemory, Shard, VoxelMap, fixed},
};

/// Voxels in a row.
pub(crate) const ROW: usize = BLOCK_EDGE as usize;

/// Rows in a block, numbered y + 8 z.
pub(crate) const ROWS: usize = BLOCK_VOXELS / ROW;

/// The engine that updates blocks from the items that may touch them. Keep it from scan to scan: it keeps its buffers. `T` is what the
/// update of a block wants to know of an item.
///
/// ```
/// use tsdfuse::{VoxelMap, MapConfig, fuse::Gather, glam::IVec3, index::{BlockIndex, local_number}};
/// // Each item adds weight to one voxel.
/// let voxels = [IVec3::new(3, 0, 0), IVec3::new(-1, 9, 2), IVec3::new(3, 0, 0)];
/// let mut map = VoxelMap::new(MapConfig::default())?;
/// let done = Gather::<IVec3>::default().run(
///     &mut map,
///     voxels.len(),
///     |items, near| {
///         for i in items {
///             near.block(BlockIndex::of(voxels[i]), i as u32, voxels[i]);
///             near.count(Ok(()));
///         }
///     },
///     |_| false,
///     |_, items, updates| items.iter().for_each(|&voxel| updates.add(local_number(voxel), -0.5, 1.0)),
/// )?;
/// assert_eq!((done.updated_blocks.len(), done.fused_returns), (2, 3));
/// assert_eq!((map.voxel(voxels[0]).weight(), map.voxel(voxels[0]).distance()), (2.0, Some(-0.5)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Gather<T = ()> {
    /// The vector instructions of this CPU.
    level: Level,
    pieces: Vec<Near<T>>,
    shards: Vec<Named<T>>,
}

impl<T: Item> Default for Gather<T> {
    fn default() -> Self {
        Self::with(Level::new())
    }
}

/// What can be known of an item.
pub trait Item: Copy + Send + Sync {}

impl<T: Copy + Send + Sync> Item for T {}

impl<T: Item> Gather<T> {
    /// With given instructions.
    pub(crate) fn with(level: Level) -> Self {
        Self {
            level,
            pieces: (0..PIECES).map(|_| Near::default()).collect(),
            shards: (0..SHARDS).map(|_| Named::default()).collect(),
        }
    }

    /// The vector instructions of this CPU, for `fearless_simd::dispatch!`.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Lets each of `items` items name the blocks that it may touch, then updates those blocks, and the blocks of the map that
    /// are `visible` although no item named them. It counts as one integration.
    ///
    /// `name` is called for ranges of items, on any thread, and reports what became of each ([`Near::count`]).
    /// `update` is called once per block on any thread, with the items that named the block, in order (and again for each further
    /// 256 items). It must update a voxel at most 64 times for each item, or sums overflow. Blocks are made only if they get an
    /// update.
    ///
    /// # Errors
    /// There is no memory for a block, and a part of the updates is made; or more blocks are named than can have memory.
    pub fn run(
        &mut self,
        map: &mut VoxelMap,
        items: usize,
        name: impl Fn(Range<usize>, &mut Near<T>) + Sync,
        visible: impl Fn(BlockIndex) -> bool + Sync,
        update: impl Fn(BlockIndex, &Items<'_, T>, &mut Updates) + Sync,
    ) -> Result<Integration, OutOfMemory> {
        let start = Instant::now();
        let limit_bytes = map.memory_limit();
        self.pieces.par_iter_mut().enumerate().for_each(|(k, piece)| {
            piece.clear(limit_bytes);
            name(items * k / PIECES..items * (k + 1) / PIECES, piece);
        });
        if self.pieces.iter().any(|piece| piece.is_full) {
            return Err(OutOfMemory::Limit { limit_bytes });
        }
        let (stamp, limit) = map.begin_integration();
        let find_secs = start.elapsed().as_secs_f64();
        let pieces = &self.pieces;
        let level = self.level;
        let shards = map.shards.par_iter_mut().zip(&mut self.shards).enumerate();
        let touched: Result<Vec<Vec<BlockIndex>>, OutOfMemory> = shards
            .map(|(s, (shard, named))| {
                named.collect(pieces.iter().map(|piece| &piece.buckets[s]));
                let writer = Writer { stamp, limit, level };
                writer.update_shard(shard, named, &visible, &update)
            })
            .collect();
        let counts = self.pieces.iter().map(|piece| &piece.counts);
        Ok(Counts::sum(touched?.concat(), find_secs, counts))
    }
}

/// Takes down which blocks the items of one piece of a scan may touch.
#[derive(Debug)]
pub struct Near<T> {
    addresses: HashMap<BlockIndex, Address, FxBuildHasher>,
    /// The addresses of the blocks named last, by the low bits of their indices.
    recent: [(BlockIndex, Address); 64],
    buckets: Vec<Bucket<T>>,
    counts: Counts,
    /// How many blocks may still be named, and whether more should have been.
    room: usize,
    is_full: bool,
}

/// What a piece of a scan says of one shard.
#[derive(Debug)]
struct Bucket<T> {
    /// Each block once, with the number of the item that named it last.
    blocks: Vec<(BlockIndex, u32)>,
    /// Those that named any block.
    items: Vec<T>,
    /// Of the last item.
    tag: Option<u32>,
    /// Number of the block in `blocks`, and of the item in `items`.
    names: Vec<(u32, u32)>,
}

/// Where the names of a block go: shard, and number of the block in its bucket.
#[derive(Clone, Copy, Debug)]
struct Address {
    shard: u32,
    number: u32,
}

/// Of so many bytes of the map's memory limit, one block may be named. That is eight times as many as the map can hold, since not
/// each that is named gets an update, and a quarter of the limit for all the names.
const LIMIT_PER_NAME: usize = size_of::<Block>() / 8;

/// A block that no map holds.
const NOWHERE: BlockIndex = BlockIndex(glam::IVec3::MIN);

const NO_ADDRESS: (BlockIndex, Address) = (NOWHERE, Address { shard: 0, number: 0 });

impl<T> Default for Near<T> {
    fn default() -> Self {
        Self {
            addresses: HashMap::default(),
            recent: [NO_ADDRESS; 64],
            buckets: (0..SHARDS).map(|_| Bucket::new()).collect(),
            counts: Counts::default(),
            room: 0,
            is_full: false,
        }
    }
}

impl<T> Bucket<T> {
    fn new() -> Self {
        Self {
            blocks: Vec::new(),
            items: Vec::new(),
            tag: None,
            names: Vec::new(),
        }
    }
}

impl<T: Item> Near<T> {
    fn clear(&mut self, limit_bytes: usize) {
        (self.room, self.is_full) = (limit_bytes / (PIECES * LIMIT_PER_NAME), false);
        self.addresses.clear();
        self.recent = [NO_ADDRESS; 64];
        for bucket in &mut self.buckets {
            bucket.blocks.clear();
            bucket.items.clear();
            bucket.tag = None;
            bucket.names.clear();
        }
        self.counts = Counts::default();
    }

    /// Counts what became of an item.
    #[inline(always)]
    pub fn count(&mut self, done: Result<(), Skip>) {
        self.counts.count(done);
    }

    /// Names a block that an item may touch. `item` is what the block's update wants to know of it, `tag` its number (or always 0
    /// where items do not matter). Naming a block twice in a row for one item counts once.
    #[inline]
    pub fn block(&mut self, block: BlockIndex, tag: u32, item: T) {
        let low = block.0 & 3;
        let recent = (low.x | low.y << 2 | low.z << 4) as usize;
        if self.recent[recent].0 != block {
            let Some(address) = self.address(block) else { return };
            self.recent[recent] = (block, address);
        }
        let Address { shard, number } = self.recent[recent].1;
        let bucket = &mut self.buckets[shard as usize];
        if bucket.tag != Some(tag) {
            bucket.tag = Some(tag);
            bucket.items.push(item);
        }
        let item = (bucket.items.len() - 1) as u32;
        let last = &mut bucket.blocks[number as usize].1;
        if *last != item {
            *last = item;
            bucket.names.push((number, item));
        }
    }

    /// Whether more blocks were named than can have memory, so that the run will fail and naming more is in vain.
    #[inline]
    pub fn is_full(&self) -> bool {
        self.is_full
    }

    /// `None` if more blocks are named than there can be memory for.
    fn address(&mut self, block: BlockIndex) -> Option<Address> {
        if let Some(&address) = self.addresses.get(&block) {
            return Some(address);
        }
        self.is_full |= self.room == 0;
        self.room = self.room.checked_sub(1)?;
        let shard = shard_of(block);
        let blocks = &mut self.buckets[shard].blocks;
        blocks.push((block, u32::MAX)); // no item: there are fewer
        let address = Address {
            shard: shard as u32,
            number: (blocks.len() - 1) as u32,
        };
        self.addresses.insert(block, address);
        Some(address)
    }
}

/// The names of all pieces for one shard, by block.
#[derive(Debug)]
struct Named<T> {
    blocks: Vec<BlockIndex>,
    numbers: HashMap<BlockIndex, u32, FxBuildHasher>,
    /// For each piece's blocks, one piece after the other: the number in `blocks`.
    numbers_of_pieces: Vec<u32>,
    /// Of all pieces.
    items: Vec<T>,
    /// Where the names of each block end.
    ends: Vec<u32>,
    /// Numbers of items.
    names: Vec<u32>,
}

impl<T> Default for Named<T> {
    fn default() -> Self {
        Self {
            blocks: Vec::new(),
            numbers: HashMap::default(),
            numbers_of_pieces: Vec::new(),
            items: Vec::new(),
            ends: Vec::new(),
            names: Vec::new(),
        }
    }
}

impl<T: Item> Named<T> {
    /// A counting sort: the pieces hold parts of the items one after the other, so that the items of a block come in order.
    fn collect<'a>(&mut self, buckets: impl Iterator<Item = &'a Bucket<T>> + Clone)
    where
        T: 'a,
    {
        self.blocks.clear();
        self.numbers.clear();
        self.numbers_of_pieces.clear();
        self.items.clear();
        self.ends.clear();
        for bucket in buckets.clone() {
            let first = self.numbers_of_pieces.len();
            for &(block, _) in &bucket.blocks {
                let number = *self.numbers.entry(block).or_insert_with(|| {
                    self.blocks.push(block);
                    self.ends.push(0);
                    (self.blocks.len() - 1) as u32
                });
                self.numbers_of_pieces.push(number);
            }
            let numbers = &self.numbers_of_pieces[first..];
            for &(number, _) in &bucket.names {
                self.ends[numbers[number as usize] as usize] += 1;
            }
        }
        let mut sum = 0;
        for end in &mut self.ends {
            (*end, sum) = (sum, sum + *end); // where they start, for now
        }
        self.names.clear();
        self.names.resize(sum as usize, 0);
        let mut first = 0;
        for bucket in buckets {
            let numbers = &self.numbers_of_pieces[first..];
            let first_item = self.items.len() as u32;
            self.items.extend_from_slice(&bucket.items);
            for &(number, item) in &bucket.names {
                let end = &mut self.ends[numbers[number as usize] as usize];
                self.names[*end as usize] = first_item + item;
                *end += 1;
            }
            first += bucket.blocks.len();
        }
    }

    /// Each block with the items that named it, in order.
    fn by_block(&self) -> impl Iterator<Item = (BlockIndex, &[u32])> {
        let mut start = 0;
        self.blocks.iter().zip(&self.ends).map(move |(&block, &end)| {
            let range = std::mem::replace(&mut start, end as usize)..end as usize;
            (block, &self.names[range])
        })
    }
}

/// The items that named a block.
#[derive(Debug)]
pub struct Items<'a, T> {
    items: &'a [T],
    names: &'a [u32],
}

impl<'a, T> Items<'a, T> {
    /// The items, in the order of their numbers.
    #[inline(always)]
    pub fn iter(&self) -> impl Iterator<Item = &'a T> + Clone + use<'a, T> {
        let (items, names) = (self.items, self.names);
        names.iter().map(|&i| &items[i as usize])
    }
}

/// The updates of one block in one scan.
#[derive(Debug)]
pub struct Updates {
    weights: [[i32; ROW]; ROWS],
    distances: [[i32; ROW]; ROWS],
    /// A bit for each row whose sums may not be 0.
    rows: u64,
}

/// A block's updates are added up for so many items at a time: the sums, of at most 2⁶ updates an item and 2¹⁵ an update, are
/// at most 2²⁹.
const AT_ONCE: usize = 1 << 8;

impl Updates {
    const NONE: Self = Self {
        weights: [[0; ROW]; ROWS],
        distances: [[0; ROW]; ROWS],
        rows: 0,
    };

    /// Adds an update to the voxel with number `local` ([`local_number`](crate::index::local_number)): distance over μ (clamped to ±1)
    /// and weight (clamped to 0..=1; less than 1/65536 is no update). Neither may be NaN.
    #[inline(always)]
    pub fn add(&mut self, local: usize, distance: f32, weight: f32) {
        let (weight, distance) = fixed(distance, weight);
        let (row, x) = (local / ROW % ROWS, local % ROW);
        self.rows |= 1 << row;
        self.weights[row][x] += weight;
        self.distances[row][x] += distance;
    }

    /// Adds an update to those of the eight voxels of a row, `row` = y + 8 z, that are `inside`; distances and weights as for
    /// [`Updates::add`], with the same rounding. Those of voxels outside may be NaN.
    #[inline(always)]
    pub fn add_row<S: Simd>(&mut self, row: usize, inside: mask32x8<S>, distance: f32x8<S>, weight: f32x8<S>) {
        let (weight, distance) = fixed_row(distance, weight);
        let row = row % ROWS;
        self.rows |= u64::from(inside.any_true()) << row;
        for (sums, new) in [(&mut self.weights[row], weight), (&mut self.distances[row], distance)] {
            let simd = new.token();
            let new = inside.select(new, i32x8::splat(simd, 0));
            *sums = (i32x8::simd_from(simd, *sums) + new).into();
        }
    }

    /// The rows that may have sums.
    fn used_rows(&self) -> impl Iterator<Item = usize> + use<> {
        let mut left = self.rows;
        std::iter::from_fn(move || {
            let row = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (row < ROWS).then_some(row)
        })
    }

    fn is_empty(&self) -> bool {
        self.used_rows().all(|row| self.weights[row] == [0; ROW])
    }

    /// Adds the sums to a block and forgets them; whether a voxel's weight is now beyond `limit`.
    #[inline(always)]
    fn move_to(&mut self, block: &mut Block, limit: u32) -> bool {
        let mut most = 0;
        for row in self.used_rows() {
            let voxels: Range<usize> = ROW * row..ROW * (row + 1);
            let (weights, distances) = (&mut self.weights[row], &mut self.distances[row]);
            for (x, voxel) in block.voxels[voxels].iter_mut().enumerate() {
                voxel.add_sums(weights[x], distances[x]);
                most = most.max(voxel.weight_sum);
            }
            (*weights, *distances) = ([0; ROW], [0; ROW]);
        }
        self.rows = 0;
        most > limit
    }
}

/// Pass 2.
#[derive(Clone, Copy)]
struct Writer {
    stamp: u32,
    limit: u32,
    level: Level,
}

impl Writer {
    fn update_shard<T: Item>(
        self,
        shard: &mut Shard,
        named: &Named<T>,
        visible: impl Fn(BlockIndex) -> bool,
        update: impl Fn(BlockIndex, &Items<'_, T>, &mut Updates),
    ) -> Result<Vec<BlockIndex>, OutOfMemory> {
        let mut touched = Vec::new();
        let mut updates = Updates::NONE;
        let mut visit = |shard: &mut Shard, block: BlockIndex, names: &[u32]| -> Result<(), OutOfMemory> {
            let items = &named.items;
            update(block, &Items { items, names }, &mut updates);
            if updates.is_empty() {
                updates.rows = 0;
                return Ok(());
            }
            let (region, number) = in_region(block);
            let region = shard.region_to_update(region, self.stamp)?;
            let slot = shard.slot_to_update(region, number, &mut touched)?;
            let block = &mut shard.blocks_mut()[slot as usize];
            if dispatch!(self.level, _ => updates.move_to(block, self.limit)) {
                shard.limit_weights(slot, self.limit);
            }
            Ok(())
        };
        let seen = shard
            .indices()
            .filter(|&b| visible(b) && !named.numbers.contains_key(&b));
        let seen: Vec<BlockIndex> = seen.collect();
        for (block, names) in named.by_block() {
            names.chunks(AT_ONCE).try_for_each(|names| visit(shard, block, names))?;
        }
        seen.into_iter().try_for_each(|block| visit(shard, block, &[]))?;
        Ok(touched)
    }
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
        let mut gather = Gather::default();
        let level = gather.level();
        let done = gather.run(
            &mut map,
            1000,
            |items, near| {
                for i in items {
                    near.block(full, i as u32, i);
                    near.block(empty, i as u32, i);
                    near.count(Ok(()));
                }
            },
            |_| false,
            |block, items, updates| {
                for &tag in items.iter() {
                    let weight = if block == full { tag as f32 / 1000.0 } else { 0.0 };
                    let distances = [0, 1, 2, 3, 4, 5, 6, 7].map(|x| x as f32 / 4.0 - 1.0);
                    if by_row {
                        dispatch!(level, simd => {
                            let all = mask32x8::splat(simd, true);
                            updates.add_row(5, all, f32x8::simd_from(simd, distances), f32x8::splat(simd, weight));
                        });
                    } else {
                        (0..8).for_each(|x| updates.add(40 + x, distances[x], weight));
                    }
                }
            },
        );
        (map, done.unwrap())
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
