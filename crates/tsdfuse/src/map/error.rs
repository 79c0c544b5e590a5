//! Why a map cannot be made or changed.

use glam::DVec3;

use super::block::{Block, MAX_WEIGHT, Voxel};
use crate::{index::BlockIndex, memory::OutOfMemory};

/// Blocks farther out are refused by [`VoxelMap::insert_block`]: ±107 000 km at 5 cm.
pub(super) const MAX_BLOCK: u32 = (1 << 28) - 2;

/// Why a map cannot be made or changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapError {
    /// A length must be positive and finite.
    #[error("{name} must be a positive length in metres, not {value}")]
    Length {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The band must hold at least one voxel on each side of the surface, and not thousands.
    #[error("the truncation ({truncation_m} m) must be between 1 and 64 voxels ({voxel_size_m} m each)")]
    Truncation {
        /// μ.
        truncation_m: f64,
        /// κ.
        voxel_size_m: f64,
    },
    /// Zero would never remember, more does not fit.
    #[error("max_weight must be above 0 and at most {MAX_WEIGHT}, not {0}")]
    MaxWeight(f32),
    /// A block can be put into a map once.
    #[error("block {:?} is there already", block.0.to_array())]
    Occupied {
        /// Which.
        block: BlockIndex,
    },
    /// Voxels of the block or of its neighbours would have no 32-bit coordinates.
    #[error("block {:?} lies outside of the grid", block.0.to_array())]
    Outside {
        /// Which.
        block: BlockIndex,
    },
    /// The sums are not those of any observations.
    #[error("block {:?}: voxel {number} cannot hold a weight of {} and a distance of {}", block.0.to_array(), voxel.weight_sum, voxel.distance_sum)]
    Voxel {
        /// The voxel's block.
        block: BlockIndex,
        /// Its [`local_number`](crate::index::local_number).
        number: usize,
        /// Its sums.
        voxel: Voxel,
    },
    /// Maps can be put together only if their voxels mean the same.
    #[error("the maps differ in {name}: {a} and {b}")]
    Differ {
        /// The field.
        name: &'static str,
        /// Its value in one map.
        a: f64,
        /// And in the other.
        b: f64,
    },
    /// There is no memory for more blocks.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// A box has its lower corner below its upper one.
    #[error("the box from {low} to {high} holds nothing")]
    Box {
        /// The lower corner.
        low: DVec3,
        /// The upper one.
        high: DVec3,
    },
    /// Arrays are limited, and so is memory.
    #[error("a box of {voxels} voxels is too large for arrays; take it in parts")]
    Dense {
        /// How many it has.
        voxels: u128,
    },
}

/// Checks that a block lies within the grid, and that observations can sum up to its voxels.
pub(super) fn check_block(index: BlockIndex, block: &Block) -> Result<(), MapError> {
    if index.0.to_array().iter().any(|i| i.unsigned_abs() > MAX_BLOCK) {
        return Err(MapError::Outside { block: index });
    }
    match block.voxels.iter().enumerate().find(|(_, v)| !v.is_possible()) {
        Some((number, &voxel)) => Err(MapError::Voxel {
            block: index,
            number,
            voxel,
        }),
        None => Ok(()),
    }
}
