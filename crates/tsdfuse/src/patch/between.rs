//! Patches between neighbouring returns of one surface, so that a surface is closed where beams are farther apart than voxels.

use glam::Vec3;
use rayon::prelude::*;

use super::{Limits, Patch};
use crate::sensor::{PART, ScanImage};

/// Patches whose normals are at most this far apart may be of one surface: a cosine, of 26°.
pub const MIN_DOT: f32 = 0.9;

/// Each of the two lies on the plane of the other, up to this many standard deviations of ranges.
pub const MAX_OFF: f32 = 2.0;

/// Finds patches between those of neighbouring returns (next ring, next column), at most `step_m` apart. Where columns are denser than
/// that, only every second, fourth, … has patches to the next ring. Keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Between {
    parts: Vec<Vec<Patch>>,
}

impl Between {
    /// Appends them.
    pub(super) fn append_to(&mut self, all: &mut Vec<Patch>, image: &ScanImage, column_rad: f32, limits: &Limits) {
        let count = all.len();
        self.parts.resize_with(count.div_ceil(PART), Vec::new);
        self.parts.par_iter_mut().enumerate().for_each(|(part, between)| {
            between.clear();
            for i in part * PART..((part + 1) * PART).min(count) {
                let Some((ring, column)) = image.place_of(i).filter(|_| all[i].is_some()) else {
                    continue;
                };
                let next = if column + 1 == image.columns() { 0 } else { column + 1 };
                let dense = limits.step_m / (column_rad * all[i].center.length());
                let above = image.get(ring + 1, column).filter(|_| column % nth(dense) == 0);
                for other in [above, image.get(ring, next)].into_iter().flatten() {
                    connect(&all[i], &all[other], limits, between);
                }
            }
        });
        self.parts.iter().for_each(|part| all.extend_from_slice(part));
    }
}

/// The greatest power of two that is not above a number; at least 1.
#[inline(always)]
fn nth(dense: f32) -> usize {
    1 << (dense as u32).max(1).ilog2()
}

/// Adds what lies between two patches, if they are of one surface.
#[inline(always)]
fn connect(a: &Patch, b: &Patch, limits: &Limits, between: &mut Vec<Patch>) {
    let apart = b.center - a.center;
    let gap = apart.length();
    // A plane that takes part of a window only is known as far as that window reaches.
    let far = if a.whole && b.whole {
        limits.max_gap_m
    } else {
        2.0 * limits.window_m
    };
    if !(limits.step_m..=far).contains(&gap) || !b.is_some() || a.normal.dot(b.normal) < MIN_DOT {
        return;
    }
    let off = a.normal.dot(apart).abs().max(b.normal.dot(apart).abs());
    if off > MAX_OFF * limits.noise_m {
        return;
    }
    let steps = (gap / limits.step_m).ceil();
    for k in 1..steps as usize {
        let t = k as f32 / steps;
        between.push(Patch {
            center: a.center + apart * t,
            normal: lerp(a.normal, b.normal, t),
            whole: true,
        });
    }
}

fn lerp(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    (a + (b - a) * t).normalize_or_zero()
}
