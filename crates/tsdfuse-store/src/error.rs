//! What can go wrong with a store. Every message is one line and names the file.

use std::io;
use std::path::{Path, PathBuf};

use tsdfuse::fuse::FuseError;
use tsdfuse::index::RegionIndex;
use tsdfuse::map::MapError;

/// What is wrong with a store, or with what is read from it or written to it. Whatever it is, the file keeps the last
/// commit.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file cannot be created, read or written: the disk is full, for instance.
    #[error("{}: {reason}", path.display())]
    File {
        /// The store.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// The file is not as it was written.
    #[error("{}: {reason}", path.display())]
    Damaged {
        /// The store.
        path: PathBuf,
        /// Which part of it, and what is wrong.
        reason: String,
    },
    /// The bytes of a region are not as they were written.
    #[error("{}: region {:?}: {reason}", path.display(), region.0.to_array())]
    Region {
        /// The store.
        path: PathBuf,
        /// The region.
        region: RegionIndex,
        /// What is wrong with it.
        reason: String,
    },
    /// A scan changed a region that was not loaded, because the method's reach did not include it.
    #[error("{}: region {:?} was touched although it lies beyond the scan's reach", path.display(), region.0.to_array())]
    BeyondReach {
        /// The store.
        path: PathBuf,
        /// The region.
        region: RegionIndex,
    },
    /// A store that was opened for reading cannot be changed.
    #[error("{}: is open for reading only", path.display())]
    ReadOnly {
        /// The store.
        path: PathBuf,
    },
    /// The configuration or a block does not fit into a map.
    #[error("{}: {reason}", path.display())]
    Map {
        /// The store.
        path: PathBuf,
        /// Why not.
        reason: MapError,
    },
    /// An earlier error made the map in memory useless. Only the last commit is left, in the file.
    #[error("{cause} (the store takes nothing more since)")]
    Broken {
        /// The message of the first error.
        cause: String,
    },
    /// The map cannot be saved as a map file.
    #[error(transparent)]
    Save(#[from] tsdfuse_io::Error),
    /// The receiver of a mesh or of regions failed, or the mesh has too many vertices.
    #[error(transparent)]
    Sink(#[from] io::Error),
}

impl StoreError {
    /// Wraps an error of the system.
    pub(crate) fn file(path: &Path) -> impl Fn(io::Error) -> Self {
        move |reason| Self::File {
            path: path.to_owned(),
            reason: reason.to_string(),
        }
    }

    /// Whether the file is damaged, so that [`crate::Salvage`] may help.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Damaged { .. } | Self::Region { .. })
    }

    /// Whether the map in memory is useless after this error.
    pub(crate) fn is_final(&self) -> bool {
        matches!(
            self,
            Self::File { .. } | Self::Damaged { .. } | Self::Region { .. } | Self::BeyondReach { .. }
        )
    }

    /// The error that travelled within an [`io::Error`], or that error itself as one of the sink.
    pub(crate) fn from_io(error: io::Error) -> Self {
        error.downcast().unwrap_or_else(Self::Sink)
    }
}

/// Why a scan was not fused into a [`crate::PagedMap`].
#[derive(Debug, thiserror::Error)]
pub enum PagedError {
    /// The scan cannot be fused. The map is unchanged, and further scans can be fused.
    #[error(transparent)]
    Fuse(#[from] FuseError),
    /// The store failed. Nothing more can be fused; the file keeps the last commit.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Result with this crate's [`StoreError`].
pub type Result<T, E = StoreError> = std::result::Result<T, E>;
