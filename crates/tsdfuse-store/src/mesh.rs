//! The surface of a whole map as one mesh, which is never whole in memory.
//!
//! A vertex is worked out by every piece that has it, with the same bits ([`tsdfuse::mesh::Piece`]), so its position tells which ones
//! are one. Only those on the border between cubes have to be remembered from cube to cube.

use std::io;

use tsdfuse::VoxelMap;
use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::index::Grid;
use tsdfuse::mesh::{MeshConfig, Piece};

use crate::error::Result;
use crate::pager::Pager;
use crate::surface::{CUBE_VOXELS, Surface, is_on_plane};
use crate::weld::{Numbers, renumbered};

/// Who takes a mesh, part by part.
pub trait Sink {
    /// Takes vertices that come next (world, metres), with their normals.
    ///
    /// # Errors
    /// What keeps it from that.
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> io::Result<()>;

    /// Takes triangles between vertices that came before, numbered from 0 through all parts.
    ///
    /// # Errors
    /// What keeps it from that.
    fn triangles(&mut self, triangles: &[[u32; 3]]) -> io::Result<()>;
}

impl Pager {
    /// Extracts the surface of the whole map, which is the one of [`tsdfuse::mesh::extract_with`], its vertices and triangles in another
    /// order. There is no more of the map in memory than else.
    ///
    /// # Errors
    /// As [`Pager::bring`], and what `sink` says; also for more than 2³² vertices.
    pub fn mesh(&mut self, map: &mut VoxelMap, config: &MeshConfig, sink: &mut impl Sink) -> Result<()> {
        let mut stitcher = Stitcher::new(map.grid());
        let mut surface = Surface::paged(map, self, config);
        for cube in surface.cubes() {
            for piece in surface.pieces(cube)? {
                stitcher.add(&piece)?;
            }
            stitcher.finish_cube(sink)?;
        }
        Ok(())
    }
}

/// Puts pieces together.
struct Stitcher {
    grid: Grid,
    /// Of vertices that other cubes may have, too; and of this cube's other ones.
    shared: Numbers,
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

    fn add(&mut self, piece: &Piece<'_>) -> Result<()> {
        let mut numbers = Vec::with_capacity(piece.vertices.len());
        for (&position, &normal) in piece.vertices.iter().zip(piece.normals) {
            let known = match is_on_plane(self.grid, position, CUBE_VOXELS.into()) {
                true => &mut self.shared,
                false => &mut self.own,
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
            return Err(io::Error::other("the surface has more vertices than one mesh can number").into());
        }
        self.triangles.extend(renumbered(piece.triangles, &numbers));
        Ok(())
    }

    fn finish_cube(&mut self, sink: &mut impl Sink) -> Result<()> {
        sink.vertices(&self.positions, &self.normals)?;
        sink.triangles(&self.triangles)?;
        self.own.clear();
        self.positions.clear();
        self.normals.clear();
        self.triangles.clear();
        Ok(())
    }
}
