//! Points on a mesh, spread evenly over its area. Always the same ones for the same mesh.

mod poisson;

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

pub use poisson::poisson_disk;

use crate::triangle;

/// `count` points, one per equal share of the area: in the order of the triangles, within a triangle by Roberts's R2
/// sequence. None for a mesh without area.
pub fn uniform(mesh: &Mesh, count: usize) -> Vec<DVec3> {
    let area = ByArea::of(mesh);
    (0..count)
        .into_par_iter()
        .filter_map(|i| area.point(i, count))
        .collect()
}

/// The triangles of a mesh along the line of their summed area.
struct ByArea<'a> {
    mesh: &'a Mesh,
    /// Where each triangle ends, m².
    ends_m2: Vec<f64>,
}

impl<'a> ByArea<'a> {
    fn of(mesh: &'a Mesh) -> Self {
        let ends = mesh.triangles.iter().scan(0.0, |sum, t| {
            let area = triangle::area(corners(mesh, t));
            *sum += if area.is_finite() { area } else { 0.0 };
            Some(*sum)
        });
        Self {
            mesh,
            ends_m2: ends.collect(),
        }
    }

    fn total_m2(&self) -> f64 {
        self.ends_m2.last().copied().unwrap_or(0.0)
    }

    /// Point `i` of `count`.
    fn point(&self, i: usize, count: usize) -> Option<DVec3> {
        let at = (i as f64 + 0.5) / count as f64 * self.total_m2();
        let t = self.ends_m2.partition_point(|&end| end <= at);
        let [a, b, c] = corners(self.mesh, self.mesh.triangles.get(t)?);
        // Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018: powers of 1 / the plastic number.
        let [u, v] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3].map(|step| (0.5 + step * i as f64).fract());
        let root = u.sqrt();
        Some(a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v))
    }
}

/// The area of a mesh, m²; triangles that are not finite count nothing.
pub fn area_m2(mesh: &Mesh) -> f64 {
    ByArea::of(mesh).total_m2()
}

pub(crate) fn corners(mesh: &Mesh, triangle: &[u32; 3]) -> [DVec3; 3] {
    triangle.map(|v| mesh.vertices[v as usize])
}

#[cfg(test)]
pub(crate) mod tests;
