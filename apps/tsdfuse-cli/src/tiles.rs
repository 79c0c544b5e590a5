//! Meshes as 3D Tiles: `-o NAME/tileset.json`.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use tsdfuse_store::Surface;

use crate::exit::Usage;
use crate::progress;
use crate::report::{MeshReport, TilesReport};

/// Finds out before the work whether tiles can be written there.
pub(crate) fn check(path: &Path) -> Result<()> {
    tsdfuse_tiles::check(path).map_err(Usage::new)?;
    Ok(())
}

/// Extracts a surface, which must not be empty, and writes it.
pub(crate) fn write(path: &Path, surface: &mut Surface<'_>) -> Result<MeshReport> {
    let start = Instant::now();
    let _spinner = progress::working("writing tiles");
    let written = tsdfuse_tiles::write(path, surface)?;
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
    })
}
