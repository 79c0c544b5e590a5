//! The map: a truncated signed distance field in voxel blocks ([`VoxelMap`]), and what it answers.
//!
//! | file | what is in it |
//! |---|---|
//! | `config` | [`MapConfig`]: sizes of voxels and of the band around surfaces |
//! | `block` | [`Voxel`] and [`Block`]: two integer sums per voxel |
//! | `shard` | the table of blocks, in parts that threads own |
//! | `voxel_map` | [`VoxelMap`] itself |
//! | `region` | regions of blocks, taken out of a map and put in again |
//! | `tally` | what a map holds, counted without it |
//! | `sample`, `observed`, `dense` | queries: the field at points, all that was observed, a box as arrays |
//! | `update` | single voxels, for methods that do not need speed |
//! | `merge`, `crop`, `warp` | maps made of maps |

pub(crate) mod block;
mod config;
mod crop;
mod dense;
mod error;
mod merge;
mod observed;
mod recent;
mod region;
mod sample;
mod shard;
mod tally;
#[cfg(test)]
pub(crate) mod testing;
mod update;
mod voxel_map;
mod warp;

pub use crate::memory::OutOfMemory;
pub use block::{Block, MAX_WEIGHT, Voxel, WEIGHT_SCALE};
pub(crate) use block::{fixed, min_weight_sum};
pub use config::MapConfig;
pub use dense::Dense;
pub use error::MapError;
pub use observed::{ObservedBlock, ObservedVoxel};
pub(crate) use recent::Recent;
pub use region::{BlockPool, RegionBlocks};
pub use sample::Sample;
pub(crate) use shard::{NO_SLOT, OpenRegion, Shard};
pub use tally::Tally;
pub use update::{Updated, VoxelUpdate};
pub use voxel_map::VoxelMap;
