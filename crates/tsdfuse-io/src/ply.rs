//! PLY, the Stanford polygon format: reads and writes meshes, reads point clouds.
//!
//! The readers accept `ascii`, `binary_little_endian` and `binary_big_endian`, with any elements in any order.
//! [`columns`](crate::columns) says what the `vertex` properties of a point cloud mean. Of a mesh, positions, normals and faces are
//! read; a face with more than three corners becomes a fan of triangles.

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
