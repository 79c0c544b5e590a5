//! What every shape provides.

use glam::DVec3;

use super::facets::Facets;
use super::ray::{Aabb, Entry, Ray};

/// A shape in its own frame. All lengths are metres.
pub(super) trait Solid {
    /// Signed distance, exact inside and outside.
    fn distance(&self, p: DVec3) -> f64;
    /// The first crossing into the solid beyond `ray.from`.
    fn enter(&self, ray: &Ray) -> Option<Entry>;
    /// The box that holds it.
    fn bounds(&self) -> Aabb;
    /// Adds triangles whose vertices lie on the surface and which deviate from it by at most `chord_m`.
    fn tessellate(&self, chord_m: f64, out: &mut Facets);
}
