//! Why there are no tiles.

use std::path::PathBuf;

/// The one error of this crate. Its message is one line.
#[derive(Debug, thiserror::Error)]
pub enum TilesError {
    /// The map cannot be read from its store.
    #[error(transparent)]
    Store(#[from] tsdfuse_store::StoreError),
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] tsdfuse_io::Error),
    /// The folder of the tiles cannot be made, or is not ours to fill.
    #[error("{}: {reason}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says, or what is there.
        reason: String,
    },
    /// Nothing to show.
    #[error("the map has no surface: no triangle at a weight of {min_weight} or more")]
    NoSurface {
        /// Voxels of less weight were left out.
        min_weight: f32,
    },
}

/// Result with this crate's [`TilesError`].
pub type Result<T, E = TilesError> = std::result::Result<T, E>;
