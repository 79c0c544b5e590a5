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

use super::chunks::{CHUNK, Chunks, FAR, LocalSite, VOXELS};
use super::lattice::{CELLS, Lattice};

const EDGE: usize = CHUNK as usize;
/// Cells along the edge of a chunk.
const CHUNK_CELLS: i32 = CHUNK * CELLS;
/// Squared distances of voxels along z.
type Column = [i16; EDGE];
/// Columns of voxels that are found together, since they see mostly the same cells.
const TOGETHER: usize = 4;
/// From the first of these to the last, cells.
const APART: usize = CELLS as usize * (TOGETHER - 1);

/// A chunk and the squared distances of its voxels in steps, x slowest; none where all are beyond the radius.
type Found = (IVec3, Option<Box<[i16]>>);

/// The distances of these chunks, which are sorted, in order of their layers, written over what they had before.
pub(super) fn run(lattice: &Lattice, chunks: &Chunks, changed: Vec<Found>) -> Vec<Found> {
    let tables = Tables::new(lattice);
    let mut layers: BTreeMap<i32, Vec<Found>> = BTreeMap::new();
    for found in changed {
        layers.entry(found.0.z).or_default().push(found);
    }
    let layers = layers.into_iter();
    layers.flat_map(|(z, layer)| tables.layer(chunks, z, layer)).collect()
}

/// Squares that are looked up, and how far sites are seen.
struct Tables {
    lattice: Lattice,
    reach: i32,
    /// Chunks to each side that the radius reaches.
    beside: i32,
    /// The squared distances between a voxel and a cell that is n − [`APART`] cells after the first cell within its reach, for each voxel of a
    /// column; [`FAR`] beyond its reach.
    between: Vec<Column>,
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
        let seen = 2 * reach + CELLS;
        let between = |n: i32| {
            if !(0..seen).contains(&n) {
                return [FAR; EDGE];
            }
            // From the middle of a cell to the middle of the voxel.
            let steps = (n - reach) * lattice.cell_steps() + lattice.cell_steps() / 2 - lattice.steps / 2;
            [i16::try_from(steps * steps).unwrap_or(FAR); EDGE]
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
            between: (-(APART as i32)..seen + APART as i32).map(between).collect(),
            heights: (0..steps).map(height).collect(),
            below,
        }
    }

    /// The distances of the chunks of a layer, which are sorted.
    fn layer(&self, chunks: &Chunks, z: i32, changed: Vec<Found>) -> Vec<Found> {
        // The cells in x that are needed of each chunk, by columns of chunks along y.
        let mut needed: BTreeMap<i32, BTreeMap<i32, Range<i32>>> = BTreeMap::new();
        for (chunk, _) in &changed {
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
        let distances = |(chunk, before): Found| {
            let squared = dispatch!(level, _ => self.along_x(&planes, chunk.truncate(), before));
            (chunk, squared)
        };
        changed.into_par_iter().map(distances).collect()
    }

    /// The planes of a column of chunks along y.
    #[inline(always)]
    fn along_y(&self, chunks: &Chunks, [x, z]: [i32; 2], needed: BTreeMap<i32, Range<i32>>) -> BTreeMap<i32, Planes> {
        let (Some(&first), Some(&last)) = (needed.keys().next(), needed.keys().next_back()) else {
            return BTreeMap::new();
        };
        let (first, last) = (first - self.beside, last + self.beside);
        let line_cells = ((last - first + 1) * CHUNK_CELLS) as usize;
        let mut sources = self.sources(chunks, [x, z], first, &needed);
        let seen = -self.lattice.radius_steps..=CHUNK * self.lattice.steps + self.lattice.radius_steps;
        let mut line = vec![[FAR; EDGE]; line_cells];
        let mut has_sites = vec![false; line_cells];
        let mut with_sites = Vec::new();
        let mut planes: BTreeMap<i32, Planes> = needed
            .into_iter()
            .map(|(y, cells)| {
                let columns = Vec::with_capacity(cells.len());
                (y, Planes { cells, columns })
            })
            .collect();
        for cell in 0..CHUNK_CELLS {
            for source in &mut sources {
                for site in source.take(cell) {
                    let height = source.height + i32::from(site.z);
                    if !seen.contains(&height) {
                        continue;
                    }
                    let at = source.y + usize::from(site.y);
                    if !std::mem::replace(&mut has_sites[at], true) {
                        line[at] = [FAR; EDGE];
                        with_sites.push(at);
                    }
                    self.drop_site(&mut line[at], height);
                }
            }
            with_sites.sort_unstable();
            for (y, planes) in &mut planes {
                if planes.cells.contains(&cell) {
                    let begin = ((y - first) * CHUNK_CELLS - self.reach) as usize;
                    planes.columns.push(self.nearest_along_y(&line, &with_sites, begin));
                }
            }
            for at in with_sites.drain(..) {
                has_sites[at] = false;
            }
        }
        planes
    }

    /// The sites of a column of chunks that may be seen from a layer; `first` is the first chunk along y.
    fn sources<'a>(
        &self,
        chunks: &'a Chunks,
        [x, z]: [i32; 2],
        first: i32,
        needed: &BTreeMap<i32, Range<i32>>,
    ) -> Vec<Source<'a>> {
        let around = needed.keys().flat_map(|y| y - self.beside..=y + self.beside);
        let around: BTreeSet<i32> = around.collect();
        let source = |(y, dz): (i32, i32)| Source {
            sites: chunks.sites(IVec3::new(x, y, z + dz)),
            y: ((y - first) * CHUNK_CELLS) as usize,
            height: dz * CHUNK * self.lattice.steps,
        };
        let at = around
            .into_iter()
            .flat_map(|y| (-self.beside..=self.beside).map(move |dz| (y, dz)));
        at.map(source).filter(|source| !source.sites.is_empty()).collect()
    }

    /// Lets a column of voxels see a site.
    #[inline(always)]
    fn drop_site(&self, column: &mut Column, height: i32) {
        // Steps are a power of two.
        let voxel = height >> self.lattice.steps.trailing_zeros();
        let phase = height & (self.lattice.steps - 1);
        // Voxel v is v − voxel above the site's voxel.
        let begin = (self.below - voxel) as usize;
        let Some(squares) = self.heights[phase as usize][begin..].first_chunk::<EDGE>() else {
            return;
        };
        relax(column, squares, &[0; EDGE]);
    }

    /// For each voxel along y, the nearest of the columns within its reach: those of the line that have sites. The first that the first voxel
    /// sees is at `begin`.
    #[inline(always)]
    fn nearest_along_y(&self, line: &[Column], with_sites: &[usize], begin: usize) -> Option<Box<[Column; EDGE]>> {
        let end = begin + EDGE * CELLS as usize + 2 * self.reach as usize;
        let from = with_sites.partition_point(|at| *at < begin);
        let with_sites = &with_sites[from..];
        let with_sites = &with_sites[..with_sites.partition_point(|at| *at < end)];
        if with_sites.is_empty() {
            return None;
        }
        let mut nearest = Box::new([[FAR; EDGE]; EDGE]);
        for (y, nearest) in nearest.as_chunks_mut::<TOGETHER>().0.iter_mut().enumerate() {
            let first = begin + y * TOGETHER * CELLS as usize;
            let from = with_sites.partition_point(|at| *at < first);
            let seen = with_sites[from..].iter().map(|at| (at - first, &line[*at]));
            *nearest = self.nearest(seen);
        }
        Some(nearest)
    }

    /// The nearest that voxels side by side see of columns, which are told with how many cells they are after the first that the first voxel
    /// sees, in order.
    #[inline(always)]
    fn nearest<'a>(&self, columns: impl Iterator<Item = (usize, &'a Column)>) -> [Column; TOGETHER] {
        let [mut a, mut b, mut c, mut d] = [[FAR; EDGE]; TOGETHER];
        for (at, column) in columns {
            // Beyond the reach of all.
            let Some([to_d, _, to_c, _, to_b, _, to_a]) = self.between.get(at..at + APART + 1) else {
                break;
            };
            relax(&mut a, column, to_a);
            relax(&mut b, column, to_b);
            relax(&mut c, column, to_c);
            relax(&mut d, column, to_d);
        }
        [a, b, c, d]
    }

    #[inline(always)]
    fn along_x(
        &self,
        planes: &BTreeMap<i32, BTreeMap<i32, Planes>>,
        chunk: IVec2,
        before: Option<Box<[i16]>>,
    ) -> Option<Box<[i16]>> {
        // Of all cells within reach, from the first voxel's first on.
        let plane = |cell: i32| {
            let planes = planes.get(&(chunk.x + cell.div_euclid(CHUNK_CELLS)))?.get(&chunk.y)?;
            let at = cell.rem_euclid(CHUNK_CELLS) - planes.cells.start;
            planes.columns.get(usize::try_from(at).ok()?)?.as_deref()
        };
        let within =
            (0..(CHUNK_CELLS + 2 * self.reach) as usize).filter_map(|at| Some((at, plane(at as i32 - self.reach)?)));
        let within: Vec<(usize, &[Column; EDGE])> = within.collect();
        if within.is_empty() {
            return None;
        }
        // All of it is overwritten.
        let mut squared = before.unwrap_or_else(|| vec![FAR; VOXELS].into_boxed_slice());
        let mut is_near = false;
        for x in (0..EDGE).step_by(TOGETHER) {
            let first = x * CELLS as usize;
            let within = &within[within.partition_point(|(at, _)| *at < first)..];
            for y in 0..EDGE {
                let found = self.nearest(within.iter().map(|(at, columns)| (at - first, &columns[y])));
                for (x, found) in (x..).zip(found) {
                    let at = (x * EDGE + y) * EDGE;
                    for (squared, found) in squared[at..at + EDGE].iter_mut().zip(found) {
                        let is_within = found <= self.lattice.max_squared;
                        *squared = if is_within { found } else { FAR };
                        is_near |= is_within;
                    }
                }
            }
        }
        is_near.then_some(squared)
    }
}

/// Sites of a chunk, which are taken plane by plane.
struct Source<'a> {
    /// Those that are left.
    sites: &'a [LocalSite],
    /// Where the chunk begins along y, cells.
    y: usize,
    /// The height of its bottom, steps.
    height: i32,
}

impl<'a> Source<'a> {
    /// Those of the next cell along x.
    fn take(&mut self, cell: i32) -> &'a [LocalSite] {
        let count = self.sites.iter().take_while(|site| i32::from(site.x) <= cell).count();
        let (taken, left) = self.sites.split_at(count);
        self.sites = left;
        taken
    }
}

/// The less of what was found and of what lies so much farther.
#[inline(always)]
fn relax(found: &mut Column, others: &Column, farther: &Column) {
    // As values: they stay in registers.
    *found = std::array::from_fn(|i| others[i].saturating_add(farther[i]).min(found[i]));
}

const _: () = assert!(
    TOGETHER == 4 && CELLS == 2,
    "how many columns are relaxed together is written out"
);
