//! Local surface normals (OP), thesis 5.4: every return updates the voxels along the normal of the surface it lies on.
//!
//! Which voxels: within √3·κ/2 of the line through p along n (5.14), within μ of the surface's plane (5.15). What distance:
//! (v − p)·n/μ (5.16), to the plane. What weight: w_θ·w_o·w_n (5.20), by how well the neighbouring faces agree, by range and by
//! incidence.
//!
//! Strong at grazing incidence, where raycasting leaves holes. Weak at edges and on thin parts, which have no normal or a wrong
//! one (thesis 7.4); returns without a normal are not fused, so that less is covered.

use std::{f32::consts::PI, time::Instant};

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};

use super::{
    FuseError, Integration, Integrator,
    beams::{Beams, rings_of},
    cylinder::{EightVoxels, VOXEL_RADIUS},
    engine::Skip,
    lines::{Line, Lines, Rule, Shape},
    placed::Placed,
};
use crate::{
    map::{MapConfig, VoxelMap},
    memory::prefetch,
    normals::{Normal, NormalsConfig, estimate},
    reach::Reach,
    scan::Scan,
    sensor::{ScanImage, SensorModel, approx::acos_f32},
};

/// The integrator along local surface normals.
#[derive(Debug, Default)]
pub struct Normals {
    config: NormalsConfig,
    beams: Beams,
    placed: Placed,
    image: ScanImage,
    normals: Vec<Normal>,
    lines: Lines,
}

impl Normals {
    /// With the given options. Without a sensor's model, the first scan decides which one it is.
    pub fn new(config: NormalsConfig, sensor: Option<SensorModel>) -> Self {
        Self {
            config,
            beams: Beams::new(sensor),
            ..Self::default()
        }
    }
}

impl Integrator for Normals {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        let (grid, placed, image) = (map.grid(), &mut self.placed, &mut self.image);
        if scan.points.is_empty() {
            placed.place(grid, scan)?;
            return Ok(Integration::default());
        }
        scan.check()?;
        let sensor = self.beams.of(scan)?;
        let (done, ()) = rayon::join(
            || placed.place(grid, scan).map(|_| placed.sort(grid)),
            || image.update(&scan.points, &rings_of(scan, sensor), sensor),
        );
        done?;
        let origins = Some(self.placed.origins.as_slice()).filter(|o| !o.is_empty());
        estimate(
            &self.image,
            &self.placed.points,
            origins,
            &self.config,
            &mut self.normals,
        );
        let prepare_secs = start.elapsed().as_secs_f64();

        let reach = map.config().truncation_vox();
        let (placed, normals) = (&self.placed, &self.normals);
        let integration = self.lines.run(
            map,
            &placed.order.numbers,
            #[inline(always)]
            |i| {
                prefetch(&placed.points[i]);
                prefetch(&normals[i]);
            },
            #[inline(always)]
            |i| {
                let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                let Normal { normal, agreement } = normals[i];
                if !normals[i].is_some() {
                    return Err(Skip::WithoutNormal);
                }
                let by_range = 1.0 - ray.range_m / sensor.max_range_m; // (5.18)
                let by_incidence = 1.0 - 2.0 * acos_f32(-ray.direction.dot(normal)) / PI; // (5.19)
                let weight = agreement * by_range * by_incidence; // (5.20); agreement is (5.17)
                if !(weight > 0.0) {
                    return Err(Skip::WithoutWeight);
                }
                Ok(Line {
                    center: ray.end,
                    axis: normal,
                    reach,
                    weight,
                })
            },
            &AlongNormal,
        )?;
        Ok(Integration {
            prepare_secs,
            ..integration
        })
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        true
    }
}

pub(super) struct AlongNormal;

impl Rule for AlongNormal {
    const SHAPE: Shape = Shape::Cylinder;

    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let truncation = line.reach;
        let (weight, inverse) = (f32x8::splat(simd, line.weight), 1.0 / truncation);
        #[inline(always)]
        move |v| (v.within(VOXEL_RADIUS, truncation), v.along * inverse, weight) // (5.14)(5.15)(5.16)
    }
}
