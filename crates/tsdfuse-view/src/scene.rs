//! What is shown, and beside it.

use serde::Serialize;
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

/// What is shown beside the surface.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// The page's title.
    pub title: String,
    /// Where the sensor was, in order, world, metres.
    pub path: Vec<DVec3>,
    /// Names and values, as people read them.
    pub figures: Vec<(String, String)>,
}

/// A mesh and what is known of its vertices beside their place.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Its vertices, with normals, and triangles; world, metres.
    pub mesh: &'a Mesh,
    /// What is known of its vertices.
    pub paint: Paint<'a>,
}

/// What is known of each vertex; what is empty is not known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Paint<'a> {
    /// sRGB.
    pub colors: &'a [[u8; 3]],
    /// Numbers, each with its values.
    pub channels: &'a [(Channel, &'a [f32])],
}

impl<'a> Surface<'a> {
    /// A mesh of which nothing else is known.
    pub fn of(mesh: &'a Mesh) -> Self {
        let paint = Paint::default();
        Self { mesh, paint }
    }
}

/// Gives a mesh without normals those of its triangles: the mean of the triangles around each vertex, weighted by area.
pub fn add_normals(mesh: &mut Mesh) {
    if mesh.normals.len() == mesh.vertices.len() {
        return;
    }
    let mut sums = vec![DVec3::ZERO; mesh.vertices.len()];
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|v| mesh.vertices[v as usize]);
        let twice_area = (b - a).cross(c - a);
        corners.iter().for_each(|&v| sums[v as usize] += twice_area);
    }
    mesh.normals = sums.iter().map(|sum| sum.normalize_or(DVec3::Z).as_vec3()).collect();
}

/// A number that each vertex has.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Channel {
    /// Its name in lower case.
    pub name: String,
    /// Its unit; may be empty.
    pub unit: String,
    /// The values that the first and the last colour show; 255 steps lie between them.
    pub low: f32,
    /// See `low`.
    pub high: f32,
    /// How it is shown.
    pub ramp: Ramp,
    /// Whether it is what the page shows first.
    pub first: bool,
}

/// Colours of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Ramp {
    /// Black to white.
    Grey,
    /// Blue over green to red.
    Turbo,
}

impl Channel {
    /// A value in 256 steps.
    pub(crate) fn quantised(&self, value: f32) -> u8 {
        (((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0) * 255.0 + 0.5) as u8
    }
}
