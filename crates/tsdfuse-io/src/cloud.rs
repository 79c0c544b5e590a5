//! The points of one file, before the pose of the sensor is known.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::glam::Vec3;

use crate::error::{Error, Result};

/// The longest time between a return and its scan's pose, seconds. Longer times must be in another unit.
const MAX_OFFSET_SECS: f64 = 10.0;

/// The points of one file and the columns that it has, each as long as `points`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Sensor frame, metres; invalid returns are as in the file.
    pub points: Vec<Vec3>,
    /// The laser of each point.
    pub rings: Option<Vec<u16>>,
    /// When each point was measured: seconds after the scan's pose, or since the epoch of the scans' times.
    pub secs: Option<Vec<f64>>,
    /// In the sensor's own unit.
    pub intensities: Option<Vec<f32>>,
    /// Where the sensor was, if the file says so: `world_from_sensor`.
    pub viewpoint: Option<Pose>,
}

/// Converts times to seconds after the scan's pose. They count from there or, like `scan_secs`, from an epoch; if neither fits, the
/// earliest of them is taken as zero. A point without a finite time gets NaN.
pub(crate) fn offsets(path: &Path, secs: &[f64], scan_secs: Option<f64>) -> Result<Vec<f32>> {
    let finite = secs.iter().copied().filter(|t| t.is_finite());
    let Some(first) = finite.clone().reduce(f64::min) else {
        return Ok(vec![f32::NAN; secs.len()]);
    };
    let candidates = [Some(0.0), scan_secs].into_iter().flatten();
    let nearest = candidates.min_by(|a, b| (first - a).abs().total_cmp(&(first - b).abs()));
    let base = nearest
        .filter(|base| (first - base).abs() <= MAX_OFFSET_SECS)
        .unwrap_or(first);
    if let Some(t) = finite.map(|t| t - base).find(|t| t.abs() > MAX_OFFSET_SECS) {
        return Err(too_far(path, t));
    }
    let offset = |t: &f64| if t.is_finite() { (t - base) as f32 } else { f32::NAN };
    Ok(secs.iter().map(offset).collect())
}

/// Checks times that should count from the scan's pose.
pub(crate) fn checked_offsets(path: &Path, secs: Vec<f32>) -> Result<Vec<f32>> {
    match secs.iter().find(|t| f64::from(t.abs()) > MAX_OFFSET_SECS) {
        Some(t) => Err(too_far(path, f64::from(*t))),
        None => Ok(secs),
    }
}

fn too_far(path: &Path, secs: f64) -> Error {
    let reason =
        format!("a point was measured {secs:.3} s from the scan's pose; more than {MAX_OFFSET_SECS} s cannot be");
    Error::format(path, reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(secs: &[f64], scan_secs: Option<f64>) -> Result<Vec<f32>, String> {
        offsets(Path::new("a.pcd"), secs, scan_secs).map_err(|e| e.to_string())
    }

    #[test]
    fn times_count_from_the_pose_or_from_the_scans_epoch() {
        assert_eq!(of(&[0.0, 0.5], None), Ok(vec![0.0, 0.5]));
        assert_eq!(of(&[-0.5, 0.0], Some(3.0)), Ok(vec![-0.5, 0.0]));
        assert_eq!(of(&[3.5, 3.0], Some(3.0)), Ok(vec![0.5, 0.0]));
        assert_eq!(of(&[1.5e9 + 0.25], Some(1.5e9)), Ok(vec![0.25]));
        // Another clock than the scans': the earliest point is where the scan begins.
        assert_eq!(of(&[1.5e9 + 0.25, 1.5e9], Some(3.0)), Ok(vec![0.25, 0.0]));
        assert_eq!(of(&[], None), Ok(vec![]));
    }

    #[test]
    fn a_sweep_of_more_than_ten_seconds_is_another_unit() {
        let message = of(&[0.0, 99.5], None).unwrap_err();
        assert_eq!(
            message,
            "a.pcd: a point was measured 99.500 s from the scan's pose; more than 10 s cannot be"
        );
        assert!(of(&[0.0, f64::INFINITY], None).unwrap()[1].is_nan());
        assert!(checked_offsets(Path::new("a.f32"), vec![0.1, f32::INFINITY]).is_err());
    }
}
