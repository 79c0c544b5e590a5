//! Views of a map: the zero level of its field, met by a ray for each pixel (thesis 5.1, as in InfiniTAM).
//!
//! ```
//! use tsdfuse::render::{Camera, ImageKind, Renderer};
//! use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3, sensor::Pinhole};
//! # let wall = (-30..30).flat_map(|y| (-20..20).map(move |z| Vec3::new(4.0, 0.03 * y as f32, 0.03 * z as f32)));
//! # let mut map = VoxelMap::new(MapConfig::default())?;
//! # Raycast::default().integrate(&mut map, &Scan { points: wall.collect(), ..Default::default() })?;
//!
//! let renderer = Renderer::new(&map, &Default::default())?; // once for any number of views
//! let camera = Camera::Pinhole(Pinhole::with_fov(64, 48, 0.2));
//! let view = renderer.view(&camera, Pose::IDENTITY)?;
//! let hit = view.hit(32, 24).ok_or("nothing ahead")?;
//! assert!((hit.depth_m - 4.0).abs() < 0.01 && hit.normal.x < -0.9);
//! let picture = view.image(ImageKind::Shaded); // pixels; `tsdfuse_io::png` writes them
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **What is seen.** Between eight neighbouring voxel centres that were all observed the field is trilinear; a ray ends where
//! it first falls from F ≥ 0 to F < 0, found exactly. Nothing is seen where one of the eight was never observed, so views
//! invent no surface, and they show the very cells that [`crate::mesh`] makes triangles of.
//!
//! **What is not.** From behind (F rises from negative to positive) a ray passes, as in InfiniTAM: walls and ceilings that were
//! only seen from the inside are transparent from the outside, so that one can look into a room from above.

mod camera;
mod cast;
mod cell;
mod field;
mod image;
mod orbit;
mod renderer;
#[cfg(test)]
mod tests;
mod tree;
mod view;
mod walk;

use serde::{Deserialize, Serialize};

use crate::pose::PoseError;
use crate::sensor::{PinholeError, SensorError};
use crate::{Pose, VoxelMap};

pub use camera::{Camera, Rays};
pub use cast::Ray;
pub use image::{DEPTH_PER_M, Image, ImageKind, Pixels, WEIGHT_RANGE};
pub use orbit::{overview, turntable};
pub use renderer::Renderer;
pub use view::{Hit, View};

/// What is seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderConfig {
    /// Voxels of less weight count as never observed.
    pub min_weight: f32,
    /// What is farther from the camera is not seen.
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

/// What a camera sees of a map from a pose (`world_from_camera`); for several views, see [`Renderer`].
///
/// # Errors
/// See [`Renderer::new`] and [`Renderer::view`].
pub fn render(
    map: &VoxelMap,
    camera: &Camera,
    world_from_camera: Pose,
    config: &RenderConfig,
) -> Result<View, RenderError> {
    Renderer::new(map, config)?.view(camera, world_from_camera)
}
