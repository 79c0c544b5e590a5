//! Fusing scans into the map: one trait ([`Integrator`]), one file per method, two engines underneath.
//!
//! A method decides, for each return of a scan, which voxels are updated, with what signed distance and what weight. The rest is
//! shared. `placed` puts returns into the world and undoes motion. `cylinder` and `pierced` find the voxels near a line or on
//! it. Two engines find blocks, write updates and spread the work over threads: `lines` for the voxels along thin lines, `gather`
//! for everything else.
//!
//! # A method of your own
//!
//! All of this is public, so a method can live in another crate, at the same speed: implement [`Integrator`] with [`Placed`] for the
//! returns, and [`Lines`] with a [`Rule`], or [`Gather`], for the updates. Where speed does not matter,
//! [`VoxelMap::update`](crate::VoxelMap::update) takes voxels one by one. `examples/04_own_method.rs` is a complete method.

mod agreement;
mod beams;
mod caminal;
mod carve;
mod centers;
mod cylinder;
mod cylindrical;
mod depth;
mod engine;
mod gather;
mod integrator;
mod kuehner;
mod lines;
mod method;
mod normals;
mod patch;
pub mod pictures;
mod pierced;
mod placed;
mod raycast;
mod roldao;
mod settled;
mod surfel;
#[doc(hidden)]
pub mod twin;

pub use beams::{Beams, Rows, rings_of};
pub use caminal::{Caminal, CaminalConfig};
pub use cylinder::{EightVoxels, VOXEL_RADIUS};
pub use cylindrical::Cylindrical;
pub use depth::Depth;
pub use engine::Skip;
pub use gather::{Gather, Item, Items, Near, Updates};
pub use integrator::{FuseError, Integration, Integrator, Skipped};
pub use kuehner::{Kuehner, KuehnerConfig};
pub use lines::{Line, Lines, Planes, Rule, Shape};
pub use method::{FuseConfig, Method};
pub use normals::Normals;
pub use patch::{Patch, PatchConfig};
pub use placed::{MeasuredRay, Placed};
pub use raycast::{Distance, Raycast, RaycastConfig};
pub use roldao::{Roldao, RoldaoConfig, RoldaoForm};
pub use surfel::Surfels;
