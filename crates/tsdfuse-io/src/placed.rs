//! How a sensor moves during its scans, from the poses of scans or a trajectory.

use tsdfuse::scan::PoseAt;
use tsdfuse::trajectory::{ns_after, secs_between};
use tsdfuse::{Pose, Trajectory};

use crate::poses;
use crate::source::ScanRef;

/// The longest time between two scans over which the sensor is taken to move steadily, seconds.
pub const MAX_STEP_SECS: f64 = 1.0;

/// How the sensor moves while scan `index` measures points at `times`: through all poses of the trajectory within the sweep, if
/// there is no gap; otherwise through the pose of the next scan, or of the one before if the next is farther away than
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
    if let Some(trajectory) = trajectory {
        let (first, last) = span(times);
        let is_covered = || poses::covers(trajectory, ns_after(now, first), ns_after(now, last));
        if last - first > 0.0
            && last.max(-first) <= MAX_STEP_SECS
            && is_covered()
            && let Some((_, motion)) = trajectory.motion_within(now, first, last, body_from_sensor)
        {
            return motion;
        }
    }
    // Of the same sensor.
    let neighbours = [scans.get(index + 1..), scans.get(..index)];
    let [after, before] = neighbours.map(Option::unwrap_or_default);
    let same = |other: &&ScanRef| other.sensor == scan.sensor;
    let near = [after.iter().find(same), before.iter().rev().find(same)];
    let mut motions = near.into_iter().flatten().filter_map(|other| {
        let secs = secs_between(now, other.time_ns?);
        Some(PoseAt {
            secs,
            pose: other.pose?,
        })
    });
    let near = motions.find(|m| m.secs != 0.0 && m.secs.abs() <= MAX_STEP_SECS);
    near.into_iter().collect()
}

/// The first and the last of some times; 0 is always within.
fn span(times: &[f32]) -> (f64, f64) {
    let finite = times.iter().copied().filter(|t| t.is_finite()).map(f64::from);
    finite.fold((0.0, 0.0), |(first, last): (f64, f64), t| (first.min(t), last.max(t)))
}
