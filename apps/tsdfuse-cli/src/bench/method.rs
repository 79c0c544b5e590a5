//! A method and all that was measured of it.

use anyhow::Result;
use serde::Serialize;
use tsdfuse_io::Dataset;

use super::changes::Changes;
use super::run::Run;
use crate::config::{RunConfig, Suggested};
use crate::evaluate::results::median;
use crate::fuse::Fusion;
use crate::settings::Settings;

/// A method, its settings and its runs.
#[derive(Debug, Serialize)]
pub(super) struct Method {
    pub(super) name: String,
    pub(super) config: RunConfig,
    pub(super) runs: Vec<Run>,
    /// What a scan changes in the map.
    pub(super) changes: Changes,
}

/// A figure over all runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spread {
    pub(super) median: f64,
    pub(super) min: f64,
    pub(super) max: f64,
}

impl Method {
    pub(super) fn new(name: String, config: RunConfig) -> Self {
        Self {
            name,
            config,
            runs: Vec::new(),
            changes: Changes::default(),
        }
    }

    /// Adds a run.
    pub(super) fn run(&mut self, settings: &Settings, indices: &[usize]) -> Result<()> {
        self.runs.push(Run::time(settings, &self.config, indices)?);
        Ok(())
    }

    /// Counts what changes.
    pub(super) fn count(&mut self, settings: &Settings, dataset: &Dataset, indices: &[usize]) -> Result<()> {
        let fusion = Fusion::new(settings, &self.config, Suggested::by(dataset).sensor.as_ref())?;
        self.changes = Changes::count(fusion, dataset, indices)?;
        Ok(())
    }

    pub(super) fn is_complete(&self) -> bool {
        self.runs.iter().all(|run| run.skipped_scans == 0)
    }

    /// A figure of each run.
    pub(super) fn spread(&self, of: impl Fn(&Run) -> f64) -> Spread {
        let values: Vec<f64> = self.runs.iter().map(of).collect();
        Spread {
            min: values.iter().copied().fold(f64::INFINITY, f64::min),
            max: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            median: median(values),
        }
    }
}
