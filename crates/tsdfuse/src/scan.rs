//! One sweep of a sensor: returns in the sensor frame, and where the sensor was.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::pose::{Interpolation, Pose};
use crate::sensor::Pinhole;

/// One sweep (or one frame) of a range sensor.
///
/// Points are in the sensor frame (x forward, y left, z up, metres) **at the moment each was measured**. Where `times` and
/// `motion` are given, every return is placed from its own sensor pose, so that motion within the sweep is undone
/// (deskew); otherwise all returns are placed from `pose`.
///
/// The optional columns `rings`, `times` and `intensities` have one entry per point; [`Scan::check`] verifies that.
#[derive(Clone, Debug, Default)]
pub struct Scan {
    /// What to call this scan in messages: a file name, usually.
    pub name: String,
    /// Seconds since some epoch, of `pose`.
    pub timestamp_secs: Option<f64>,
    /// Returns in the sensor frame, metres. May hold invalid returns until [`Scan::drop_invalid`] has run.
    pub points: Vec<Vec3>,
    /// The laser of each return, 0 = lowest.
    pub rings: Option<Vec<u16>>,
    /// When each return was measured: seconds after `pose` (negative: before), NaN where that is not known.
    pub times: Option<Vec<f32>>,
    /// Intensity of each return, in the sensor's own unit.
    pub intensities: Option<Vec<f32>>,
    /// `world_from_sensor` at time 0.
    pub pose: Pose,
    /// How the sensor moves during the scan.
    pub motion: Option<Motion>,
    /// The camera, where the scan is a depth image: each point lies on the ray through the centre of its pixel.
    pub camera: Option<Pinhole>,
    /// What the reader and [`Scan::drop_invalid`] left out so far.
    pub dropped: Dropped,
}

/// A second pose of the sensor, so that poses during the scan can be interpolated (or extrapolated).
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// `world_from_sensor` at `secs`.
    pub pose: Pose,
    /// Seconds from the scan's own pose to this one: not zero, negative for an earlier pose.
    pub secs: f64,
}

/// Returns that were left out, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dropped {
    /// A coordinate was NaN or infinite.
    pub not_finite: u64,
    /// All coordinates were zero: the mark of a beam that did not come back.
    pub no_return: u64,
    /// Nearer than the minimum range.
    pub too_near: u64,
    /// Farther than the maximum range.
    pub too_far: u64,
    /// Measured by another sensor of the same log than the one asked for.
    pub other_sensor: u64,
    /// Left out by a mask.
    pub masked: u64,
    /// Its time is missing or not within the scan, so that it cannot be placed.
    pub untimed: u64,
}

impl Dropped {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.not_finite + self.no_return + self.too_near + self.too_far + self.other_sensor + self.masked + self.untimed
    }
}

impl std::ops::AddAssign for Dropped {
    fn add_assign(&mut self, other: Self) {
        self.not_finite += other.not_finite;
        self.no_return += other.no_return;
        self.too_near += other.too_near;
        self.too_far += other.too_far;
        self.other_sensor += other.other_sensor;
        self.masked += other.masked;
        self.untimed += other.untimed;
    }
}

/// Which ranges count as measurements, metres from the sensor's origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RangeLimits {
    /// Nearer returns are the vehicle itself, or dust on the window.
    pub min_range_m: f32,
    /// Farther returns are not fused.
    pub max_range_m: f32,
}

impl Default for RangeLimits {
    fn default() -> Self {
        Self {
            min_range_m: 0.5,
            max_range_m: 200.0,
        }
    }
}

/// No range is between the limits.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("no range is between min_range_m = {} and max_range_m = {}", .0.min_range_m, .0.max_range_m)]
pub struct RangeError(pub RangeLimits);

impl RangeLimits {
    /// Checks that there are ranges between the limits.
    ///
    /// # Errors
    /// [`RangeError`] names both limits.
    pub fn validate(&self) -> Result<(), RangeError> {
        // Also false for NaN.
        match self.min_range_m >= 0.0 && self.min_range_m < self.max_range_m {
            true => Ok(()),
            false => Err(RangeError(*self)),
        }
    }
}

/// Why a scan cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScanError {
    /// A per-point column is as long as the points, or absent.
    #[error("{scan}: {points} points but {entries} {column}")]
    Length {
        /// The scan's name.
        scan: String,
        /// Which column.
        column: &'static str,
        /// Entries in that column.
        entries: usize,
        /// Points in the scan.
        points: usize,
    },
    /// Without a usable second pose there is nothing to interpolate.
    #[error("{scan}: the second pose for motion compensation is {secs} s away from the first")]
    Motion {
        /// The scan's name.
        scan: String,
        /// The time between the two poses.
        secs: f64,
    },
}

impl Scan {
    /// Checks that the per-point columns agree in length and that the motion spans time.
    ///
    /// # Errors
    /// [`ScanError`] names the scan and the column.
    pub fn check(&self) -> Result<(), ScanError> {
        let columns = [
            ("rings", self.rings.as_ref().map(Vec::len)),
            ("times", self.times.as_ref().map(Vec::len)),
            ("intensities", self.intensities.as_ref().map(Vec::len)),
        ];
        for (column, entries) in columns {
            if let Some(entries) = entries.filter(|&n| n != self.points.len()) {
                return Err(ScanError::Length {
                    scan: self.name.clone(),
                    column,
                    entries,
                    points: self.points.len(),
                });
            }
        }
        match self.motion {
            Some(m) if !(m.secs.is_finite() && m.secs != 0.0) => Err(ScanError::Motion {
                scan: self.name.clone(),
                secs: m.secs,
            }),
            _ => Ok(()),
        }
    }

    /// Removes returns that measure nothing, counting each by its reason in `dropped`; order is kept.
    pub fn drop_invalid(&mut self, limits: &RangeLimits) {
        let mut dropped = Dropped::default();
        let (near, far) = (limits.min_range_m.powi(2), limits.max_range_m.powi(2));
        let is_untimed = |i: usize| {
            let secs = self.times.as_ref().and_then(|times| times.get(i));
            secs.is_some_and(|secs| !secs.is_finite())
        };
        let is_valid = |p: &Vec3| {
            let r2 = p.length_squared();
            r2 > 0.0 && r2 >= near && r2 <= far && r2.is_finite()
        };
        if self.points.iter().all(is_valid) && (0..self.points.len()).all(|i| !is_untimed(i)) {
            return;
        }
        let keep: Vec<bool> = self
            .points
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let counter = match p.length_squared() {
                    _ if is_untimed(i) => &mut dropped.untimed,
                    _ if !p.is_finite() => &mut dropped.not_finite,
                    0.0 => &mut dropped.no_return,
                    r2 if r2 < near => &mut dropped.too_near,
                    r2 if r2 > far => &mut dropped.too_far,
                    _ => return true,
                };
                *counter += 1;
                false
            })
            .collect();
        self.dropped += dropped;
        if dropped.total() > 0 {
            self.keep_only(&keep);
        }
    }

    /// Keeps the points whose entry is true, in all columns.
    pub fn keep_only(&mut self, keep: &[bool]) {
        fn filter<T: Copy>(column: &mut Vec<T>, keep: &[bool]) {
            let mut keep = keep.iter();
            column.retain(|_| keep.next().copied().unwrap_or(false));
        }
        filter(&mut self.points, keep);
        self.rings.iter_mut().for_each(|c| filter(c, keep));
        self.times.iter_mut().for_each(|c| filter(c, keep));
        self.intensities.iter_mut().for_each(|c| filter(c, keep));
    }

    /// `world_from_sensor` at the moment of each return.
    pub fn poses(&self) -> impl Iterator<Item = Pose> {
        let trajectory = self.trajectory();
        (0..self.points.len()).map(move |i| {
            let secs = self.times.as_ref().and_then(|times| times.get(i));
            match (&trajectory, secs) {
                (Some(trajectory), Some(&secs)) => trajectory.at(f64::from(secs)),
                _ => self.pose,
            }
        })
    }

    /// All points in the world, each placed from where the sensor was when it measured it.
    pub fn points_in_world(&self) -> impl Iterator<Item = DVec3> + '_ {
        let placed = self.poses().zip(&self.points);
        placed.map(|(pose, point)| pose.transform_point(point.as_dvec3()))
    }

    /// The sensor's motion as a function of seconds after `pose`; `None` where all returns are placed from `pose`.
    pub fn trajectory(&self) -> Option<Trajectory> {
        let motion = self.motion.filter(|m| m.secs != 0.0 && self.times.is_some())?;
        Some(Trajectory {
            motion: Interpolation::new(self.pose, motion.pose),
            per_sec: 1.0 / motion.secs,
        })
    }
}

/// Where the sensor is at each moment of a scan.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory {
    motion: Interpolation,
    per_sec: f64,
}

impl Trajectory {
    /// The motion between two poses `secs` apart.
    pub fn new(from: Pose, to: &Motion) -> Self {
        Self {
            motion: Interpolation::new(from, to.pose),
            per_sec: 1.0 / to.secs,
        }
    }

    /// `world_from_sensor`, `secs` after the scan's pose.
    pub fn at(&self, secs: f64) -> Pose {
        self.motion.at(secs * self.per_sec)
    }

    /// Rotation of the sensor, and its translation relative to the scan's pose (exact far from the world's origin).
    pub fn relative_at(&self, secs: f64) -> (glam::DQuat, glam::DVec3) {
        let s = secs * self.per_sec;
        (self.motion.rotation_at(s), self.motion.shift_at(s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_returns_are_counted_by_reason() {
        let mut scan = Scan {
            points: vec![
                Vec3::new(1.0, 0.0, 0.0),
                Vec3::new(f32::NAN, 0.0, 0.0),
                Vec3::ZERO,
                Vec3::new(0.0, 0.1, 0.0),
                Vec3::new(0.0, 0.0, 999.0),
                Vec3::new(f32::INFINITY, 0.0, 0.0),
                Vec3::new(2.0, 0.0, 0.0),
            ],
            rings: Some((0..7).collect()),
            ..Default::default()
        };
        scan.drop_invalid(&RangeLimits::default());
        assert_eq!(
            scan.dropped,
            Dropped {
                not_finite: 2,
                no_return: 1,
                too_near: 1,
                too_far: 1,
                ..Default::default()
            }
        );
        assert_eq!(scan.points.len(), 2);
        assert_eq!(scan.rings, Some(vec![0, 6]));
    }

    #[test]
    fn returns_at_no_known_time_are_counted() {
        let mut scan = Scan {
            points: vec![Vec3::X, Vec3::Y, Vec3::NAN],
            times: Some(vec![f32::NAN, 0.0, f32::NAN]),
            ..Default::default()
        };
        scan.drop_invalid(&RangeLimits::default());
        assert_eq!((scan.dropped.untimed, scan.dropped.total()), (2, 2));
        assert_eq!((scan.points, scan.times), (vec![Vec3::Y], Some(vec![0.0])));
    }

    #[test]
    fn columns_of_other_length_are_refused() {
        let scan = Scan {
            points: vec![Vec3::X; 3],
            rings: Some(vec![0; 2]),
            ..Default::default()
        };
        assert_eq!(scan.check().unwrap_err().to_string(), ": 3 points but 2 rings");
    }
}
