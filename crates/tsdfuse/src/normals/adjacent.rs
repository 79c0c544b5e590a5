//! The thesis's estimator: four triangles between a return and its four neighbours (5.4.2).

use glam::Vec3;

use super::{CANCELLED, Cloud, Normal, unit_sum};
use crate::sensor::approx::acos_f32;

/// The normal of a return, either side up; `None` without all four neighbours or without two similar triangles.
#[inline]
pub(super) fn normal(cloud: &Cloud, i: usize, min_dot: f32) -> Option<Normal> {
    let (ring, column) = cloud.image.place_of(i)?;
    let (left, right) = cloud.beside(column);
    let p = cloud.points[i];
    // Cyclic, so that neighbouring entries span the adjacent triangles [E3].
    let edges = [
        cloud.at(ring.checked_sub(1)?, column)? - p,
        cloud.at(ring, right)? - p,
        cloud.at(ring + 1, column)? - p,
        cloud.at(ring, left)? - p,
    ];
    // A triangle without area has a NaN normal, which is similar to none.
    let triangles: [Vec3; 4] = std::array::from_fn(|j| {
        let n = edges[j].cross(edges[(j + 1) % 4]);
        n / n.length()
    });
    let similar = |a: usize, b: usize| triangles[a].dot(triangles[b]) > min_dot;
    let pairs = [
        [similar(0, 1), similar(0, 2), similar(0, 3)],
        [similar(1, 2), similar(1, 3), similar(2, 3)],
    ];
    let [[s01, s02, s03], [s12, s13, s23]] = pairs;
    // N_S: those with at least one similar other.
    let chosen = [s01 | s02 | s03, s01 | s12 | s13, s02 | s12 | s23, s03 | s13 | s23];
    let mut sum = Vec3::ZERO;
    for (n, chosen) in triangles.iter().zip(chosen) {
        sum += if chosen { *n } else { Vec3::ZERO };
    }
    let normal = unit_sum(sum, CANCELLED)?; // (5.13)
    let mut angles = 0.0;
    for (n, chosen) in triangles.iter().zip(chosen) {
        angles += if chosen { acos_f32(n.dot(normal)) } else { 0.0 };
    }
    let agreement = (1.0 - angles / std::f32::consts::PI).max(0.0); // (5.17)
    Some(Normal { normal, agreement })
}
