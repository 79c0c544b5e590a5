//! PLY, the Stanford polygon format: meshes are written and read, point clouds are read.

mod write;

pub use write::{write, write_to};
