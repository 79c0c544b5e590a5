//! Which voxels the rays of a scan touch.

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::glam::{BVec3, DVec3, IVec3};

/// Voxels along the edge of a chunk.
pub(crate) const CHUNK: i32 = 16;
/// Voxels of a chunk.
pub(crate) const VOXELS: usize = (CHUNK * CHUNK * CHUNK) as usize;
const WORDS: usize = VOXELS / 64;

/// The number of a voxel in its chunk.
pub(crate) fn number(voxel: IVec3) -> usize {
    let at = voxel & (CHUNK - 1);
    ((at.x * CHUNK + at.y) * CHUNK + at.z) as usize
}

/// The inverse of [`number`].
pub(crate) fn voxel_of(chunk: IVec3, number: usize) -> IVec3 {
    let number = number as i32;
    chunk * CHUNK + IVec3::new(number / (CHUNK * CHUNK), number / CHUNK % CHUNK, number % CHUNK)
}

/// Calls `visit` with the number of each bit that is set.
pub(crate) fn bits(mut word: u64, mut visit: impl FnMut(usize)) {
    while word != 0 {
        visit(word.trailing_zeros() as usize);
        word &= word - 1;
    }
}

/// Of one chunk: voxels that rays passed through, and in which rays ended.
#[derive(Clone)]
pub(crate) struct ChunkMarks {
    passed: [u64; WORDS],
    hit: [u64; WORDS],
}

impl ChunkMarks {
    /// Passed and hit, 64 voxels each.
    pub(crate) fn words(&self) -> impl Iterator<Item = (u64, u64)> {
        self.passed.iter().copied().zip(self.hit.iter().copied())
    }
}

/// The voxels that rays touch.
#[derive(Default)]
pub(crate) struct Marks {
    places: HashMap<IVec3, usize, FxBuildHasher>,
    chunks: Vec<ChunkMarks>,
    /// The chunk that was asked for last.
    last: Option<(IVec3, usize)>,
}

impl Marks {
    /// Marks a ray, whose ends are given in voxels.
    pub(crate) fn ray(&mut self, from: DVec3, to: DVec3, hits: bool) {
        walk(from, to, |voxel| {
            let number = number(voxel);
            self.chunk(voxel).passed[number / 64] |= 1 << (number % 64);
        });
        let end = to.floor().as_ivec3();
        let (word, bit) = (number(end) / 64, 1 << (number(end) % 64));
        let chunk = self.chunk(end);
        if hits {
            chunk.hit[word] |= bit;
        } else {
            chunk.passed[word] |= bit;
        }
    }

    fn chunk(&mut self, voxel: IVec3) -> &mut ChunkMarks {
        let index = voxel >> CHUNK.trailing_zeros();
        let place = match self.last {
            Some((last, place)) if last == index => place,
            _ => *self.places.entry(index).or_insert_with(|| {
                self.chunks.push(ChunkMarks {
                    passed: [0; WORDS],
                    hit: [0; WORDS],
                });
                self.chunks.len() - 1
            }),
        };
        self.last = Some((index, place));
        &mut self.chunks[place]
    }

    /// What either has.
    pub(crate) fn merged(mut self, other: Self) -> Self {
        if self.chunks.is_empty() {
            return other;
        }
        for (index, place) in other.places {
            let (from, to) = (&other.chunks[place], self.chunk(index * CHUNK));
            to.passed
                .iter_mut()
                .zip(&from.passed)
                .for_each(|(to, from)| *to |= from);
            to.hit.iter_mut().zip(&from.hit).for_each(|(to, from)| *to |= from);
        }
        self
    }

    /// All chunks, in any order.
    pub(crate) fn into_chunks(self) -> impl Iterator<Item = (IVec3, ChunkMarks)> {
        let chunks = self.chunks;
        self.places
            .into_iter()
            .map(move |(index, place)| (index, chunks[place].clone()))
    }
}

/// Visits the voxels along a ray but for the last one (Amanatides and Woo, "A Fast Voxel Traversal Algorithm", Eurographics 1987).
/// Both ends are given in voxels.
pub(crate) fn walk(from: DVec3, to: DVec3, mut visit: impl FnMut(IVec3)) {
    let (mut voxel, last) = (from.floor().as_ivec3(), to.floor().as_ivec3());
    let (way, step) = (to - from, (last - voxel).signum());
    let mut left = (last - voxel).abs();
    // The share of the ray after which the next voxel begins along each axis, and from there to the one after it.
    let per_voxel = way.abs().recip();
    let ahead = DVec3::select(
        step.cmpgt(IVec3::ZERO),
        voxel.as_dvec3() + 1.0 - from,
        from - voxel.as_dvec3(),
    );
    let mut next = ahead * per_voxel;
    let blocked = |left: IVec3| -> BVec3 { left.cmpeq(IVec3::ZERO) };
    while left != IVec3::ZERO {
        visit(voxel);
        let shares = DVec3::select(blocked(left), DVec3::INFINITY, next);
        let axis = if shares.x <= shares.y && shares.x <= shares.z {
            0
        } else if shares.y <= shares.z {
            1
        } else {
            2
        };
        voxel[axis] += step[axis];
        left[axis] -= 1;
        next[axis] += per_voxel[axis];
    }
}
