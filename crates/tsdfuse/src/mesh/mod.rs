//! Triangle meshes, and their extraction from the map by marching cubes.

mod changes;
mod cube;
mod distances;
mod extract;
mod incremental;
mod mesher;
pub(crate) mod near;
mod nearby;
pub(crate) mod neighbourhood;
#[cfg(test)]
mod oracle;
pub(crate) mod signs;
mod surface;
pub mod triangle;
mod updated;
mod weld;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

pub use changes::{Changes, Piece};
pub use cube::triangles as cube_triangles;
pub use extract::{extract, extract_with};
pub use incremental::Incremental;
pub use nearby::Nearby;
pub use surface::{CUBE_VOXELS, RegionSource, Surface, is_on_plane};
pub use weld::{MeshSink, Weld, stitch};

use crate::map::min_weight_sum;

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

/// Which voxels become surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MeshConfig {
    /// Voxels with less weight count as unobserved.
    pub min_weight: f32,
}

impl Default for MeshConfig {
    fn default() -> Self {
        Self { min_weight: 0.0 }
    }
}

impl MeshConfig {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`MeshError`] names the field and its value.
    pub fn validate(&self) -> Result<(), MeshError> {
        if self.min_weight >= 0.0 && self.min_weight.is_finite() {
            Ok(())
        } else {
            Err(MeshError::MinWeight(self.min_weight))
        }
    }

    /// Voxels with a smaller weight sum count as never observed. (No weight sum is beyond an i32.)
    pub fn min_weight_sum(self) -> i32 {
        min_weight_sum(self.min_weight).clamp(1, i32::MAX as u32) as i32
    }
}

/// Why there is no mesh.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// A weight is 0 or more.
    #[error("min_weight must be 0 or more, not {0}")]
    MinWeight(f32),
    /// Vertices are numbered with 32 bits.
    #[error("the surface has {0} vertices, more than one mesh can number: extract it in parts")]
    TooManyVertices(u64),
}

/// The topology of a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Edges with a triangle on one side only.
    pub border_edges: usize,
    /// Edges that more than two triangles share.
    pub overused_edges: usize,
    /// Edges whose two triangles run along them in the same direction: orientation flips there.
    pub flipped_edges: usize,
    /// Vertices in no triangle.
    pub unused_vertices: usize,
    /// Vertices at the position of another one.
    pub duplicate_vertices: usize,
    /// Triangles with a vertex twice.
    pub degenerate_triangles: usize,
}

impl Topology {
    /// Each edge between one or two triangles that agree in orientation, every vertex used and unique.
    pub fn is_manifold(&self) -> bool {
        Self {
            border_edges: 0,
            ..*self
        } == Self::default()
    }

    /// Manifold without borders.
    pub fn is_closed(&self) -> bool {
        *self == Self::default()
    }
}

impl Mesh {
    /// Examines edges and vertices. This takes a few sorts.
    pub fn topology(&self) -> Topology {
        let mut topology = Topology::default();
        for edge in self.sorted_edges().chunk_by(same_edge) {
            match edge {
                [_] => topology.border_edges += 1,
                [a, b] => topology.flipped_edges += usize::from(a.2 == b.2),
                _ => topology.overused_edges += 1,
            }
        }
        let mut used = vec![false; self.vertices.len()];
        self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        topology.unused_vertices = used.iter().filter(|u| !**u).count();
        topology.degenerate_triangles = self
            .triangles
            .iter()
            .filter(|[a, b, c]| a == b || b == c || c == a)
            .count();
        let mut positions: Vec<[u64; 3]> = self.vertices.iter().map(|v| v.to_array().map(f64::to_bits)).collect();
        positions.sort_unstable();
        topology.duplicate_vertices = positions.windows(2).filter(|w| w[0] == w[1]).count();
        topology
    }

    /// The edges with a triangle on one side only, as pairs of vertices.
    pub fn border_edges(&self) -> Vec<[u32; 2]> {
        let edges = self.sorted_edges();
        edges
            .chunk_by(same_edge)
            .filter(|e| e.len() == 1)
            .map(|e| [e[0].0, e[0].1])
            .collect()
    }

    /// Lower vertex, higher vertex, and whether the triangle runs from the lower to the higher, for each side of each triangle.
    fn sorted_edges(&self) -> Vec<(u32, u32, bool)> {
        let sides = self.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let mut edges: Vec<_> = sides.map(|(a, b)| (a.min(b), a.max(b), a < b)).collect();
        edges.sort_unstable();
        edges
    }
}

fn same_edge(a: &(u32, u32, bool), b: &(u32, u32, bool)) -> bool {
    (a.0, a.1) == (b.0, b.1)
}
