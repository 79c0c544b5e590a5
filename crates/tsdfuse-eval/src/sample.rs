//! Samples a mesh: points spread evenly over its area, always the same ones for the same mesh.

mod area;
mod poisson;

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use area::ByArea;
pub(crate) use area::corners;
pub use poisson::poisson_disk;

/// `count` points, one for each equal share of the area, in the order of the triangles; within a triangle they follow Roberts's
/// R2 sequence. Empty for a mesh without area.
pub fn uniform(mesh: &Mesh, count: usize) -> Vec<DVec3> {
    let area = ByArea::of(mesh);
    (0..count)
        .into_par_iter()
        .filter_map(|i| area.point(i, count))
        .collect()
}

/// The area of a mesh, m², without triangles that are not finite.
pub fn area_m2(mesh: &Mesh) -> f64 {
    ByArea::of(mesh).total_m2()
}

#[cfg(test)]
pub(crate) mod tests;
