//! The ellipsoid, and with it the sphere.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::facets::{Facets, chords};
use super::ray::{Aabb, Entry, Ray};
use super::solid::Solid;

/// Σ (p_i / axes_i)² ≤ 1.
#[derive(Clone, Debug)]
pub(super) struct Ellipsoid {
    pub(super) axes: DVec3,
}

impl Ellipsoid {
    /// The point of the surface that is nearest to `p`.
    ///
    /// Eberly, *Distance from a point to an ellipsoid* (2013): x_i = e_i² p_i / (s + e_i²), where s is the largest root of
    /// G(s) = Σ (e_i p_i / (s + e_i²))² − 1. Written in u = s + e_min², which keeps its digits where u is tiny (points near
    /// the centre). G falls and is convex for u > 0, so Newton's steps from the left never overshoot.
    fn nearest(&self, p: DVec3) -> DVec3 {
        let squared = self.axes * self.axes;
        let above_least = squared - squared.min_element();
        // By symmetry in the positive octant; never quite on a plane of symmetry, where the root may be a pole.
        let octant = p.abs().max(self.axes * 1e-14);
        let numerator = self.axes * octant;
        let mut u = (numerator - above_least).max_element();
        for _ in 0..100 {
            let ratio = numerator / (above_least + u);
            let g = ratio.length_squared() - 1.0;
            let slope = -2.0 * (ratio * ratio / (above_least + u)).element_sum();
            let next = u - g / slope;
            if next <= u * (1.0 + 1e-15) {
                break;
            }
            u = next;
        }
        let nearest = self.axes * (numerator / (above_least + u));
        DVec3::select(p.cmplt(DVec3::ZERO), -nearest, nearest)
    }

    fn normal(&self, p: DVec3) -> DVec3 {
        (p / (self.axes * self.axes)).normalize_or(DVec3::Z)
    }
}

impl Solid for Ellipsoid {
    fn distance(&self, p: DVec3) -> f64 {
        if self.axes.min_element() == self.axes.max_element() {
            return p.length() - self.axes.x;
        }
        let inside = (p / self.axes).length_squared() < 1.0;
        let distance = p.distance(self.nearest(p));
        if inside { -distance } else { distance }
    }

    fn enter(&self, ray: &Ray) -> Option<Entry> {
        // Against the unit sphere, in the frame where the ellipsoid is one.
        let (o, d) = (ray.origin / self.axes, ray.direction / self.axes);
        let a = d.length_squared();
        let b = o.dot(d);
        // The distance of the line from the centre, not b² − a c: nothing cancels.
        let off_centre = o - d * (b / a);
        let discriminant = 1.0 - off_centre.length_squared();
        if discriminant < 0.0 {
            return None;
        }
        let t = -b / a - (discriminant / a).sqrt();
        (t > ray.from).then(|| Entry {
            t,
            normal: self.normal(ray.at(t)),
        })
    }

    fn bounds(&self) -> Aabb {
        Aabb {
            min: -self.axes,
            max: self.axes,
        }
    }

    fn tessellate(&self, chord_m: f64, out: &mut Facets) {
        // Both chords of a quad add up, hence half the error for each; an ellipsoid is a sphere, stretched.
        let around = chords(self.axes.max_element(), chord_m / 2.0);
        let rows = around / 2;
        let vertex = |row: u32, column: u32, out: &mut Facets| {
            let polar = TAU * f64::from(row) / f64::from(around);
            let (z, ring) = if row == rows {
                (-1.0, 0.0)
            } else {
                (polar.cos(), polar.sin())
            };
            let azimuth = DVec2::from_angle(TAU * f64::from(column) / f64::from(around));
            let p = (azimuth * ring).extend(z) * self.axes;
            out.vertex(p, self.normal(p))
        };
        let north = vertex(0, 0, out);
        let south = vertex(rows, 0, out);
        let first = south + 1;
        for row in 1..rows {
            for column in 0..around {
                vertex(row, column, out);
            }
        }
        let number = |row: u32, column: u32| match row {
            0 => north,
            r if r == rows => south,
            r => first + (r - 1) * around + column % around,
        };
        for row in 0..rows {
            for column in 0..around {
                let [a, b] = [column, column + 1].map(|c| number(row, c));
                let [c, d] = [column, column + 1].map(|c| number(row + 1, c));
                if row > 0 {
                    out.triangles.push([a, d, b]);
                }
                if row + 1 < rows {
                    out.triangles.push([a, c, d]);
                }
            }
        }
    }
}
