//! Joining pieces of a surface: vertices with the same position become one.
//!
//! Every piece that shares a vertex computes it with the same bits ([`Piece`]), so the position identifies the vertex.

use std::io;

use glam::{DVec3, Vec3};
use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;

use super::{
    Mesh,
    changes::Piece,
    surface::{CUBE_VOXELS, Surface, is_on_plane},
};
use crate::index::Grid;

/// Numbers of vertices, by the bits of their positions.
#[derive(Debug, Default)]
struct Numbers(HashMap<[u64; 3], u32, FxBuildHasher>);

impl Numbers {
    /// The number of a vertex; `new` assigns it when the vertex is seen for the first time.
    fn of(&mut self, position: DVec3, new: impl FnOnce() -> u32) -> u32 {
        let key = position.to_array().map(f64::to_bits);
        *self.0.entry(key).or_insert_with(new)
    }
}

/// Joins parts of a surface into one mesh.
#[derive(Debug, Default)]
pub struct Weld {
    numbers: Numbers,
    mesh: Mesh,
}

impl Weld {
    /// Adds a part: positions (world, metres), one normal per position, and triangles that index them.
    pub fn add(&mut self, positions: &[DVec3], normals: &[Vec3], triangles: &[[u32; 3]]) {
        let Self { numbers, mesh } = self;
        let number = |(&position, &normal): (&DVec3, &Vec3)| {
            numbers.of(position, || {
                mesh.vertices.push(position);
                mesh.normals.push(normal);
                // Vertices are numbered with 32 bits, as those of the parts are.
                (mesh.vertices.len() - 1) as u32
            })
        };
        let numbers: Vec<u32> = positions.iter().zip(normals).map(number).collect();
        mesh.triangles.extend(renumbered(triangles, &numbers));
    }

    /// The mesh. Vertices and triangles are in the order in which they were added.
    pub fn finish(self) -> Mesh {
        self.mesh
    }
}

/// Triangles with the new numbers of their corners.
fn renumbered(triangles: &[[u32; 3]], numbers: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    let number = |v: u32| numbers.get(v as usize).copied().unwrap_or_default();
    triangles.iter().map(move |corners| corners.map(number))
}

/// Receives a mesh in parts.
pub trait MeshSink {
    /// Receives the next vertices (world, metres) with their normals.
    ///
    /// # Errors
    /// If they cannot be written.
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> io::Result<()>;

    /// Receives triangles between vertices that came before; vertices are numbered from 0 through all parts.
    ///
    /// # Errors
    /// If they cannot be written.
    fn triangles(&mut self, triangles: &[[u32; 3]]) -> io::Result<()>;
}

/// Sends a surface to `sink` as one mesh, which is never whole in memory. It is the mesh of [`super::extract_with`],
/// with its vertices and triangles in another order.
///
/// # Errors
/// As [`Surface::pieces`] and `sink`; also for more than 2³² vertices.
pub fn stitch(surface: &mut Surface<'_>, sink: &mut impl MeshSink) -> io::Result<()> {
    let mut stitcher = Stitcher::new(surface.grid());
    for cube in surface.cubes() {
        for piece in surface.pieces(cube)? {
            stitcher.add(&piece)?;
        }
        stitcher.finish_cube(sink)?;
    }
    Ok(())
}

/// Joins pieces cube by cube. From one cube to the next, it remembers only the vertices on the planes between cubes.
struct Stitcher {
    grid: Grid,
    /// Vertices that other cubes may share.
    shared: Numbers,
    /// The other vertices of this cube.
    own: Numbers,
    count: u32,
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Stitcher {
    fn new(grid: Grid) -> Self {
        Self {
            grid,
            shared: Numbers::default(),
            own: Numbers::default(),
            count: 0,
            positions: Vec::new(),
            normals: Vec::new(),
            triangles: Vec::new(),
        }
    }

    fn add(&mut self, piece: &Piece<'_>) -> io::Result<()> {
        let mut numbers = Vec::with_capacity(piece.vertices.len());
        for (&position, &normal) in piece.vertices.iter().zip(piece.normals) {
            let known = if is_on_plane(self.grid, position, CUBE_VOXELS.into()) {
                &mut self.shared
            } else {
                &mut self.own
            };
            let number = known.of(position, || {
                self.positions.push(position);
                self.normals.push(normal);
                self.count += 1;
                self.count - 1
            });
            numbers.push(number);
        }
        if self.count > u32::MAX - (1 << 20) {
            let told = "the surface has more vertices than one mesh can number";
            return Err(io::Error::other(told));
        }
        self.triangles.extend(renumbered(piece.triangles, &numbers));
        Ok(())
    }

    fn finish_cube(&mut self, sink: &mut impl MeshSink) -> io::Result<()> {
        sink.vertices(&self.positions, &self.normals)?;
        sink.triangles(&self.triangles)?;
        self.own.0.clear();
        self.positions.clear();
        self.normals.clear();
        self.triangles.clear();
        Ok(())
    }
}
