//! Distances to the nearest site: along z, then along y, then along x.
//!
//! ```text
//!   column of chunks ─▶ plane by plane of cells in x: what sites are away along z ─▶ the nearest along y      (Rows)
//!   chunk            ─▶ the nearest along x, among the planes within the radius                                (along_x)
//! ```
//!
//! Chunks share what was found for their neighbours. It is kept layer by layer of chunks, since it needs more memory than the distances.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;
use tsdfuse::glam::{IVec2, IVec3};

use super::chunks::{CHUNK, Chunks, FAR, VOXELS};
use super::lattice::{CELLS, Lattice};

const EDGE: usize = CHUNK as usize;
/// Cells along the edge of a chunk.
const CHUNK_CELLS: i32 = CHUNK * CELLS;
/// Squared distances of voxels along z.
type Column = [i16; EDGE];

/// A chunk and the squared distances of its voxels in steps, x slowest; none where all are beyond the radius.
type Found = (IVec3, Option<Box<[i16]>>);

/// The distances of these chunks, which are sorted, in order of their layers.
pub(super) fn run(lattice: &Lattice, chunks: &Chunks, changed: &[IVec3]) -> Vec<Found> {
    let tables = Tables::new(lattice);
    let mut layers: BTreeMap<i32, Vec<IVec2>> = BTreeMap::new();
    for chunk in changed {
        layers.entry(chunk.z).or_default().push(chunk.truncate());
    }
    layers
        .iter()
        .flat_map(|(z, layer)| tables.layer(chunks, *z, layer))
        .collect()
}

/// Squares that are looked up, and how far sites are seen.
struct Tables {
    lattice: Lattice,
    reach: i32,
    /// Chunks to each side that the radius reaches.
    beside: i32,
    /// The squared distances between a voxel and a cell that is n cells after the first cell within its reach.
    between: Vec<i16>,
    /// For each step that a site is above the bottom of a voxel: the squared distances of voxels to it, from the voxel that is
    /// [`Self::below`] below.
    heights: Vec<Vec<i16>>,
    below: i32,
}

/// What lies along y and z, of all cells in x that are wanted of a chunk.
struct Planes {
    cells: Range<i32>,
    /// Of each of these cells, the columns of the voxels along y; none where no site is near.
    columns: Vec<Option<Box<[Column; EDGE]>>>,
}

impl Tables {
    fn new(lattice: &Lattice) -> Self {
        let (reach, steps) = (lattice.reach_cells(), lattice.steps);
        let between = |n: i32| {
            // From the middle of a cell to the middle of the voxel.
            let steps = (n - reach) * lattice.cell_steps() + lattice.cell_steps() / 2 - lattice.steps / 2;
            i16::try_from(steps * steps).unwrap_or(FAR)
        };
        // Sites up to the radius above and below a chunk are seen by voxels within the radius.
        let below = CHUNK + lattice.radius_steps / steps + 1;
        let height = |phase: i32| {
            let square = |voxel: i32| {
                let apart = (voxel - below) * steps + steps / 2 - phase;
                i16::try_from(apart * apart).unwrap_or(FAR)
            };
            (0..2 * below + 1).map(square).collect()
        };
        Self {
            lattice: *lattice,
            reach,
            beside: (reach - 1) / CHUNK_CELLS + 1,
            between: (0..2 * reach + CELLS).map(between).collect(),
            heights: (0..steps).map(height).collect(),
            below,
        }
    }

    /// The distances of the chunks of a layer, which are sorted.
    fn layer(&self, chunks: &Chunks, z: i32, changed: &[IVec2]) -> Vec<Found> {
        // The cells in x that are needed of each chunk, by columns of chunks along y.
        let mut needed: BTreeMap<i32, BTreeMap<i32, Range<i32>>> = BTreeMap::new();
        for chunk in changed {
            for dx in -self.beside..=self.beside {
                let cells =
                    (-dx * CHUNK_CELLS - self.reach).max(0)..((1 - dx) * CHUNK_CELLS + self.reach).min(CHUNK_CELLS);
                if cells.is_empty() {
                    continue;
                }
                let all = needed
                    .entry(chunk.x + dx)
                    .or_default()
                    .entry(chunk.y)
                    .or_insert(cells.clone());
                *all = all.start.min(cells.start)..all.end.max(cells.end);
            }
        }
        let level = Level::new();
        let columns: Vec<(i32, BTreeMap<i32, Range<i32>>)> = needed.into_iter().collect();
        let planes: BTreeMap<i32, BTreeMap<i32, Planes>> = columns
            .into_par_iter()
            .map(|(x, needed)| (x, dispatch!(level, _ => self.along_y(chunks, [x, z], needed))))
            .collect();
        let distances = |chunk: &IVec2| {
            let squared = dispatch!(level, _ => self.along_x(&planes, *chunk));
            (chunk.extend(z), squared)
        };
        changed.par_iter().map(distances).collect()
    }

    /// The planes of a column of chunks along y.
    #[inline(always)]
    fn along_y(&self, chunks: &Chunks, [x, z]: [i32; 2], needed: BTreeMap<i32, Range<i32>>) -> BTreeMap<i32, Planes> {
        let (Some(&first), Some(&last)) = (needed.keys().next(), needed.keys().next_back()) else {
            return BTreeMap::new();
        };
        let (first, last) = (first - self.beside, last + self.beside);
        let line_cells = ((last - first + 1) * CHUNK_CELLS) as usize;
        let sites = self.sites(chunks, [x, z], first, &needed);
        let mut line = vec![[FAR; EDGE]; line_cells];
        let mut has_sites = vec![false; line_cells];
        let mut planes: BTreeMap<i32, Planes> = needed
            .into_iter()
            .map(|(y, cells)| {
                let columns = Vec::with_capacity(cells.len());
                (y, Planes { cells, columns })
            })
            .collect();
        for (cell, sites) in (0..).zip(&sites) {
            for &(y, height) in sites {
                let at = y as usize;
                if !std::mem::replace(&mut has_sites[at], true) {
                    line[at] = [FAR; EDGE];
                }
                self.drop_site(&mut line[at], height);
            }
            for (y, planes) in &mut planes {
                if planes.cells.contains(&cell) {
                    let begin = ((y - first) * CHUNK_CELLS - self.reach) as usize;
                    planes
                        .columns
                        .push(self.nearest_along_y(&line[begin..], &has_sites[begin..]));
                }
            }
            for (y, _) in sites {
                has_sites[*y as usize] = false;
            }
        }
        planes
    }

    /// The sites of a column of chunks that are seen from a layer: for each cell in x, their cells in y from the chunk `first` on and their
    /// heights in steps above the layer's bottom.
    fn sites(
        &self,
        chunks: &Chunks,
        [x, z]: [i32; 2],
        first: i32,
        needed: &BTreeMap<i32, Range<i32>>,
    ) -> Vec<Vec<(i32, i32)>> {
        let mut sites = vec![Vec::new(); CHUNK_CELLS as usize];
        let bottom = z * CHUNK * self.lattice.steps;
        let radius = self.lattice.radius_steps;
        let seen = -radius..=CHUNK * self.lattice.steps + radius;
        let around = needed.keys().flat_map(|y| y - self.beside..=y + self.beside);
        for y in around.collect::<BTreeSet<i32>>() {
            let above = (-self.beside..=self.beside).map(|dz| IVec3::new(x, y, z + dz));
            for site in above.flat_map(|chunk| chunks.sites(chunk)) {
                let height = site.z - bottom;
                if seen.contains(&height) {
                    sites[site.x.rem_euclid(CHUNK_CELLS) as usize].push((site.y - first * CHUNK_CELLS, height));
                }
            }
        }
        sites
    }

    /// Lets a column of voxels see a site.
    #[inline(always)]
    fn drop_site(&self, column: &mut Column, height: i32) {
        let (voxel, phase) = (
            height.div_euclid(self.lattice.steps),
            height.rem_euclid(self.lattice.steps),
        );
        // Voxel v is v − voxel above the site's voxel.
        let begin = (self.below - voxel) as usize;
        let squares = &self.heights[phase as usize][begin..begin + EDGE];
        for (nearest, square) in column.iter_mut().zip(squares) {
            *nearest = (*nearest).min(*square);
        }
    }

    /// For each voxel along y, the nearest of the columns within its reach; the first of them is the first voxel's.
    #[inline(always)]
    fn nearest_along_y(&self, line: &[Column], has_sites: &[bool]) -> Option<Box<[Column; EDGE]>> {
        let seen = &has_sites[..EDGE * CELLS as usize + self.between.len() - CELLS as usize];
        if !seen.contains(&true) {
            return None;
        }
        let mut nearest = Box::new([[FAR; EDGE]; EDGE]);
        for (y, nearest) in nearest.iter_mut().enumerate() {
            let first = y * CELLS as usize;
            let mut found = [FAR; EDGE];
            let window = line[first..].iter().zip(&has_sites[first..]);
            for ((column, has_sites), &between) in window.zip(&self.between) {
                if *has_sites {
                    relax(&mut found, column, between);
                }
            }
            *nearest = found;
        }
        Some(nearest)
    }

    #[inline(always)]
    fn along_x(&self, planes: &BTreeMap<i32, BTreeMap<i32, Planes>>, chunk: IVec2) -> Option<Box<[i16]>> {
        // Of all cells within reach, from the first voxel's first on.
        let plane = |cell: i32| {
            let planes = planes.get(&(chunk.x + cell.div_euclid(CHUNK_CELLS)))?.get(&chunk.y)?;
            let at = cell.rem_euclid(CHUNK_CELLS) - planes.cells.start;
            planes.columns.get(usize::try_from(at).ok()?)?.as_deref()
        };
        let within: Vec<Option<&[Column; EDGE]>> = (-self.reach..CHUNK_CELLS + self.reach).map(plane).collect();
        if within.iter().all(Option::is_none) {
            return None;
        }
        let mut squared = vec![FAR; VOXELS];
        let mut near: Vec<(&[Column; EDGE], i16)> = Vec::with_capacity(self.between.len());
        let mut is_near = false;
        for (x, squared) in squared.chunks_exact_mut(EDGE * EDGE).enumerate() {
            near.clear();
            let window = within[x * CELLS as usize..].iter().zip(&self.between);
            near.extend(window.filter_map(|(columns, between)| Some(((*columns)?, *between))));
            for (y, column) in squared.chunks_exact_mut(EDGE).enumerate() {
                let mut found = [FAR; EDGE];
                for (columns, between) in &near {
                    relax(&mut found, &columns[y], *between);
                }
                for (squared, found) in column.iter_mut().zip(found) {
                    let is_within = found <= self.lattice.max_squared;
                    *squared = if is_within { found } else { FAR };
                    is_near |= is_within;
                }
            }
        }
        is_near.then(|| squared.into_boxed_slice())
    }
}

/// The less of what was found and of what lies so much farther.
#[inline(always)]
fn relax(found: &mut Column, others: &Column, farther: i16) {
    for (found, other) in found.iter_mut().zip(others) {
        *found = other.saturating_add(farther).min(*found);
    }
}
