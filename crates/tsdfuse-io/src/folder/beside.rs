//! The files that lie beside the scans: poses, motion, the sensor.

use std::path::{Path, PathBuf};

use tsdfuse::SensorModel;
use tsdfuse::scan::PoseAt;

use crate::dataset::OpenOptions;
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::poses::{self, Poses};
use crate::{calib, text};

/// The motion of each scan, where the file is there and says so.
pub(super) fn motions(path: &Path, files: &[ScanFile]) -> Result<Vec<Vec<PoseAt>>> {
    if !path.is_file() {
        return Ok(vec![Vec::new(); files.len()]);
    }
    let bytes = files::read(path)?;
    let rows: Result<Vec<_>> = text::lines(path, &bytes)?
        .map(|line| {
            if line.text == "-" {
                return Ok(Vec::new());
            }
            let mut motion: Vec<PoseAt> = Vec::new();
            for numbers in line.numbers()?.chunks(1 + 12) {
                let (secs, pose) = match numbers.split_first() {
                    Some((&secs, pose)) if secs.is_finite() && secs != 0.0 => (secs, poses::matrix(&line, pose)?),
                    _ => return Err(line.error("the seconds to a pose are zero or not finite")),
                };
                if motion.last().is_some_and(|last| last.secs >= secs) {
                    return Err(line.error(format!("the pose at {secs} s is not later than the one before")));
                }
                motion.push(PoseAt { secs, pose });
            }
            Ok(motion)
        })
        .collect();
    poses::rows_of_scans(path, "lines", &rows?, files)
}

/// The sensor's model: the one asked for, or that of `sensor.toml`.
pub(super) fn sensor(root: &Path, options: &OpenOptions) -> Result<Option<SensorModel>> {
    if let Some(name) = &options.sensor {
        let model = tsdfuse::sensor::model(name).ok_or_else(|| {
            let known = tsdfuse::sensor::names().join(", ");
            Error::dataset(root, format!("there is no sensor model {name:?}; known are {known}"))
        })?;
        return Ok(Some(model));
    }
    let path = root.join("sensor.toml");
    path.is_file()
        .then(|| parse_sensor(&path, &files::read(&path)?))
        .transpose()
}

/// Parses `sensor.toml`; `path` is for messages.
///
/// # Errors
/// Names the file and what no sensor can have.
pub(crate) fn parse_sensor(path: &Path, bytes: &[u8]) -> Result<SensorModel> {
    let model: SensorModel = text::toml(path, bytes)?;
    model.check().map_err(|e| Error::format(path, e.to_string()))?;
    Ok(model)
}

/// Poses and the file they come from.
pub(crate) struct PoseFile {
    pub(crate) path: PathBuf,
    pub(crate) poses: Poses,
    /// For the user, if it should be known how they were read.
    pub(crate) note: Option<String>,
}

/// The poses asked for, or those found in the folder, or those `elsewhere`.
///
/// They are `world_from_sensor`, unless a `calib.txt` with a `Tr` lies in the folder or beside the pose file: then they
/// are the camera's, P, and `world_from_sensor = Tr⁻¹ · P · Tr`.
pub(crate) fn poses(root: &Path, options: &OpenOptions, elsewhere: &Path) -> Result<PoseFile> {
    let found = match &options.poses {
        Some(path) => Some(path.clone()),
        None => poses::find(root)?.or_else(|| elsewhere.is_file().then(|| elsewhere.to_owned())),
    };
    let path = found.ok_or_else(|| Error::dataset(root, "holds scans but no poses.txt or other pose file"))?;
    let mut poses = poses::read(&path)?;
    let beside = || calib::in_folder(path.parent().unwrap_or(Path::new("")));
    let calibration = calib::in_folder(root)?.map_or_else(beside, |tr| Ok(Some(tr)))?;
    if let Some(camera_from_sensor) = calibration {
        let sensor_from_camera = camera_from_sensor.inverse();
        poses.map(|pose| sensor_from_camera * *pose * camera_from_sensor);
    }
    let given_for_camera = options.poses.is_some() && calibration.is_some();
    Ok(PoseFile {
        note: given_for_camera.then(|| {
            format!(
                "the poses of {} are taken as the camera's, by calib.txt",
                path.display()
            )
        }),
        path,
        poses,
    })
}
