//! PLY, the Stanford polygon format: meshes are written and read, point clouds are read.
//!
//! Read are `ascii`, `binary_little_endian` and `binary_big_endian` with any elements in any order. A point cloud's
//! `vertex` properties mean what [`columns`](crate::columns) says; of a mesh, positions, normals and faces are read, faces
//! with more than three corners as fans of triangles.

mod body;
mod cloud;
mod header;
mod mesh;
mod stream;
mod write;

pub use cloud::parse as parse_cloud;
pub use mesh::{parse as parse_mesh, read as read_mesh};
pub use stream::Stream;
pub(crate) use write::{has_normals, in_chunks, one_color_each};
pub use write::{write, write_colored_to, write_to, write_vertices};

#[cfg(test)]
mod tests;
