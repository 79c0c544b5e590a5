//! Statistics of points in cells: count, mean and covariance as integer sums, so that they can be added in any order.

use glam::{DVec3, IVec3, Vec3};
use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;

use crate::{
    fuse::placed::Placed,
    index::{BlockIndex, GridPoint, SHARDS, local_number, round, shard_of},
};

/// Positions within a cell are rounded to this fraction of its edge (0.1 mm at 5 cm).
pub(super) const STEPS: f32 = 512.0;

/// The most points in a cell, so that no sum can overflow. Further points are left out.
const MAX_COUNT: u32 = (1 << 15) - 1;

/// Pieces of a scan, enough to balance the load of many threads.
const LANES: usize = 32;

/// The points in one cell: 40 bytes, and 24 for the vectors to their sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    pub(super) count: u32,
    /// Σ x, Σ y, Σ z about the cell's centre, in steps.
    pub(super) sum: [i32; 3],
    /// Σ xx, Σ yy, Σ zz, Σ xy, Σ xz, Σ yz about the cell's centre, in steps².
    pub(super) products: [i32; 6],
}

/// Σ (s − p) of the points in one cell: the vectors from the points to their sensor positions, in steps.
pub(super) type Towards = [i64; 3];

impl Cell {
    fn add(&mut self, point: &Point, towards: &mut Towards) {
        if self.count == MAX_COUNT {
            return;
        }
        let [x, y, z] = point.offset.map(i32::from);
        let products = [x * x, y * y, z * z, x * y, x * z, y * z];
        self.count += 1;
        for (sum, v) in self.sum.iter_mut().zip([x, y, z]) {
            *sum += v;
        }
        for (sum, v) in self.products.iter_mut().zip(products) {
            *sum += v;
        }
        for (sum, v) in towards.iter_mut().zip(point.towards) {
            *sum += i64::from(v);
        }
    }
}

/// The occupied cells among 8×8×8.
#[derive(Clone, Debug)]
pub(super) struct CellBlock {
    /// A bit for each occupied cell: word z, bit x + 8 y.
    mask: [u64; 8],
    /// The occupied cells, in the order of their bits.
    cells: Vec<Cell>,
    /// One for each of these cells.
    towards: Vec<Towards>,
    /// Bounds of the vectors from points to their sensor, in steps.
    views: [[i32; 3]; 2],
}

impl Default for CellBlock {
    fn default() -> Self {
        Self {
            mask: [0; 8],
            cells: Vec::new(),
            towards: Vec::new(),
            views: [[i32::MAX; 3], [i32::MIN; 3]],
        }
    }
}

impl CellBlock {
    /// Adds points that are sorted by cell.
    fn add(&mut self, points: &[Point]) {
        let of_cells = || points.chunk_by(|a, b| a.local == b.local);
        let is_new = |p: &[Point]| self.mask[usize::from(p[0].local >> 6)] >> (p[0].local & 63) & 1 == 0;
        let new = of_cells().filter(|p| is_new(p)).count();
        self.cells.reserve_exact(new);
        self.towards.reserve_exact(new);
        for towards in points.iter().map(|p| p.towards) {
            self.views[0] = std::array::from_fn(|i| self.views[0][i].min(towards[i]));
            self.views[1] = std::array::from_fn(|i| self.views[1][i].max(towards[i]));
        }
        for points in of_cells() {
            let (word, bit) = (usize::from(points[0].local >> 6), 1u64 << (points[0].local & 63));
            let before = self.mask[..word].iter().map(|m| m.count_ones()).sum::<u32>();
            let rank = (before + (self.mask[word] & (bit - 1)).count_ones()) as usize;
            if self.mask[word] & bit == 0 {
                self.mask[word] |= bit;
                self.cells.insert(rank, Cell::default());
                self.towards.insert(rank, Towards::default());
            }
            let (cell, towards) = (&mut self.cells[rank], &mut self.towards[rank]);
            points.iter().for_each(|p| cell.add(p, towards));
        }
    }

    /// Bounds of the vectors from points to their sensor, in steps.
    pub(super) fn views(&self) -> (DVec3, DVec3) {
        let [from, to] = self.views.map(|v| IVec3::from(v).as_dvec3());
        (from, to)
    }

    /// The lowest and highest coordinates of occupied cells within the block.
    pub(super) fn bounds(&self) -> (IVec3, IVec3) {
        let (mut rows, mut planes) = (0, 0_u8);
        for (z, &word) in self.mask.iter().enumerate() {
            rows |= word;
            planes |= u8::from(word != 0) << z;
        }
        let rows = rows.to_le_bytes();
        let columns = rows.iter().fold(0, |all, row| all | row);
        let lines = rows
            .iter()
            .enumerate()
            .fold(0, |all, (y, &row)| all | u8::from(row != 0) << y);
        let low = [columns, lines, planes].map(|bits| bits.trailing_zeros() as i32);
        let high = [columns, lines, planes].map(|bits| 7 - bits.leading_zeros() as i32);
        (low.into(), high.into())
    }

    /// Visits the occupied cells with coordinates `low..=high` within the block.
    #[inline]
    pub(super) fn for_each_within<'a>(
        &'a self,
        low: IVec3,
        high: IVec3,
        mut visit: impl FnMut(IVec3, &'a Cell, &'a Towards),
    ) {
        let mut rank = 0;
        let row = (0xff_u64 >> (7 - high.x)) & (0xff << low.x);
        let rows = (low.y..=high.y).fold(0, |all, y| all | row << (8 * y));
        for (z, &word) in (0..).zip(&self.mask) {
            let mut left = if (low.z..=high.z).contains(&z) { word & rows } else { 0 };
            while left != 0 {
                let bit = left.trailing_zeros();
                left &= left - 1;
                let before = (word & ((1 << bit) - 1)).count_ones();
                let at = IVec3::new(bit as i32 & 7, bit as i32 >> 3, z);
                let number = (rank + before) as usize;
                visit(at, &self.cells[number], &self.towards[number]);
            }
            rank += word.count_ones();
        }
    }
}

/// A return on its way into its cell.
#[derive(Clone, Copy, Debug)]
struct Point {
    block: BlockIndex,
    local: u16,
    /// From the cell's centre, in steps.
    offset: [i16; 3],
    /// To the sensor, in steps.
    towards: [i32; 3],
}

impl Point {
    fn new(at: GridPoint, towards_vox: Vec3) -> Self {
        // Cell j covers [j − ½, j + ½) voxels, so that the corners of cells are the centres of voxels.
        let above = at.fraction.cmpge(Vec3::splat(0.5));
        let above = IVec3::new(above.x.into(), above.y.into(), above.z.into());
        let cell = at.voxel + above;
        let offset = (at.fraction - above.as_vec3()) * STEPS;
        Self {
            block: BlockIndex::of(cell),
            local: local_number(cell) as u16,
            offset: offset.to_array().map(|v| round(v) as i16),
            towards: (towards_vox * STEPS).to_array().map(|v| v as i32),
        }
    }
}

/// Cells of the voxels' size whose corners are the voxels' centres, each with the statistics of its points.
#[derive(Debug)]
pub(super) struct Cells {
    shards: Vec<HashMap<BlockIndex, CellBlock, FxBuildHasher>>,
    /// Per lane and shard: points on their way.
    lanes: Vec<Vec<Vec<Point>>>,
    sorted: Vec<Vec<Point>>,
}

impl Default for Cells {
    fn default() -> Self {
        Self {
            shards: (0..SHARDS).map(|_| HashMap::default()).collect(),
            lanes: vec![vec![Vec::new(); SHARDS]; LANES],
            sorted: vec![Vec::new(); SHARDS],
        }
    }
}

impl Cells {
    /// Adds the returns of a scan and tells how many were added; the others are invalid or outside the grid.
    pub(super) fn add(&mut self, placed: &Placed, voxel_size_m: f64) -> u64 {
        let voxels_per_m = (1.0 / voxel_size_m) as f32;
        let items = placed.len();
        let fill = |(k, lane): (usize, &mut Vec<Vec<Point>>)| {
            lane.iter_mut().for_each(Vec::clear);
            let mut added = 0;
            for i in items * k / LANES..items * (k + 1) / LANES {
                if let Some(ray) = placed.ray(i) {
                    let point = Point::new(ray.end, ray.direction * (-ray.range_m * voxels_per_m));
                    lane[shard_of(point.block)].push(point);
                    added += 1;
                }
            }
            added
        };
        let added = self.lanes.par_iter_mut().enumerate().map(fill).sum();
        let lanes = &self.lanes;
        let shards = self.shards.par_iter_mut().zip(&mut self.sorted).enumerate();
        shards.for_each(|(s, (shard, sorted))| {
            sorted.clear();
            lanes.iter().for_each(|lane| sorted.extend(&lane[s]));
            // Stable, so that a cell takes its points in the order of the scan.
            sorted.sort_by_key(|p| (p.block, p.local));
            for points in sorted.chunk_by(|a, b| a.block == b.block) {
                shard.entry(points[0].block).or_default().add(points);
            }
        });
        added
    }

    /// Forgets all points.
    pub(super) fn clear(&mut self) {
        self.shards.par_iter_mut().for_each(HashMap::clear);
    }

    /// All blocks with points.
    pub(super) fn blocks(&self) -> Vec<(BlockIndex, &CellBlock)> {
        self.shards
            .iter()
            .flatten()
            .map(|(&index, block)| (index, block))
            .collect()
    }
}
