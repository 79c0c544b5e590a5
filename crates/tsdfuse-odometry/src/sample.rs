//! Which returns of a scan are used: spread evenly over space.

use glam::Vec3;
use rustc_hash::{FxBuildHasher, FxHashSet};
use tsdfuse::Scan;

use crate::register::Return;

/// The span of a sweep and its returns, spread evenly over space.
#[derive(Clone, Debug)]
pub(crate) struct Sampled {
    /// Times of the first and the last return, seconds after the scan's own time; equal where returns have no times.
    pub(crate) span: (f64, f64),
    /// For the map.
    pub(crate) dense: Vec<Return>,
    /// For registration.
    pub(crate) sparse: Vec<Return>,
}

/// The first return in each cube of space.
fn thinned(returns: impl Iterator<Item = Return>, size: f32, expected: usize) -> Vec<Return> {
    let mut taken: FxHashSet<u64> = FxHashSet::with_capacity_and_hasher(expected, FxBuildHasher);
    let cube = |p: Vec3| {
        let bits = |v: f32| u64::from((v / size).floor() as i32 as u32 & 0x1f_ffff);
        bits(p.x) << 42 | bits(p.y) << 21 | bits(p.z)
    };
    returns.filter(|r| taken.insert(cube(r.point))).collect()
}

/// Cubes of the two selections, metres; the larger ones follow the number of returns that is wanted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampling {
    pub(crate) dense_m: f32,
    pub(crate) sparse_m: f32,
    pub(crate) wanted: usize,
}

impl Sampling {
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
            .map(|(i, &point)| Return { point, share: share(i) });
        let dense = thinned(returns, self.dense_m, scan.points.len() / 2);
        let sparse = thinned(dense.iter().copied(), self.sparse_m, self.wanted);
        let ratio = sparse.len().max(1) as f32 / self.wanted as f32;
        // Returns lie on surfaces: their number falls with the square of the cubes' edge.
        self.sparse_m = (self.sparse_m * ratio.sqrt().clamp(0.7, 1.4)).clamp(self.dense_m, 2.0);
        Sampled {
            span: (f64::from(span.0), f64::from(span.1)),
            dense,
            sparse,
        }
    }
}
