//! Single rays: the surface that a measurement would have hit.

use glam::DVec3;
use rayon::prelude::*;

use super::{Hit, Renderer, walk};

/// A ray through the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it begins, world, metres.
    pub origin: DVec3,
    /// Where it goes, world axes; of any length but 0.
    pub direction: DVec3,
    /// Where it ends, metres from its origin.
    pub length_m: f64,
}

impl Renderer<'_> {
    /// The first surface that each ray hits before it ends, if any; depths are ranges. Rays that begin outside the grid or have no
    /// direction hit nothing.
    pub fn cast(&self, rays: &[Ray]) -> Vec<Option<Hit>> {
        rays.par_iter().map(|ray| self.cast_one(ray)).collect()
    }

    fn cast_one(&self, ray: &Ray) -> Option<Hit> {
        let (base, fraction) = self.map.grid().anchor(ray.origin)?.split();
        let direction = ray.direction.try_normalize()?;
        // Also false for NaN.
        if !(self.field.reaches(base) && ray.length_m > 0.0) {
            return None;
        }
        self.field.meet(&walk::Ray {
            base,
            // Cells begin at the centres of voxels.
            origin: fraction - 0.5,
            direction,
            start: 0.0,
            length: ray.length_m.min(f64::from(self.config.max_range_m)) / self.map.config().voxel_size_m,
            depth_per_range: 1.0,
        })
    }
}
