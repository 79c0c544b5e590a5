//! Meshes in the colours of their distances to a reference.

use tsdfuse::Mesh;
use tsdfuse_eval::{Reference, color};

/// The colour of each vertex's distance to the reference: dark blue at 0, yellow from `max_error_m` on.
pub fn by_distance(mesh: &Mesh, reference: &Reference, max_error_m: f64) -> Vec<[u8; 3]> {
    let distances = reference.distances(&mesh.vertices).into_iter();
    distances
        .map(|distance_m| color::of_distance(distance_m, max_error_m))
        .collect()
}
