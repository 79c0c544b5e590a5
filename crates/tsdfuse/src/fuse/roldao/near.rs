//! The cells around one block of vertices, as summed-area tables: the sum over any cube of cells takes eight look-ups.

use std::ops::{Add, AddAssign};

use glam::{DVec3, IVec3, Vec3};

use super::{
    cells::{Cell, CellBlock, STEPS, Towards},
    plane::Moments,
};
use crate::index::{BLOCK_EDGE, BlockIndex};

/// The largest level that is supported: its neighbourhoods reach one block beyond their own.
pub(super) const MAX_LEVEL: usize = 8;

const EDGE: usize = BLOCK_EDGE as usize;

/// The cells within `reach` of a block's vertices.
///
/// ```text
///   vertices                        0     1   …   7
///   cells        | 0 | 1 | … |reach−1|reach| …            level k of vertex i: cells i + reach − k .. i + reach + k
/// ```
#[derive(Debug)]
pub(super) struct Around<'a> {
    cells: Vec<(IVec3, &'a Cell, &'a Towards)>,
    low: IVec3,
    high: IVec3,
    reach: usize,
    /// Bounds of the vectors from the points to their sensor.
    views: (DVec3, DVec3),
}

impl<'a> Around<'a> {
    /// Finds the cells around `block` in blocks of cells.
    pub(super) fn new(
        block: BlockIndex,
        items: impl Iterator<Item = (BlockIndex, &'a CellBlock)>,
        reach: usize,
    ) -> Self {
        let mut found = Self {
            cells: Vec::with_capacity(64),
            low: IVec3::MAX,
            high: IVec3::MIN,
            reach,
            views: (DVec3::INFINITY, DVec3::NEG_INFINITY),
        };
        let (last, reach) = (BLOCK_EDGE - 1, reach as i32);
        for (index, cells) in items {
            let shift = (index.0 - block.0) * BLOCK_EDGE + reach - 1;
            let low = (-shift).max(IVec3::ZERO);
            let high = (2 * reach + last - 1 - shift).min(IVec3::splat(last));
            if low.cmple(high).all() {
                let (from, to) = cells.views();
                found.views = (found.views.0.min(from), found.views.1.max(to));
                cells.for_each_within(low, high, |at, cell, towards| {
                    let at = at + shift;
                    (found.low, found.high) = (found.low.min(at), found.high.max(at));
                    found.cells.push((at, cell, towards));
                });
            }
        }
        found
    }

    /// Whether a normal faces the sensor for all points (1), for none (−1), or undecided (0).
    #[inline]
    pub(super) fn side(&self, normal: Vec3) -> i32 {
        let normal = normal.as_dvec3();
        let (a, b) = (normal * self.views.0, normal * self.views.1);
        match (a.min(b).element_sum() > 0.0, a.max(b).element_sum() < 0.0) {
            (true, _) => 1,
            (_, true) => -1,
            _ => 0,
        }
    }

    /// Whether the cells hold at least this many points.
    pub(super) fn has(&self, points: u32) -> bool {
        // Each occupied cell holds at least one.
        let sum = || self.cells.iter().map(|c| u64::from(c.1.count)).sum::<u64>();
        self.cells.len() as u64 >= u64::from(points) || sum() >= u64::from(points)
    }
}

/// The starts of four rows of sums, see [`Sums::rows`].
pub(super) type Rows = [usize; 4];

/// Summed-area tables over cells: `table[x, y, z]` is the sum over all cells below x, y and z in the bounding box of the
/// occupied ones. The sums are of whole numbers, so that differences are exact.
#[derive(Debug, Default)]
pub(super) struct Sums {
    size: [usize; 3],
    /// Per axis, level − 1 and vertex: where its cells begin and end in the table.
    ranges: [[[(usize, usize); EDGE]; MAX_LEVEL]; 3],
    counts: Vec<[i32; 1]>,
    /// Relative to the middle of the block, in steps.
    moments: Vec<Moments>,
    /// Σ (s − p), in steps; empty until it is needed.
    towards: Vec<[f64; 3]>,
}

impl Sums {
    /// Counts the points around a block.
    pub(super) fn count(&mut self, around: &Around) {
        let &Around { low, high, reach, .. } = around;
        let extent = high - low + 1;
        for axis in 0..3 {
            for k in 1..=reach {
                for i in 0..EDGE {
                    let clamp = |cell: usize| (cell as i32 - low[axis]).clamp(0, extent[axis]) as usize;
                    self.ranges[axis][k - 1][i] = (clamp(i + reach - k), clamp(i + reach + k));
                }
            }
        }
        self.size = extent.to_array().map(|n| n as usize + 1);
        sum_up(&mut self.counts, self.size, around, |_, cell, _| [cell.count as i32]);
    }

    /// Sums up the moments of the points that were counted.
    pub(super) fn sum(&mut self, around: &Around) {
        let middle = around.low - (around.reach as i32 - 1) - BLOCK_EDGE / 2;
        let moments = |at: IVec3, cell: &Cell, _: &Towards| moments_about(at + middle, cell);
        sum_up(&mut self.moments, self.size, around, moments);
        self.towards.clear();
    }

    /// The starts of the four table rows along x that enclose the cells of level `k` of a row of vertices; a sum over these cells
    /// is a − b − c + d. `None` if there are no cells.
    #[inline]
    pub(super) fn rows(&self, k: usize, y: usize, z: usize) -> Option<Rows> {
        let (y0, y1) = self.ranges[1][k - 1][y];
        let (z0, z1) = self.ranges[2][k - 1][z];
        let row = |y, z| self.size[0] * (y + self.size[1] * z);
        (y0 < y1 && z0 < z1).then(|| [row(y1, z1), row(y0, z1), row(y1, z0), row(y0, z0)])
    }

    /// The vertices of a row whose cells of level `k` hold at least `min_points` points (4.4), as bits.
    #[inline]
    pub(super) fn crowded(&self, k: usize, rows: Rows, min_points: u32) -> u8 {
        let nx = self.size[0];
        let [a, b, c, d] = rows.map(|row| &self.counts[row..row + nx]);
        let mut sums = [0; 2 * MAX_LEVEL + EDGE];
        for x in 0..nx.min(sums.len()) {
            sums[x] = a[x][0] - b[x][0] - c[x][0] + d[x][0];
        }
        let ranges = self.ranges[0][k - 1].iter().enumerate();
        ranges.fold(0, |bits, (x, &(x0, x1))| {
            bits | u8::from(sums[x1] - sums[x0] >= min_points as i32) << x
        })
    }

    /// The moments of the cells of level `k` of vertex `x` of a row.
    #[inline(never)] // so that the compiler adds in vectors
    pub(super) fn moments(&self, k: usize, x: usize, rows: Rows) -> Moments {
        cube(&self.moments, rows, self.ranges[0][k - 1][x])
    }

    /// Σ (s − p) of the same.
    #[inline]
    pub(super) fn towards(&mut self, around: &Around, k: usize, x: usize, rows: Rows) -> DVec3 {
        if self.towards.is_empty() {
            sum_up(&mut self.towards, self.size, around, |_, _, towards| {
                towards.map(|v| v as f64)
            });
        }
        cube(&self.towards, rows, self.ranges[0][k - 1][x]).into()
    }
}

/// Makes a table of sums from the values of cells, given their place in the box.
fn sum_up<T: Copy + Default + Add<Output = T> + AddAssign, const N: usize>(
    table: &mut Vec<[T; N]>,
    [nx, ny, nz]: [usize; 3],
    around: &Around,
    value: impl Fn(IVec3, &Cell, &Towards) -> [T; N],
) {
    let none = [T::default(); N];
    table.clear();
    table.resize(nx * ny * nz, none);
    for (at, cell, towards) in &around.cells {
        let at = *at - around.low;
        let [x, y, z] = (at + 1).to_array().map(|i| i as usize);
        table[x + nx * (y + ny * z)] = value(at, cell, towards);
    }
    let mut layer = [none; 2 * MAX_LEVEL + EDGE];
    for z in 1..nz {
        layer.fill(none);
        for y in 1..ny {
            let start = nx * (y + ny * z);
            let (below, here) = table.split_at_mut(start);
            let below = &below[start - nx * ny..][..nx];
            let here = &mut here[..nx];
            let mut row = none;
            for ((sum, below), layer) in here.iter_mut().zip(below).zip(&mut layer) {
                for i in 0..N {
                    row[i] += sum[i];
                    layer[i] += row[i];
                    sum[i] = layer[i] + below[i];
                }
            }
        }
    }
}

/// The sum over a cube of cells.
#[inline(always)]
fn cube<const N: usize>(table: &[[f64; N]], rows: Rows, (x0, x1): (usize, usize)) -> [f64; N] {
    let [a, b, c, d] = rows.map(|row| (&table[row + x1], &table[row + x0]));
    std::array::from_fn(|i| (a.0[i] - a.1[i]) - (b.0[i] - b.1[i]) - (c.0[i] - c.1[i]) + (d.0[i] - d.1[i]))
}

/// A cell's moments about a point that lies `at` cells below it.
fn moments_about(at: IVec3, cell: &Cell) -> Moments {
    let n = f64::from(cell.count);
    let [dx, dy, dz] = (at.as_dvec3() * f64::from(STEPS)).to_array();
    let [sx, sy, sz] = cell.sum.map(f64::from);
    let [xx, yy, zz, xy, xz, yz] = cell.products.map(f64::from);
    [
        n,
        sx + n * dx,
        sy + n * dy,
        sz + n * dz,
        xx + dx * (2.0 * sx + n * dx),
        yy + dy * (2.0 * sy + n * dy),
        zz + dz * (2.0 * sz + n * dz),
        xy + dx * sy + dy * sx + n * dx * dy,
        xz + dx * sz + dz * sx + n * dx * dz,
        yz + dy * sz + dz * sy + n * dy * dz,
    ]
}
