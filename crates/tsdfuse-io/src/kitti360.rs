//! KITTI-360: one drive, `data_3d_raw/NAME/velodyne_points/data/*.bin`, with `data_poses/NAME/poses.txt` and `calibration/` of the data set.
//!
//! `poses.txt` has a line for each frame that has a pose: its number, and the 12 numbers of `world_from_imu`. Frames without a pose
//! (the vehicle hardly moved, or GPS was bad) are left out. With the first camera of `calib_cam_to_pose.txt` and
//! `calib_cam_to_velo.txt`, `imu_from_velodyne = imu_from_cam0 · (velodyne_from_cam0)⁻¹`. The points are as they were measured, without times.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;

use crate::calib::KITTI_HDL64E_DEG;
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::folder::{self, PoseFile, ScanFolder};
use crate::poses::{self, Poses};
use crate::source::OpenOptions;
use crate::{calib, present, text};

/// Whether it is a drive whose data set has KITTI-360's calibration.
pub(crate) fn recognises(path: &Path) -> bool {
    path.join("velodyne_points/data").is_dir() && data_set(path).join("calibration/calib_cam_to_velo.txt").is_file()
}

/// The data set's folder, of a drive in `data_3d_raw`.
fn data_set(path: &Path) -> PathBuf {
    path.join("../..")
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let velodyne = path.join("velodyne_points");
    let mut scans = files::list(&velodyne.join("data"), "bin")?;
    let all = scans.len();
    let poses = match &options.poses {
        Some(_) => folder::poses(&velodyne, options, Path::new(""))?,
        None => poses_by_number(path, &mut scans)?,
    };
    let options = OpenOptions {
        extrinsics: Some(options.extrinsics.map_or_else(|| imu_from_velodyne(path), Ok)?),
        ..options.clone()
    };
    let mut log =
        ScanFolder::new("KITTI-360", &velodyne, &scans, poses, &options)?.with_usual_sensor("hdl64e", KITTI_HDL64E_DEG);
    if scans.len() < all {
        log.note(format!(
            "{} of {all} scans have no pose and are left out",
            all - scans.len()
        ));
    }
    Ok(log)
}

/// `world_from_imu` of the scans that have one; the others are removed.
fn poses_by_number(path: &Path, scans: &mut Vec<ScanFile>) -> Result<Option<PoseFile>> {
    let name = std::fs::canonicalize(path).map_err(Error::io(path))?;
    let file = data_set(path)
        .join("data_poses")
        .join(files::name(&name))
        .join("poses.txt");
    if !present::file(&file)? {
        return Ok(None);
    }
    let numbered = parse(&file, &files::read(&file)?)?;
    let pose = |scan: &ScanFile| {
        let place = numbered
            .binary_search_by_key(&scan.number()?, |(number, _)| *number)
            .ok()?;
        Some(numbered[place].1)
    };
    scans.retain(|scan| pose(scan).is_some());
    if scans.is_empty() {
        return Err(Error::dataset(&file, "has no pose for any scan"));
    }
    Ok(Some(PoseFile {
        poses: Poses::Listed(scans.iter().filter_map(pose).collect()),
        path: file,
        note: None,
    }))
}

/// Parses `poses.txt`: numbers of frames, ascending, and poses; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<(usize, Pose)>> {
    let mut numbered: Vec<(usize, Pose)> = Vec::new();
    for line in text::lines(path, bytes)? {
        let numbers = line.numbers()?;
        let number = line.words().next().and_then(|word| word.parse().ok());
        let number = number.ok_or_else(|| line.error("does not begin with the number of a frame"))?;
        if numbered.last().is_some_and(|(last, _)| *last >= number) {
            return Err(line.error(format!("frame {number} is not after the one before")));
        }
        numbered.push((number, poses::matrix(&line, &numbers[1..])?));
    }
    Ok(numbered)
}

fn imu_from_velodyne(path: &Path) -> Result<Pose> {
    let calibration = data_set(path).join("calibration");
    let file = calibration.join("calib_cam_to_velo.txt");
    let velodyne_from_camera = single(&file)?;
    let file = calibration.join("calib_cam_to_pose.txt");
    let imu_from_camera = calib::parse(&file, &files::read(&file)?, "image_00")?;
    let imu_from_camera = imu_from_camera.ok_or_else(|| Error::format(&file, "has no line image_00"))?;
    Ok(imu_from_camera * velodyne_from_camera.inverse())
}

fn single(path: &Path) -> Result<Pose> {
    match poses::read_all(path)?.as_slice() {
        [pose] => Ok(*pose),
        poses => Err(Error::format(
            path,
            format!("{} poses where one was expected", poses.len()),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_numbers() {
        let read = |text: &str| parse(Path::new("poses.txt"), text.as_bytes()).map_err(|e| e.to_string());
        let poses = read("1 1 0 0 5 0 1 0 0 0 0 1 0\n4 1 0 0 6 0 1 0 0 0 0 1 0\n").unwrap();
        let at: Vec<_> = poses
            .iter()
            .map(|(number, pose)| (*number, pose.translation.x))
            .collect();
        assert_eq!(at, [(1, 5.0), (4, 6.0)]);
        for (bad, wanted) in [
            (
                "1.5 1 0 0 5 0 1 0 0 0 0 1 0",
                "line 1: does not begin with the number of a frame",
            ),
            ("1 1 0 0", "line 1: 3 numbers where a pose has 12"),
            (
                "2 1 0 0 5 0 1 0 0 0 0 1 0\n2 1 0 0 5 0 1 0 0 0 0 1 0",
                "line 2: frame 2 is not after",
            ),
        ] {
            let message = read(bad).unwrap_err();
            assert!(message.contains(wanted), "{message}");
        }
    }
}
