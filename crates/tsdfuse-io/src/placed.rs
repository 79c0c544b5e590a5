//! How a sensor moves during its scans, from the poses of scans or a trajectory.

use tsdfuse::scan::PoseAt;
use tsdfuse::trajectory::{ns_after, secs_between};
use tsdfuse::{Pose, Trajectory};

use crate::poses;
use crate::source::ScanRef;

/// The longest time between two scans over which the sensor is taken to move steadily, seconds.
pub const MAX_STEP_SECS: f64 = 1.0;

/// How the sensor moves while scan `index` measures points at `times`: as the trajectory says, or the poses of the scans around it,
/// if there is no gap; otherwise through the pose of the next scan, or of the one before if the next is farther away than
/// [`MAX_STEP_SECS`].
pub(crate) fn motion(
    scans: &[ScanRef],
    index: usize,
    times: &[f32],
    trajectory: Option<&Trajectory>,
    body_from_sensor: &Pose,
) -> Vec<PoseAt> {
    let Some((scan, now)) = scans
        .get(index)
        .and_then(|scan| scan.pose.and(Some((scan, scan.time_ns?))))
    else {
        return Vec::new();
    };
    let (first, last) = span(times);
    let within = |trajectory: &Trajectory, body_from_sensor| {
        let is_covered = || poses::covers(trajectory, ns_after(now, first), ns_after(now, last));
        let is_sweep = last - first > 0.0 && last.max(-first) <= MAX_STEP_SECS && is_covered();
        let motion = is_sweep.then(|| trajectory.motion_within(now, first, last, body_from_sensor));
        motion.flatten().map(|(_, motion)| motion)
    };
    if let Some(motion) = trajectory.and_then(|trajectory| within(trajectory, body_from_sensor)) {
        return motion;
    }
    // Of the same sensor.
    let placed = |other: &ScanRef| (other.sensor == scan.sensor).then_some((other.time_ns?, other.pose?));
    let [before, after] = [scans.get(..index), scans.get(index + 1..)].map(Option::unwrap_or_default);
    let after: Vec<_> = after.iter().filter_map(placed).take(2).collect();
    let mut before: Vec<_> = before.iter().rev().filter_map(placed).take(2).collect();
    let next = [after.first().copied(), before.first().copied()];
    before.reverse();
    before.extend(scan.pose.map(|pose| (now, pose)));
    before.extend(after);
    let around = Trajectory::new(before).ok();
    let around = around.and_then(|around| within(&around, &Pose::IDENTITY));
    around.unwrap_or_else(|| {
        let mut near = next.into_iter().flatten().map(|(time_ns, pose)| PoseAt {
            secs: secs_between(now, time_ns),
            pose,
        });
        let near = near.find(|m| m.secs != 0.0 && m.secs.abs() <= MAX_STEP_SECS);
        near.into_iter().collect()
    })
}

/// The first and the last of some times; 0 is always within.
fn span(times: &[f32]) -> (f64, f64) {
    let finite = times.iter().copied().filter(|t| t.is_finite()).map(f64::from);
    finite.fold((0.0, 0.0), |(first, last): (f64, f64), t| (first.min(t), last.max(t)))
}
