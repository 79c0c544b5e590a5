//! Block storage in 2 MiB pages, and prefetching. The only `unsafe` of this crate.
//!
//! A map grows by some megabytes with each scan. From a usual allocator, each page of 4 KiB of it would cost a page fault, and an
//! entry in the CPU's address cache (TLB), which is far too small for hundreds of megabytes that are visited at random. So blocks
//! come from chunks that are mapped at once, in pages of 2 MiB where the system has them.
//!
//! Memory is limited ([`Pool::set_limit`]). Where a map asks for more, or the system has no more, it gets [`OutOfMemory`].

mod limit;

use std::{
    alloc::{Layout, handle_alloc_error},
    fmt,
    ops::{Deref, DerefMut, Index, IndexMut},
    ptr::NonNull,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use hashbrown::HashMap;
use memmap2::{MmapOptions, MmapRaw};
use rustc_hash::FxBuildHasher;

use crate::{
    index::BLOCK_VOXELS,
    map::block::{Block, Voxel},
};
pub use limit::OutOfMemory;
use limit::default_limit;

/// Tells the CPU to fetch the cache line of a value that will soon be changed. Only a hint: it does nothing on CPUs for which no
/// instruction is known here.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    prefetch_at(std::ptr::from_ref(value));
}

#[allow(unsafe_code)]
#[inline(always)]
fn prefetch_at<T>(value: *const T) {
    // SAFETY: the instruction reads and writes nothing and never faults, whatever the address.
    #[cfg(target_arch = "x86_64")]
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(value.cast());
    }
    // SAFETY: as above; the address is its only operand, and it changes neither flags nor memory.
    #[cfg(target_arch = "aarch64")]
    unsafe {
        std::arch::asm!("prfm pstl1keep, [{}]", in(reg) value, options(nostack, readonly, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = value;
}

/// Where some values lie that will soon be looked at, and may change until then.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hint<T>(*const T);

impl<T> Hint<T> {
    pub(crate) fn of(values: &[T]) -> Self {
        Self(values.as_ptr())
    }

    /// Prefetches one of them.
    #[inline(always)]
    pub(crate) fn prefetch(self, number: usize) {
        prefetch_at(self.0.wrapping_add(number));
    }
}

/// The blocks of one part of a map, by number. Blocks never move; whole slabs of them can be taken out and put in.
#[derive(Debug, Default)]
pub(crate) struct Blocks {
    /// `None` where a slab was taken out.
    slabs: Vec<Option<Slab>>,
    /// The places of those.
    free: Vec<u32>,
    pool: Arc<Pool>,
}

impl Blocks {
    /// No blocks yet; memory will come from `pool`.
    pub(crate) fn of(pool: &Arc<Pool>) -> Self {
        Self {
            slabs: Vec::new(),
            free: Vec::new(),
            pool: Arc::clone(pool),
        }
    }

    /// All numbers are below this.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        SLAB_BLOCKS * self.slabs.len()
    }

    /// Adds a slab of empty blocks and returns the number of the first.
    pub(crate) fn push(&mut self) -> Result<u32, OutOfMemory> {
        let slab = self.pool.slab()?;
        Ok(self.put(slab))
    }

    /// Adds a slab and returns the number of its first block.
    pub(crate) fn put(&mut self, slab: Slab) -> u32 {
        let number = self.free.pop().unwrap_or_else(|| {
            self.slabs.push(None);
            (self.slabs.len() - 1) as u32
        });
        self.slabs[number as usize] = Some(slab);
        SLAB_BLOCKS as u32 * number
    }

    /// Takes out the slab that begins with a block, if it is there.
    pub(crate) fn take(&mut self, first: u32) -> Option<Slab> {
        let number = first / SLAB_BLOCKS as u32;
        let slab = self.slabs.get_mut(number as usize)?.take()?;
        self.free.push(number);
        Some(slab)
    }

    /// The block with a number; `None` where its slab was taken out.
    #[inline]
    pub(crate) fn get(&self, number: usize) -> Option<&Block> {
        let slab = self.slabs.get(number / SLAB_BLOCKS)?.as_ref()?;
        Some(&slab[number % SLAB_BLOCKS])
    }

    /// All blocks, also those of a slab that nobody asked for yet.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Block> {
        self.slabs.iter().flatten().flat_map(|slab| slab.iter())
    }

    /// Bytes of memory that the blocks take, with the room for more in the last slabs.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.slab_count() * SLAB_BYTES + self.slabs.len() * size_of::<Slab>()
    }

    /// The error of a map that gets no memory for its tables.
    pub(crate) fn exhausted(&self) -> OutOfMemory {
        let map_bytes = self.pool.lock().used;
        OutOfMemory::System { map_bytes }
    }

    fn slab_count(&self) -> usize {
        self.slabs.len() - self.free.len()
    }
}

/// Indexing into a slab that was taken out is a mistake of the caller.
#[cold]
#[inline(never)]
fn taken_out(number: usize) -> ! {
    unreachable!("block {number} is in a slab that was taken out")
}

impl Index<usize> for Blocks {
    type Output = Block;

    #[inline(always)]
    fn index(&self, number: usize) -> &Block {
        match &self.slabs[number / SLAB_BLOCKS] {
            Some(slab) => &slab[number % SLAB_BLOCKS],
            None => taken_out(number),
        }
    }
}

impl IndexMut<usize> for Blocks {
    #[inline(always)]
    fn index_mut(&mut self, number: usize) -> &mut Block {
        match &mut self.slabs[number / SLAB_BLOCKS] {
            Some(slab) => &mut slab[number % SLAB_BLOCKS],
            None => taken_out(number),
        }
    }
}

impl Clone for Blocks {
    /// The limit does not apply to a copy. As with a vector, the program ends if there is no memory for it.
    fn clone(&self) -> Self {
        let copy = |slab: &Slab| {
            let Ok(mut new) = self.pool.slab_within(usize::MAX) else {
                handle_alloc_error(Layout::new::<[Block; SLAB_BLOCKS]>());
            };
            new.clone_from_slice(&slab[..]);
            new
        };
        Self {
            slabs: self.slabs.iter().map(|slab| slab.as_ref().map(copy)).collect(),
            free: self.free.clone(),
            pool: Arc::clone(&self.pool),
        }
    }
}

impl Drop for Blocks {
    fn drop(&mut self) {
        self.pool.lock().release(self.slab_count());
    }
}

/// Some of the blocks, under numbers of one's own: where they are is looked up once.
#[derive(Debug)]
pub(crate) struct Near<'a> {
    blocks: &'a mut Blocks,
    /// Null where no block is known.
    known: [*mut Block; NEAR],
}

/// Numbers are below this.
pub(crate) const NEAR: usize = 512;

impl<'a> Near<'a> {
    /// None yet.
    pub(crate) fn new(blocks: &'a mut Blocks) -> Self {
        Self {
            blocks,
            known: [std::ptr::null_mut(); NEAR],
        }
    }

    /// [`Blocks::push`].
    pub(crate) fn push(&mut self) -> Result<u32, OutOfMemory> {
        self.blocks.push()
    }

    /// Gives a block a number.
    pub(crate) fn insert(&mut self, number: usize, slot: u32) {
        let slot = slot as usize;
        let slab = self.blocks.slabs.get(slot / SLAB_BLOCKS).and_then(Option::as_ref);
        self.known[number % NEAR] = slab.map_or(std::ptr::null_mut(), |slab| {
            let first: *mut Block = slab.blocks.as_ptr().cast();
            first.wrapping_add(slot % SLAB_BLOCKS)
        });
    }

    /// Prefetches a voxel; false if the block is not known.
    #[inline(always)]
    pub(crate) fn prefetch(&self, number: usize, voxel: usize) -> bool {
        let block = self.known[number % NEAR];
        prefetch_at(block.cast::<Voxel>().wrapping_add(voxel % BLOCK_VOXELS));
        !block.is_null()
    }

    /// A voxel; `None` if the block is not known.
    #[allow(unsafe_code)]
    #[inline(always)]
    pub(crate) fn voxel(&mut self, number: usize, voxel: usize) -> Option<&mut Voxel> {
        // SAFETY: null or a block of `blocks`: those do not move, and no slab is taken out or reached in another way as long as this borrows them.
        let block = unsafe { self.known[number % NEAR].as_mut() };
        block.map(|block| &mut block.voxels[voxel % BLOCK_VOXELS])
    }
}

/// Blocks in a slab: 32 KiB, all of one region of a map.
pub(crate) const SLAB_BLOCKS: usize = 8;
const SLAB_BYTES: usize = size_of::<[Block; SLAB_BLOCKS]>();

/// Bytes of memory that a region's blocks take, with the room for more in the last slab.
pub(crate) fn slabs_bytes(blocks: usize) -> usize {
    blocks.div_ceil(SLAB_BLOCKS) * (SLAB_BYTES + size_of::<Slab>())
}

/// A large page, which is the first chunk, and the largest chunk.
const PAGE_BYTES: usize = 2 << 20;
const MAX_CHUNK_BYTES: usize = 64 << 20;

/// Where slabs come from: chunks of memory, each twice as long as the one before, and slabs that are no longer needed.
#[derive(Debug, Default)]
pub(crate) struct Pool(Mutex<Stock>);

#[derive(Debug)]
struct Stock {
    last: Option<Chunk>,
    /// Slabs to be used again, and how many there were when it was last checked whether they make up whole chunks.
    free: Vec<Slab>,
    kept: usize,
    /// Bytes of the slabs in use, and how many they may be.
    used: usize,
    limit: usize,
}

impl Default for Stock {
    fn default() -> Self {
        Self {
            last: None,
            free: Vec::new(),
            kept: 0,
            used: 0,
            limit: default_limit(),
        }
    }
}

/// Mapped memory, of which slabs were given away up to `next`.
#[derive(Debug)]
struct Chunk {
    memory: Arc<MmapRaw>,
    next: usize,
    end: usize,
    bytes: usize,
}

impl Pool {
    /// Bytes that slabs in use may take.
    pub(crate) fn limit(&self) -> usize {
        self.lock().limit
    }

    /// Sets [`Self::limit`]. Slabs that are in use stay so.
    pub(crate) fn set_limit(&self, bytes: usize) {
        self.lock().limit = bytes;
    }

    /// A slab of empty blocks.
    pub(crate) fn slab(&self) -> Result<Slab, OutOfMemory> {
        self.slab_within(self.limit())
    }

    fn slab_within(&self, limit_bytes: usize) -> Result<Slab, OutOfMemory> {
        let (mut slab, is_new) = self.lock().slab(limit_bytes)?;
        if !is_new {
            slab.fill(Block::EMPTY);
        }
        Ok(slab)
    }

    /// Takes back slabs. Chunks of which nothing is in use go back to the system.
    pub(crate) fn give_back(&self, slabs: impl IntoIterator<Item = Slab>) {
        let mut stock = self.lock();
        let before = stock.free.len();
        stock.free.extend(slabs);
        let count = stock.free.len() - before;
        stock.release(count);
        if stock.free.len() * SLAB_BYTES >= MAX_CHUNK_BYTES && stock.free.len() >= 2 * stock.kept {
            stock.tidy();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Stock> {
        // Nothing leaves it half changed.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Stock {
    /// A slab, and whether its memory is new: then its blocks are empty.
    fn slab(&mut self, limit_bytes: usize) -> Result<(Slab, bool), OutOfMemory> {
        let used = self.used + SLAB_BYTES;
        if used > limit_bytes {
            return Err(OutOfMemory::Limit { limit_bytes });
        }
        let slab = match self.free.pop() {
            Some(slab) => (slab, false),
            None => (self.new_slab()?, true),
        };
        self.used = used;
        Ok(slab)
    }

    /// Counts slabs as no longer in use.
    fn release(&mut self, slabs: usize) {
        // A region of another map's pool was not counted by this one.
        self.used = self.used.saturating_sub(slabs * SLAB_BYTES);
    }

    #[allow(unsafe_code)]
    fn new_slab(&mut self) -> Result<Slab, OutOfMemory> {
        let mut chunk = match self.last.take() {
            Some(chunk) if chunk.next + SLAB_BYTES <= chunk.end => chunk,
            last => {
                let bytes = last.map_or(PAGE_BYTES, |last| (2 * last.bytes).min(MAX_CHUNK_BYTES));
                Chunk::map(bytes).ok_or(OutOfMemory::System { map_bytes: self.used })?
            }
        };
        let start = chunk.next;
        chunk.next += SLAB_BYTES;
        let memory = Arc::clone(&chunk.memory);
        self.last = Some(chunk);
        // SAFETY: the bytes from `start` on are within the mapping, since `end` is and `next` never exceeds it.
        let blocks = unsafe { memory.as_mut_ptr().add(start) };
        Ok(Slab {
            // SAFETY: not null, since the system maps nothing there.
            blocks: unsafe { NonNull::new_unchecked(blocks.cast()) },
            memory,
        })
    }

    /// Drops the slabs of chunks of which no slab is in use, and so these chunks.
    fn tidy(&mut self) {
        let mut free = HashMap::<_, usize, FxBuildHasher>::default();
        for slab in &self.free {
            *free.entry(Arc::as_ptr(&slab.memory)).or_default() += 1;
        }
        let last = self.last.as_ref().map(|chunk| Arc::as_ptr(&chunk.memory));
        let in_use = |slab: &Slab| {
            let memory = Arc::as_ptr(&slab.memory);
            let known = free.get(&memory).copied().unwrap_or_default() + usize::from(last == Some(memory));
            Arc::strong_count(&slab.memory) > known
        };
        // All are judged before any is dropped, because dropping one changes the count.
        let judged: Vec<bool> = self.free.iter().map(in_use).collect();
        let mut judged = judged.into_iter();
        self.free.retain(|_| judged.next().unwrap_or(true));
        self.kept = self.free.len();
    }
}

impl Chunk {
    /// Maps new memory, all zero; `None` if the system refuses.
    fn map(bytes: usize) -> Option<Self> {
        // Some more, so that a large page can start in it; what is not touched costs nothing.
        let memory = MmapOptions::new().len(bytes + PAGE_BYTES).map_anon().ok()?;
        // Only advice, which the system may ignore.
        #[cfg(target_os = "linux")]
        let _ = memory.advise(memmap2::Advice::HugePage);
        let memory = MmapRaw::from(memory);
        let next = memory.as_ptr().align_offset(PAGE_BYTES);
        Some(Self {
            memory: Arc::new(memory),
            next,
            end: next + bytes,
            bytes,
        })
    }
}

/// Blocks side by side, on whole cache lines, empty at first.
pub(crate) struct Slab {
    blocks: NonNull<[Block; SLAB_BLOCKS]>,
    /// The mapping that they lie in; it lasts as long as any slab of it.
    memory: Arc<MmapRaw>,
}

// SAFETY: a slab owns its blocks as a box would: no other slab has the same ones, and nothing else reaches into the mapping.
#[allow(unsafe_code)]
unsafe impl Send for Slab {}
// SAFETY: as above; shared, it only gives shared references.
#[allow(unsafe_code)]
unsafe impl Sync for Slab {}

impl Deref for Slab {
    type Target = [Block; SLAB_BLOCKS];

    #[allow(unsafe_code)]
    #[inline(always)]
    fn deref(&self) -> &Self::Target {
        // SAFETY: aligned to 32 KiB (chunks begin at a page, and slabs have that size); mapped as long as this slab lives; all bits
        // zero at first, which makes blocks of integers; changed only through `deref_mut`, which borrows this slab alone.
        unsafe { self.blocks.as_ref() }
    }
}

impl DerefMut for Slab {
    #[allow(unsafe_code)]
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut Self::Target {
        // SAFETY: as in `deref`.
        unsafe { self.blocks.as_mut() }
    }
}

impl fmt::Debug for Slab {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SLAB_BLOCKS} blocks")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marked(voxel: &mut Voxel, mark: usize) {
        voxel.weight_sum = mark as u32;
    }

    #[test]
    fn near_blocks_are_those_of_their_slots() {
        let mut blocks = Blocks::of(&Arc::default());
        blocks.push().unwrap();
        let mut near = Near::new(&mut blocks);
        assert!(!near.prefetch(3, 5) && near.voxel(3, 5).is_none());
        let slot = near.push().unwrap() + 6;
        near.insert(3, slot);
        near.insert(4, 7);
        near.insert(5, 1000);
        assert!(near.prefetch(3, 5) && near.prefetch(4, 5) && !near.prefetch(5, 5));
        marked(near.voxel(3, 5).unwrap(), 1);
        marked(near.voxel(4, 511).unwrap(), 2);
        let marks = |number: usize, voxel: usize| blocks[number].voxels[voxel].weight_sum;
        assert_eq!((marks(slot as usize, 5), marks(7, 511)), (1, 2));
        assert_eq!(
            blocks
                .iter()
                .flat_map(|block| block.voxels)
                .filter(|v| v.weight_sum > 0)
                .count(),
            2
        );
    }

    #[test]
    fn blocks_are_empty_at_first_and_nobody_elses() {
        let pool = Arc::default();
        let mut parts = [Blocks::of(&pool), Blocks::of(&pool)];
        for first in (0..2504).step_by(SLAB_BLOCKS) {
            for (p, part) in parts.iter_mut().enumerate() {
                assert_eq!(part.push().unwrap() as usize, first);
                for number in first..first + SLAB_BLOCKS {
                    assert_eq!(std::ptr::from_ref(&part[number]).align_offset(64), 0);
                    assert!(part[number] == Block::EMPTY, "{number}");
                    part[number].voxels.iter_mut().for_each(|v| marked(v, 2 * number + p));
                }
            }
        }
        let copy = parts[0].clone();
        for part in &mut parts {
            part.push().unwrap();
            assert!(part[2504] == Block::EMPTY);
        }
        for (p, part) in [(0, &parts[0]), (1, &parts[1]), (0, &copy)] {
            let marks = part.iter().take(2504).map(marks_of);
            assert!(marks.eq((0..2504).map(|number| [2 * number + p; 2])));
        }
        assert_eq!(
            (parts[0].len(), parts[0].iter().count(), copy.len()),
            (2512, 2512, 2504)
        );
    }

    fn marks_of(block: &Block) -> [usize; 2] {
        [block.voxels[0], block.voxels[511]].map(|v| v.weight_sum as usize)
    }

    #[test]
    fn slabs_go_from_part_to_part_and_their_memory_is_used_again() {
        let pool = Arc::default();
        let (mut one, mut other) = (Blocks::of(&pool), Blocks::of(&pool));
        for slab in 0..10 {
            let first = one.push().unwrap() as usize;
            (first..first + SLAB_BLOCKS).for_each(|n| one[n].voxels.iter_mut().for_each(|v| marked(v, slab)));
        }
        let (all, at) = (one.memory_bytes(), std::ptr::from_ref(&one[24]));
        let taken = one.take(24).unwrap();
        assert!(one.take(24).is_none() && one.take(80).is_none());
        assert_eq!((one.memory_bytes() + SLAB_BYTES, one.get(25)), (all, None));
        assert!(one.get(23) == Some(&one[23]) && one.get(80).is_none());
        // It is the same memory elsewhere,
        assert_eq!((other.put(taken), marks_of(&other[7])), (0, [3; 2]));
        assert_eq!(std::ptr::from_ref(&other[0]), at);
        // and, given back, empty again; its number too is used again.
        pool.give_back(other.take(0));
        assert_eq!(one.push(), Ok(24));
        assert!(std::ptr::eq(&one[24], at) && (24..32).all(|n| one[n] == Block::EMPTY));
        assert!((0..80).filter(|n| n / 8 != 3).all(|n| marks_of(&one[n]) == [n / 8; 2]));
    }

    /// Chunks that memory is mapped for.
    fn chunks(pool: &Pool) -> usize {
        let stock = pool.lock();
        let mut all: Vec<_> = stock.free.iter().map(|slab| Arc::as_ptr(&slab.memory)).collect();
        all.sort_unstable();
        all.dedup();
        all.len()
    }

    #[test]
    fn memory_of_which_nothing_is_used_goes_back_to_the_system() {
        let pool = Arc::default();
        let mut blocks = Blocks::of(&pool);
        // Chunks of 2, 4, … 64 MiB and one more of 64.
        let slabs = (2 * MAX_CHUNK_BYTES - PAGE_BYTES + MAX_CHUNK_BYTES) / SLAB_BYTES;
        let numbers: Vec<u32> = (0..slabs).map(|_| blocks.push().unwrap()).collect();
        let memories: Vec<_> = blocks
            .slabs
            .iter()
            .flatten()
            .map(|s| Arc::downgrade(&s.memory))
            .collect();
        // One slab of the first chunk stays, so that chunk does.
        for &number in &numbers[1..] {
            pool.give_back(blocks.take(number));
        }
        pool.lock().tidy();
        assert_eq!(chunks(&pool), 1);
        assert_eq!(pool.lock().free.len(), PAGE_BYTES / SLAB_BYTES - 1);
        let mapped = memories.iter().filter(|m| m.upgrade().is_some()).count();
        // The last chunk is what comes next.
        assert_eq!(mapped, PAGE_BYTES / SLAB_BYTES + MAX_CHUNK_BYTES / SLAB_BYTES);
        // What is left is used again.
        let last = blocks.push().unwrap();
        assert!(blocks[last as usize] == Block::EMPTY);
        assert_eq!(pool.lock().free.len(), PAGE_BYTES / SLAB_BYTES - 2);
    }

    #[test]
    fn memory_outlives_the_pool_and_the_parts_beside_it() {
        let pool = Arc::default();
        let (mut kept, mut dropped) = (Blocks::of(&pool), Blocks::of(&pool));
        for number in 0..100 {
            kept.push().unwrap();
            dropped.push().unwrap();
            marked(&mut kept[8 * number].voxels[7], number);
        }
        let last = pool.lock().last.as_ref().map(|chunk| Arc::downgrade(&chunk.memory));
        let last = last.unwrap();
        drop((pool, dropped));
        assert!((0..100).all(|n| kept[8 * n].voxels[7].weight_sum as usize == n));
        // And it is given back with the last of them.
        assert!(last.upgrade().is_some());
        drop(kept);
        assert!(last.upgrade().is_none());
    }

    #[test]
    fn a_pool_gives_no_more_than_its_limit() {
        let pool: Arc<Pool> = Arc::default();
        assert_eq!(pool.limit(), default_limit());
        let limit_bytes = 10 * SLAB_BYTES + 1;
        pool.set_limit(limit_bytes);
        let full = Err(OutOfMemory::Limit { limit_bytes });
        let (mut one, mut other) = (Blocks::of(&pool), Blocks::of(&pool));
        (0..6).for_each(|_| _ = one.push().unwrap());
        (0..4).for_each(|_| _ = other.push().unwrap());
        // What fails changes nothing.
        assert_eq!((one.push(), other.push(), one.len(), other.len()), (full, full, 48, 32));
        // What moves to another part stays in use; what is given back or dropped does not.
        let moved = one.take(8).unwrap();
        assert_eq!(one.push(), full);
        other.put(moved);
        assert_eq!(one.push(), full);
        pool.give_back(other.take(0));
        assert_eq!((one.push(), one.push()), (Ok(8), full));
        drop(other);
        (0..4).for_each(|_| _ = one.push().unwrap());
        assert_eq!(one.push(), full);
        // A copy is made beyond the limit, and no longer counts once it is gone.
        drop(one.clone());
        assert_eq!(pool.lock().used, 10 * SLAB_BYTES);
        assert_eq!(
            one.exhausted(),
            OutOfMemory::System {
                map_bytes: 10 * SLAB_BYTES
            }
        );
        drop(one);
        assert_eq!(pool.lock().used, 0);
    }

    #[test]
    #[should_panic(expected = "block 9 is in a slab that was taken out")]
    fn a_block_that_was_taken_out_is_not_given() {
        let mut blocks = Blocks::default();
        (0..2).for_each(|_| _ = blocks.push().unwrap());
        drop(blocks.take(8));
        let _ = &blocks[9];
    }

    #[test]
    #[should_panic(expected = "out of bounds")]
    fn a_block_that_is_not_there_is_not_given() {
        let _ = &Blocks::default()[0];
    }
}
