//! What is known of this machine in the end.

use serde::Serialize;
use tsdfuse_eval::stats::median;
use tsdfuse_run::{Machine, RunConfig};

use super::changes::Changes;
use super::limits::Limits;
use super::run::Run;
use crate::results::Failed;

/// Methods on this machine.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// The version of this crate.
    pub version: &'static str,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// This machine.
    pub machine: Machine,
    /// What was fused.
    pub dataset: Data,
    /// What memory allows.
    pub limits: Limits,
    /// The methods.
    pub methods: Vec<Measured>,
    /// Methods that could not be used on these data, with the reason.
    pub failed: Vec<Failed>,
}

/// What was fused.
#[derive(Clone, Debug, Serialize)]
pub struct Data {
    /// The log's path, or [`super::STREET`].
    pub name: String,
    /// Its format.
    pub format: String,
    /// Scans that were asked for.
    pub scans: usize,
}

/// A method and all that was measured of it.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// The form's name.
    pub name: String,
    /// With what it fuses.
    pub config: RunConfig,
    /// Its runs.
    pub runs: Vec<Run>,
    /// What a scan changes in the map.
    pub changes: Changes,
}

/// A figure over all runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spread {
    pub(crate) median: f64,
    pub(crate) min: f64,
    pub(crate) max: f64,
}

impl Results {
    /// Whether all scans could be used.
    pub fn is_complete(&self) -> bool {
        let mut runs = self.methods.iter().flat_map(|method| &method.runs);
        runs.all(|run| run.skipped_scans == 0)
    }
}

impl Measured {
    pub(crate) fn new(name: String, config: RunConfig) -> Self {
        Self {
            name,
            config,
            runs: Vec::new(),
            changes: Changes::default(),
        }
    }

    /// A figure of each run.
    pub(crate) fn spread(&self, of: impl Fn(&Run) -> f64) -> Spread {
        let values: Vec<f64> = self.runs.iter().map(of).collect();
        Spread {
            min: values.iter().copied().fold(f64::INFINITY, f64::min),
            max: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            median: median(values),
        }
    }
}
