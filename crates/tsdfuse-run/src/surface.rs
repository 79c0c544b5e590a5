//! Surfaces and maps as files.

use std::path::Path;
use std::time::Instant;

use tsdfuse::VoxelMap;
use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::mesh::{Mesh, MeshConfig, MeshSink, Surface, extract_with};
use tsdfuse_io::ply;
use tsdfuse_store::PagedMap;
use tsdfuse_view::{Scene, page};

use crate::error::{Result, RunError};
use crate::intensity;
use crate::layers::{Layers, Painting};
use crate::paint::Painted;
use crate::report::{ColorReport, MeshReport, SavedMap};

/// Whether a surface is to be written as 3D Tiles: `NAME/tileset.json`.
pub fn is_tileset(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"))
}

/// Whether a surface can be written to such a file: `.ply`, `.glb`, `.obj`, `.html`, `NAME/tileset.json`, or `-` for standard output.
///
/// # Errors
/// [`RunError::Config`] names what is possible.
pub fn check(path: &Path) -> Result<()> {
    if is_tileset(path) {
        return tiles::check(path);
    }
    if path.as_os_str() == "-" || page::is_page(path) {
        return Ok(());
    }
    tsdfuse_io::mesh::check(path)
        .map_err(|error| RunError::config(format_args!("{error}, as .html, or as NAME/tileset.json")))
}

/// Whether colours can be written to such a file.
///
/// # Errors
/// [`RunError::Config`] names what is possible.
pub fn check_painted(path: &Path) -> Result<()> {
    if is_tileset(path) {
        return tiles::check(path);
    }
    if page::is_page(path) {
        return Ok(());
    }
    tsdfuse_io::mesh::check_colored(path)
        .map_err(|error| RunError::config(format_args!("{error}, as .html, or as NAME/tileset.json")))
}

/// Whether [`write_in_parts`] can write to such a file.
///
/// # Errors
/// [`RunError::Config`] names what is possible.
pub fn check_in_parts(path: &Path) -> Result<()> {
    let is_ply = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
    if is_ply || is_tileset(path) || page::is_page(path) {
        return check(path);
    }
    Err(RunError::config(
        "a mesh that comes in parts is written as a .ply file, a .html file or as NAME/tileset.json",
    ))
}

/// Extracts the surface of a map, which must not be empty, and writes it; `scene` is what a page shows beside it.
///
/// # Errors
/// [`RunError::Nothing`] for a map without surface; if the file cannot be written.
pub fn write(map: &VoxelMap, config: &MeshConfig, path: &Path, scene: &Scene) -> Result<MeshReport> {
    write_by(
        || Ok(extract_with(map, config)?),
        map,
        config,
        path,
        scene,
        &Layers::default(),
    )
}

/// As [`write()`], where something else extracts the mesh of the map, and with what layers tell of it.
///
/// # Errors
/// As [`write()`], and what `extract` says.
pub fn write_by(
    extract: impl FnOnce() -> Result<Mesh>,
    map: &VoxelMap,
    config: &MeshConfig,
    path: &Path,
    scene: &Scene,
    layers: &Layers,
) -> Result<MeshReport> {
    if is_tileset(path) {
        return tiles::write(path, &mut Surface::new(map, config), layers);
    }
    write_mesh(extract, map.block_count(), config, path, scene, layers)
}

/// Writes one mesh file, of a map of so many blocks.
pub(crate) fn write_mesh(
    extract: impl FnOnce() -> Result<Mesh>,
    blocks: usize,
    config: &MeshConfig,
    path: &Path,
    scene: &Scene,
    layers: &Layers,
) -> Result<MeshReport> {
    let start = Instant::now();
    let mesh = extract()?;
    if mesh.triangles.is_empty() {
        return Err(RunError::Nothing(format!(
            "the map has no surface: {blocks} blocks, but no triangle with a weight of {} or more",
            config.min_weight
        )));
    }
    let seconds = start.elapsed().as_secs_f64();
    if !layers.is_empty() && check_painted(path).is_ok() {
        let report = write_painted(&mesh, &layers.painting(&mesh), path, scene)?;
        return Ok(MeshReport { seconds, ..report });
    }
    if page::is_page(path) {
        page::write(path, scene, &tsdfuse_view::Surface::of(&mesh))?;
    } else {
        tsdfuse_io::mesh::write(path, &mesh)?;
    }
    Ok(MeshReport {
        path: path.to_owned(),
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        seconds,
        write_seconds: start.elapsed().as_secs_f64() - seconds,
        ..MeshReport::default()
    })
}

/// Writes a mesh that was extracted from a map, with what is known of its vertices, as `.ply`, `.glb` or `.html`. Formats that have
/// only colours show intensities as greys, where there are no colours.
///
/// # Errors
/// [`RunError::Nothing`] for a mesh without triangles; if the file cannot be written.
pub fn write_painted(mesh: &Mesh, painting: &Painting, path: &Path, scene: &Scene) -> Result<MeshReport> {
    if mesh.triangles.is_empty() {
        return Err(RunError::Nothing("the map has no surface".to_owned()));
    }
    let start = Instant::now();
    let colors = painting.colors.as_ref().map(|painted| painted.colors.as_slice());
    if page::is_page(path) {
        painting.with(mesh, |surface| page::write(path, scene, surface))?;
    } else {
        let greys = || painting.intensities.as_deref().map(intensity::greys);
        let colors = colors.map(<[_]>::to_vec).or_else(greys).unwrap_or_default();
        if colors.is_empty() {
            tsdfuse_io::mesh::write(path, mesh)?;
        } else {
            tsdfuse_io::mesh::write_colored(path, mesh, &colors)?;
        }
    }
    let color = |painted: &Painted| ColorReport {
        images: painted.images,
        vertices: painted.seen,
    };
    Ok(MeshReport {
        path: path.to_owned(),
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        write_seconds: start.elapsed().as_secs_f64(),
        color: painting.colors.as_ref().map(color),
        ..MeshReport::default()
    })
}

/// Extracts the surface of a paged map, which must not be empty, and writes it. The triangles are those of [`write()`], in
/// another order. For a page, the whole mesh is in memory, though not the map.
///
/// # Errors
/// As [`write()`]; if the store cannot be read.
pub fn write_in_parts(map: &mut PagedMap, config: &MeshConfig, path: &Path, scene: &Scene) -> Result<MeshReport> {
    write_in_parts_with(map, config, path, scene, &Layers::default())
}

/// As [`write_in_parts`], with what layers tell of the surface; then the whole mesh is in memory, unless it becomes tiles.
///
/// # Errors
/// As [`write_in_parts`].
pub fn write_in_parts_with(
    map: &mut PagedMap,
    config: &MeshConfig,
    path: &Path,
    scene: &Scene,
    layers: &Layers,
) -> Result<MeshReport> {
    if is_tileset(path) {
        return tiles::write(path, &mut map.surface(config), layers);
    }
    if page::is_page(path) || !layers.is_empty() {
        let blocks = map.sizes().blocks as usize;
        return write_mesh(|| gather(map, config), blocks, config, path, scene, layers);
    }
    let start = Instant::now();
    let mut out = Parts(ply::Stream::new(path)?);
    map.mesh(config, &mut out)?;
    let (vertices, triangles) = out.0.counts();
    if triangles == 0 {
        return Err(RunError::Nothing(format!(
            "the map has no surface: no triangle with a weight of {} or more",
            config.min_weight
        )));
    }
    let seconds = start.elapsed().as_secs_f64();
    out.0.finish()?;
    Ok(MeshReport {
        path: path.to_owned(),
        vertices: vertices as usize,
        triangles: triangles as usize,
        seconds,
        write_seconds: start.elapsed().as_secs_f64() - seconds,
        ..MeshReport::default()
    })
}

/// The whole surface of a paged map, cube by cube.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn gather(map: &mut PagedMap, config: &MeshConfig) -> Result<Mesh> {
    let mut whole = Whole(Mesh::default());
    map.mesh(config, &mut whole)?;
    Ok(whole.0)
}

/// Saves a map that is not all in memory.
///
/// # Errors
/// If the store cannot be read, or the file cannot be written.
pub fn save_in_parts(map: &mut PagedMap, path: &Path) -> Result<SavedMap> {
    let start = Instant::now();
    map.save(path)?;
    Ok(SavedMap::written(path, start))
}

/// A PLY file that takes a mesh in parts.
struct Parts(ply::Stream);

impl MeshSink for Parts {
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> std::io::Result<()> {
        self.0.vertices(positions, normals)
    }

    fn triangles(&mut self, triangles: &[[u32; 3]]) -> std::io::Result<()> {
        self.0.triangles(triangles)
    }
}

/// A mesh that takes its parts.
struct Whole(Mesh);

impl MeshSink for Whole {
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> std::io::Result<()> {
        self.0.vertices.extend_from_slice(positions);
        self.0.normals.extend_from_slice(normals);
        Ok(())
    }

    fn triangles(&mut self, triangles: &[[u32; 3]]) -> std::io::Result<()> {
        self.0.triangles.extend_from_slice(triangles);
        Ok(())
    }
}

#[cfg(feature = "tiles")]
mod tiles {
    use std::path::Path;
    use std::time::Instant;

    use tsdfuse::mesh::Surface;

    use crate::error::{Result, RunError};
    use crate::layers::Layers;
    use crate::report::{MeshReport, TilesReport};

    pub(super) fn check(path: &Path) -> Result<()> {
        tsdfuse_tiles::check(path).map(drop).map_err(RunError::config)
    }

    pub(super) fn write(path: &Path, surface: &mut Surface<'_>, layers: &Layers) -> Result<MeshReport> {
        let start = Instant::now();
        let written = if layers.is_empty() {
            tsdfuse_tiles::write(path, surface)?
        } else {
            tsdfuse_tiles::write_colored(path, surface, &layers.vertex_coloring())?
        };
        Ok(MeshReport {
            path: path.to_owned(),
            vertices: written.vertices,
            triangles: written.triangles,
            seconds: start.elapsed().as_secs_f64(),
            write_seconds: 0.0,
            tiles: Some(TilesReport {
                tiles: written.tiles,
                levels: written.levels,
                bytes: written.bytes,
            }),
            color: None,
        })
    }
}

#[cfg(not(feature = "tiles"))]
mod tiles {
    use std::path::Path;

    use crate::error::{Result, RunError};
    use crate::report::MeshReport;

    pub(super) fn check(path: &Path) -> Result<()> {
        let told = "this build writes no 3D Tiles: it was made without the feature tiles";
        Err(RunError::config(format_args!("{}: {told}", path.display())))
    }

    pub(super) fn write<S>(path: &Path, _: S, _: &crate::layers::Layers) -> Result<MeshReport> {
        check(path)?;
        Ok(MeshReport::default())
    }
}
