//! A log whose sensors have another model or other errors than its format gives them, or a clock that differs from that of its poses.

use std::sync::Arc;

use tsdfuse::sensor::SensorCorrection;
use tsdfuse::trajectory::ns_after;
use tsdfuse::{Pose, Scan, SensorModel, Trajectory};

use crate::error::{Error, Result};
use crate::placed;
use crate::poses;
use crate::source::{GnssFix, ImageRef, ImuSample, Recorded, ScanRef, Sensor, Source};

/// A source whose sensors are corrected otherwise than its format does.
pub(crate) struct Corrected {
    source: Arc<dyn Source>,
    sensors: Vec<Sensor>,
    /// Where scans have other poses.
    replaced: Option<Replaced>,
}

/// Scans with the poses of another time.
struct Replaced {
    scans: Vec<ScanRef>,
    trajectory: Trajectory,
    /// Whether the trajectory is that of the sensor itself.
    is_sensors: bool,
}

impl Corrected {
    pub(crate) fn new(source: Arc<dyn Source>, correction: &SensorCorrection) -> Self {
        Self::of_sensors(source, |sensors| set(sensors, correction))
    }

    pub(crate) fn of_model(source: Arc<dyn Source>, model: &SensorModel) -> Self {
        Self::of_sensors(source, |sensors| set_model(sensors, model))
    }

    fn of_sensors(source: Arc<dyn Source>, change: impl FnOnce(&mut [Sensor])) -> Self {
        let mut sensors = source.sensors().to_vec();
        change(&mut sensors);
        Self {
            source,
            sensors,
            replaced: None,
        }
    }

    /// Scans at time t have the poses of t + `secs`; those that would lie beyond the first or the last pose have none.
    ///
    /// # Errors
    /// If the poses have no times, or those of several sensors are no trajectory.
    pub(crate) fn later(source: Arc<dyn Source>, secs: f64) -> Result<Self> {
        let sensors = source.sensors().iter().cloned();
        let sensors: Vec<_> = sensors
            .map(|sensor| Sensor {
                time_offset_s: Some(secs),
                ..sensor
            })
            .collect();
        let error = |reason: String| Error::dataset(source.format(), format!("time_offset_s: {reason}"));
        let at = |(time_ns, pose): (i64, Pose)| (ns_after(time_ns, -secs), pose);
        let is_sensors = source.trajectory().is_none();
        let timed: Vec<(i64, Pose)> = match source.trajectory() {
            Some(given) => given
                .times_ns()
                .iter()
                .copied()
                .zip(given.poses().iter().copied())
                .map(at)
                .collect(),
            None if sensors.len() > 1 => {
                return Err(error("the poses of several sensors are no trajectory".to_owned()));
            }
            None => source
                .scans()
                .iter()
                .filter_map(|scan| Some(at((scan.time_ns?, scan.pose?))))
                .collect(),
        };
        let trajectory = Trajectory::new(timed).map_err(|e| error(e.to_string()))?;
        let mut scans = source.scans().to_vec();
        for scan in &mut scans {
            let body = scan.time_ns.and_then(|time_ns| poses::at(&trajectory, time_ns).ok());
            let sitting = if is_sensors {
                Pose::IDENTITY
            } else {
                sensors[scan.sensor].body_from_sensor
            };
            scan.pose = body.map(|body| body * sitting);
        }
        let replaced = Replaced {
            scans,
            trajectory,
            is_sensors,
        };
        Ok(Self {
            source,
            sensors,
            replaced: Some(replaced),
        })
    }
}

/// Gives all sensors a model.
pub(crate) fn set_model(sensors: &mut [Sensor], model: &SensorModel) {
    for sensor in sensors {
        sensor.model = Some(model.clone());
    }
}

/// Gives all sensors this correction.
pub(crate) fn set(sensors: &mut [Sensor], correction: &SensorCorrection) {
    for sensor in sensors {
        sensor.correction.clone_from(correction);
    }
}

impl Source for Corrected {
    fn format(&self) -> &str {
        self.source.format()
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        self.replaced
            .as_ref()
            .map_or_else(|| self.source.scans(), |replaced| &replaced.scans)
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let mut scan = self.source.read(index)?;
        if let Some(Replaced {
            scans,
            trajectory,
            is_sensors,
        }) = &self.replaced
        {
            scan.pose = scans[index].pose;
            let sitting = if *is_sensors {
                Pose::IDENTITY
            } else {
                self.sensors[scans[index].sensor].body_from_sensor
            };
            let times = scan.times.as_deref().unwrap_or_default();
            scan.motion = placed::motion(scans, index, times, Some(trajectory), &sitting);
        }
        Ok(scan)
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        match &self.replaced {
            Some(replaced) => (!replaced.is_sensors).then_some(&replaced.trajectory),
            None => self.source.trajectory(),
        }
    }

    fn imu(&self) -> Result<Vec<ImuSample>> {
        self.source.imu()
    }

    fn gnss(&self) -> Result<Vec<GnssFix>> {
        self.source.gnss()
    }

    fn recorded(&self) -> Option<&Recorded> {
        self.source.recorded()
    }

    fn images(&self) -> &[ImageRef] {
        self.source.images()
    }

    fn read_image(&self, index: usize) -> Result<Vec<u8>> {
        self.source.read_image(index)
    }

    fn notes(&self) -> &[String] {
        self.source.notes()
    }
}
