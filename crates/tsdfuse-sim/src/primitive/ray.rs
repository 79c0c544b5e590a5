//! Rays and axis-aligned boxes.

use glam::DVec3;

/// A ray of unit direction.
pub(crate) struct Ray {
    pub(crate) origin: DVec3,
    pub(crate) direction: DVec3,
    /// 1 / direction, never infinite.
    pub(crate) inverse: DVec3,
    /// Crossings count beyond this, metres from the origin.
    pub(crate) from: f64,
}

impl Ray {
    pub(crate) fn new(origin: DVec3, direction: DVec3, from: f64) -> Self {
        // Finite inverses: 0 · ∞ would be NaN for a ray within a face.
        let safe = |d: f64| if d.abs() < 1e-200 { 1e-200_f64.copysign(d) } else { d };
        let inverse = DVec3::new(safe(direction.x), safe(direction.y), safe(direction.z)).recip();
        Self {
            origin,
            direction,
            inverse,
            from,
        }
    }

    pub(crate) fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}

/// Where a ray enters a solid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    /// Metres along the ray.
    pub(crate) t: f64,
    /// Unit normal, out of the solid.
    pub(crate) normal: DVec3,
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aabb {
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
}

impl Aabb {
    pub(crate) const EMPTY: Self = Self {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };

    pub(crate) fn union(&self, other: &Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    pub(crate) fn centre(&self) -> DVec3 {
        (self.min + self.max) * 0.5
    }

    /// Half the surface area, the measure of a bounding volume's cost.
    pub(crate) fn half_area(&self) -> f64 {
        let s = self.max - self.min;
        s.x * s.y + s.y * s.z + s.z * s.x
    }

    /// The stretch of the ray within the box; empty if the first number is larger.
    pub(crate) fn span(&self, ray: &Ray) -> (f64, f64) {
        let a = (self.min - ray.origin) * ray.inverse;
        let b = (self.max - ray.origin) * ray.inverse;
        let (near, far) = (a.min(b), a.max(b));
        (near.max_element().max(ray.from), far.min_element())
    }

    /// Signed distance to the box's surface: no solid within the box is nearer.
    pub(crate) fn distance(&self, p: DVec3) -> f64 {
        let outside = (self.min - p).max(p - self.max);
        outside.max(DVec3::ZERO).length() + outside.max_element().min(0.0)
    }
}
