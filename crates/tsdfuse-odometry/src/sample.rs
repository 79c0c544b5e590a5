//! Which returns of a scan are used: spread evenly over space.

use glam::Vec3;
use rayon::prelude::*;
use rustc_hash::{FxBuildHasher, FxHashMap};
use tsdfuse::Scan;

use crate::cells::{Seen, elevation_bit};
use crate::motion::Motion;
use crate::register::COARSE;
use crate::returns::Return;

/// The span of a sweep and its returns, spread evenly over space.
#[derive(Clone, Debug)]
pub(crate) struct Sampled {
    /// Times of the first and the last return, seconds after the scan's own time; equal where returns have no times.
    pub(crate) span: (f64, f64),
    /// For the map.
    pub(crate) dense: Vec<Return>,
    /// For registration: each [`COARSE`]-th one first, then the next ones of these, and so on.
    pub(crate) sparse: Vec<Return>,
}

/// Returns that one thread looks at, at a time.
const GRAIN: usize = 4096;

/// Parts of space that are thinned beside each other.
const PARTS: u64 = 16;

/// One return in each cube of space, in order: the one nearest to the ray through the middle of the cube. So noise, which runs along the rays, has no say.
/// (The first one would be that whose noise brings it into the cube before the others, for instance too near where surface comes nearer as the
/// beams turn, and tracking would drift by that.)
fn thinned(returns: &[Return], size: f32) -> Vec<Return> {
    let cube = |r: &Return| {
        let key = (r.point / size).floor();
        let bits = |v: f32| u64::from(v as i32 as u32 & 0x1f_ffff);
        let middle = ((key + 0.5) * size).normalize_or_zero();
        let off = r.point.normalize_or_zero().distance_squared(middle);
        (bits(key.x) << 42 | bits(key.y) << 21 | bits(key.z), off)
    };
    let part_of = |cube: u64| cube.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32 & (PARTS - 1);
    let cubes: Vec<(u64, f32)> = returns.par_iter().with_min_len(GRAIN).map(cube).collect();
    let nearest = (0..PARTS).into_par_iter().map(|part| {
        let mut nearest: FxHashMap<u64, (f32, u32)> =
            FxHashMap::with_capacity_and_hasher(cubes.len() / 40, FxBuildHasher);
        for (i, &(cube, off)) in cubes.iter().enumerate().filter(|(_, (cube, _))| part_of(*cube) == part) {
            let best = nearest.entry(cube).or_insert((off, i as u32));
            if off < best.0 {
                *best = (off, i as u32);
            }
        }
        nearest.into_values().map(|(_, i)| i).collect::<Vec<_>>()
    });
    let mut chosen = nearest.collect::<Vec<_>>().concat();
    chosen.par_sort_unstable();
    chosen.into_iter().map(|i| returns[i as usize]).collect()
}

/// Cubes of the two selections, metres; the larger ones follow the number of returns that is wanted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampling {
    dense_m: f32,
    sparse_m: f32,
    wanted: usize,
}

impl Sampled {
    /// What a sensor saw that moved so.
    pub(crate) fn seen(&self, motion: &Motion) -> Vec<Seen> {
        let placer = motion.placer();
        let seen = |r: &Return| Seen {
            at: placer.place(r.point, r.share),
            elevation: elevation_bit(r.point),
        };
        self.dense.par_iter().with_min_len(GRAIN).map(seen).collect()
    }
}

impl Sampling {
    /// Selects about so many returns of each scan for registration.
    pub(crate) fn new(wanted: usize) -> Self {
        Self {
            dense_m: 0.1,
            sparse_m: 0.5,
            wanted,
        }
    }

    /// Selects returns of a scan, and adapts to how many there were.
    pub(crate) fn sample(&mut self, scan: &Scan) -> Sampled {
        let times = scan.times.as_deref().unwrap_or_default();
        let ends = times.iter().filter(|t| t.is_finite());
        let (first, last) = ends.fold((f32::MAX, f32::MIN), |(a, b), &t| (a.min(t), b.max(t)));
        let is_timed = last > first;
        let span = if is_timed { (first, last) } else { (0.0, 0.0) };
        let share = |i: usize| match times.get(i) {
            Some(t) if is_timed && t.is_finite() => (t - first) / (last - first),
            _ => 0.0,
        };
        let returns = scan.points.iter().enumerate();
        let returns = returns
            .filter(|(_, p)| p.is_finite() && **p != Vec3::ZERO)
            .map(|(i, &point)| Return {
                point,
                share: share(i),
                ring: scan.rings.as_ref().and_then(|rings| rings.get(i).copied()),
            });
        let dense = thinned(&returns.collect::<Vec<_>>(), self.dense_m);
        let sparse = thinned(&dense, self.sparse_m);
        let ratio = sparse.len().max(1) as f32 / self.wanted as f32;
        // Returns lie on surfaces: their number falls with the square of the cubes' edge.
        self.sparse_m = (self.sparse_m * ratio.sqrt().clamp(0.7, 1.4)).clamp(self.dense_m, 2.0);
        Sampled {
            span: (f64::from(span.0), f64::from(span.1)),
            sparse: (0..COARSE)
                .flat_map(|first| sparse.iter().skip(first).step_by(COARSE).copied())
                .collect(),
            dense,
        }
    }
}

#[cfg(test)]
mod tests {
    use rustc_hash::FxHashSet;

    use super::*;

    /// A wall that the beams of a turning sensor meet nearer and nearer, with errors of ranges; each return with its error.
    fn wall() -> (Vec<Return>, Vec<f32>) {
        let mut state = 1_u32;
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let errors = (0..64 * 900).map(|_| 0.02 * (0..12).map(|_| uniform()).sum::<f32>());
        let errors: Vec<f32> = errors.collect();
        let returns = errors.iter().enumerate().map(|(i, error)| {
            let (column, ring) = ((i / 64) as f32, (i % 64) as f32);
            let (azimuth, elevation) = (0.2 + column * 0.001, (ring - 32.0) * 0.004);
            let (sin, cos) = azimuth.sin_cos();
            let ray = Vec3::new(cos * elevation.cos(), sin * elevation.cos(), elevation.sin());
            Return {
                point: ray * (8.0 / ray.y + error),
                share: 0.0,
                ring: None,
            }
        });
        (returns.collect(), errors)
    }

    #[test]
    fn noise_does_not_choose() {
        let (returns, errors) = wall();
        let mean = |chosen: &[Return]| {
            let error = |r: &Return| r.point.length() - 8.0 / (r.point.y / r.point.length());
            chosen.iter().map(error).sum::<f32>() / chosen.len() as f32
        };
        assert!(errors.iter().sum::<f32>().abs() / (errors.len() as f32) < 2e-4);
        let chosen = thinned(&returns, 0.5);
        // The first one in each cube would be too near.
        let mut taken = FxHashSet::default();
        let is_first = |r: &&Return| taken.insert((r.point / 0.5).floor().as_ivec3());
        let first: Vec<Return> = returns.iter().filter(is_first).copied().collect();
        let (chosen_m, first_m) = (mean(&chosen), mean(&first));
        assert!(chosen.len() > 100 && first_m < -0.0025, "{first_m}");
        assert!(chosen_m.abs() < 0.4 * first_m.abs(), "{chosen_m} {first_m}");
    }

    #[test]
    fn cubes_keep_one_return() {
        let (returns, _) = wall();
        let cubes = |returns: &[Return]| {
            let cubes = returns.iter().map(|r| (r.point / 0.25).floor().as_ivec3());
            cubes.collect::<FxHashSet<_>>().len()
        };
        let chosen = thinned(&returns, 0.25);
        assert_eq!(chosen.len(), cubes(&returns));
        assert_eq!(cubes(&chosen), chosen.len());
    }
}
