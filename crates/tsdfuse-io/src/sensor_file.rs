//! `sensor.toml`: a sensor's model, where it sits, and its systematic errors; each of them may be missing.
//!
//! - the model ([`SensorModel`]): `name`, `elevations_deg`, `columns`, `min_range_m` and `max_range_m`,
//! - `body_from_sensor`: the 12 numbers of where the sensor sits on the body whose poses are used,
//! - the errors, taken back ([`SensorCorrection`]): `elevation_correction_deg`, `range_correction_m`, and for each ring
//!   `[[beam_corrections]]` with `elevation_deg`, `azimuth_deg` and `range_m`.

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
}

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
}

/// A `sensor.toml` without a model.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WithoutModel {
    body_from_sensor: Option<[f64; 12]>,
    elevation_correction_deg: Option<f64>,
    range_correction_m: Option<f64>,
    beam_corrections: Option<Vec<BeamCorrection>>,
}

/// Parses `sensor.toml`: the model, where the sensor sits and what its errors are; each of them may be missing. `path` is for
/// messages.
///
/// # Errors
/// Names the file and what no sensor can have.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<SensorFile> {
    let file = |model,
                body_from_sensor: Option<[f64; 12]>,
                errors: (Option<f64>, Option<f64>, Option<Vec<BeamCorrection>>)| {
        let pose = |numbers: [f64; 12]| {
            let pose = Pose::from_row_major_3x4(&numbers);
            pose.map_err(|e| Error::format(path, format!("body_from_sensor: {e}")))
        };
        let is_told = errors.0.is_some() || errors.1.is_some() || errors.2.is_some();
        let correction = SensorCorrection {
            elevation_deg: errors.0.unwrap_or_default(),
            range_m: errors.1.unwrap_or_default(),
            beams: errors.2.unwrap_or_default(),
        };
        correction.check().map_err(|e| Error::format(path, e.to_string()))?;
        Ok(SensorFile {
            model,
            body_from_sensor: body_from_sensor.map(pose).transpose()?,
            correction: is_told.then_some(correction),
        })
    };
    if let Ok(WithoutModel {
        body_from_sensor,
        elevation_correction_deg,
        range_correction_m,
        beam_corrections,
    }) = text::toml(path, bytes)
    {
        let errors = (elevation_correction_deg, range_correction_m, beam_corrections);
        let told = file(None, body_from_sensor, errors)?;
        if told.body_from_sensor.is_some() || told.correction.is_some() {
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
    let errors = (
        told.elevation_correction_deg,
        told.range_correction_m,
        told.beam_corrections,
    );
    file(Some(model), told.body_from_sensor, errors)
}

/// A sensor as its file has it.
#[derive(Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    model: Option<&'a SensorModel>,
    #[serde(skip_serializing_if = "Option::is_none")]
    body_from_sensor: Option<[f64; 12]>,
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
                        ..Sensor::new("lidar")
                    };
                    write(&path, &sensor).unwrap();
                    let told = read(&path).unwrap();
                    assert_eq!(told.model, model);
                    assert_eq!(told.correction.unwrap(), sensor.correction);
                    let off = told.body_from_sensor.unwrap_or_default().inverse() * body_from_sensor;
                    assert!(off.translation.length() < 1e-12 && off.rotation.xyz().length() < 1e-12);
                }
            }
        }
    }
}
