//! What tf is told of a sensor's way: at each time one pose, although sweeps overlap.

use std::collections::BTreeMap;

use tsdfuse::glam::Vec3;
use tsdfuse::scan::Sweep;
use tsdfuse::trajectory::{ns_after, secs_between};
use tsdfuse::{Pose, Scan, Trajectory};

use super::recording::motion_within;

/// Poses that are remembered of each sensor.
const REMEMBERED: usize = 1000;

/// The poses that were told of a sensor.
#[derive(Default)]
pub(super) struct Told {
    poses: BTreeMap<i64, Pose>,
    /// The last scan's time.
    time_ns: Option<i64>,
}

impl Told {
    /// The poses during a scan that are not told yet, in order of time, and its points where they are not as measured.
    ///
    /// What was told of a time stays. So where a sweep began before the one before ended, and moves otherwise than that, its returns of this
    /// time are given as the sensor would have seen them from where it is told to be: they lie at the same place of the world.
    pub(super) fn follow(&mut self, time_ns: i64, scan: &Scan) -> (Vec<(i64, Pose)>, Option<Vec<Vec3>>) {
        let Some(pose) = scan.pose else {
            return (Vec::new(), None);
        };
        let sweep = scan.sweep();
        let own = sweep.clone().unwrap_or_else(|| Sweep::new(pose, &[]));
        let mut times = vec![time_ns];
        if sweep.is_some() {
            let secs = scan.times.iter().flatten().filter(|secs| secs.is_finite());
            let (first, last) = secs.fold((0.0f32, 0.0f32), |(first, last), &t| (first.min(t), last.max(t)));
            // A nanosecond farther, so that rounding leaves no return outside; but a time since 0 stays one.
            let first = (ns_after(time_ns, first.into()) - 1).max(time_ns.min(0));
            let last = ns_after(time_ns, last.into()) + 1;
            let knots = scan.motion.iter().map(|m| ns_after(time_ns, m.secs));
            times.extend(knots.filter(|&t| first < t && t < last).chain([first, last]));
        }
        // Where time went back, there is no sense in what was told.
        let until = match self.poses.last_key_value() {
            Some((&until, _)) if self.time_ns.is_some_and(|before| before < time_ns) => until,
            _ => i64::MIN,
        };
        if times.iter().any(|&t| t <= until) && times.iter().any(|&t| t > until) {
            times.push(until + 1);
        }
        times.retain(|&t| t > until);
        times.sort_unstable();
        times.dedup();
        let mut new = Vec::new();
        for at in times {
            let pose = if at == time_ns {
                pose
            } else {
                own.at(secs_between(time_ns, at))
            };
            if self.poses.insert(at, pose) != Some(pose) {
                new.push((at, pose));
            }
        }
        self.time_ns = Some(time_ns);
        while self.poses.len() > REMEMBERED {
            self.poses.pop_first();
        }
        (new, self.seen_as_told(time_ns, scan, &own, until))
    }

    /// The points, if any was measured until a time: those as they are seen from the poses told.
    fn seen_as_told(&self, time_ns: i64, scan: &Scan, own: &Sweep, until: i64) -> Option<Vec<Vec3>> {
        let secs = |i: usize| {
            scan.times
                .as_ref()
                .map_or(0.0, |times| times.get(i).copied().unwrap_or(0.0))
        };
        let until_secs = if until == i64::MIN {
            f64::NEG_INFINITY
        } else {
            secs_between(time_ns, until + 1)
        };
        let is_early = |i: usize| f64::from(secs(i)) < until_secs;
        if !(0..scan.points.len()).any(is_early) {
            return None;
        }
        let trajectory = Trajectory::new(self.poses.iter().map(|(t, pose)| (*t, *pose)).collect()).ok()?;
        let motion = motion_within(
            &trajectory,
            time_ns,
            scan.times.as_deref().unwrap_or_default(),
            &Pose::IDENTITY,
        );
        let told = Sweep::new(trajectory.at(time_ns)?, &motion);
        let seen = |(i, point): (usize, &Vec3)| {
            if !is_early(i) {
                return *point;
            }
            let (own, told) = (own.at(secs(i).into()), told.at(secs(i).into()));
            (told.inverse() * own).transform_point(point.as_dvec3()).as_vec3()
        };
        Some(scan.points.iter().enumerate().map(seen).collect())
    }
}

#[cfg(test)]
mod tests {
    use tsdfuse::glam::{DQuat, DVec3};
    use tsdfuse::scan::PoseAt;

    use super::*;

    fn at(x: f64, yaw: f64) -> Pose {
        Pose {
            rotation: DQuat::from_rotation_z(yaw),
            translation: DVec3::new(x, 0.0, 0.0),
        }
    }

    /// Returns from 0.11 s before its time to 2 ms after it; its motion is told a tenth of a second before.
    fn sweep(k: i64, yaw_before: f64) -> (i64, Scan) {
        let times: Vec<f32> = (0..=1120).map(|i| i as f32 * 1e-4 - 0.11).collect();
        let scan = Scan {
            points: times.iter().map(|t| Vec3::new(50.0, 900.0 * t, 1.0)).collect(),
            times: Some(times),
            pose: Some(at(k as f64, 0.0)),
            motion: vec![PoseAt {
                secs: -0.1,
                pose: at(k as f64 - 1.0, yaw_before),
            }],
            ..Scan::default()
        };
        (k * 100_000_000, scan)
    }

    #[test]
    fn returns_of_sweeps_that_overlap_keep_their_place() {
        let (mut told, mut poses) = (Told::default(), Vec::new());
        let mut written = Vec::new();
        // Each ends with another pose than the next one begins with.
        for (k, yaw) in [(10, 0.003), (11, -0.002), (12, 0.001)] {
            let (time_ns, scan) = sweep(k, yaw);
            let (new, points) = told.follow(time_ns, &scan);
            assert!(new.is_sorted_by_key(|(t, _)| *t));
            poses.extend(new);
            assert_eq!(points.is_some(), k > 10);
            let points = points.unwrap_or_else(|| scan.points.clone());
            let moved = points.iter().zip(&scan.points).filter(|(a, b)| a != b).count();
            assert!(moved <= 121, "only where sweeps overlap: {moved}");
            written.push((time_ns, scan, points));
        }
        assert!(poses.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let trajectory = Trajectory::new(poses).unwrap();
        for (time_ns, scan, points) in written {
            let motion = motion_within(&trajectory, time_ns, scan.times.as_ref().unwrap(), &Pose::IDENTITY);
            let read = Scan {
                points,
                pose: trajectory.at(time_ns),
                motion,
                ..scan.clone()
            };
            for (a, b) in scan.points_in_world().unwrap().zip(read.points_in_world().unwrap()) {
                assert!(a.distance(b) < 2e-5, "{a} is read as {b}");
            }
        }
    }

    #[test]
    fn scans_again_at_a_time_or_before_are_told_as_they_are() {
        let mut told = Told::default();
        let (time_ns, scan) = sweep(10, 0.0);
        assert_eq!(told.follow(time_ns, &scan).0.len(), 4);
        assert_eq!(told.follow(time_ns, &scan), (Vec::new(), None));
        let (earlier_ns, earlier) = sweep(5, 0.0);
        assert_eq!(told.follow(earlier_ns, &earlier).1, None);
    }
}
