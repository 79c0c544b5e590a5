//! KITTI odometry: `velodyne/*.bin`, `calib.txt`, and poses of the left grey camera.
//!
//! Poses are looked for as `poses.txt` (SemanticKITTI) or another pose file in the folder, and as KITTI lays them out:
//! `../../poses/00.txt` for `sequences/00`. Scans may also lie in `../velodyne`. With P a pose of the camera and Tr the
//! line of `calib.txt`, `world_from_sensor = Tr⁻¹ · P · Tr`: the world is the scanner's frame where KITTI's is the camera's.

use std::path::{Path, PathBuf};

use crate::calib::KITTI_HDL64E_DEG;
use crate::error::Result;
use crate::files::{self, ScanFile};
use crate::folder::{self, ScanFolder};
use crate::source::OpenOptions;

/// Whether there is a `calib.txt` that tells of a laser scanner, and scans.
pub(crate) fn recognises(path: &Path) -> bool {
    // A broken calib.txt is recognised as well: opening it says what is wrong with it.
    !matches!(crate::calib::in_folder(path), Ok(None)) && scans(path).is_ok_and(|s| !s.is_empty())
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let scans = scans(path)?;
    let poses = folder::poses(path, options, &poses_by_sequence(path))?;
    Ok(ScanFolder::new("KITTI odometry", path, &scans, poses, options)?.with_usual_sensor("hdl64e", KITTI_HDL64E_DEG))
}

fn scans(path: &Path) -> Result<Vec<ScanFile>> {
    let here = files::list(&path.join("velodyne"), "bin")?;
    if here.is_empty() {
        return files::list(&path.join("../velodyne"), "bin");
    }
    Ok(here)
}

/// `poses/00.txt` for `sequences/00`.
fn poses_by_sequence(path: &Path) -> PathBuf {
    let name = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let name = name.file_name().unwrap_or_default().to_owned();
    path.join("../../poses").join(name).with_extension("txt")
}
