//! Options of views, and errors.

use serde::{Deserialize, Serialize};

use super::tree;
use crate::pose::PoseError;
use crate::sensor::{PinholeError, SensorError};

/// Options of views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderConfig {
    /// Voxels with less weight count as unobserved.
    pub min_weight: f32,
    /// Surface farther from the camera is not seen, metres.
    pub max_range_m: f32,
}

impl Default for RenderConfig {
    fn default() -> Self {
        Self {
            min_weight: 0.0,
            max_range_m: 10_000.0,
        }
    }
}

/// Why there is no view.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// A weight is 0 or more.
    #[error("min_weight must be 0 or more, not {0}")]
    MinWeight(f32),
    /// A range is positive.
    #[error("max_range_m must be a positive length in metres, not {0}")]
    MaxRange(f32),
    /// These numbers are no camera.
    #[error(transparent)]
    Pinhole(#[from] PinholeError),
    /// These numbers are no sensor.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// These numbers are no pose.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The camera is not where voxels can be.
    #[error("the camera is outside of the map's grid, at {0:?} m")]
    Outside([f64; 3]),
    /// Cells are numbered with 30 bits along each axis.
    #[error("the surface of the map is wider than {} voxels", tree::MAX_SPAN)]
    TooWide,
}

impl RenderConfig {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`RenderError`] names the field and its value.
    pub fn validate(&self) -> Result<(), RenderError> {
        if !(self.min_weight >= 0.0 && self.min_weight.is_finite()) {
            return Err(RenderError::MinWeight(self.min_weight));
        }
        if !(self.max_range_m > 0.0 && self.max_range_m.is_finite()) {
            return Err(RenderError::MaxRange(self.max_range_m));
        }
        Ok(())
    }
}
