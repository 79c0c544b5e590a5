//! Writes pose files that [`read`](super::read) reads.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use tsdfuse::Pose;

use super::Poses;
use crate::atomic;
use crate::error::{Error, Result};

/// Writes poses to a file, which appears when it is complete: those with times as TUM, the others as KITTI.
///
/// Times and positions come back bit for bit, rotations up to rounding (1e-15).
///
/// # Errors
/// Names the file, and the pose that holds a number that is not finite, or what the system says.
///
/// # Examples
/// ```
/// use tsdfuse::{Pose, Trajectory};
/// use tsdfuse_io::poses::{self, Poses};
///
/// # let dir = tempfile::tempdir()?;
/// let path = dir.path().join("drive.tum");
/// let drive = Poses::Timed(Trajectory::new(vec![(1_583_836_591_182_590_976, Pose::IDENTITY)])?);
/// poses::write(&path, &drive)?;
/// assert_eq!(std::fs::read_to_string(&path)?, "1583836591.182590976 0 0 0 0 0 0 1\n");
/// assert_eq!(poses::read(&path)?, drive);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(path: impl AsRef<Path>, poses: &Poses) -> Result<()> {
    write_after(path.as_ref(), "", poses)
}

/// The first line of a file of poses of the sensor itself.
const OF_SENSOR: &str = "# world_from_sensor: poses of the sensor, not of a body that carries it\n";

/// As [`write()`], for poses of a sensor, at times of its own clock, which a log may know to sit on a body: a first line, which other
/// readers take for a comment, says so, and [`open_with`](crate::open_with) moves such poses by no extrinsics and no time offset.
///
/// # Errors
/// As [`write()`].
pub fn write_of_sensor(path: impl AsRef<Path>, poses: &Poses) -> Result<()> {
    write_after(path.as_ref(), OF_SENSOR, poses)
}

/// Whether a file was written by [`write_of_sensor`]. What cannot be read was not.
pub fn is_of_sensor(path: impl AsRef<Path>) -> bool {
    let mut begin = [0; OF_SENSOR.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut begin));
    read.is_ok() && begin == *OF_SENSOR.as_bytes()
}

fn write_after(path: &Path, first_line: &str, poses: &Poses) -> Result<()> {
    let is_finite = |pose: &Pose| pose.rotation.is_finite() && pose.translation.is_finite();
    let all = match poses {
        Poses::Listed(poses) => poses.as_slice(),
        Poses::Timed(trajectory) => trajectory.poses(),
    };
    if let Some(bad) = all.iter().position(|pose| !is_finite(pose)) {
        let reason = format!("pose {bad} holds a number that is not finite: it is not written");
        return Err(Error::format(path, reason));
    }
    atomic::write(path, |out| {
        out.write_all(first_line.as_bytes())?;
        write_to(out, poses)
    })
}

/// Writes poses: those with times as TUM, the others as KITTI.
///
/// # Errors
/// What the system says.
pub fn write_to(mut out: impl Write, poses: &Poses) -> io::Result<()> {
    match poses {
        Poses::Listed(poses) => poses
            .iter()
            .try_for_each(|pose| writeln!(out, "{}", joined(&pose.to_row_major_3x4()))),
        Poses::Timed(trajectory) => {
            let mut timed = trajectory.times_ns().iter().zip(trajectory.poses());
            timed.try_for_each(|(&time_ns, pose)| {
                let (t, q) = (pose.translation, pose.rotation);
                let numbers = joined(&[t.x, t.y, t.z, q.x, q.y, q.z, q.w]);
                writeln!(out, "{} {numbers}", secs(time_ns))
            })
        }
    }
}

/// Seconds with nine digits after the point: exact.
fn secs(time_ns: i64) -> String {
    let sign = if time_ns < 0 { "-" } else { "" };
    let ns = time_ns.unsigned_abs();
    format!("{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
}

/// The numbers with as many digits (up to 17) as it takes to read the same ones.
fn joined(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use tsdfuse::Trajectory;
    use tsdfuse::glam::{DQuat, DVec3};

    use super::*;

    fn any_pose() -> impl Strategy<Value = Pose> {
        (prop::array::uniform4(-1.0..1.0f64), prop::array::uniform3(-1e7..1e7f64)).prop_filter_map("zero", |(q, t)| {
            let q = DQuat::from_array(q);
            (q.length() > 0.1).then(|| Pose {
                rotation: q.normalize(),
                translation: DVec3::from(t),
            })
        })
    }

    /// Written and read again.
    fn again(poses: &Poses) -> Poses {
        let mut bytes = Vec::new();
        write_to(&mut bytes, poses).unwrap();
        crate::poses::parse(Path::new("poses"), &bytes).unwrap()
    }

    fn check(read: &[Pose], written: &[Pose]) {
        assert_eq!(read.len(), written.len());
        for (a, b) in read.iter().zip(written) {
            assert_eq!(a.translation, b.translation);
            let turn = if a.rotation.dot(b.rotation) < 0.0 {
                -a.rotation
            } else {
                a.rotation
            };
            assert!((turn - b.rotation).length() < 2e-15, "{a:?} {b:?}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            poses in prop::collection::vec(any_pose(), 1..20),
            times in prop::collection::btree_set(any::<i64>(), 20),
        ) {
            let Poses::Listed(read) = again(&Poses::Listed(poses.clone())) else { unreachable!() };
            check(&read, &poses);
            let written = Trajectory::new(times.into_iter().zip(poses).collect()).unwrap();
            let Poses::Timed(read) = again(&Poses::Timed(written.clone())) else { unreachable!() };
            prop_assert_eq!(read.times_ns(), written.times_ns());
            check(read.poses(), written.poses());
        }
    }

    #[test]
    fn times_are_exact() {
        for (ns, text) in [
            (0, "0.000000000"),
            (-1, "-0.000000001"),
            (-1_500_000_000, "-1.500000000"),
            (1_583_836_591_182_590_976, "1583836591.182590976"),
            (i64::MIN, "-9223372036.854775808"),
        ] {
            assert_eq!(secs(ns), text);
        }
    }

    #[test]
    fn what_could_not_be_read_is_not_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("poses.txt");
        let mut poses = vec![Pose::IDENTITY; 2];
        poses[1].translation.y = f64::NAN;
        let told = write(&path, &Poses::Listed(poses)).unwrap_err().to_string();
        assert!(
            told.ends_with("poses.txt: pose 1 holds a number that is not finite: it is not written"),
            "{told}"
        );
        assert!(!path.exists());
    }
}
