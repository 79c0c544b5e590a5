//! What can go wrong: a scan that cannot be used, or a run that cannot go on.

use std::fmt::Display;

/// A scan that cannot be used: the only trouble that can be skipped. The map is as it was before.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct BadScan {
    /// The scan's name.
    pub scan: String,
    /// What is wrong with it; names the file.
    pub reason: String,
}

/// Why a run ended without a result, or with less than was asked for.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The configuration asks for what cannot be.
    #[error("{0}")]
    Config(String),
    /// A scan cannot be used, and bad scans were not to be skipped.
    #[error(transparent)]
    BadScan(#[from] BadScan),
    /// The device or the memory is full. The map holds the scans before, and the session can still write them.
    #[error("{0}; only the scans before are in the result")]
    Full(String),
    /// The run has no result: no scan could be fused, or the map has no surface.
    #[error("{0}")]
    Nothing(String),
    /// A log cannot be opened, or a result cannot be written.
    #[error(transparent)]
    Io(#[from] tsdfuse_io::Error),
    /// The store cannot be read or written.
    #[error(transparent)]
    Store(#[from] tsdfuse_store::StoreError),
    /// The GPU failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] tsdfuse_gpu::GpuError),
    /// The map cannot be made.
    #[error(transparent)]
    Map(#[from] tsdfuse::map::MapError),
    /// The surface cannot be extracted.
    #[error(transparent)]
    Mesh(#[from] tsdfuse::mesh::MeshError),
    /// The map cannot be rendered.
    #[error(transparent)]
    Render(#[from] tsdfuse::render::RenderError),
    /// The surface cannot be written as tiles.
    #[cfg(feature = "tiles")]
    #[error(transparent)]
    Tiles(#[from] tsdfuse_tiles::TilesError),
}

/// A result of this crate.
pub type Result<T, E = RunError> = std::result::Result<T, E>;

impl RunError {
    /// The configuration asks for what cannot be, for this reason.
    pub fn config(reason: impl Display) -> Self {
        Self::Config(reason.to_string())
    }
}
