//! Poses from which a whole map is seen: from above, at an angle.

use std::collections::HashSet;
use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec3};

use super::Renderer;
use super::camera::Camera;
use crate::Pose;
use crate::index::{BlockIndex, RegionIndex, voxel_at};
use crate::sensor::Pinhole;

/// How far down the camera looks.
const PITCH_RAD: f64 = 0.65;

/// How far an overview may look down.
const PITCHES_RAD: [f64; 3] = [0.35, 0.5, 0.65];

/// Overviews are tried from so many sides.
const TURNS: usize = 12;

/// Pixels in a row of the pictures that tell how much is seen.
const TRIAL: u32 = 64;

/// Shares of the surface that may lie beyond each side of an overview.
const OUTSIDE: [f64; 6] = [0.01, 0.03, 0.06, 0.1, 0.15, 0.2];

/// Points that stand for the surface, at most.
const POINTS: usize = 4000;

/// How far the view turns away from looking straight across the map's long side.
const OBLIQUE_RAD: f64 = 0.45;

/// The share of the surface beyond each side of the box that is shown, at most: what lies far out is sparse.
const BEYOND: f64 = 0.08;

/// The share of the surface at each end that may be a thin tail.
const TAIL: f64 = 0.15;

/// Regions that hold this many times less surface than those of most of the surface are not dense.
const DENSE: u64 = 2;

/// Surface within this of the path counts, metres.
const AROUND_M: f64 = 18.0;

/// A flight's camera is so far above the sensor's places, and looks so far ahead, metres.
const ABOVE_M: f64 = 1.2;
/// See [`ABOVE_M`].
const AHEAD_M: f64 = 9.0;

/// Places to each side that a place of a flight is averaged with.
const SMOOTH: usize = 4;

/// A shorter path goes nowhere, metres.
const SHORTEST_M: f64 = 0.2;

/// The share of the image that stays free at its borders.
const MARGIN: f64 = 0.04;

/// The pose from which a camera sees most of the map's surface, and little else: of views from all sides, the one whose picture holds the
/// most of the surface times the share of its pixels that see some. Of a map whose sensor's `path` (world) is known, only what lies
/// around it counts; without surface there, all does. `None` for a map without surface.
pub fn overview(renderer: &Renderer, camera: &Pinhole, path: &[DVec3]) -> Option<Pose> {
    let hull = Hull::of(renderer, path)?;
    let scale = TRIAL as f32 / camera.width as f32;
    let height = ((camera.height as f32 * scale).round() as u32).max(1);
    let small = Pinhole {
        width: TRIAL,
        height,
        fx: camera.fx * scale,
        fy: camera.fy * scale,
        cx: 0.5 * (TRIAL - 1) as f32,
        cy: 0.5 * (height - 1) as f32,
    };
    let turns = (0..TURNS).map(|i| OBLIQUE_RAD + TAU * i as f64 / TURNS as f64);
    let axes = turns.flat_map(|turn| PITCHES_RAD.map(|pitch| hull.axes(turn, pitch)));
    let tries = axes.flat_map(|axes| OUTSIDE.map(|outside| (axes, outside)));
    let tried = tries.filter_map(|(axes, outside)| {
        let place = hull.framing(camera, axes, outside);
        let pose = Pose {
            rotation: axes,
            translation: hull.center + axes * place,
        };
        let view = renderer.view(&Camera::Pinhole(small), pose).ok()?;
        let seen = hull.share_within(camera, pose) * view.hit_count() as f64 / view.hits.len() as f64;
        Some((seen, pose))
    });
    // The first of the best.
    let best = tried.reduce(|best, other| if other.0 > best.0 { other } else { best });
    best.map(|(_, pose)| pose)
}

/// `count` poses around most of the map's surface, all as far from it; the first looks across its long side, the others follow
/// counter-clockwise. What is far out and sparse may lie outside of the pictures. What counts is as for [`overview`]. None for a map without surface.
pub fn turntable(renderer: &Renderer, camera: &Pinhole, path: &[DVec3], count: usize) -> Vec<Pose> {
    let Some(hull) = Hull::of(renderer, path) else {
        return Vec::new();
    };
    let turns = (0..count).map(|i| OBLIQUE_RAD + TAU * i as f64 / count as f64);
    let places: Vec<_> = turns
        .map(|turn| (hull.axes(turn, PITCH_RAD), hull.place(camera, turn)))
        .collect();
    let back = places.iter().map(|(_, place)| place.x).fold(0.0, f64::min);
    let pose = |(axes, place): (DQuat, DVec3)| Pose {
        rotation: axes,
        translation: hull.center + axes * DVec3::new(back, place.y, place.z),
    };
    places.into_iter().map(pose).collect()
}

/// What lies around a path, seen from above.
struct Near(HashSet<(i64, i64)>);

impl Near {
    /// Squares of a third of [`AROUND_M`], each within it of the path.
    fn new(path: &[DVec3]) -> Self {
        let around = |(x, y): (i64, i64)| (-3..=3).flat_map(move |dx| (-3..=3).map(move |dy| (x + dx, y + dy)));
        Self(
            path.iter()
                .map(|place| Self::square(*place))
                .collect::<HashSet<_>>()
                .into_iter()
                .flat_map(around)
                .collect(),
        )
    }

    fn square(place: DVec3) -> (i64, i64) {
        let at = (place / (AROUND_M / 3.0)).floor();
        (at.x as i64, at.y as i64)
    }

    fn is_near(&self, place: DVec3) -> bool {
        self.0.contains(&Self::square(place))
    }
}

/// Poses of a flight along a path (world), in even steps: some way above the sensor's places, smoothed, looking ahead. None for a path
/// that goes nowhere.
pub fn flight(path: &[DVec3], count: usize) -> Vec<Pose> {
    let smooth = |i: usize| {
        // Even to both sides, so that the ends stay where they are.
        let far = SMOOTH.min(i).min(path.len() - 1 - i);
        let around = &path[i - far..=i + far];
        around.iter().sum::<DVec3>() / around.len() as f64
    };
    let places: Vec<DVec3> = (0..path.len()).map(smooth).collect();
    let mut lengths = vec![0.0];
    for pair in places.windows(2) {
        lengths.push(lengths[lengths.len() - 1] + pair[0].distance(pair[1]));
    }
    let whole = lengths[lengths.len() - 1];
    if whole < SHORTEST_M {
        return Vec::new();
    }
    let at = |length: f64| {
        let i = lengths
            .partition_point(|&before| before <= length)
            .clamp(1, places.len() - 1);
        let (from, to) = (lengths[i - 1], lengths[i]);
        let share = if to > from { (length - from) / (to - from) } else { 0.0 };
        places[i - 1].lerp(places[i], share.min(1.0))
    };
    let ahead_m = AHEAD_M.min(0.5 * whole);
    let pose = |i: usize| {
        let length = whole * i as f64 / (count.max(2) - 1) as f64;
        // Beyond the end, the way goes on straight.
        let beyond = ((length + ahead_m - whole) / ahead_m).max(0.0);
        let there = at((length + ahead_m).min(whole)) + (at(whole) - at(whole - 0.1 * ahead_m)) * (10.0 * beyond);
        let eye = at(length) + DVec3::Z * ABOVE_M;
        let way = (there - eye).normalize_or(DVec3::X);
        let rotation =
            DQuat::from_rotation_z(way.y.atan2(way.x)) * DQuat::from_rotation_y(-way.z.clamp(-1.0, 1.0).asin());
        Pose {
            rotation,
            translation: eye,
        }
    };
    (0..count).map(pose).collect()
}

/// The blocks where the surface is dense, and how much of it each holds: far from the sensor, single specks and lines lie about.
fn dense(renderer: &Renderer) -> Vec<(BlockIndex, u32)> {
    let mut blocks: Vec<_> = renderer.surface().collect();
    blocks.sort_unstable_by_key(|(block, _)| RegionIndex::of(*block));
    let regions = || blocks.chunk_by(|(a, _), (b, _)| RegionIndex::of(*a) == RegionIndex::of(*b));
    let held = |region: &[(BlockIndex, u32)]| region.iter().map(|(_, cells)| u64::from(*cells)).sum::<u64>();
    // Half of the surface lies in regions that hold as much, or more.
    let mut sums: Vec<u64> = regions().map(held).collect();
    sums.sort_unstable();
    let (mut below, all) = (0, sums.iter().sum::<u64>());
    let median = sums.into_iter().find(|sum| {
        below += sum;
        2 * below >= all
    });
    let kept = regions().filter(|region| DENSE * held(region) >= median.unwrap_or_default());
    kept.flatten().copied().collect()
}

/// What lies where along an axis: values, sorted, with their weights.
struct Spread {
    values: Vec<(f64, u32)>,
    weight: u64,
}

impl Spread {
    fn new(mut values: Vec<(f64, u32)>) -> Self {
        values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let weight = values.iter().map(|(_, weight)| u64::from(*weight)).sum();
        Self { values, weight }
    }

    /// The value below which this share of the weight lies.
    fn at(&self, share: f64) -> f64 {
        let wanted = share * self.weight as f64;
        let mut below = 0;
        let found = self.values.iter().find(|(_, weight)| {
            below += u64::from(*weight);
            below as f64 >= wanted
        });
        found.or(self.values.last()).map_or(0.0, |(value, _)| *value)
    }

    /// From where to where nearly all lies.
    fn nearly_all(&self) -> (f64, f64) {
        (self.at(BEYOND), self.at(1.0 - BEYOND))
    }

    /// As [`Self::nearly_all`], but no longer than the extent of evenly spread surface with the same quartiles: a thin tail is cut.
    /// What lies in the middle ([`TAIL`]) is never cut.
    fn most(&self) -> (f64, f64) {
        let ((low, high), first, third) = (self.nearly_all(), self.at(0.25), self.at(0.75));
        let (middle, half) = (0.5 * (first + third), third - first);
        let even = (
            (middle - half).min(self.at(TAIL)),
            (middle + half).max(self.at(1.0 - TAIL)),
        );
        (low.max(even.0), high.min(even.1))
    }
}

/// A box around most of the surface, upright and turned along its longest extent.
struct Hull {
    center: DVec3,
    /// Half of its edges, along its own axes, metres.
    half: DVec3,
    /// From the world's x axis to its own, about z.
    heading_rad: f64,
    /// Of the surface that counts: places from the centre, world axes, and how much each stands for.
    points: Vec<(DVec3, u32)>,
}

impl Hull {
    fn of(renderer: &Renderer, path: &[DVec3]) -> Option<Self> {
        let grid = renderer.map().grid();
        let center = |block| grid.center(voxel_at(block, 0)) + 3.5 * grid.voxel_size_m();
        let mut points: Vec<(DVec3, u32)> = dense(renderer)
            .into_iter()
            .map(|(block, cells)| (center(block), cells))
            .collect();
        let near = Near::new(path);
        if points.iter().any(|(point, _)| near.is_near(*point)) {
            points.retain(|(point, _)| near.is_near(*point));
        }
        let (first, _) = *points.first()?;
        // Relative to the first: covariances do not suffer from large coordinates.
        points.iter_mut().for_each(|(p, _)| *p -= first);
        let weight: f64 = points.iter().map(|(_, cells)| f64::from(*cells)).sum();
        let middle = points.iter().map(|(p, cells)| *p * f64::from(*cells)).sum::<DVec3>() / weight;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (d, w) in points.iter().map(|(p, cells)| (*p - middle, f64::from(*cells))) {
            (xx, xy, yy) = (xx + w * d.x * d.x, xy + w * d.x * d.y, yy + w * d.y * d.y);
        }
        let heading_rad = 0.5 * (2.0 * xy).atan2(xx - yy);
        let own_from_world = DQuat::from_rotation_z(-heading_rad);
        let block_m = 8.0 * grid.voxel_size_m();
        let spread = |axis: usize| {
            let own = points.iter().map(|(p, cells)| ((own_from_world * *p)[axis], *cells));
            Spread::new(own.collect())
        };
        let along = [spread(0).most(), spread(1).most(), spread(2).nearly_all()];
        let along = along.map(|(low, high)| (low - 0.5 * block_m, high + 0.5 * block_m));
        let low = DVec3::from(along.map(|(low, _)| low));
        let high = DVec3::from(along.map(|(_, high)| high));
        let center = own_from_world.conjugate() * (0.5 * (low + high));
        let step = points.len().div_ceil(POINTS);
        Some(Self {
            center: first + center,
            half: 0.5 * (high - low),
            heading_rad,
            points: points
                .into_iter()
                .step_by(step)
                .map(|(p, cells)| (p - center, cells))
                .collect(),
        })
    }

    /// The camera's axes in the world where it looks down across the box, turned counter-clockwise about it.
    fn axes(&self, turn_rad: f64, pitch_rad: f64) -> DQuat {
        DQuat::from_rotation_z(self.heading_rad + FRAC_PI_2 + turn_rad) * DQuat::from_rotation_y(pitch_rad)
    }

    /// The nearest place for a camera with these axes, from the centre in its axes, such that at most a share of the surface lies beyond
    /// each side of its image, metres.
    fn framing(&self, camera: &Pinhole, axes: DQuat, outside: f64) -> DVec3 {
        let own: Vec<(DVec3, u32)> = self
            .points
            .iter()
            .map(|(p, cells)| (axes.conjugate() * *p, *cells))
            .collect();
        let fit = |axis: usize, pixels: u32, focal: f32| {
            let t = half_view(pixels, focal);
            let most = |sign: f64| {
                let beyond = own.iter().map(|(p, cells)| (sign * p[axis] - t * p.x, *cells));
                Spread::new(beyond.collect()).at(1.0 - outside)
            };
            between(most(1.0), most(-1.0), t)
        };
        let (left, by_width) = fit(1, camera.width, camera.fx);
        let (up, by_height) = fit(2, camera.height, camera.fy);
        DVec3::new(-by_width.max(by_height), left, up)
    }

    /// The share of the surface that a camera has in its image.
    fn share_within(&self, camera: &Pinhole, pose: Pose) -> f64 {
        let camera_from_world = pose.inverse();
        let sum = |is_counted: &dyn Fn(DVec3) -> bool| {
            let counted = self.points.iter().filter(|(p, _)| is_counted(*p));
            counted.map(|(_, cells)| f64::from(*cells)).sum::<f64>()
        };
        let is_within = |p: DVec3| {
            let seen = camera_from_world.transform_point(self.center + p);
            camera.pixel(seen.as_vec3()).is_some()
        };
        sum(&is_within) / sum(&|_| true)
    }

    /// The nearest place from which the whole box is in the image, from the box's centre in the camera's axes, metres.
    fn place(&self, camera: &Pinhole, turn_rad: f64) -> DVec3 {
        let camera_from_own = self.axes(turn_rad, PITCH_RAD).conjugate() * DQuat::from_rotation_z(self.heading_rad);
        let corners = [0, 1, 2, 3, 4, 5, 6, 7].map(|c| {
            let side = |bit: i32| if c & bit == 0 { -1.0 } else { 1.0 };
            camera_from_own * (self.half * DVec3::new(side(1), side(2), side(4)))
        });
        let fit = |axis: usize, pixels: u32, focal: f32| {
            let t = half_view(pixels, focal);
            let most = |sign: f64| {
                corners
                    .iter()
                    .map(|p| sign * p[axis] - t * p.x)
                    .fold(f64::MIN, f64::max)
            };
            between(most(1.0), most(-1.0), t)
        };
        let (left, by_width) = fit(1, camera.width, camera.fx);
        let (up, by_height) = fit(2, camera.height, camera.fy);
        DVec3::new(-by_width.max(by_height), left, up)
    }
}

/// The tangent of half the field of view, without the borders that stay free.
fn half_view(pixels: u32, focal: f32) -> f64 {
    (0.5 - MARGIN) * f64::from(pixels) / f64::from(focal)
}

/// How far to the side, and how far back, a camera is whose image just holds some points. From (−d, s) a point (x, y) is in the image if
/// |y − s| ≤ t·(x + d), t being the tangent of half the field of view: d ≥ (a − s)/t and d ≥ (b + s)/t with a = max(y − t x),
/// b = max(−y − t x). Best is s = (a − b)/2, d = (a + b)/2t.
fn between(a: f64, b: f64, t: f64) -> (f64, f64) {
    (0.5 * (a - b), 0.5 * (a + b) / t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_goes_along_the_path_and_looks_ahead() {
        // A quarter of a circle of 40 m, and a straight way.
        let turn = (0..=90)
            .map(|i| f64::from(i).to_radians())
            .map(|a| DVec3::new(40.0 * a.sin(), 40.0 - 40.0 * a.cos(), 2.0));
        let path: Vec<DVec3> = turn
            .chain((1..=60).map(|i| DVec3::new(40.0, 40.0 + f64::from(i), 2.0)))
            .collect();
        let poses = flight(&path, 200);
        assert_eq!(poses.len(), 200);
        let steps: Vec<f64> = poses
            .windows(2)
            .map(|pair| pair[0].translation.distance(pair[1].translation))
            .collect();
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        assert!(steps.iter().all(|step| (step / mean - 1.0).abs() < 0.2), "{steps:?}");
        for pair in poses.windows(2) {
            let (way, ahead) = (
                (pair[1].translation - pair[0].translation).normalize(),
                pair[0].rotation * DVec3::X,
            );
            assert!(way.dot(ahead) > 0.95, "{way} {ahead}");
            let near = path
                .iter()
                .map(|place| place.distance(pair[0].translation))
                .fold(f64::MAX, f64::min);
            assert!(near < 1.5, "{near}");
            assert!((pair[0].rotation * DVec3::Y).z.abs() < 1e-9, "the horizon is level");
        }
        assert!(
            flight(&[], 10).is_empty() && flight(&[DVec3::X; 9], 10).is_empty() && flight(&path[..3], 10).len() == 10
        );
    }

    #[test]
    fn squares_around_a_path_are_near() {
        let near = Near::new(&[DVec3::ZERO, DVec3::X * 100.0]);
        assert!(near.is_near(DVec3::new(10.0, -10.0, 50.0)) && near.is_near(DVec3::new(95.0, 0.0, 0.0)));
        assert!(!near.is_near(DVec3::new(50.0, 0.0, 0.0)) && !near.is_near(DVec3::new(0.0, 26.0, 0.0)));
    }

    fn spread(values: impl IntoIterator<Item = (f64, u32)>) -> (f64, f64) {
        Spread::new(values.into_iter().collect()).most()
    }

    #[test]
    fn evenly_spread_surface_is_shown_and_a_thin_tail_is_cut() {
        let even = || (0..1000).map(|i| (f64::from(i), 10));
        let (low, high) = spread(even());
        assert!(
            (low - 79.0).abs() < 2.0 && (high - 919.0).abs() < 2.0,
            "{low} to {high}"
        );
        // A tail with a tenth of all, far beyond: of it, the share alone would leave some.
        let tail = || (0..1000).map(|i| (1000.0 + 10.0 * f64::from(i), 1));
        let tailed = Spread::new(even().chain(tail()).collect());
        assert!(tailed.nearly_all().1 > 2000.0);
        let (low, high) = tailed.most();
        assert!(
            (low - 87.0).abs() < 2.0 && (1000.0..1100.0).contains(&high),
            "{low} to {high}"
        );
        // The same mirrored.
        let (other, one) = spread(even().chain(tail()).map(|(value, weight)| (-value, weight)));
        assert!(
            (one + low).abs() < 2.0 && (other + high).abs() < 2.0,
            "{other} to {one}"
        );
    }

    #[test]
    fn what_is_heavy_at_one_place_does_not_hide_the_rest() {
        // Three quarters of the surface are a wall at 0; the rest is a floor of 100 m.
        let wall = [(0.0, 3000)];
        let (low, high) = spread(wall.into_iter().chain((1..=100).map(|i| (f64::from(i), 10))));
        assert_eq!((low, high), (0.0, 40.0));
    }
}
