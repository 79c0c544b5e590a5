//! Vertices that are one, found by their positions.

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

/// Numbers of vertices by the bits of their positions: parts of one surface have a common vertex with the same bits.
#[derive(Debug, Default)]
pub(crate) struct Numbers(HashMap<[u64; 3], u32, FxBuildHasher>);

impl Numbers {
    /// The number of a vertex, which `new` tells the first time.
    pub(crate) fn of(&mut self, position: DVec3, new: impl FnOnce() -> u32) -> u32 {
        let key = position.to_array().map(f64::to_bits);
        *self.0.entry(key).or_insert_with(new)
    }

    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }
}

/// Makes one mesh of parts of a surface.
#[derive(Debug, Default)]
pub struct Weld {
    numbers: Numbers,
    mesh: Mesh,
}

impl Weld {
    /// Adds a part: positions (world, metres), a normal of each, and triangles that count from its first vertex.
    pub fn add(&mut self, positions: &[DVec3], normals: &[Vec3], triangles: &[[u32; 3]]) {
        let Self { numbers, mesh } = self;
        let number = |(&position, &normal): (&DVec3, &Vec3)| {
            numbers.of(position, || {
                mesh.vertices.push(position);
                mesh.normals.push(normal);
                // A mesh is numbered with 32 bits, as its parts are.
                (mesh.vertices.len() - 1) as u32
            })
        };
        let numbers: Vec<u32> = positions.iter().zip(normals).map(number).collect();
        mesh.triangles.extend(renumbered(triangles, &numbers));
    }

    /// The mesh: vertices and triangles in the order in which they came.
    pub fn finish(self) -> Mesh {
        self.mesh
    }
}

/// Triangles by the new numbers of their corners.
pub(crate) fn renumbered(triangles: &[[u32; 3]], numbers: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    let number = |v: u32| numbers.get(v as usize).copied().unwrap_or_default();
    triangles.iter().map(move |corners| corners.map(number))
}
