//! The configuration of a map.

use serde::{Deserialize, Serialize};

use super::{
    block::{MAX_WEIGHT, WEIGHT_SCALE},
    error::MapError,
};

/// Size of voxels and of the band around the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapConfig {
    /// κ, the edge of a voxel.
    pub voxel_size_m: f64,
    /// μ, half the width of the band around the surface in which distances are stored.
    pub truncation_m: f64,
    /// W_max: weights are limited to this, so that the map follows changes. At most [`MAX_WEIGHT`], which is the default.
    pub max_weight: f32,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.05,
            truncation_m: 0.20,
            max_weight: MAX_WEIGHT,
        }
    }
}

impl MapConfig {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`MapError`] names the field and its value.
    pub fn validate(&self) -> Result<(), MapError> {
        for (name, value) in [("voxel_size_m", self.voxel_size_m), ("truncation_m", self.truncation_m)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(MapError::Length { name, value });
            }
        }
        if !(1.0..=64.0).contains(&(self.truncation_m / self.voxel_size_m + 1e-9)) {
            return Err(MapError::Truncation {
                truncation_m: self.truncation_m,
                voxel_size_m: self.voxel_size_m,
            });
        }
        if !(self.max_weight > 0.0 && self.max_weight <= MAX_WEIGHT) {
            return Err(MapError::MaxWeight(self.max_weight));
        }
        Ok(())
    }

    /// Checks that voxels of two maps mean the same.
    ///
    /// # Errors
    /// [`MapError::Differ`] names the first field that differs.
    pub fn check_same(&self, other: &Self) -> Result<(), MapError> {
        let fields = [
            ("voxel_size_m", self.voxel_size_m, other.voxel_size_m),
            ("truncation_m", self.truncation_m, other.truncation_m),
            ("max_weight", self.max_weight.into(), other.max_weight.into()),
        ];
        match fields.into_iter().find(|(_, a, b)| a != b) {
            Some((name, a, b)) => Err(MapError::Differ { name, a, b }),
            None => Ok(()),
        }
    }

    /// The largest weight sum (fixed point, [`WEIGHT_SCALE`]) that a voxel holds: [`Self::max_weight`].
    pub fn max_weight_sum(&self) -> u32 {
        ((f64::from(self.max_weight) * f64::from(WEIGHT_SCALE)).round() as u32).max(1)
    }

    /// μ/κ, the truncation in voxels.
    pub fn truncation_vox(&self) -> f32 {
        (self.truncation_m / self.voxel_size_m) as f32
    }
}
