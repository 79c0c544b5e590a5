//! How far a trajectory is from another one: absolute errors after rigid alignment, and drift.
//!
//! ```
//! use tsdfuse::{Pose, glam::DVec3};
//! use tsdfuse::trajectory::Poses;
//! use tsdfuse_eval::trajectory::compare;
//!
//! let at = |x: f64, y: f64| Pose { translation: DVec3::new(x, y, 0.0), ..Pose::IDENTITY };
//! let truth: Vec<Pose> = (0..200).map(|i| at(f64::from(i), 20.0 * (0.01 * f64::from(i)).sin())).collect();
//! // One per cent too long, and in a world of its own.
//! let odometry = truth.iter().map(|p| at(1.01 * p.translation.x + 7.0, 1.01 * p.translation.y)).collect();
//! let found = compare(&Poses::Listed(odometry), &Poses::Listed(truth), true)?;
//! assert!((found.kitti.unwrap().translation_percent - 1.0).abs() < 0.05);
//! # Ok::<(), tsdfuse_eval::trajectory::TrajectoryError>(())
//! ```

use serde::Serialize;
use tsdfuse::Pose;
use tsdfuse::trajectory::{Poses, distances_m};

use crate::stats::Stats;

mod align;
mod drift;
mod pairs;

use align::aligned;
use drift::drift;
pub use drift::{Drift, KITTI_LENGTHS_M};
pub use pairs::TrajectoryError;
use pairs::{Pairs, pairs};

/// Lengths over which the drift is told besides KITTI's, metres.
const LENGTHS_M: [f64; 2] = [10.0, 50.0];
/// KITTI's benchmark begins a piece at each so many-th pose.
const KITTI_STEP: usize = 10;

/// How far a trajectory is from a reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrajectoryComparison {
    /// Pairs of poses that were compared.
    pub poses: usize,
    /// Poses of the trajectory for which the reference has none.
    pub left_out: usize,
    /// The distance along the reference's poses, metres.
    pub distance_m: f64,
    /// From the first to the last pose, where both trajectories have times.
    pub seconds: Option<f64>,
    /// `reference_from_trajectory`, the rigid motion that was applied before absolute errors were taken: least squares of the
    /// positions. `None` if none was asked for.
    pub alignment: Option<Pose>,
    /// Distances between positions (absolute trajectory error), metres.
    pub absolute_m: Spread,
    /// Angles between orientations, degrees.
    pub absolute_deg: Spread,
    /// The drift over 10 and 50 m, over pieces that begin at every pose; those lengths that the drive has.
    pub drift: Vec<Drift>,
    /// KITTI's figures: the drift over 100, 200 … 800 m, over pieces that begin at every tenth pose, the mean of all. `None` for
    /// a drive of less than 100 m.
    pub kitti: Option<Drift>,
    /// How far the last pose is off if the first ones coincide, metres.
    pub last_m: f64,
    /// The same in degrees.
    pub last_deg: f64,
    /// Each pair, for plots.
    #[serde(skip)]
    pub pairs: Vec<Compared>,
}

/// Two poses of one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// Along the reference, metres.
    pub distance_m: f64,
    /// The pose of the reference.
    pub reference: Pose,
    /// That of the trajectory, after alignment.
    pub aligned: Pose,
    /// Between their positions, metres.
    pub error_m: f64,
    /// Between their orientations, degrees.
    pub error_deg: f64,
}

/// Statistics of errors, in their unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The root mean square.
    pub rmse: f64,
    /// The average.
    pub mean: f64,
    /// The median.
    pub median: f64,
    /// The largest.
    pub max: f64,
}

impl Spread {
    fn of(errors: impl Iterator<Item = f64>) -> Option<Self> {
        Stats::of(&errors.collect::<Vec<_>>()).map(|stats| Self {
            rmse: stats.rmse_m,
            mean: stats.mean_m,
            median: stats.median_m,
            max: stats.max_m,
        })
    }
}

/// Compares a trajectory with a reference, after rigid alignment if `align` says so.
///
/// Poses are matched by time where both have times: the reference is interpolated, over at most [`MAX_GAP_SECS`](tsdfuse::trajectory::MAX_GAP_SECS). Otherwise they are
/// matched by order.
///
/// # Errors
/// [`TrajectoryError`] if poses cannot be matched, or none can be.
pub fn compare(track: &Poses, reference: &Poses, align: bool) -> Result<TrajectoryComparison, TrajectoryError> {
    let Pairs {
        poses,
        left_out,
        seconds,
    } = pairs(track, reference)?;
    let alignment = align.then(|| aligned(&poses));
    let reference: Vec<Pose> = poses.iter().map(|pair| pair[1]).collect();
    let estimate: Vec<Pose> = poses.iter().map(|pair| pair[0]).collect();
    let distances_m = distances_m(&reference).collect::<Vec<_>>();
    let compared = |(pair, &distance_m): (&[Pose; 2], &f64)| {
        let aligned = alignment.map_or(pair[0], |alignment| alignment * pair[0]);
        Compared {
            distance_m,
            reference: pair[1],
            aligned,
            error_m: aligned.translation.distance(pair[1].translation),
            error_deg: drift::angle_deg(aligned.rotation.conjugate() * pair[1].rotation),
        }
    };
    let pairs: Vec<Compared> = poses.iter().zip(&distances_m).map(compared).collect();
    let of = |length_m: f64| drift(&estimate, &reference, &distances_m, &[length_m], 1);
    let [last_m, last_deg] = match (poses.first(), poses.last()) {
        (Some(first), Some(last)) => drift::between(first, last),
        _ => [0.0; 2],
    };
    Ok(TrajectoryComparison {
        poses: poses.len(),
        left_out,
        distance_m: distances_m.last().copied().unwrap_or(0.0),
        seconds,
        alignment,
        absolute_m: Spread::of(pairs.iter().map(|pair| pair.error_m)).ok_or(TrajectoryError::Empty)?,
        absolute_deg: Spread::of(pairs.iter().map(|pair| pair.error_deg)).ok_or(TrajectoryError::Empty)?,
        drift: LENGTHS_M.into_iter().filter_map(of).collect(),
        kitti: drift(&estimate, &reference, &distances_m, &KITTI_LENGTHS_M, KITTI_STEP),
        last_m,
        last_deg,
        pairs,
    })
}

#[cfg(test)]
mod tests;
