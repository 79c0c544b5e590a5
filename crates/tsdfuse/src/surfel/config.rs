//! How a scan becomes surfels.

use serde::{Deserialize, Serialize};

/// How a scan becomes surfels.
///
/// The defaults suit a rotating LiDAR: cells of 0.25 m up to 16 m, doubling to 4 m beyond 128 m. At long range, a cell then
/// subtends 0.9° to 1.8°, a few scan lines and firings. In an evenly covered cell, a radius of two standard deviations makes a disc
/// of about the area of the cell. One and a half cover nearly as much of the surface and extend less beyond its edges; one is what
/// the thesis says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SurfelConfig {
    /// c₀, the edge of a cell of level 0; it doubles from level to level.
    pub finest_cell_m: f32,
    /// R₀, the distance from the sensor up to which cells are of level 0; it doubles from level to level.
    pub finest_range_m: f32,
    /// The number of levels. The last level has no outer limit.
    pub levels: u32,
    /// Cells with fewer returns make no surfel.
    pub min_points: u32,
    /// The radius of a surfel, in standard deviations along its longest axis. 1 is the thesis's literal form.
    pub radius_sigmas: f32,
    /// Thesis 7.5: surfels below the sensor that face down, both in the sensor's own axes, are flipped. For vehicles on a road.
    pub ground_flip: bool,
}

impl Default for SurfelConfig {
    fn default() -> Self {
        Self {
            finest_cell_m: 0.25,
            finest_range_m: 16.0,
            levels: 5,
            min_points: 5,
            radius_sigmas: 1.5,
            ground_flip: false,
        }
    }
}

/// More levels than any range needs.
const MAX_LEVELS: u32 = 12;

/// The largest cell; it bounds how many voxels a surfel can touch.
const MAX_CELL_M: f32 = 32.0;

/// Why a configuration of the surfels cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SurfelError {
    /// Cells have a size, and the largest is limited.
    #[error(
        "surfel.finest_cell_m is {finest} and surfel.levels {levels}; cells of above 0 to {MAX_CELL_M} m on 1 to {MAX_LEVELS} levels are possible"
    )]
    Cells {
        /// c₀.
        finest: f32,
        /// The levels.
        levels: u32,
    },
    /// A distance.
    #[error("surfel.finest_range_m is {0}; a distance above 0 is possible")]
    Range(f32),
    /// A plane has three points.
    #[error("surfel.min_points is {0}; at least 3 are possible")]
    MinPoints(u32),
    /// A radius is a few standard deviations.
    #[error("surfel.radius_sigmas is {0}; above 0 to 4 is possible")]
    Radius(f32),
}

impl SurfelConfig {
    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// The reason, naming the field.
    pub fn validate(&self) -> Result<(), SurfelError> {
        let (finest, levels) = (self.finest_cell_m, self.levels);
        // All of these are false for NaN.
        if !((1..=MAX_LEVELS).contains(&levels) && finest > 0.0 && self.cell_m(levels - 1) <= MAX_CELL_M) {
            return Err(SurfelError::Cells { finest, levels });
        }
        if !(self.finest_range_m > 0.0 && self.finest_range_m.is_finite()) {
            return Err(SurfelError::Range(self.finest_range_m));
        }
        if self.min_points < 3 {
            return Err(SurfelError::MinPoints(self.min_points));
        }
        if !(self.radius_sigmas > 0.0 && self.radius_sigmas <= 4.0) {
            return Err(SurfelError::Radius(self.radius_sigmas));
        }
        Ok(())
    }

    /// The level of a point at this squared distance from the sensor: the smallest l with distance ≤ R₀·2ˡ, or the last.
    #[inline]
    pub(crate) fn level(&self, distance2: f32) -> u32 {
        let mut level = 0;
        let mut range2 = self.finest_range_m * self.finest_range_m;
        while distance2 > range2 && level + 1 < self.levels {
            level += 1;
            range2 *= 4.0;
        }
        level
    }

    /// The edge of the cells of a level.
    #[inline]
    pub(crate) fn cell_m(&self, level: u32) -> f32 {
        self.finest_cell_m * (1_u32 << level) as f32
    }
}
