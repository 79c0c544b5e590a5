//! A source whose scans are listed in a table, and read by one function.

use tsdfuse::{Scan, Trajectory};

use crate::error::Result;
use crate::source::{ImageRef, ScanRef, Sensor, Source};

/// What data sets with an index of their own are made of.
pub(crate) struct Listed {
    pub(crate) format: &'static str,
    pub(crate) sensors: Vec<Sensor>,
    pub(crate) scans: Vec<ScanRef>,
    /// `world_from_body`.
    pub(crate) trajectory: Option<Trajectory>,
    pub(crate) images: Vec<ImageRef>,
    pub(crate) notes: Vec<String>,
    /// Reads the scan of a number.
    pub(crate) read: Box<dyn Fn(usize) -> Result<Scan> + Send + Sync>,
}

impl Source for Listed {
    fn format(&self) -> &str {
        self.format
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let reference = &self.scans[index];
        let scan = (self.read)(index)?;
        Ok(Scan {
            name: reference.name.clone(),
            time_ns: reference.time_ns,
            pose: reference.pose,
            ..scan
        })
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.trajectory.as_ref()
    }

    fn images(&self) -> &[ImageRef] {
        &self.images
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}
