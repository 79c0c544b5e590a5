//! Readers of LiDAR logs and depth images, and writers of meshes and pictures.
//!
//! [`open`] recognises what lies at a path and gives a [`Dataset`]: scans with poses, read ahead in the background.
//! [`mesh::write`] and [`png::write`] write what was made of them; [`geometry::read`] reads a mesh or a cloud.

pub mod atomic;
mod bin;
mod calib;
mod cloud;
pub mod clouds;
pub mod columns;
pub mod dataset;
pub mod error;
mod files;
pub mod folder;
#[doc(hidden)]
pub mod fuzzing;
pub mod geometry;
pub mod glb;
pub mod kitti;
pub mod kitti_raw;
pub mod map_file;
pub mod mesh;
pub mod npz;
pub mod obj;
pub mod pandaset;
mod pcd;
mod pickle;
pub mod plain;
pub mod ply;
pub mod png;
pub mod poses;
pub mod read_ahead;
pub mod rgbd;
mod scalar;
mod text;
mod times;
#[cfg(feature = "zarr")]
pub mod zarr;

pub use cloud::Cloud;
pub use dataset::{Dataset, OpenOptions, ScanRef, Source, open, open_with};
pub use error::{Error, Result};
pub use read_ahead::{ReadAhead, ReadScan};
