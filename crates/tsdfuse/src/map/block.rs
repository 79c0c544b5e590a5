//! Voxels and blocks: what is stored, and in which numbers.
//!
//! A voxel holds S_w = Σ w and S_f = Σ w·f over all its updates, in fixed point, so that the update rule (3.5)(3.6)
//!
//! ```text
//!   F ← (W·F + Σ w f) / (W + Σ w),     W ← min(W + Σ w, W_max)
//! ```
//!
//! is a pair of integer additions: the same bits in any order, on any number of threads. F = S_f / S_w is derived when read.

use crate::index::{BLOCK_VOXELS, round};

/// Fixed-point scale of weights and of weighted distances: an update of weight 1 adds 32 768. A weight of 0.01 (a return at
/// 100 m) still adds 328, and moves S_f in steps of 1/328 of the truncation.
pub const WEIGHT_SCALE: u32 = 1 << 15;

/// The largest weight a voxel can hold: 32 768 observations of weight 1, or 800 000 at 25 m. What comes after is averaged as
/// `max_weight` says: F stays a running mean, the weight stays.
pub const MAX_WEIGHT: f32 = (1 << 15) as f32;

pub(crate) const MAX_WEIGHT_SUM: u32 = (MAX_WEIGHT as u32) * WEIGHT_SCALE;
// One update more fits both sums.
const _: () = assert!(MAX_WEIGHT_SUM as u64 + WEIGHT_SCALE as u64 <= i32::MAX as u64);

/// One voxel: fixed-point sums of weights and of weighted distances. All zero: never observed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Voxel {
    /// S_w·[`WEIGHT_SCALE`].
    pub weight_sum: u32,
    /// S_f·[`WEIGHT_SCALE`]; its magnitude never exceeds `weight_sum`.
    pub distance_sum: i32,
}

impl Voxel {
    /// W, the accumulated weight.
    #[inline]
    pub fn weight(self) -> f32 {
        self.weight_sum as f32 * (1.0 / WEIGHT_SCALE as f32)
    }

    /// F in [−1, 1]: the distance over the truncation, positive in front of the surface. `None` if never observed.
    #[inline]
    pub fn distance(self) -> Option<f32> {
        (self.weight_sum > 0).then(|| self.distance_sum as f32 / self.weight_sum as f32)
    }

    /// Adds the sums of many updates at once, |distance| ≤ weight ≤ 2²⁹. Neither sum can overflow if the voxel is brought back
    /// below its limit at once ([`Self::limit`]).
    #[inline]
    pub(crate) fn add_sums(&mut self, weight: i32, distance: i32) {
        self.weight_sum += weight as u32;
        self.distance_sum += distance;
    }

    /// Whether observations can sum up to this.
    pub(super) fn is_possible(self) -> bool {
        self.weight_sum <= MAX_WEIGHT_SUM && self.distance_sum.unsigned_abs() <= self.weight_sum
    }

    /// Limits the weight to `max_sum` (fixed point), keeping F.
    #[inline]
    pub(crate) fn limit(&mut self, max_sum: u32) {
        if self.weight_sum > max_sum {
            let scaled = i64::from(self.distance_sum) * i64::from(max_sum) / i64::from(self.weight_sum);
            *self = Self {
                weight_sum: max_sum,
                distance_sum: scaled as i32,
            };
        }
    }
}

/// 8×8×8 voxels, in the order of [`local_number`](crate::index::local_number).
#[repr(align(64))]
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// The voxels.
    pub voxels: [Voxel; BLOCK_VOXELS],
}

impl Block {
    /// A block in which nothing was observed.
    pub const EMPTY: Self = Self {
        voxels: [Voxel {
            weight_sum: 0,
            distance_sum: 0,
        }; BLOCK_VOXELS],
    };

    /// Whether any voxel was observed.
    pub fn is_observed(&self) -> bool {
        self.voxels.iter().any(|v| v.weight_sum > 0)
    }
}

/// The fixed-point form of an update: weight (clamped to 0..=1; 0 is no update) and weighted distance (clamped to ±1).
#[inline(always)]
pub(crate) fn fixed(distance: f32, weight: f32) -> (i32, i32) {
    let weight = round(weight.clamp(0.0, 1.0) * WEIGHT_SCALE as f32);
    (weight, round(distance.clamp(-1.0, 1.0) * weight as f32))
}

/// The smallest weight sum that makes a weight of at least `min_weight`.
pub(crate) fn min_weight_sum(min_weight: f32) -> u32 {
    (min_weight.max(0.0) * WEIGHT_SCALE as f32).ceil() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observations_beyond_the_limit_keep_a_running_mean() {
        let mut v = Voxel::default();
        let add = |v: &mut Voxel, weight: u32, distance: i32| {
            v.add_sums(weight as i32, distance);
            v.limit(MAX_WEIGHT_SUM);
        };
        let (near, far) = (WEIGHT_SCALE as i32 / 4, WEIGHT_SCALE as i32 / 2);
        for i in 0..300_000 {
            add(&mut v, WEIGHT_SCALE, if i % 2 == 0 { near } else { far });
        }
        assert_eq!(v.weight(), MAX_WEIGHT);
        assert!((v.distance().unwrap() - 0.375).abs() < 1e-3, "{v:?}");
        // A small weight still moves a full voxel.
        let before = v.distance_sum;
        (0..1000).for_each(|_| add(&mut v, WEIGHT_SCALE / 100, -(WEIGHT_SCALE as i32) / 100));
        assert!(v.distance_sum < before);
    }

    #[test]
    fn limiting_the_weight_keeps_the_distance() {
        let mut v = Voxel {
            weight_sum: 3_000_000,
            distance_sum: -1_500_000,
        };
        v.limit(1000);
        assert_eq!(
            v,
            Voxel {
                weight_sum: 1000,
                distance_sum: -500
            }
        );
        v.limit(2000);
        assert_eq!(v.weight_sum, 1000);
    }
}
