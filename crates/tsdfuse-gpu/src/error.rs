//! What can go wrong on the device.

use tsdfuse::{fuse::FuseError, map::MapError, mesh::MeshError, render::RenderError};

/// Why something could not be done on the device.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// There is no usable adapter, or none of the requested name.
    #[error("no GPU can be used: {0}")]
    NoAdapter(String),
    /// The device stopped: it was reset or removed, or a kernel ran too long. Its contents are lost.
    #[error("the GPU stopped working, and what was on it is lost: {0}")]
    Lost(String),
    /// The device has no memory left.
    #[error("the GPU has no memory for {what} ({bytes} bytes)")]
    OutOfMemory {
        /// What the memory was for.
        what: String,
        /// How much was requested.
        bytes: u64,
    },
    /// The map needs more blocks than the device can address.
    #[error("the map needs more than {blocks} blocks, which is all that this GPU can hold")]
    TooManyBlocks {
        /// How many blocks it can hold.
        blocks: u64,
    },
    /// A buffer would exceed what one binding of this device can hold.
    #[error("{what} needs {bytes} bytes, but this GPU binds at most {limit} at once")]
    TooLarge {
        /// The contents of the buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// The largest possible size.
        limit: u64,
    },
    /// A fault of the driver or of this program.
    #[error("the GPU reports an error: {0}")]
    Driver(String),
    /// The method does not run on the device.
    #[error("{0}")]
    Unsupported(String),
    /// The scan cannot be fused, on the device or elsewhere.
    #[error(transparent)]
    Fuse(#[from] FuseError),
    /// The map cannot be created.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The mesh cannot be extracted.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The view cannot be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
}

impl GpuError {
    /// Whether the device has no room for a larger map. The map on it still holds all scans that were reported before.
    pub fn is_full(&self) -> bool {
        matches!(self, Self::OutOfMemory { .. } | Self::TooManyBlocks { .. })
    }

    /// Whether only the scan that was passed to [`Fuser::integrate`](crate::Fuser::integrate) is at fault. The map is
    /// unchanged then, scans before it are not affected, and further scans can be fused.
    pub fn is_bad_scan(&self) -> bool {
        matches!(self, Self::Fuse(_) | Self::TooLarge { .. })
    }
}
