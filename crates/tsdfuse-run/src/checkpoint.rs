//! How far a run has come: what a store holds beside the map, so that any program can go on with it.

use std::path::Path;

use serde::{Deserialize, Serialize};
use tsdfuse::SensorModel;

use crate::config::RunConfig;
use crate::error::{Result, RunError};
use crate::intensity::RangeResponse;
use crate::job::Job;
use crate::report::{SkippedScan, Sums};

/// How far a run has come.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// What is run: the log, its scans, and what is to be made of them. `None` for a session that no job began.
    pub job: Option<Job>,
    /// With what it is fused.
    pub config: RunConfig,
    /// The models of the sensors, stated or guessed.
    pub sensors: Vec<Option<SensorModel>>,
    /// Whether the map that is continued, if any, is in the store.
    pub is_loaded: bool,
    /// Scans that were asked for; not known of a stream.
    pub asked: Option<usize>,
    /// Scans that are done, fused or skipped.
    pub done: usize,
    /// How many of these were fused.
    pub fused: usize,
    /// Their counts and times.
    pub sums: Sums,
    /// Those that were skipped.
    pub skipped: Vec<SkippedScan>,
    /// What was learnt of how the sensor reports intensities, if they are averaged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<RangeResponse>,
}

impl Checkpoint {
    /// Reads the checkpoint of a store.
    ///
    /// # Errors
    /// [`RunError::Config`] names the store if it holds something else.
    pub fn parse(store: &Path, bytes: &[u8]) -> Result<Self> {
        serde_json::from_slice(bytes).map_err(|error| {
            RunError::config(format_args!(
                "{}: its checkpoint is not one of this version of tsdfuse: {error}",
                store.display()
            ))
        })
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        // Plain data with text as keys cannot fail to become JSON.
        serde_json::to_vec(self).unwrap_or_default()
    }
}
