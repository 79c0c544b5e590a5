//! Triangle meshes, and their extraction from the map.

use glam::{DVec3, Vec3};

/// An indexed triangle mesh in world coordinates.
///
/// Triangles are counter-clockwise seen from free space (the sensor's side); normals point there too.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, world, metres.
    pub vertices: Vec<DVec3>,
    /// Unit normals, one per vertex.
    pub normals: Vec<Vec3>,
    /// Three vertex numbers per triangle.
    pub triangles: Vec<[u32; 3]>,
}
