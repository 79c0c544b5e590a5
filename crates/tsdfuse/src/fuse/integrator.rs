//! What every method of fusing scans offers, and what it says of a scan that it fused or could not fuse.

use serde::{Deserialize, Serialize};

use crate::{
    index::BlockIndex,
    map::{MapConfig, OutOfMemory, VoxelMap},
    reach::Reach,
    scan::{Scan, ScanError},
};

/// A method of fusing scans.
///
/// Implement it for a method of your own: [`Placed`](super::Placed) puts the returns of a scan into the world, and
/// [`Lines`](super::Lines), [`Gather`](super::Gather) or [`VoxelMap::update`] write to the map.
/// `examples/04_own_method.rs` does so in some thirty lines.
pub trait Integrator: Send {
    /// Fuses one scan and returns the blocks that changed.
    ///
    /// The result does not depend on the number of threads, bit for bit. Invalid returns (see [`Scan::drop_invalid`]) that
    /// are still in the scan are skipped and counted.
    ///
    /// # Errors
    /// [`FuseError`]. The map is unchanged then, except after [`FuseError::OutOfMemory`]: it may hold a part of the scan, and which
    /// one depends on the threads.
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError>;

    /// Ends a series of scans: a method that collects scans before it fuses them does so now.
    ///
    /// # Errors
    /// [`FuseError::OutOfMemory`].
    fn finish(&mut self, _map: &mut VoxelMap) -> Result<Integration, FuseError> {
        Ok(Integration::default())
    }

    /// The part of a map with this configuration that [`Self::integrate`] may read or write for a scan: what a map larger than
    /// memory must load first. Start from [`Reach::of`], which covers the rays of the scan, and widen it by what the method
    /// touches beside them. Returns beyond the range limits must have been dropped.
    ///
    /// # Errors
    /// [`FuseError`] if the scan cannot be fused.
    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError>;

    /// Whether the result depends on the sensor's model. Such a method guesses the model from its first scan if it is built
    /// without one, so a run that is to be continued elsewhere must keep the model.
    fn needs_sensor(&self) -> bool;
}

/// What one integration did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Integration {
    /// The blocks that were made or updated, each once.
    pub updated_blocks: Vec<BlockIndex>,
    /// Returns that reached the map.
    pub fused_returns: u64,
    /// Returns that could not be used, by reason.
    pub skipped: Skipped,
    /// Wall time of the method's own preparation (placing returns, normals, …), in seconds.
    pub prepare_secs: f64,
    /// Wall time of finding out which parts of the map returns reach into, in seconds.
    pub find_secs: f64,
}

/// Returns that a method did not use, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Skipped {
    /// Not finite, at the sensor's origin, or farther away than the grid reaches.
    pub outside_grid: u64,
    /// No surface normal could be estimated from the neighbours.
    pub without_normal: u64,
    /// The method gave it no weight.
    pub without_weight: u64,
    /// Outside the image that the method makes of the scan.
    pub outside_image: u64,
    /// Behind another return in the same pixel of that image.
    pub hidden: u64,
}

impl std::ops::AddAssign for Skipped {
    fn add_assign(&mut self, other: Self) {
        self.outside_grid += other.outside_grid;
        self.without_normal += other.without_normal;
        self.without_weight += other.without_weight;
        self.outside_image += other.outside_image;
        self.hidden += other.hidden;
    }
}

/// Why a scan cannot be fused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FuseError {
    /// The scan contradicts itself.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// An option has an impossible value.
    #[error("{0}")]
    Config(String),
    /// The method needs an organized scan, and neither the scan nor the sensor's model tells the laser of each return.
    #[error("{scan}: {reason}")]
    Unorganized {
        /// The scan's name.
        scan: String,
        /// What is missing, and what the user can do.
        reason: String,
    },
    /// The method needs an image that the scan does not give.
    #[error("{scan}: {reason}")]
    Image {
        /// The scan's name.
        scan: String,
        /// What is wrong.
        reason: String,
    },
    /// The sensor's position lies outside the grid or is not finite.
    #[error("{scan}: the sensor's position {position} lies outside the map's grid")]
    OutsideGrid {
        /// The scan's name.
        scan: String,
        /// World position.
        position: glam::DVec3,
    },
    /// There is no memory for the blocks that the scan touches. The scan is not to blame: the next one will fail as well.
    #[error("{0}; it may hold only a part of the last scan")]
    OutOfMemory(#[from] OutOfMemory),
}
