//! Axis-aligned boxes.

use rayon::prelude::*;
use serde::Serialize;
use tsdfuse::glam::DVec3;

/// A box, given by opposite corners, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// The smallest coordinates.
    pub min: DVec3,
    /// The largest coordinates.
    pub max: DVec3,
}

impl Bounds {
    /// The box around points; `None` if there are no points.
    pub fn of(points: &[DVec3]) -> Option<Self> {
        let of_point = |&p: &DVec3| Self { min: p, max: p };
        let joined = |a: Self, b: Self| Self {
            min: a.min.min(b.min),
            max: a.max.max(b.max),
        };
        points.par_iter().map(of_point).reduce_with(joined)
    }

    /// Whether a point lies inside the box or on its sides.
    pub fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// The length of the diagonal, metres.
    pub fn diagonal_m(&self) -> f64 {
        self.min.distance(self.max)
    }

    /// The distance between two boxes, metres; 0 if they overlap.
    pub fn gap_m(&self, other: &Self) -> f64 {
        (other.min - self.max)
            .max(self.min - other.max)
            .max(DVec3::ZERO)
            .length()
    }
}
