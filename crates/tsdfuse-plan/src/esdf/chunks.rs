//! Sites and distances by chunks of voxels.

use std::collections::BTreeMap;

use hashbrown::{HashMap, HashSet};
use rustc_hash::FxBuildHasher;
use tsdfuse::glam::IVec3;
use tsdfuse::index::BlockIndex;

use super::lattice::{CELLS, Lattice};
use super::sites::Site;

/// Voxels along the edge of a chunk.
pub const CHUNK: i32 = 32;
/// Voxels of a chunk.
pub(super) const VOXELS: usize = (CHUNK * CHUNK * CHUNK) as usize;
/// Stands for a distance beyond the radius.
pub(super) const FAR: i16 = i16::MAX;

/// 32³ voxels.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// The sites that lie in it, by the map's block that they come from.
    sites: BTreeMap<BlockIndex, Vec<Site>>,
    /// Squared distances in steps, x slowest; none where all voxels are beyond the radius.
    squared: Option<Box<[i16]>>,
}

impl Chunk {
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
    /// In which chunks a block has sites.
    homes: HashMap<BlockIndex, Vec<IVec3>, FxBuildHasher>,
}

/// The chunk that holds a site.
fn chunk_of(lattice: &Lattice, site: &Site) -> IVec3 {
    let cells = CHUNK * CELLS;
    let steps = CHUNK * lattice.steps;
    IVec3::new(
        site.x.div_euclid(cells),
        site.y.div_euclid(cells),
        site.z.div_euclid(steps),
    )
}

impl Chunks {
    pub(super) fn get(&self, index: IVec3) -> Option<&Chunk> {
        self.chunks.get(&index)
    }

    /// The sites in a chunk.
    pub(super) fn sites(&self, index: IVec3) -> impl Iterator<Item = &Site> {
        self.chunks
            .get(&index)
            .into_iter()
            .flat_map(|chunk| chunk.sites.values().flatten())
    }

    /// Replaces the sites of blocks. Returns the chunks whose distances can be others now, sorted.
    pub(super) fn put(&mut self, lattice: &Lattice, sampled: Vec<(BlockIndex, Vec<Site>)>) -> Vec<IVec3> {
        let mut changed: HashSet<IVec3, FxBuildHasher> = HashSet::default();
        for (block, mut sites) in sampled {
            // Sites of a chunk are together.
            sites.sort_by_key(|site| chunk_of(lattice, site).to_array());
            let new: Vec<(IVec3, &[Site])> = sites
                .chunk_by(|a, b| chunk_of(lattice, a) == chunk_of(lattice, b))
                .filter_map(|sites| Some((chunk_of(lattice, sites.first()?), sites)))
                .collect();
            let before = self.homes.remove(&block).unwrap_or_default();
            for &home in &before {
                let Some(old) = self.chunks.get_mut(&home).and_then(|chunk| chunk.sites.remove(&block)) else {
                    continue;
                };
                let now = new.iter().find(|(chunk, _)| *chunk == home);
                note_changes(lattice, &old, now.map_or(&[], |(_, sites)| sites), &mut changed);
            }
            for (home, sites) in &new {
                if !before.contains(home) {
                    note_changes(lattice, &[], sites, &mut changed);
                }
                self.chunks
                    .entry(*home)
                    .or_default()
                    .sites
                    .insert(block, sites.to_vec());
            }
            if !new.is_empty() {
                self.homes.insert(block, new.iter().map(|(home, _)| *home).collect());
            }
        }
        let mut changed: Vec<IVec3> = changed.into_iter().collect();
        changed.sort_unstable_by_key(IVec3::to_array);
        changed
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
            let sites: usize = chunk
                .sites
                .values()
                .map(|sites| 64 + size_of_val(sites.as_slice()))
                .sum();
            sites + chunk.squared.as_ref().map_or(0, |squared| size_of_val(&**squared))
        };
        self.chunks.values().map(chunk).sum::<usize>() + self.homes.len() * 64
    }
}

/// Notes the chunks within the radius of sites that are not in both lists.
fn note_changes(lattice: &Lattice, old: &[Site], new: &[Site], changed: &mut HashSet<IVec3, FxBuildHasher>) {
    if old == new {
        return;
    }
    let only = |a: &[Site], b: &[Site]| -> Vec<Site> { a.iter().filter(|site| !b.contains(site)).copied().collect() };
    let differing = [only(old, new), only(new, old)].concat();
    let (cells, steps) = (lattice.reach_cells(), lattice.radius_steps);
    let end = |of: fn(&Site) -> i32, reach: i32| {
        let values = || differing.iter().map(of);
        let low = values().min().map(|low| low - reach);
        low.zip(values().max().map(|high| high + reach))
    };
    let ends = (
        end(|site| site.x, cells),
        end(|site| site.y, cells),
        end(|site| site.z, steps),
    );
    let (Some(x), Some(y), Some(z)) = ends else { return };
    let corner = |x, y, z| chunk_of(lattice, &Site { x, y, z });
    let (low, high) = (corner(x.0, y.0, z.0), corner(x.1, y.1, z.1));
    for x in low.x..=high.x {
        for y in low.y..=high.y {
            changed.extend((low.z..=high.z).map(|z| IVec3::new(x, y, z)));
        }
    }
}
