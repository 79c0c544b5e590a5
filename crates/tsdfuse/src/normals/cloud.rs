//! The organized cloud that normals are estimated in, and what is found for each return.

use glam::Vec3;

use crate::sensor::ScanImage;

/// The surface at one return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Normal {
    /// Unit vector towards the side of the sensor, in the axes of the points; zero where there is none.
    pub normal: Vec3,
    /// w_θ (5.17): 1 where all faces used agree, falling to 0 with the sum of their angles to the normal.
    pub agreement: f32,
}

impl Normal {
    /// Whether there is a normal at all.
    pub fn is_some(&self) -> bool {
        self.normal != Vec3::ZERO
    }
}

/// An organized cloud.
pub(super) struct Cloud<'a> {
    pub(super) image: &'a ScanImage,
    pub(super) points: &'a [Vec3],
    pub(super) origins: &'a [Vec3],
}

impl Cloud<'_> {
    /// The return in a cell.
    #[inline(always)]
    pub(super) fn at(&self, ring: usize, column: usize) -> Option<Vec3> {
        self.points.get(self.image.get(ring, column)?).copied()
    }

    /// From the sensor to a return.
    #[inline(always)]
    pub(super) fn ray(&self, i: usize) -> Vec3 {
        self.points[i] - self.origins.get(i).copied().unwrap_or(Vec3::ZERO)
    }

    /// The columns on both sides of one.
    #[inline(always)]
    pub(super) fn beside(&self, column: usize) -> (usize, usize) {
        let last = self.image.columns() - 1;
        (
            if column == 0 { last } else { column - 1 },
            if column == last { 0 } else { column + 1 },
        )
    }
}

/// Unit vectors whose sum is shorter than this cancel each other: it points nowhere.
pub(super) const CANCELLED: f32 = 1e-3;
