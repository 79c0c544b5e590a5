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
pub(crate) fn rows_of_scans<T: Copy>(path: &Path, what: &str, rows: &[T], scans: &[ScanFile]) -> Result<Vec<T>> {
    if rows.len() == scans.len() {
        return Ok(rows.to_vec());
    }
    let by_number = || {
        scans
            .iter()
            .map(|s| rows.get(s.number()?).copied())
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    const IDENTITY: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n";

    fn poses(text: &str) -> Result<Poses, String> {
        parse(Path::new("poses.txt"), text.as_bytes()).map_err(|e| e.to_string())
    }

    fn scans(names: &[&str]) -> Vec<ScanFile> {
        let file = |name: &&str| ScanFile {
            path: name.into(),
            name: (*name).to_owned(),
        };
        names.iter().map(file).collect()
    }

    fn shift(x: f64) -> Pose {
        Pose {
            translation: DVec3::new(x, 0.0, 0.0),
            ..Pose::IDENTITY
        }
    }

    fn placed(poses: &Poses, names: &[&str], secs: Option<Vec<f64>>) -> Result<Vec<(f64, Option<f64>)>, String> {
        let placed = place(Path::new("poses.txt"), poses, &scans(names), secs).map_err(|e| e.to_string())?;
        Ok(placed
            .into_iter()
            .map(|(pose, secs)| (pose.translation.x, secs))
            .collect())
    }

    #[test]
    fn both_notations_are_told_apart() {
        assert_eq!(poses(&IDENTITY.repeat(2)), Ok(Poses::Listed(vec![Pose::IDENTITY; 2])));
        let timed = Poses::Timed(Trajectory {
            secs: vec![0.5, 1.5],
            poses: vec![shift(7.0), shift(8.0)],
        });
        let text = "\u{feff}# secs x y z qx qy qz qw\r\n\r\n0.5 7 0 0 0 0 0 1\r\n1.5, 8, 0, 0, 0, 0, 0, 1";
        assert_eq!(poses(text), Ok(timed));
    }

    #[test]
    fn every_error_names_the_line() {
        let seven = |bad: &str| poses(&(IDENTITY.repeat(6) + bad)).unwrap_err();
        for (bad, message) in [
            (
                "1 0 0 0 0 1 0 0 0 0 1",
                "line 7: 11 numbers where a pose has 12, as in the lines before",
            ),
            (
                "0 0 0 0 0 0 0 1",
                "line 7: 8 numbers where a pose has 12, as in the lines before",
            ),
            (
                "1 0 0 NaN 0 1 0 0 0 0 1 0",
                "line 7: the pose holds a number that is not finite",
            ),
            ("1 0 0 x 0 1 0 0 0 0 1 0", "line 7: \"x\" is not a number"),
            (
                "2 0 0 0 0 2 0 0 0 0 2 0",
                "line 7: the pose is not rigid: its 3x3 part is 3.00e0 away from a rotation",
            ),
        ] {
            assert_eq!(seven(bad), format!("poses.txt: {message}"));
        }
        let tum = "1 0 0 0 0 0 0 1\n";
        assert_eq!(
            poses(&tum.repeat(2)).unwrap_err(),
            "poses.txt: line 2: the time 1 is not later than that of the pose before"
        );
        assert!(
            poses("1 0 0 0 0 0 0 0")
                .unwrap_err()
                .contains("line 1: the pose is not rigid")
        );
        assert!(
            poses("inf 0 0 0 0 0 0 1")
                .unwrap_err()
                .contains("line 1: the time is not finite")
        );
        assert_eq!(poses("# nothing\n").unwrap_err(), "poses.txt: holds no poses");
        assert_eq!(
            parse(Path::new("p"), b"1 \xff").unwrap_err().to_string(),
            "p: is not text: byte 2 is not UTF-8"
        );
    }

    #[test]
    fn listed_poses_go_by_order_or_by_number() {
        let listed = Poses::Listed((0..4).map(|i| shift(f64::from(i))).collect());
        let x = |names: &[&str]| {
            Ok(placed(&listed, names, None)?
                .into_iter()
                .map(|p| p.0)
                .collect::<Vec<_>>())
        };
        assert_eq!(x(&["a", "b", "c", "d"]), Ok(vec![0.0, 1.0, 2.0, 3.0]));
        assert_eq!(x(&["7.bin", "8.bin", "9.bin", "10.bin"]), Ok(vec![0.0, 1.0, 2.0, 3.0]));
        assert_eq!(x(&["001.bin", "003.bin"]), Ok(vec![1.0, 3.0]));
        let refused: Result<Vec<f64>, String> = x(&["001.bin", "004.bin"]);
        assert_eq!(
            refused.unwrap_err(),
            "poses.txt: 4 poses for 2 scans, and the scans' names do not number them"
        );
        assert!(x(&["a", "1"]).is_err());
        assert!(
            x(&["0", "1", "2", "3", "4"])
                .unwrap_err()
                .contains("4 poses for 5 scans")
        );
    }

    #[test]
    fn timed_poses_are_interpolated_within_the_gap() {
        let trajectory = Trajectory {
            secs: vec![0.0, 0.2, 0.3, 2.0],
            poses: [0.0, 2.0, 3.0, 4.0].map(shift).to_vec(),
        };
        let timed = Poses::Timed(trajectory);
        let at = |secs: f64| placed(&timed, &["a.pcd"], Some(vec![secs])).map(|p| p[0].0);
        let near = |secs, x: f64| at(secs).is_ok_and(|got| (got - x).abs() < 1e-9);
        assert!(near(0.1, 1.0) && near(0.25, 2.5) && near(0.3, 3.0) && near(2.0, 4.0) && near(0.300_01, 3.0));
        assert_eq!(
            at(1.0).unwrap_err(),
            "poses.txt: no pose for a.pcd at 1.000000 s: its neighbours, at 0.300000 and 2.000000, are more than 0.2 s apart"
        );
        assert_eq!(
            at(2.5).unwrap_err(),
            "poses.txt: no pose for a.pcd at 2.500000 s: the poses run from 0.000000 to 2.000000 s"
        );
        // Scans that tell no time take them by order.
        let by_order = placed(&timed, &["0", "1", "2", "3"], None).unwrap();
        assert_eq!(by_order[2], (3.0, Some(0.3)));
        assert!(
            placed(&timed, &["0", "1"], None)
                .unwrap_err()
                .contains("4 poses with times for 2 scans without")
        );
    }

    #[test]
    fn the_pose_file_is_found_or_the_choice_is_left_to_the_user() {
        let dir = tempfile::tempdir().unwrap();
        let add = |name: &str| std::fs::write(dir.path().join(name), "").unwrap();
        let found = || find(dir.path()).map(|p| p.map(|p| p.file_name().unwrap().to_str().unwrap().to_owned()));
        assert_eq!(found().unwrap(), None);
        add("readme.txt");
        add("07.txt");
        assert_eq!(found().unwrap().as_deref(), Some("07.txt"));
        add("08.txt");
        assert!(
            found()
                .unwrap_err()
                .to_string()
                .ends_with("has several pose files, 07.txt and 08.txt: name the one to use")
        );
        add("00.poses_cam0.txt");
        assert_eq!(found().unwrap().as_deref(), Some("00.poses_cam0.txt"));
        add("poses.txt");
        assert_eq!(found().unwrap().as_deref(), Some("poses.txt"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(Path::new("p"), &bytes);
        }

        #[test]
        fn any_numbers_are_bearable(rows in prop::collection::vec(prop::collection::vec(any::<f64>(), 7..14), 0..5)) {
            let line = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
            let text = rows.iter().map(line).collect::<Vec<_>>().join("\n");
            let _ = parse(Path::new("p"), text.as_bytes());
        }
    }
}
