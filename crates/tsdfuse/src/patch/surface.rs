//! The surface at a return, and what it must be like.

use glam::Vec3;

/// The surface at a return, or between two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Patch {
    /// Where the surface is, in the axes of the points.
    pub(crate) center: Vec3,
    /// Unit vector towards the side of the sensor; zero at a return without a plane.
    pub(crate) normal: Vec3,
    pub(crate) kind: Kind,
}

/// What is known about the surface at a patch, the least first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    /// Where a ray ends.
    #[default]
    Ray,
    /// A plane through half of the returns around.
    Half,
    /// A plane through all of them.
    Whole,
}

impl Patch {
    /// Whether there is a plane.
    pub(crate) fn is_plane(&self) -> bool {
        self.kind != Kind::Ray
    }

    /// The arm of a turn of the sensor: how far the patch moves along its normal, at most, for each radian.
    #[inline(always)]
    pub(crate) fn arm_m(&self) -> f32 {
        self.center.cross(self.normal).length()
    }
}

/// What a plane must be like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Half the edge of the windows, metres.
    pub(crate) window_m: f32,
    /// The standard deviation of ranges, metres; 0: it is estimated.
    pub(crate) noise_m: f32,
    /// Neighbours farther apart than this get patches between them, at such distances, …
    pub(crate) step_m: f32,
    /// … if they are no farther apart than this (of planes: as seen by the sensor); more, far away: [`super::widest_gap_m`].
    pub(crate) max_gap_m: f32,
    /// Neighbours in the image are at most this many cells apart, with nothing between.
    pub(crate) neighbour_cells: usize,
    /// There may be about as many patches between neighbours.
    pub(crate) most: usize,
}
