//! One tile, and how several become one that is coarser.

use std::fmt;
use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::index::Grid;
use tsdfuse_io::glb;
use tsdfuse_store::{CUBE_VOXELS, Weld, is_on_plane};

use crate::bounds::Bounds;
use crate::error::Result;
use crate::simplify::simplified;
use crate::tileset::Node;

/// A tile has about so many triangles at most (unless more lie at its border): 1.2 MB.
const TRIANGLES: usize = 1 << 16;

/// In a tile of this diagonal, positions in f32 are 1/2048 of a voxel apart: larger ones are not for the finest level.
const FINE_VOXELS: f64 = 8192.0;

/// Voxels along the edge of a tile of level 0.
const FINEST_VOXELS: i64 = CUBE_VOXELS as i64 / 2;

/// What tiles are written with.
#[derive(Debug)]
pub(crate) struct Place<'a> {
    pub(crate) folder: &'a Path,
    /// What positions are relative to, world, metres.
    pub(crate) origin: DVec3,
    pub(crate) grid: Grid,
}

/// Which cube of space: level l is divided into cubes of [`FINEST_VOXELS`]·2ˡ voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cube {
    pub(crate) level: u32,
    pub(crate) index: IVec3,
}

impl fmt::Display for Cube {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let IVec3 { x, y, z } = self.index;
        write!(f, "{}_{x}_{y}_{z}", self.level)
    }
}

/// A tile that is not yet written.
#[derive(Debug)]
pub(crate) struct Tile {
    cube: Cube,
    mesh: Mesh,
    /// Of all of its surface, not only of this mesh, world.
    bounds: Bounds,
    /// Tiles below it, one below the other.
    height: u32,
    children: Vec<Node>,
}

impl Tile {
    /// Of the surface as it is; `None` if there is none.
    pub(crate) fn finest(cube: Cube, mesh: Mesh) -> Option<Self> {
        (!mesh.triangles.is_empty()).then(|| Self {
            cube,
            bounds: Bounds::of(&mesh.vertices),
            mesh,
            height: 0,
            children: Vec::new(),
        })
    }

    /// Makes one tile of those that lie in a cube, and writes them if it does not show all that they show.
    pub(crate) fn join(cube: Cube, mut tiles: Vec<Self>, place: &Place<'_>) -> Result<Option<Self>> {
        if tiles.len() < 2 {
            return Ok(tiles.pop());
        }
        let mut weld = Weld::default();
        for Mesh {
            vertices,
            normals,
            triangles,
        } in tiles.iter().map(|tile| &tile.mesh)
        {
            weld.add(vertices, normals, triangles);
        }
        let mesh = weld.finish();
        let bounds = tiles.iter().fold(Bounds::NONE, |all, tile| all.with(&tile.bounds));
        let is_small = bounds.diagonal_m() <= FINE_VOXELS * place.grid.voxel_size_m();
        if is_small && mesh.triangles.len() <= TRIANGLES && tiles.iter().all(|tile| tile.children.is_empty()) {
            return Ok(Self::finest(cube, mesh));
        }
        let height = 1 + tiles.iter().map(|tile| tile.height).max().unwrap_or_default();
        let edge = FINEST_VOXELS << cube.level;
        let at_border = |v| is_on_plane(place.grid, v, edge);
        // The tolerances of all heights up to this one add up to less than its error.
        let tolerance_m = place.grid.voxel_size_m() * f64::from(height - 1).exp2();
        Ok(Some(Self {
            cube,
            mesh: simplified(&mesh, TRIANGLES, tolerance_m, at_border),
            bounds,
            height,
            children: tiles.into_iter().map(|tile| tile.write(place)).collect::<Result<_>>()?,
        }))
    }

    /// How far its mesh is from the finest one at most, metres: the voxels of its height, and what f32 loses.
    fn error_m(&self, grid: Grid) -> f64 {
        match self.height {
            0 => 0.0,
            height => {
                grid.voxel_size_m() * f64::from(height).exp2() + self.bounds.diagonal_m() * f64::from(f32::EPSILON)
            }
        }
    }

    /// How many vertices and triangles its mesh has.
    pub(crate) fn counts(&self) -> (usize, usize) {
        (self.mesh.vertices.len(), self.mesh.triangles.len())
    }

    /// Its box, world.
    pub(crate) fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Writes its mesh.
    pub(crate) fn write(self, place: &Place<'_>) -> Result<Node> {
        let error_m = self.error_m(place.grid);
        let Self {
            cube,
            mut mesh,
            bounds,
            children,
            ..
        } = self;
        let uri = format!("{cube}.glb");
        mesh.vertices.iter_mut().for_each(|v| *v -= place.origin);
        glb::write(place.folder.join(&uri), &mesh)?;
        Ok(Node::new(uri, &bounds.seen_from(place.origin), error_m, children))
    }
}
