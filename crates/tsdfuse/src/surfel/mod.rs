//! The multi-resolution surfel map of one scan (thesis 3.3–3.5, after Droeschel et al.): planar discs, fine ones near the
//! sensor, coarse ones far away.
//!
//! ```text
//!                    sensor   R₀        2R₀                 4R₀
//!      level              o 0  │    1    │         2         │   …     set by the distance from the sensor
//!      edge of a cell     c₀   │   2c₀   │        4c₀        │   …     axis-aligned, one corner at the sensor
//! ```
//!
//! The returns of one level that share a cell make one surfel if there are enough of them. Its centre is their mean, its normal the
//! direction of their smallest variance, and its radius a multiple of their largest standard deviation.

mod cells;
mod config;
mod disc;

use glam::Vec3;
use rayon::prelude::*;

pub use config::{SurfelConfig, SurfelError};
pub use disc::Surfel;

use cells::Cell;

/// The surfels of one scan. Reuse it from scan to scan: it keeps its buffers.
#[derive(Debug, Default)]
pub struct SurfelMap {
    cells: Vec<Cell>,
    groups: Vec<(usize, usize)>,
    surfels: Vec<Surfel>,
    outside: u64,
    too_few: u64,
}

impl SurfelMap {
    /// Replaces the surfels by those of a scan.
    ///
    /// `points` are deskewed: in world axes relative to the sensor's position at the scan's pose, metres. `origins` are where
    /// their rays began, in the same frame; without them all began at zero. `up` is the sensor's z axis in these axes. The
    /// result does not depend on the number of threads.
    pub fn update(&mut self, points: &[Vec3], origins: Option<&[Vec3]>, up: Vec3, config: &SurfelConfig) {
        self.outside = cells::sort(points, config, &mut self.cells);
        self.groups.clear();
        self.too_few = 0;
        let mut first = 0;
        for group in self.cells.chunk_by(|a, b| a.key == b.key) {
            if group.len() >= config.min_points as usize {
                self.groups.push((first, first + group.len()));
            } else {
                self.too_few += group.len() as u64;
            }
            first += group.len();
        }
        let cells = &self.cells;
        let surfels = self.groups.par_iter().map(|&(from, to)| {
            let members = cells[from..to].iter().map(|cell| cell.point as usize);
            disc::surfel(points, origins, members, up, config)
        });
        surfels.collect_into_vec(&mut self.surfels);
    }

    /// The surfels, in the order of their cells: by level, then z, y, x.
    pub fn surfels(&self) -> &[Surfel] {
        &self.surfels
    }

    /// Points that have no cell: not finite, or thousands of kilometres away.
    pub fn outside(&self) -> u64 {
        self.outside
    }

    /// Points in cells that hold fewer than `min_points`.
    pub fn too_few(&self) -> u64 {
        self.too_few
    }
}
