//! Which pose of one trajectory belongs to which of the other.

use tsdfuse::trajectory::{Poses, secs_between};
use tsdfuse::{Pose, Trajectory};

/// Why two trajectories cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Poses without times are matched by order.
    #[error("{track} poses and {reference} of the reference, and not both have times: they cannot be matched")]
    Counts {
        /// Poses of the trajectory.
        track: usize,
        /// Poses of the reference.
        reference: usize,
    },
    /// The times are of different drives, or clocks.
    #[error(
        "no pose has a time within the reference: the poses run from {:.3} to {:.3} s, the reference from {:.3} to {:.3} s",
        track[0], track[1], reference[0], reference[1]
    )]
    Apart {
        /// First and last time, seconds.
        track: [f64; 2],
        /// First and last time, seconds.
        reference: [f64; 2],
    },
    /// There is nothing to compare.
    #[error("there are no poses")]
    Empty,
    /// A pose is NaN or infinite.
    #[error("pose {0} holds a number that is not finite")]
    NotFinite(usize),
}

/// Poses of the same moments.
pub(super) struct Pairs {
    /// Of the trajectory, and of the reference.
    pub(super) poses: Vec<[Pose; 2]>,
    /// Poses of the trajectory without a counterpart.
    pub(super) left_out: usize,
    /// From the first to the last pair, where both have times.
    pub(super) seconds: Option<f64>,
}

/// Matches poses by time where both have times, else by order.
pub(super) fn pairs(track: &Poses, reference: &Poses) -> Result<Pairs, TrajectoryError> {
    let pairs = match (track, reference) {
        (Poses::Timed(track), Poses::Timed(reference)) => by_time(track, reference)?,
        _ => by_order(track.poses(), reference.poses())?,
    };
    let is_finite = |pose: &Pose| pose.rotation.is_finite() && pose.translation.is_finite();
    match pairs.poses.iter().position(|pair| !pair.iter().all(is_finite)) {
        Some(bad) => Err(TrajectoryError::NotFinite(bad)),
        None if pairs.poses.is_empty() => Err(TrajectoryError::Empty),
        None => Ok(pairs),
    }
}

fn by_time(track: &Trajectory, reference: &Trajectory) -> Result<Pairs, TrajectoryError> {
    let timed = track.times_ns().iter().zip(track.poses());
    let matched = timed.filter_map(|(&time_ns, &pose)| Some((time_ns, [pose, reference.near(time_ns)?])));
    let (times_ns, poses): (Vec<i64>, Vec<_>) = matched.unzip();
    let (Some(&first), Some(&last)) = (times_ns.first(), times_ns.last()) else {
        let span = |(first, last): (i64, i64)| [first, last].map(|ns| secs_between(0, ns));
        return Err(TrajectoryError::Apart {
            track: span(track.span_ns()),
            reference: span(reference.span_ns()),
        });
    };
    Ok(Pairs {
        left_out: track.poses().len() - poses.len(),
        poses,
        seconds: Some(secs_between(first, last)),
    })
}

fn by_order(track: &[Pose], reference: &[Pose]) -> Result<Pairs, TrajectoryError> {
    if track.len() != reference.len() {
        return Err(TrajectoryError::Counts {
            track: track.len(),
            reference: reference.len(),
        });
    }
    Ok(Pairs {
        poses: track.iter().zip(reference).map(|(&a, &b)| [a, b]).collect(),
        left_out: 0,
        seconds: None,
    })
}
