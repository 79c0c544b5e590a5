//! A piece of a surface, on its way from Python.

use glam::{DVec3, IVec3};
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::Piece;

/// A piece of a surface, on its way from Python.
pub(crate) struct OwnPiece {
    pub(crate) block: IVec3,
    pub(crate) vertices: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl OwnPiece {
    pub(crate) fn as_piece(&self) -> Piece<'_> {
        Piece {
            block: BlockIndex(self.block),
            vertices: &self.vertices,
            normals: &[],
            triangles: &self.triangles,
        }
    }
}
