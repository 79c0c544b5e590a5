//! Ground: z = along(x) + across(y), both polylines, the second with vertical steps.

use glam::{DVec2, DVec3, dvec3};

use super::facets::Facets;
use super::ray::{Aabb, Entry, Ray};
use super::solid::Solid;

/// How far the solid reaches below the lowest point of its surface, metres.
const DEPTH_M: f64 = 5.0;

/// Sloping, undulating ground with kerbs.
///
/// The surface is the sum of a height along x (slope, undulation) and a cross-section over y, in which two points with one y
/// make a vertical step. Both are polylines, so the surface consists of plane parallelograms and everything about it is
/// exact. Below it the solid is 5 m deep; its sides and underside are part of the signed distance, but not of the mesh,
/// and rays do not hit them.
///
/// ```
/// use tsdfuse_sim::Terrain;
///
/// // 1 % uphill, with a kerb of 12 cm at y = 3 m.
/// let road = Terrain::new(-50.0, 1.0, (0..=100).map(|i| 0.01 * f64::from(i)).collect(), vec![
///     (-3.0, 0.0), (3.0, 0.0), (3.0, 0.12), (5.0, 0.12),
/// ]).unwrap();
/// assert!((road.height_m(0.0, 4.0) - 0.62).abs() < 1e-12);
/// ```
#[derive(Clone, Debug)]
pub struct Terrain {
    start: f64,
    step: f64,
    along: Vec<f64>,
    across: Vec<(f64, f64)>,
    /// The box around the upper surface.
    surface: Aabb,
}

/// A plane parallelogram: corner + s·u + t·v with s, t in 0..1; u × v points up or out of a step.
struct Patch {
    corner: DVec3,
    u: DVec3,
    v: DVec3,
}

impl Patch {
    /// (s, t) of the point's foot on the plane.
    fn foot(&self, p: DVec3) -> DVec2 {
        let w = p - self.corner;
        let (uu, uv, vv) = (self.u.dot(self.u), self.u.dot(self.v), self.v.dot(self.v));
        let (wu, wv) = (w.dot(self.u), w.dot(self.v));
        DVec2::new(wu * vv - wv * uv, wv * uu - wu * uv) / (uu * vv - uv * uv)
    }

    fn contains(foot: DVec2) -> bool {
        const SEAM: f64 = 1e-12; // rays must not slip between two patches
        foot.min_element() >= -SEAM && foot.max_element() <= 1.0 + SEAM
    }

    fn at(&self, s: f64, t: f64) -> DVec3 {
        self.corner + self.u * s + self.v * t
    }

    fn distance(&self, p: DVec3) -> f64 {
        let foot = self.foot(p);
        if Self::contains(foot) {
            return p.distance(self.at(foot.x, foot.y));
        }
        let edge = |from: DVec3, along: DVec3| {
            let s = ((p - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
            p.distance(from + along * s)
        };
        let near_sides = edge(self.corner, self.u).min(edge(self.corner, self.v));
        let far_sides = edge(self.at(0.0, 1.0), self.u).min(edge(self.at(1.0, 0.0), self.v));
        near_sides.min(far_sides)
    }

    fn bounds(&self) -> Aabb {
        let opposite = self.at(1.0, 1.0);
        let (a, b) = (self.corner + self.u, self.corner + self.v);
        Aabb {
            min: self.corner.min(a).min(b).min(opposite),
            max: self.corner.max(a).max(b).max(opposite),
        }
    }
}

impl Terrain {
    /// Heights every `step_m` of x from `start_m` on, and the cross-section as (y, height).
    ///
    /// `None` unless both have two points or more, the step is positive, y never falls and all numbers are finite.
    pub fn new(start_m: f64, step_m: f64, along_m: Vec<f64>, across_m: Vec<(f64, f64)>) -> Option<Self> {
        let finite = [start_m, step_m].iter().chain(&along_m).all(|v| v.is_finite())
            && across_m.iter().all(|(y, z)| y.is_finite() && z.is_finite());
        let enough = along_m.len() >= 2 && across_m.len() >= 2;
        if !(finite && enough && step_m > 0.0 && across_m.is_sorted_by(|a, b| a.0 <= b.0)) {
            return None;
        }
        let (low_along, high_along) = range(along_m.iter().copied());
        let (low_across, high_across) = range(across_m.iter().map(|a| a.1));
        let (y0, y1) = range(across_m.iter().map(|a| a.0));
        let end = start_m + step_m * (along_m.len() - 1) as f64;
        let surface = Aabb {
            min: dvec3(start_m, y0, low_along + low_across),
            max: dvec3(end, y1, high_along + high_across),
        };
        Some(Self {
            start: start_m,
            step: step_m,
            along: along_m,
            across: across_m,
            surface,
        })
    }

    /// Height of the surface, metres: the upper edge of a step; beyond the borders that of the nearest border.
    pub fn height_m(&self, x_m: f64, y_m: f64) -> f64 {
        let i = self.station(x_m);
        let s = ((x_m - self.x(i)) / self.step).clamp(0.0, 1.0);
        let along = self.along[i] + (self.along[i + 1] - self.along[i]) * s;
        let y = y_m.clamp(self.surface.min.y, self.surface.max.y);
        let across = self.across.windows(2).filter(|w| w[0].0 <= y && y <= w[1].0).map(|w| {
            let [(y0, z0), (y1, z1)] = [w[0], w[1]];
            if y0 == y1 {
                z0.max(z1)
            } else {
                z0 + (z1 - z0) * (y - y0) / (y1 - y0)
            }
        });
        along + across.fold(f64::NEG_INFINITY, f64::max)
    }

    fn x(&self, station: usize) -> f64 {
        self.start + self.step * station as f64
    }

    /// The stretch of x that holds `x`, or the one nearest to it.
    fn station(&self, x: f64) -> usize {
        // The cast takes what is negative to 0.
        (((x - self.start) / self.step) as usize).min(self.along.len() - 2)
    }

    fn patch(&self, i: usize, k: usize) -> Patch {
        let [(y0, z0), (y1, z1)] = [self.across[k], self.across[k + 1]];
        Patch {
            corner: dvec3(self.x(i), y0, self.along[i] + z0),
            u: dvec3(self.x(i + 1) - self.x(i), 0.0, self.along[i + 1] - self.along[i]),
            v: dvec3(0.0, y1 - y0, z1 - z0),
        }
    }

    fn to_surface(&self, p: DVec3, start: f64) -> f64 {
        let mut best = start;
        for i in self.station(p.x - best)..=self.station(p.x + best) {
            for k in 0..self.across.len() - 1 {
                let patch = self.patch(i, k);
                if patch.bounds().distance(p) < best {
                    best = best.min(patch.distance(p));
                }
            }
        }
        best
    }
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
}

impl Solid for Terrain {
    fn distance(&self, p: DVec3) -> f64 {
        let Aabb { min, max } = self.bounds();
        // The nearest point of the box under the surface's border, and the surface straight above or below it.
        let within = p.clamp(min, dvec3(max.x, max.y, f64::INFINITY));
        let surface = self.height_m(within.x, within.y);
        let surface_above = within.with_z(surface);
        let to_surface = self.to_surface(p, p.distance(surface_above));
        if within.z > surface {
            to_surface
        } else if within != p {
            p.distance(within)
        } else {
            let to_sides = (p - min).min_element().min(max.x - p.x).min(max.y - p.y);
            -to_surface.min(to_sides)
        }
    }

    fn enter(&self, ray: &Ray) -> Option<Entry> {
        let (t0, t1) = self.surface.span(ray);
        // Up to rounding: the border of the surface belongs to it.
        if t0 > t1 + 1e-9 {
            return None;
        }
        let (first, last) = (self.station(ray.at(t0).x), self.station(ray.at(t1).x));
        let steps = first.abs_diff(last);
        let mut best: Option<Entry> = None;
        for n in 0..=steps {
            let i = if first < last { first + n } else { first - n };
            let [a, b] = [self.x(i), self.x(i + 1)].map(|x| ((x - ray.origin.x) * ray.inverse.x).clamp(t0, t1.max(t0)));
            let (from, to) = (ray.at(a), ray.at(b));
            let (low, high) = (from.min(to) - 1e-9, from.max(to) + 1e-9);
            for k in 0..self.across.len() - 1 {
                let patch = self.patch(i, k);
                let extent = patch.bounds();
                if low.cmpgt(extent.max).any() || high.cmplt(extent.min).any() {
                    continue;
                }
                let normal = patch.u.cross(patch.v);
                let approach = normal.dot(ray.direction);
                let t = normal.dot(patch.corner - ray.origin) / approach;
                if approach < 0.0
                    && t > ray.from
                    && best.is_none_or(|e| t < e.t)
                    && Patch::contains(patch.foot(ray.at(t)))
                {
                    let normal = normal.normalize();
                    best = Some(Entry { t, normal });
                }
            }
            if best.is_some() {
                break;
            }
        }
        best
    }

    fn bounds(&self) -> Aabb {
        Aabb {
            min: self.surface.min - DVec3::Z * DEPTH_M,
            ..self.surface
        }
    }

    fn tessellate(&self, _chord_m: f64, out: &mut Facets) {
        for i in 0..self.along.len() - 1 {
            for k in 0..self.across.len() - 1 {
                let patch = self.patch(i, k);
                let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(s, t)| patch.at(s, t));
                out.polygon(&corners, patch.u.cross(patch.v).normalize());
            }
        }
    }
}
