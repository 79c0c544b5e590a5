//! Distances to the nearest site: along z, then along y, then along x.
//!
//! ```text
//!   plane by plane of cells in x: how far sites are away along z ─▶ the nearest along y     (along_z_and_y)
//!   ─▶ the nearest along x, among the planes within the radius                              (along_x)
//! ```
//!
//! Each chunk is on its own. Planes within the radius beside it are found again for its neighbours, a third more of them, but what is kept between
//! the steps stays in the CPU's second-level cache.

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;
use tsdfuse::glam::IVec3;

use super::chunks::{CHUNK, Chunks, FAR, LocalSite, VOXELS};
use super::lattice::{CELLS, Lattice};

const EDGE: usize = CHUNK as usize;
/// Cells along the edge of a chunk.
const CHUNK_CELLS: i32 = CHUNK * CELLS;
/// Squared distances of voxels along z. In a cache line each.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Column(Heights);
type Heights = [i16; EDGE];
const FAR_COLUMN: Column = Column([FAR; EDGE]);
/// Columns of voxels that are found together, since they see mostly the same cells.
const TOGETHER: usize = 4;
/// From the first of these to the last, cells.
const APART: usize = CELLS as usize * (TOGETHER - 1);

/// A chunk and the squared distances of its voxels in steps, x slowest; none where all are beyond the radius.
type Found = (IVec3, Option<Box<[i16]>>);

/// The distances of these chunks, in the same order, written over what they had before.
pub(super) fn run(lattice: &Lattice, chunks: &Chunks, changed: Vec<Found>) -> Vec<Found> {
    let tables = Tables::new(lattice);
    let level = Level::new();
    let found = changed.into_par_iter().map_init(
        || Workplace::new(&tables),
        |workplace, (chunk, before)| {
            let squared = dispatch!(level, _ => tables.chunk(chunks, chunk, before, workplace));
            (chunk, squared)
        },
    );
    found.collect()
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

/// Memory for what is found of a chunk. All cells are those within its reach, from the first on.
struct Workplace {
    /// Of the cells along y of one plane: the columns, whether they have sites, and which do.
    line: Vec<Column>,
    has_sites: Vec<bool>,
    with_sites: Vec<usize>,
    /// Planes near sites: which cells along x, …
    planes: Vec<usize>,
    /// … and for each voxel along y, with room for all planes: the columns.
    rows: Vec<Column>,
}

impl Workplace {
    fn new(tables: &Tables) -> Self {
        let cells = tables.cells();
        Self {
            line: vec![FAR_COLUMN; cells],
            has_sites: vec![false; cells],
            with_sites: Vec::with_capacity(cells),
            planes: Vec::with_capacity(cells),
            rows: vec![FAR_COLUMN; EDGE * cells],
        }
    }
}

impl Tables {
    fn new(lattice: &Lattice) -> Self {
        let (reach, steps) = (lattice.reach_cells(), lattice.steps);
        let seen = 2 * reach + CELLS;
        let between = |n: i32| {
            if !(0..seen).contains(&n) {
                return FAR_COLUMN;
            }
            // From the middle of a cell to the middle of the voxel.
            let steps = (n - reach) * lattice.cell_steps() + lattice.cell_steps() / 2 - lattice.steps / 2;
            Column([i16::try_from(steps * steps).unwrap_or(FAR); EDGE])
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

    /// Cells within the reach of a chunk, along an axis.
    fn cells(&self) -> usize {
        (CHUNK_CELLS + 2 * self.reach) as usize
    }

    /// The distances of a chunk.
    #[inline(always)]
    fn chunk(
        &self,
        chunks: &Chunks,
        chunk: IVec3,
        before: Option<Box<[i16]>>,
        workplace: &mut Workplace,
    ) -> Option<Box<[i16]>> {
        self.along_z_and_y(chunks, chunk, workplace);
        if workplace.planes.is_empty() {
            return None;
        }
        // All of it is overwritten.
        let mut squared = before.unwrap_or_else(|| vec![FAR; VOXELS].into_boxed_slice());
        self.along_x(workplace, &mut squared).then_some(squared)
    }

    /// The planes within the reach of a chunk.
    #[inline(always)]
    fn along_z_and_y(&self, chunks: &Chunks, chunk: IVec3, workplace: &mut Workplace) {
        let Workplace {
            line,
            has_sites,
            with_sites,
            planes,
            rows,
        } = workplace;
        planes.clear();
        let stride = line.len();
        let seen = -self.lattice.radius_steps..=CHUNK * self.lattice.steps + self.lattice.radius_steps;
        for dx in -self.beside..=self.beside {
            let mut sources = self.sources(chunks, chunk + IVec3::X * dx);
            let first = dx * CHUNK_CELLS + self.reach;
            for cell in 0..CHUNK_CELLS {
                let sites = sources.iter_mut().flat_map(|source| {
                    let (y, height) = (source.y, source.height);
                    let sites = source.take(cell).iter();
                    sites.map(move |site| (y + i32::from(site.y), height + i32::from(site.z)))
                });
                let Some(at_x) = usize::try_from(first + cell).ok().filter(|at| *at < stride) else {
                    sites.for_each(drop);
                    continue;
                };
                for (y, height) in sites {
                    let Some(at) = usize::try_from(y).ok().filter(|at| *at < stride) else {
                        continue;
                    };
                    if !seen.contains(&height) {
                        continue;
                    }
                    if !std::mem::replace(&mut has_sites[at], true) {
                        line[at] = FAR_COLUMN;
                        with_sites.push(at);
                    }
                    self.drop_site(&mut line[at], height);
                }
                if with_sites.is_empty() {
                    continue;
                }
                with_sites.sort_unstable();
                let rows = rows[planes.len()..].chunks_mut(stride);
                self.along_y(line, with_sites, rows.filter_map(|row| row.first_mut()));
                planes.push(at_x);
                for at in with_sites.drain(..) {
                    has_sites[at] = false;
                }
            }
        }
    }

    /// The sites that may be seen from a chunk, of the chunks beside it along y and z.
    fn sources<'a>(&self, chunks: &'a Chunks, chunk: IVec3) -> Vec<Source<'a>> {
        let beside = || -self.beside..=self.beside;
        let at = beside().flat_map(|dy| beside().map(move |dz| (dy, dz)));
        let source = |(dy, dz): (i32, i32)| Source {
            sites: chunks.sites(chunk + IVec3::new(0, dy, dz)),
            y: dy * CHUNK_CELLS + self.reach,
            height: dz * CHUNK * self.lattice.steps,
        };
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
        let mut nearer = [0; EDGE];
        for i in 0..EDGE {
            nearer[i] = squares[i].min(column.0[i]);
        }
        column.0 = nearer;
    }

    /// For each voxel along y, the nearest of the columns within its reach: those of the line that have sites.
    #[inline(always)]
    fn along_y<'a>(&self, line: &[Column], with_sites: &[usize], mut nearest: impl Iterator<Item = &'a mut Column>) {
        for y in (0..EDGE).step_by(TOGETHER) {
            let first = y * CELLS as usize;
            let from = with_sites.partition_point(|at| *at < first);
            let seen = with_sites[from..].iter().map(|at| (at - first, &line[*at]));
            for (found, nearest) in self.nearest(seen).into_iter().zip(&mut nearest) {
                nearest.0 = found;
            }
        }
    }

    /// The nearest that voxels side by side see of columns, which are told with how many cells they are after the first that the first voxel
    /// sees, in order.
    #[inline(always)]
    fn nearest<'a>(&self, columns: impl Iterator<Item = (usize, &'a Column)>) -> [Heights; TOGETHER] {
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

    /// The nearest of the planes within the reach of each voxel; whether any is within the radius.
    #[inline(always)]
    fn along_x(&self, workplace: &Workplace, squared: &mut [i16]) -> bool {
        let Workplace { planes, rows, .. } = workplace;
        let most = self.lattice.max_squared;
        let mut nearest = [FAR; EDGE];
        for (y, row) in rows.chunks(self.cells()).enumerate() {
            for x in (0..EDGE).step_by(TOGETHER) {
                let first = x * CELLS as usize;
                let from = planes.partition_point(|at| *at < first);
                let seen = planes[from..].iter().map(|at| at - first).zip(&row[from..]);
                for (x, found) in (x..).zip(self.nearest(seen)) {
                    let at = (x * EDGE + y) * EDGE;
                    for (i, squared) in squared[at..at + EDGE].iter_mut().enumerate() {
                        *squared = if found[i] <= most { found[i] } else { FAR };
                        nearest[i] = found[i].min(nearest[i]);
                    }
                }
            }
        }
        nearest.iter().any(|nearest| *nearest <= most)
    }
}

/// Sites of a chunk, which are taken plane by plane.
struct Source<'a> {
    /// Those that are left.
    sites: &'a [LocalSite],
    /// Where the chunk begins along y, cells after the first one.
    y: i32,
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
fn relax(found: &mut Heights, others: &Column, farther: &Column) {
    // As a value: it stays in registers.
    let mut nearer = [0; EDGE];
    for i in 0..EDGE {
        nearer[i] = others.0[i].saturating_add(farther.0[i]).min(found[i]);
    }
    *found = nearer;
}

const _: () = assert!(
    TOGETHER == 4 && CELLS == 2,
    "how many columns are relaxed together is written out"
);
