//! Wavefront OBJ: plain text that every modelling tool reads, several times the size of PLY.
//!
//! Only `v` and `f` lines are read; faces with more than three corners become fans of triangles.

use std::io::{self, Write};
use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use crate::error::{Error, Result};
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

/// Parses a mesh; `path` is for messages. Its normals are not read.
///
/// # Errors
/// Names the file, the line and what is wrong; also if a corner refers to no vertex.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let mut mesh = Mesh::default();
    let mut corners = Vec::new();
    for (line, number) in bytes.split(|&b| b == b'\n').zip(1_u64..) {
        // Names may be in any encoding; numbers are ASCII.
        let line = String::from_utf8_lossy(line);
        let mut words = line.split_ascii_whitespace();
        let read = match words.next() {
            Some("v") => position(words).map(|p| mesh.vertices.push(p)),
            Some("f") => {
                let vertices = mesh.vertices.len();
                corners.clear();
                words
                    .try_for_each(|word| {
                        corners.push(corner(word, vertices)?);
                        Ok(())
                    })
                    .map(|()| {
                        let fan = corners.get(1..).unwrap_or_default().windows(2);
                        mesh.triangles.extend(fan.map(|pair| [corners[0], pair[0], pair[1]]));
                    })
            }
            _ => Ok(()),
        };
        read.map_err(|what: String| Error::format(path, format!("line {number}: {what}")))?;
    }
    Ok(mesh)
}

fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Result<DVec3, String> {
    let mut coordinate = || {
        let word = words.next().ok_or("a vertex of less than three numbers")?;
        word.parse().map_err(|_| format!("{word:?} is not a number"))
    };
    Ok(DVec3::new(coordinate()?, coordinate()?, coordinate()?))
}

/// The vertex of `7`, `7/1`, `7//3` or `-1`, counted from 0; negative numbers count back from the last vertex so far.
fn corner(word: &str, vertices: usize) -> Result<u32, String> {
    let number = word.split('/').next().unwrap_or_default();
    let number: i64 = number.parse().map_err(|_| format!("{word:?} is not a corner"))?;
    let index = if number < 0 {
        number.checked_add_unsigned(vertices as u64)
    } else {
        number.checked_sub(1)
    };
    let index = index.and_then(|i| u32::try_from(i).ok());
    index
        .filter(|&i| (i as usize) < vertices)
        .ok_or_else(|| format!("corner {number} is none of {vertices} vertices"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tsdfuse::glam::Vec3;

    fn read(text: &str) -> Result<Mesh, String> {
        parse(Path::new("a.obj"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn faces_come_in_many_spellings() {
        let mesh = read(
            "mtllib a.mtl\no thing\nv 0 0 0\nv 1.5 0 0 0.1 0.2 0.3\r\n v 1 1 0\nvn 0 0 1\n\nvt 0 0\nf 1/1/1 2//1 3\ns off\n\
             v 0 1 0\nf -4 -2 -1 2/1\n",
        );
        let mesh = mesh.unwrap();
        assert_eq!((mesh.vertices.len(), mesh.vertices[1]), (4, DVec3::new(1.5, 0.0, 0.0)));
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 1]]);
    }

    #[test]
    fn wrong_lines_are_named() {
        let told = |text: &str| read(text).unwrap_err();
        assert_eq!(told("v 0 0\n"), "a.obj: line 1: a vertex of less than three numbers");
        assert_eq!(told("\nv 0 x 0\n"), "a.obj: line 2: \"x\" is not a number");
        for (face, number) in [
            ("0", 0),
            ("2", 2),
            ("-2", -2),
            ("9223372036854775807", i64::MAX),
            ("-9223372036854775808", i64::MIN),
        ] {
            let expected = format!("a.obj: line 2: corner {number} is none of 1 vertices");
            assert_eq!(told(&format!("v 0 0 0\nf 1 1 {face}\n")), expected);
        }
        assert_eq!(told("v 0 0 0\nf 1 //1 1\n"), "a.obj: line 2: \"//1\" is not a corner");
    }

    proptest! {
        #[test]
        fn any_bytes_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..200), text in "([vf] ?[-0-9/ .]{0,12}\n?){0,20}") {
            let _ = (parse(Path::new("a.obj"), &bytes), read(&text));
        }
    }

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
