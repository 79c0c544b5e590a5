//! MulRan: one sequence, `sensor_data/Ouster/*.bin` (or `Ouster/*.bin`) with `global_pose.csv`.
//!
//! Scans are named by their time in nanoseconds, the begin of the sweep. A whole scan has 64 points for each of 1024 columns, in the
//! order in which they were measured, which tells their times; some scans of the data set are not whole and get none. Poses are those
//! of the vehicle (time and 12 numbers); the makers' calibration tells where the scanner sits.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3, EulerRot};

use crate::bin;
use crate::cloud::Cloud;
use crate::error::Result;
use crate::files;
use crate::folder::{self, ScanFolder};
use crate::source::OpenOptions;

const ROWS: usize = 64;
const COLUMNS: usize = 1024;
const SWEEP_SECS: f64 = 0.1;

/// Whether there are an Ouster's scans and MulRan's tables.
pub(crate) fn recognises(path: &Path) -> bool {
    let has_tables = ["global_pose.csv", "data_stamp.csv", "sensor_data/data_stamp.csv"];
    scans_folder(path).is_some() && has_tables.iter().any(|name| path.join(name).is_file())
}

fn scans_folder(path: &Path) -> Option<PathBuf> {
    let folders = ["sensor_data/Ouster", "Ouster"].map(|name| path.join(name));
    folders
        .into_iter()
        .find(|folder| files::list(folder, "bin").is_ok_and(|scans| !scans.is_empty()))
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let scans = files::list(&scans_folder(path).unwrap_or_default(), "bin")?;
    let poses = folder::poses(path, options, &path.join("global_pose.csv"))?;
    let (scans, left_out) = folder::covered(path, scans, poses.as_ref())?;
    let options = OpenOptions {
        extrinsics: Some(options.extrinsics.unwrap_or_else(base_from_ouster)),
        ..options.clone()
    };
    let log = ScanFolder::new("MulRan", path, &scans, poses, &options)?;
    Ok(log
        .with_reader(cloud)
        .with_usual_sensor("os1-64-gen1", 0.0)
        .without(left_out))
}

/// From the makers' `calib_base2ouster.txt`: metres, and angles about x, y, z in degrees.
fn base_from_ouster() -> Pose {
    let [roll, pitch, yaw] = [0.0001, 0.0003, 179.6654].map(f64::to_radians);
    Pose {
        rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
        translation: DVec3::new(1.7042, -0.021, 1.8047),
    }
}

fn cloud(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let mut cloud = bin::parse(path, bytes)?;
    if cloud.points.len() == ROWS * COLUMNS {
        let points = 0..cloud.points.len();
        cloud.secs = Some(
            points
                .clone()
                .map(|i| (i / ROWS) as f64 * SWEEP_SECS / COLUMNS as f64)
                .collect(),
        );
        let mut rings: Vec<u16> = points.map(|i| (i % ROWS) as u16).collect();
        tsdfuse::sensor::sort_rings(&cloud.points, &mut rings);
        cloud.rings = Some(rings);
    }
    Ok(cloud)
}
