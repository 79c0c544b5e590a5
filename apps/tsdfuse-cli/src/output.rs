//! Finding out before the work, not after it, that its results could not be written.

use std::io::IsTerminal;
use std::path::Path;

use anyhow::{Result, bail};

use crate::exit::Usage;
use crate::tiles;

/// Whether a mesh is to be written as 3D Tiles.
pub(crate) fn is_tileset(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"))
}

/// Checks where a mesh is to go; `json` goes to standard output.
pub(crate) fn check_mesh(path: &Path, json: bool) -> Result<()> {
    if is_tileset(path) {
        return tiles::check(path);
    }
    if path.as_os_str() != "-" {
        tsdfuse_io::mesh::check(path).map_err(Usage::new)?;
        return check_file(path);
    }
    if json {
        return Err(Usage::new("--output - and --json cannot both have standard output").into());
    }
    if std::io::stdout().is_terminal() {
        return Err(Usage::new("--output - would write a binary file to the terminal").into());
    }
    Ok(())
}

/// Checks that a file can be made.
pub(crate) fn check_file(path: &Path) -> Result<()> {
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    if !folder.is_dir() {
        bail!("{}: there is no folder {}", path.display(), folder.display());
    }
    if path.is_dir() {
        bail!("{}: is a folder, not a file to write", path.display());
    }
    Ok(())
}
