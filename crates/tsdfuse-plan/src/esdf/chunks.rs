//! Sites and distances by chunks of voxels.

use std::cmp::Ordering;
use std::hash::BuildHasher;

use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;
use tsdfuse::glam::{IVec2, IVec3};
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::mesh::Piece;

use super::lattice::{CELLS, Lattice};
use super::sites::{Sampler, Site};

/// Voxels along the edge of a chunk.
pub const CHUNK: i32 = 32;
/// Voxels of a chunk.
pub(super) const VOXELS: usize = (CHUNK * CHUNK * CHUNK) as usize;
/// Stands for a distance beyond the radius.
pub(super) const FAR: i16 = i16::MAX;

/// A site relative to its chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct LocalSite {
    /// Cells.
    pub(super) x: u8,
    /// Cells.
    pub(super) y: u8,
    /// Steps.
    pub(super) z: u16,
}

/// 32³ voxels.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// The sites that lie in it, sorted. Several of the map's blocks may have the same one.
    sites: Vec<LocalSite>,
    /// Squared distances in steps, x slowest; none where all voxels are beyond the radius.
    squared: Option<Box<[i16]>>,
}

impl Chunk {
    /// Takes sites out, each once, and puts others in.
    fn exchange(&mut self, mut gone: Vec<LocalSite>, new: Vec<LocalSite>) {
        gone.sort_unstable();
        let mut gone = gone.into_iter().peekable();
        self.sites.retain(|site| gone.next_if_eq(site).is_none());
        let kept = self.sites.len();
        self.sites.extend(new);
        self.sites[kept..].sort_unstable();
        // Two sorted runs.
        self.sites.sort();
    }

    /// The squared distance of a voxel of the chunk, steps.
    pub(super) fn squared(&self, voxel: IVec3) -> Option<i16> {
        let at = voxel.rem_euclid(IVec3::splat(CHUNK));
        let squared = *self
            .squared
            .as_ref()?
            .get(((at.x * CHUNK + at.y) * CHUNK + at.z) as usize)?;
        (squared < FAR).then_some(squared)
    }

    /// All voxels within the radius of surface, and their squared distances; `index` is the chunk's.
    pub(super) fn known(&self, index: IVec3) -> impl Iterator<Item = (IVec3, i16)> {
        let all = (0..).zip(self.squared.iter().flatten().copied());
        let voxel = move |at: i32| index * CHUNK + IVec3::new(at / (CHUNK * CHUNK), at / CHUNK % CHUNK, at % CHUNK);
        all.filter(|(_, squared)| *squared < FAR)
            .map(move |(at, squared)| (voxel(at), squared))
    }
}

/// The chunks that there are.
#[derive(Clone, Debug)]
pub(super) struct Chunks {
    chunks: HashMap<IVec3, Chunk, FxBuildHasher>,
    blocks: Vec<Blocks>,
}

/// The sites of each of some of the map's blocks, sorted.
type Blocks = HashMap<BlockIndex, Box<[Site]>, FxBuildHasher>;

/// The map's blocks are shared out among so many tables, which change side by side.
const SHARES: usize = 32;

/// The table of a block: that of all blocks of its region.
fn share_of(block: BlockIndex) -> usize {
    FxBuildHasher.hash_one(RegionIndex::of(block)) as usize % SHARES
}

/// The chunk that holds a site, and the site within it.
fn localize(lattice: &Lattice, site: &Site) -> (IVec3, LocalSite) {
    let (cells, steps) = (CHUNK * CELLS, CHUNK * lattice.steps);
    let chunk = IVec3::new(
        site.x.div_euclid(cells),
        site.y.div_euclid(cells),
        site.z.div_euclid(steps),
    );
    let local = LocalSite {
        x: site.x.rem_euclid(cells) as u8,
        y: site.y.rem_euclid(cells) as u8,
        z: site.z.rem_euclid(steps) as u16,
    };
    (chunk, local)
}

/// What changed of the sites of some blocks.
#[derive(Debug, Default)]
struct Change {
    /// With their chunks.
    gone: Vec<(IVec3, LocalSite)>,
    /// With their chunks.
    new: Vec<(IVec3, LocalSite)>,
    /// The first chunk that the sites of some blocks side by side reach, and the last.
    reached: Vec<[IVec3; 2]>,
}

impl Change {
    /// Adds what changes if a block has these sites now. Both are sorted.
    fn add(&mut self, lattice: &Lattice, before: &[Site], sites: &[Site]) {
        let (mut low, mut high) = (IVec3::MAX, IVec3::MIN);
        let mut local = |site: &Site| {
            let at = IVec3::new(site.x, site.y, site.z);
            (low, high) = (low.min(at), high.max(at));
            localize(lattice, site)
        };
        let (mut left, mut right) = (before.iter().peekable(), sites.iter().peekable());
        while let Some(order) = match (left.peek(), right.peek()) {
            (Some(before), Some(now)) => Some(before.cmp(now)),
            (Some(_), None) => Some(Ordering::Less),
            (None, Some(_)) => Some(Ordering::Greater),
            (None, None) => None,
        } {
            match order {
                Ordering::Less => self.gone.extend(left.next().map(&mut local)),
                Ordering::Greater => self.new.extend(right.next().map(&mut local)),
                Ordering::Equal => {
                    left.next();
                    right.next();
                }
            }
        }
        let reach = IVec2::splat(lattice.reach_cells()).extend(lattice.radius_steps);
        let edge = CHUNK * IVec2::splat(CELLS).extend(lattice.steps);
        let reached = [(low - reach).div_euclid(edge), (high + reach).div_euclid(edge)];
        if self.reached.last() != Some(&reached) {
            self.reached.push(reached);
        }
    }

    /// The chunks within the radius of what changed, some of them more than once.
    fn chunks(&self) -> impl Iterator<Item = IVec3> {
        self.reached.iter().flat_map(|&[first, last]| {
            (first.x..=last.x).flat_map(move |x| {
                (first.y..=last.y).flat_map(move |y| (first.z..=last.z).map(move |z| IVec3::new(x, y, z)))
            })
        })
    }
}

impl Default for Chunks {
    fn default() -> Self {
        Self {
            chunks: HashMap::default(),
            blocks: vec![Blocks::default(); SHARES],
        }
    }
}

impl Chunks {
    pub(super) fn get(&self, index: IVec3) -> Option<&Chunk> {
        self.chunks.get(&index)
    }

    /// The sites in a chunk, sorted.
    pub(super) fn sites(&self, index: IVec3) -> &[LocalSite] {
        self.chunks.get(&index).map_or(&[], |chunk| &chunk.sites)
    }

    /// Takes in pieces, each in place of what its block had before. Returns the chunks whose distances can be others now.
    pub(super) fn take_in<'a>(
        &mut self,
        lattice: &Lattice,
        pieces: impl IntoIterator<Item = Piece<'a>>,
    ) -> HashSet<IVec3, FxBuildHasher> {
        let mut shares: Vec<Vec<Piece<'a>>> = vec![Vec::new(); SHARES];
        for piece in pieces {
            shares[share_of(piece.block)].push(piece);
        }
        let tasks = self.blocks.par_iter_mut().zip(shares);
        let changes = tasks.map_init(Sampler::default, |sampler, (blocks, mut pieces)| {
            // Of several pieces of one block, the last.
            pieces.sort_by_key(|piece| piece.block);
            pieces.dedup_by(|later, kept| {
                let is_same = later.block == kept.block;
                if is_same {
                    *kept = *later;
                }
                is_same
            });
            let mut change = Change::default();
            for piece in pieces {
                let sites = sampler.sites(lattice, &piece);
                let before = blocks.get_mut(&piece.block);
                let known = before.as_ref().map_or(&[][..], |before| before);
                if known == sites {
                    continue;
                }
                change.add(lattice, known, sites);
                match before {
                    _ if sites.is_empty() => drop(blocks.remove(&piece.block)),
                    Some(before) => *before = sites.into(),
                    None => drop(blocks.insert(piece.block, sites.into())),
                }
            }
            change
        });
        let changes: Vec<Change> = changes.collect();
        let mut by_chunk: HashMap<IVec3, [Vec<LocalSite>; 2], FxBuildHasher> = HashMap::default();
        for change in &changes {
            for (sites, which) in [(&change.gone, 0), (&change.new, 1)] {
                // Mostly many that follow each other lie in one chunk.
                for of_one in sites.chunk_by(|(a, _), (b, _)| a == b) {
                    let sites = of_one.iter().map(|(_, site)| *site);
                    by_chunk.entry(of_one[0].0).or_default()[which].extend(sites);
                }
            }
        }
        let taken = by_chunk.into_iter().map(|(index, exchanged)| {
            let chunk = self.chunks.remove(&index).unwrap_or_default();
            (index, chunk, exchanged)
        });
        let taken: Vec<(IVec3, Chunk, [Vec<LocalSite>; 2])> = taken.collect();
        let exchanged = taken.into_par_iter().map(|(index, mut chunk, [gone, new])| {
            chunk.exchange(gone, new);
            (index, chunk)
        });
        let exchanged: Vec<(IVec3, Chunk)> = exchanged.collect();
        self.chunks.extend(exchanged);
        changes.iter().flat_map(Change::chunks).collect()
    }

    /// Takes the memory of a chunk's distances, which are about to be others.
    pub(super) fn take(&mut self, index: IVec3) -> Option<Box<[i16]>> {
        self.chunks.get_mut(&index)?.squared.take()
    }

    /// Puts in distances; `None` for chunks without any.
    pub(super) fn set(&mut self, distances: impl IntoIterator<Item = (IVec3, Option<Box<[i16]>>)>) {
        for (index, squared) in distances {
            if squared.is_some() {
                self.chunks.entry(index).or_default().squared = squared;
            } else if let Some(chunk) = self.chunks.get_mut(&index) {
                chunk.squared = None;
                if chunk.sites.is_empty() {
                    self.chunks.remove(&index);
                }
            }
        }
    }

    /// The chunks with distances, sorted.
    pub(super) fn with_distances(&self) -> Vec<IVec3> {
        let known = self.chunks.iter().filter(|(_, chunk)| chunk.squared.is_some());
        let mut known: Vec<IVec3> = known.map(|(index, _)| *index).collect();
        known.sort_unstable_by_key(IVec3::to_array);
        known
    }

    pub(super) fn have_same_distances(&self, other: &Self) -> bool {
        let indices = self.with_distances();
        let same = |index| self.get(index).map(|chunk| &chunk.squared) == other.get(index).map(|chunk| &chunk.squared);
        indices == other.with_distances() && indices.into_iter().all(same)
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let chunk = |chunk: &Chunk| {
            let squared = chunk.squared.as_ref().map_or(0, |squared| size_of_val(&**squared));
            size_of_val(chunk.sites.as_slice()) + squared
        };
        let block = |sites: &[Site]| size_of::<(BlockIndex, Box<[Site]>)>() + size_of_val(sites);
        let blocks = self.blocks.iter().flat_map(Blocks::values);
        self.chunks.values().map(chunk).sum::<usize>() + blocks.map(|sites| block(sites)).sum::<usize>()
    }
}
