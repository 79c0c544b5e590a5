//! The mesh of a map that is not all in memory.

use std::path::Path;
use std::time::Instant;

use anyhow::{Result, bail};
use glam::{DVec3, Vec3};
use tsdfuse::VoxelMap;
use tsdfuse::mesh::MeshConfig;
use tsdfuse_io::ply;
use tsdfuse_store::{Pager, Sink, Surface};

use crate::output::is_tileset;
use crate::report::MeshReport;
use crate::tiles;

/// Finds out before the work whether [`surface_in_parts`] can write this; else tells why not.
pub(crate) fn check_in_parts(path: &Path) -> Result<(), &'static str> {
    let is_ply = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
    match is_ply || is_tileset(path) {
        true => Ok(()),
        false => Err("a mesh that comes in parts is written as a .ply file or as NAME/tileset.json"),
    }
}

/// Extracts the surface of a paged map, which must not be empty, and writes it.
pub(crate) fn surface_in_parts(
    map: &mut VoxelMap,
    pager: &mut Pager,
    config: &MeshConfig,
    path: &Path,
) -> Result<MeshReport> {
    if is_tileset(path) {
        return tiles::write(path, &mut Surface::paged(map, pager, config));
    }
    let start = Instant::now();
    let mut out = Parts(ply::Stream::new(path)?);
    pager.mesh(map, config, &mut out)?;
    let (vertices, triangles) = out.0.counts();
    if triangles == 0 {
        bail!(
            "the map has no surface: no triangle at a weight of {} or more",
            config.min_weight
        );
    }
    let seconds = start.elapsed().as_secs_f64();
    out.0.finish()?;
    Ok(MeshReport {
        path: path.to_owned(),
        vertices: vertices as usize,
        triangles: triangles as usize,
        seconds,
        write_seconds: start.elapsed().as_secs_f64() - seconds,
        tiles: None,
    })
}

/// A PLY file that takes a mesh in parts.
struct Parts(ply::Stream);

impl Sink for Parts {
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> std::io::Result<()> {
        self.0.vertices(positions, normals)
    }

    fn triangles(&mut self, triangles: &[[u32; 3]]) -> std::io::Result<()> {
        self.0.triangles(triangles)
    }
}
