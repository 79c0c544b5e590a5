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

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};
use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator,
    cylinder::{EightVoxels, VOXEL_RADIUS},
    engine::Skip,
    lines::{Line, Lines, Rule, Shape},
    pierced::pierced,
    placed::Placed,
};
use crate::{
    map::{MapConfig, VoxelMap},
    memory::prefetch,
    reach::Reach,
    scan::Scan,
};

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
    lines: Lines,
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
        self.placed.sort(map.grid());
        let prepare_secs = start.elapsed().as_secs_f64();

        let reach = map.config().truncation_vox();
        let (lines, placed) = (&mut self.lines, &self.placed);
        let integration = match self.config.distance {
            Distance::Euclidean => lines.run(
                map,
                &placed.order.numbers,
                |i| prefetch(&placed.points[i]),
                #[inline(always)]
                |i| along(placed, i, reach),
                &Euclidean,
            ),
            Distance::Projective => lines.run(
                map,
                &placed.order.numbers,
                |i| prefetch(&placed.points[i]),
                #[inline(always)]
                |i| along(placed, i, reach),
                &Projective,
            ),
        }?;
        Ok(Integration {
            prepare_secs,
            ..integration
        })
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        false
    }
}

/// The line along a ray, which reaches as far as the truncation.
#[inline(always)]
fn along(placed: &Placed, i: usize, reach: f32) -> Result<Line, Skip> {
    let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
    Ok(Line {
        center: ray.end,
        axis: ray.direction,
        reach,
        weight: (1.0 / ray.range_m).min(1.0), // (5.8)
    })
}

/// The thesis's form.
pub(super) struct Euclidean;

impl Rule for Euclidean {
    const SHAPE: Shape = Shape::RoundedCylinder;

    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (truncation, inverse) = (line.reach, 1.0 / line.reach);
        let weight = f32x8::splat(simd, line.weight);
        #[inline(always)]
        move |v| {
            let inside = v.within(VOXEL_RADIUS, truncation) & v.distance2.simd_le(truncation * truncation);
            let distance = (v.distance2.sqrt() * inverse).copysign(-v.along); // (5.7)
            (inside, distance, weight)
        }
    }
}

/// The related work's form.
pub(super) struct Projective;

impl Rule for Projective {
    const SHAPE: Shape = Shape::Pierced;

    #[inline(always)]
    fn of<S: Simd>(&self, _: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (truncation, inverse) = (line.reach, 1.0 / line.reach);
        // Fully known down to 1.5 voxels behind the surface, enough for the noise of ranges to cancel, or half the band.
        let slope = 1.0 / (truncation - (0.5 * truncation).min(1.5));
        let (axis, weight) = (line.axis, line.weight);
        #[inline(always)]
        move |v| {
            let inside = pierced(axis, v) & v.distance2.simd_le(truncation * truncation);
            let beside = 1.0 - (v.distance2 - v.along * v.along) * (1.0 / (VOXEL_RADIUS * VOXEL_RADIUS));
            let behind = ((truncation - v.along) * slope).max(0.0).min(1.0);
            (inside, -v.along * inverse, beside * weight * (behind * behind))
        }
    }
}
