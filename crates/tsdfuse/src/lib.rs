//! Dense 3D reconstruction from LiDAR: [`Scan`]s with poses go in, a truncated signed distance field ([`VoxelMap`]) grows, and
//! a [`Mesh`] comes out, at any time.
//!
//! ```
//! use tsdfuse::{Integrator, MapConfig, Patch, Pose, Scan, VoxelMap, glam::Vec3, mesh};
//!
//! let mut map = VoxelMap::new(MapConfig { voxel_size_m: 0.05, truncation_m: 0.20, ..Default::default() })?;
//! let mut fuser = Patch::default();
//!
//! // One scan: returns in the sensor frame (x forward, y left, z up), and where the sensor was.
//! let wall = (-30..30).flat_map(|y| (-20..20).map(move |z| Vec3::new(4.0, 0.03 * y as f32, 0.03 * z as f32)));
//! let scan = Scan { points: wall.collect(), pose: Some(Pose::IDENTITY), ..Default::default() };
//!
//! let done = fuser.integrate(&mut map, &scan)?; // which blocks changed, what was left out
//! assert!(!done.updated_blocks.is_empty());
//! let mesh = mesh::extract(&map)?;
//! assert!(mesh.vertices.iter().all(|v| (v.x - 4.0).abs() < 0.01));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The types to know: [`Scan`] (with [`Pose`] and [`scan::PoseAt`], by which movement during the sweep is undone), [`Trajectory`],
//! [`VoxelMap`], the trait [`Integrator`] with one type per method ([`Patch`], [`Raycast`], [`Normals`], …; by name: [`fuse::Method`]),
//! [`Mesh`], and [`SensorModel`] for what a rotating LiDAR's beams look like.
//!
//! The crate reads no files; `tsdfuse-io` does. The work is spread over the threads of the current rayon pool, and the
//! result does not depend on their number, bit for bit.

mod eigen;
pub mod fuse;
pub mod index;
mod lanes;
pub mod map;
mod memory;
pub mod mesh;
pub mod normals;
mod patch;
pub mod pose;
pub mod reach;
pub mod render;
pub mod scan;
pub mod sensor;
pub mod surfel;
pub mod trajectory;
mod trilinear;

pub use fearless_simd;
pub use fuse::{
    Caminal, Cylindrical, Depth, FuseConfig, Integration, Integrator, Kuehner, Method, Normals, Patch, Raycast, Roldao,
    Surfels,
};
pub use glam;
pub use map::{MapConfig, Sample, VoxelMap};
pub use mesh::Mesh;
pub use pose::Pose;
pub use reach::Reach;
pub use render::Renderer;
pub use scan::Scan;
pub use sensor::SensorModel;
pub use trajectory::Trajectory;
