//! Patches between neighbouring returns, so that a surface is closed where beams are farther apart than voxels.

use glam::Vec3;
use rayon::prelude::*;

use super::{Kind, Limits, Patch};
use crate::sensor::{PART, ScanImage};

/// Patches whose normals are at most this far apart may be of one surface; and a link between rays is at least this far from them: a
/// cosine, of 26°.
pub const MIN_DOT: f32 = 0.9;

/// Each of the two lies on the plane of the other, up to this many standard deviations of ranges.
pub const MAX_OFF: f32 = 2.0;

/// Where not both have planes, returns are linked no farther apart than this, metres.
pub const MAX_GAP_OF_RAYS_M: f32 = 0.4;

/// Finds patches between those of neighbouring returns (next ring, next column), at most `step_m` apart. Where columns are denser than
/// that, only every second, fourth, … is linked to the next ring. Keeps its buffers.
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
                let Some((ring, column)) = image.place_of(i) else {
                    continue;
                };
                let next = if column + 1 == image.columns() { 0 } else { column + 1 };
                let dense = limits.step_m / (column_rad * all[i].center.length());
                let above = image.get(ring + 1, column).filter(|_| column % nth(dense) == 0);
                for other in [above, image.get(ring, next)].into_iter().flatten() {
                    if let Some(kind) = linked(&all[i], &all[other], limits) {
                        between.extend(on_the_way(&all[i], &all[other], kind, limits.step_m));
                    }
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

/// What is known between two neighbours; `None` if nothing tells that they are of one surface.
#[inline(always)]
fn linked(a: &Patch, b: &Patch, limits: &Limits) -> Option<Kind> {
    let apart = b.center - a.center;
    let gap = apart.length();
    // Without a plane there is no normal, and nothing is off it.
    let off = a.normal.dot(apart).abs().max(b.normal.dot(apart).abs());
    let kind = a.kind.min(b.kind);
    let (far, is_one) = match kind {
        Kind::Ray => {
            let deeper = (b.center.length() - a.center.length()).abs();
            let is_one = off <= limits.window_m && deeper <= MIN_DOT * gap;
            (limits.max_gap_m.min(MAX_GAP_OF_RAYS_M), is_one)
        }
        _ => {
            let is_one = off <= MAX_OFF * limits.noise_m && a.normal.dot(b.normal) >= MIN_DOT;
            // A plane that takes part of a window only is known as far as that window reaches.
            let far = if kind == Kind::Whole {
                limits.max_gap_m
            } else {
                2.0 * limits.window_m
            };
            (far, is_one)
        }
    };
    (gap >= limits.step_m && gap <= far && is_one).then_some(kind)
}

/// Patches between two.
#[inline(always)]
fn on_the_way(a: &Patch, b: &Patch, kind: Kind, step_m: f32) -> impl Iterator<Item = Patch> {
    let steps = (a.center.distance(b.center) / step_m).ceil();
    (1..steps as usize).map(move |k| {
        let mixed = |a: Vec3, b: Vec3| a + (b - a) * (k as f32 / steps);
        let center = mixed(a.center, b.center);
        let normal = match kind {
            Kind::Ray => -center,
            _ => mixed(a.normal, b.normal),
        };
        Patch {
            center,
            normal: normal.normalize_or_zero(),
            kind,
        }
    })
}
