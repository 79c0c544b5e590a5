//! Surface patches: ours.

use std::time::Instant;

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};
use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator,
    beams::Beams,
    carve::{Carver, Seen},
    cylinder::{Row, VOXEL_RADIUS},
    depth::world_axes,
    gather::Skip,
    lines::{Line, Lines, Rule, Shape},
    placed::{Order, Placed},
};
use crate::{
    map::VoxelMap,
    patch::{Limits, Patches},
    scan::Scan,
    sensor::{ScanImage, SensorModel, rings_of},
};

/// Options of [`Patch`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatchConfig {
    /// Half the edge of the windows in which planes are fitted, metres.
    pub window_m: f32,
    /// Standard deviation of ranges, metres.
    pub noise_m: f32,
    /// How far in front of the surface voxels are updated, in voxels.
    pub reach_vox: f32,
    /// How far behind the surface voxels are updated.
    pub depth_vox: f32,
    /// Behind fall-off start, in voxels.
    pub behind_vox: f32,
    /// Interpolate between neighbours across gaps up to this.
    pub max_gap_m: f32,
    /// Step of interpolated lines, voxels.
    pub step_vox: f32,
    /// Weight of interpolated ones.
    pub fill_weight: f32,
    /// Weight of returns without plane.
    pub ray_weight: f32,
    /// Whether free space erases what is not there any more.
    pub carve: bool,
}

impl Default for PatchConfig {
    fn default() -> Self {
        Self {
            window_m: 0.12,
            noise_m: 0.02,
            reach_vox: 1.5,
            depth_vox: 1.25,
            behind_vox: 1.0,
            max_gap_m: 1.0,
            step_vox: 1.5,
            fill_weight: 0.5,
            ray_weight: 0.3,
            carve: true,
        }
    }
}

/// The integrator of surface patches.
#[derive(Debug, Default)]
pub struct Patch {
    config: PatchConfig,
    beams: Beams,
    placed: Placed,
    image: ScanImage,
    patches: Patches,
    order: Order,
    carver: Carver,
    lines: Lines,
}

impl Patch {
    /// With the given options. Without a sensor's model, the first scan decides which one it is.
    pub fn new(config: PatchConfig, sensor: Option<SensorModel>) -> Self {
        Self {
            config,
            beams: Beams::new(sensor),
            ..Self::default()
        }
    }
}

impl Integrator for Patch {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        let (grid, config) = (map.grid(), self.config);
        let (placed, image) = (&mut self.placed, &mut self.image);
        if scan.points.is_empty() {
            placed.place(grid, scan)?;
            return Ok(Integration::default());
        }
        scan.check()?;
        let sensor = self.beams.of(scan)?;
        let (anchor, ()) = rayon::join(
            || placed.place(grid, scan),
            || image.update(&scan.points, &rings_of(scan, sensor), sensor),
        );
        let anchor = anchor?;
        let voxel_m = map.config().voxel_size_m as f32;
        let limits = Limits {
            window_m: config.window_m,
            noise_m: config.noise_m,
            step_m: config.step_vox * voxel_m,
            max_gap_m: config.max_gap_m,
        };
        let placed = &self.placed;
        self.patches
            .update(&self.image, &placed.points, &placed.origins, sensor, &limits);
        let (returns, patches) = (placed.len(), &self.patches.all);
        let at = |i: usize| match placed.points.get(i) {
            Some(point) if !patches[i].is_some() => *point,
            _ => patches[i].center,
        };
        self.order.sort(grid, anchor, patches.len(), at);
        let prepare_secs = start.elapsed().as_secs_f64();

        let truncation = map.config().truncation_vox();
        let integration = self.lines.run(
            map,
            &self.order.numbers,
            #[inline(always)]
            |i| {
                let patch = patches[i];
                if i < returns && !patch.is_some() {
                    let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                    let weight = config.ray_weight * (1.0 / ray.range_m).min(1.0);
                    return Ok(Line { center: ray.end, axis: -ray.direction, weight });
                }
                let range_m = patch.center.length();
                let cosine = -patch.center.dot(patch.normal) / range_m;
                let kind = if i < returns { 1.0 } else { config.fill_weight };
                Ok(Line {
                    center: anchor.locate(patch.center).ok_or(Skip::OutsideGrid)?,
                    axis: patch.normal,
                    weight: kind * (1.0 / range_m).min(1.0) * cosine.max(0.0),
                })
            },
            &AlongPatch {
                truncation,
                reach: config.reach_vox.min(truncation),
                depth: config.depth_vox,
                behind: config.behind_vox,
            },
        );
        let mut integration = integration;
        if config.carve {
            let seen = Seen {
                image: &self.image,
                placed,
                patches,
                anchor,
                sensor_from_world: world_axes(scan).transpose(),
            };
            let carved = self.carver.carve(map, &seen, sensor);
            integration.updated_blocks.extend(carved);
        }
        Ok(Integration {
            prepare_secs,
            ..integration
        })
    }
}

/// Along a patch's normal, or against the ray where there is no patch.
struct AlongPatch {
    truncation: f32,
    reach: f32,
    depth: f32,
    behind: f32,
}

impl Rule for AlongPatch {
    const SHAPE: Shape = Shape::Cylinder;

    #[inline(always)]
    fn of<S: Simd>(&self, _: S, line: &Line) -> impl Fn(&Row<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (reach, inverse, weight) = (self.reach, 1.0 / self.truncation, line.weight);
        let depth = self.depth;
        let slope = 1.0 / (depth + 0.5 - self.behind.min(depth));
        #[inline(always)]
        move |v| {
            let behind = ((depth + 0.5 + v.along) * slope).max(0.0).min(1.0);
            (
                v.within(VOXEL_RADIUS, reach) & v.along.simd_ge(-depth),
                v.along * inverse,
                behind * weight,
            )
        }
    }
}
