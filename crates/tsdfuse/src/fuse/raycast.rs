//! Raycasting (RC), thesis 5.3: every return updates the voxels on its ray, within the band around its end.
//!
//! | | `euclidean`: the thesis's form | `projective`: the form of the related work |
//! |---|---|---|
//! | which voxels | centre within √3·κ/2 of the ray (5.5)(5.6), within μ of p | those the ray passes through, within μ of p |
//! | distance | ±‖v − p‖/μ, signed by the side of p (5.7) | (p − v)·r/μ, along the ray |
//! | weight | min(1, 1/range) (5.8) | the same × how much the ray tells about this voxel (below) |
//!
//! The thesis's distance is never 0 off the ray, and its voxels behind the surface count as much as those in front, although
//! nothing was seen there: from the other side of a thin wall they pull the surface out. The projective form weighs a voxel
//! by its distance e from the ray, 1 − e²/(¾κ²), and less the deeper it lies behind the surface: fully down to 1.5 voxels,
//! then falling as the square of what is left of the band (voxblox, Oleynikova et al. 2017, does so linearly).
//!
//! Strong where surfaces are hit head-on. Weak at grazing incidence: the distance along the ray overstates the distance to
//! the surface by 1/cos of the incidence, and the band then covers little height (thesis 7.3).

use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator,
    cylinder::{Cylinder, VOXEL_RADIUS},
    pierced::Segment,
    placed::Placed,
    scatter::{Scatter, Skip},
};
use crate::{map::VoxelMap, scan::Scan};

/// The two forms of raycasting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Distance {
    /// The thesis's.
    #[default]
    Euclidean,
    /// The related work's.
    Projective,
}

/// Options of [`Raycast`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RaycastConfig {
    /// Which form.
    pub distance: Distance,
}

/// The raycasting integrator.
#[derive(Debug, Default)]
pub struct Raycast {
    config: RaycastConfig,
    placed: Placed,
    scatter: Scatter,
}

impl Raycast {
    /// Raycasting with the given options.
    pub fn new(config: RaycastConfig) -> Self {
        Self {
            config,
            ..Self::default()
        }
    }
}

impl Integrator for Raycast {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        self.placed.place(map.grid(), scan)?;
        let prepare_secs = start.elapsed().as_secs_f64();

        let truncation = map.config().truncation_vox();
        let inverse = 1.0 / truncation;
        let behind = Behind::new(truncation);
        let placed = &self.placed;
        let integration = match self.config.distance {
            Distance::Euclidean => self.scatter.run(map, placed.len(), |i, lane| {
                let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                let weight = weight(ray.range_m);
                let about = Cylinder {
                    center: ray.end,
                    axis: ray.direction,
                    radius: VOXEL_RADIUS,
                    half_length: truncation,
                };
                lane.approach(about.lowest_voxel());
                about.for_each(|v| {
                    if v.distance2 <= truncation * truncation {
                        let f = -v.along.signum() * v.distance2.sqrt() * inverse; // (5.7)
                        lane.update(v.voxel, f, weight);
                    }
                });
                Ok(())
            }),
            Distance::Projective => self.scatter.run(map, placed.len(), |i, lane| {
                let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                let weight = weight(ray.range_m);
                let on = Segment {
                    center: ray.end,
                    axis: ray.direction,
                    half_length: truncation,
                };
                lane.approach(on.lowest_voxel());
                on.for_each(|v| {
                    let off_axis2 = v.distance2 - v.along * v.along;
                    let beside = 1.0 - off_axis2 * (1.0 / (VOXEL_RADIUS * VOXEL_RADIUS));
                    lane.update(v.voxel, -v.along * inverse, weight * beside * behind.factor(v.along));
                });
                Ok(())
            }),
        };
        Ok(Integration {
            prepare_secs,
            ..integration
        })
    }
}

/// The weight of a return (5.8).
#[inline]
fn weight(range_m: f32) -> f32 {
    (1.0 / range_m).min(1.0)
}

/// How much is known about voxels behind the surface.
#[derive(Clone, Copy)]
struct Behind {
    truncation: f32,
    slope: f32,
}

impl Behind {
    /// For a band of `truncation` voxels: fully known down to 1.5 voxels, enough for the noise of ranges to cancel, or half the
    /// band if that is less.
    fn new(truncation: f32) -> Self {
        Self {
            truncation,
            slope: 1.0 / (truncation - (0.5 * truncation).min(1.5)),
        }
    }

    /// The factor at `depth` voxels behind the surface (in front: negative), 1 … 0.
    #[inline]
    fn factor(self, depth: f32) -> f32 {
        ((self.truncation - depth) * self.slope).clamp(0.0, 1.0).powi(2)
    }
}
