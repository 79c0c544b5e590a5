//! The triangles of a mesh lined up by their area.

use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use crate::triangle;

/// The triangles of a mesh, lined up by their area.
pub(super) struct ByArea<'a> {
    mesh: &'a Mesh,
    /// The summed area up to the end of each triangle, m².
    ends_m2: Vec<f64>,
}

impl<'a> ByArea<'a> {
    pub(super) fn of(mesh: &'a Mesh) -> Self {
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

    pub(super) fn total_m2(&self) -> f64 {
        self.ends_m2.last().copied().unwrap_or(0.0)
    }

    /// Point `i` of `count`.
    pub(super) fn point(&self, i: usize, count: usize) -> Option<DVec3> {
        let at = (i as f64 + 0.5) / count as f64 * self.total_m2();
        let t = self.ends_m2.partition_point(|&end| end <= at);
        let [a, b, c] = corners(self.mesh, self.mesh.triangles.get(t)?);
        // Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018: powers of 1 / the plastic number.
        let [u, v] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3].map(|step| (0.5 + step * i as f64).fract());
        let root = u.sqrt();
        Some(a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v))
    }
}

pub(crate) fn corners(mesh: &Mesh, triangle: &[u32; 3]) -> [DVec3; 3] {
    triangle.map(|v| mesh.vertices[v as usize])
}
