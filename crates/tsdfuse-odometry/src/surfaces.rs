//! Surfaces of a place, to which points of another view of it are registered as one rigid body.

use glam::{DVec3, Vec3};
use nalgebra::Matrix6;
use tsdfuse::Pose;

use crate::cells::{Cells, Seen, elevation_bit};
use crate::motion::Motion;
use crate::register::{COARSE, Prior, recentred, register};
use crate::returns::Return;
use crate::tracker::{OdometryConfig, Quality};

/// What the rough pose of a registration may be off, metres and radians.
const LOOSE: (f64, f64) = (2.0, 0.3);

/// The beam of a point of which no beam is known.
const ANY_BEAM: u8 = u8::MAX;

/// A point of a place, in its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Metres.
    pub at: Vec3,
    /// Which of 64 bits tells its beam apart from others.
    beam: u8,
}

impl SurfacePoint {
    /// A point that a beam saw, in the frame of the place and in that of the sensor: the points of one beam alone make no plane, since they lie in
    /// its cone.
    pub fn seen(at: Vec3, in_sensor: Vec3) -> Self {
        Self {
            at,
            beam: elevation_bit(in_sensor).trailing_zeros() as u8,
        }
    }

    /// A point of a surface that is known.
    pub fn known(at: Vec3) -> Self {
        Self { at, beam: ANY_BEAM }
    }

    /// The same point elsewhere.
    pub fn moved(self, at: Vec3) -> Self {
        Self { at, ..self }
    }

    fn elevation(self) -> u64 {
        match self.beam {
            ANY_BEAM => u64::MAX,
            beam => 1 << beam,
        }
    }
}

/// The planes of a place, fitted to points that were seen there.
pub struct Surfaces(Cells);

/// A view that was registered.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// `place_from_view`.
    pub pose: Pose,
    /// Information of the points about the pose: shift (metres) and turn (radians) along the axes of the place, about the view's origin.
    pub information: Matrix6<f64>,
    /// How well the points lie on the surfaces.
    pub quality: Quality,
    /// Whether the points told nothing of their own accord about some direction.
    pub is_weak: bool,
}

impl Surfaces {
    /// Fits planes to the points of a place.
    pub fn new(points: &[SurfacePoint], config: &OdometryConfig) -> Self {
        let mut cells = Cells::upright(config.cell_m, config.noise_m);
        let seen = |p: &SurfacePoint| Seen {
            at: p.at.as_dvec3(),
            elevation: p.elevation(),
        };
        cells.add(&points.iter().map(seen).collect::<Vec<_>>(), 0.0);
        Self(cells)
    }

    /// Moves a view's points onto the surfaces, beginning at a rough pose: surfaces are looked for as far as `reach_m` away at first.
    pub fn register(&self, view: &[SurfacePoint], rough: &Pose, reach_m: f64) -> Fit {
        let returns: Vec<Return> = (0..COARSE)
            .flat_map(|first| view.iter().skip(first).step_by(COARSE))
            .map(|point| Return {
                point: point.at,
                share: 0.0,
                ring: None,
            })
            .collect();
        let (shift, turn) = LOOSE;
        let sigmas = [shift, shift, shift, turn, turn, turn];
        let prior = Prior {
            motion: Motion::still(*rough),
            begin: Matrix6::from_diagonal(&sigmas.map(|sigma: f64| sigma.powi(-2)).into()),
            step_sigma: LOOSE,
            most: LOOSE,
            remembered: None,
            along: None,
            reach: reach_m,
        };
        let registered = register(&self.0, &returns, &returns, &prior);
        let pose = registered.motion.last();
        let to_pose = recentred(rough.translation, pose.translation);
        Fit {
            pose,
            information: to_pose.transpose() * registered.rigid * to_pose,
            quality: Quality::of(&registered),
            is_weak: registered.along.is_some(),
        }
    }

    /// The share of a view's points that lie on the surfaces at a pose, within three standard deviations, and the share that lies where there are
    /// any.
    pub fn overlap(&self, view: &[SurfacePoint], pose: &Pose) -> (f64, f64) {
        let (mut near, mut on) = (0_usize, 0_usize);
        for point in view {
            let x: DVec3 = pose.transform_point(point.at.as_dvec3());
            if let Some((_, r, variance)) = self.0.plane_at(x) {
                near += 1;
                on += usize::from(r * r < 9.0 * variance);
            }
        }
        let share = |n: usize| n as f64 / view.len().max(1) as f64;
        (share(on), share(near))
    }

    /// How far a point lies off the plane around it, metres.
    pub fn distance(&self, point: DVec3) -> Option<f64> {
        self.0.plane_at(point).map(|(_, r, _)| r)
    }

    /// The unit normal of the plane around a point; which of the two sides it points to means nothing.
    pub fn normal_at(&self, point: Vec3) -> Option<DVec3> {
        self.0.plane_at(point.as_dvec3()).map(|(plane, ..)| plane.normal)
    }
}
