//! A data set: scans with poses, whatever the files look like.

use std::path::PathBuf;

use tsdfuse::{Pose, Scan, SensorModel};

use crate::error::Result;

/// How to open a data set; the default asks for nothing.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Poses to use instead of those that lie beside the scans (TUM or KITTI text).
    pub poses: Option<PathBuf>,
    /// The sensor: one of several in the log, or the model of the only one.
    pub sensor: Option<String>,
}

/// One scan of a data set, before it is read.
#[derive(Clone, Debug)]
pub struct ScanRef {
    /// What messages call it: the file's name.
    pub name: String,
    /// Seconds, where the data set has times.
    pub timestamp_secs: Option<f64>,
    /// `world_from_sensor`.
    pub pose: Pose,
}

/// One file format: knows its scans and reads any of them.
pub trait Source: Send + Sync {
    /// The format's name for people: `PandaSet`, `KITTI odometry`, …
    fn format(&self) -> &'static str;
    /// The scans in order of time, each with its pose.
    fn scans(&self) -> &[ScanRef];
    /// Reads scan `index` of [`Source::scans`]. Invalid returns are still in it, as measured.
    ///
    /// # Errors
    /// Names the file and the reason.
    fn read(&self, index: usize) -> Result<Scan>;
    /// The sensor's model, where the data set states it.
    fn sensor(&self) -> Option<SensorModel> {
        None
    }
    /// What is missing or odd, one sentence each: frames without scan, scans without pose, …
    fn notes(&self) -> &[String] {
        &[]
    }
}
