//! The files that lie beside the scans: poses, motion, the sensor.

use std::path::{Path, PathBuf};

use tsdfuse::SensorModel;
use tsdfuse::scan::PoseAt;

use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::poses::{self, Poses};
use crate::sensor_file;
use crate::source::{OpenOptions, Sensor};
use crate::{calib, present, text};

/// The motion of each scan, where the file is there and says so.
pub(super) fn motions(path: &Path, files: &[ScanFile]) -> Result<Vec<Vec<PoseAt>>> {
    if !present::file(path)? {
        return Ok(vec![Vec::new(); files.len()]);
    }
    let rows = parse_motions(path, &files::read(path)?)?;
    poses::rows_of_scans(path, "lines", &rows, files)
}

/// Parses `motion.txt`; `path` is for messages.
///
/// # Errors
/// Names the file, the line and what is wrong.
pub(crate) fn parse_motions(path: &Path, bytes: &[u8]) -> Result<Vec<Vec<PoseAt>>> {
    text::lines(path, bytes)?.map(|line| motion(&line)).collect()
}

/// One line of `motion.txt`: seconds and a pose, as often as there are poses.
fn motion(line: &text::Line) -> Result<Vec<PoseAt>> {
    if line.text == "-" {
        return Ok(Vec::new());
    }
    let mut motion: Vec<PoseAt> = Vec::new();
    for numbers in line.numbers()?.chunks(1 + 12) {
        let (secs, pose) = match numbers.split_first() {
            Some((&secs, pose)) if secs.is_finite() && secs != 0.0 => (secs, poses::matrix(line, pose)?),
            _ => return Err(line.error("the seconds to a pose are zero or not finite")),
        };
        if motion.last().is_some_and(|last| last.secs >= secs) {
            return Err(line.error(format!("the pose at {secs} s is not later than the one before")));
        }
        motion.push(PoseAt { secs, pose });
    }
    Ok(motion)
}

/// The sensor: the model asked for, or that of `sensor.toml`, and where it sits on the body; and whether the file tells its errors.
pub(super) fn sensor(root: &Path, options: &OpenOptions) -> Result<(Sensor, bool)> {
    let path = options.sensor_file.clone().unwrap_or_else(|| root.join("sensor.toml"));
    let is_there = options.sensor_file.is_some() || present::file(&path)?;
    let told = is_there.then(|| sensor_file::read(&path));
    let told = told.transpose()?.unwrap_or_default();
    let mut model = told.model;
    match options.sensors.as_slice() {
        [] => {}
        [name] => {
            model = Some(tsdfuse::sensor::model(name).ok_or_else(|| {
                let known = tsdfuse::sensor::names().join(", ");
                Error::dataset(root, format!("there is no sensor model {name:?}; known are {known}"))
            })?);
        }
        [a, b, ..] => {
            let reason = format!("holds the scans of one sensor, which cannot be both {a:?} and {b:?}");
            return Err(Error::dataset(root, reason));
        }
    }
    let sensor = Sensor {
        body_from_sensor: options.extrinsics.or(told.body_from_sensor).unwrap_or_default(),
        correction: told.correction.clone().unwrap_or_default(),
        time_offset_s: told.time_offset_s,
        ..of_model(model)
    };
    Ok((sensor, told.correction.is_some()))
}

/// A sensor that is called after its model.
pub(super) fn of_model(model: Option<SensorModel>) -> Sensor {
    let name = model.as_ref().map_or("lidar", |model| model.name.as_str()).to_owned();
    Sensor {
        model,
        ..Sensor::new(name)
    }
}

/// Poses and the file they come from.
pub(crate) struct PoseFile {
    pub(crate) path: PathBuf,
    pub(crate) poses: Poses,
    /// For the user, if it should be known how they were read.
    pub(crate) note: Option<String>,
}

/// The poses asked for, or those found in the folder, or those `elsewhere`; `None` where there are none.
///
/// They are `world_from_sensor` (or `world_from_body`, where the sensor's extrinsics are told), unless a `calib.txt` with a
/// `Tr` lies in the folder or beside the pose file: then they are the camera's, P, and `world_from_sensor = Tr⁻¹ · P · Tr`.
/// Those of [`poses::write_of_sensor`] are `world_from_sensor` in any case.
pub(crate) fn poses(root: &Path, options: &OpenOptions, elsewhere: &Path) -> Result<Option<PoseFile>> {
    let found = match &options.poses {
        Some(path) => Some(path.clone()),
        None => match poses::find(root)? {
            None if present::file(elsewhere)? => Some(elsewhere.to_owned()),
            found => found,
        },
    };
    let Some(path) = found else { return Ok(None) };
    let mut poses = poses::read(&path)?;
    let beside = || calib::in_folder(path.parent().unwrap_or(Path::new("")));
    let calibration = if poses::is_of_sensor(&path) {
        None
    } else {
        calib::in_folder(root)?.map_or_else(beside, |tr| Ok(Some(tr)))?
    };
    if let Some(camera_from_sensor) = calibration {
        let sensor_from_camera = camera_from_sensor.inverse();
        poses.map(|pose| sensor_from_camera * *pose * camera_from_sensor);
    }
    let given_for_camera = options.poses.is_some() && calibration.is_some();
    Ok(Some(PoseFile {
        note: given_for_camera.then(|| {
            format!(
                "the poses of {} are taken as the camera's, by calib.txt",
                path.display()
            )
        }),
        path,
        poses,
    }))
}
