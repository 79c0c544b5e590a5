//! Writing a mesh in the format that its file name asks for.

use std::io::{BufWriter, Write};
use std::path::Path;

use tsdfuse::Mesh;

use crate::error::{Error, Result};
use crate::ply;

/// Writes a mesh as `.ply`, or to standard output as PLY if `path` is `-`. A file appears when it is complete.
///
/// # Errors
/// Names the file and what the system says; also for other extensions.
pub fn write(path: impl AsRef<Path>, mesh: &Mesh) -> Result<()> {
    let path = path.as_ref();
    if path.as_os_str() == "-" {
        let mut out = BufWriter::new(std::io::stdout().lock());
        return ply::write_to(&mut out, mesh)
            .and_then(|()| out.flush())
            .map_err(Error::io("standard output"));
    }
    match path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase()
        .as_str()
    {
        "ply" => ply::write(path, mesh),
        _ => Err(Error::dataset(path, "a mesh is written as .ply")),
    }
}
