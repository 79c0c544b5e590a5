//! Reading a mesh or a cloud from one file, in world coordinates.

use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use crate::error::{Error, Result};
use crate::{files, glb, obj, pcd, ply};

/// What a file holds, in world coordinates, metres.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// Triangles.
    Mesh(Mesh),
    /// Points alone, those that are not finite included.
    Cloud(Vec<DVec3>),
}

/// Reads `.ply` (a mesh, or a cloud if it has no faces), `.obj`, `.glb` or `.pcd`.
///
/// Points of a PCD are taken as they are, whatever its `VIEWPOINT`. A GLB's y up becomes z up.
///
/// # Errors
/// Names the file and what is wrong in it; also for other extensions.
pub fn read(path: impl AsRef<Path>) -> Result<Geometry> {
    let path = path.as_ref();
    let parse = match extension(path).as_str() {
        "ply" => |path: &Path, bytes: &[u8]| {
            let mesh = ply::parse_mesh(path, bytes)?;
            Ok(if mesh.triangles.is_empty() {
                Geometry::Cloud(mesh.vertices)
            } else {
                Geometry::Mesh(mesh)
            })
        },
        "obj" => |path: &Path, bytes: &[u8]| obj::parse(path, bytes).map(Geometry::Mesh),
        "glb" => |path: &Path, bytes: &[u8]| glb::parse(path, bytes).map(Geometry::Mesh),
        "pcd" => |path: &Path, bytes: &[u8]| pcd::parse_points(path, bytes).map(Geometry::Cloud),
        _ => return Err(Error::format(path, "is none of .ply, .obj, .glb and .pcd")),
    };
    parse(path, &files::read(path)?)
}

/// The extension of a path in lower case, or nothing.
pub(crate) fn extension(path: &Path) -> String {
    path.extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh() -> Mesh {
        Mesh {
            vertices: vec![
                DVec3::new(5e6, 4e5, 1.0),
                DVec3::new(5e6 + 1.0, 4e5, 2.0),
                DVec3::new(5e6, 4e5 + 2.0, 3.0),
            ],
            triangles: vec![[0, 1, 2]],
            ..Default::default()
        }
    }

    #[test]
    fn what_is_written_is_read_in_every_format() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a.ply", "a.OBJ", "a.glb"] {
            let path = dir.path().join(name);
            crate::mesh::write(&path, &mesh()).unwrap();
            let Geometry::Mesh(read) = read(&path).unwrap() else {
                panic!("{name} is a mesh");
            };
            assert_eq!(read.triangles, mesh().triangles, "{name}");
            let near = |(a, b): (&DVec3, &DVec3)| a.distance(*b) < 1e-6;
            assert!(
                read.vertices.iter().zip(&mesh().vertices).all(near),
                "{name}: {:?}",
                read.vertices
            );
        }
    }

    #[test]
    fn clouds_keep_the_digits_of_far_places() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = dir.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n\
                   end_header\n5000000.123 4 5\n";
        let pcd = "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n\
                   VIEWPOINT 1 2 3 1 0 0 0\nPOINTS 1\nDATA ascii\n5000000.123 4 5\n";
        for path in [write("a.ply", ply), write("a.pcd", pcd)] {
            let expected = Geometry::Cloud(vec![DVec3::new(5_000_000.123, 4.0, 5.0)]);
            assert_eq!(read(&path).unwrap(), expected, "{}", path.display());
        }
        let told = crate::mesh::read(dir.path().join("a.ply")).unwrap_err().to_string();
        assert!(
            told.ends_with("a.ply: is a cloud of 1 points, not a mesh: it has no faces"),
            "{told}"
        );
        let told = read(dir.path().join("a.stl")).unwrap_err().to_string();
        assert!(told.ends_with("a.stl: is none of .ply, .obj, .glb and .pcd"), "{told}");
    }
}
