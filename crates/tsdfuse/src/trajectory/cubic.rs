//! The motion between two neighbouring poses of a trajectory.

use glam::{DQuat, DVec3};

use crate::pose::Pose;

/// A neighbour that is this much farther away in time says nothing of the velocity here.
const MAX_RATIO: f64 = 2.0;
/// No sensor is accelerated more, m/s²: a change of velocity beyond it is a jump of the poses, or their noise.
const MAX_ACCELERATION: f64 = 50.0;
/// The same for its turning, rad/s².
const MAX_TURNING: f64 = 100.0;

/// Position and rotation vector from one pose to the next, as polynomials of the share `u` of the time between them:
/// `c[0] u + c[1] u² + c[2] u³`.
pub(super) struct Cubic {
    from: Pose,
    shift: [DVec3; 3],
    turn: [DVec3; 3],
}

/// Where a pose lies as seen from the first one: seconds after it, shift in the world, rotation vector.
#[derive(Clone, Copy)]
struct Step {
    secs: f64,
    shift: DVec3,
    turn: DVec3,
}

impl Step {
    fn new(from: Pose, (secs, to): (f64, Pose)) -> Self {
        let turn = from.rotation.conjugate() * to.rotation;
        Self {
            secs,
            shift: to.translation - from.translation,
            turn: if turn.w < 0.0 { -turn } else { turn }.to_scaled_axis(),
        }
    }

    fn minus(self, other: Self) -> Self {
        Self {
            secs: self.secs - other.secs,
            shift: self.shift - other.shift,
            turn: self.turn - other.turn,
        }
    }

    /// Whether the velocity of a neighbouring step `other` can be that of the same sensor a moment before or after.
    fn goes_on_as(self, other: Self) -> bool {
        let secs = 0.5 * (self.secs + other.secs);
        let change = |own: DVec3, others: DVec3| (own / self.secs - others / other.secs).length() / secs;
        other.secs <= MAX_RATIO * self.secs
            && change(self.shift, other.shift) <= MAX_ACCELERATION
            && change(self.turn, other.turn) <= MAX_TURNING
    }

    /// Shift and turn in `secs` at the velocity of the chord over this step and a neighbouring one.
    fn chord(self, other: Self) -> [DVec3; 2] {
        let share = self.secs / (self.secs + other.secs);
        [(self.shift + other.shift) * share, (self.turn + other.turn) * share]
    }
}

impl Cubic {
    /// From a pose to a later one; `around` are the poses before and after these two. Times are seconds after the first pose.
    pub(super) fn new(from: Pose, to: (f64, Pose), around: [Option<(f64, Pose)>; 2]) -> Self {
        let own = Step::new(from, to);
        let origin = Step {
            secs: 0.0,
            shift: DVec3::ZERO,
            turn: DVec3::ZERO,
        };
        let [before, after] = around.map(|pose| pose.map(|pose| Step::new(from, pose)));
        let before = before.map(|before| origin.minus(before));
        let after = after.map(|after| after.minus(own));
        let [begin, end] =
            [before, after].map(|step| step.filter(|&step| own.goes_on_as(step)).map(|step| own.chord(step)));
        let d = [own.shift, own.turn];
        let mirrored = |velocity: [DVec3; 2]| [2.0 * d[0] - velocity[0], 2.0 * d[1] - velocity[1]];
        let (begin, end) = match (begin, end) {
            (Some(begin), Some(end)) => (begin, end),
            (Some(begin), None) => (begin, mirrored(begin)),
            (None, Some(end)) => (mirrored(end), end),
            (None, None) => (d, d),
        };
        // The cubic of Hermite from 0 to d with these velocities at its ends.
        let through = |k: usize| {
            [
                begin[k],
                3.0 * d[k] - 2.0 * begin[k] - end[k],
                begin[k] + end[k] - 2.0 * d[k],
            ]
        };
        Self {
            from,
            shift: through(0),
            turn: through(1),
        }
    }

    /// The pose at a share of the time, from 0 to 1.
    pub(super) fn at(&self, u: f64) -> Pose {
        let along = |[a, b, c]: [DVec3; 3]| ((c * u + b) * u + a) * u;
        Pose {
            rotation: (self.from.rotation * DQuat::from_scaled_axis(along(self.turn))).normalize(),
            translation: self.from.translation + along(self.shift),
        }
    }
}
