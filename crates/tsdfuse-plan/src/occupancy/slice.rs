//! A layer of heights as seen from above.

use tsdfuse::glam::{DVec2, IVec3};

use super::{Occupancy, State};

/// What is known between two heights, from above.
#[derive(Clone, Debug, PartialEq)]
pub struct Slice {
    /// The lower left corner of the first cell, world, metres.
    pub origin: DVec2,
    /// Edge of a cell, metres.
    pub cell_m: f64,
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Row by row along x, from the lowest y on. Occupied where any voxel of the column is, else free where any is.
    pub cells: Vec<State>,
}

impl Occupancy {
    /// What is known between two heights (of voxel centres, world, metres); `None` if nothing is.
    pub fn slice(&self, low_m: f64, high_m: f64) -> Option<Slice> {
        let grid = self.grid();
        let within = |(voxel, _): &(IVec3, State)| (low_m..=high_m).contains(&grid.center(*voxel).z);
        let bounds = self.known().filter(within).fold(None, |bounds, (voxel, _)| {
            let (low, high) = bounds.unwrap_or((voxel, voxel));
            Some((voxel.min(low), voxel.max(high)))
        });
        let (low, high) = bounds?;
        let [width, height] = [high.x - low.x, high.y - low.y].map(|cells| cells as usize + 1);
        let mut cells = vec![State::Unknown; width * height];
        for (voxel, state) in self.known().filter(within) {
            let cell = &mut cells[(voxel.y - low.y) as usize * width + (voxel.x - low.x) as usize];
            if *cell != State::Occupied {
                *cell = state;
            }
        }
        let cell_m = self.config.voxel_size_m;
        Some(Slice {
            origin: low.truncate().as_dvec2() * cell_m,
            cell_m,
            width,
            height,
            cells,
        })
    }
}

impl Slice {
    /// The cost of each cell, 0 to 100: 100 for those that are occupied, falling to 0 for free ones that are `radius_m` from these
    /// (centre to centre), linearly; `None` for unknown ones.
    pub fn costs(&self, radius_m: f64) -> Vec<Option<u8>> {
        let reach = (radius_m / self.cell_m).ceil().clamp(0.0, 1e4) as i64;
        let mut costs = vec![0_u8; self.cells.len()];
        let [width, height] = [self.width, self.height].map(|cells| cells as i64);
        let occupied = self
            .cells
            .iter()
            .enumerate()
            .filter(|(_, state)| **state == State::Occupied);
        for (at, _) in occupied {
            let (x, y) = (at as i64 % width, at as i64 / width);
            for ny in (y - reach).max(0)..=(y + reach).min(height - 1) {
                for nx in (x - reach).max(0)..=(x + reach).min(width - 1) {
                    let distance_m = ((nx - x) as f64).hypot((ny - y) as f64) * self.cell_m;
                    let cost = if (nx, ny) == (x, y) {
                        100
                    } else {
                        // Also of a radius of 0.
                        (99.0 * (1.0 - distance_m / radius_m)).clamp(0.0, 99.0) as u8
                    };
                    let known = &mut costs[(ny * width + nx) as usize];
                    *known = cost.max(*known);
                }
            }
        }
        let cost = |(state, cost): (&State, u8)| (*state != State::Unknown).then_some(cost);
        self.cells.iter().zip(costs).map(cost).collect()
    }
}
