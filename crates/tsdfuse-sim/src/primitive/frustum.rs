//! The cone frustum, and with it the cylinder and the cone.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::facets::{Facets, chords};
use super::ray::{Aabb, Entry, Ray};
use super::solid::Solid;

/// |z| ≤ half, √(x² + y²) ≤ radius(z), the radius running linearly from `bottom` to `top`.
#[derive(Clone, Debug)]
pub(super) struct Frustum {
    pub(super) bottom: f64,
    pub(super) top: f64,
    pub(super) half: f64,
}

impl Frustum {
    /// Radius at z = 0, and how it grows with z.
    fn cone(&self) -> (f64, f64) {
        (
            (self.bottom + self.top) / 2.0,
            (self.top - self.bottom) / (2.0 * self.half),
        )
    }

    fn normal(&self, p: DVec3) -> DVec3 {
        let radial = p.truncate().normalize_or(DVec2::X);
        radial.extend(-self.cone().1).normalize()
    }
}

impl Solid for Frustum {
    fn distance(&self, p: DVec3) -> f64 {
        // In the half plane (ρ, z): the nearest point of the end discs and that of the slanted edge.
        let q = dvec2(p.truncate().length(), p.z);
        let end_radius = if q.y < 0.0 { self.bottom } else { self.top };
        let to_end = dvec2((q.x - end_radius).max(0.0), q.y.abs() - self.half);
        let (low, high) = (dvec2(self.bottom, -self.half), dvec2(self.top, self.half));
        let edge = high - low;
        let s = ((q - low).dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        let to_edge = q - (low + edge * s);
        let (radius, slope) = self.cone();
        let inside = q.y.abs() < self.half && q.x < radius + slope * q.y;
        let distance = to_end.length().min(to_edge.length());
        if inside { -distance } else { distance }
    }

    fn enter(&self, ray: &Ray) -> Option<Entry> {
        let (o, d) = (ray.origin, ray.direction);
        let mut best: Option<Entry> = None;
        let mut offer = |t: f64, normal: DVec3| {
            if t > ray.from && normal.dot(d) < 0.0 && best.is_none_or(|b| t < b.t) {
                best = Some(Entry { t, normal });
            }
        };
        // The end disc that faces the ray.
        let (z, end_radius) = if d.z < 0.0 {
            (self.half, self.top)
        } else {
            (-self.half, self.bottom)
        };
        let t = (z - o.z) * ray.inverse.z;
        if ray.at(t).truncate().length_squared() <= end_radius * end_radius {
            offer(t, DVec3::Z * z.signum());
        }
        // The slanted side: x² + y² = (r + m z)², a t² + 2 b t + c = 0.
        let (radius, slope) = self.cone();
        let (r, dr) = (radius + slope * o.z, slope * d.z);
        let a = d.x * d.x + d.y * d.y - dr * dr;
        let b = o.x * d.x + o.y * d.y - r * dr;
        let c = o.x * o.x + o.y * o.y - r * r;
        let discriminant = b * b - a * c;
        if discriminant >= 0.0 {
            let q = -(b + discriminant.sqrt().copysign(b));
            for t in [q / a, c / q] {
                let p = ray.at(t);
                if p.z.abs() <= self.half && radius + slope * p.z >= 0.0 {
                    offer(t, self.normal(p));
                }
            }
        }
        best
    }

    fn bounds(&self) -> Aabb {
        let r = self.bottom.max(self.top);
        let max = dvec3(r, r, self.half);
        Aabb { min: -max, max }
    }

    fn tessellate(&self, chord_m: f64, out: &mut Facets) {
        let n = chords(self.bottom.max(self.top), chord_m);
        let around = |i: u32| DVec2::from_angle(TAU * f64::from(i % n) / f64::from(n));
        for (z, radius) in [(-self.half, self.bottom), (self.half, self.top)] {
            if radius > 0.0 {
                let corner = |i: u32| (around(i) * radius).extend(z);
                let turn = |i: u32| if z < 0.0 { n - i } else { i };
                let corners: Vec<_> = (0..n).map(|i| corner(turn(i))).collect();
                out.polygon(&corners, DVec3::Z * z.signum());
            }
        }
        let [low, high] = [(-self.half, self.bottom), (self.half, self.top)].map(|(z, radius)| {
            let first = out.vertices.len() as u32;
            for i in 0..n {
                let direction = around(i).extend(0.0);
                out.vertex(direction * radius + DVec3::Z * z, self.normal(direction));
            }
            first
        });
        for i in 0..n {
            let j = (i + 1) % n;
            // At an apex one half of each quad vanishes.
            if self.bottom > 0.0 {
                out.triangles.push([low + i, low + j, high + j]);
            }
            if self.top > 0.0 {
                out.triangles.push([low + i, high + j, high + i]);
            }
        }
    }
}
