//! What can go wrong with files. Every message names the file, the scan or line, and the reason.

use std::path::{Path, PathBuf};

/// The error of this crate. Its message is one line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said. Part of the message, so [`std::error::Error::source`] does not give it again.
        reason: std::io::Error,
    },
    /// The file is not in its format.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Where in it and what is wrong.
        reason: String,
    },
    /// The path holds nothing that can be read, or its parts do not fit together.
    #[error("{}: {reason}", path.display())]
    Dataset {
        /// The data set's folder.
        path: PathBuf,
        /// What is missing or contradictory.
        reason: String,
    },
}

impl Error {
    /// Wraps a system error with its path.
    pub fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        move |reason| Self::Io {
            path: path.as_ref().to_owned(),
            reason,
        }
    }

    /// A file whose content is wrong.
    pub fn format(path: impl AsRef<Path>, reason: impl Into<String>) -> Self {
        Self::Format {
            path: path.as_ref().to_owned(),
            reason: reason.into(),
        }
    }

    /// A folder that cannot be used.
    pub fn dataset(path: impl AsRef<Path>, reason: impl Into<String>) -> Self {
        Self::Dataset {
            path: path.as_ref().to_owned(),
            reason: reason.into(),
        }
    }
}

/// Result with this crate's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;
