//! The thesis's estimator: four triangles between a return and its four neighbours (5.4.2).

use std::f32::consts::PI;

use glam::Vec3;

use super::cloud::{CANCELLED, Cloud, Normal};
use crate::lanes::{Floats, LANES, Mask, Vectors, lanes, select};
use crate::sensor::approx::acos_f32;

/// The normals of the returns from `first` on.
#[inline(always)]
pub(super) fn normals(cloud: &Cloud, first: usize, min_dot: f32, out: &mut [Normal]) {
    for (block, out) in out.chunks_mut(LANES).enumerate() {
        let first = first + block * LANES;
        let (mut edges, mut rays) = ([Vectors::ZERO; 4], Vectors::ZERO);
        for lane in 0..out.len() {
            let at_lane = edges_of(cloud, first + lane).unwrap_or([Vec3::ZERO; 4]);
            edges
                .iter_mut()
                .zip(at_lane)
                .for_each(|(edges, edge)| edges.set(lane, edge));
            rays.set(lane, cloud.ray(first + lane));
        }
        let (normals, agreements) = fuse_triangles(edges, rays, min_dot);
        for (lane, out) in out.iter_mut().enumerate() {
            *out = Normal {
                normal: normals.get(lane),
                agreement: agreements[lane],
            };
        }
    }
}

/// From a return to its four neighbours; cyclic, so that two after another span an adjacent triangle [E3].
#[inline(always)]
fn edges_of(cloud: &Cloud, i: usize) -> Option<[Vec3; 4]> {
    let (ring, column) = cloud.image.place_of(i)?;
    let (left, right) = cloud.beside(column);
    let p = cloud.points[i];
    Some([
        cloud.at(ring.checked_sub(1)?, column)? - p,
        cloud.at(ring, right)? - p,
        cloud.at(ring + 1, column)? - p,
        cloud.at(ring, left)? - p,
    ])
}

/// Normal towards the sensor and agreement; zero where no two triangles are similar.
#[inline(always)]
fn fuse_triangles(edges: [Vectors; 4], rays: Vectors, min_dot: f32) -> (Vectors, Floats) {
    // A triangle without area has a NaN normal, which is similar to none.
    let mut triangles = [Vectors::ZERO; 4];
    for (j, triangle) in triangles.iter_mut().enumerate() {
        let n = edges[j].cross(edges[(j + 1) % 4]);
        *triangle = n.scale(n.inverse_length());
    }
    let similar = |a: usize, b: usize| -> Mask {
        let dot = triangles[a].dot(triangles[b]);
        lanes(|l| dot[l] > min_dot)
    };
    let [s01, s02, s03] = [similar(0, 1), similar(0, 2), similar(0, 3)];
    let [s12, s13, s23] = [similar(1, 2), similar(1, 3), similar(2, 3)];
    // N_S: those with at least one similar other.
    let any = |a: Mask, b: Mask, c: Mask| -> Mask { lanes(|l| a[l] | b[l] | c[l]) };
    let chosen = [
        any(s01, s02, s03),
        any(s01, s12, s13),
        any(s02, s12, s23),
        any(s03, s13, s23),
    ];

    let mut sum = Vectors::ZERO;
    for (triangle, chosen) in triangles.iter().zip(chosen) {
        sum = sum.add(triangle.select(chosen));
    }
    let inverse = sum.inverse_length();
    // None chosen, or all cancel: 1/0 is too large too.
    let found: Mask = lanes(|l| inverse[l] < 1.0 / CANCELLED);
    let normals = sum.scale(inverse).select(found); // (5.13)

    let mut angles = [0.0; LANES];
    for (triangle, chosen) in triangles.iter().zip(chosen) {
        let dot = triangle.dot(normals);
        let angle = select(chosen, lanes(|l| acos_f32(dot[l])));
        angles = lanes(|l| angles[l] + angle[l]);
    }
    let agreements = lanes(|l| (1.0 - angles[l] / PI).max(0.0)); // (5.17)

    let away = normals.dot(rays);
    let facing = normals.scale(lanes(|l| if away[l] > 0.0 { -1.0 } else { 1.0 })); // [E4]
    (facing, select(found, agreements))
}
