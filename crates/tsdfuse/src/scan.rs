//! One sweep of a sensor: returns in the sensor frame, and where the sensor was.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::pose::{Interpolation, Pose};
use crate::sensor::Pinhole;

/// One sweep (or one frame) of a range sensor.
///
/// Points are in the sensor frame (x forward, y left, z up, metres) **at the moment each was measured**. Where `times` and
/// `motion` are given, each return is placed from the sensor's pose at its own time, which undoes motion within the sweep
/// (deskewing); otherwise all returns are placed from `pose`.
///
/// The optional columns `rings`, `times` and `intensities` have one entry per point; [`Scan::check`] verifies that.
#[derive(Clone, Debug, Default)]
pub struct Scan {
    /// What messages call this scan: usually a file name.
    pub name: String,
    /// Nanoseconds since the log's epoch (1970 where the log gives absolute time), of `pose` and of time 0 of `times`.
    pub time_ns: Option<i64>,
    /// Returns in the sensor frame, metres. May hold invalid returns until [`Scan::drop_invalid`] has run.
    pub points: Vec<Vec3>,
    /// The laser of each return, 0 = lowest.
    pub rings: Option<Vec<u16>>,
    /// When each return was measured: seconds after `pose` (negative: before), NaN where that is not known.
    pub times: Option<Vec<f32>>,
    /// Intensity of each return, in the sensor's own unit.
    pub intensities: Option<Vec<f32>>,
    /// `world_from_sensor` at time 0. `None` where it is not known (yet): such a scan cannot be fused.
    pub pose: Option<Pose>,
    /// Further poses during the sweep, in order of time, none at time 0. Empty: the sensor stands still, or its motion is
    /// not known.
    pub motion: Vec<PoseAt>,
    /// The camera, where the scan is a depth image: each point lies on the ray through the centre of its pixel.
    pub camera: Option<Pinhole>,
    /// What the reader and [`Scan::drop_invalid`] left out so far.
    pub dropped: Dropped,
}

/// A pose of the sensor at another time of the sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseAt {
    /// Seconds after the scan's pose (negative: before it).
    pub secs: f64,
    /// `world_from_sensor` at that time.
    pub pose: Pose,
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
    /// Of something that moves, which is not to be fused.
    #[serde(default)]
    pub moving: u64,
}

impl Dropped {
    /// All of them.
    pub fn total(&self) -> u64 {
        let invalid = self.not_finite + self.no_return + self.too_near + self.too_far;
        invalid + self.other_sensor + self.masked + self.untimed + self.moving
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
        self.moving += other.moving;
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
        if self.min_range_m >= 0.0 && self.min_range_m < self.max_range_m {
            Ok(())
        } else {
            Err(RangeError(*self))
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
    /// Poses during the sweep have finite times that ascend and are not 0.
    #[error(
        "{scan}: a pose for motion compensation is {secs} s away from the scan's: such times must be finite, not 0, and ascend"
    )]
    Motion {
        /// The scan's name.
        scan: String,
        /// The time that is wrong.
        secs: f64,
    },
    /// Nobody knows where the sensor was.
    #[error("{scan}: has no pose, so it cannot be placed in the world")]
    NoPose {
        /// The scan's name.
        scan: String,
    },
}

impl Scan {
    /// Checks that the per-point columns agree in length and that the times of the motion ascend.
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
        let mut last = f64::NEG_INFINITY;
        for &PoseAt { secs, .. } in &self.motion {
            if !(secs.is_finite() && secs != 0.0 && secs > last) {
                let scan = self.name.clone();
                return Err(ScanError::Motion { scan, secs });
            }
            last = secs;
        }
        Ok(())
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

    /// Removes the returns whose entry is true: those of things that move. They are counted in `dropped`.
    pub fn drop_moving(&mut self, is_moving: &[bool]) {
        let keep: Vec<bool> = is_moving.iter().map(|is_moving| !is_moving).collect();
        let moving = is_moving.iter().filter(|is_moving| **is_moving).count();
        if moving > 0 {
            self.dropped.moving += moving as u64;
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

    /// `world_from_sensor` at time 0.
    ///
    /// # Errors
    /// [`ScanError::NoPose`] names the scan.
    pub fn world_from_sensor(&self) -> Result<Pose, ScanError> {
        self.pose.ok_or_else(|| ScanError::NoPose {
            scan: self.name.clone(),
        })
    }

    /// `world_from_sensor` at the moment of each return.
    ///
    /// # Errors
    /// [`ScanError::NoPose`] names the scan.
    pub fn poses(&self) -> Result<impl Iterator<Item = Pose>, ScanError> {
        let (pose, sweep) = (self.world_from_sensor()?, self.sweep());
        // Many returns in a row were measured at one time.
        let mut last = (f32::NAN, pose);
        Ok((0..self.points.len()).map(move |i| {
            let secs = self.times.as_ref().and_then(|times| times.get(i));
            match (&sweep, secs) {
                (Some(sweep), Some(&secs)) => {
                    if secs != last.0 {
                        last = (secs, sweep.at(f64::from(secs)));
                    }
                    last.1
                }
                _ => pose,
            }
        }))
    }

    /// All points in the world, each placed from where the sensor was when it measured it.
    ///
    /// # Errors
    /// [`ScanError::NoPose`] names the scan.
    pub fn points_in_world(&self) -> Result<impl Iterator<Item = DVec3>, ScanError> {
        let placed = self.poses()?.zip(&self.points);
        Ok(placed.map(|(pose, point)| pose.transform_point(point.as_dvec3())))
    }

    /// Moves each point to where the sensor would have seen it from `pose`, and forgets times and motion. A point whose time is not
    /// known becomes NaN where the sensor moved.
    pub fn undistort(&mut self) {
        if let (Some(sweep), Some(times)) = (self.sweep(), &self.times) {
            let scan_from_world = self.pose.unwrap_or_default().inverse();
            for (point, secs) in self.points.iter_mut().zip(times) {
                let seen = scan_from_world * sweep.at(f64::from(*secs));
                *point = if secs.is_finite() {
                    seen.transform_point(point.as_dvec3()).as_vec3()
                } else {
                    Vec3::NAN
                };
            }
        }
        (self.times, self.motion) = (None, Vec::new());
    }

    /// The sensor's motion as a function of seconds after `pose`; `None` where all returns are placed from `pose`, and where
    /// that is missing.
    pub fn sweep(&self) -> Option<Sweep> {
        let moves = !self.motion.is_empty() && self.times.is_some();
        self.pose.filter(|_| moves).map(|pose| Sweep::new(pose, &self.motion))
    }
}

/// Where the sensor is at each moment of a scan: at constant velocity from pose to pose, and beyond the outermost ones.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// In order of time; at least one.
    pieces: Vec<Piece>,
}

/// The motion between two neighbouring poses.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// It holds up to this time; the last one beyond it, too.
    until_secs: f64,
    /// From the pose nearer to time 0 to the other one.
    motion: Interpolation,
    /// The time of the pose nearer to time 0.
    from_secs: f64,
    per_sec: f64,
    /// From the scan's position to that of the pose nearer to time 0, metres.
    from_shift: DVec3,
}

impl Sweep {
    /// The motion through the scan's own pose and further ones, which are in order of time (see [`Scan::motion`]). Without
    /// further poses the sensor stands still.
    pub fn new(pose: Pose, motion: &[PoseAt]) -> Self {
        let own = PoseAt { secs: 0.0, pose };
        let piece = |from: PoseAt, to: PoseAt| Piece {
            until_secs: from.secs.max(to.secs),
            motion: Interpolation::new(from.pose, to.pose),
            from_secs: from.secs,
            per_sec: 1.0 / (to.secs - from.secs),
            // Adding −0 changes no number, not even the sign of a zero.
            from_shift: if from.secs == 0.0 {
                DVec3::splat(-0.0)
            } else {
                from.pose.translation - pose.translation
            },
        };
        let (before, after) = motion.split_at(motion.partition_point(|m| m.secs < 0.0));
        let mut pieces = Vec::with_capacity(motion.len().max(1));
        let ends = before.iter().copied().zip(before.iter().skip(1).copied().chain([own]));
        pieces.extend(ends.map(|(earlier, later)| piece(later, earlier)));
        let starts = [own].into_iter().chain(after.iter().copied());
        pieces.extend(starts.zip(after.iter().copied()).map(|(from, to)| piece(from, to)));
        if pieces.is_empty() {
            pieces.push(Piece {
                per_sec: 0.0,
                ..piece(own, own)
            });
        }
        Self { pieces }
    }

    /// The piece at a time, and how far along it that is.
    #[inline]
    fn piece(&self, secs: f64) -> (&Piece, f64) {
        let last = self.pieces.len() - 1;
        let piece = &self.pieces[self.pieces[..last].partition_point(|piece| piece.until_secs < secs)];
        (piece, (secs - piece.from_secs) * piece.per_sec)
    }

    /// `world_from_sensor`, `secs` after the scan's pose.
    pub fn at(&self, secs: f64) -> Pose {
        let (piece, s) = self.piece(secs);
        piece.motion.at(s)
    }

    /// Rotation of the sensor, and its translation relative to the scan's pose (exact far from the world's origin).
    #[inline]
    pub fn relative_at(&self, secs: f64) -> (glam::DQuat, DVec3) {
        let (piece, s) = self.piece(secs);
        (piece.motion.rotation_at(s), piece.from_shift + piece.motion.shift_at(s))
    }

    /// Seconds after the scan's pose at which the velocity changes: the times of all poses but the outermost ones.
    pub fn knots(&self) -> impl Iterator<Item = f64> {
        self.pieces[..self.pieces.len() - 1]
            .iter()
            .map(|piece| piece.until_secs)
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

    fn posed(x: f64, yaw: f64) -> Pose {
        Pose {
            rotation: glam::DQuat::from_rotation_z(yaw),
            translation: DVec3::new(1e6 + x, -3e5, 0.0),
        }
    }

    /// With one further pose, the bits of the plain formula; also before time 0 and beyond the pose.
    #[test]
    fn two_poses_are_one_straight_motion() {
        for secs in [0.1, -0.1] {
            let (a, b) = (posed(0.0, 0.2), posed(0.7, -0.3));
            let sweep = Sweep::new(a, &[PoseAt { secs, pose: b }]);
            let plain = Interpolation::new(a, b);
            for t in [-0.25, -0.05, -0.0, 0.0, 0.033, 0.1, 0.17] {
                let s = t * (1.0 / secs);
                assert_eq!(sweep.at(t), plain.at(s));
                let (rotation, shift) = sweep.relative_at(t);
                assert_eq!(rotation, plain.rotation_at(s));
                assert_eq!(
                    shift.to_array().map(f64::to_bits),
                    plain.shift_at(s).to_array().map(f64::to_bits)
                );
            }
        }
    }

    #[test]
    fn a_sweep_meets_each_of_its_poses_and_goes_on_beyond_them() {
        let motion = [(-0.2, -3.0, 0.4), (-0.1, -1.0, 0.1), (0.05, 1.0, -0.2), (0.1, 3.0, 0.3)];
        let motion = motion.map(|(secs, x, yaw)| PoseAt {
            secs,
            pose: posed(x, yaw),
        });
        let own = posed(0.0, 0.0);
        let sweep = Sweep::new(own, &motion);
        for PoseAt { secs, pose } in motion.into_iter().chain([PoseAt { secs: 0.0, pose: own }]) {
            let (at, (rotation, shift)) = (sweep.at(secs), sweep.relative_at(secs));
            assert!(at.translation.distance(pose.translation) < 1e-9, "{secs}");
            assert!(
                at.rotation.angle_between(pose.rotation) < 1e-7 && rotation == at.rotation,
                "{secs}"
            );
            assert!(shift.distance(pose.translation - own.translation) < 1e-9, "{secs}");
        }
        for (secs, x) in [
            (-0.15, -2.0),
            (-0.05, -0.5),
            (0.025, 0.5),
            (0.075, 2.0),
            (-0.3, -5.0),
            (0.15, 5.0),
        ] {
            assert!((sweep.relative_at(secs).1.x - x).abs() < 1e-9, "{secs}");
        }
        assert_eq!(sweep.knots().collect::<Vec<_>>(), [-0.1, 0.0, 0.05]);
        let still = Sweep::new(own, &[]);
        assert_eq!((still.at(9.0), still.knots().count()), (own, 0));
    }

    #[test]
    fn a_scan_without_a_pose_has_no_place() {
        let scan = Scan {
            name: "a.pcd".into(),
            points: vec![Vec3::X],
            ..Default::default()
        };
        assert_eq!(scan.check(), Ok(()));
        let told = scan.points_in_world().err().map(|e| e.to_string());
        assert_eq!(
            told.as_deref(),
            Some("a.pcd: has no pose, so it cannot be placed in the world")
        );
        assert!(scan.poses().is_err() && scan.sweep().is_none());
    }

    #[test]
    fn times_of_poses_must_ascend() {
        let of = |secs: &[f64]| Scan {
            motion: secs
                .iter()
                .map(|&secs| PoseAt {
                    secs,
                    pose: Pose::IDENTITY,
                })
                .collect(),
            ..Default::default()
        };
        assert_eq!(of(&[-0.1, 0.1, 0.2]).check(), Ok(()));
        for wrong in [&[0.0][..], &[f64::NAN], &[f64::INFINITY], &[0.2, 0.1], &[0.1, 0.1]] {
            assert!(matches!(of(wrong).check(), Err(ScanError::Motion { .. })), "{wrong:?}");
        }
    }
}
