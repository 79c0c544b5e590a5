//! How a log is fused, and where the map is meanwhile.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tsdfuse::Pose;
use tsdfuse::fuse::{Method, RoldaoForm};
use tsdfuse_io::{Log, Selection};

use crate::config::RunConfig;
use crate::device::Device;
use crate::error::{Result, RunError};

/// How scans come by their poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Placing {
    /// They are the log's.
    #[default]
    Given,
    /// Odometry finds them.
    Track,
    /// They are the log's, refined first: each scan is registered to what the others saw.
    Refine,
}

/// How a log is fused: the configuration, and where the map is meanwhile.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct Setup {
    /// What decides the result.
    pub config: RunConfig,
    /// How scans come by their poses.
    pub placing: Placing,
    /// Whether loops are closed: where the sensor comes back, poses and map meet. A first pass over the log does that before anything is fused. A stream is fused
    /// as it comes, and again when it is over and its poses are corrected.
    pub loops: bool,
    /// Which scans are fused.
    pub selection: Selection,
    /// Whether scans that cannot be used are left out; otherwise the first one ends the run.
    pub skip_bad: bool,
    /// What fuses.
    pub device: Device,
    /// Most memory for blocks of the map; the others are in a file meanwhile.
    pub memory_bytes: Option<usize>,
    /// The file in which the map is kept as it grows, so that a run that was ended early can go on.
    pub store: Option<PathBuf>,
    /// Scans from commit to commit of the store.
    pub commit_every: usize,
    /// Where the temporary store of a limited memory lies, and what is kept of a stream: in this folder, or beside this file.
    pub temporary: PathBuf,
    /// A saved map to continue. Odometry looks for the log's place in it.
    pub load_map: Option<PathBuf>,
    /// About where in the saved map the first scan was taken, `world_from_sensor`; `None`: near the poses of the map's scans.
    pub initial_pose: Option<Pose>,
    /// Whether intensities of returns are averaged in a layer beside the map.
    pub intensity: bool,
    /// The folder in which it is written for each scan which of its returns move.
    pub labels: Option<PathBuf>,
    /// Scans from one [`Event::SurfaceChanged`](crate::Event::SurfaceChanged) to the next; `None`: nobody wants to know.
    pub follow_every: Option<usize>,
    /// Of what changed farther than this from the sensor, in metres, each event tells a tenth, the last one all; `None`: each tells all, as with
    /// limited memory.
    pub follow_near_m: Option<f64>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            config: RunConfig::default(),
            placing: Placing::Given,
            loops: true,
            selection: Selection::default(),
            skip_bad: false,
            device: Device::Cpu,
            memory_bytes: None,
            store: None,
            commit_every: 100,
            temporary: std::env::temp_dir(),
            load_map: None,
            initial_pose: None,
            intensity: false,
            labels: None,
            follow_every: None,
            follow_near_m: None,
        }
    }
}

impl Setup {
    /// The defaults for a log.
    pub fn for_log(log: &Log) -> Self {
        Self {
            config: RunConfig::for_log(log),
            ..Self::default()
        }
    }

    /// Whether odometry finds the poses of all scans, and closes their loops, before the first one is fused.
    pub(crate) fn tracks_first(&self, log: &Log) -> bool {
        self.closes_loops() && log.len().is_some()
    }

    /// Whether the log is a stream that is fused again where its loops are closed.
    pub(crate) fn tracks_again(&self, log: &Log) -> bool {
        self.closes_loops() && log.len().is_none()
    }

    /// In a map that is continued, scans have their place.
    fn closes_loops(&self) -> bool {
        self.loops && self.placing == Placing::Track && self.load_map.is_none()
    }

    /// The folder in which a stream is kept: there is as much room as for the results, or for the store.
    pub(crate) fn spool(&self) -> &Path {
        let beside = self.store.as_deref().unwrap_or(&self.temporary);
        let folder = if beside.is_dir() { Some(beside) } else { beside.parent() };
        folder
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."))
    }

    /// Whether not all of the map is in memory.
    pub fn is_paged(&self) -> bool {
        self.memory_bytes.is_some() || self.store.is_some()
    }

    /// Whether anybody wants to know which returns move.
    pub(crate) fn tells_moving(&self) -> bool {
        self.config.leaves_out_moving() || self.labels.is_some()
    }

    /// Refuses what does not go together.
    ///
    /// # Errors
    /// [`RunError::Config`] says what.
    pub fn check(&self) -> Result<()> {
        self.config.validate()?;
        let is_batch = self.config.method == Method::Roldao && self.config.roldao.form == RoldaoForm::Batch;
        if self.initial_pose.is_some() && (self.load_map.is_none() || self.placing != Placing::Track) {
            return Err(RunError::config(
                "--initial-pose is where a sensor without poses is in a saved map: it needs --load-map, and a log without poses or --poses track",
            ));
        }
        if self.intensity && self.device != Device::Cpu {
            return Err(RunError::config(
                "--intensity needs a map that is fused by the CPU: leave out --device",
            ));
        }
        if self.is_paged() {
            if self.device != Device::Cpu {
                return Err(RunError::config(
                    "--memory and --store need the CPU: leave out --device",
                ));
            }
            if is_batch {
                return Err(RunError::config(
                    "--memory and --store: roldao.form = batch keeps the points of all scans in memory; roldao.form=streaming does not",
                ));
            }
        }
        if let (Some(path), true) = (&self.load_map, is_batch) {
            return Err(RunError::config(format_args!(
                "{}: roldao.form = batch fits planes to all scans at once, and a saved map no longer holds them; roldao.form=streaming can continue it",
                path.display()
            )));
        }
        Ok(())
    }
}
