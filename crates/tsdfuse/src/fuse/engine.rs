//! What both engines, [`Lines`](super::Lines) and [`Gather`](super::Gather), need.

use fearless_simd::{Simd, f32x8, i32x8, prelude::*};

use super::{Integration, Skipped};
use crate::{
    index::{BlockIndex, ROUND},
    map::WEIGHT_SCALE,
};

/// Pieces of a scan: enough to balance the load of many threads.
pub(super) const PIECES: usize = 32;

/// Why a return makes no update; counted in [`Skipped`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Skip {
    /// It is not finite, at the sensor's origin, or outside of the grid.
    OutsideGrid,
    /// It has no surface normal.
    WithoutNormal,
    /// The method gives it no weight.
    WithoutWeight,
}

/// What became of the items of one piece of a scan.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    fused: u64,
    skipped: Skipped,
}

impl Counts {
    pub(super) fn count(&mut self, done: Result<(), Skip>) {
        match done {
            Ok(()) => self.fused += 1,
            Err(Skip::OutsideGrid) => self.skipped.outside_grid += 1,
            Err(Skip::WithoutNormal) => self.skipped.without_normal += 1,
            Err(Skip::WithoutWeight) => self.skipped.without_weight += 1,
        }
    }

    /// What an integration did that updated these blocks.
    pub(super) fn sum<'a>(
        updated_blocks: Vec<BlockIndex>,
        find_secs: f64,
        all: impl Iterator<Item = &'a Self>,
    ) -> Integration {
        let mut done = Integration {
            updated_blocks,
            find_secs,
            ..Default::default()
        };
        for counts in all {
            done.skipped += counts.skipped;
            done.fused_returns += counts.fused;
        }
        done
    }
}

/// [`fixed`](crate::map::fixed), for eight voxels.
#[inline(always)]
pub(super) fn fixed_row<S: Simd>(distance: f32x8<S>, weight: f32x8<S>) -> (i32x8<S>, i32x8<S>) {
    let scaled = weight.max(0.0).min(1.0) * WEIGHT_SCALE as f32 + ROUND;
    let product = distance.max(-1.0).min(1.0) * (scaled - ROUND) + ROUND;
    let zero = ROUND.to_bits() as i32;
    (
        scaled.bitcast::<i32x8<S>>() - zero,
        product.bitcast::<i32x8<S>>() - zero,
    )
}
