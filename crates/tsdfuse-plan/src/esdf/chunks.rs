//! Sites and distances by chunks of voxels.

use std::cmp::Ordering;

use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;
use tsdfuse::glam::{IVec2, IVec3};
use tsdfuse::index::BlockIndex;

use super::lattice::{CELLS, Lattice};
use super::sites::Site;

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
    fn exchange(&mut self, mut gone: Vec<LocalSite>, mut new: Vec<LocalSite>) {
        gone.sort_unstable();
        new.sort_unstable();
        let mut gone = gone.into_iter().peekable();
        self.sites.retain(|site| gone.next_if_eq(site).is_none());
        self.sites.extend(new);
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
#[derive(Clone, Debug, Default)]
pub(super) struct Chunks {
    chunks: HashMap<IVec3, Chunk, FxBuildHasher>,
    /// The sites of each of the map's blocks, sorted.
    blocks: HashMap<BlockIndex, Box<[Site]>, FxBuildHasher>,
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

/// What changed of the sites of a block.
pub(super) struct Change {
    block: BlockIndex,
    sites: Box<[Site]>,
    /// With their chunks.
    gone: Vec<(IVec3, LocalSite)>,
    /// With their chunks.
    new: Vec<(IVec3, LocalSite)>,
    /// The first chunk that they reach, and the last.
    reached: [IVec3; 2],
}

impl Change {
    /// `None` if the sites are as before.
    fn of(lattice: &Lattice, block: BlockIndex, before: &[Site], sites: &[Site]) -> Option<Self> {
        if before == sites {
            return None;
        }
        let (mut gone, mut new) = (Vec::new(), Vec::new());
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
                Ordering::Less => gone.extend(left.next().map(&mut local)),
                Ordering::Greater => new.extend(right.next().map(&mut local)),
                Ordering::Equal => {
                    left.next();
                    right.next();
                }
            }
        }
        let reach = IVec2::splat(lattice.reach_cells()).extend(lattice.radius_steps);
        let edge = CHUNK * IVec2::splat(CELLS).extend(lattice.steps);
        Some(Self {
            block,
            sites: sites.into(),
            gone,
            new,
            reached: [(low - reach).div_euclid(edge), (high + reach).div_euclid(edge)],
        })
    }

    /// The chunks within the radius of what changed.
    fn chunks(&self) -> impl Iterator<Item = IVec3> + use<> {
        let [first, last] = self.reached;
        (first.x..=last.x).flat_map(move |x| {
            (first.y..=last.y).flat_map(move |y| (first.z..=last.z).map(move |z| IVec3::new(x, y, z)))
        })
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

    /// What changes if a block has these sites now, which are sorted; `None`: nothing.
    pub(super) fn change(&self, lattice: &Lattice, block: BlockIndex, sites: &[Site]) -> Option<Change> {
        let before = self.blocks.get(&block).map_or(&[][..], |sites| sites);
        Change::of(lattice, block, before, sites)
    }

    /// Changes sites, each block's once. Returns the chunks whose distances can be others now, sorted.
    pub(super) fn put(&mut self, changes: Vec<Change>) -> Vec<IVec3> {
        let mut changed: HashSet<IVec3, FxBuildHasher> = HashSet::default();
        let mut by_chunk: HashMap<IVec3, [Vec<LocalSite>; 2], FxBuildHasher> = HashMap::default();
        // Neighbouring blocks mostly reach the same ones.
        let mut last = None;
        for change in changes {
            if last.replace(change.reached) != Some(change.reached) {
                changed.extend(change.chunks());
            }
            for (sites, which) in [(&change.gone, 0), (&change.new, 1)] {
                // Most of a block's sites lie in one chunk.
                for of_one in sites.chunk_by(|(a, _), (b, _)| a == b) {
                    if let Some((chunk, _)) = of_one.first() {
                        let sites = of_one.iter().map(|(_, site)| *site);
                        by_chunk.entry(*chunk).or_default()[which].extend(sites);
                    }
                }
            }
            if change.sites.is_empty() {
                self.blocks.remove(&change.block)
            } else {
                self.blocks.insert(change.block, change.sites)
            };
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
        let mut changed: Vec<IVec3> = changed.into_iter().collect();
        changed.sort_unstable_by_key(IVec3::to_array);
        changed
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
        self.chunks.values().map(chunk).sum::<usize>() + self.blocks.values().map(|sites| block(sites)).sum::<usize>()
    }
}
