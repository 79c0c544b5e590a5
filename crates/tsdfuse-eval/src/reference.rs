//! References that a mesh is compared with.

mod cloud;
mod coherent;
mod triangles;

use std::sync::OnceLock;

use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use crate::error::{EvalError, Result};
use crate::sample;

pub use crate::bounds::Bounds;
pub(crate) use cloud::CloudTree;
pub(crate) use triangles::TriangleTree;

/// Coordinates beyond this, metres, count as errors: the Earth is smaller.
pub const MAX_COORDINATE_M: f64 = 1e8;

/// A cloud or a mesh that measures the distances of points from it.
#[derive(Debug)]
pub struct Reference {
    shape: Shape,
    bounds: Bounds,
    /// The points at which completeness is measured, if not those of the cloud.
    observed: Option<Vec<DVec3>>,
    left_out: usize,
}

#[derive(Debug)]
enum Shape {
    Cloud {
        points: Vec<DVec3>,
        tree: OnceLock<CloudTree>,
    },
    Mesh {
        mesh: Mesh,
        tree: OnceLock<TriangleTree>,
    },
}

impl Reference {
    /// A cloud: distances are to the nearest point. Points that are not finite are left out and counted.
    ///
    /// # Errors
    /// If no point is left, or there are too many to be numbered.
    pub fn cloud(points: Vec<DVec3>) -> Result<Self> {
        let (points, left_out) = finite(points)?;
        let bounds = Bounds::of(&points).ok_or(EvalError::NoPoints)?;
        let tree = OnceLock::new();
        Ok(Self {
            shape: Shape::Cloud { points, tree },
            bounds,
            observed: None,
            left_out,
        })
    }

    /// A mesh: distances are to the nearest point of any triangle. Triangles that are not finite are left out and counted.
    ///
    /// # Errors
    /// If it has no area, or a triangle with a corner that is not a vertex.
    pub fn mesh(mesh: Mesh) -> Result<Self> {
        let (mesh, left_out) = sound("reference", mesh)?;
        let used: Vec<DVec3> = mesh
            .triangles
            .iter()
            .flatten()
            .map(|&v| mesh.vertices[v as usize])
            .collect();
        let bounds = Bounds::of(&used).ok_or(EvalError::NoTriangles("reference"))?;
        let tree = OnceLock::new();
        Ok(Self {
            shape: Shape::Mesh { mesh, tree },
            bounds,
            observed: None,
            left_out,
        })
    }

    /// Measures completeness at these points only, for instance at those points of a true surface that a sensor has seen.
    ///
    /// # Errors
    /// As [`Reference::cloud`].
    pub fn with_observed(mut self, points: Vec<DVec3>) -> Result<Self> {
        let (points, left_out) = finite(points)?;
        self.observed = Some(points);
        self.left_out += left_out;
        Ok(self)
    }

    /// The distance from each point to the reference, metres: to its nearest point, or to the nearest point of any triangle.
    pub fn distances(&self, points: &[DVec3]) -> Vec<f64> {
        match &self.shape {
            Shape::Cloud { points: cloud, tree } => tree.get_or_init(|| CloudTree::new(cloud)).distances(points),
            Shape::Mesh { mesh, tree } => tree.get_or_init(|| TriangleTree::new(mesh)).distances(points),
        }
    }

    /// Whether each point is at most this far from the reference. Faster than [`Reference::distances`].
    pub fn are_within(&self, points: &[DVec3], distance_m: f64) -> Vec<bool> {
        match &self.shape {
            Shape::Cloud { .. } => self.distances(points).iter().map(|d| *d <= distance_m).collect(),
            Shape::Mesh { mesh, tree } => {
                let tree = tree.get_or_init(|| TriangleTree::new(mesh));
                tree.are_within(points, distance_m)
            }
        }
    }

    /// The box around the reference.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Its kind, for messages: `cloud` or `mesh`.
    pub fn kind(&self) -> &'static str {
        match self.shape {
            Shape::Cloud { .. } => "cloud",
            Shape::Mesh { .. } => "mesh",
        }
    }

    /// The points at which completeness is measured: the observed ones or the cloud's; `None` for a mesh without observed
    /// points.
    pub fn points(&self) -> Option<&[DVec3]> {
        match (&self.observed, &self.shape) {
            (Some(observed), _) => Some(observed),
            (None, Shape::Cloud { points, .. }) => Some(points),
            (None, Shape::Mesh { .. }) => None,
        }
    }

    /// The mesh, if it is one.
    pub fn as_mesh(&self) -> Option<&Mesh> {
        match &self.shape {
            Shape::Mesh { mesh, .. } => Some(mesh),
            Shape::Cloud { .. } => None,
        }
    }

    /// How many points or triangles were left out because they are not finite.
    pub fn left_out(&self) -> usize {
        self.left_out
    }
}

fn is_sound(p: DVec3) -> bool {
    p.abs().max_element() <= MAX_COORDINATE_M && !p.is_nan()
}

/// The valid points, and the number of invalid ones.
fn finite(mut points: Vec<DVec3>) -> Result<(Vec<DVec3>, usize)> {
    let all = points.len();
    points.retain(|&p| is_sound(p));
    match points.len() {
        0 if all == 0 => Err(EvalError::NoPoints),
        0 => Err(EvalError::NoFinitePoints(all)),
        // The trees number points with 32 bits.
        n if n >= u32::MAX as usize => Err(EvalError::TooManyPoints(n)),
        n => Ok((points, all - n)),
    }
}

/// Checks that all corners are vertices. Returns the mesh without invalid triangles, and the number of these.
pub(crate) fn sound(of: &'static str, mut mesh: Mesh) -> Result<(Mesh, usize)> {
    let all = mesh.triangles.len();
    if all == 0 {
        return Err(EvalError::NoTriangles(of));
    }
    let vertices = mesh.vertices.len();
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        if let Some(&corner) = corners.iter().find(|&&v| v as usize >= vertices) {
            return Err(EvalError::Corner {
                of,
                triangle,
                corner,
                vertices,
            });
        }
    }
    let Mesh {
        vertices, triangles, ..
    } = &mut mesh;
    triangles.retain(|t| t.iter().all(|&v| is_sound(vertices[v as usize])));
    let left_out = all - mesh.triangles.len();
    if sample::area_m2(&mesh) > 0.0 {
        Ok((mesh, left_out))
    } else {
        Err(EvalError::NoArea(of, all))
    }
}

#[cfg(test)]
mod tests;
