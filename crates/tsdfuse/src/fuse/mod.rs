//! Fusing scans into the map: one trait ([`Integrator`]), one file per method, two engines underneath.
//!
//! A method decides, for each return of a scan, which voxels are updated, with what signed distance and what weight. The rest is
//! shared. `placed` puts returns into the world and undoes motion. `cylinder` and `pierced` find the voxels near a line or on
//! it. Two engines find blocks, write updates and spread the work over threads: `lines` for the voxels along thin lines, `gather`
//! for everything else.

mod beams;
mod caminal;
mod carve;
mod centers;
mod cylinder;
mod cylindrical;
mod depth;
mod gather;
mod integrator;
mod kuehner;
mod lines;
mod method;
mod normals;
mod patch;
mod pierced;
mod placed;
mod raycast;
mod roldao;
mod surfel;
#[doc(hidden)]
pub mod twin;

pub use beams::{Beams, rings_of};
pub use caminal::{Caminal, CaminalConfig};
pub use cylindrical::Cylindrical;
pub use depth::Depth;
pub use integrator::{FuseError, Integration, Integrator, Skipped};
pub use kuehner::{Kuehner, KuehnerConfig};
pub use method::{FuseConfig, Method};
pub use normals::Normals;
pub use patch::{Patch, PatchConfig};
pub use raycast::{Distance, Raycast, RaycastConfig};
pub use roldao::{Roldao, RoldaoConfig, RoldaoForm};
pub use surfel::Surfels;
