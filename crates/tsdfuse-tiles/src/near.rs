//! Whether points lie near a mesh.

use rayon::prelude::*;
use rstar::{AABB, PointDistance, RTree, RTreeObject};
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;
use tsdfuse::mesh::triangle::{area, closest_on};

/// Whether a triangle of the mesh is no farther from each of `points` than this. No point is near a mesh without area.
pub(crate) fn are_within(mesh: &Mesh, points: &[DVec3], distance_m: f64) -> Vec<bool> {
    let triangles = mesh
        .triangles
        .iter()
        .map(|t| Triangle(t.map(|v| mesh.vertices[v as usize])));
    let triangles: Vec<Triangle> = triangles.collect();
    let area_m2: f64 = triangles.iter().map(|t| area(t.0)).sum();
    if !(area_m2 > 0.0) {
        return vec![false; points.len()];
    }
    let tree = RTree::bulk_load(triangles);
    let is_within = |p: &DVec3| {
        let mut within = tree.locate_within_distance(p.to_array(), distance_m * distance_m);
        within.next().is_some()
    };
    points.par_iter().map(is_within).collect()
}

struct Triangle([DVec3; 3]);

impl RTreeObject for Triangle {
    type Envelope = AABB<[f64; 3]>;

    fn envelope(&self) -> Self::Envelope {
        let [a, b, c] = self.0;
        AABB::from_bounds(a.min(b).min(c).to_array(), a.max(b).max(c).to_array())
    }
}

impl PointDistance for Triangle {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let point = DVec3::from(*point);
        closest_on(self.0, point).distance_squared(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_without_area_is_near_nothing() {
        let mesh = |height: f64| Mesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::new(0.0, height, 0.0)],
            normals: Vec::new(),
            triangles: vec![[0, 1, 2]],
        };
        let points = [DVec3::new(0.2, 0.1, 0.4), DVec3::new(0.2, 0.1, -0.6)];
        assert_eq!(are_within(&mesh(1.0), &points, 0.5), [true, false]);
        assert_eq!(are_within(&mesh(0.0), &points, 0.5), [false, false]);
        assert_eq!(are_within(&Mesh::default(), &points, 0.5), [false, false]);
    }
}
