//! Surface patches: the plane that each return of a scan lies on, from the returns around it in the organized image.

mod between;
mod plane;
mod sums;
mod surface;

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;

use crate::{
    lanes::{LANES, Vectors, lanes},
    sensor::{NONE, ScanImage},
};
pub use between::{
    COPLANAR_DOT, COPLANAR_GAPS, COPLANAR_LENGTH_M, COPLANAR_OFF_M, FAR_M, MAX_GAP_ACROSS_M, MAX_GAP_OF_RANGE,
    MAX_OFF as MAX_OFF_BETWEEN, MIN_DOT, widest_gap_m,
};
pub use sums::MAX_COLUMNS;
pub use surface::RAY_WEIGHT;
pub(crate) use surface::{Kind, Limits, Patch, Turn};

use between::Between;
use plane::Moments;
use sums::{Window, WindowSums};

/// How rough a surface may be beside the noise (root of the mean of squares), metres.
pub const ROUGHNESS_M: f32 = 0.01;

/// Returns are off their plane by at most this many times what is expected, in the mean (root of the squares), …
pub const MAX_RESIDUAL: f32 = 1.5;

/// … and the return itself by this many.
pub const MAX_OFF: f32 = 2.5;

/// A plane takes returns that are spread twice as far along it, in its narrower direction, as they are off it.
pub const MIN_SPREAD: f32 = 2.0;

/// The least cosine of the angle between a ray and a plane's normal.
pub const MIN_COSINE: f32 = 0.03;

/// Fewer returns make no plane that could be told from their noise.
pub const MIN_RETURNS: f32 = 5.0;

/// Windows reach this many rings up and down at most.
pub const MAX_RINGS: usize = 8;

/// The noise is estimated from every such return, …
pub const SAMPLE: usize = 16;

/// … whose window has this many returns, …
pub const MIN_TELLING: f32 = 9.0;

/// … and is met by the ray at an angle of at least this cosine to its normal; …
pub const FACING: f32 = 0.5;

/// … and is taken to be no less and no more than this, metres.
pub const NOISE_M: [f32; 2] = [0.01, 0.03];

/// Columns that one thread takes at a time.
const PART: usize = 32;

/// Finds the patches of a scan's returns. Reuse it from scan to scan: it keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct Patches {
    sums: WindowSums,
    between: Between,
    noise: Vec<f32>,
    parts: Vec<Part>,
    /// By return; then those between returns.
    pub(crate) all: Vec<Patch>,
}

/// What is found in some columns. Column by column, so that windows lie near those before them, in whatever order returns come.
#[derive(Debug, Default)]
struct Part {
    /// Which returns there are; the patch of each; and which of them, by their place here, want halves of their windows.
    returns: Vec<u32>,
    patches: Vec<Patch>,
    rest: Vec<usize>,
}

impl Patches {
    /// `points` are those that `image` was built from, in any axes, with the `origins` of their rays (all at zero if there are
    /// none); columns are `column_rad` apart.
    ///
    /// A return's window reaches as far along rings and columns as [`Limits::window_m`] does at its range. If its returns do not
    /// lie in a plane, halves of it are tried, so that planes end at edges: of those that are planes the one with
    /// the smallest residual is taken.
    pub(crate) fn update(
        &mut self,
        image: &ScanImage,
        points: &[Vec3],
        origins: &[Vec3],
        column_rad: f32,
        limits: &mut Limits,
    ) {
        self.sums.update(image, points);
        self.all.clear();
        self.all.extend(points.iter().map(|&center| Patch {
            center,
            ..Patch::default()
        }));
        let mut scan = Scan {
            image,
            points,
            origins,
            sums: &self.sums,
            limits: *limits,
            column_rad,
        };
        let level = Level::new(); // the vector instructions of this CPU
        if limits.noise_m == 0.0 {
            scan.limits.noise_m = scan.noise_m(level, &mut self.noise);
        }
        limits.noise_m = scan.limits.noise_m;
        let scan = &scan;
        self.parts.resize_with(image.columns().div_ceil(PART), Part::default);
        self.parts.par_iter_mut().enumerate().for_each(|(k, part)| {
            let columns = k * PART..((k + 1) * PART).min(image.columns());
            dispatch!(level, _ => scan.find(columns, part));
        });
        for Part { returns, patches, .. } in &self.parts {
            let planes = returns.iter().zip(patches).filter(|(_, patch)| patch.is_plane());
            planes.for_each(|(&i, &patch)| self.all[i as usize] = patch);
        }
    }

    /// Appends those between returns; `None` if there are too many of them ([`Limits::most`]). Where a patch between two returns
    /// `is_contradicted`, wide gaps stay.
    pub(crate) fn link(
        &mut self,
        image: &ScanImage,
        column_rad: f32,
        limits: &Limits,
        is_contradicted: impl Fn(&Patch) -> bool + Sync,
    ) -> Option<()> {
        (self.between).append_to(&mut self.all, image, column_rad, limits, is_contradicted)
    }
}

/// All that a patch is made from.
struct Scan<'a> {
    image: &'a ScanImage,
    points: &'a [Vec3],
    origins: &'a [Vec3],
    sums: &'a WindowSums,
    limits: Limits,
    column_rad: f32,
}

/// The patches of some windows, with their mean squared residual (infinite where there is none).
struct Found {
    patches: [Patch; LANES],
    residual2: [f32; LANES],
}

impl Scan<'_> {
    /// The standard deviation of ranges: how far returns are off the planes of their windows, along their rays. Only windows that face
    /// the sensor tell, and those with the smaller residuals: the others are no planes. `all` is a buffer.
    fn noise_m(&self, level: Level, all: &mut Vec<f32>) -> f32 {
        all.clear();
        all.resize(self.points.len().div_ceil(SAMPLE), f32::INFINITY);
        all.par_chunks_mut(LANES).enumerate().for_each(|(group, out)| {
            dispatch!(level, _ => self.noise2(group * LANES * SAMPLE, out));
        });
        all.retain(|noise2| noise2.is_finite());
        let [least, most] = NOISE_M;
        if all.is_empty() {
            return most;
        }
        let third = all.len() / 3;
        let (_, noise2, _) = all.select_nth_unstable_by(third, f32::total_cmp);
        noise2.sqrt().clamp(least, most)
    }

    /// The squared noise in the windows of each [`SAMPLE`]-th return from number `first` on, where they tell.
    #[inline(always)]
    fn noise2(&self, first: usize, out: &mut [f32]) {
        let mut moments = Moments::NONE;
        for lane in 0..out.len() {
            let i = first + lane * SAMPLE;
            if let Some(around) = self.around(i) {
                moments.set(lane, &self.sums.of(around.window(WHOLE)), self.points[i]);
            }
        }
        let planes = moments.planes();
        for (lane, out) in out.iter_mut().enumerate() {
            let ray = self.ray(first + lane * SAMPLE);
            let cosine = ray.dot(planes.normal.get(lane)) / ray.length();
            if planes.count[lane] >= MIN_TELLING && cosine.abs() >= FACING {
                *out = planes.residual2[lane] / (cosine * cosine);
            }
        }
    }

    /// The patches of the returns in some columns.
    #[inline(always)]
    fn find(&self, columns: Range<usize>, part: &mut Part) {
        let Part { returns, patches, rest } = part;
        returns.clear();
        for column in columns {
            let cells = (0..self.image.rings()).filter_map(|ring| self.image.get(ring, column));
            returns.extend(cells.map(|i| i as u32));
        }
        patches.clear();
        patches.resize(returns.len(), Patch::default());
        rest.clear();
        for (group, (returns, out)) in returns.chunks(LANES).zip(patches.chunks_mut(LANES)).enumerate() {
            let mut moments = Moments::NONE;
            let mut of = [NONE; LANES];
            for (lane, &i) in returns.iter().enumerate() {
                if let Some(around) = self.around(i as usize) {
                    of[lane] = i;
                    moments.set(lane, &self.sums.of(around.window(WHOLE)), self.points[i as usize]);
                }
            }
            let found = self.judge(&moments, &of, Kind::Whole);
            for (lane, out) in out.iter_mut().enumerate() {
                *out = found.patches[lane];
                // Halves would have fewer returns still.
                if found.residual2[lane] == f32::INFINITY && moments.count(lane) >= MIN_RETURNS {
                    rest.push(group * LANES + lane);
                }
            }
        }
        // Four returns at a time, each with four halves of its window.
        for few in rest.chunks(LANES / HALVES.len()) {
            let mut moments = Moments::NONE;
            let mut of = [NONE; LANES];
            for (k, &place) in few.iter().enumerate() {
                let i = returns[place];
                let Some(around) = self.around(i as usize) else {
                    continue;
                };
                for (half, &reach) in HALVES.iter().enumerate() {
                    let lane = HALVES.len() * k + half;
                    of[lane] = i;
                    moments.set(lane, &self.sums.of(around.window(reach)), self.points[i as usize]);
                }
            }
            let found = self.judge(&moments, &of, Kind::Half);
            for (k, &place) in few.iter().enumerate() {
                let first_half = HALVES.len() * k;
                let residuals2 = &found.residual2[first_half..first_half + HALVES.len()];
                let (mut best, mut least2) = (0, f32::INFINITY);
                for (half, &residual2) in residuals2.iter().enumerate() {
                    best = if residual2 < least2 { half } else { best };
                    least2 = least2.min(residual2);
                }
                patches[place] = found.patches[first_half + best];
            }
        }
    }

    /// The window about a return; `None` if it has no cell.
    #[inline(always)]
    fn around(&self, i: usize) -> Option<Around> {
        let (ring, column) = self.image.place_of(i)?;
        let range = self.ray(i).length();
        let last = self.image.rings() - 1;
        let gap = self.image.ring_gap_beside(ring);
        let cells = |angle: f32, most: usize| {
            let cells = self.limits.window_m / (range * angle.max(1e-4));
            ((cells + 0.5) as usize).clamp(1, most)
        };
        Some(Around {
            ring,
            column: column + MAX_COLUMNS,
            rings: cells(gap, MAX_RINGS),
            columns: cells(self.column_rad, MAX_COLUMNS),
            last,
        })
    }

    #[inline(always)]
    fn ray(&self, i: usize) -> Vec3 {
        self.points[i] - self.origins.get(i).copied().unwrap_or(Vec3::ZERO)
    }

    /// Which planes are surface that their return lies on.
    #[inline(always)]
    fn judge(&self, moments: &Moments, of: &[u32; LANES], kind: Kind) -> Found {
        let planes = moments.planes();
        let mut found = Found {
            patches: [Patch::default(); LANES],
            residual2: [f32::INFINITY; LANES],
        };
        let noise2 = self.limits.noise_m * self.limits.noise_m;
        let (mut points, mut rays) = (Vectors::ZERO, Vectors::ZERO);
        for (lane, &i) in of.iter().enumerate().filter(|(_, i)| **i != NONE) {
            points.set(lane, self.points[i as usize]);
            rays.set(lane, self.ray(i as usize));
        }
        let normal = planes.normal;
        let (facing, off) = (rays.dot(normal), normal.dot(planes.mean));
        let length2 = rays.dot(rays);
        let cosine2 = lanes(|l| facing[l] * facing[l] / length2[l]);
        let (residual2, spread2) = (&planes.residual2, &planes.spread2);
        // What is expected across the plane: of the noise, what does not lie along it.
        let noise2_across = lanes(|l| noise2 * cosine2[l]);
        let expected2 = lanes(|l| noise2_across[l] + ROUGHNESS_M * ROUGHNESS_M);
        // Also false for NaN.
        let is_plane = lanes(|l| {
            (planes.count[l] >= MIN_RETURNS)
                & (residual2[l] <= MAX_RESIDUAL * MAX_RESIDUAL * expected2[l])
                & (off[l] * off[l] <= MAX_OFF * MAX_OFF * expected2[l])
                & (spread2[l] >= MIN_SPREAD * MIN_SPREAD * residual2[l].max(noise2))
                & (cosine2[l] >= MIN_COSINE * MIN_COSINE)
        });
        // Of what is off the plane, noise goes, and shape stays (Wiener's filter).
        let moved = lanes(|l| (noise2_across[l] / residual2[l]).min(1.0) * off[l]);
        let centers = points.add(normal.scale(moved));
        let towards = normal.scale(lanes(|l| if facing[l] > 0.0 { -1.0 } else { 1.0 }));
        for (lane, patch) in found.patches.iter_mut().enumerate() {
            *patch = Patch {
                center: centers.get(lane),
                normal: towards.get(lane),
                kind: if is_plane[lane] { kind } else { Kind::Ray },
                turn: Turn::default(),
            };
        }
        found.residual2 = lanes(|l| if is_plane[l] { residual2[l] } else { f32::INFINITY });
        found
    }
}

/// A window about a return's cell.
struct Around {
    ring: usize,
    column: usize,
    /// How far it reaches to each side.
    rings: usize,
    columns: usize,
    /// The last ring that there is.
    last: usize,
}

/// Whether a window reaches to lower rings, to higher ones, to lower columns and to higher ones.
type Reach = [bool; 4];

const WHOLE: Reach = [true; 4];

const HALVES: [Reach; 4] = [
    [true, true, true, false],
    [true, true, false, true],
    [true, false, true, true],
    [false, true, true, true],
];

impl Around {
    #[inline(always)]
    fn window(&self, [down, up, left, right]: Reach) -> Window {
        let reach = |yes: bool, far: usize| if yes { far } else { 0 };
        Window {
            rings: [
                self.ring.saturating_sub(reach(down, self.rings)),
                (self.ring + reach(up, self.rings)).min(self.last),
            ],
            columns: [
                self.column - reach(left, self.columns),
                self.column + reach(right, self.columns),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{
        model,
        testing::{random, scan_room},
    };

    #[test]
    fn noise_is_that_along_rays() {
        let sensor = model("os1-64").unwrap();
        let (points, rings) = scan_room(&sensor, |_| 0.0);
        let mut image = ScanImage::new();
        for (noise_m, told) in [(0.0, 0.01), (0.015, 0.015), (0.025, 0.025), (0.1, 0.03)] {
            let noisy = points.iter().enumerate().map(|(i, p)| {
                let uniform = 12.0_f32.sqrt() * (random(i) - 0.5); // of variance 1
                *p + p.normalize() * noise_m * uniform
            });
            let points: Vec<Vec3> = noisy.collect();
            image.update(&points, &rings, &sensor);
            let mut sums = WindowSums::default();
            sums.update(&image, &points);
            let scan = Scan {
                image: &image,
                points: &points,
                origins: &[],
                sums: &sums,
                limits: Limits {
                    window_m: 0.12,
                    noise_m: 0.0,
                    step_m: 0.1,
                    max_gap_m: 1.0,
                    neighbour_cells: 1,
                    most: usize::MAX,
                },
                column_rad: sensor.column_width_rad() as f32,
            };
            let found = scan.noise_m(Level::new(), &mut Vec::new());
            assert!((found - told).abs() <= 0.1 * told, "{noise_m}: {found}");
        }
    }
}
