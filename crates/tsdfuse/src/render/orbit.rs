//! Poses from which a whole map is seen: from above, at an angle.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec3};

use super::Renderer;
use crate::Pose;
use crate::index::{BlockIndex, RegionIndex, voxel_at};
use crate::sensor::Pinhole;

/// How far down the camera looks.
const PITCH_RAD: f64 = 0.65;

/// How far the view turns away from looking straight across the map's long side.
const OBLIQUE_RAD: f64 = 0.45;

/// The share of the surface's blocks beyond each side of the box that is shown: what lies far out is sparse.
const BEYOND: f64 = 0.08;

/// Regions that hold this many times fewer blocks of surface than most blocks' regions do are not dense.
const DENSE: usize = 3;

/// The share of the image that stays free at its borders.
const MARGIN: f64 = 0.04;

/// The pose from which a camera sees the whole map across its long side; `None` for a map without surface.
pub fn overview(renderer: &Renderer, camera: &Pinhole) -> Option<Pose> {
    turntable(renderer, camera, 1).pop()
}

/// `count` poses around the map, all as far from it; the first looks as [`overview`] does, the others follow
/// counter-clockwise. None for a map without surface.
pub fn turntable(renderer: &Renderer, camera: &Pinhole, count: usize) -> Vec<Pose> {
    let Some(hull) = Hull::of(renderer) else {
        return Vec::new();
    };
    let turns = (0..count).map(|i| OBLIQUE_RAD + TAU * i as f64 / count as f64);
    let places: Vec<_> = turns.map(|turn| (hull.axes(turn), hull.place(camera, turn))).collect();
    let back = places.iter().map(|(_, place)| place.x).fold(0.0, f64::min);
    let pose = |(axes, place): (DQuat, DVec3)| Pose {
        rotation: axes,
        translation: hull.center + axes * DVec3::new(back, place.y, place.z),
    };
    places.into_iter().map(pose).collect()
}

/// The blocks of the surface where it is dense: far from the sensor, single specks lie about.
fn dense(renderer: &Renderer) -> Vec<BlockIndex> {
    let mut blocks: Vec<BlockIndex> = renderer.surface_blocks().collect();
    blocks.sort_unstable_by_key(|block| RegionIndex::of(*block));
    let regions = || blocks.chunk_by(|a, b| RegionIndex::of(*a) == RegionIndex::of(*b));
    // Half of all blocks lie in regions that hold as many blocks, or more.
    let mut counts: Vec<usize> = regions()
        .flat_map(|region| std::iter::repeat_n(region.len(), region.len()))
        .collect();
    counts.sort_unstable();
    let median = counts.get(counts.len() / 2).copied().unwrap_or_default();
    let kept = regions().filter(|region| DENSE * region.len() >= median);
    kept.flatten().copied().collect()
}

/// A box around nearly all of the surface, upright and turned along its longest extent.
struct Hull {
    center: DVec3,
    /// Half of its edges, along its own axes, metres.
    half: DVec3,
    /// From the world's x axis to its own, about z.
    heading_rad: f64,
}

impl Hull {
    fn of(renderer: &Renderer) -> Option<Self> {
        let grid = renderer.map().grid();
        let center = |block| grid.center(voxel_at(block, 0)) + 3.5 * grid.voxel_size_m();
        let mut points: Vec<DVec3> = dense(renderer).into_iter().map(center).collect();
        let first = *points.first()?;
        // Relative to the first: covariances do not suffer from large coordinates.
        points.iter_mut().for_each(|p| *p -= first);
        let middle = points.iter().sum::<DVec3>() / points.len() as f64;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for d in points.iter().map(|p| *p - middle) {
            (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
        }
        let heading_rad = 0.5 * (2.0 * xy).atan2(xx - yy);
        let own_from_world = DQuat::from_rotation_z(-heading_rad);
        let block_m = 8.0 * grid.voxel_size_m();
        let mut along = [0, 1, 2].map(|axis| {
            let mut values: Vec<f64> = points.iter().map(|p| (own_from_world * *p)[axis]).collect();
            values.sort_unstable_by(f64::total_cmp);
            let beyond = (BEYOND * (values.len() - 1) as f64) as usize;
            (values[beyond], values[values.len() - 1 - beyond])
        });
        along
            .iter_mut()
            .for_each(|(low, high)| (*low, *high) = (*low - 0.5 * block_m, *high + 0.5 * block_m));
        let low = DVec3::from(along.map(|(low, _)| low));
        let high = DVec3::from(along.map(|(_, high)| high));
        Some(Self {
            center: first + own_from_world.conjugate() * (0.5 * (low + high)),
            half: 0.5 * (high - low),
            heading_rad,
        })
    }

    /// The camera's axes in the world where it looks across the box, turned counter-clockwise about it.
    fn axes(&self, turn_rad: f64) -> DQuat {
        DQuat::from_rotation_z(self.heading_rad + FRAC_PI_2 + turn_rad) * DQuat::from_rotation_y(PITCH_RAD)
    }

    /// The nearest place from which the whole box is in the image, from the box's centre in the camera's axes, metres.
    fn place(&self, camera: &Pinhole, turn_rad: f64) -> DVec3 {
        let camera_from_own = self.axes(turn_rad).conjugate() * DQuat::from_rotation_z(self.heading_rad);
        let corners = [0, 1, 2, 3, 4, 5, 6, 7].map(|c| {
            let side = |bit: i32| if c & bit == 0 { -1.0 } else { 1.0 };
            camera_from_own * (self.half * DVec3::new(side(1), side(2), side(4)))
        });
        // From (−d, s) a corner (x, y) is in the image if |y − s| ≤ t·(x + d), t being the tangent of half the field of view:
        // d ≥ (a − s)/t and d ≥ (b + s)/t with a = max(y − t x), b = max(−y − t x). Best is s = (a − b)/2, d = (a + b)/2t.
        let fit = |axis: usize, pixels: u32, focal: f32| {
            let t = (0.5 - MARGIN) * f64::from(pixels) / f64::from(focal);
            let most = |sign: f64| {
                corners
                    .iter()
                    .map(|p| sign * p[axis] - t * p.x)
                    .fold(f64::MIN, f64::max)
            };
            let (a, b) = (most(1.0), most(-1.0));
            (0.5 * (a - b), 0.5 * (a + b) / t)
        };
        let (left, by_width) = fit(1, camera.width, camera.fx);
        let (up, by_height) = fit(2, camera.height, camera.fy);
        DVec3::new(-by_width.max(by_height), left, up)
    }
}
