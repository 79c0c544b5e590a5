//! What changed of a surface: a piece for each block.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::{Mesh, near::Place};
use crate::index::BlockIndex;

/// The surface within the cells of one block. It is self-contained: neighbouring pieces repeat the vertices on their common
/// border, with the same position and normal, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece<'a> {
    /// The block whose voxels are the first corners of the cells.
    pub block: BlockIndex,
    /// Vertex positions, world, metres. Empty if the block no longer has any surface.
    pub vertices: &'a [DVec3],
    /// Unit normals, one per vertex.
    pub normals: &'a [Vec3],
    /// Three vertex numbers per triangle, counting from the piece's first vertex.
    pub triangles: &'a [[u32; 3]],
}

/// The pieces of a surface that changed.
#[derive(Debug, Default)]
pub struct Changes {
    pub(super) chunks: Vec<Chunk>,
    /// Sorted by block.
    pub(super) entries: Vec<Entry>,
}

impl Changes {
    /// That these blocks, in this order, have no surface any more.
    pub fn gone(blocks: impl IntoIterator<Item = BlockIndex>) -> Self {
        let entry = |block| Entry {
            block,
            chunk: 0,
            vertices: 0..0,
            triangles: 0..0,
        };
        Self {
            chunks: vec![Chunk::default()],
            entries: blocks.into_iter().map(entry).collect(),
        }
    }

    /// The pieces, in the order of their blocks.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Piece<'_>> {
        self.entries.iter().map(|entry| {
            let mesh = &self.chunks[entry.chunk].mesh;
            Piece {
                block: entry.block,
                vertices: &mesh.vertices[entry.vertices.clone()],
                normals: &mesh.normals[entry.vertices.clone()],
                triangles: &mesh.triangles[entry.triangles.clone()],
            }
        })
    }

    /// Keeps only the pieces of blocks that are wanted.
    pub fn retain(&mut self, is_wanted: impl Fn(BlockIndex) -> bool) {
        self.entries.retain(|entry| is_wanted(entry.block));
    }

    /// How many pieces there are.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether nothing changed.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}

/// The pieces that one task made, one after another.
#[derive(Debug, Default)]
pub(super) struct Chunk {
    pub(super) mesh: Mesh,
    pub(super) entries: Vec<Entry>,
    /// For each entry's block: its place, and the blocks that its surface depends on.
    pub(super) sources: Vec<(Place, u32)>,
}

/// Where a piece is.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) block: BlockIndex,
    pub(super) chunk: usize,
    pub(super) vertices: Range<usize>,
    pub(super) triangles: Range<usize>,
}

impl Chunk {
    pub(super) fn clear(&mut self) {
        self.mesh.vertices.clear();
        self.mesh.normals.clear();
        self.mesh.triangles.clear();
        self.entries.clear();
        self.sources.clear();
    }
}
