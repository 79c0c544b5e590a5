//! Holz and Behnke's estimator: a mesh of quads without long edges (5.4.1).

use glam::Vec3;

use super::{Cloud, Normal, unit_sum};
use crate::sensor::approx::acos_f32;

/// A face is a corner of a quad of returns: no smaller area, m², has a direction.
const SMALLEST_AREA: f32 = 1e-12;

/// The normal of a return, either side up; `None` if it belongs to no quad.
pub(super) fn normal(cloud: &Cloud, i: usize) -> Option<Normal> {
    let (ring, column) = cloud.image.place_of(i)?;
    let (left, _) = cloud.beside(column);
    let mut faces = [None; 4];
    for (k, face_of) in faces.iter_mut().enumerate() {
        let lower = if k < 2 { Some(ring) } else { ring.checked_sub(1) };
        *face_of = lower.and_then(|lower| face(cloud, lower, if k % 2 == 0 { column } else { left }));
    }
    let faces = || faces.iter().flatten();
    let normal = unit_sum(faces().sum(), SMALLEST_AREA)?; // (5.12)
    let angles: f32 = faces().map(|f| acos_f32(f.dot(normal) / f.length())).sum();
    let agreement = (1.0 - angles / std::f32::consts::PI).max(0.0); // (5.17)
    Some(Normal { normal, agreement })
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
