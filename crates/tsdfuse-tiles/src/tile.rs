//! One tile, and how several tiles become a coarser one.

use std::fmt;
use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::index::Grid;
use tsdfuse::mesh::{CUBE_VOXELS, Weld, is_on_plane};
use tsdfuse_io::{atomic, glb};

use crate::bounds::Bounds;
use crate::error::Result;
use crate::simplify::simplified;
use crate::tileset::Node;

/// A tile has about this many triangles at most, unless more lie at its border: 1.2 MB.
const TRIANGLES: usize = 1 << 16;

/// In a tile with this diagonal, f32 resolves 1/2048 of a voxel. Larger tiles are not used at the finest level.
const FINE_VOXELS: f64 = 8192.0;

/// Voxels along the edge of a tile of level 0.
const FINEST_VOXELS: i64 = CUBE_VOXELS as i64 / 2;

/// What tells the colour of each vertex of a mesh.
pub type Coloring<'a> = dyn Fn(&Mesh) -> Vec<[u8; 3]> + Sync + 'a;

/// Where tiles are written, and their frame.
pub(crate) struct Place<'a> {
    pub(crate) folder: &'a Path,
    /// The origin of the tiles' positions, world, metres.
    pub(crate) origin: DVec3,
    pub(crate) grid: Grid,
    pub(crate) colors: Option<&'a Coloring<'a>>,
}

/// A cube of space: level l is divided into cubes of [`FINEST_VOXELS`]·2ˡ voxels.
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

/// A tile that is not written yet.
#[derive(Debug)]
pub(crate) struct Tile {
    cube: Cube,
    mesh: Mesh,
    /// The bounds of its surface at all levels, not only of this mesh, world.
    bounds: Bounds,
    /// Levels of tiles below it.
    height: u32,
    children: Vec<Node>,
}

impl Tile {
    /// A tile of the original surface; `None` if there is none.
    pub(crate) fn finest(cube: Cube, mesh: Mesh) -> Option<Self> {
        (!mesh.triangles.is_empty()).then(|| Self {
            cube,
            bounds: Bounds::of(&mesh.vertices),
            mesh,
            height: 0,
            children: Vec::new(),
        })
    }

    /// Joins the tiles in a cube into one. If that one is simplified, the others are written as its children.
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
        // The tolerances of all heights up to this one sum to less than its error.
        let tolerance_m = place.grid.voxel_size_m() * f64::from(height - 1).exp2();
        Ok(Some(Self {
            cube,
            mesh: simplified(&mesh, TRIANGLES, tolerance_m, at_border),
            bounds,
            height,
            children: tiles.into_iter().map(|tile| tile.write(place)).collect::<Result<_>>()?,
        }))
    }

    /// The largest distance between its mesh and the finest one, metres: the voxel size at its height, plus f32
    /// rounding.
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
        let colors = place.colors.map(|colors| colors(&mesh));
        mesh.vertices.iter_mut().for_each(|v| *v -= place.origin);
        let path = place.folder.join(&uri);
        match colors {
            Some(colors) => atomic::write(path, |out| glb::write_colored_to(out, &mesh, &colors))?,
            None => glb::write(path, &mesh)?,
        }
        Ok(Node::new(uri, &bounds.seen_from(place.origin), error_m, children))
    }
}
