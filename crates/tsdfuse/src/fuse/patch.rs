//! Surface patches: ours.

use std::time::Instant;

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator,
    beams::Beams,
    cylinder::{Row, VOXEL_RADIUS},
    gather::Skip,
    lines::{Line, Lines, Rule, Shape},
    pierced::pierced,
    placed::Placed,
};
use crate::{
    eigen::eigen,
    map::VoxelMap,
    scan::Scan,
    sensor::{NONE, ScanImage, SensorModel, rings_of},
};

/// Options of [`Patches`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatchConfig {
    /// Half the edge of the windows in which planes are fitted, metres.
    pub window_m: f32,
    /// Standard deviation of ranges, metres.
    pub noise_m: f32,
    /// How far from the surface voxels are updated, in voxels.
    pub reach_vox: f32,
    /// Weight of returns without plane.
    pub ray_weight: f32,
    /// Smallest sine of the angle between ray and plane.
    pub min_sine: f32,
    /// Interpolate between rings across gaps up to this.
    pub max_gap_m: f32,
    /// Weight exponent of incidence
    pub incidence: f32,
    /// Residual limit in sigmas
    pub residual: f32,
    /// Behind fall-off start, in voxels.
    pub behind_vox: f32,
    /// How far behind the surface voxels are updated.
    pub depth_vox: f32,
    /// Step of interpolated lines, voxels.
    pub step_vox: f32,
    /// Weight of interpolated ones.
    pub fill_weight: f32,
    /// Radius of lines, in voxels.
    pub radius_vox: f32,
}

impl Default for PatchConfig {
    fn default() -> Self {
        Self {
            window_m: 0.12,
            noise_m: 0.02,
            reach_vox: 2.0,
            ray_weight: 0.3,
            min_sine: 0.03,
            max_gap_m: 1.0,
            incidence: 1.0,
            residual: 1.5,
            behind_vox: 1.0,
            depth_vox: 1.75,
            step_vox: 1.2,
            fill_weight: 0.5,
            radius_vox: 0.866,
        }
    }
}

/// The integrator.
#[derive(Debug, Default)]
pub struct Patches {
    config: PatchConfig,
    beams: Beams,
    placed: Placed,
    image: ScanImage,
    sums: Sums,
    patches: Vec<Patch>,
    fills: Vec<Patch>,
    lines: Lines,
}

/// The surface about a return.
#[derive(Clone, Copy, Debug, Default)]
struct Patch {
    center: Vec3,
    normal: Vec3,
    weight: f32,
}

impl Patches {
    /// With options.
    pub fn new(config: PatchConfig, sensor: Option<SensorModel>) -> Self {
        Self { config, beams: Beams::new(sensor), ..Self::default() }
    }
}

impl Integrator for Patches {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        self.placed.place(map.grid(), scan)?;
        if scan.points.is_empty() {
            return Ok(Integration::default());
        }
        let sensor = self.beams.of(scan)?;
        self.image.update(&scan.points, &rings_of(scan, sensor), sensor);
        self.sums.update(&self.image, &self.placed.points);
        let (config, placed, image, sums) = (self.config, &self.placed, &self.image, &self.sums);
        let column_rad = sensor.column_width_rad() as f32;
        (0..placed.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| patch(i, &config, placed, image, sums, column_rad).unwrap_or_default())
            .collect_into_vec(&mut self.patches);
        let voxel_m = map.config().voxel_size_m as f32;
        let patches = &self.patches;
        self.fills.clear();
        if config.max_gap_m > 0.0 {
            self.fills.par_extend((0..placed.len()).into_par_iter().with_min_len(1024).flat_map_iter(|i| {
                let own = patches[i];
                let place = image.place_of(i).filter(|_| own.weight > 0.0);
                let mut out = Vec::new();
                if let Some((ring, column)) = place {
                    let next = if column + 1 == image.columns() { 0 } else { column + 1 };
                    for other in [image.get(ring + 1, column), image.get(ring, next)].into_iter().flatten() {
                        fill(&own, &patches[other], voxel_m, &config, &mut out);
                    }
                }
                out
            }));
        }
        if std::env::var("PATCH_STATS").is_ok() {
            let n = self.patches.iter().filter(|p| p.weight > 0.0).count();
            eprintln!("patches {n} of {}, fills {}", self.patches.len(), self.fills.len());
        }
        let prepare_secs = start.elapsed().as_secs_f64();
        let truncation = map.config().truncation_vox();
        let reach = config.reach_vox.min(truncation);
        let patches = &self.patches;
        let mut done = self.lines.run(
            map,
            &placed.order,
            #[inline(always)]
            |i| {
                let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                let p = patches[i];
                let by_range = (1.0 / ray.range_m).min(1.0);
                if p.weight > 0.0 {
                    let center = placed.anchor().and_then(|a| a.locate(p.center)).ok_or(Skip::OutsideGrid)?;
                    let sine = -ray.direction.dot(p.normal);
                    return Ok(Line { center, axis: p.normal, weight: by_range * p.weight * sine.powf(config.incidence) });
                }
                Err(Skip::WithoutNormal)
            },
            &AlongPatch { truncation, reach, depth: config.depth_vox, behind: config.behind_vox, radius: config.radius_vox },
        );
        if !self.fills.is_empty() {
            let fills = &self.fills;
            let order: Vec<u32> = (0..fills.len() as u32).collect();
            let filled = self.lines.run(
                map,
                &order,
                #[inline(always)]
                |i| {
                    let p = fills[i];
                    let range_m = p.center.length();
                    let by_range = (1.0 / range_m).min(1.0);
                    let center = placed.anchor().and_then(|a| a.locate(p.center)).ok_or(Skip::OutsideGrid)?;
                    let sine = (-p.center.dot(p.normal) / range_m).max(0.0);
                    Ok(Line { center, axis: p.normal, weight: by_range * config.fill_weight * sine.powf(config.incidence) })
                },
                &AlongPatch { truncation, reach, depth: config.depth_vox, behind: config.behind_vox, radius: config.radius_vox },
            );
            done.updated_blocks.extend(filled.updated_blocks);
            done.updated_blocks.sort_unstable();
            done.updated_blocks.dedup();
        }
        if config.ray_weight > 0.0 {
            let rays = self.lines.run(
                map,
                &placed.order,
                #[inline(always)]
                |i| {
                    let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                    if patches[i].weight > 0.0 {
                        return Err(Skip::WithoutWeight);
                    }
                    Ok(Line { center: ray.end, axis: ray.direction, weight: config.ray_weight * (1.0 / ray.range_m).min(1.0) })
                },
                &AlongRay { truncation, reach, depth: config.depth_vox, behind: config.behind_vox },
            );
            done.updated_blocks.extend(rays.updated_blocks);
            done.updated_blocks.sort_unstable();
            done.updated_blocks.dedup();
            done.fused_returns += rays.fused_returns;
            done.skipped.without_normal = 0;
        }
        done.prepare_secs = prepare_secs;
        Ok(done)
    }
}

struct AlongPatch {
    truncation: f32,
    reach: f32,
    depth: f32,
    behind: f32,
    radius: f32,
}

impl Rule for AlongPatch {
    const SHAPE: Shape = Shape::Cylinder;

    #[inline(always)]
    fn of<S: Simd>(&self, _: S, line: &Line) -> impl Fn(&Row<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (reach, inverse, weight) = (self.reach, 1.0 / self.truncation, line.weight);
        let (depth, radius) = (self.depth, self.radius);
        let slope = 1.0 / (depth + 0.5 - self.behind.min(depth));
        #[inline(always)]
        move |v| {
            let behind = ((depth + 0.5 + v.along) * slope).max(0.0).min(1.0);
            (v.within(radius, reach) & v.along.simd_ge(-depth), v.along * inverse, behind * weight)
        }
    }
}

struct AlongRay {
    truncation: f32,
    reach: f32,
    depth: f32,
    behind: f32,
}

impl Rule for AlongRay {
    const SHAPE: Shape = Shape::Pierced;

    #[inline(always)]
    fn of<S: Simd>(&self, _: S, line: &Line) -> impl Fn(&Row<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (reach, inverse) = (self.reach, 1.0 / self.truncation);
        let depth = self.depth;
        let slope = 1.0 / (depth + 0.5 - self.behind.min(depth));
        let (axis, weight) = (line.axis, line.weight);
        #[inline(always)]
        move |v| {
            let inside = pierced(axis, v) & v.distance2.simd_le(reach * reach) & v.along.simd_le(depth);
            let beside = 1.0 - (v.distance2 - v.along * v.along) * (1.0 / (VOXEL_RADIUS * VOXEL_RADIUS));
            let behind = ((depth + 0.5 - v.along) * slope).max(0.0).min(1.0);
            (inside, -v.along * inverse, beside * weight * (behind * behind))
        }
    }
}

/// Sums of all returns above and left of each cell: count, x, y, z, xx, xy, xz, yy, yz, zz.
#[derive(Debug, Default)]
struct Sums {
    columns: usize,
    rings: usize,
    all: Vec<[f64; 10]>,
}

const PAD: usize = 16;

impl Sums {
    fn width(&self) -> usize {
        self.columns + 2 * PAD + 1
    }

    fn update(&mut self, image: &ScanImage, points: &[Vec3]) {
        (self.columns, self.rings) = (image.columns(), image.rings());
        let width = self.width();
        self.all.resize(width * (self.rings + 1), [0.0; 10]);
        self.all[..width].fill([0.0; 10]);
        // prefix along rows, in parallel; then down columns
        let columns = self.columns;
        self.all[width..].par_chunks_mut(width).enumerate().for_each(|(ring, row)| {
            let cells = image.row(ring);
            let mut sum = [0.0; 10];
            row[0] = sum;
            for c in 0..width - 1 {
                let i = cells[(c + columns - PAD % columns) % columns];
                if i != NONE {
                    let p = points[i as usize].as_dvec3();
                    let add = [1.0, p.x, p.y, p.z, p.x * p.x, p.x * p.y, p.x * p.z, p.y * p.y, p.y * p.z, p.z * p.z];
                    for k in 0..10 {
                        sum[k] += add[k];
                    }
                }
                row[c + 1] = sum;
            }
        });
        for ring in 1..self.rings {
            let (above, below) = self.all.split_at_mut(width * (ring + 1));
            let above = &above[width * ring..];
            below[..width].par_iter_mut().with_min_len(512).zip(above).for_each(|(b, a)| {
                for k in 0..10 {
                    b[k] += a[k];
                }
            });
        }
    }

    /// Over rings r0..=r1 and columns c−left..=c+right.
    fn window(&self, r0: usize, r1: usize, c: usize, left: usize, right: usize) -> [f64; 10] {
        let width = self.width();
        let (x0, x1) = (c + PAD - left, c + PAD + right + 1);
        let at = |r: usize, x: usize| &self.all[r * width + x];
        let (a, b, e, d) = (at(r0, x0), at(r0, x1), at(r1 + 1, x0), at(r1 + 1, x1));
        std::array::from_fn(|k| d[k] - b[k] - e[k] + a[k])
    }
}

/// mean, normal, residual², spread² of the middle eigenvalue, count
fn plane(s: &[f64; 10]) -> Option<(DVec3, DVec3, f64, f64)> {
    let n = s[0];
    if n < 4.5 {
        return None;
    }
    let m = DVec3::new(s[1], s[2], s[3]) / n;
    let c = |k: usize, a: f64, b: f64| s[k] / n - a * b;
    let (xx, xy, xz) = (c(4, m.x, m.x), c(5, m.x, m.y), c(6, m.x, m.z));
    let (yy, yz, zz) = (c(7, m.y, m.y), c(8, m.y, m.z), c(9, m.z, m.z));
    let e = eigen(&DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz)));
    Some((m, e.vectors[0], e.values[0].max(0.0) * n / (n - 3.0), e.values[1]))
}

fn patch(i: usize, config: &PatchConfig, placed: &Placed, image: &ScanImage, sums: &Sums, column_rad: f32) -> Option<Patch> {
    let (ring, column) = image.place_of(i)?;
    let ray = placed.ray(i)?;
    let p = placed.points[i];
    let half = |angle: f32, most: usize| ((config.window_m / (ray.range_m * angle)).round() as usize).clamp(1, most);
    let v = half(column_rad, PAD);
    let gap = image.ring_gap_tangent(ring.min(image.rings() - 2)).max(1e-4);
    let u = half(gap, 8);
    let (top, bottom) = (image.rings() - 1, 0);
    let windows = [
        (u, u, v, v),
        (u, u, v, 0),
        (u, u, 0, v),
        (u, 0, v, v),
        (0, u, v, v),
        (u, 0, v, 0),
        (u, 0, 0, v),
        (0, u, v, 0),
        (0, u, 0, v),
    ];
    let limit = f64::from(config.residual * config.noise_m).powi(2);
    let mut best: Option<(f64, Patch)> = None;
    for (k, (down, up, left, right)) in windows.into_iter().enumerate() {
        let (r0, r1) = (ring.saturating_sub(down).max(bottom), (ring + up).min(top));
        if r0 == r1 {
            continue;
        }
        let s = sums.window(r0, r1, column, left, right);
        let Some((mean, normal, residual2, spread2)) = plane(&s) else { continue };
        if residual2 > limit || spread2 < 4.0 * residual2.max(limit * 0.25) {
            continue;
        }
        let mut normal = normal.as_vec3();
        let sine = ray.direction.dot(normal);
        if sine > 0.0 {
            normal = -normal;
        }
        if sine.abs() < config.min_sine {
            continue;
        }
        // the return itself must lie on it
        let off = normal.dot(mean.as_vec3() - p);
        if off.abs() > 2.5 * config.noise_m {
            continue;
        }
        // slide along the ray
        let center = p + normal * off;
        let patch = Patch { center, normal, weight: 1.0 };
        if k == 0 {
            return Some(patch);
        }
        if best.is_none_or(|(r, _)| residual2 < r) {
            best = Some((residual2, patch));
        }
    }
    best.map(|(_, patch)| patch)
}

fn fill(a: &Patch, b: &Patch, voxel_m: f32, config: &PatchConfig, out: &mut Vec<Patch>) {
    if b.weight == 0.0 {
        return;
    }
    let step = b.center - a.center;
    let gap = step.length();
    if gap > config.max_gap_m || gap < config.step_vox * voxel_m || a.normal.dot(b.normal) < 0.9 {
        return;
    }
    let tolerance = 2.0 * config.noise_m;
    if a.normal.dot(step).abs() > tolerance || b.normal.dot(step).abs() > tolerance {
        return;
    }
    let count = (gap / (config.step_vox * voxel_m)).ceil();
    for k in 1..count as usize {
        let t = k as f32 / count;
        out.push(Patch { center: a.center + step * t, normal: a.normal.lerp(b.normal, t).normalize(), weight: 1.0 });
    }
}
