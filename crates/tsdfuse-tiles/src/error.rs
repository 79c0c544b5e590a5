//! What can go wrong with tiles.

/// The one error of this crate. Its message is one line.
#[derive(Debug, thiserror::Error)]
pub enum TilesError {
    /// The surface cannot be read: the error of [`tsdfuse::mesh::Surface::pieces`].
    #[error(transparent)]
    Surface(std::io::Error),
    /// A file cannot be written, or the tiles' folder cannot be created or is not empty.
    #[error(transparent)]
    File(#[from] tsdfuse_io::Error),
    /// The map has no surface.
    #[error("the map has no surface: no triangle with a weight of {min_weight} or more")]
    NoSurface {
        /// Voxels of less weight count as never observed.
        min_weight: f32,
    },
}

/// Result with this crate's [`TilesError`].
pub type Result<T, E = TilesError> = std::result::Result<T, E>;
