//! A scene: solids, their exact signed distance, rays, and the true mesh.

use glam::DVec3;
use tsdfuse::Mesh;

use crate::bvh::Bvh;
use crate::primitive::{Aabb, Primitive};

/// A union of solids in the world.
///
/// Outside all solids the signed distance is exact; where solids overlap, the inside distance is that of the deepest one, a
/// lower bound of the depth.
///
/// ```
/// use glam::DVec3;
/// use tsdfuse_sim::scene;
///
/// let sphere = scene::by_name("sphere", 0).unwrap();
/// let hit = sphere.cast(DVec3::new(-5.0, 0.0, 0.0), DVec3::X).unwrap();
/// assert_eq!(hit.range_m, 3.0);
/// assert_eq!(sphere.signed_distance(DVec3::new(0.0, 2.5, 0.0)), 0.5);
/// ```
#[derive(Clone, Debug)]
pub struct Scene {
    name: String,
    bvh: Bvh,
    /// The origin of the solids' common frame in the world.
    offset: DVec3,
}

/// Where a ray meets a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Metres from the ray's origin.
    pub range_m: f64,
    /// Unit normal of the surface, towards free space.
    pub normal: DVec3,
    /// The index of the solid in [`Scene::primitives`].
    pub primitive: usize,
}

impl Scene {
    /// A scene from its solids.
    pub fn new(name: impl Into<String>, primitives: Vec<Primitive>) -> Self {
        Self {
            name: name.into(),
            bvh: Bvh::new(primitives),
            offset: DVec3::ZERO,
        }
    }

    /// The scene's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same scene moved by `offset_m`, as from local to UTM coordinates. Scans taken along the scene's paths are the same
    /// bit for bit.
    #[must_use]
    pub fn translated(self, offset_m: DVec3) -> Self {
        Self {
            offset: self.offset + offset_m,
            ..self
        }
    }

    /// The offset by which [`Scene::translated`] has moved it, metres.
    pub fn offset_m(&self) -> DVec3 {
        self.offset
    }

    /// Its solids, placed in the scene before [`Scene::translated`].
    pub fn primitives(&self) -> &[Primitive] {
        self.bvh.primitives()
    }

    /// Distance from a point in the world to the nearest surface, metres: positive in free space, negative in a solid.
    pub fn signed_distance(&self, point: DVec3) -> f64 {
        self.bvh.signed_distance(point - self.offset)
    }

    /// Where a ray (world coordinates) first enters a solid; the direction need not be a unit vector. Solids around the
    /// origin are not seen from inside.
    pub fn cast(&self, origin: DVec3, direction: DVec3) -> Option<Hit> {
        self.cast_local(origin - self.offset, direction.try_normalize()?)
    }

    /// [`Scene::cast`] in the frame of the solids, for a unit direction.
    pub(crate) fn cast_local(&self, origin: DVec3, direction: DVec3) -> Option<Hit> {
        let (entry, primitive) = self.bvh.cast(origin, direction)?;
        Some(Hit {
            range_m: entry.t,
            normal: entry.normal,
            primitive,
        })
    }

    /// The box around all solids before [`Scene::translated`].
    pub(crate) fn bounds(&self) -> Aabb {
        self.bvh.bounds()
    }

    /// The true surface: every vertex lies on it, and it is nowhere farther than `chord_m` from the triangles of its solid.
    ///
    /// Triangles that lie wholly within another solid are left out; those that are partly buried stay whole.
    pub fn mesh(&self, chord_m: f64) -> Mesh {
        let mut mesh = Mesh::default();
        for primitive in self.primitives() {
            let facets = primitive.facets(chord_m);
            let mut number = vec![u32::MAX; facets.vertices.len()];
            for triangle in &facets.triangles {
                let corners = triangle.map(|v| facets.vertices[v as usize]);
                if self.buried(corners) {
                    continue;
                }
                mesh.triangles.push(triangle.map(|v| {
                    let (old, new) = (v as usize, &mut number[v as usize]);
                    if *new == u32::MAX {
                        *new = mesh.vertices.len() as u32;
                        mesh.vertices.push(facets.vertices[old] + self.offset);
                        mesh.normals.push(facets.normals[old].as_vec3());
                    }
                    *new
                }));
            }
        }
        mesh
    }

    /// Whether a triangle is certainly inside a solid, since a ball around it is.
    fn buried(&self, corners: [DVec3; 3]) -> bool {
        let centroid = corners.iter().sum::<DVec3>() / 3.0;
        let reach = corners.iter().map(|c| c.distance(centroid)).fold(0.0, f64::max);
        self.bvh.signed_distance(centroid) < -reach
    }
}
