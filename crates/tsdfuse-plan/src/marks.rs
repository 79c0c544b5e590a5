//! Which voxels the rays of a scan touch.

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::glam::{DVec3, IVec3};

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
    chunks: Vec<(IVec3, ChunkMarks)>,
    /// The chunk that was asked for last.
    last: Option<(IVec3, usize)>,
}

impl Marks {
    /// Marks a ray, whose ends are given in voxels (Amanatides and Woo, "A Fast Voxel Traversal Algorithm", Eurographics 1987).
    pub(crate) fn ray(&mut self, from: DVec3, to: DVec3, hits: bool) {
        let (voxel, last) = (from.floor(), to.floor());
        let (way, left) = (to - from, (last - voxel).as_ivec3());
        let step = left.signum();
        // The share of the ray after which the next voxel begins along each axis, and from there to the one after it.
        let per_voxel = way.abs().recip();
        let ahead = DVec3::select(step.cmpgt(IVec3::ZERO), voxel + 1.0 - from, from - voxel);
        let mut next = DVec3::select(step.cmpeq(IVec3::ZERO), DVec3::INFINITY, ahead * per_voxel);
        let [step_x, step_y, step_z] = [step.x << 12, step.y << 6, step.z];
        let voxel = voxel.as_ivec3();
        let mut index = voxel >> CHUNK.trailing_zeros();
        let mut chunk = self.chunk(index);
        let mut within = Within::new(voxel);
        for _ in 0..left.abs().element_sum() {
            chunk.passed[within.number() / 64] |= 1 << (within.number() % 64);
            // Without branches, which would be guessed wrong half of the time.
            let x = (next.x <= next.y) & (next.x <= next.z);
            let y = !x & (next.y <= next.z);
            let z = !(x | y);
            next.x += if x { per_voxel.x } else { 0.0 };
            next.y += if y { per_voxel.y } else { 0.0 };
            next.z += if z { per_voxel.z } else { 0.0 };
            let by = if x {
                step_x
            } else if y {
                step_y
            } else {
                step_z
            };
            within.0 += by;
            if within.is_outside() {
                within.0 -= by * CHUNK;
                index += IVec3::new(i32::from(x), i32::from(y), i32::from(z)) * step;
                chunk = self.chunk(index);
            }
        }
        let end = last.as_ivec3();
        let (word, bit) = (number(end) / 64, 1 << (number(end) % 64));
        let chunk = self.chunk(end >> CHUNK.trailing_zeros());
        if hits {
            chunk.hit[word] |= bit;
        } else {
            chunk.passed[word] |= bit;
        }
    }

    fn chunk(&mut self, index: IVec3) -> &mut ChunkMarks {
        let place = match self.last {
            Some((last, place)) if last == index => place,
            _ => *self.places.entry(index).or_insert_with(|| {
                let none = [0; WORDS];
                self.chunks.push((
                    index,
                    ChunkMarks {
                        passed: none,
                        hit: none,
                    },
                ));
                self.chunks.len() - 1
            }),
        };
        self.last = Some((index, place));
        &mut self.chunks[place].1
    }

    /// What either has.
    pub(crate) fn merged(mut self, other: Self) -> Self {
        if self.chunks.is_empty() {
            return other;
        }
        for (index, from) in other.chunks {
            let to = self.chunk(index);
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
        self.chunks.into_iter()
    }
}

/// A voxel in its chunk: six bits for each axis, of which the upper two are 01, so that a step out of the chunk changes these.
#[derive(Clone, Copy)]
struct Within(i32);

impl Within {
    const UPPER: i32 = 0b110000_110000_110000;
    const INSIDE: i32 = 0b010000_010000_010000;

    fn new(voxel: IVec3) -> Self {
        let at = voxel & (CHUNK - 1);
        Self(Self::INSIDE | at.x << 12 | at.y << 6 | at.z)
    }

    fn is_outside(self) -> bool {
        self.0 & Self::UPPER != Self::INSIDE
    }

    /// As [`number`].
    fn number(self) -> usize {
        (self.0 >> 4 & 0xf00 | self.0 >> 2 & 0xf0 | self.0 & 0xf) as usize
    }
}
