//! The Newer College Dataset (2020): one sequence, `raw_format/ouster_scan/*.pcd` with `ground_truth/registered_poses.csv`.
//!
//! (Its bags, and those of 2021, are read as bags, with the ground truth named by `--poses`.) The poses are those of the left camera's
//! base; the makers' calibration tells where the Ouster sits on it.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};

use crate::error::Result;
use crate::files;
use crate::folder::{self, ScanFolder};
use crate::source::OpenOptions;

/// Whether there are scans as in a sequence.
pub(crate) fn recognises(path: &Path) -> bool {
    files::list(&scans_folder(path), "pcd").is_ok_and(|scans| !scans.is_empty())
}

fn scans_folder(path: &Path) -> PathBuf {
    path.join("raw_format/ouster_scan")
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let scans = files::list(&scans_folder(path), "pcd")?;
    let poses = folder::poses(path, options, &path.join("ground_truth/registered_poses.csv"))?;
    let (scans, left_out) = folder::covered(path, scans, poses.as_ref())?;
    let options = OpenOptions {
        extrinsics: Some(options.extrinsics.unwrap_or_else(base_from_ouster)),
        ..options.clone()
    };
    let log = ScanFolder::new("Newer College", path, &scans, poses, &options)?;
    Ok(log.with_usual_sensor("os1-64-gen1", 0.0).without(left_out))
}

fn base_from_ouster() -> Pose {
    Pose {
        rotation: DQuat::from_xyzw(0.0, 0.0, 0.924, 0.383).normalize(),
        translation: DVec3::new(-0.084, -0.025, 0.050),
    }
}
