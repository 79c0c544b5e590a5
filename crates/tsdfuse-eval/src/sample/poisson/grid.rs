//! Points sorted by the cells of a grid.

use std::ops::Range;

use rayon::prelude::*;
use tsdfuse::glam::Vec3;

/// z, y and x of a cell: in this order, so that cells beside each other in x lie one after another.
type Cell = [i32; 3];

/// Points sorted by cells, so that all within an edge's length of one lie in nine runs.
pub(super) struct Grid {
    /// In the order of their cells.
    pub(super) positions: Vec<Vec3>,
    /// The number that each had at first.
    pub(super) numbers: Vec<u32>,
    /// The cell of each.
    cells: Vec<u32>,
    /// For each cell the points in it and around it.
    around: Vec<[Range<u32>; 9]>,
}

impl Grid {
    pub(super) fn new(positions: Vec<Vec3>, edge_m: f32) -> Self {
        let cell = |p: Vec3| -> Cell {
            let [x, y, z] = (p / edge_m).floor().as_ivec3().to_array();
            [z, y, x]
        };
        let mut keyed: Vec<(Cell, u32)> = positions
            .par_iter()
            .zip(0..positions.len() as u32)
            .map(|(&p, i)| (cell(p), i))
            .collect();
        keyed.par_sort_unstable();
        let sorted = keyed.par_iter().map(|&(_, i)| positions[i as usize]).collect();
        drop(positions);
        let mut starts: Vec<(Cell, u32)> = Vec::new();
        let mut cells = Vec::with_capacity(keyed.len());
        for (&(cell, _), i) in keyed.iter().zip(0_u32..) {
            if starts.last().is_none_or(|last| last.0 != cell) {
                starts.push((cell, i));
            }
            cells.push(starts.len() as u32 - 1);
        }
        let end = keyed.len() as u32;
        let first_from = |cell: Cell| {
            let at = starts.partition_point(|start| start.0 < cell);
            starts.get(at).map_or(end, |start| start.1)
        };
        let runs = |&([z, y, x], _): &(Cell, u32)| {
            const ROWS: [[i32; 2]; 9] = [
                [-1, -1],
                [-1, 0],
                [-1, 1],
                [0, -1],
                [0, 0],
                [0, 1],
                [1, -1],
                [1, 0],
                [1, 1],
            ];
            ROWS.map(|[dz, dy]| {
                let row = |x| first_from([z.saturating_add(dz), y.saturating_add(dy), x]);
                row(x.saturating_sub(1))..row(x.saturating_add(2))
            })
        };
        Self {
            around: starts.par_iter().map(runs).collect(),
            positions: sorted,
            numbers: keyed.into_iter().map(|(_, i)| i).collect(),
            cells,
        }
    }

    /// The points in the cell of point `i` and in the cells around it, `i` among them.
    pub(super) fn around(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        let runs = &self.around[self.cells[i] as usize];
        runs.iter().flat_map(|run| run.start as usize..run.end as usize)
    }
}
