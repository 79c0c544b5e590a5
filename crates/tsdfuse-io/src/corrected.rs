//! A log whose sensors have other errors than its format gives them.

use std::sync::Arc;

use tsdfuse::sensor::SensorCorrection;
use tsdfuse::{Scan, Trajectory};

use crate::error::Result;
use crate::source::{GnssFix, ImageRef, ImuSample, Recorded, ScanRef, Sensor, Source};

/// A source whose sensors are corrected otherwise than its format does.
pub(crate) struct Corrected {
    source: Arc<dyn Source>,
    sensors: Vec<Sensor>,
}

impl Corrected {
    pub(crate) fn new(source: Arc<dyn Source>, correction: &SensorCorrection) -> Self {
        let mut sensors = source.sensors().to_vec();
        set(&mut sensors, correction);
        Self { source, sensors }
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
        self.source.scans()
    }

    fn read(&self, index: usize) -> Result<Scan> {
        self.source.read(index)
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.source.trajectory()
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
