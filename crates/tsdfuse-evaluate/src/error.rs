//! Why nothing could be measured.

use std::fmt::Display;
use std::path::Path;

use tsdfuse_run::RunError;

/// Why nothing could be measured. Its message is one line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The options ask for something impossible.
    #[error("{0}")]
    Config(String),
    /// Nothing came of it.
    #[error("{0}")]
    Failed(String),
    /// A run failed.
    #[error(transparent)]
    Run(RunError),
    /// A file cannot be read or written.
    #[error(transparent)]
    Io(#[from] tsdfuse_io::Error),
    /// A mesh cannot be compared.
    #[error(transparent)]
    Eval(#[from] tsdfuse_eval::EvalError),
    /// A simulated scan cannot be made.
    #[error(transparent)]
    Simulation(#[from] tsdfuse_sim::SimulationError),
    /// The GPU failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] tsdfuse_gpu::GpuError),
}

/// A result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// The options ask for something impossible, for this reason.
    pub fn config(reason: impl Display) -> Self {
        Self::Config(reason.to_string())
    }

    /// Nothing came of it, for this reason.
    pub fn failed(reason: impl Display) -> Self {
        Self::Failed(reason.to_string())
    }

    /// Names the file in front of an error's message.
    pub(crate) fn at<E: Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |error| Self::failed(format_args!("{}: {error}", path.display()))
    }
}

impl From<RunError> for Error {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Config(reason) => Self::Config(reason),
            error => Self::Run(error),
        }
    }
}

impl From<tsdfuse::map::MapError> for Error {
    fn from(error: tsdfuse::map::MapError) -> Self {
        RunError::from(error).into()
    }
}

impl From<tsdfuse::render::RenderError> for Error {
    fn from(error: tsdfuse::render::RenderError) -> Self {
        RunError::from(error).into()
    }
}
