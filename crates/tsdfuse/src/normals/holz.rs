//! Holz and Behnke's estimator: a mesh of quads without long edges (5.4.1).

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use super::cloud::{Cloud, Normal};
use crate::sensor::approx::acos_f32;

/// A face is a corner of a quad of returns: no smaller area, m², has a direction.
const SMALLEST_AREA: f32 = 1e-12;

/// The faces of the mesh, by the cell of their lower left corner; zero where there is none.
pub(super) fn faces(cloud: &Cloud) -> Vec<Vec3> {
    let columns = cloud.image.columns();
    let cells = (0..cloud.image.rings() * columns).into_par_iter().with_min_len(2048);
    let faces = cells.map(|cell| face(cloud, cell / columns, cell % columns).unwrap_or(Vec3::ZERO));
    faces.collect()
}

/// The normals of the returns from `first` on.
pub(super) fn normals(cloud: &Cloud, faces: &[Vec3], first: usize, out: &mut [Normal]) {
    for (i, out) in (first..).zip(out) {
        *out = normal(cloud, faces, i).unwrap_or_default();
    }
}

/// The normal of a return; `None` if it belongs to no face.
fn normal(cloud: &Cloud, faces: &[Vec3], i: usize) -> Option<Normal> {
    let (ring, column) = cloud.image.place_of(i)?;
    let (left, _) = cloud.beside(column);
    let of = |ring: usize, column: usize| faces.get(ring * cloud.image.columns() + column).copied();
    let below = |column: usize| of(ring.checked_sub(1)?, column);
    let around = [of(ring, column), of(ring, left), below(column), below(left)].map(Option::unwrap_or_default);
    let sum: Vec3 = around.iter().sum();
    // Also false for NaN.
    if !(sum.length() > SMALLEST_AREA) {
        return None;
    }
    let normal = sum.normalize(); // (5.12)
    let angle = |face: Vec3| match face.length() {
        0.0 => 0.0,
        area => acos_f32(face.dot(normal) / area),
    };
    let angles: f32 = around.into_iter().map(angle).sum();
    let away = normal.dot(cloud.ray(i)) > 0.0;
    Some(Normal {
        normal: if away { -normal } else { normal }, // [E4]
        agreement: (1.0 - angles / PI).max(0.0),     // (5.17)
    })
}

/// The face between a ring and the next and between a column and the next: the cross product of two of its edges, if all
/// four edges are short enough.
fn face(cloud: &Cloud, ring: usize, column: usize) -> Option<Vec3> {
    let (_, right) = cloud.beside(column);
    let corner = |ring, column| {
        let i = cloud.image.get(ring, column)?;
        Some((*cloud.points.get(i)?, cloud.ray(i).length()))
    };
    let (a, b) = (corner(ring, column)?, corner(ring, right)?);
    let (c, d) = (corner(ring + 1, column)?, corner(ring + 1, right)?);
    let within = cloud.image.column_width_tangent();
    let between = cloud.image.ring_gap_tangent(ring);
    let valid = is_short(a, b, within) && is_short(c, d, within) && is_short(a, c, between) && is_short(b, d, between);
    let face = (b.0 - a.0).cross(c.0 - a.0);
    (valid && face.length() > SMALLEST_AREA).then_some(face)
}

/// (5.9)–(5.11): whether two returns (with their ranges, the shorter of which counts) may be of one surface.
fn is_short(a: (Vec3, f32), b: (Vec3, f32), tangent: f32) -> bool {
    let limit = std::f32::consts::SQRT_2 * a.1.min(b.1) * tangent;
    a.0.distance_squared(b.0) <= limit * limit
}
