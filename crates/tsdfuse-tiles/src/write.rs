//! From the surface of a map to a folder of tiles.

use std::path::Path;
use std::{fs, io};

use rayon::prelude::*;
use serde::Serialize;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::mesh::{CUBE_VOXELS, MeshConfig, Surface, Weld};
use tsdfuse_io::Error;
use tsdfuse_io::atomic::{self, Folder};

use crate::error::{Result, TilesError};
use crate::tile::{Coloring, Cube, Place, Tile};
use crate::tileset::Tileset;

/// The level at which at most eight tiles, those around the origin, cover any map.
const TOP: u32 = 27;

/// What was written.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Written {
    /// Number of tiles; each is a file beside `tileset.json`.
    pub tiles: usize,
    /// Depth of the tree of tiles.
    pub levels: usize,
    /// Vertices of the finest tiles; shared vertices count once per tile.
    pub vertices: usize,
    /// Triangles of the finest tiles, which are the triangles of the whole surface.
    pub triangles: usize,
    /// Total size of all files.
    pub bytes: u64,
}

/// Checks before the work begins whether tiles can be written for this `…/tileset.json`. Returns their folder.
///
/// # Errors
/// [`TilesError::File`] unless the folder is empty or does not exist yet.
pub fn check(tileset: &Path) -> Result<&Path> {
    let folder = tileset.parent().filter(|folder| folder.file_name().is_some());
    let own = "tiles are written into a folder of their own: NAME/tileset.json";
    let folder = folder.ok_or_else(|| Error::dataset(tileset, own))?;
    atomic::check_folder(folder)?;
    Ok(folder)
}

/// Writes a surface as 3D Tiles: `tileset` (`NAME/tileset.json`) and the tiles beside it. The folder appears once it is
/// complete.
///
/// # Errors
/// As [`check`]; [`TilesError::Surface`] if the map cannot be read, [`TilesError::NoSurface`] if it has no surface,
/// [`TilesError::File`] if a file cannot be written.
pub fn write(tileset: &Path, surface: &mut Surface<'_>) -> Result<Written> {
    write_with(tileset, surface, None)
}

/// As [`write()`], with a colour (sRGB) for each vertex: `colors` tells those of a mesh whose vertices lie in the world.
///
/// # Errors
/// As [`write()`].
pub fn write_colored(tileset: &Path, surface: &mut Surface<'_>, colors: &Coloring<'_>) -> Result<Written> {
    write_with(tileset, surface, Some(colors))
}

fn write_with(tileset: &Path, surface: &mut Surface<'_>, colors: Option<&Coloring<'_>>) -> Result<Written> {
    let folder = Folder::begin(check(tileset)?)?;
    let mut cubes = surface.cubes();
    let config = *surface.config();
    let mut writer = Writer {
        place: Place {
            folder: folder.path(),
            origin: middle(&cubes, surface.grid().voxel_size_m()),
            grid: surface.grid(),
            colors,
        },
        surface,
        written: Written::default(),
    };
    let root = writer.tile(TOP, &mut cubes)?;
    let Writer { place, mut written, .. } = writer;
    let root = root.ok_or(no_surface(&config))?;
    let size_m = root.bounds().diagonal_m();
    let root = root.write(&place)?;
    (written.tiles, written.levels) = root.count();
    let tiles = Tileset::new(root, place.origin, size_m);
    let name = tileset.file_name().unwrap_or_default();
    atomic::write(folder.path().join(name), |out| Ok(serde_json::to_writer(out, &tiles)?))?;
    written.bytes = bytes(folder.path()).map_err(Error::io(folder.path()))?;
    folder.finish()?;
    Ok(written)
}

/// Total size of a folder's files.
fn bytes(folder: &Path) -> io::Result<u64> {
    fs::read_dir(folder)?.map(|entry| Ok(entry?.metadata()?.len())).sum()
}

fn no_surface(config: &MeshConfig) -> TilesError {
    TilesError::NoSurface {
        min_weight: config.min_weight,
    }
}

/// The centre of some cubes, rounded to whole metres, world.
fn middle(cubes: &[IVec3], voxel_size_m: f64) -> DVec3 {
    let first = cubes.iter().copied().reduce(IVec3::min).unwrap_or_default();
    let last = cubes.iter().copied().reduce(IVec3::max).unwrap_or_default();
    let edge_m = f64::from(CUBE_VOXELS) * voxel_size_m;
    ((first.as_dvec3() + last.as_dvec3() + 1.0) / 2.0 * edge_m).round()
}

/// Where tiles come from and where they go.
struct Writer<'a, 'b> {
    surface: &'a mut Surface<'b>,
    place: Place<'a>,
    written: Written,
}

impl Writer<'_, '_> {
    /// The tile of some of the surface's cubes, all within one cube of this level; `None` if they have no surface.
    fn tile(&mut self, level: u32, cubes: &mut [IVec3]) -> Result<Option<Tile>> {
        let Some(first) = cubes.first() else { return Ok(None) };
        let index = *first >> (level - 1);
        let child_of = |cube: IVec3| cube >> (level - 2);
        let tiles = if level == 2 {
            // Extracted one after the other, each on all threads; simplified in parallel.
            let finest: Vec<_> = cubes.iter().map(|cube| self.finest(*cube)).collect::<Result<_>>()?;
            let join = |(&index, tiles)| Tile::join(Cube { level: 1, index }, tiles, &self.place);
            cubes.par_iter().zip(finest).map(join).collect::<Result<Vec<_>>>()?
        } else {
            cubes.sort_by_key(|cube| {
                let child = child_of(*cube);
                (child.z, child.y, child.x)
            });
            let children = cubes.chunk_by_mut(|a, b| child_of(*a) == child_of(*b));
            children
                .map(|cubes| self.tile(level - 1, cubes))
                .collect::<Result<Vec<_>>>()?
        };
        Tile::join(
            Cube { level, index },
            tiles.into_iter().flatten().collect(),
            &self.place,
        )
    }

    /// The finest tiles of a cube.
    fn finest(&mut self, cube: IVec3) -> Result<Vec<Tile>> {
        let mut parts: [Weld; 8] = Default::default();
        let index = |part: usize| (cube << 1) + IVec3::new(part as i32 & 1, part as i32 >> 1 & 1, part as i32 >> 2);
        for piece in self.surface.pieces(cube).map_err(TilesError::Surface)? {
            let half: IVec3 = (piece.block.0 >> 4) & 1;
            let part = half.x | half.y << 1 | half.z << 2;
            parts[part as usize & 7].add(piece.vertices, piece.normals, piece.triangles);
        }
        let tiles = parts.into_iter().enumerate().filter_map(|(part, weld)| {
            let index = index(part);
            Tile::finest(Cube { level: 0, index }, weld.finish())
        });
        let tiles: Vec<Tile> = tiles.collect();
        for tile in &tiles {
            let (vertices, triangles) = tile.counts();
            self.written.vertices += vertices;
            self.written.triangles += triangles;
        }
        Ok(tiles)
    }
}
