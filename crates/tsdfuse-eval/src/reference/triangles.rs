//! The nearest triangle of a mesh.

use rstar::{AABB, PointDistance, RTree, RTreeObject};
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use super::coherent;
use crate::sample::corners;
use crate::triangle::closest_on;

/// An R-tree over triangles of any size.
#[derive(Debug)]
pub(crate) struct TriangleTree(RTree<Triangle>);

impl TriangleTree {
    /// Builds the tree of a valid mesh.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let triangles = mesh.triangles.iter().map(|t| Triangle(corners(mesh, t)));
        Self(RTree::bulk_load(triangles.collect()))
    }

    /// The distance from each of `points` to the nearest triangle, metres.
    pub(crate) fn distances(&self, points: &[DVec3]) -> Vec<f64> {
        let distance = |p: DVec3| {
            let nearest = self.0.nearest_neighbor_with_distance_2(p.to_array());
            nearest.map_or(f64::INFINITY, |(_, squared)| squared.sqrt())
        };
        coherent::answers(points, distance)
    }

    /// Whether each of `points` has a triangle at most this far away.
    pub(crate) fn are_within(&self, points: &[DVec3], distance_m: f64) -> Vec<bool> {
        let is_within = |p: DVec3| {
            let within = self.0.locate_within_distance(p.to_array(), distance_m * distance_m);
            within.take(1).count() > 0
        };
        coherent::answers(points, is_within)
    }
}

#[derive(Debug)]
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
