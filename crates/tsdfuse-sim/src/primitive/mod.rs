//! Solids with exact surfaces: what scenes are made of.
//!
//! A [`Primitive`] is a shape in its own frame, placed by a [`Pose`] (`scene_from_local`). Each shape provides three things:
//! the signed distance from any point (positive outside), the point where a ray first enters it, and a triangle mesh with
//! all vertices on its surface. Distances are closed formulas, except for the ellipsoid's, which is a root found to rounding
//! error.

mod cuboid;
mod ellipsoid;
mod facets;
mod frustum;
mod prism;
mod ray;
mod solid;
mod terrain;

use glam::{DMat3, DVec2, DVec3};
use tsdfuse::Pose;

use cuboid::Cuboid;
use ellipsoid::Ellipsoid;
pub(crate) use facets::Facets;
use frustum::Frustum;
use prism::Prism;
pub(crate) use ray::{Aabb, Entry, Ray};
use solid::Solid;
pub use terrain::Terrain;

#[derive(Clone, Debug)]
enum Shape {
    Cuboid(Cuboid),
    Frustum(Frustum),
    Ellipsoid(Ellipsoid),
    Prism(Prism),
    Terrain(Box<Terrain>),
}

impl Shape {
    fn solid(&self) -> &dyn Solid {
        match self {
            Self::Cuboid(s) => s,
            Self::Frustum(s) => s,
            Self::Ellipsoid(s) => s,
            Self::Prism(s) => s,
            Self::Terrain(s) => s.as_ref(),
        }
    }
}

/// One solid of a scene.
///
/// Lengths given to the constructors are metres and positive; their sign is ignored.
///
/// ```
/// use glam::DVec3;
/// use tsdfuse_sim::{Pose, Primitive};
///
/// let ball = Primitive::ellipsoid(DVec3::splat(2.0)).placed(&Pose { translation: DVec3::X, ..Pose::IDENTITY });
/// assert_eq!(ball.signed_distance(DVec3::new(4.0, 0.0, 0.0)), 1.0);
/// ```
#[derive(Clone, Debug)]
pub struct Primitive {
    shape: Shape,
    scene_from_local: DMat3,
    centre: DVec3,
    reflectivity: f64,
}

impl Primitive {
    fn new(shape: Shape) -> Self {
        Self {
            shape,
            scene_from_local: DMat3::IDENTITY,
            centre: DVec3::ZERO,
            reflectivity: 0.4,
        }
    }

    /// A box of full edge lengths `size_m`, centred at the origin.
    pub fn cuboid(size_m: DVec3) -> Self {
        let half = size_m.abs() / 2.0;
        Self::new(Shape::Cuboid(Cuboid { half }))
    }

    /// A cone frustum around the z axis from z = 0, radius `bottom_m`, up to z = `height_m`, radius `top_m`; a cylinder where
    /// the radii are equal.
    pub fn frustum(bottom_m: f64, top_m: f64, height_m: f64) -> Self {
        let half = height_m.abs() / 2.0;
        let shape = Shape::Frustum(Frustum {
            bottom: bottom_m.abs(),
            top: top_m.abs(),
            half,
        });
        let raised = DVec3::Z * half;
        Self {
            centre: raised,
            ..Self::new(shape)
        }
    }

    /// A cone frustum between the centres of its ends; a cylinder where the radii are equal.
    pub fn tube(from: DVec3, to: DVec3, from_radius_m: f64, to_radius_m: f64) -> Self {
        let rotation = glam::DQuat::from_rotation_arc(DVec3::Z, (to - from).normalize_or(DVec3::Z));
        Self::frustum(from_radius_m, to_radius_m, from.distance(to)).placed(&Pose {
            rotation,
            translation: from,
        })
    }

    /// An ellipsoid with these half axes, centred at the origin; a sphere where they are equal.
    pub fn ellipsoid(half_axes_m: DVec3) -> Self {
        Self::new(Shape::Ellipsoid(Ellipsoid {
            axes: half_axes_m.abs(),
        }))
    }

    /// A simple polygon in the xy plane, either way round, extruded to `height_m` / 2 on both sides of z = 0.
    pub fn prism(outline_m: Vec<DVec2>, height_m: f64) -> Self {
        Self::new(Shape::Prism(Prism::new(outline_m, height_m.abs() / 2.0)))
    }

    /// A side view: a simple polygon of (x, z) points, extruded to `width_m` / 2 on both sides of y = 0.
    pub fn profile(outline_m: Vec<DVec2>, width_m: f64) -> Self {
        // Local (x, y, z) lie along scene (x, z, −y).
        let scene_from_local = DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y);
        Self {
            scene_from_local,
            ..Self::prism(outline_m, width_m)
        }
    }

    /// Sloping, undulating ground with steps across it.
    pub fn terrain(terrain: Terrain) -> Self {
        Self::new(Shape::Terrain(Box::new(terrain)))
    }

    /// The same solid moved by `scene_from_local`.
    #[must_use]
    pub fn placed(self, scene_from_local: &Pose) -> Self {
        Self {
            scene_from_local: DMat3::from_quat(scene_from_local.rotation) * self.scene_from_local,
            centre: scene_from_local.transform_point(self.centre),
            ..self
        }
    }

    /// The same solid shifted.
    #[must_use]
    pub fn at(self, x_m: f64, y_m: f64, z_m: f64) -> Self {
        Self {
            centre: self.centre + DVec3::new(x_m, y_m, z_m),
            ..self
        }
    }

    /// The same solid turned about the z axis through the origin, counter-clockwise from above.
    #[must_use]
    pub fn turned(self, yaw_rad: f64) -> Self {
        self.placed(&Pose {
            rotation: glam::DQuat::from_rotation_z(yaw_rad),
            ..Pose::IDENTITY
        })
    }

    /// The same solid with another share of light returned at normal incidence, 0 to 1.
    #[must_use]
    pub fn reflecting(self, reflectivity: f64) -> Self {
        Self { reflectivity, ..self }
    }

    /// The share of light returned at normal incidence, 0 to 1.
    pub fn reflectivity(&self) -> f64 {
        self.reflectivity
    }

    /// Distance from a point to the surface, metres: positive outside, negative inside.
    pub fn signed_distance(&self, point: DVec3) -> f64 {
        let local = self.scene_from_local.transpose_mul_vec3(point - self.centre);
        self.shape.solid().distance(local)
    }

    /// Where a ray of unit direction first enters the solid.
    pub(crate) fn enter(&self, origin: DVec3, direction: DVec3) -> Option<Entry> {
        // The ray starts abreast of the solid, so that a distant origin costs the shapes' quadratics no digits.
        let abreast = (self.centre - origin).dot(direction);
        let local = |v| self.scene_from_local.transpose_mul_vec3(v);
        let start = local(origin + direction * abreast - self.centre);
        let entry = self.shape.solid().enter(&Ray::new(start, local(direction), -abreast))?;
        Some(Entry {
            t: entry.t + abreast,
            normal: self.scene_from_local * entry.normal,
        })
    }

    pub(crate) fn bounds(&self) -> Aabb {
        let local = self.shape.solid().bounds();
        let (centre, half) = ((local.min + local.max) / 2.0, (local.max - local.min) / 2.0);
        let m = &self.scene_from_local;
        let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        let centre = self.centre + *m * centre;
        Aabb {
            min: centre - reach,
            max: centre + reach,
        }
    }

    pub(crate) fn facets(&self, chord_m: f64) -> Facets {
        let mut facets = Facets::default();
        self.shape.solid().tessellate(chord_m, &mut facets);
        for v in &mut facets.vertices {
            *v = self.centre + self.scene_from_local * *v;
        }
        for n in &mut facets.normals {
            *n = self.scene_from_local * *n;
        }
        facets
    }
}

#[cfg(test)]
mod tests;
