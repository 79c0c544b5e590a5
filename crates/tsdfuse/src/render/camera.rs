//! Cameras: which ray each pixel of an image looks along.

use glam::{DVec3, Vec3};

use super::RenderError;
use crate::sensor::{Pinhole, Pixel, Projection, SensorModel};

/// What looks at a map. Sensor frame: x forward, y left, z up.
#[derive(Clone, Debug, PartialEq)]
pub enum Camera {
    /// A pinhole camera; depths are along its optical axis.
    Pinhole(Pinhole),
    /// A rotating LiDAR: one row per beam, the highest on top, and one column per firing, starting straight ahead and
    /// continuing clockwise ([`Projection`]). It sees no farther than its model says; depths are ranges.
    Lidar(SensorModel),
}

impl Camera {
    /// Width and height of its image, in pixels.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Pinhole(camera) => (camera.width as usize, camera.height as usize),
            Self::Lidar(model) => (model.columns as usize, model.rings()),
        }
    }

    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// [`RenderError`] passes on what the camera or the sensor model says.
    pub fn check(&self) -> Result<(), RenderError> {
        match self {
            Self::Pinhole(camera) => Ok(camera.check()?),
            Self::Lidar(model) => Ok(model.check()?),
        }
    }

    /// The longest range it measures.
    pub fn max_range_m(&self) -> f32 {
        match self {
            Self::Pinhole(_) => f32::INFINITY,
            Self::Lidar(model) => model.max_range_m,
        }
    }

    /// The rays of its pixels.
    pub fn rays(&self) -> Rays<'_> {
        Rays(match self {
            Self::Pinhole(camera) => Kind::Pinhole(camera),
            Self::Lidar(model) => Kind::Lidar {
                projection: Projection::new(model),
                top: model.rings() - 1,
            },
        })
    }
}

/// The rays of a camera's pixels.
#[derive(Debug)]
pub struct Rays<'a>(Kind<'a>);

#[derive(Debug)]
enum Kind<'a> {
    Pinhole(&'a Pinhole),
    Lidar { projection: Projection, top: usize },
}

impl Rays<'_> {
    /// The unit vector (sensor frame) along which a pixel looks, and the depth of what is seen at range 1 there.
    #[inline]
    pub fn of(&self, column: usize, row: usize) -> (DVec3, f32) {
        match &self.0 {
            Kind::Pinhole(camera) => {
                let ray: Vec3 = camera.ray(column as f32, row as f32);
                let direction = ray.as_dvec3().normalize();
                (direction, direction.x as f32)
            }
            Kind::Lidar { projection, top } => {
                let pixel = Pixel {
                    row: (top - row) as f64,
                    column: column as f64,
                };
                (projection.direction(pixel), 1.0)
            }
        }
    }
}
