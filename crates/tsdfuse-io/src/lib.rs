//! Readers of LiDAR logs and writers of meshes.

pub mod dataset;
pub mod error;

pub use dataset::{OpenOptions, ScanRef, Source};
pub use error::{Error, Result};
