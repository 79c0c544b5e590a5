//! `sensor.toml`: a sensor's model, where it sits, and its systematic errors; each of them may be missing.
//!
//! - the model ([`SensorModel`]): `name`, `elevations_deg`, `columns`, `min_range_m` and `max_range_m`,
//! - `body_from_sensor`: the 12 numbers of where the sensor sits on the body whose poses are used,
//! - the errors to correct ([`SensorCorrection`]): `elevation_correction_deg`, `range_correction_m`, and for each ring
//!   `[[beam_corrections]]` with `elevation_deg`, `azimuth_deg` and `range_m`,
//! - `time_offset_s`: a scan at time t has the pose of t + `time_offset_s`, where the clock of the poses differs from the sensor's.

use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tsdfuse::sensor::{BeamCorrection, SensorCorrection};
use tsdfuse::{Pose, SensorModel};

use crate::error::{Error, Result};
use crate::source::Sensor;
use crate::{atomic, files, text};

/// What `sensor.toml` tells.
#[derive(Debug, Default)]
pub(crate) struct SensorFile {
    pub(crate) model: Option<SensorModel>,
    pub(crate) body_from_sensor: Option<Pose>,
    pub(crate) correction: Option<SensorCorrection>,
    pub(crate) time_offset_s: Option<f64>,
}

/// A larger difference between two clocks is none, seconds.
const MAX_TIME_OFFSET_S: f64 = 10.0;

/// A `sensor.toml` with a model.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WithModel {
    name: String,
    elevations_deg: Vec<f32>,
    columns: u32,
    min_range_m: f32,
    max_range_m: f32,
    body_from_sensor: Option<[f64; 12]>,
    elevation_correction_deg: Option<f64>,
    range_correction_m: Option<f64>,
    beam_corrections: Option<Vec<BeamCorrection>>,
    time_offset_s: Option<f64>,
}

/// A `sensor.toml` without a model.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WithoutModel {
    body_from_sensor: Option<[f64; 12]>,
    elevation_correction_deg: Option<f64>,
    range_correction_m: Option<f64>,
    beam_corrections: Option<Vec<BeamCorrection>>,
    time_offset_s: Option<f64>,
}

/// Parses `sensor.toml`: the model, where the sensor sits and what its errors are; each of them may be missing. `path` is for
/// messages.
///
/// # Errors
/// Names the file and what no sensor can have.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<SensorFile> {
    if let Ok(told) = text::toml::<WithoutModel>(path, bytes) {
        let told = told.checked(path)?;
        if told.body_from_sensor.is_some() || told.correction.is_some() || told.time_offset_s.is_some() {
            return Ok(told);
        }
    }
    let told: WithModel = text::toml(path, bytes)?;
    let model = SensorModel {
        name: told.name,
        elevations_deg: told.elevations_deg,
        columns: told.columns,
        min_range_m: told.min_range_m,
        max_range_m: told.max_range_m,
    };
    model.check().map_err(|e| Error::format(path, e.to_string()))?;
    let besides = WithoutModel {
        body_from_sensor: told.body_from_sensor,
        elevation_correction_deg: told.elevation_correction_deg,
        range_correction_m: told.range_correction_m,
        beam_corrections: told.beam_corrections,
        time_offset_s: told.time_offset_s,
    };
    Ok(SensorFile {
        model: Some(model),
        ..besides.checked(path)?
    })
}

impl WithoutModel {
    fn checked(self, path: &Path) -> Result<SensorFile> {
        let pose = |numbers: [f64; 12]| {
            let pose = Pose::from_row_major_3x4(&numbers);
            pose.map_err(|e| Error::format(path, format!("body_from_sensor: {e}")))
        };
        let is_told = self.elevation_correction_deg.is_some()
            || self.range_correction_m.is_some()
            || self.beam_corrections.is_some();
        let correction = SensorCorrection {
            elevation_deg: self.elevation_correction_deg.unwrap_or_default(),
            range_m: self.range_correction_m.unwrap_or_default(),
            beams: self.beam_corrections.unwrap_or_default(),
        };
        correction.check().map_err(|e| Error::format(path, e.to_string()))?;
        if let Some(secs) = self.time_offset_s
            && !(secs.abs() <= MAX_TIME_OFFSET_S)
        {
            let reason =
                format!("time_offset_s: clocks that are {secs} s apart: at most {MAX_TIME_OFFSET_S} s are possible");
            return Err(Error::format(path, reason));
        }
        Ok(SensorFile {
            model: None,
            body_from_sensor: self.body_from_sensor.map(pose).transpose()?,
            correction: is_told.then_some(correction),
            time_offset_s: self.time_offset_s,
        })
    }
}

/// A sensor as its file has it.
#[derive(Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    model: Option<&'a SensorModel>,
    #[serde(skip_serializing_if = "Option::is_none")]
    body_from_sensor: Option<[f64; 12]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_offset_s: Option<f64>,
    #[serde(flatten)]
    correction: &'a SensorCorrection,
}

/// Reads `sensor.toml`.
///
/// # Errors
/// Names the file and what no sensor can have.
pub(crate) fn read(path: &Path) -> Result<SensorFile> {
    parse(path, &files::read(path)?)
}

/// Writes what is known of a sensor, for [`OpenOptions::sensor_file`](crate::OpenOptions::sensor_file) or beside a folder's scans.
///
/// # Errors
/// If the file cannot be written.
pub fn write(path: &Path, sensor: &Sensor) -> Result<()> {
    let written = Written {
        model: sensor.model.as_ref(),
        body_from_sensor: (sensor.body_from_sensor != Pose::IDENTITY)
            .then(|| sensor.body_from_sensor.to_row_major_3x4()),
        time_offset_s: sensor.time_offset_s,
        correction: &sensor.correction,
    };
    let text = toml::to_string(&written).map_err(|e| Error::format(path, e.to_string()))?;
    atomic::write(path, |file| file.write_all(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use tsdfuse::glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let path = tempfile::tempdir().unwrap().path().join("sensor.toml");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let beam = BeamCorrection {
            range_m: -0.01,
            ..BeamCorrection::default()
        };
        for model in [None, tsdfuse::sensor::model("vlp16")] {
            for body_from_sensor in [
                Pose::IDENTITY,
                Pose::new(DQuat::from_rotation_z(0.5), DVec3::X).unwrap(),
            ] {
                for beams in [vec![], vec![beam, BeamCorrection::default()]] {
                    let sensor = Sensor {
                        model: model.clone(),
                        body_from_sensor,
                        correction: SensorCorrection {
                            beams,
                            ..SensorCorrection::of_elevation(0.2)
                        },
                        time_offset_s: Some(-0.04),
                        ..Sensor::new("lidar")
                    };
                    write(&path, &sensor).unwrap();
                    let told = read(&path).unwrap();
                    assert_eq!(told.model, model);
                    assert_eq!(told.correction.unwrap(), sensor.correction);
                    assert_eq!(told.time_offset_s, Some(-0.04));
                    let off = told.body_from_sensor.unwrap_or_default().inverse() * body_from_sensor;
                    assert!(off.translation.length() < 1e-12 && off.rotation.xyz().length() < 1e-12);
                }
            }
        }
    }
}
