//! Poses over time, of any rate, and the pose at any moment between them.

use glam::DVec3;

use crate::pose::Pose;
use crate::scan::PoseAt;

mod cubic;

use cubic::Cubic;

/// The longest time between two poses that [`Trajectory::near`] interpolates over, seconds.
pub const MAX_GAP_SECS: f64 = 0.2;
/// A pose that is this near in time needs no second one, seconds.
const SAME_SECS: f64 = 1e-4;
/// [`Trajectory::motion_within`] gives poses at least this often, seconds: straight pieces of this length follow a curve of 50 m/s²
/// to 1 mm.
const STEP_SECS: f64 = 0.0125;
/// Between two poses, [`Trajectory::motion_within`] gives at most this many.
const MOST_STEPS: f64 = 64.0;
/// Nanoseconds in a second.
const NS_PER_SEC: f64 = 1e9;

/// Poses in order of time, interpolated on SE(3) by cubics that meet with equal velocity: that of the chord from the pose before
/// to the pose after (E. Catmull, R. Rom: A class of local interpolating splines, 1974), for the position and for the rotation
/// vector. A sensor that sways within a sweep is followed this way; straight lines between 10 poses a second are off by centimetres.
///
/// Between two neighbours the position moves on a straight line and the orientation turns at a constant rate, the shorter way
/// round, where there are no poses around, or none that tell a velocity: across a gap, or where they jump.
///
/// Times are nanoseconds since the log's epoch. What the poses connect is up to the user; for a moving body it is
/// `world_from_body`.
///
/// ```
/// use tsdfuse::{Pose, Trajectory, glam::DVec3};
///
/// let at = |x| Pose { translation: DVec3::new(x, 0.0, 0.0), ..Pose::IDENTITY };
/// let trajectory = Trajectory::new(vec![(0, at(0.0)), (100_000_000, at(1.0))])?;
/// assert_eq!(trajectory.at(25_000_000), Some(at(0.25)));
/// assert_eq!(trajectory.at(-1), None); // no pose is invented
/// # Ok::<(), tsdfuse::trajectory::TrajectoryError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Strictly ascending, as long as `poses`, not empty.
    times_ns: Vec<i64>,
    poses: Vec<Pose>,
}

/// Poses of a drive, of whatever frame: with or without times.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// Without times.
    Listed(Vec<Pose>),
    /// With times.
    Timed(Trajectory),
}

impl Poses {
    /// With times, if all poses have one and these ascend.
    pub fn of(poses: impl Iterator<Item = (Option<i64>, Pose)> + Clone) -> Self {
        let timed: Option<Vec<_>> = poses.clone().map(|(time_ns, pose)| Some((time_ns?, pose))).collect();
        match timed.and_then(|timed| Trajectory::new(timed).ok()) {
            Some(trajectory) => Self::Timed(trajectory),
            None => Self::Listed(poses.map(|(_, pose)| pose).collect()),
        }
    }

    /// The poses in order.
    pub fn poses(&self) -> &[Pose] {
        match self {
            Self::Listed(poses) => poses,
            Self::Timed(trajectory) => trajectory.poses(),
        }
    }

    /// Applies `f` to each pose.
    pub fn map(&mut self, f: impl FnMut(&Pose) -> Pose) {
        *self = match self {
            Self::Listed(poses) => Self::Listed(poses.iter().map(f).collect()),
            Self::Timed(trajectory) => Self::Timed(trajectory.map(f)),
        };
    }
}

/// Why poses are not a trajectory.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// A trajectory has at least one pose.
    #[error("a trajectory needs at least one pose")]
    Empty,
    /// Times must ascend strictly.
    #[error("pose {index} of the trajectory, at {time_ns} ns, is not later than the one before")]
    Order {
        /// Number of the pose, from 0.
        index: usize,
        /// Its time.
        time_ns: i64,
    },
    /// A number of a pose is NaN or infinite.
    #[error("pose {index} of the trajectory holds a number that is not finite")]
    NotFinite {
        /// Number of the pose, from 0.
        index: usize,
    },
}

/// Seconds from one time to another, both in nanoseconds.
pub fn secs_between(from_ns: i64, to_ns: i64) -> f64 {
    // Exact for any two times, also where the difference overflows i64.
    (i128::from(to_ns) - i128::from(from_ns)) as f64 / NS_PER_SEC
}

/// The time in nanoseconds that lies `secs` after `from_ns`, to the nearest nanosecond; saturates.
pub fn ns_after(from_ns: i64, secs: f64) -> i64 {
    from_ns.saturating_add((secs * NS_PER_SEC).round() as i64)
}

impl Trajectory {
    /// A trajectory from `(time_ns, pose)` pairs in order of time.
    ///
    /// # Errors
    /// [`TrajectoryError`] names the first pose that is out of order or not finite.
    pub fn new(poses: Vec<(i64, Pose)>) -> Result<Self, TrajectoryError> {
        if poses.is_empty() {
            return Err(TrajectoryError::Empty);
        }
        for (index, &(time_ns, pose)) in poses.iter().enumerate() {
            if index > 0 && poses[index - 1].0 >= time_ns {
                return Err(TrajectoryError::Order { index, time_ns });
            }
            if !(pose.rotation.is_finite() && pose.translation.is_finite()) {
                return Err(TrajectoryError::NotFinite { index });
            }
        }
        let (times_ns, poses) = poses.into_iter().unzip();
        Ok(Self { times_ns, poses })
    }

    /// The times of the poses, nanoseconds, strictly ascending.
    pub fn times_ns(&self) -> &[i64] {
        &self.times_ns
    }

    /// The poses, in order of time.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// The times of the first and the last pose.
    pub fn span_ns(&self) -> (i64, i64) {
        let first = self.times_ns.first().copied().unwrap_or_default();
        (first, self.times_ns.last().copied().unwrap_or(first))
    }

    /// The poses before and after a time, with their times; at the time of a pose, that pose is both.
    pub fn neighbours(&self, time_ns: i64) -> [Option<(i64, Pose)>; 2] {
        let side = |i: usize| Some((*self.times_ns.get(i)?, *self.poses.get(i)?));
        let after = self.times_ns.partition_point(|&t| t < time_ns);
        match side(after) {
            Some(exact) if exact.0 == time_ns => [Some(exact), Some(exact)],
            next => [after.checked_sub(1).and_then(side), next],
        }
    }

    /// The pose at a time; `None` before the first pose and after the last one.
    pub fn at(&self, time_ns: i64) -> Option<Pose> {
        let after = self.times_ns.partition_point(|&t| t < time_ns);
        let (&t1, &pose) = self.times_ns.get(after).zip(self.poses.get(after))?;
        if t1 == time_ns {
            return Some(pose);
        }
        let t0 = *self.times_ns.get(after.checked_sub(1)?)?;
        Some(
            self.between(after - 1)?
                .at(secs_between(t0, time_ns) / secs_between(t0, t1)),
        )
    }

    /// The motion from pose `i` to the next one.
    fn between(&self, i: usize) -> Option<Cubic> {
        let at = |i: usize| Some((*self.times_ns.get(i)?, *self.poses.get(i)?));
        let (from, to) = (at(i)?, at(i + 1)?);
        let away = |other: (i64, Pose)| (secs_between(from.0, other.0), other.1);
        let around = [i.checked_sub(1).and_then(at), at(i + 2)];
        Some(Cubic::new(from.1, away(to), around.map(|other| other.map(away))))
    }

    /// As [`Self::at`], but `None` also in gaps longer than [`MAX_GAP_SECS`], and up to 0.1 ms from a pose that pose itself.
    pub fn near(&self, time_ns: i64) -> Option<Pose> {
        let neighbours = self.neighbours(time_ns);
        if let [Some(before), Some(after)] = neighbours
            && secs_between(before.0, after.0) <= MAX_GAP_SECS
        {
            return self.at(time_ns);
        }
        let mut poses = neighbours.into_iter().flatten();
        let near = poses.find(|(t, _)| secs_between(*t, time_ns).abs() <= SAME_SECS);
        near.map(|(_, pose)| pose)
    }

    /// The trajectory with `f` applied to each pose: with `|pose| *pose * body_from_sensor`, for instance, that of a sensor.
    #[must_use]
    pub fn map(&self, f: impl FnMut(&Pose) -> Pose) -> Self {
        Self {
            times_ns: self.times_ns.clone(),
            poses: self.poses.iter().map(f).collect(),
        }
    }

    /// How a sensor moves during a sweep: its pose at `time_ns`, and its poses from `first_secs` to `last_secs` after that
    /// (negative: before): those at the ends, all that the trajectory has in between, and more where these are far apart.
    ///
    /// `body_from_sensor` is where the sensor sits on the body whose poses these are. Where the trajectory ends within the
    /// sweep, the motion ends with it, and [`crate::scan::Sweep`] extrapolates. `None` if the trajectory has no pose at `time_ns`.
    pub fn motion_within(
        &self,
        time_ns: i64,
        first_secs: f64,
        last_secs: f64,
        body_from_sensor: &Pose,
    ) -> Option<(Pose, Vec<PoseAt>)> {
        let pose = self.at(time_ns)?;
        let (begin, end) = self.span_ns();
        let first_ns = ns_after(time_ns, first_secs.min(0.0)).max(begin);
        let last_ns = ns_after(time_ns, last_secs.max(0.0)).min(end);
        let within = self.times_ns.partition_point(|&t| t <= first_ns)..self.times_ns.partition_point(|&t| t < last_ns);
        let inner = self.times_ns.get(within).unwrap_or_default().iter().copied();
        let starts = [first_ns].into_iter().chain(inner.clone());
        let times = starts.zip(inner.chain([last_ns])).flat_map(|(from, to)| {
            let steps = (secs_between(from, to) / STEP_SECS).ceil().clamp(1.0, MOST_STEPS) as i64;
            let step =
                move |k: i64| from + ((i128::from(to) - i128::from(from)) * i128::from(k) / i128::from(steps)) as i64;
            (0..steps).map(step)
        });
        // At the sweep's own time stands the pose above.
        let times = times.chain([last_ns]).filter(|&t| t != time_ns);
        let timed = times.filter_map(|t| Some((t, self.at(t)?)));
        let motion = timed.map(|(t, pose)| PoseAt {
            secs: secs_between(time_ns, t),
            pose: pose * *body_from_sensor,
        });
        Some((pose * *body_from_sensor, motion.collect()))
    }

    /// The distance travelled along the poses, metres.
    pub fn length_m(&self) -> f64 {
        length_m(&self.poses)
    }
}

/// The distance travelled from pose to pose, metres.
pub fn length_m<'a>(poses: impl IntoIterator<Item = &'a Pose>) -> f64 {
    distances_m(poses).last().unwrap_or(0.0)
}

/// The distance travelled up to each pose, metres.
pub fn distances_m<'a>(poses: impl IntoIterator<Item = &'a Pose>) -> impl Iterator<Item = f64> {
    let steps = poses.into_iter().scan(None, |last: &mut Option<DVec3>, pose| {
        let last = last.replace(pose.translation);
        Some(last.map_or(0.0, |last| last.distance(pose.translation)))
    });
    steps.scan(0.0, |sum, step| {
        *sum += step;
        Some(*sum)
    })
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    use super::*;
    use crate::scan::Sweep;

    fn turned(x: f64, yaw: f64) -> Pose {
        Pose {
            rotation: DQuat::from_rotation_z(yaw),
            translation: DVec3::new(x, 0.0, 0.0),
        }
    }

    #[test]
    fn what_is_no_trajectory_is_refused() {
        assert_eq!(Trajectory::new(vec![]), Err(TrajectoryError::Empty));
        let same = Trajectory::new(vec![(5, turned(0.0, 0.0)), (5, turned(1.0, 0.0))]);
        assert_eq!(same, Err(TrajectoryError::Order { index: 1, time_ns: 5 }));
        let nan = Trajectory::new(vec![(5, turned(f64::NAN, 0.0))]);
        assert_eq!(nan, Err(TrajectoryError::NotFinite { index: 0 }));
    }

    #[test]
    fn poses_are_met_and_none_is_invented() {
        let t0 = 1_583_836_591_182_590_976;
        let trajectory = Trajectory::new(vec![(t0, turned(0.0, 0.0)), (t0 + 200, turned(2.0, 0.5))]).unwrap();
        assert_eq!(trajectory.at(t0), Some(turned(0.0, 0.0)));
        assert_eq!(trajectory.at(t0 + 200), Some(turned(2.0, 0.5)));
        // Nanoseconds of today's epoch count.
        let middle = trajectory.at(t0 + 50).unwrap();
        assert!(middle.translation.distance(DVec3::new(0.5, 0.0, 0.0)) < 1e-12);
        assert!(middle.rotation.angle_between(DQuat::from_rotation_z(0.125)) < 1e-7);
        assert_eq!((trajectory.at(t0 - 1), trajectory.at(t0 + 201)), (None, None));
        assert_eq!(
            Trajectory::new(vec![(i64::MIN, turned(0.0, 0.0)), (i64::MAX, turned(1.0, 0.0))])
                .unwrap()
                .at(0)
                .unwrap()
                .translation
                .x,
            0.5
        );
    }

    #[test]
    fn a_sweep_has_all_poses_within_it_and_those_at_its_ends() {
        let poses = (0..10).map(|k| (10 * k, turned(k as f64, 0.1 * k as f64))).collect();
        let trajectory = Trajectory::new(poses).unwrap();
        let secs = |motion: &[PoseAt]| motion.iter().map(|m| (m.secs * 1e9).round() as i64).collect::<Vec<_>>();
        let of = |time, first, last| {
            let (pose, motion) = trajectory
                .motion_within(time, first * 1e-9, last * 1e-9, &Pose::IDENTITY)
                .unwrap();
            (pose.translation.x, secs(&motion))
        };
        assert_eq!(of(30, 0.0, 25.0), (3.0, vec![10, 20, 25]));
        assert_eq!(of(35, -20.0, 5.0), (3.5, vec![-20, -15, -5, 5]));
        assert_eq!(of(30, -30.0, 0.0), (3.0, vec![-30, -20, -10]));
        // It ends where the trajectory does.
        assert_eq!(of(80, 0.0, 25.0), (8.0, vec![10]));
        assert_eq!(of(90, 0.0, 25.0), (9.0, vec![]));
        assert_eq!(trajectory.motion_within(91, 0.0, 0.0, &Pose::IDENTITY), None);
    }

    /// A car that sways and turns, seen by its poses 10 times a second.
    fn swaying(secs: f64) -> Pose {
        Pose {
            rotation: DQuat::from_rotation_z(0.5 * secs) * DQuat::from_rotation_x(0.01 * (6.0 * secs).sin()),
            translation: DVec3::new(8.0 * secs, secs * secs, 0.02 * (7.0 * secs).sin()),
        }
    }

    #[test]
    fn a_swaying_sensor_is_followed_between_its_poses() {
        let poses = (0..30).map(|k| (k * 100_000_000, swaying(0.1 * k as f64))).collect();
        let trajectory = Trajectory::new(poses).unwrap();
        let (mut worst, mut straight) = ([0.0_f64; 2], [0.0_f64; 2]);
        let off = |a: Pose, b: Pose| [a.translation.distance(b.translation), turn_between(a, b)];
        for k in 1..28 {
            let (pose, motion) = trajectory
                .motion_within(k * 100_000_000, 0.0, 0.1, &Pose::IDENTITY)
                .unwrap();
            let sweep = Sweep::new(pose, &motion);
            let line = Sweep::new(pose, &motion[motion.len() - 1..]);
            for j in 0..=100 {
                let secs = 1e-3 * f64::from(j);
                let truth = swaying(0.1 * k as f64 + secs);
                worst = zip_max(worst, off(sweep.at(secs), truth));
                straight = zip_max(straight, off(line.at(secs), truth));
            }
        }
        assert!(worst[0] < 1.6e-4 && worst[1] < 6e-5, "{worst:?}");
        assert!(straight[0] > 1.5e-3 && straight[1] > 4e-4, "{straight:?}");
    }

    #[test]
    fn what_tells_no_velocity_is_left_out() {
        // A jump of 3 m, a gap, and two poses alone: straight lines.
        let jump = [(0, 0.0), (100, 1.0), (200, 2.0), (300, 6.0), (400, 7.0)];
        let gap = [(0, 0.0), (900, 1.0), (1000, 2.0), (1100, 3.0)];
        for (poses, at, x) in [
            (&jump[..], 150, 1.5),
            (&jump[..], 350, 6.5),
            (&gap[..], 950, 1.5),
            (&gap[..2], 450, 0.5),
        ] {
            let poses = poses.iter().map(|&(ms, x)| (ms * 1_000_000, turned(x, 0.0))).collect();
            let got = Trajectory::new(poses)
                .unwrap()
                .at(at * 1_000_000)
                .unwrap()
                .translation
                .x;
            assert!((got - x).abs() < 1e-9, "{got} {x}");
        }
    }

    fn turn_between(a: Pose, b: Pose) -> f64 {
        2.0 * (a.rotation.conjugate() * b.rotation).xyz().length().min(1.0).asin()
    }

    fn zip_max(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        [a[0].max(b[0]), a[1].max(b[1])]
    }

    proptest! {
        /// A sensor beside the body, at every moment of its sweep: as the trajectory of the body says.
        #[test]
        fn a_sensor_moves_with_its_body(
            steps in prop::collection::vec((1..40_000_000i64, -1.0..1.0f64, -0.5..0.5f64), 2..20),
            share in 0.0..1.0f64,
            (before, after) in (0.0..0.05f64, 0.0..0.05f64),
        ) {
            let (mut t, mut x, mut yaw) = (1_700_000_000_000_000_000, 1e3, 0.0);
            let mut poses = vec![(t, turned(x, yaw))];
            for (ns, dx, dyaw) in steps {
                (t, x, yaw) = (t + ns, x + dx, yaw + dyaw);
                poses.push((t, turned(x, yaw)));
            }
            let trajectory = Trajectory::new(poses).unwrap();
            let body_from_sensor = Pose { rotation: DQuat::from_rotation_x(0.3), translation: DVec3::new(0.0, 0.4, 1.7) };
            let (begin, end) = trajectory.span_ns();
            let now = begin + ((end - begin) as f64 * share) as i64;
            let (pose, motion) = trajectory.motion_within(now, -before, after, &body_from_sensor).unwrap();
            let sweep = Sweep::new(pose, &motion);
            for k in 0..=20 {
                let at = ns_after(now, -before + (before + after) * f64::from(k) / 20.0);
                let Some(body) = trajectory.at(at) else { continue };
                let want = body * body_from_sensor;
                let got = sweep.at(secs_between(now, at));
                // The lever moves on an arc; between two poses of the motion the sensor is taken to move straight on.
                let [before, after] = trajectory.neighbours(at);
                let turn = before.zip(after).map_or(0.0, |(a, b)| a.1.rotation.angle_between(b.1.rotation));
                let sagitta = 0.4 * (1.0 - (0.5 * turn).cos());
                prop_assert!(got.translation.distance(want.translation) < 4e-3 + 1.1 * sagitta, "{got:?} {want:?}");
                prop_assert!(got.rotation.angle_between(want.rotation) < 8e-3);
            }
        }
    }
}
