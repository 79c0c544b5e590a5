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
    pub(crate) turn: Turn,
}

/// Whether a patch takes part in a scan, and for how many scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Turn {
    pub(crate) times: u8,
    pub(crate) is_due: bool,
}

impl Default for Turn {
    fn default() -> Self {
        Self { times: 1, is_due: true }
    }
}

/// Weight where there is no plane.
pub const RAY_WEIGHT: f32 = 0.1;

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

    /// The cosine of the angle at which the sensor sees it, as from its place at the scan's pose; where there is no plane, it faces the sensor.
    #[inline(always)]
    pub(crate) fn cosine(&self) -> f32 {
        match self.kind {
            Kind::Ray => 1.0,
            _ => (-self.center.dot(self.normal) / self.center.length()).max(0.0),
        }
    }

    /// What it weighs where scans agree.
    #[inline(always)]
    pub(crate) fn weight(&self) -> f32 {
        let known = if self.is_plane() { 1.0 } else { RAY_WEIGHT };
        known * self.cosine() * (1.0 / self.center.length()).min(1.0)
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
