//! What can go wrong with a store: every message names the file.

use std::path::{Path, PathBuf};

use tsdfuse::index::RegionIndex;
use tsdfuse::map::MapError;

/// The one error of this crate. Its message is one line. Whatever it is, the file holds what was committed last.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file cannot be made, read or written: the disk is full, for instance.
    #[error("{}: {reason}", path.display())]
    File {
        /// The store.
        path: PathBuf,
        /// What the system or the database says.
        reason: String,
    },
    /// A region's bytes are not as they were written.
    #[error("{}: region {:?}: {reason}", path.display(), region.0.to_array())]
    Region {
        /// The store.
        path: PathBuf,
        /// Which region.
        region: RegionIndex,
        /// What is wrong with it.
        reason: String,
    },
    /// A scan touched more than it was said to; fusing on would lose what the store has there.
    #[error("{}: region {:?} was touched although it lies beyond the scan's reach", path.display(), region.0.to_array())]
    BeyondReach {
        /// The store.
        path: PathBuf,
        /// Which region.
        region: RegionIndex,
    },
    /// The store's settings make no map.
    #[error("{}: {reason}", path.display())]
    Map {
        /// The store.
        path: PathBuf,
        /// Why not.
        reason: MapError,
    },
    /// Who takes a mesh or regions cannot, or there are too many vertices.
    #[error(transparent)]
    Sink(#[from] std::io::Error),
}

impl StoreError {
    /// Wraps what the database says.
    pub(crate) fn file(path: &Path) -> impl Fn(redb::Error) -> Self {
        move |reason| Self::File {
            path: path.to_owned(),
            reason: match reason {
                redb::Error::Io(e) => e.to_string(),
                other => other.to_string(),
            },
        }
    }
}

/// Result with this crate's [`StoreError`].
pub type Result<T, E = StoreError> = std::result::Result<T, E>;
