//! Where a sensor is at the times of its scans, and how it moves during them, from the poses of scans or a trajectory.

use std::path::Path;

use tsdfuse::scan::PoseAt;
use tsdfuse::trajectory::{ns_after, secs_between};
use tsdfuse::{Pose, Trajectory};

use crate::error::{Error, Result};
use crate::files::ScanFile;
use crate::poses::{self, Poses};
use crate::source::{ScanRef, Sensor};

/// The longest time between two scans over which the sensor is taken to move steadily, seconds.
pub const MAX_STEP_SECS: f64 = 1.0;

/// Gives the scans of a recording the poses of a file. Those at whose times it has none are taken out, and their places with them. Returns the
/// poses over time, and a sentence if scans were taken out.
///
/// # Errors
/// If no scan has a pose.
pub(crate) fn by_file<T>(
    log: &Path,
    file: &Path,
    poses: Poses,
    sensors: &[Sensor],
    scans: &mut Vec<ScanRef>,
    places: &mut Vec<T>,
) -> Result<(Option<Trajectory>, Option<String>)> {
    let all = scans.len();
    let times_ns: Option<Vec<i64>> = scans.iter().map(|scan| scan.time_ns).collect();
    let (trajectory, found): (_, Vec<Option<Pose>>) = match (poses, times_ns) {
        (Poses::Timed(trajectory), Some(times_ns)) => {
            let found: Vec<_> = times_ns.iter().map(|&time| poses::at(&trajectory, time).ok()).collect();
            if let (Some(first), Some(last)) = (times_ns.iter().min(), times_ns.iter().max())
                && found.iter().all(Option::is_none)
            {
                let (from, to) = trajectory.span_ns();
                let [from, to, first, last] = [from, to, *first, *last].map(|time_ns| secs_between(0, time_ns));
                let reason =
                    format!("has poses from {from:.3} to {to:.3} s, and the scans are from {first:.3} to {last:.3} s");
                return Err(Error::dataset(file, reason));
            }
            (Some(trajectory), found)
        }
        (poses, times_ns) => {
            let named = scans.iter().map(|scan| ScanFile {
                path: log.to_owned(),
                name: scan.name.clone(),
            });
            let found = poses::place(file, &poses, &named.collect::<Vec<_>>(), times_ns)?;
            (None, found.into_iter().map(|(pose, _)| Some(pose)).collect())
        }
    };
    for (scan, pose) in scans.iter_mut().zip(found) {
        let body_from_sensor = sensors.get(scan.sensor).map_or(Pose::IDENTITY, |s| s.body_from_sensor);
        scan.pose = match pose {
            Some(pose) if body_from_sensor != Pose::IDENTITY => Some(pose * body_from_sensor),
            pose => pose,
        };
    }
    let mut placed = scans.iter().map(|scan| scan.pose.is_some());
    places.retain(|_| placed.next().unwrap_or(false));
    scans.retain(|scan| scan.pose.is_some());
    let left_out = all - scans.len();
    let note = format!("{left_out} of {all} scans are left out: there are no poses at their times");
    Ok((trajectory, Some(note).filter(|_| left_out > 0)))
}

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
