//! Triangles of one solid.

use std::f64::consts::TAU;

use glam::DVec3;

/// Triangles, counter-clockwise seen from outside, with a normal at each vertex.
#[derive(Clone, Debug, Default)]
pub(crate) struct Facets {
    pub(crate) vertices: Vec<DVec3>,
    pub(crate) normals: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Facets {
    /// Adds a vertex and returns its number.
    pub(crate) fn vertex(&mut self, position: DVec3, normal: DVec3) -> u32 {
        self.vertices.push(position);
        self.normals.push(normal);
        self.vertices.len() as u32 - 1
    }

    /// Adds a plane convex polygon, counter-clockwise seen from its normal's side.
    pub(crate) fn polygon(&mut self, corners: &[DVec3], normal: DVec3) {
        let first = self.vertices.len() as u32;
        for &corner in corners {
            self.vertex(corner, normal);
        }
        let fan = (1..corners.len().saturating_sub(1) as u32).map(|i| [first, first + i, first + i + 1]);
        self.triangles.extend(fan);
    }
}

/// How many chords a full circle needs so that none is farther than `chord_m` from it: 8 to 4096, a multiple of four.
///
/// A chord over the angle a leaves the circle by r (1 − cos a/2).
pub(crate) fn chords(radius_m: f64, chord_m: f64) -> u32 {
    let half_angle = (1.0 - (chord_m / radius_m).clamp(1e-7, 0.5)).acos();
    let n = (TAU / (2.0 * half_angle)).ceil() as u32;
    n.clamp(8, 4096).next_multiple_of(4)
}
