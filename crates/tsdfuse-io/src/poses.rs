//! Pose files, and which pose belongs to which scan.
//!
//! Two kinds of file are read, told apart by the numbers in a line: **KITTI** (12 numbers, the row-major 3×4 matrix
//! `[R | t]`) and **TUM** (8 numbers, `secs x y z qx qy qz qw`; also with ms, µs or ns since
//! 1970). Blank lines and lines that start with `#` are skipped.
//!
//! Which pose belongs to which scan:
//!
//! - KITTI poses go **by order**: as many poses as scans, the first for the first scan. Where there are more poses than
//!   scans and every scan is named by a number (`000012.bin`), they go **by number**: the 13th pose for scan 12.
//! - TUM poses go **by time**: a scan's time is in `times.txt` or `timestamps.txt`, or in its name (`12.345.pcd`,
//!   `1583836591_182590976.pcd`, or an integer since 1970 in s, ms, µs or ns). Its pose is interpolated between the poses
//!   before and after, which may be [`MAX_GAP_SECS`] apart. Scans without times take TUM poses by order, if there are
//!   as many of them as scans.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::pose::Interpolation;

use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::text::{self, Line};

/// The longest time between two poses of a trajectory that is interpolated over, seconds.
pub const MAX_GAP_SECS: f64 = 0.2;

/// A pose that is this near in time needs no second one, seconds.
const SAME_SECS: f64 = 1e-4;

/// The poses of a file.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// KITTI: poses without times.
    Listed(Vec<Pose>),
    /// TUM: poses with times.
    Timed(Trajectory),
}

/// Poses at increasing times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Seconds, strictly increasing; as long as `poses`.
    secs: Vec<f64>,
    poses: Vec<Pose>,
}

impl Poses {
    /// Applies `f` to each pose.
    pub fn map(&mut self, f: impl FnMut(&Pose) -> Pose) {
        let (Self::Listed(poses) | Self::Timed(Trajectory { poses, .. })) = self;
        *poses = poses.iter().map(f).collect();
    }

    fn len(&self) -> usize {
        match self {
            Self::Listed(poses) | Self::Timed(Trajectory { poses, .. }) => poses.len(),
        }
    }
}

impl Trajectory {
    /// The pose at `secs`, interpolated; or why there is none.
    pub(crate) fn at(&self, secs: f64) -> Result<Pose, String> {
        let after = self.secs.partition_point(|&t| t < secs);
        let side = |i: usize| Some((*self.secs.get(i)?, *self.poses.get(i)?));
        let (before, after) = (after.checked_sub(1).and_then(side), side(after));
        match (before, after) {
            (Some((t0, a)), Some((t1, b))) if t1 - t0 <= MAX_GAP_SECS => {
                return Ok(Interpolation::new(a, b).at((secs - t0) / (t1 - t0)));
            }
            _ => {}
        }
        let near = [before, after].into_iter().flatten();
        if let Some((_, pose)) = near.clone().find(|(t, _)| (t - secs).abs() <= SAME_SECS) {
            return Ok(pose);
        }
        let times: Vec<_> = near.map(|(t, _)| format!("{t:.6}")).collect();
        Err(match times.as_slice() {
            [_, _] => format!(
                "its neighbours, at {}, are more than {MAX_GAP_SECS} s apart",
                times.join(" and ")
            ),
            _ => format!(
                "the poses run from {:.6} to {:.6} s",
                self.secs.first().unwrap_or(&f64::NAN),
                self.secs.last().unwrap_or(&f64::NAN)
            ),
        })
    }
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
    match parse(path, &bytes)? {
        Poses::Listed(poses) | Poses::Timed(Trajectory { poses, .. }) => Ok(poses),
    }
}

/// Parses the content of a pose file; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Poses> {
    let mut listed = Vec::new();
    let mut timed = Trajectory::default();
    for line in text::lines(path, bytes)? {
        let numbers = line.numbers()?;
        match numbers.len() {
            12 if timed.poses.is_empty() => listed.push(matrix(&line, &numbers)?),
            8 if listed.is_empty() => {
                let (secs, pose) = tum(&line, &numbers)?;
                if timed.secs.last().is_some_and(|&last| last >= secs) {
                    return Err(line.error(format!("the time {secs} is not later than that of the pose before")));
                }
                timed.secs.push(secs);
                timed.poses.push(pose);
            }
            n => {
                let wanted = match (listed.len(), timed.secs.len()) {
                    (0, 0) => "12 (KITTI) or 8 (TUM)",
                    (_, 0) => "12, as in the lines before",
                    _ => "8, as in the lines before",
                };
                return Err(line.error(format!("{n} numbers where a pose has {wanted}")));
            }
        }
    }
    match (listed.len(), timed.secs.len()) {
        (0, 0) => Err(Error::format(path, "holds no poses")),
        (_, 0) => Ok(Poses::Listed(listed)),
        _ => Ok(Poses::Timed(timed)),
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

fn tum(line: &Line, numbers: &[f64]) -> Result<(f64, Pose)> {
    let &[secs, x, y, z, qx, qy, qz, qw] = numbers else {
        return Err(line.error("a TUM pose has 8 numbers"));
    };
    if !secs.is_finite() {
        return Err(line.error("the time is not finite"));
    }
    let pose = Pose::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z));
    Ok((
        files::epoch_secs(secs).unwrap_or(secs),
        pose.map_err(|e| line.error(e))?,
    ))
}

/// The pose file of a data set: `poses.txt`, `poses.tum`, another `*.tum`, `*poses*.txt`, `traj*.txt`, `groundtruth*.txt`,
/// or the name of a sequence, `00.txt`; the first kind of which there is one.
pub(crate) fn find(folder: &Path) -> Result<Option<PathBuf>> {
    type Kind = fn(&str) -> bool;
    let kinds: [Kind; 7] = [
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

/// Pose and time of each scan, see the [module](self); `path` is the poses' file and `secs` are the scans' times.
pub(crate) fn place(
    path: &Path,
    poses: &Poses,
    scans: &[ScanFile],
    secs: Option<Vec<f64>>,
) -> Result<Vec<(Pose, Option<f64>)>> {
    match (poses, secs) {
        (Poses::Listed(poses), None) => {
            let poses = rows_of_scans(path, "poses", poses, scans)?;
            Ok(poses.into_iter().map(|p| (p, None)).collect())
        }
        (Poses::Listed(poses), Some(secs)) => {
            let poses = rows_of_scans(path, "poses", poses, scans)?;
            Ok(poses.into_iter().zip(secs.into_iter().map(Some)).collect())
        }
        (Poses::Timed(trajectory), Some(secs)) => {
            let placed = scans.iter().zip(secs).map(|(scan, secs)| {
                let pose = trajectory
                    .at(secs)
                    .map_err(|why| Error::dataset(path, format!("no pose for {} at {secs:.6} s: {why}", scan.name)))?;
                Ok((pose, Some(secs)))
            });
            placed.collect()
        }
        (Poses::Timed(t), None) if t.poses.len() == scans.len() => {
            Ok(t.poses.iter().copied().zip(t.secs.iter().copied().map(Some)).collect())
        }
        (Poses::Timed(_), None) => {
            let (n, m) = (poses.len(), scans.len());
            let reason =
                format!("{n} poses with times for {m} scans without: their names hold none, nor does a times.txt");
            Err(Error::dataset(path, reason))
        }
    }
}

#[cfg(test)]
mod tests;
