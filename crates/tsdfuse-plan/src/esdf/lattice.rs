//! Lengths as integers.
//!
//! ```text
//!   │ voxel         │ voxel         │
//!   │ cell  │ cell  │ cell  │ cell  │    a site's x and y are those of its cell's middle
//!   │ u steps       │               │    its z, and all distances, are in steps
//! ```

use super::EsdfConfig;
use crate::error::{PlanError, check_voxel_size};

/// Cells along the edge of a voxel.
pub(super) const CELLS: i32 = 2;
/// The largest distance in steps: its square fits an `i16`.
const MAX_STEPS: f64 = 181.0;
/// Steps along the edge of a voxel: at most, and at least. A power of two, so that the middles of cells are whole steps.
const STEPS: [i32; 2] = [16, 4];

/// How lengths become integers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    pub(super) voxel_size_m: f64,
    /// Steps along the edge of a voxel.
    pub(super) steps: i32,
    /// The radius in steps, rounded up.
    pub(super) radius_steps: i32,
    /// The square of the radius in steps, rounded down.
    pub(super) max_squared: i16,
}

impl Lattice {
    pub(super) fn new(config: &EsdfConfig) -> Result<Self, PlanError> {
        let EsdfConfig { voxel_size_m, radius_m } = *config;
        check_voxel_size(voxel_size_m)?;
        let voxels = radius_m / voxel_size_m;
        let [mut steps, least] = STEPS;
        while steps > least && voxels * f64::from(steps) > MAX_STEPS {
            steps /= 2;
        }
        let radius = voxels * f64::from(steps);
        if !(voxels >= 1.0 && radius <= MAX_STEPS) {
            let most = (MAX_STEPS / f64::from(least)).floor();
            return Err(PlanError::new(
                "radius_m",
                radius_m,
                format!("1 to {most} voxels of {voxel_size_m} m"),
            ));
        }
        Ok(Self {
            voxel_size_m,
            steps,
            radius_steps: radius.ceil() as i32,
            max_squared: (radius * radius) as i16,
        })
    }

    /// The steps from one cell to the next.
    pub(super) fn cell_steps(&self) -> i32 {
        self.steps / CELLS
    }

    /// The cells that the radius reaches beyond a voxel.
    pub(super) fn reach_cells(&self) -> i32 {
        self.radius_steps / self.cell_steps() + 1
    }

    /// Steps in a metre.
    pub(super) fn steps_per_m(&self) -> f64 {
        f64::from(self.steps) / self.voxel_size_m
    }

    /// A distance whose square is given in steps.
    pub(super) fn metres(&self, squared: i16) -> f32 {
        f32::from(squared).sqrt() * (self.voxel_size_m / f64::from(self.steps)) as f32
    }
}
