//! Raycasting (RC), thesis 5.3: every return updates the voxels about its ray, within the band around its end.
//!
//! Which voxels: dist(v, ray) < √3·κ/2 (5.5)(5.6) and ‖v − p‖ ≤ μ. What distance: ±‖v − p‖/μ (5.7), signed by the side on
//! which the voxel lies; or, as `projective`, the distance along the ray. What weight: min(1, 1/range) (5.8).
//!
//! Strong where surfaces are hit head-on. Weak at grazing incidence: the distance along the ray overstates the distance to
//! the surface by 1/cos of the incidence, and the band then covers little height (thesis 7.3).

use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator,
    cylinder::{Cylinder, VOXEL_RADIUS},
    placed::Placed,
    scatter::{Scatter, Skip},
};
use crate::{map::VoxelMap, scan::Scan};

/// What is stored for a voxel beside the ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Distance {
    /// ±‖v − p‖/μ, the thesis's (5.7): never 0 off the ray.
    #[default]
    Euclidean,
    /// (p − v)·r/μ, the distance along the ray r.
    Projective,
}

/// Options of [`Raycast`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RaycastConfig {
    /// Which distance is stored.
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
        let placed = &self.placed;
        let distance = self.config.distance;
        let scattered = self.scatter.run(map, placed.len(), |i, lane| {
            let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
            let weight = (1.0 / ray.range_m).min(1.0); // (5.8)
            let about = Cylinder {
                center: ray.end,
                axis: ray.direction,
                radius: VOXEL_RADIUS,
                half_length: truncation,
            };
            lane.cylinder(&about, weight, |v| {
                if v.distance2 > truncation * truncation {
                    return None;
                }
                Some(match distance {
                    Distance::Euclidean => -v.along.signum() * v.distance2.sqrt() / truncation, // (5.7)
                    Distance::Projective => -v.along / truncation,
                })
            })
        });
        Ok(Integration {
            updated_blocks: scattered.updated_blocks,
            fused_returns: scattered.fused,
            skipped: scattered.skipped,
            prepare_secs,
        })
    }
}
