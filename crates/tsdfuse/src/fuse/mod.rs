//! Fusing scans into the map: one trait, one file per method, one engine underneath.
//!
//! A method decides, for each return of a scan, which voxels it touches, with what signed distance and what weight. All
//! else is shared: [`placed`] puts returns into the world (undoing motion), [`cylinder`] walks the voxels about a line, and
//! [`scatter`] finds blocks, combines updates and spreads the work over threads.

mod cylinder;
mod placed;
mod raycast;
mod scatter;

use serde::{Deserialize, Serialize};

pub use raycast::{Distance, Raycast, RaycastConfig};

use crate::{index::BlockIndex, map::VoxelMap, scan::Scan, scan::ScanError};

/// A method of fusing scans.
pub trait Integrator: Send {
    /// Fuses one scan and says which blocks changed.
    ///
    /// The result does not depend on the number of threads, bit for bit. Invalid returns (see [`Scan::drop_invalid`]) that
    /// are still in the scan are skipped and counted.
    ///
    /// # Errors
    /// [`FuseError`]; the map is unchanged then.
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError>;
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
}

impl std::ops::AddAssign for Skipped {
    fn add_assign(&mut self, other: Self) {
        self.outside_grid += other.outside_grid;
        self.without_normal += other.without_normal;
        self.without_weight += other.without_weight;
    }
}

/// Why a scan cannot be fused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FuseError {
    /// The scan contradicts itself.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// The sensor's position lies outside the grid or is not finite.
    #[error("{scan}: the sensor's position {position} lies outside the map's grid")]
    OutsideGrid {
        /// The scan's name.
        scan: String,
        /// World position.
        position: glam::DVec3,
    },
}
