//! The vertices of one block: the smallest neighbourhood that decides each of them.

use std::{array, cell::RefCell};

use glam::DVec3;

use super::{
    cells::CellBlock,
    near::{Around, Rows, Sums},
    plane::{LANES, Limits, Neighbourhoods},
};
use crate::{
    fuse::gather::Updates,
    index::{BLOCK_EDGE, BlockIndex},
    map::MapConfig,
};

const EDGE: usize = BLOCK_EDGE as usize;

/// A spread below this, in voxels, is rounding: the points lie on a line.
const LEAST_SPREAD: f32 = 0.01;

/// The search for neighbourhoods.
#[derive(Debug)]
pub(super) struct Adaptive {
    min_points: u32,
    max_level: usize,
    truncation_vox: f32,
    limits: Limits,
}

/// A vertex with enough points in the current level: its x, its row y + 8 z, and the rows of sums around it.
type Candidate = (u8, u8, Rows);

thread_local! {
    /// Buffers that each thread keeps from block to block.
    static BUFFERS: RefCell<(Sums, Vec<Candidate>)> = RefCell::default();
}

impl Adaptive {
    /// Neighbourhoods of `min_points` or more in `max_level` levels; `min_spread_m` and `min_density` as in `RoldaoConfig`.
    pub(super) fn new(
        (min_points, max_level): (u32, usize),
        (min_spread_m, min_density): (f64, f64),
        map: &MapConfig,
    ) -> Self {
        Self {
            min_points,
            max_level,
            truncation_vox: map.truncation_vox(),
            limits: Limits {
                min_density: min_density as f32,
                min_spread: ((min_spread_m / map.voxel_size_m) as f32).max(LEAST_SPREAD),
            },
        }
    }

    /// Updates the voxels of `block` from the points in the blocks of cells around it.
    pub(super) fn update<'a>(
        &self,
        block: BlockIndex,
        cells: impl Iterator<Item = (BlockIndex, &'a CellBlock)>,
        updates: &mut Updates,
    ) {
        let around = Around::new(block, cells, self.max_level);
        if around.has(self.min_points) {
            BUFFERS.with_borrow_mut(|(sums, queue)| self.search(&around, sums, queue, updates));
        }
    }

    fn search(&self, around: &Around, sums: &mut Sums, queue: &mut Vec<Candidate>, updates: &mut Updates) {
        sums.count(around);
        // One bit per x for each row: the vertices with enough points in the largest neighbourhood. The others have too few at
        // every level. Most distant blocks have no such vertex.
        let crowded = |sums: &Sums, k: usize, row: usize| -> Option<(Rows, u8)> {
            let rows = sums.rows(k, row % EDGE, row / EDGE)?;
            Some((rows, sums.crowded(k, rows, self.min_points))) // (4.4)
        };
        let mut undecided: [u8; EDGE * EDGE] =
            array::from_fn(|row| crowded(sums, self.max_level, row).map_or(0, |(_, bits)| bits));
        if undecided == [0; EDGE * EDGE] {
            return;
        }
        sums.sum(around);
        for k in 1..=self.max_level {
            queue.clear();
            for (row, &left) in undecided.iter().enumerate().filter(|(_, left)| **left != 0) {
                let Some((rows, crowded)) = crowded(sums, k, row) else {
                    continue;
                };
                let mut bits = left & crowded;
                while bits != 0 {
                    queue.push((bits.trailing_zeros() as u8, row as u8, rows));
                    bits &= bits - 1;
                }
            }
            self.decide(around, sums, k, queue, |row, x, distance| {
                undecided[row] &= !(1 << x);
                if distance.abs() <= self.truncation_vox {
                    updates.add(EDGE * row + x, distance / self.truncation_vox, 1.0);
                }
            });
        }
    }

    /// Calls `decided` for the candidates that level `k` decides: row, x, and the distance in voxels (4.7).
    fn decide(
        &self,
        around: &Around,
        sums: &mut Sums,
        k: usize,
        candidates: &[Candidate],
        mut decided: impl FnMut(usize, usize, f32),
    ) {
        let mut neighbourhoods = Neighbourhoods::default();
        for vertices in candidates.chunks(LANES) {
            for (lane, &(x, row, rows)) in vertices.iter().enumerate() {
                let (y, z) = (row % BLOCK_EDGE as u8, row / BLOCK_EDGE as u8);
                // Relative to the block's middle cell, half a voxel above the middle of its vertices.
                let vertex = DVec3::new(x.into(), y.into(), z.into()) - 3.5;
                neighbourhoods.set(lane, &sums.moments(k, x.into(), rows), vertex);
            }
            let planes = neighbourhoods.planes(&self.limits);
            for (lane, &(x, row, rows)) in vertices.iter().enumerate() {
                if planes.accepted >> lane & 1 == 0 {
                    continue;
                }
                let (normal, distance) = planes.plane(lane);
                let facing = match around.side(normal) {
                    0 => normal.as_dvec3().dot(sums.towards(around, k, x.into(), rows)) > 0.0, // (4.5)
                    side => side > 0,
                };
                decided(row.into(), x.into(), if facing { distance } else { -distance });
            }
        }
    }
}
