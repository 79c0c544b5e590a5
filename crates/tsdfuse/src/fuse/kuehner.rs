//! Cylindrical projection as published by Kühner and Kümmerle (2020; thesis 4.2).
//!
//! A scan becomes a cylindrical depth image with square pixels. Its **centre of projection** is the point on the sensor's axis
//! with the smallest sum of squared distances to all rays. An empty pixel takes the depth of the nearest measured pixel in its
//! column, up to half the gap between neighbouring beams away; gaps wider than `max_gap_deg` are filled only that far.
//!
//! Which voxels: **all** voxels whose centre lies in the frustum of a filled pixel and within μ of its range. No voxel is missed
//! at long range, where rays are more than a voxel apart. What distance: (range of the pixel − range of the voxel)/μ, measured
//! from the centre of projection. What weight: min(1, 1/range).
//!
//! Strong at long range: the ground between two rings is closed. Weak at edges, which move by up to half of what is filled, and
//! at grazing incidence: the range of a ring is constant over what it fills, so that the ground becomes a staircase.

use std::time::Instant;

use fearless_simd::{Simd, dispatch, f32x8, prelude::*};
use glam::{Mat3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator, Skipped,
    beams::{Beams, rings_of},
    centers::{Centers, depths_at},
    depth::world_axes,
    engine::Skip,
    gather::{Gather, Near, ROW, Updates},
    placed::Placed,
};
use crate::{
    index::{Anchor, BLOCK_EDGE, BlockIndex, Grid},
    map::{MapConfig, VoxelMap},
    reach::Reach,
    scan::Scan,
    sensor::{CylindricalPoint, CylindricalProjection as Cylindrical, PART, SensorModel, approx::sin_cos},
};

/// Options of [`Kuehner`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KuehnerConfig {
    /// Gaps between neighbouring beams are filled up to this width, half of it from each side. Wider gaps keep a hole in the
    /// middle. 0 fills nothing, 180 fills all gaps.
    pub max_gap_deg: f32,
}

impl Default for KuehnerConfig {
    /// One pixel above and below the beams of most sensors. Simulated streets and halls, with sensors of 32, 64 and 128 beams, have
    /// half the error or less than at 1°, and more of the surface within 5 cm.
    fn default() -> Self {
        Self { max_gap_deg: 0.5 }
    }
}

impl KuehnerConfig {
    /// Checks the number, which may come from a file.
    ///
    /// # Errors
    /// [`FuseError::Config`] names the field and what is possible.
    pub fn validate(&self) -> Result<(), FuseError> {
        // Also false for NaN.
        if (0.0..=180.0).contains(&self.max_gap_deg) {
            return Ok(());
        }
        Err(FuseError::Config(format!(
            "kuehner.max_gap_deg is {}; 0 to 180 are possible",
            self.max_gap_deg
        )))
    }
}

/// The integrator of dense cylindrical depth images.
#[derive(Debug, Default)]
pub struct Kuehner {
    config: KuehnerConfig,
    beams: Beams,
    placed: Placed,
    seen: Vec<CylindricalPoint>,
    /// Of the image.
    depths_m: Vec<f32>,
    rings: Vec<u16>,
    gather: Gather,
}

impl Kuehner {
    /// With the given options. Without a sensor's model, the first scan decides which one it is.
    pub fn new(config: KuehnerConfig, sensor: Option<SensorModel>) -> Self {
        Self {
            config,
            beams: Beams::new(sensor),
            ..Self::default()
        }
    }

    /// The image of a scan with its measured pixels only.
    pub(super) fn project(&mut self, grid: Grid, scan: &Scan) -> Result<(Anchor, Image), FuseError> {
        scan.check()?;
        let sensor = self.beams.of(scan)?;
        let rings = rings_of(scan, sensor);
        let buffers = (std::mem::take(&mut self.depths_m), std::mem::take(&mut self.rings));
        let (placed, max_gap_deg) = (&mut self.placed, self.config.max_gap_deg);
        let (anchor, mut image) = rayon::join(
            || placed.place(grid, scan),
            || Image::new(scan, &rings, sensor, max_gap_deg, buffers),
        );
        let anchor = anchor?;
        let sensor_from_world = world_axes(scan)?.transpose();
        let seen = &mut self.seen;
        image
            .projection
            .project_all(&self.placed.points, |p| sensor_from_world * p, seen);
        image.render(seen, &rings);
        Ok((anchor, image))
    }
}

impl Integrator for Kuehner {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        if scan.points.is_empty() {
            self.placed.place(map.grid(), scan)?;
            return Ok(Integration::default());
        }
        let (anchor, mut image) = self.project(map.grid(), scan)?;
        image.fill();
        let config = *map.config();
        image.check_size(scan, &config)?;
        let world_from_sensor = world_axes(scan)?;
        let prepare_secs = start.elapsed().as_secs_f64();

        let centers = Centers {
            anchor,
            origin: Vec3::ZERO,
            rotation: world_from_sensor.transpose(),
            voxel_size_m: config.voxel_size_m as f32,
        };
        let level = self.gather.level();
        let mut done = self.gather.run(
            map,
            image.projection.columns(),
            |columns, near| {
                dispatch!(level, _ => for column in columns {
                    let done = image.allocate(column, &anchor, world_from_sensor, &config, near);
                    near.count(done);
                });
            },
            |_| false,
            |block, _, updates| {
                dispatch!(level, simd => image.update(simd, block, &centers, config.truncation_m as f32, updates));
            },
        );
        done.skipped = image.skipped;
        done.fused_returns = scan.points.len() as u64 - image.skipped.hidden - image.skipped.outside_image;
        done.prepare_secs = prepare_secs;
        (self.depths_m, self.rings) = (image.depths_m, image.rings);
        Ok(done)
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        true
    }
}

/// The height on the sensor's axis (metres) with the smallest sum of squared distances to all rays.
///
/// The ray of a beam with elevation e to a point at height z, ρ away from the axis, crosses the axis at z − ρ·tan e. Its distance
/// from the height c on the axis is |z − ρ·tan e − c|·cos e.
fn center_of_projection(points: &[Vec3], rings: &[u16], sensor: &SensorModel) -> f32 {
    let of_beam = |degrees: &f32| {
        let (sin, cos) = sin_cos(f64::from(*degrees).to_radians());
        (sin / cos, cos * cos)
    };
    let beams: Vec<(f64, f64)> = sensor.elevations_deg.iter().map(of_beam).collect();
    let sums = points
        .par_chunks(PART)
        .zip(rings.par_chunks(PART))
        .map(|(points, rings)| {
            let (mut heights, mut weights) = (0.0, 0.0);
            for (point, &ring) in points.iter().zip(rings) {
                let p = point.as_dvec3();
                // Not true for NaN.
                let valid = point.length() <= sensor.max_range_m;
                if let Some((tan, cos2)) = beams.get(usize::from(ring)).filter(|_| valid) {
                    heights += cos2 * (p.z - p.truncate().length() * tan);
                    weights += cos2;
                }
            }
            (heights, weights)
        });
    // Added in order, so that the result does not depend on the threads.
    let sums: Vec<(f64, f64)> = sums.collect();
    let (heights, weights) = sums
        .iter()
        .fold((0.0, 0.0), |sum, part| (sum.0 + part.0, sum.1 + part.1));
    if weights > 0.0 { (heights / weights) as f32 } else { 0.0 }
}

/// The boxes around all frusta of an image may hold this many voxels. Those of a street, at 5 cm, hold a fiftieth. Near the limit,
/// a scan takes seconds and gigabytes.
const MAX_VOXELS: f64 = 5e8;

/// A cylindrical depth image: ρ per pixel, 0 for an empty one, column by column.
#[derive(Debug)]
pub(super) struct Image {
    pub(super) projection: Cylindrical,
    depths_m: Vec<f32>,
    /// The beam that measured a pixel.
    rings: Vec<u16>,
    /// How many rows each beam fills above and below itself.
    reach: Vec<[f32; 2]>,
    skipped: Skipped,
}

impl Image {
    /// An empty image for a scan; it reuses two buffers.
    fn new(
        scan: &Scan,
        rings: &[u16],
        sensor: &SensorModel,
        max_gap_deg: f32,
        (mut depths_m, mut of_ring): (Vec<f32>, Vec<u16>),
    ) -> Self {
        let center_z_m = center_of_projection(&scan.points, rings, sensor);
        let pitch = std::f32::consts::TAU / sensor.columns as f32;
        let half_gap = |pair: &[f32]| {
            let tangent = pair[1].to_radians().tan() - pair[0].to_radians().tan();
            0.5 * tangent / pitch * (max_gap_deg / (pair[1] - pair[0])).min(1.0)
        };
        let halves: Vec<f32> = sensor.elevations_deg.windows(2).map(half_gap).collect();
        // The outermost beams reach as far outwards as inwards.
        let half = |k: usize| halves.get(k).or(halves.last()).copied().unwrap_or(0.0);
        let reach: Vec<[f32; 2]> = (0..sensor.rings())
            .map(|ring| [half(ring), half(ring.saturating_sub(1))])
            .collect();
        let margin = reach
            .first()
            .map_or(0.0, |r| r[1])
            .max(reach.last().map_or(0.0, |r| r[0]))
            * pitch;
        let phase = Cylindrical::phase_of(&scan.points, sensor.columns);
        let projection = Cylindrical::new(sensor, center_z_m, phase, margin);
        let pixels = projection.rows() * projection.columns();
        depths_m.clear();
        depths_m.resize(pixels, 0.0);
        of_ring.resize(pixels, 0); // only those with a depth are looked at
        Self {
            projection,
            depths_m,
            rings: of_ring,
            reach,
            skipped: Skipped::default(),
        }
    }

    /// Enters the returns. The nearest return of a pixel stays.
    fn render(&mut self, seen: &[CylindricalPoint], rings: &[u16]) {
        for (&seen, &ring) in seen.iter().zip(rings) {
            let pixel = self
                .projection
                .pixel(seen)
                .filter(|_| usize::from(ring) < self.reach.len());
            let Some((row, column)) = pixel else {
                self.skipped.outside_image += 1;
                continue;
            };
            let pixel = column * self.projection.rows() + row;
            let depth = &mut self.depths_m[pixel];
            self.skipped.hidden += u64::from(*depth > 0.0);
            if *depth == 0.0 || seen.depth_m < *depth {
                (*depth, self.rings[pixel]) = (seen.depth_m, ring);
            }
        }
    }

    /// Gives each empty pixel the depth of the nearest measured pixel of its column that reaches so far, the upper one of two.
    pub(super) fn fill(&mut self) {
        let rows = self.projection.rows();
        let columns = self.depths_m.par_chunks_mut(rows).zip(self.rings.par_chunks(rows));
        let reach = &self.reach;
        columns.with_min_len(64).for_each_init(
            || vec![(f32::INFINITY, 0.0); rows],
            |nearest, (depths, rings)| {
                nearest.fill((f32::INFINITY, 0.0));
                for (measured, &depth) in depths.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
                    let [above, below] = reach[usize::from(rings[measured])];
                    let first = (measured as f32 - above).ceil().max(0.0) as usize;
                    let last = ((measured as f32 + below) as usize).min(rows - 1);
                    for (row, best) in nearest.iter_mut().enumerate().take(last + 1).skip(first) {
                        let distance = measured.abs_diff(row) as f32;
                        if distance < best.0 {
                            *best = (distance, depth);
                        }
                    }
                }
                depths.iter_mut().zip(nearest).for_each(|(depth, best)| *depth = best.1);
            },
        );
    }

    /// The depth of a pixel, metres; 0 if it is empty.
    pub(super) fn depth_m(&self, row: usize, column: usize) -> f32 {
        self.depths_m[column * self.projection.rows() + row]
    }

    /// Refuses an image whose frusta are so large that they would fill memory: far beyond the ranges of a LiDAR, a pixel is
    /// many metres wide.
    fn check_size(&self, scan: &Scan, config: &MapConfig) -> Result<(), FuseError> {
        let (pitch, band) = (f64::from(self.projection.pitch()), 2.0 * config.truncation_m);
        let frustum = |depth: &f32| {
            let edge = f64::from(*depth) * pitch;
            edge * edge * (edge + band)
        };
        let voxels = self.depths_m.iter().map(frustum).sum::<f64>() / config.voxel_size_m.powi(3);
        if voxels <= MAX_VOXELS {
            return Ok(());
        }
        let farthest_m = self.depths_m.iter().copied().fold(0.0, f32::max);
        Err(FuseError::Image {
            scan: scan.name.clone(),
            reason: format!(
                "its pixels, seen from the scan's pose up to {farthest_m:.0} m away, span {voxels:.1e} voxels, more than {MAX_VOXELS:e}: \
                 its motion goes too far within the sweep, its ranges are too long, or voxels are too small"
            ),
        })
    }

    /// Names the blocks that may hold voxels of a column's pixels.
    #[inline(always)]
    fn allocate(
        &self,
        column: usize,
        anchor: &Anchor,
        world_from_sensor: Mat3,
        config: &MapConfig,
        near: &mut Near<()>,
    ) -> Result<(), Skip> {
        let rows = self.projection.rows();
        let center = world_from_sensor * (Vec3::Z * self.projection.center_z_m());
        let truncation_m = config.truncation_m as f32;
        let block_m = BLOCK_EDGE as f32 * config.voxel_size_m as f32;
        let depths = &self.depths_m[column * rows..(column + 1) * rows];
        let (mut next, mut named) = (0, None);
        while next < rows {
            // A run of pixels of one depth, at most as high as a block.
            let (first, depth) = (next, depths[next]);
            let most = 1 + (block_m / (depth * self.projection.pitch())).min(rows as f32) as usize;
            let same = depths[first..].iter().take(most).take_while(|d| **d == depth);
            next += same.count().max(1);
            if depth == 0.0 {
                continue;
            }
            // Depths differ by no more than ranges, so by no more than μ.
            let (nearest, farthest) = ((depth - truncation_m).max(0.0), depth + truncation_m);
            let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
            for corner in self.projection.corners(first, next - 1, column) {
                let corner = world_from_sensor * corner;
                low = low.min(corner * nearest).min(corner * farthest);
                high = high.max(corner * nearest).max(corner * farthest);
            }
            // The arc of a column bulges less than this beyond its corners.
            let slack = Vec3::splat(depth * self.projection.pitch() * self.projection.pitch() + 1e-3 * truncation_m);
            let (Some(low), Some(high)) = (
                anchor.locate(center + low - slack),
                anchor.locate(center + high + slack),
            ) else {
                continue;
            };
            let (low, high) = (BlockIndex::of(low.voxel), BlockIndex::of(high.voxel));
            if named.replace((low, high)) == Some((low, high)) {
                continue;
            }
            for z in low.0.z..=high.0.z {
                for y in low.0.y..=high.0.y {
                    for x in low.0.x..=high.0.x {
                        near.block(BlockIndex(glam::IVec3::new(x, y, z)), 0, ());
                    }
                }
            }
        }
        Ok(())
    }

    /// Updates the voxels of a block.
    #[inline(always)]
    fn update<S: Simd>(&self, simd: S, block: BlockIndex, centers: &Centers, truncation_m: f32, updates: &mut Updates) {
        let (center_z, inverse) = (self.projection.center_z_m(), 1.0 / truncation_m);
        centers.for_each_row(
            block,
            #[inline(always)]
            |first, [x, y, z]| {
                let mut seen = [[0.0; ROW]; 3];
                let [at_column, at_row, at_depth] = &mut seen;
                for i in 0..ROW {
                    let point = self.projection.project(Vec3::new(x[i], y[i], z[i])); // (4.1)-(4.3)
                    (at_column[i], at_row[i], at_depth[i]) = (point.column, point.row, point.depth_m);
                }
                let vector = |row: [f32; ROW]| f32x8::simd_from(simd, row);
                let (depth, z) = (vector(*at_depth), vector(*z));
                let (inside, pixels) = self.projection.pixels(vector(*at_column), vector(*at_row), depth);
                if !inside.any_true() {
                    return;
                }
                let measured = depths_at(simd, &self.depths_m, pixels);
                let ahead = measured - depth;
                // Ranges differ by no less than depths.
                let near = inside & measured.simd_gt(0.0) & ahead.abs().simd_le(truncation_m);
                if !near.any_true() {
                    return;
                }
                let height = z - center_z;
                let range = (depth * depth + height * height).sqrt();
                let distance = ahead * (range / depth);
                let inside = near & distance.abs().simd_le(truncation_m);
                let weight = (f32x8::splat(simd, 1.0) / range).min(1.0);
                updates.add_row(first / ROW, inside, distance * inverse, weight);
            },
        );
    }
}
