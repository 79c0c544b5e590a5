//! Wavefront OBJ: plain text that every modelling tool reads, several times the size of PLY.

use std::io::{self, Write};
use std::path::Path;

use tsdfuse::Mesh;

use crate::error::Result;
use crate::ply::{has_normals, in_chunks};

/// Writes a mesh to a file, which appears when it is complete.
///
/// # Errors
/// Names the file and what the system says.
pub fn write(path: impl AsRef<Path>, mesh: &Mesh) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, mesh))
}

/// Writes a mesh: positions to a tenth of a millimetre, normals to four digits.
///
/// # Errors
/// What the system says; `InvalidInput` if there are normals for some vertices only.
pub fn write_to(mut out: impl Write, mesh: &Mesh) -> io::Result<()> {
    let normals = has_normals(mesh)?;
    out.write_all(b"# tsdfuse, metres, z up\n")?;
    // Writing to a Vec cannot fail.
    in_chunks(&mut out, mesh.vertices.len(), |i, bytes| {
        let v = mesh.vertices[i];
        let _ = writeln!(bytes, "v {:.4} {:.4} {:.4}", v.x, v.y, v.z);
    })?;
    in_chunks(&mut out, mesh.normals.len(), |i, bytes| {
        let n = mesh.normals[i];
        let _ = writeln!(bytes, "vn {:.4} {:.4} {:.4}", n.x, n.y, n.z);
    })?;
    in_chunks(&mut out, mesh.triangles.len(), |i, bytes| {
        let [a, b, c] = mesh.triangles[i].map(|v| u64::from(v) + 1);
        let _ = if normals {
            writeln!(bytes, "f {a}//{a} {b}//{b} {c}//{c}")
        } else {
            writeln!(bytes, "f {a} {b} {c}")
        };
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::{DVec3, Vec3};

    #[test]
    fn vertices_count_from_one() {
        let mut mesh = Mesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1e6, -0.5)],
            normals: vec![Vec3::Z; 3],
            triangles: vec![[0, 1, 2]],
        };
        let text = |mesh: &Mesh| {
            let mut bytes = Vec::new();
            write_to(&mut bytes, mesh).unwrap();
            String::from_utf8(bytes).unwrap()
        };
        assert!(text(&mesh).contains("\nv 0.0000 1000000.0000 -0.5000\nvn 0.0000 0.0000 1.0000\n"));
        assert!(text(&mesh).ends_with("\nf 1//1 2//2 3//3\n"));
        mesh.normals.clear();
        assert!(text(&mesh).ends_with("-0.5000\nf 1 2 3\n"));
    }
}
