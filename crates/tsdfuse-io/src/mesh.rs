//! Reading and writing a mesh in the format that its file name asks for.

use std::io::{BufWriter, Write};
use std::path::Path;

use tsdfuse::Mesh;

use crate::error::{Error, Result};
use crate::geometry::{self, Geometry, extension};
use crate::{glb, obj, ply};

/// Reads a mesh from `.ply`, `.obj` or `.glb`; normals may be missing.
///
/// # Errors
/// As [`geometry::read`]; also for a cloud of points, and a mesh without triangles.
pub fn read(path: impl AsRef<Path>) -> Result<Mesh> {
    let path = path.as_ref();
    match geometry::read(path)? {
        Geometry::Mesh(mesh) if mesh.triangles.is_empty() => Err(Error::format(path, "is a mesh without triangles")),
        Geometry::Mesh(mesh) => Ok(mesh),
        Geometry::Cloud(points) => {
            let reason = format!("is a cloud of {} points, not a mesh: it has no faces", points.len());
            Err(Error::format(path, reason))
        }
    }
}

/// Writes a mesh as `.ply`, `.glb` or `.obj`, or to standard output as PLY if `path` is `-`. A file appears when it is complete.
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
    writer(path)?(path, mesh)
}

/// Writes a mesh with an sRGB colour for each vertex as `.ply` or `.glb`. A file appears when it is complete.
///
/// # Errors
/// Names the file and what the system says; also for other extensions, and if there are not as many colours as vertices.
pub fn write_colored(path: impl AsRef<Path>, mesh: &Mesh, colors: &[[u8; 3]]) -> Result<()> {
    let path = path.as_ref();
    check_colored(path)?;
    crate::atomic::write(path, |out| match extension(path).as_str() {
        "glb" => glb::write_colored_to(out, mesh, colors),
        _ => ply::write_colored_to(out, mesh, colors),
    })
}

/// Finds out before the work whether [`write_colored`] knows a format for this path.
///
/// # Errors
/// Names the file and the extensions there are.
pub fn check_colored(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    match extension(path).as_str() {
        "ply" | "glb" => Ok(()),
        _ => Err(Error::dataset(path, "a coloured mesh is written as .ply or .glb")),
    }
}

/// Finds out before the work whether [`write()`] knows a format for this path.
///
/// # Errors
/// Names the file and the extensions there are.
pub fn check(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    if path.as_os_str() == "-" {
        return Ok(());
    }
    writer(path).map(drop)
}

fn writer(path: &Path) -> Result<fn(&Path, &Mesh) -> Result<()>> {
    match extension(path).as_str() {
        "ply" => Ok(|path, mesh| ply::write(path, mesh)),
        "glb" => Ok(|path, mesh| glb::write(path, mesh)),
        "obj" => Ok(|path, mesh| obj::write(path, mesh)),
        _ => Err(Error::dataset(path, "a mesh is written as .ply, .glb or .obj")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extension_chooses_the_format() {
        let dir = tempfile::tempdir().unwrap();
        for (name, start) in [("a.ply", "ply\n"), ("a.GLB", "glTF"), ("a.obj", "# tsdfuse")] {
            let path = dir.path().join(name);
            check(&path).unwrap();
            write(&path, &Mesh::default()).unwrap();
            assert!(std::fs::read(&path).unwrap().starts_with(start.as_bytes()), "{name}");
        }
        let refused = write(dir.path().join("a.stl"), &Mesh::default())
            .unwrap_err()
            .to_string();
        assert!(
            refused.ends_with("a.stl: a mesh is written as .ply, .glb or .obj"),
            "{refused}"
        );
        assert_eq!(check(dir.path().join("a.stl")).unwrap_err().to_string(), refused);
        check("-").unwrap();
    }
}
