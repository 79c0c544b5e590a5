//! Which methods are compared, and on which data.

use std::path::PathBuf;

use tsdfuse_io::Log;
use tsdfuse_run::{Input, Settings};

use crate::error::{Error, Result};
use crate::form::Form;
use crate::pose_noise::PoseNoise;

/// Methods, the data they are run on, and which scans are held out from their maps.
#[derive(Clone, Debug)]
pub struct Contest {
    /// The log and which of its scans.
    pub input: Input,
    /// What is set for all methods.
    pub settings: Settings,
    /// The methods.
    pub forms: Vec<Form>,
    /// One of so many scans is held out; 0: none. `None`: as many as suit the purpose and the length of the log.
    pub hold_out: Option<usize>,
    /// Largest distance between a held-out return and its surface, metres. `None`: the default truncation for the log.
    pub margin_m: Option<f64>,
    /// What is added to the poses that scans are fused with; held-out scans and references keep theirs.
    pub pose_noise: Option<PoseNoise>,
}

impl Contest {
    /// All methods on all scans of a log.
    pub fn of(log: impl Into<PathBuf>) -> Self {
        Self {
            input: Input {
                path: log.into(),
                ..Input::default()
            },
            settings: Settings::default(),
            forms: Form::all(),
            hold_out: None,
            margin_m: None,
            pose_noise: None,
        }
    }

    /// Finds out before the work what cannot be.
    pub(crate) fn check(&self) -> Result<()> {
        for form in &self.forms {
            form.over(&self.settings)?;
        }
        self.margin_m
            .map_or(Ok(()), |margin_m| check_length("--margin", margin_m))
    }

    /// The margin for a log.
    pub(crate) fn margin_m(&self, log: &Log) -> f64 {
        self.margin_m.unwrap_or(log.suggested().map.truncation_m)
    }
}

/// Refuses what is no length.
pub(crate) fn check_length(flag: &str, length_m: f64) -> Result<()> {
    if length_m > 0.0 && length_m.is_finite() {
        return Ok(());
    }
    Err(Error::config(format_args!(
        "{flag} must be a positive length in metres, not {length_m}"
    )))
}
