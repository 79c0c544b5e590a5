//! Patches between neighbouring returns, so that a surface is closed where beams are farther apart than voxels.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    ROUGHNESS_M,
    surface::{Kind, Limits, Patch, Turn},
};
use crate::sensor::{PART, ScanImage};

/// Patches whose normals are at most this far apart may be of one surface; and a link between rays is at least this far from them: a
/// cosine, of 26°.
pub const MIN_DOT: f32 = 0.9;

/// Each of the two lies on the plane of the other, up to this many standard deviations of ranges.
pub const MAX_OFF: f32 = 4.0;

/// Two planes of whole windows certify what lies between them, up to this many times the widest gap, if the map knows of no surface behind it, …
pub const COPLANAR_GAPS: f32 = 4.0;

/// … but no farther than this, metres, …
pub const COPLANAR_LENGTH_M: f32 = 3.0;

/// … if each of the two is no farther off the plane of the other than this, metres, …
pub const COPLANAR_OFF_M: f32 = 2.0 * ROUGHNESS_M;

/// … and their normals no farther apart than this cosine, of 5°.
pub const COPLANAR_DOT: f32 = 0.996;

/// From this range on, metres, the greatest gap grows with the range, as the one between beams does.
pub const FAR_M: f32 = 25.0;

/// Returns are linked no farther apart than this share of their range.
pub const MAX_GAP_OF_RANGE: f32 = 0.5;

/// Returns of neighbouring columns are linked no farther apart than this, metres. Where rays graze a row of façades, the next column may be
/// metres farther on, past an opening; a road, which rings graze, has none.
pub const MAX_GAP_ACROSS_M: f32 = 1.0;

/// The widest gap that is closed at some range.
#[inline(always)]
pub fn widest_gap_m(max_gap_m: f32, range_m: f32) -> f32 {
    max_gap_m * (range_m / FAR_M).max(1.0)
}

/// Patches are made in any case up to this many for each return, whatever [`Limits::most`] says.
const ALWAYS: usize = 16;

/// Finds patches between those of neighbouring returns (next ring, next column), at most `step_m` apart. Where columns are denser than
/// that, only every second, fourth, … is linked to the next ring. Keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Between {
    parts: Vec<Vec<Patch>>,
}

impl Between {
    /// Appends them; `None` if there are too many of them, because voxels are very small. No wide link is made where a patch of it
    /// `is_contradicted` by what the map holds.
    pub(super) fn append_to(
        &mut self,
        all: &mut Vec<Patch>,
        image: &ScanImage,
        column_rad: f32,
        limits: &Limits,
        is_contradicted: impl Fn(&Patch) -> bool + Sync,
    ) -> Option<()> {
        let count = all.len();
        self.parts.resize_with(count.div_ceil(PART), Vec::new);
        let room = (limits.most / self.parts.len().max(1)).max(ALWAYS * PART);
        self.parts.par_iter_mut().enumerate().try_for_each(|(part, between)| {
            between.clear();
            for i in part * PART..((part + 1) * PART).min(count) {
                let Some((ring, column)) = image.place_of(i) else {
                    continue;
                };
                let dense = limits.step_m / (column_rad * all[i].center.length());
                let cells = 1..=limits.neighbour_cells;
                let above = cells.clone().find_map(|k| image.get(ring + k, column));
                let above = above.filter(|_| column % nth(dense) == 0);
                let next = cells
                    .into_iter()
                    .find_map(|k| image.get(ring, (column + k) % image.columns()));
                for (other, longest_m) in [(above, f32::INFINITY), (next, MAX_GAP_ACROSS_M)] {
                    let Some(other) = other else {
                        continue;
                    };
                    // The end that takes part more often, since it is less known, tells when.
                    let (turn, others) = (all[i].turn, all[other].turn);
                    let turn = if others.times < turn.times { others } else { turn };
                    if !turn.is_due {
                        continue;
                    }
                    let Some(link) = linked(&all[i], &all[other], longest_m, limits) else {
                        continue;
                    };
                    let more = on_the_way(&all[i], &all[other], link.kind, limits.step_m);
                    if more.len() > room - between.len() {
                        return None;
                    }
                    if link.is_wide && more.clone().any(|patch| is_contradicted(&patch)) {
                        continue;
                    }
                    between.extend(more.map(|patch| Patch { turn, ..patch }));
                }
            }
            Some(())
        })?;
        self.parts.iter().for_each(|part| all.extend_from_slice(part));
        Some(())
    }
}

/// The greatest power of two that is not above a number; at least 1.
#[inline(always)]
fn nth(dense: f32) -> usize {
    1 << (dense as u32).max(1).ilog2()
}

/// Two neighbours that are of one surface.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Link {
    kind: Kind,
    /// Something as large as a window of a house would be missed between the two rays.
    is_wide: bool,
}

/// What is known between two neighbours; `None` if nothing tells that they are of one surface, or if they are too far apart.
#[inline(always)]
fn linked(a: &Patch, b: &Patch, longest_m: f32, limits: &Limits) -> Option<Link> {
    let apart = b.center - a.center;
    let gap = apart.length();
    // As most are not. Also false for NaN.
    if !(gap >= limits.step_m && gap <= longest_m) {
        return None;
    }
    let ranges = [a, b].map(|patch| patch.center.length());
    let range = ranges[0].min(ranges[1]);
    if !(gap <= MAX_GAP_OF_RANGE * range) {
        return None;
    }
    let widest = widest_gap_m(limits.max_gap_m, range);
    // Without a plane there is no normal, and nothing is off it.
    let off = a.normal.dot(apart).abs().max(b.normal.dot(apart).abs());
    let is_one_plane = || off <= MAX_OFF * limits.noise_m && a.normal.dot(b.normal) >= MIN_DOT;
    let kind = a.kind.min(b.kind);
    let mut is_wide = false;
    let is_one = match kind {
        Kind::Ray => gap <= widest && off <= limits.window_m && (ranges[1] - ranges[0]).abs() <= MIN_DOT * gap,
        // It is known as far as the part of the window reaches that it takes.
        Kind::Half => {
            let growing = limits.max_gap_m * (range / FAR_M);
            gap <= growing.max(2.0 * limits.window_m).min(widest) && is_one_plane()
        }
        // As the sensor sees it: what could stand between two rings on a road is no higher.
        Kind::Whole => {
            let seen = apart.reject_from(a.center + b.center).length();
            is_wide = seen > widest;
            !is_wide && is_one_plane()
                || seen <= COPLANAR_GAPS * widest
                    && gap <= COPLANAR_LENGTH_M
                    && off <= COPLANAR_OFF_M
                    && a.normal.dot(b.normal) >= COPLANAR_DOT
        }
    };
    is_one.then_some(Link { kind, is_wide })
}

/// Patches between two.
#[inline(always)]
fn on_the_way(a: &Patch, b: &Patch, kind: Kind, step_m: f32) -> impl ExactSizeIterator<Item = Patch> + Clone {
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
            turn: Turn::default(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::SensorModel;

    const LIMITS: Limits = Limits {
        window_m: 0.1,
        noise_m: 0.02,
        step_m: 0.075,
        max_gap_m: 0.4,
        neighbour_cells: 1,
        most: usize::MAX,
    };

    fn patch(center: Vec3, normal: Vec3, kind: Kind) -> Patch {
        Patch {
            center,
            normal,
            kind,
            turn: Turn::default(),
        }
    }

    /// Whether what the sensor meets head-on `range` away, `gap` apart, is linked.
    fn facing(kind: Kind, range: f32, gap: f32, max_gap_m: f32) -> bool {
        let normal = if kind == Kind::Ray { Vec3::ZERO } else { -Vec3::X };
        let at = |y: f32| patch(Vec3::new(range, y, 0.0), normal, kind);
        let limits = Limits { max_gap_m, ..LIMITS };
        let link = linked(&at(-0.5 * gap), &at(0.5 * gap), f32::INFINITY, &limits);
        assert!(link.is_none_or(|link| link.kind == kind));
        link.is_some()
    }

    #[test]
    fn gaps_are_linked_up_to_a_width_that_grows_far_away() {
        // Kind, range, and the widest gap that is linked there.
        for (kind, range, widest) in [
            (Kind::Ray, 5.0, 0.4),
            (Kind::Ray, 20.0, 0.4),
            (Kind::Ray, 50.0, 0.8),
            (Kind::Half, 5.0, 0.2),
            (Kind::Half, 20.0, 0.32),
            (Kind::Half, 50.0, 0.8),
            (Kind::Whole, 5.0, 1.6),
            (Kind::Whole, 40.0, 2.56),
            (Kind::Whole, 50.0, 3.0),
            (Kind::Whole, 0.6, 0.3), // half the range
        ] {
            assert!(facing(kind, range, 0.98 * widest, 0.4), "{kind:?} {range}");
            assert!(!facing(kind, range, 1.05 * widest, 0.4), "{kind:?} {range}");
            assert!(!facing(kind, range, 0.98 * widest, 0.0), "{kind:?} {range}");
        }
        assert!(facing(Kind::Ray, 5.0, 0.08, 0.4) && !facing(Kind::Ray, 5.0, 0.07, 0.4));
    }

    #[test]
    fn in_a_grid_neighbours_are_found_over_empty_cells() {
        // On a wall 8 m away, rows and columns 5 cm apart, every third of which has returns.
        let (rows, columns) = (10, 1000);
        let wide_rad = std::f32::consts::TAU / columns as f32;
        let elevations = (0..rows).map(|row| (row as f32 * wide_rad).to_degrees()).collect();
        let model = SensorModel::from_beams("grid", elevations, columns, (0.1, 100.0)).unwrap();
        let cells = (0..rows)
            .step_by(3)
            .flat_map(|row| (0..9).step_by(3).map(move |column| (row, column)));
        let at = |(row, column): (u16, u16)| {
            let (up, along) = (f32::from(row) * wide_rad, (f32::from(column) + 0.5) * wide_rad);
            Vec3::new(8.0, -8.0 * along.tan(), 8.0 * up.tan() / along.cos())
        };
        let points: Vec<Vec3> = cells.clone().map(at).collect();
        let rings: Vec<u16> = cells.map(|(row, _)| row).collect();
        let mut image = ScanImage::new();
        image.update(&points, &rings, &model);
        let wall = |&center: &Vec3| patch(center, -Vec3::X, Kind::Half);
        let count = |neighbour_cells: usize| {
            let mut all: Vec<Patch> = points.iter().map(wall).collect();
            let limits = Limits {
                neighbour_cells,
                ..LIMITS
            };
            Between::default()
                .append_to(&mut all, &image, wide_rad, &limits, |_| false)
                .unwrap();
            all.len() - points.len()
        };
        // 4 × 3 returns have 3 × 3 neighbours above and 4 × 2 beside, 15 cm apart: a patch or two between them.
        assert_eq!((count(1), count(2)), (0, 0));
        assert!((17..=34).contains(&count(3)), "{}", count(3));
    }

    #[test]
    fn wide_gaps_stay_where_surface_lies_behind() {
        // Two rings on a wall, and a window between them.
        let count = |apart_deg: f32, window: bool| {
            let sensor = SensorModel::from_beams("two rings", vec![0.0, apart_deg], 900, (0.1, 100.0)).unwrap();
            let wide_rad = std::f32::consts::TAU / 900.0;
            let up = 8.0 * apart_deg.to_radians().tan();
            let points = [0.0, up].map(|up| Vec3::new(8.0, -4.0 * wide_rad, up));
            let mut image = ScanImage::new();
            image.update(&points, &[0, 1], &sensor);
            let mut all: Vec<Patch> = points.map(|p| patch(p, -Vec3::X, Kind::Whole)).to_vec();
            let is_contradicted = |patch: &Patch| window && (patch.center.z - 0.5 * up).abs() < 0.1;
            Between::default()
                .append_to(&mut all, &image, wide_rad, &LIMITS, is_contradicted)
                .unwrap();
            all.len() - points.len()
        };
        // 0.7 m apart: more than the 0.4 m that are closed anyhow.
        assert_eq!((count(5.0, false), count(5.0, true)), (9, 0));
        assert_eq!((count(2.5, false), count(2.5, true)), (4, 4));
    }

    #[test]
    fn on_a_road_the_gap_is_what_the_sensor_sees_of_it() {
        // 1.8 m below the sensor; rays meet it at 9°.
        let road = |x: f32, kind: Kind| patch(Vec3::new(x, 0.0, -1.8), Vec3::Z, kind);
        let of = |kind: Kind, far: f32| {
            let link = linked(&road(11.0, kind), &road(far, kind), f32::INFINITY, &LIMITS);
            link.map(|link| link.kind)
        };
        assert_eq!(of(Kind::Whole, 13.6), Some(Kind::Whole)); // 0.38 m
        assert_eq!(of(Kind::Whole, 14.1), None); // more than 3 m
        assert_eq!((of(Kind::Half, 11.3), of(Kind::Ray, 11.3)), (None, None));
    }

    #[test]
    fn wider_gaps_take_planes_that_agree() {
        let wall = |y: f32, off: f32, turn: f32| {
            let (sin, cos) = turn.to_radians().sin_cos();
            patch(Vec3::new(10.0 + off, y, 0.0), Vec3::new(-cos, sin, 0.0), Kind::Whole)
        };
        let to = |other: Patch| linked(&wall(0.0, 0.0, 0.0), &other, f32::INFINITY, &LIMITS).is_some();
        assert!(to(wall(1.5, 0.0, 0.0)) && to(wall(1.5, 0.019, 0.0)) && to(wall(0.3, 0.0, 4.0)));
        assert!(!to(wall(1.7, 0.0, 0.0)) && !to(wall(1.5, 0.021, 0.0)));
        // 5.5° and 6 cm off: as of a curve.
        let curved = wall(0.6, 0.03, 5.5);
        assert!(
            !to(curved)
                && to(Patch {
                    kind: Kind::Whole,
                    ..wall(0.39, 0.02, 5.5)
                })
        );
    }

    #[test]
    fn along_a_row_of_facades_openings_are_not_closed() {
        // 2 m beside the sensor; rays meet it at 8°.
        let facade = |x: f32| patch(Vec3::new(x, 2.0, 0.0), -Vec3::Y, Kind::Whole);
        let of = |far: f32, longest_m: f32| {
            let link = linked(&facade(14.0), &facade(far), longest_m, &LIMITS);
            link.map(|link| link.kind)
        };
        assert_eq!(of(14.9, MAX_GAP_ACROSS_M), Some(Kind::Whole));
        assert_eq!(of(15.1, MAX_GAP_ACROSS_M), None);
        let as_rings = of(15.1, f32::INFINITY);
        assert_eq!(as_rings, Some(Kind::Whole));
    }

    #[test]
    fn what_lies_on_other_planes_is_not_linked() {
        let wall = |x: f32, y: f32, turn: f32| {
            let (sin, cos) = turn.to_radians().sin_cos();
            patch(Vec3::new(x, y, 0.0), Vec3::new(-cos, sin, 0.0), Kind::Whole)
        };
        let with = |other: Patch| linked(&wall(10.0, 0.0, 0.0), &other, f32::INFINITY, &LIMITS).is_some();
        assert!(with(wall(10.07, 0.3, 0.0)) && !with(wall(10.09, 0.3, 0.0)));
        assert!(with(wall(10.0, 0.1, 25.0)) && !with(wall(10.0, 0.1, 27.0)));
        // Of a return without a plane it is a window's half.
        let ray = |x: f32| patch(Vec3::new(x, 0.3, 0.0), Vec3::ZERO, Kind::Ray);
        assert!(with(ray(10.09)) && !with(ray(10.11)));
    }
}
