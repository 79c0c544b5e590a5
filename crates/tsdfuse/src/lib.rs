//! Builds a 3D surface from LiDAR scans whose poses are known, and answers questions about it.
//!
//! Single scans are sparse and noisy, and each sees a part of the scene. This crate fuses any number of them into one truncated
//! signed distance field, a [`VoxelMap`]: [`Scan`]s go in, and a [`Mesh`], views, ray casts or distances come out, at any time.
//!
//! ```
//! use tsdfuse::{Integrator, MapConfig, Patch, Pose, Scan, VoxelMap, glam::{DVec3, Vec3}, mesh};
//!
//! let mut map = VoxelMap::new(MapConfig { voxel_size_m: 0.05, truncation_m: 0.20, ..Default::default() })?;
//! let mut method = Patch::default();
//!
//! // One scan: returns in the sensor frame (x forward, y left, z up), and where the sensor was.
//! let wall = (-30..30).flat_map(|y| (-20..20).map(move |z| Vec3::new(4.02, 0.03 * y as f32, 0.03 * z as f32)));
//! let scan = Scan { points: wall.collect(), pose: Some(Pose::IDENTITY), ..Default::default() };
//!
//! let done = method.integrate(&mut map, &scan)?; // which blocks changed, what was left out
//! assert!(!done.updated_blocks.is_empty());
//! let mesh = mesh::extract(&map)?;
//! assert!(mesh.vertices.iter().all(|v| (v.x - 4.02).abs() < 0.01));
//! let sample = map.sample(DVec3::new(4.0, 0.1, 0.1)).ok_or("nothing is known there")?;
//! assert!((sample.distance_m - 0.02).abs() < 0.003);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What goes in
//!
//! A [`Scan`] with its [`Pose`] and, where the sensor moved during the sweep, further poses ([`scan::PoseAt`], mostly from a
//! [`Trajectory`]); motion is undone. A [`SensorModel`] says what a rotating LiDAR's beams look like; without one it is guessed.
//! [`Scan::drop_invalid`] removes returns out of range: do so before fusing.
//!
//! # How it is fused
//!
//! By an [`Integrator`]: [`Patch`], the default and our own method, or [`Raycast`], [`Normals`], [`Surfels`], [`Cylindrical`],
//! [`Kuehner`], [`Depth`], [`Caminal`], [`Roldao`], by name [`Method`]. A method of your own can live in another crate, at the same
//! speed: see [`fuse`].
//!
//! # What comes out
//!
//! | question | answer |
//! |---|---|
//! | What is the surface? | [`mesh::extract`]; piece by piece, as the map grows: [`mesh::Incremental`] |
//! | How far is the nearest surface, in which direction, how certain? | [`VoxelMap::sample`], [`VoxelMap::sample_all`] |
//! | What was observed? | [`VoxelMap::voxels`], [`VoxelMap::blocks`], [`VoxelMap::bounds`] |
//! | What is in this box, as arrays? | [`VoxelMap::dense`] |
//! | What does a ray meet, what does a camera see? | [`Renderer::cast`], [`Renderer::view`] |
//! | What may a scan change? | [`Integrator::reach`] |
//!
//! `examples/` is a ladder of four pages to learn from.
//!
//! The crate reads no files; `tsdfuse-io` does. Work is spread over the threads of the current rayon pool, and the result does not
//! depend on their number, bit for bit.

pub mod eigen;
pub mod fuse;
pub mod imu;
pub mod index;
mod lanes;
pub mod map;
mod memory;
pub mod mesh;
pub mod normals;
mod patch;
pub mod pose;
pub mod raster;
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
pub use imu::{ImuSample, STANDARD_GRAVITY};
pub use map::{MapConfig, Sample, VoxelMap};
pub use mesh::Mesh;
pub use pose::Pose;
pub use reach::Reach;
pub use render::Renderer;
pub use scan::Scan;
pub use sensor::SensorModel;
pub use trajectory::Trajectory;

// The README's example is tested like the others.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
