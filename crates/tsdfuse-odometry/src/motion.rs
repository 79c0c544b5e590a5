//! How the sensor moves during one sweep: poses at even steps of time, and corrections of them.

use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3, Vec3};
use tsdfuse::scan::{PoseAt, Sweep};
use tsdfuse::{Pose, Scan};

/// Steps of time in a sweep: motion within one of them is straight.
pub(crate) const STEPS: usize = 16;

/// A small motion in the world about a centre: first turned about it, then shifted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Twist {
    pub(crate) shift: DVec3,
    /// Axis times angle, radians.
    pub(crate) turn: DVec3,
}

impl Twist {
    /// The point between two twists, as they would be at a share of the time between them.
    fn between(a: Self, b: Self, share: f64) -> Self {
        Self {
            shift: a.shift.lerp(b.shift, share),
            turn: a.turn.lerp(b.turn, share),
        }
    }

    pub(crate) fn apply(&self, pose: &Pose, centre: DVec3) -> Pose {
        let turn = DQuat::from_scaled_axis(self.turn);
        Pose {
            rotation: (turn * pose.rotation).normalize(),
            translation: centre + turn * (pose.translation - centre) + self.shift,
        }
    }
}

/// Axis times angle of a rotation, the shorter way.
pub(crate) fn turn_of(rotation: DQuat) -> DVec3 {
    let q = if rotation.w < 0.0 { -rotation } else { rotation };
    q.to_scaled_axis()
}

/// The motion `b_from_a` repeated `s` times, for any real `s`: along a screw, as a vehicle goes through a bend.
pub(crate) fn repeated(motion: &Pose, s: f64) -> Pose {
    let turn = turn_of(motion.rotation);
    let shift = ahead(motion) * s;
    Pose {
        rotation: DQuat::from_scaled_axis(turn * s),
        translation: screwed(turn * s, shift),
    }
}

/// How a body moves in its own frame, metres in the time of the motion.
pub(crate) fn ahead(motion: &Pose) -> DVec3 {
    unscrewed(turn_of(motion.rotation), motion.translation)
}

/// Where a body comes to that moves by `shift` in its own frame while it turns.
fn screwed(turn: DVec3, shift: DVec3) -> DVec3 {
    let angle = turn.length();
    let (first, second) = if angle < 1e-4 {
        (0.5, 1.0 / 6.0)
    } else {
        let square = angle * angle;
        ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
    };
    let across = turn.cross(shift);
    shift + first * across + second * turn.cross(across)
}

/// The inverse: how a body moves in its own frame.
fn unscrewed(turn: DVec3, translation: DVec3) -> DVec3 {
    let angle = turn.length();
    let second = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle)
    };
    let across = turn.cross(translation);
    translation - 0.5 * across + second * turn.cross(across)
}

/// `world_from_sensor` at even steps from the begin of a sweep to its end.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    /// At least one; one where the sweep takes no time.
    pub(crate) poses: Arc<[Pose]>,
}

impl Motion {
    /// A sensor at rest.
    pub(crate) fn still(pose: Pose) -> Self {
        Self {
            poses: Arc::new([pose]),
        }
    }

    /// From a pose on, by `sweep` (sensor at the end from sensor at the begin of it) spread evenly.
    pub(crate) fn steady(begin: Pose, sweep: &Pose) -> Self {
        let at = |j: usize| begin * repeated(sweep, j as f64 / STEPS as f64);
        Self {
            poses: (0..=STEPS).map(at).collect(),
        }
    }

    pub(crate) fn first(&self) -> Pose {
        self.poses[0]
    }

    pub(crate) fn last(&self) -> Pose {
        self.poses[self.poses.len() - 1]
    }

    /// The same after a motion of the world.
    pub(crate) fn moved(&self, by: &Pose) -> Self {
        Self {
            poses: self.poses.iter().map(|pose| *by * *pose).collect(),
        }
    }

    /// The pose at a share of the sweep that is a whole number of steps.
    pub(crate) fn knot(&self, k: usize, knots: usize) -> Pose {
        let steps = self.poses.len() - 1;
        self.poses[if knots > 1 { k * steps / (knots - 1) } else { 0 }]
    }

    /// The same motion, but along a direction where another one is.
    pub(crate) fn as_along(&self, other: &Self, direction: DVec3) -> Self {
        let pair = self.poses.iter().zip(other.poses.iter());
        let moved = pair.map(|(own, other)| Pose {
            translation: own.translation + direction * direction.dot(other.translation - own.translation),
            ..*own
        });
        Self { poses: moved.collect() }
    }

    /// Shifted along a direction, by so much at the begin and at the end.
    pub(crate) fn shifted(&self, direction: DVec3, [begin, end]: [f64; 2]) -> Self {
        let steps = self.poses.len().saturating_sub(1).max(1) as f64;
        let moved = self.poses.iter().enumerate().map(|(j, pose)| Pose {
            translation: pose.translation + direction * (begin + (end - begin) * j as f64 / steps),
            ..*pose
        });
        Self { poses: moved.collect() }
    }

    /// Corrected by twists at evenly spaced knots, in proportion between them.
    pub(crate) fn corrected(&self, twists: &[Twist], centre: DVec3) -> Self {
        let steps = self.poses.len() - 1;
        let twist = |j: usize| match twists {
            [only] => *only,
            _ => {
                let at = j as f64 / steps.max(1) as f64 * (twists.len() - 1) as f64;
                let k = (at as usize).min(twists.len() - 2);
                Twist::between(twists[k], twists[k + 1], at - k as f64)
            }
        };
        let poses = self.poses.iter().enumerate();
        Self {
            poses: poses.map(|(j, pose)| twist(j).apply(pose, centre)).collect(),
        }
    }

    /// The pose at a scan's own time, and those at other times, of a sweep that spans these seconds after the scan's time.
    pub(crate) fn around_scan(&self, (first, last): (f64, f64)) -> (Pose, Vec<PoseAt>) {
        let steps = self.poses.len() - 1;
        if steps == 0 {
            return (self.first(), Vec::new());
        }
        let at = |(j, &pose): (usize, &Pose)| PoseAt {
            secs: first + (last - first) * j as f64 / steps as f64,
            pose,
        };
        let at: Vec<PoseAt> = self.poses.iter().enumerate().map(at).collect();
        let after_first = at[1..].iter().map(|m| PoseAt {
            secs: m.secs - first,
            ..*m
        });
        let own = Sweep::new(at[0].pose, &after_first.collect::<Vec<_>>()).at(-first);
        (own, at.into_iter().filter(|m| m.secs.abs() > 1e-9).collect())
    }

    /// The motion of a scan that has a pose, over the seconds after its time that its returns span.
    pub(crate) fn of_scan(scan: &Scan, (first, last): (f64, f64)) -> Option<Self> {
        let pose = scan.pose?;
        let Some(sweep) = scan.sweep().filter(|_| last > first) else {
            return Some(Self::still(pose));
        };
        let secs = |j: usize| first + (last - first) * j as f64 / STEPS as f64;
        Some(Self {
            poses: (0..=STEPS).map(|j| sweep.at(secs(j))).collect(),
        })
    }

    /// What places points quickly.
    pub(crate) fn placer(&self) -> Placer {
        let affine = |pose: &Pose| (DMat3::from_quat(pose.rotation), pose.translation);
        Placer(self.poses.iter().map(affine).collect())
    }
}

/// Places points that were measured at shares (0 to 1) of the sweep.
pub(crate) struct Placer(Vec<(DMat3, DVec3)>);

impl Placer {
    pub(crate) fn place(&self, point: Vec3, share: f32) -> DVec3 {
        let p = point.as_dvec3();
        let steps = self.0.len() - 1;
        if steps == 0 {
            let (turn, shift) = self.0[0];
            return turn * p + shift;
        }
        let at = f64::from(share) * steps as f64;
        let j = (at as usize).min(steps - 1);
        let placed = |(turn, shift): (DMat3, DVec3)| turn * p + shift;
        // Within a step the arc is flatter than a millionth of the range.
        placed(self.0[j]).lerp(placed(self.0[j + 1]), at - j as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_in_parts_is_the_whole() {
        let motion = Pose {
            rotation: DQuat::from_scaled_axis(DVec3::new(0.1, -0.3, 0.8)),
            translation: DVec3::new(2.0, 0.3, -0.1),
        };
        let part = repeated(&motion, 0.25);
        let whole = part * part * part * part;
        assert!(whole.translation.distance(motion.translation) < 1e-12);
        assert!(whole.rotation.angle_between(motion.rotation) < 1e-7);
        // The small angles' series meets the formula.
        let small = |angle: f64| Pose {
            rotation: DQuat::from_rotation_z(angle),
            translation: DVec3::X,
        };
        let (series, formula) = (repeated(&small(0.99e-4), 2.0), repeated(&small(1.01e-4), 2.0));
        assert!(series.translation.distance(formula.translation) < 3e-6);
    }
}
