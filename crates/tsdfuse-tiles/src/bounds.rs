//! Axis-aligned boxes.

use tsdfuse::glam::DVec3;

/// Opposite corners, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
}

impl Bounds {
    /// Contains nothing.
    pub(crate) const NONE: Self = Self {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };

    pub(crate) fn of(points: &[DVec3]) -> Self {
        let mut bounds = Self::NONE;
        points.iter().for_each(|p| bounds.add(*p));
        bounds
    }

    pub(crate) fn add(&mut self, point: DVec3) {
        *self = self.with(&Self { min: point, max: point });
    }

    pub(crate) fn with(&self, other: &Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    pub(crate) fn middle(&self) -> DVec3 {
        (self.min + self.max) / 2.0
    }

    pub(crate) fn diagonal_m(&self) -> f64 {
        self.min.distance(self.max)
    }

    /// Relative to an origin, and rounded outwards to whole millimetres, which covers the rounding of positions to f32.
    pub(crate) fn seen_from(&self, origin: DVec3) -> Self {
        let per_m = 1000.0;
        Self {
            min: ((self.min - origin) * per_m - 0.5).floor() / per_m,
            max: ((self.max - origin) * per_m + 0.5).ceil() / per_m,
        }
    }
}
