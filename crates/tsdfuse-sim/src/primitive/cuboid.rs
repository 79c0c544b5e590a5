//! The box.

use glam::DVec3;

use super::facets::Facets;
use super::ray::{Aabb, Entry, Ray};
use super::solid::Solid;

/// |x| ≤ half.x, |y| ≤ half.y, |z| ≤ half.z.
#[derive(Clone, Debug)]
pub(super) struct Cuboid {
    pub(super) half: DVec3,
}

impl Solid for Cuboid {
    fn distance(&self, p: DVec3) -> f64 {
        self.bounds().distance(p)
    }

    fn enter(&self, ray: &Ray) -> Option<Entry> {
        // The three slabs: the last one entered is the face.
        let centre = -ray.origin * ray.inverse;
        let reach = self.half * ray.inverse.abs();
        let (near, far) = (centre - reach, (centre + reach).min_element());
        let t = near.max_element();
        if t > far || t <= ray.from {
            return None;
        }
        let axis = near.max_position();
        let mut normal = DVec3::ZERO;
        normal[axis] = -ray.direction[axis].signum();
        Some(Entry { t, normal })
    }

    fn bounds(&self) -> Aabb {
        Aabb {
            min: -self.half,
            max: self.half,
        }
    }

    fn tessellate(&self, _chord_m: f64, out: &mut Facets) {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let normal = DVec3::AXES[axis] * side;
                let u = DVec3::AXES[(axis + 1) % 3];
                let v = normal.cross(u);
                let corner = |a: f64, b: f64| (normal + u * a + v * b) * self.half;
                let corners = [
                    corner(-1.0, -1.0),
                    corner(1.0, -1.0),
                    corner(1.0, 1.0),
                    corner(-1.0, 1.0),
                ];
                out.polygon(&corners, normal);
            }
        }
    }
}
