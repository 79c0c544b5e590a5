//! Local maps seen from above: images of how much of each column is filled, and what is remarkable in them.
//!
//! (After Gupta et al., "Effectively Detecting Loop Closures using Point Cloud Density Maps", ICRA 2024; corners after Harris & Stephens, 1988,
//! with the direction of Rublee et al., "ORB", ICCV 2011. Binary descriptions tell little of images that are mostly empty, so what is around a corner is
//! kept in rings and sectors.)

use glam::{DVec2, IVec2, Vec2};
use rustc_hash::{FxHashMap, FxHashSet};

use crate::local_map::LocalMap;

/// Edge of a pixel, metres.
pub(crate) const PIXEL_M: f64 = 0.25;

/// Height of a layer, metres: a pixel counts in how many of them there is something.
const LAYER_M: f64 = 0.25;

/// Half the edge of an image at most, pixels.
const MOST_PIXELS: i32 = 300;

/// Features of an image at most.
const MOST_FEATURES: usize = 400;

/// Radius of the disc around a feature that tells its direction, pixels.
const DISC: i32 = 12;

/// Rings around a feature and sectors of each that describe it, and the outermost radius, pixels.
const RINGS: usize = 8;
const SECTORS: usize = 16;
const RADIUS: f32 = 16.0;

/// Correlation of two descriptions of one place at least.
const LEAST_ALIKE: f32 = 0.6;

/// Features of one image that are more alike than this tell nothing.
const SELF_SIMILAR: f32 = 0.97;

/// The most similar features that each one is matched with.
const MATCHES: usize = 2;

/// Matches that agree on a motion at least.
const LEAST_INLIERS: usize = 6;

/// How far matches that agree may be off, metres and radians.
const AGREE: (f64, f64) = (1.0, 0.35);

/// What is remarkable in a local map seen from above.
#[derive(Clone, Debug, Default)]
pub(crate) struct Features {
    /// In the levelled frame of the map, metres.
    at: Vec<DVec2>,
    /// Directions, radians.
    angle: Vec<f64>,
    descriptions: Vec<Description>,
}

/// What is around a feature, in rings and sectors; less the mean, of length 1.
type Description = [f32; RINGS * SECTORS];

/// A motion in the plane: first turned, then shifted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Planar {
    pub(crate) turn: f64,
    pub(crate) shift: DVec2,
    /// Matches that agree.
    pub(crate) inliers: usize,
}

impl Planar {
    fn apply(&self, p: DVec2) -> DVec2 {
        DVec2::from_angle(self.turn).rotate(p) + self.shift
    }
}

/// The image of a local map.
struct Image {
    width: i32,
    height: i32,
    /// Pixel of the lower left corner.
    corner: IVec2,
    values: Vec<f32>,
}

impl Image {
    fn of(map: &LocalMap) -> Self {
        let level = map.level();
        let voxels: FxHashSet<(i32, i32, i32)> = map
            .points()
            .iter()
            .map(|p| {
                let p = level * p.at.as_dvec3();
                (
                    (p.x / PIXEL_M).floor() as i32,
                    (p.y / PIXEL_M).floor() as i32,
                    (p.z / LAYER_M).floor() as i32,
                )
            })
            .filter(|(x, y, _)| x.abs() < MOST_PIXELS && y.abs() < MOST_PIXELS)
            .collect();
        let mut filled: FxHashMap<(i32, i32), f32> = FxHashMap::default();
        for (x, y, _) in voxels {
            *filled.entry((x, y)).or_default() += 1.0;
        }
        let (mut low, mut high) = (IVec2::MAX, IVec2::MIN);
        for &(x, y) in filled.keys() {
            (low, high) = (low.min(IVec2::new(x, y)), high.max(IVec2::new(x, y)));
        }
        if filled.is_empty() {
            (low, high) = (IVec2::ZERO, IVec2::ZERO);
        }
        let size = high - low + 1;
        let mut values = vec![0.0; (size.x * size.y) as usize];
        for ((x, y), value) in filled {
            // Floors are everywhere.
            values[((y - low.y) * size.x + x - low.x) as usize] = (value - 1.0_f32).clamp(0.0, 6.0);
        }
        Self {
            width: size.x,
            height: size.y,
            corner: low,
            values,
        }
        .blurred()
    }

    fn get(&self, x: i32, y: i32) -> f32 {
        if x < 0 || y < 0 || x >= self.width || y >= self.height {
            return 0.0;
        }
        self.values[(y * self.width + x) as usize]
    }

    /// By the binomial filter of 3×3.
    fn blurred(&self) -> Self {
        let pass = |image: &[f32], step: (i32, i32)| -> Vec<f32> {
            let at = |x: i32, y: i32| {
                if x < 0 || y < 0 || x >= self.width || y >= self.height {
                    0.0
                } else {
                    image[(y * self.width + x) as usize]
                }
            };
            (0..self.height)
                .flat_map(|y| (0..self.width).map(move |x| (x, y)))
                .map(|(x, y)| 0.25 * at(x - step.0, y - step.1) + 0.5 * at(x, y) + 0.25 * at(x + step.0, y + step.1))
                .collect()
        };
        Self {
            values: pass(&pass(&self.values, (1, 0)), (0, 1)),
            ..*self
        }
    }

    /// Corners, the strongest first.
    fn corners(&self) -> Vec<IVec2> {
        let (w, h) = (self.width, self.height);
        let mut products = vec![[0.0_f32; 3]; (w * h) as usize];
        for y in 0..h {
            for x in 0..w {
                let dx = self.get(x + 1, y) - self.get(x - 1, y);
                let dy = self.get(x, y + 1) - self.get(x, y - 1);
                products[(y * w + x) as usize] = [dx * dx, dx * dy, dy * dy];
            }
        }
        const REACH: i32 = 3;
        // Sums over squares, by rows and then by columns.
        let along = |from: &[[f32; 3]], step: (i32, i32)| -> Vec<[f32; 3]> {
            let sum = |x: i32, y: i32| {
                let mut sum = [0.0; 3];
                for k in -REACH..=REACH {
                    let (x, y) = (x + k * step.0, y + k * step.1);
                    if x >= 0 && y >= 0 && x < w && y < h {
                        let own = from[(y * w + x) as usize];
                        (0..3).for_each(|i| sum[i] += own[i]);
                    }
                }
                sum
            };
            (0..h)
                .flat_map(|y| (0..w).map(move |x| (x, y)))
                .map(|(x, y)| sum(x, y))
                .collect()
        };
        let sums = along(&along(&products, (1, 0)), (0, 1));
        let response: Vec<f32> = sums
            .iter()
            .map(|[xx, xy, yy]| xx * yy - xy * xy - 0.04 * (xx + yy) * (xx + yy))
            .collect();
        let at = |x: i32, y: i32| {
            if x < 0 || y < 0 || x >= w || y >= h {
                0.0
            } else {
                response[(y * w + x) as usize]
            }
        };
        let mut corners = Vec::new();
        for y in 0..h {
            for x in 0..w {
                let own = at(x, y);
                let around = || (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy)));
                if own > 0.1 && around().all(|(dx, dy)| (dx, dy) == (0, 0) || at(x + dx, y + dy) <= own) {
                    corners.push((own, IVec2::new(x, y)));
                }
            }
        }
        corners.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.to_array().cmp(&b.1.to_array())));
        corners.truncate(MOST_FEATURES);
        corners.into_iter().map(|(_, at)| at).collect()
    }

    /// The direction from a pixel to the centre of what is in the disc around it.
    fn direction(&self, at: IVec2) -> Option<f64> {
        let mut sum = Vec2::ZERO;
        for dy in -DISC..=DISC {
            for dx in -DISC..=DISC {
                if dx * dx + dy * dy <= DISC * DISC {
                    sum += IVec2::new(dx, dy).as_vec2() * self.get(at.x + dx, at.y + dy);
                }
            }
        }
        (sum.length() > 1.0).then(|| f64::from(sum.y).atan2(f64::from(sum.x)))
    }

    /// What is around a pixel, as seen in a direction.
    fn describe(&self, at: IVec2, angle: f64) -> Description {
        let mut around = [0.0; RINGS * SECTORS];
        for (i, value) in around.iter_mut().enumerate() {
            let radius = RADIUS * ((i / SECTORS) as f32 + 0.5) / RINGS as f32;
            let turn = angle as f32 + std::f32::consts::TAU * (i % SECTORS) as f32 / SECTORS as f32;
            let p = (Vec2::from_angle(turn) * radius).round().as_ivec2() + at;
            // Of 3×3 pixels: where one lies exactly is chance.
            for dy in -1..=1 {
                for dx in -1..=1 {
                    *value += self.get(p.x + dx, p.y + dy);
                }
            }
        }
        let mean = around.iter().sum::<f32>() / around.len() as f32;
        around.iter_mut().for_each(|value| *value -= mean);
        let length = alike(&around, &around).sqrt().max(1e-6);
        around.map(|value| value / length)
    }
}

fn alike(a: &Description, b: &Description) -> f32 {
    // Eight sums at once.
    let mut sums = [0.0_f32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum()
}

fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle + PI).rem_euclid(TAU) - PI
}

impl Features {
    /// Of a local map.
    pub(crate) fn of(map: &LocalMap) -> Self {
        let image = Image::of(map);
        let mut all = Self::default();
        for at in image.corners() {
            let Some(angle) = image.direction(at) else { continue };
            let centre = (at + image.corner).as_dvec2() + 0.5;
            all.at.push(centre * PIXEL_M);
            all.angle.push(angle);
            all.descriptions.push(image.describe(at, angle));
        }
        // What is there twice tells nothing.
        let is_own = |i: usize| {
            let mut others = (0..all.at.len()).filter(|&j| all.at[i].distance(all.at[j]) > 2.0);
            others.all(|j| alike(&all.descriptions[i], &all.descriptions[j]) < SELF_SIMILAR)
        };
        let own: Vec<usize> = (0..all.at.len()).filter(|&i| is_own(i)).collect();
        Self {
            at: own.iter().map(|&i| all.at[i]).collect(),
            angle: own.iter().map(|&i| all.angle[i]).collect(),
            descriptions: own.iter().map(|&i| all.descriptions[i]).collect(),
        }
    }

    /// How these lie in the frame of others, if enough of them agree: the motions `others_from_self` on which most matches agree, the best one first, at
    /// most `most`.
    pub(crate) fn place_in(&self, others: &Self, most: usize) -> Vec<Planar> {
        let mut matches = Vec::new();
        for (i, own) in self.descriptions.iter().enumerate() {
            let theirs = others.descriptions.iter().enumerate();
            let mut near: Vec<(f32, usize)> = theirs.map(|(j, other)| (alike(own, other), j)).collect();
            near.retain(|(alike, _)| *alike >= LEAST_ALIKE);
            near.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            matches.extend(near.into_iter().take(MATCHES).map(|(_, j)| (i, j)));
        }
        let agreeing = |motion: &Planar| -> Vec<(usize, usize)> {
            let turned = DVec2::from_angle(motion.turn);
            let agrees = |&&(i, j): &&(usize, usize)| {
                (turned.rotate(self.at[i]) + motion.shift).distance(others.at[j]) < AGREE.0
                    && wrapped(others.angle[j] - self.angle[i] - motion.turn).abs() < AGREE.1
            };
            matches.iter().filter(agrees).copied().collect()
        };
        // Each match alone says how all lies.
        let mut found: Vec<Planar> = Vec::new();
        for &(i, j) in &matches {
            let turn = wrapped(others.angle[j] - self.angle[i]);
            let mut motion = Planar {
                turn,
                shift: others.at[j] - DVec2::from_angle(turn).rotate(self.at[i]),
                inliers: 0,
            };
            let mut inliers = agreeing(&motion);
            for _ in 0..3 {
                if inliers.len() < LEAST_INLIERS.min(3) {
                    break;
                }
                motion = self.fitted(others, &inliers);
                inliers = agreeing(&motion);
            }
            motion.inliers = inliers.len();
            if motion.inliers >= LEAST_INLIERS {
                found.push(motion);
            }
        }
        found.sort_by(|a, b| b.inliers.cmp(&a.inliers).then(a.turn.total_cmp(&b.turn)));
        let mut different: Vec<Planar> = Vec::new();
        for motion in found {
            let is_same = |other: &Planar| {
                other.apply(DVec2::ZERO).distance(motion.apply(DVec2::ZERO)) < 2.0 * AGREE.0
                    && wrapped(other.turn - motion.turn).abs() < AGREE.1
            };
            if different.len() < most && !different.iter().any(is_same) {
                different.push(motion);
            }
        }
        different
    }

    /// The motion that brings matched features together best (least squares).
    fn fitted(&self, others: &Self, matches: &[(usize, usize)]) -> Planar {
        let n = matches.len().max(1) as f64;
        let (mut a, mut b) = (DVec2::ZERO, DVec2::ZERO);
        for &(i, j) in matches {
            (a, b) = (a + self.at[i] / n, b + others.at[j] / n);
        }
        let (mut dot, mut cross) = (0.0, 0.0);
        for &(i, j) in matches {
            let (p, q) = (self.at[i] - a, others.at[j] - b);
            dot += p.dot(q);
            cross += p.perp_dot(q);
        }
        let turn = cross.atan2(dot);
        Planar {
            turn,
            shift: b - DVec2::from_angle(turn).rotate(a),
            inliers: matches.len(),
        }
    }
}
