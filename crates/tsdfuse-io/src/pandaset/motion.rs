//! How the vehicle moved during one sweep, refined by the beams of its Pandar64.
//!
//! Poses come ten times a second. Pitch and roll change faster than that: with the mean motion between two poses, a third
//! of the returns of some sweeps lie up to 0.1° off their beams, which are 0.17° apart. But that all returns do lie on
//! beams is known, and it determines the motion: with p the return in the sensor's frame at the frame's time, t its own
//! time, ω and v the sensor's rates, it was measured at
//!
//! ```text
//! q = exp(−ω t) (p − v t),     elevation(q) = that of a beam.
//! ```
//!
//! Pitch, roll, forward and vertical rates are found from that by Gauss-Newton (returns on the outer beams first, which are
//! a degree and more apart, so that none is taken for its neighbour). Yaw and sideways rates hardly change elevations and
//! stay those of the poses. The points themselves are not moved: they keep their place in the world.

use tsdfuse::glam::{DMat4, DQuat, DVec3, DVec4};
use tsdfuse::scan::PoseAt;
use tsdfuse::{Pose, SensorModel};

/// Where the sensor was during a sweep, by the poses of the data set, in whose world its points are stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    /// `world_from_sensor` at the frame's time.
    pub(super) pose: Pose,
    /// Seconds of the frame.
    pub(super) secs: Option<f64>,
    pub(super) motion: Option<PoseAt>,
}

/// A return: its place in the sensor's frame at the frame's time, metres, and its own time after that, seconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Return {
    pub(super) point: DVec3,
    pub(super) secs: f64,
}

/// More returns do not tell more.
const RETURNS: usize = 6000;
/// With fewer the motion is left as it is.
const FEWEST_RETURNS: usize = 1000;
/// Nearer ones are on the vehicle, and off their beams by the size of the lens.
const MIN_RANGE_M: f64 = 3.0;
/// A beam this far from both of its neighbours cannot be mistaken for one of them.
const OUTER_GAP_DEG: f64 = 0.9;
/// What counts as on a beam.
const ON_BEAM_DEG: f64 = 0.04;
/// How much the beams scatter about their nominal elevations.
const SCATTER_RAD: f64 = 3e-4;
/// How far rates may be from those of the poses: pitch and roll in rad/s, forward and vertical in m/s.
const PRIOR: DVec4 = DVec4::new(0.2, 0.2, 0.5, 0.5);

/// The motion of the Pandar64 under which its returns lie best on its beams; `motion` itself if that is as good.
pub(super) fn refine(motion: PoseAt, pose: Pose, sensor: &SensorModel, returns: &[Return]) -> PoseAt {
    let far = returns
        .iter()
        .filter(|r| r.point.length_squared() > MIN_RANGE_M.powi(2));
    let far: Vec<Return> = far.copied().collect();
    let sample: Vec<Return> = far.iter().step_by(far.len() / RETURNS + 1).copied().collect();
    if sample.len() < FEWEST_RETURNS {
        return motion;
    }
    let beams = Beams::new(sensor);
    let start = Rates::between(pose, motion);
    let mut rates = start;
    for only_outer in [true, false] {
        for _ in 0..5 {
            rates = rates.improved(start, &beams, &sample, only_outer);
        }
    }
    let on_beam = |rates: Rates, r: &Return| beams.nearest(rates.seen(r)).0.abs() < ON_BEAM_DEG.to_radians();
    let count = |rates: Rates| sample.iter().filter(|r| on_beam(rates, r)).count();
    if count(rates) > count(start) {
        rates.motion(pose, motion.secs)
    } else {
        motion
    }
}

/// Rates of the sensor in its own frame: turn, rad/s, and velocity, m/s.
#[derive(Clone, Copy)]
struct Rates {
    turn: DVec3,
    velocity: DVec3,
}

impl Rates {
    fn between(pose: Pose, motion: PoseAt) -> Self {
        let shift = pose.inverse() * motion.pose;
        Self {
            turn: shift.rotation.to_scaled_axis() / motion.secs,
            velocity: shift.translation / motion.secs,
        }
    }

    fn motion(self, pose: Pose, secs: f64) -> PoseAt {
        let shift = Pose {
            rotation: DQuat::from_scaled_axis(self.turn * secs),
            translation: self.velocity * secs,
        };
        let pose = pose * shift;
        PoseAt { pose, secs }
    }

    /// The return as the sensor saw it.
    fn seen(self, r: &Return) -> DVec3 {
        DQuat::from_scaled_axis(self.turn * -r.secs) * (r.point - self.velocity * r.secs)
    }

    /// One step of Gauss-Newton with Cauchy weights.
    fn improved(self, start: Self, beams: &Beams, returns: &[Return], only_outer: bool) -> Self {
        let weight_of_prior = (SCATTER_RAD / PRIOR).powf(2.0);
        let mut hessian = DMat4::from_diagonal(weight_of_prior);
        let mut gradient = weight_of_prior * (self.free() - start.free());
        for r in returns {
            let q = self.seen(r);
            let (off, outer) = beams.nearest(q);
            if only_outer && !outer {
                continue;
            }
            // d elevation / d q, then by the rates: d q = −t (dω × q + dv).
            let (level, range2) = (q.x.hypot(q.y), q.length_squared());
            let slope = DVec3::new(-q.z * q.x / level, -q.z * q.y / level, level) / range2;
            let by_turn = q.cross(slope);
            let row = -r.secs * DVec4::new(by_turn.x, by_turn.y, slope.x, slope.z);
            let weight = 1.0 / (1.0 + (off / SCATTER_RAD).powi(2));
            hessian += DMat4::from_cols(row * row.x, row * row.y, row * row.z, row * row.w) * weight;
            gradient += row * (off * weight);
        }
        let step = hessian.inverse() * gradient;
        if !step.is_finite() {
            return self;
        }
        Self {
            turn: self.turn - DVec3::new(step.x, step.y, 0.0),
            velocity: self.velocity - DVec3::new(step.z, 0.0, step.w),
        }
    }

    fn free(self) -> DVec4 {
        DVec4::new(self.turn.x, self.turn.y, self.velocity.x, self.velocity.z)
    }
}

/// The beams' elevations, ascending, radians, and whether each is far from its neighbours.
struct Beams(Vec<(f64, bool)>);

impl Beams {
    fn new(sensor: &SensorModel) -> Self {
        let degrees: Vec<f64> = sensor.elevations_deg.iter().map(|&e| e.into()).collect();
        let beam = |(k, &deg): (usize, &f64)| {
            let near = |other: Option<&f64>| other.is_some_and(|other| (deg - other).abs() < OUTER_GAP_DEG);
            let below = k.checked_sub(1).and_then(|k| degrees.get(k));
            (deg.to_radians(), !near(below) && !near(degrees.get(k + 1)))
        };
        Self(degrees.iter().enumerate().map(beam).collect())
    }

    /// How far above the nearest beam a point is, radians, and whether that is an outer one.
    fn nearest(&self, point: DVec3) -> (f64, bool) {
        let elevation = point.z.atan2(point.x.hypot(point.y));
        let above = self.0.partition_point(|&(beam, _)| beam < elevation);
        let candidates = self.0.get(above.saturating_sub(1)..).unwrap_or_default().iter().take(2);
        candidates
            .map(|&(beam, outer)| (elevation - beam, outer))
            .min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
            .unwrap_or((0.0, false))
    }
}
