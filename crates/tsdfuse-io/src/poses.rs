//! Pose files, and which pose belongs to which scan.
//!
//! Files are told apart by their content: **KITTI** (lines of 12 numbers, the row-major 3×4 matrix `[R | t]`), the same with a time
//! in front (13 numbers), **TUM** (8 numbers, `secs x y z qx qy qz qw`; also with ms, µs or ns since 1970), a table whose
//! first line names its columns, pose graphs of g2o, and SBET, whose records are binary. Blank lines and lines that start with `#` are skipped.
//!
//! Which pose belongs to which scan:
//!
//! - Poses without times go **by order**: as many poses as scans, the first for the first scan. Where there are more poses than
//!   scans and every scan is named by a number (`000012.bin`), they go **by number**: the 13th pose for scan 12.
//! - Poses with times go **by time**: a scan's time is in `times.txt` or `timestamps.txt`, or in its name (`12.345.pcd`,
//!   `1583836591_182590976.pcd`, or an integer since 1970 in s, ms, µs or ns). Its pose is interpolated between the poses
//!   before and after, which may be [`MAX_GAP_SECS`] apart. Scans without times take them by order, if there are
//!   as many of them as scans.

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::trajectory::secs_between;
pub use tsdfuse::trajectory::{MAX_GAP_SECS, Poses};
use tsdfuse::{Pose, Trajectory};

use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::g2o;
use crate::text::{self, Line};

mod sbet;
mod table;
mod write;

pub use write::{is_of_sensor, write, write_of_sensor, write_to};

/// The pose at a time, interpolated; or why there is none.
pub(crate) fn at(trajectory: &Trajectory, time_ns: i64) -> Result<Pose, String> {
    if let Some(pose) = trajectory.near(time_ns) {
        return Ok(pose);
    }
    let near = trajectory.neighbours(time_ns).into_iter().flatten();
    let times: Vec<_> = near.map(|(t, _)| format!("{:.6}", secs_between(0, t))).collect();
    let (first, last) = trajectory.span_ns();
    Err(match times.as_slice() {
        [_, _] => format!(
            "its neighbours, at {}, are more than {MAX_GAP_SECS} s apart",
            times.join(" and ")
        ),
        _ => format!(
            "the poses run from {:.6} to {:.6} s",
            secs_between(0, first),
            secs_between(0, last)
        ),
    })
}

/// Whether the trajectory tells the poses from one time to another without a gap.
pub(crate) fn covers(trajectory: &Trajectory, first_ns: i64, last_ns: i64) -> bool {
    let times = trajectory.times_ns();
    let from = times.partition_point(|&t| t <= first_ns).checked_sub(1);
    let to = times.partition_point(|&t| t < last_ns);
    from.and_then(|from| times.get(from..=to)).is_some_and(|times| {
        times
            .windows(2)
            .all(|pair| secs_between(pair[0], pair[1]) <= MAX_GAP_SECS)
    })
}

/// Reads a pose file.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn read(path: impl AsRef<Path>) -> Result<Poses> {
    let path = path.as_ref();
    parse(path, &files::read(path)?)
}

/// Reads all poses of a file, in their order: KITTI, TUM, or a single matrix of 3 or 4 lines with 4 numbers each.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn read_all(path: impl AsRef<Path>) -> Result<Vec<Pose>> {
    let path = path.as_ref();
    let bytes = files::read(path)?;
    let first = text::lines(path, &bytes)?.next().map(|line| line.numbers());
    if first.transpose()?.is_some_and(|numbers| numbers.len() == 4) {
        return Ok(vec![rows_of_4(path, &bytes)?]);
    }
    Ok(match parse(path, &bytes)? {
        Poses::Listed(poses) => poses,
        Poses::Timed(trajectory) => trajectory.poses().to_vec(),
    })
}

/// Parses the content of a pose file; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Poses> {
    if sbet::recognises(bytes) {
        return sbet::parse(path, bytes);
    }
    if let Some(header) = table::Header::find(bytes) {
        return header.parse(path, bytes);
    }
    if g2o::recognises(bytes) {
        return g2o::poses(path, bytes).map(Poses::Listed);
    }
    let mut listed = Vec::new();
    let mut timed: Vec<(i64, Pose)> = Vec::new();
    for line in text::lines(path, bytes)? {
        let numbers = line.numbers()?;
        match numbers.len() {
            12 if timed.is_empty() => listed.push(matrix(&line, &numbers)?),
            8 | 13 if listed.is_empty() => {
                let (time_ns, pose) = timed_pose(&line, &numbers)?;
                if timed.last().is_some_and(|&(last, _)| last >= time_ns) {
                    let secs = secs_between(0, time_ns);
                    return Err(line.error(format!("the time {secs} is not later than that of the pose before")));
                }
                timed.push((time_ns, pose));
            }
            n => {
                let wanted = match (listed.len(), timed.len()) {
                    (0, 0) => "12 (KITTI), 13 (with a time in front) or 8 (TUM)",
                    (_, 0) => "12, as in the lines before",
                    _ => "8, as in the lines before",
                };
                return Err(line.error(format!("{n} numbers where a pose has {wanted}")));
            }
        }
    }
    match (listed.len(), timed.len()) {
        (0, 0) => Err(Error::format(path, "holds no poses")),
        (_, 0) => Ok(Poses::Listed(listed)),
        _ => Trajectory::new(timed)
            .map(Poses::Timed)
            .map_err(|e| Error::format(path, e.to_string())),
    }
}

/// A single pose, one row of its matrix a line.
fn rows_of_4(path: &Path, bytes: &[u8]) -> Result<Pose> {
    let rows = text::lines(path, bytes)?.take(5).map(|line| line.numbers());
    let rows: Vec<Vec<f64>> = rows.collect::<Result<_>>()?;
    let is_last = |row: &Vec<f64>| row == &[0.0, 0.0, 0.0, 1.0];
    let numbers: Vec<f64> = rows.concat();
    match numbers.first_chunk() {
        Some(matrix) if rows.iter().all(|row| row.len() == 4) && rows.len() < 5 && rows[3..].iter().all(is_last) => {
            Pose::from_row_major_3x4(matrix).map_err(|e| Error::format(path, e.to_string()))
        }
        _ => Err(Error::format(
            path,
            "a matrix has 3 lines of 4 numbers, or 4 of which the last is 0 0 0 1",
        )),
    }
}

/// The pose of 12 numbers.
pub(crate) fn matrix(line: &Line, numbers: &[f64]) -> Result<Pose> {
    let numbers: &[f64; 12] = numbers
        .try_into()
        .map_err(|_| line.error(format!("{} numbers where a pose has 12", numbers.len())))?;
    Pose::from_row_major_3x4(numbers).map_err(|e| line.error(e))
}

/// A time, and after it a position and a quaternion or the 12 numbers of a matrix.
fn timed_pose(line: &Line, numbers: &[f64]) -> Result<(i64, Pose)> {
    let (secs, pose) = match numbers {
        &[secs, x, y, z, qx, qy, qz, qw] => {
            let pose = Pose::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z));
            (secs, pose.map_err(|e| line.error(e))?)
        }
        [secs, numbers @ ..] => (*secs, matrix(line, numbers)?),
        [] => return Err(line.error("a pose has 8 or 13 numbers")),
    };
    if !secs.is_finite() {
        return Err(line.error("the time is not finite"));
    }
    // From the text itself, which has more digits than a number of seconds since 1970.
    let time_ns = line.words().next().and_then(text::nanoseconds);
    let time_ns = time_ns.ok_or_else(|| line.error(format!("the time {secs} is too large")))?;
    Ok((time_ns, pose))
}

/// The pose file of a data set: `poses.txt`, `poses.tum`, another `*.tum`, `*poses*.txt`, `traj*.txt`, `groundtruth*.txt`,
/// the name of a sequence, `00.txt`, one of these as `.csv`, `*.sbet` or `sbet*.out`, or `*.g2o`; the first kind of which there is one.
pub(crate) fn find(folder: &Path) -> Result<Option<PathBuf>> {
    type Kind = fn(&str) -> bool;
    let kinds: [Kind; 10] = [
        |n| n == "poses.txt",
        |n| n == "poses.tum",
        |n| n.ends_with(".tum"),
        |n| n.contains("pose") && n.ends_with(".txt"),
        |n| n.starts_with("traj") && n.ends_with(".txt"),
        |n| (n.starts_with("groundtruth") || n.starts_with("ground_truth")) && n.ends_with(".txt"),
        |n| {
            n.strip_suffix(".txt")
                .is_some_and(|n| n.len() == 2 && n.bytes().all(|b| b.is_ascii_digit()))
        },
        |n| {
            n.ends_with(".csv")
                && ["pose", "traj", "groundtruth", "ground_truth"]
                    .iter()
                    .any(|word| n.contains(word))
        },
        |n| n.ends_with(".sbet") || n.starts_with("sbet") && n.ends_with(".out"),
        |n| n.ends_with(".g2o"),
    ];
    let names = files::names(folder)?;
    for kind in kinds {
        let found: Vec<_> = names.iter().filter(|n| kind(&n.to_ascii_lowercase())).collect();
        match found.as_slice() {
            [] => {}
            [name] => return Ok(Some(folder.join(name))),
            [a, b, ..] => {
                let reason = format!("has several pose files, {a} and {b}: name the one to use");
                return Err(Error::dataset(folder, reason));
            }
        }
    }
    Ok(None)
}

/// The row of a table (of poses or of times) for each scan: by order or by number, see the [module](self).
pub(crate) fn rows_of_scans<T: Clone>(path: &Path, what: &str, rows: &[T], scans: &[ScanFile]) -> Result<Vec<T>> {
    if rows.len() == scans.len() {
        return Ok(rows.to_vec());
    }
    let by_number = || {
        scans
            .iter()
            .map(|s| rows.get(s.number()?).cloned())
            .collect::<Option<Vec<_>>>()
    };
    let chosen = if rows.len() > scans.len() { by_number() } else { None };
    chosen.ok_or_else(|| {
        let reason = format!(
            "{} {what} for {} scans, and the scans' names do not number them",
            rows.len(),
            scans.len()
        );
        Error::dataset(path, reason)
    })
}

/// Pose and time of each scan, see the [module](self); `path` is the poses' file and `times_ns` are the scans' times.
pub(crate) fn place(
    path: &Path,
    poses: &Poses,
    scans: &[ScanFile],
    times_ns: Option<Vec<i64>>,
) -> Result<Vec<(Pose, Option<i64>)>> {
    match (poses, times_ns) {
        (Poses::Listed(poses), None) => {
            let poses = rows_of_scans(path, "poses", poses, scans)?;
            Ok(poses.into_iter().map(|p| (p, None)).collect())
        }
        (Poses::Listed(poses), Some(times_ns)) => {
            let poses = rows_of_scans(path, "poses", poses, scans)?;
            Ok(poses.into_iter().zip(times_ns.into_iter().map(Some)).collect())
        }
        (Poses::Timed(trajectory), Some(times_ns)) => {
            let placed = scans.iter().zip(times_ns).map(|(scan, time_ns)| {
                let pose = at(trajectory, time_ns).map_err(|why| {
                    let secs = secs_between(0, time_ns);
                    Error::dataset(path, format!("no pose for {} at {secs:.6} s: {why}", scan.name))
                })?;
                Ok((pose, Some(time_ns)))
            });
            placed.collect()
        }
        (Poses::Timed(t), None) if t.poses().len() == scans.len() => {
            let times = t.times_ns().iter().copied().map(Some);
            Ok(t.poses().iter().copied().zip(times).collect())
        }
        (Poses::Timed(_), None) => {
            let (n, m) = (poses.poses().len(), scans.len());
            let reason =
                format!("{n} poses with times for {m} scans without: their names hold none, nor does a times.txt");
            Err(Error::dataset(path, reason))
        }
    }
}

#[cfg(test)]
mod tests;
