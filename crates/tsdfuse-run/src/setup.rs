//! How a log is fused, and where the map is meanwhile.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tsdfuse::fuse::{Method, RoldaoForm};
use tsdfuse_io::{Log, Selection};

use crate::config::RunConfig;
use crate::device::Device;
use crate::error::{Result, RunError};

/// How a log is fused: the configuration, and where the map is meanwhile.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct Setup {
    /// What decides the result.
    pub config: RunConfig,
    /// Whether odometry finds the poses; otherwise they are the log's.
    pub track: bool,
    /// Whether the log's poses are refined first: each scan is registered to what the others saw.
    pub refine: bool,
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
    /// Where the temporary store of a limited memory lies: in this folder.
    pub temporary: PathBuf,
    /// A saved map to continue.
    pub load_map: Option<PathBuf>,
    /// Scans from one [`Event::SurfaceChanged`](crate::Event::SurfaceChanged) to the next; `None`: nobody wants to know.
    pub follow_every: Option<usize>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            config: RunConfig::default(),
            track: false,
            refine: false,
            selection: Selection::default(),
            skip_bad: false,
            device: Device::Cpu,
            memory_bytes: None,
            store: None,
            commit_every: 100,
            temporary: std::env::temp_dir(),
            load_map: None,
            follow_every: None,
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

    /// Whether not all of the map is in memory.
    pub fn is_paged(&self) -> bool {
        self.memory_bytes.is_some() || self.store.is_some()
    }

    /// Refuses what does not go together.
    ///
    /// # Errors
    /// [`RunError::Config`] says what.
    pub fn check(&self) -> Result<()> {
        self.config.validate()?;
        let is_batch = self.config.method == Method::Roldao && self.config.roldao.form == RoldaoForm::Batch;
        if self.track && (self.store.is_some() || self.load_map.is_some()) {
            return Err(RunError::config(
                "odometry begins a world of its own, which cannot go on with a stored or saved map: write the poses first with `tsdfuse odometry LOG -o poses.tum`, and name them with --poses",
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
