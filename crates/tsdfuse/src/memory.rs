//! Memory: had in large pages, and asked for before it is needed. The only `unsafe` of this crate.
//!
//! A map of voxels grows by some megabytes with each scan. Had from a usual allocator, each page of 4 KiB of it is a
//! trip to the system's kernel of its own, and an entry of its own in the CPU's table of addresses, which is far too short for
//! hundreds of megabytes that are visited at random. So blocks are taken from chunks that are mapped at once, in pages of
//! 2 MiB where the system has such.

use std::{
    alloc::{Layout, handle_alloc_error},
    fmt,
    ops::{Deref, DerefMut, Index, IndexMut},
    ptr::NonNull,
    sync::{Arc, Mutex, PoisonError},
};

use memmap2::{MmapOptions, MmapRaw};

use crate::map::Block;

/// Tells the CPU that a value will soon be changed, so that it fetches the value's cache line meanwhile. A hint; does nothing on
/// CPUs for which no instruction is known here.
#[allow(unsafe_code)]
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    // SAFETY: the instruction reads and writes nothing and never faults, whatever the address; this one is a reference's.
    #[cfg(target_arch = "x86_64")]
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    // SAFETY: as above; it has no operands but the address and changes no flags and no memory.
    #[cfg(target_arch = "aarch64")]
    unsafe {
        std::arch::asm!("prfm pstl1keep, [{}]", in(reg) std::ptr::from_ref(value), options(nostack, readonly, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = value;
}

/// The blocks of one part of a map, by number. They never move.
#[derive(Debug, Default)]
pub(crate) struct Blocks {
    slabs: Vec<Slab>,
    len: usize,
    pool: Arc<Pool>,
}

impl Blocks {
    /// None yet; memory comes from a pool.
    pub(crate) fn of(pool: &Arc<Pool>) -> Self {
        Self {
            pool: Arc::clone(pool),
            ..Self::default()
        }
    }

    /// How many.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Adds an empty one.
    pub(crate) fn push(&mut self) {
        if self.len == SLAB_BLOCKS * self.slabs.len() {
            self.slabs.push(self.pool.slab());
        }
        self.len += 1;
    }

    /// In order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Block> {
        self.slabs.iter().flat_map(|slab| slab.iter()).take(self.len)
    }

    /// Memory that they take, room for some more included.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.slabs.len() * (size_of::<[Block; SLAB_BLOCKS]>() + size_of::<Slab>())
    }
}

/// Beyond those that there are, up to the next slab, it may give empty ones.
impl Index<usize> for Blocks {
    type Output = Block;

    #[inline(always)]
    fn index(&self, number: usize) -> &Block {
        &self.slabs[number / SLAB_BLOCKS][number % SLAB_BLOCKS]
    }
}

impl IndexMut<usize> for Blocks {
    #[inline(always)]
    fn index_mut(&mut self, number: usize) -> &mut Block {
        &mut self.slabs[number / SLAB_BLOCKS][number % SLAB_BLOCKS]
    }
}

impl Clone for Blocks {
    fn clone(&self) -> Self {
        let copy = |slab: &Slab| {
            let mut new = self.pool.slab();
            new.clone_from_slice(&slab[..]);
            new
        };
        Self {
            slabs: self.slabs.iter().map(copy).collect(),
            len: self.len,
            pool: Arc::clone(&self.pool),
        }
    }
}

/// Blocks that are had at a time: 64 KiB.
const SLAB_BLOCKS: usize = 16;

/// A large page, and the least and the most that is mapped at a time.
const PAGE_BYTES: usize = 2 << 20;
const MAX_CHUNK_BYTES: usize = 64 << 20;

/// Where slabs come from: chunks of memory, each twice as long as the one before.
#[derive(Debug, Default)]
pub(crate) struct Pool(Mutex<Option<Chunk>>);

/// Mapped memory, of which slabs were given away up to `next`.
#[derive(Debug)]
struct Chunk {
    memory: Arc<MmapRaw>,
    next: usize,
    end: usize,
    bytes: usize,
}

impl Pool {
    /// Empty blocks.
    #[allow(unsafe_code)]
    fn slab(&self) -> Slab {
        const BYTES: usize = size_of::<[Block; SLAB_BLOCKS]>();
        // Nothing below can leave a chunk half changed.
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let chunk = match last.take() {
            Some(chunk) if chunk.next + BYTES <= chunk.end => chunk,
            last => Chunk::map(last.map_or(PAGE_BYTES, |last| (2 * last.bytes).min(MAX_CHUNK_BYTES))),
        };
        let (start, memory) = (chunk.next, Arc::clone(&chunk.memory));
        *last = Some(Chunk {
            next: start + BYTES,
            ..chunk
        });
        // SAFETY: the bytes from `start` on are within the mapping, since `end` is and `next` never exceeds it.
        let blocks = unsafe { memory.as_mut_ptr().add(start) };
        Slab {
            // SAFETY: not null, since the system maps nothing there.
            blocks: unsafe { NonNull::new_unchecked(blocks.cast()) },
            _memory: memory,
        }
    }
}

impl Chunk {
    /// Maps new memory, all zero. As with a vector, the program ends if there is none.
    fn map(bytes: usize) -> Self {
        // Some more, so that a large page can start in it; what is not touched costs nothing.
        let len = bytes + PAGE_BYTES;
        let Ok(memory) = MmapOptions::new().len(len).map_anon() else {
            handle_alloc_error(Layout::new::<[Block; SLAB_BLOCKS]>());
        };
        // Only advice: what comes of it is the system's business.
        #[cfg(target_os = "linux")]
        let _ = memory.advise(memmap2::Advice::HugePage);
        let memory = MmapRaw::from(memory);
        let next = memory.as_ptr().align_offset(PAGE_BYTES);
        Self {
            memory: Arc::new(memory),
            next,
            end: next + bytes,
            bytes,
        }
    }
}

/// Blocks side by side, on whole cache lines, empty at first.
struct Slab {
    blocks: NonNull<[Block; SLAB_BLOCKS]>,
    /// Where they are, as long as any of its slabs is left.
    _memory: Arc<MmapRaw>,
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
        // SAFETY: aligned to 64 KiB (chunks begin at a page, and slabs have that size); mapped as long as this slab lives; all bits
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
    use crate::map::Voxel;

    fn marked(voxel: &mut Voxel, mark: usize) {
        voxel.weight_sum = mark as u32;
    }

    #[test]
    fn blocks_are_empty_at_first_and_nobody_elses() {
        let pool = Arc::default();
        let mut parts = [Blocks::of(&pool), Blocks::of(&pool)];
        for number in 0..2500 {
            for (p, part) in parts.iter_mut().enumerate() {
                part.push();
                assert_eq!(std::ptr::from_ref(&part[number]).align_offset(64), 0);
                assert!(part[number].voxels.iter().all(|v| *v == Voxel::default()), "{number}");
                part[number].voxels.iter_mut().for_each(|v| marked(v, 2 * number + p));
            }
        }
        // Those beyond the last one were never given away.
        let copy = parts[0].clone();
        for part in &mut parts {
            part.push();
            assert_eq!(part[2500].voxels[511], Voxel::default());
        }
        for (p, part) in [(0, &parts[0]), (1, &parts[1]), (0, &copy)] {
            let marks = part
                .iter()
                .take(2500)
                .map(|b| [b.voxels[0], b.voxels[511]].map(|v| v.weight_sum as usize));
            assert!(marks.eq((0..2500).map(|number| [2 * number + p; 2])));
        }
        assert_eq!(
            (parts[0].len(), parts[0].iter().count(), copy.len()),
            (2501, 2501, 2500)
        );
    }

    #[test]
    fn memory_outlives_the_pool_and_the_parts_beside_it() {
        let pool = Arc::default();
        let (mut kept, mut dropped) = (Blocks::of(&pool), Blocks::of(&pool));
        for number in 0..100 {
            kept.push();
            dropped.push();
            marked(&mut kept[number].voxels[7], number);
        }
        let last = pool
            .0
            .lock()
            .unwrap()
            .as_ref()
            .map(|chunk| Arc::downgrade(&chunk.memory))
            .unwrap();
        drop((pool, dropped));
        assert!((0..100).all(|n| kept[n].voxels[7].weight_sum as usize == n));
        // And it is given back with the last of them.
        assert!(last.upgrade().is_some());
        drop(kept);
        assert!(last.upgrade().is_none());
    }

    #[test]
    #[should_panic(expected = "out of bounds")]
    fn a_block_that_is_not_there_is_not_given() {
        let _ = Blocks::default()[0];
    }
}
