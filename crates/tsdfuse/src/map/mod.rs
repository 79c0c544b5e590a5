//! The map: a truncated signed distance field in voxel blocks ([`VoxelMap`]), and what it answers.
//!
//! | file | what is in it |
//! |---|---|
//! | `config` | [`MapConfig`]: sizes of voxels and of the band around surfaces |
//! | `block` | [`Voxel`] and [`Block`]: two integer sums per voxel |
//! | `shard` | the table of blocks, in parts that threads own |
//! | `voxel_map` | [`VoxelMap`] itself |
//! | `region` | regions of blocks, taken out of a map and put in again |
//! | `merge`, `crop`, `warp` | maps made of maps |

mod block;
mod config;
mod crop;
mod error;
mod merge;
mod region;
mod shard;
mod voxel_map;
mod warp;

pub use block::{Block, MAX_WEIGHT, Voxel, WEIGHT_SCALE};
pub(crate) use block::{fixed, min_weight_sum};
pub use config::MapConfig;
pub use error::MapError;
pub use region::{BlockPool, RegionBlocks};
pub(crate) use shard::{NO_SLOT, Shard};
pub use voxel_map::VoxelMap;
