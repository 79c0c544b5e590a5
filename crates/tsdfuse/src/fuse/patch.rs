//! Surface patches (`patch`): our own method. `docs/method.md` explains it with figures.
//!
//! Every return takes the plane of the returns around it (`crate::patch`), moves onto it by what is noise, and updates
//! the voxels along the plane's normal, as local normals do. Returns without a plane update along their ray, with less
//! weight. Between neighbouring returns of one surface that are farther apart than voxels, more of both are put in, so that the surface
//! is closed. What rays of later scans pass through is erased (`carve`).
//!
//! Which voxels: within √3·κ/2 of the line along the normal, as far in front of the surface and behind it as marching cubes needs
//! them; a longer line would only carry the surface beyond its edges. What distance: (v − p)·n/μ. What weight: min(1, 1/range) × the
//! cosine of the incidence, falling to 0 behind the surface, where nothing was seen.

use std::time::Instant;

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};
use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator,
    agreement::{Agreement, CROWD, SIGMAS, is_contradicted, share},
    beams::Beams,
    carve::{Carver, Seen},
    centers::Centers,
    cylinder::{EightVoxels, VOXEL_RADIUS},
    depth::world_axes,
    engine::Skip,
    lines::{Line, Lines, Planes, Rule, Shape},
    placed::{Order, Placed},
    settled::Settled,
};
use crate::{
    map::{MapConfig, OutOfMemory, VoxelMap},
    memory::prefetch,
    patch::{self, Limits, Patches, RAY_WEIGHT, widest_gap_m},
    reach::Reach,
    scan::Scan,
    sensor::{ScanImage, SensorModel},
};

/// How far in front of the surface voxels are updated, in voxels: cells that the surface passes have their corners within √3/2
/// of it along the normal, and those of neighbouring lines a little more.
pub const FRONT: f32 = 1.5;

/// How far behind it.
pub const BEHIND: f32 = 1.25;

/// From here on, behind the surface, the weight falls to 0, half a voxel beyond [`BEHIND`].
pub const FULL_BEHIND: f32 = 1.0;

/// Patches between returns are this far apart, in voxels: lines of radius √3/2 still overlap.
pub const STEP: f32 = 1.5;

/// For so many bytes of the map's memory limit, there may be one patch between returns, which takes a third of that with its line.
const LIMIT_PER_PATCH: usize = 512;

/// Options of [`Patch`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatchConfig {
    /// Half the edge of the windows that planes are fitted in, metres.
    pub window_m: f32,
    /// The standard deviation of ranges, metres; 0: estimated from each scan, 1 to 3 cm.
    pub noise_m: f32,
    /// Surface is closed between neighbouring returns no farther apart than this, metres, up to 25 m away; farther away, in proportion
    /// to the range. On planes it is what the sensor sees of the gap, so that a road closes between rings metres apart. 0: nowhere.
    pub max_gap_m: f32,
    /// Whether scans look at what the map holds: how well they agree with it, and what free space erases.
    pub carve: bool,
    /// With `carve`: whether bands, weights and erasing follow how well a scan agrees with the map. All returns of the scan tell it, so a map that
    /// is fused in parts by region goes without.
    pub agreement: bool,
}

impl Default for PatchConfig {
    fn default() -> Self {
        Self {
            window_m: 0.1,
            noise_m: 0.0,
            max_gap_m: 0.4,
            carve: true,
            agreement: true,
        }
    }
}

impl PatchConfig {
    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// [`FuseError::Config`] names the field.
    pub fn validate(&self) -> Result<(), FuseError> {
        let lengths = [
            ("window_m", self.window_m, 1e-3),
            ("noise_m", self.noise_m, 0.0),
            ("max_gap_m", self.max_gap_m, 0.0),
        ];
        match lengths
            .into_iter()
            .find(|(_, value, least)| !(*least..=100.0).contains(value))
        {
            None => Ok(()),
            Some((name, value, least)) => Err(FuseError::Config(format!(
                "patch.{name} is {value}; {least} to 100 m are possible"
            ))),
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
    settled: Settled,
    order: Order,
    places: Vec<Option<(u8, u8)>>,
    lines: Lines,
    carver: Carver,
}

impl Patch {
    /// With the given options. Without a sensor's model, the first scan decides which one it is; scans without beams are put
    /// into a grid of their own.
    pub fn new(config: PatchConfig, sensor: Option<SensorModel>) -> Self {
        Self {
            config,
            beams: Beams::new(sensor),
            ..Self::default()
        }
    }

    /// The patches of the last scan.
    #[cfg(test)]
    pub(super) fn planes(&self) -> &[crate::patch::Patch] {
        &self.patches.all
    }
}

/// How many planes of a scan meet in one voxel that faces the sensor 1 m away: far away fewer, by the square of the range.
pub fn crowd(sensor: &SensorModel, voxel_size_m: f64) -> f32 {
    let elevations = sensor.elevations_deg.iter();
    let (least, most) = elevations.fold((f32::MAX, f32::MIN), |(a, b), &e| (a.min(e), b.max(e)));
    let gaps = sensor.elevations_deg.len().saturating_sub(1).max(1);
    let ring_rad = ((most - least) / gaps as f32).to_radians().max(1e-4);
    let voxel_m = voxel_size_m as f32;
    CROWD * voxel_m * voxel_m / (ring_rad * sensor.column_width_rad() as f32)
}

impl Integrator for Patch {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        let grid = map.grid();
        let (placed, image) = (&mut self.placed, &mut self.image);
        if scan.points.is_empty() {
            placed.place(grid, scan)?;
            return Ok(Integration::default());
        }
        scan.check()?;
        let rows = self.beams.or_grid(scan)?;
        let sensor = rows.sensor.as_ref();
        let (anchor, ()) = rayon::join(
            || placed.place(grid, scan),
            || image.update(&scan.points, &rows.rings, sensor),
        );
        let anchor = anchor?;
        let (placed, image) = (&self.placed, &self.image);
        let mut limits = Limits {
            window_m: self.config.window_m,
            noise_m: self.config.noise_m,
            step_m: STEP * grid.voxel_size_m() as f32,
            max_gap_m: self.config.max_gap_m,
            neighbour_cells: rows.neighbour_cells,
            most: map.memory_limit() / LIMIT_PER_PATCH,
        };
        let column_rad = sensor.column_width_rad() as f32;
        self.patches
            .update(image, &placed.points, &placed.origins, column_rad, &mut limits);
        let returns = placed.len();
        // Without erasing, nothing depends on what the map holds, and maps of parts of a log can be added.
        let looks = self.config.carve && self.config.agreement;
        let agreement = if looks {
            Agreement::of(map, anchor, &self.patches.all, &mut self.places)
        } else {
            Agreement::default()
        };
        let crowd = crowd(sensor, grid.voxel_size_m());
        self.settled.clear();
        if looks {
            self.settled.find(map, anchor, crowd, agreement, &mut self.patches.all);
        }
        let is_contradicted = |patch: &patch::Patch| {
            let center = anchor.locate(patch.center).filter(|_| looks);
            center.is_some_and(|center| is_contradicted(map, center, patch.normal))
        };
        self.patches
            .link(image, column_rad, &limits, is_contradicted)
            .ok_or(OutOfMemory::Limit {
                limit_bytes: map.memory_limit(),
            })?;
        let patches = &self.patches.all;
        self.order.sort(grid, anchor, patches.len(), |i| {
            patches[i].turn.is_due.then_some(patches[i].center)
        });
        let prepare_secs = start.elapsed().as_secs_f64();

        let truncation = map.config().truncation_vox();
        let reach = FRONT.min(truncation);
        let mut done = self.lines.run(
            map,
            &self.order.numbers,
            |i| prefetch(&patches[i]),
            #[inline(always)]
            |i| {
                let patch = &patches[i];
                if i < returns && !patch.is_plane() {
                    let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                    return Ok(Line {
                        center: ray.end,
                        axis: -ray.direction,
                        reach,
                        weight: RAY_WEIGHT * (1.0 / ray.range_m).min(1.0),
                    });
                }
                let sigma = agreement.sigma_of(patch);
                Ok(Line {
                    center: anchor.locate(patch.center).ok_or(Skip::OutsideGrid)?,
                    axis: patch.normal,
                    reach: (SIGMAS * sigma).clamp(reach, truncation),
                    weight: share(sigma, crowd * patch.cosine() / patch.center.length_squared())
                        * patch.weight()
                        * f32::from(patch.turn.times),
                })
            },
            &AlongPatch { truncation },
        )?;
        // Patches between returns do not count as returns.
        done.fused_returns += patches[..returns].iter().filter(|patch| !patch.turn.is_due).count() as u64;
        done.fused_returns = done.fused_returns.saturating_sub((patches.len() - returns) as u64);
        self.settled.mark(map);
        if self.config.carve {
            let centers = Centers {
                anchor,
                origin: Vec3::ZERO,
                rotation: world_axes(scan)?.transpose(),
                voxel_size_m: grid.voxel_size_m() as f32,
            };
            let seen = Seen::new(scan, image, placed, patches, centers, agreement);
            done.updated_blocks.extend(self.carver.carve(map, &seen, sensor));
        }
        Ok(Integration { prepare_secs, ..done })
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        // Patches lie between returns at most this far apart.
        let reach = Reach::of(map, scan)?;
        let gap_m = widest_gap_m(self.config.max_gap_m, reach.farthest_m());
        Ok(reach.widened(f64::from(gap_m)))
    }

    fn needs_sensor(&self) -> bool {
        true
    }
}

/// Along a patch's normal, or against the ray where there is no patch.
pub(super) struct AlongPatch {
    pub(super) truncation: f32,
}

impl Rule for AlongPatch {
    const SHAPE: Shape = Shape::Cylinder;

    // Most lines are short.
    const PLANES: Planes = Planes::Four;

    #[inline(always)]
    fn of<S: Simd>(&self, _: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (inverse, weight) = (1.0 / self.truncation, line.weight);
        let front = line.reach;
        let behind = front * (BEHIND / FRONT);
        let end = behind + 0.5;
        let full = front * (FULL_BEHIND / FRONT);
        #[inline(always)]
        move |v| {
            let known = ((v.along + end) * (1.0 / (end - full))).max(0.0).min(1.0);
            let inside = v.within(VOXEL_RADIUS, front) & v.along.simd_ge(-behind);
            (inside, v.along * inverse, known * weight)
        }
    }
}
