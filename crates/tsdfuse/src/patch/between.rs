//! Patches between neighbouring returns, so that a surface is closed where beams are farther apart than voxels.
//!
//! ```text
//!  ring r+1   d ─ · ─ e      return a sees to what lies between it and the next one of its ring (b), between it and that of the
//!             │       │      next ring (d), and within the cell of the four, where all of its sides are links
//!             ·   ·   ·
//!             │       │
//!  ring r     a ─ · ─ b
//! ```

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

/// Finds patches between those of neighbouring returns, at most `step_m` apart. Where columns are denser than that, only every second,
/// fourth, … is linked to the next ring. Keeps its buffers.
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
                let patch = |ring, column| image.get(ring, column).map(|i| &all[i]);
                let next = if column + 1 == image.columns() { 0 } else { column + 1 };
                let a = &all[i];
                let dense = limits.step_m / (column_rad * a.center.length());
                let d = patch(ring + 1, column).filter(|_| column % nth(dense) == 0);
                let ab = patch(ring, next).and_then(|b| Link::new(a, b, limits));
                let ad = d.and_then(|d| Link::new(a, d, limits));
                [ab, ad].iter().flatten().for_each(|link| between.extend(link.patches()));
                if let (Some(ab), Some(ad)) = (ab, ad)
                    && ab.steps > 1
                    && ad.steps > 1
                    && let Some(e) = patch(ring + 1, next)
                    && let (Some(be), Some(de)) = (Link::new(ab.to, e, limits), Link::new(ad.to, e, limits))
                {
                    fill([ab, de], [ad, be], between);
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

/// Adds what lies within a cell, between two links along rings and two along columns.
fn fill(along: [Link<'_>; 2], up: [Link<'_>; 2], between: &mut Vec<Patch>) {
    let kind = along.iter().chain(&up).map(|link| link.kind).min().unwrap_or_default();
    let [columns, rings] = [along, up].map(|[one, other]| one.steps.max(other.steps));
    for column in 1..columns {
        let t = column as f32 / columns as f32;
        let [from, to] = &along.map(|link| Link { kind, ..link }.at(t));
        let steps = rings;
        between.extend(Link { from, to, kind, steps }.patches());
    }
}

/// Two patches with surface between them.
#[derive(Clone, Copy)]
struct Link<'a> {
    from: &'a Patch,
    to: &'a Patch,
    /// What is known between them.
    kind: Kind,
    /// So many steps from one to the other; 1 if nothing lies between them.
    steps: usize,
}

impl<'a> Link<'a> {
    /// `None` if nothing tells that two neighbours are of one surface.
    #[inline(always)]
    fn new(from: &'a Patch, to: &'a Patch, limits: &Limits) -> Option<Self> {
        let apart = to.center - from.center;
        let gap = apart.length();
        // Without a plane there is no normal, and nothing is off it.
        let off = from.normal.dot(apart).abs().max(to.normal.dot(apart).abs());
        let kind = from.kind.min(to.kind);
        let (far, is_one) = match kind {
            Kind::Ray => {
                let deeper = (to.center.length() - from.center.length()).abs();
                let is_one = off <= limits.window_m && deeper <= MIN_DOT * gap;
                (limits.max_gap_m.min(MAX_GAP_OF_RAYS_M), is_one)
            }
            _ => {
                let is_one = off <= MAX_OFF * limits.noise_m && from.normal.dot(to.normal) >= MIN_DOT;
                // A plane that takes part of a window only is known as far as that window reaches.
                let far = if kind == Kind::Whole {
                    limits.max_gap_m
                } else {
                    2.0 * limits.window_m
                };
                (far, is_one)
            }
        };
        let steps = (gap / limits.step_m).ceil() as usize;
        (gap <= far && is_one).then_some(Self { from, to, kind, steps })
    }

    /// The patch at a part of the way.
    #[inline(always)]
    fn at(&self, t: f32) -> Patch {
        let mixed = |from: Vec3, to: Vec3| from + (to - from) * t;
        let center = mixed(self.from.center, self.to.center);
        let normal = match self.kind {
            Kind::Ray => -center,
            _ => mixed(self.from.normal, self.to.normal),
        };
        Patch {
            center,
            normal: normal.normalize_or_zero(),
            kind: self.kind,
        }
    }

    /// What lies between the two.
    #[inline(always)]
    fn patches(&self) -> impl Iterator<Item = Patch> {
        (1..self.steps).map(|k| self.at(k as f32 / self.steps as f32))
    }
}
