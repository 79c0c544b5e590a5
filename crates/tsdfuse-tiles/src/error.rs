//! Why there are no tiles.

/// The one error of this crate. Its message is one line.
#[derive(Debug, thiserror::Error)]
pub enum TilesError {
    /// The map cannot be read from its store.
    #[error(transparent)]
    Store(#[from] tsdfuse_store::StoreError),
    /// A file cannot be written, or the folder of the tiles cannot be made or is not ours to fill.
    #[error(transparent)]
    File(#[from] tsdfuse_io::Error),
    /// Nothing to show.
    #[error("the map has no surface: no triangle at a weight of {min_weight} or more")]
    NoSurface {
        /// Voxels of less weight were left out.
        min_weight: f32,
    },
}

/// Result with this crate's [`TilesError`].
pub type Result<T, E = TilesError> = std::result::Result<T, E>;
