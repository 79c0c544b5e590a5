//! Writing a mesh as binary little-endian PLY.

use std::io::{self, Write};
use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use crate::error::Result;

/// Coordinates below this are stored as `float`, which rounds them by 0.03 mm at most; from here on as `double`.
const FLOAT_LIMIT_M: f64 = 1000.0;

/// Writes a mesh to a file, which appears when it is complete.
///
/// # Errors
/// Names the file and what the system says.
///
/// # Examples
/// ```
/// # let dir = tempfile::tempdir().unwrap();
/// let mesh = tsdfuse::Mesh::default();
/// tsdfuse_io::ply::write(dir.path().join("street.ply"), &mesh)?;
/// # Ok::<(), tsdfuse_io::Error>(())
/// ```
pub fn write(path: impl AsRef<Path>, mesh: &Mesh) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, mesh))
}

/// Writes a mesh: `x y z`, with normals `nx ny nz` if it has them, and `vertex_indices` of the triangles.
///
/// # Errors
/// What the system says; `InvalidInput` if there are normals for some vertices only.
pub fn write_to(out: impl Write, mesh: &Mesh) -> io::Result<()> {
    write_parts(out, mesh, None)
}

/// Writes the vertices of a mesh, with their normals if it has them, as a cloud of points, to a file which appears when it is complete.
///
/// # Errors
/// Names the file and what the system says.
pub fn write_vertices(path: impl AsRef<Path>, mesh: &Mesh) -> Result<()> {
    crate::atomic::write(path, |out| {
        let layout = Layout::of(mesh)?;
        layout.header(out, mesh.vertices.len() as u64, None)?;
        in_chunks(out, mesh.vertices.len(), |i, bytes| {
            layout.vertex(mesh.vertices[i], mesh.normals.get(i), bytes);
        })
    })
}

/// As [`write_to`], with `red green blue` of each vertex.
///
/// # Errors
/// As [`write_to`]; `InvalidInput` also if there are not as many colours as vertices.
pub fn write_colored_to(out: impl Write, mesh: &Mesh, colors: &[[u8; 3]]) -> io::Result<()> {
    one_color_each(mesh, colors)?;
    write_parts(out, mesh, Some(colors))
}

fn write_parts(mut out: impl Write, mesh: &Mesh, colors: Option<&[[u8; 3]]>) -> io::Result<()> {
    let layout = Layout {
        colors: colors.is_some(),
        ..Layout::of(mesh)?
    };
    layout.header(&mut out, mesh.vertices.len() as u64, Some(mesh.triangles.len() as u64))?;
    in_chunks(&mut out, mesh.vertices.len(), |i, bytes| {
        layout.vertex(mesh.vertices[i], mesh.normals.get(i), bytes);
        bytes.extend(colors.iter().flat_map(|colors| colors[i]));
    })?;
    in_chunks(&mut out, mesh.triangles.len(), |i, bytes| {
        triangle(mesh.triangles[i], bytes);
    })
}

/// Whether a vertex is so far from the origin that it needs doubles.
pub(super) fn is_far(vertex: DVec3) -> bool {
    vertex.abs().max_element() >= FLOAT_LIMIT_M
}

/// What is stored of a vertex.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) double: bool,
    pub(super) normals: bool,
    pub(super) colors: bool,
}

impl Layout {
    /// The layout of a mesh without colours.
    fn of(mesh: &Mesh) -> io::Result<Self> {
        Ok(Self {
            double: mesh.vertices.iter().any(|v| is_far(*v)),
            normals: has_normals(mesh)?,
            colors: false,
        })
    }

    pub(super) fn header(self, out: &mut impl Write, vertices: u64, triangles: Option<u64>) -> io::Result<()> {
        let coordinate = if self.double { "double" } else { "float" };
        write!(out, "ply\nformat binary_little_endian 1.0\ncomment tsdfuse, metres\n")?;
        writeln!(out, "element vertex {vertices}")?;
        for axis in ["x", "y", "z"] {
            writeln!(out, "property {coordinate} {axis}")?;
        }
        for axis in ["nx", "ny", "nz"].iter().filter(|_| self.normals) {
            writeln!(out, "property float {axis}")?;
        }
        for channel in ["red", "green", "blue"].iter().filter(|_| self.colors) {
            writeln!(out, "property uchar {channel}")?;
        }
        if let Some(triangles) = triangles {
            write!(
                out,
                "element face {triangles}\nproperty list uchar int vertex_indices\n"
            )?;
        }
        writeln!(out, "end_header")
    }

    /// Appends a vertex, without its colour.
    pub(super) fn vertex(self, position: DVec3, normal: Option<&Vec3>, bytes: &mut Vec<u8>) {
        if self.double {
            position.to_array().iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        } else {
            floats(position.as_vec3(), bytes);
        }
        normal.into_iter().for_each(|normal| floats(*normal, bytes));
    }
}

fn floats(v: Vec3, bytes: &mut Vec<u8>) {
    v.to_array().iter().for_each(|c| bytes.extend(c.to_le_bytes()));
}

/// Appends a triangle.
pub(super) fn triangle(corners: [u32; 3], bytes: &mut Vec<u8>) {
    bytes.push(3);
    corners.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
}

/// Whether there is a normal for each vertex.
pub(crate) fn has_normals(mesh: &Mesh) -> io::Result<bool> {
    let (vertices, normals) = (mesh.vertices.len(), mesh.normals.len());
    if normals != 0 && normals != vertices {
        let reason = format!("the mesh has {vertices} vertices but {normals} normals");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    Ok(normals > 0)
}

/// Refuses another number of colours than of vertices.
pub(crate) fn one_color_each(mesh: &Mesh, colors: &[[u8; 3]]) -> io::Result<()> {
    let (vertices, colors) = (mesh.vertices.len(), colors.len());
    if vertices == colors {
        return Ok(());
    }
    let reason = format!("the mesh has {vertices} vertices but {colors} colours");
    Err(io::Error::new(io::ErrorKind::InvalidInput, reason))
}

/// Lets `item` append items `0..count` to a buffer, and writes the buffer whenever it is full.
pub(crate) fn in_chunks(
    out: &mut impl Write,
    count: usize,
    mut item: impl FnMut(usize, &mut Vec<u8>),
) -> io::Result<()> {
    const CHUNK: usize = 1 << 18;
    let mut bytes = Vec::with_capacity(CHUNK + 256);
    for i in 0..count {
        item(i, &mut bytes);
        if bytes.len() >= CHUNK {
            out.write_all(&bytes)?;
            bytes.clear();
        }
    }
    out.write_all(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(mesh: &Mesh) -> (String, Vec<u8>) {
        let mut bytes = Vec::new();
        write_to(&mut bytes, mesh).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let body = bytes.split_off(end);
        (String::from_utf8(bytes).unwrap(), body)
    }

    fn triangle(x: f64) -> Mesh {
        Mesh {
            vertices: vec![DVec3::ZERO, DVec3::new(x, 0.0, 0.0), DVec3::Y],
            normals: vec![Vec3::Z; 3],
            triangles: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn coordinates_are_floats_near_the_origin_and_doubles_far_away() {
        let (near, body) = written(&triangle(-999.9));
        assert!(near.contains("element vertex 3\nproperty float x\n") && near.contains("element face 1\n"));
        assert_eq!(body.len(), 3 * 24 + 13);
        assert_eq!(body[24..28], (-999.9_f32).to_le_bytes());
        assert_eq!(body[72..], [3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
        let (far, body) = written(&triangle(5e6));
        assert!(far.contains("property double x\n") && far.contains("property float nx\n"));
        assert_eq!(body.len(), 3 * 36 + 13);
        assert_eq!(body[36..44], 5e6_f64.to_le_bytes());
    }

    #[test]
    fn normals_are_for_all_vertices_or_none() {
        let mut mesh = triangle(1.0);
        mesh.normals.clear();
        assert!(!written(&mesh).0.contains("nx"));
        mesh.normals.push(Vec3::Z);
        assert_eq!(
            write_to(std::io::sink(), &mesh).unwrap_err().kind(),
            io::ErrorKind::InvalidInput
        );
    }

    #[test]
    fn colors_follow_the_normals_and_are_for_all_vertices() {
        let mesh = triangle(1.0);
        let mut bytes = Vec::new();
        write_colored_to(&mut bytes, &mesh, &[[1, 2, 3], [4, 5, 6], [7, 8, 9]]).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.contains(
            "property float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face"
        ));
        assert_eq!(bytes[end + 24..end + 27], [1, 2, 3]);
        assert_eq!(bytes[end + 78..end + 81], [7, 8, 9]);
        assert_eq!(bytes.len(), end + 3 * 27 + 13);
        let refused = write_colored_to(std::io::sink(), &mesh, &[[0; 3]]).unwrap_err();
        assert_eq!(refused.to_string(), "the mesh has 3 vertices but 1 colours");
    }

    #[test]
    fn vertices_are_a_cloud() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        write_vertices(&path, &triangle(2.0)).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(!String::from_utf8_lossy(&bytes).contains("face"));
        match crate::geometry::read(&path).unwrap() {
            crate::geometry::Geometry::Cloud(points) => assert_eq!(points, triangle(2.0).vertices),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn long_lists_are_written_in_full() {
        let mut mesh = triangle(1.0);
        mesh.triangles = vec![[0, 1, 2]; 100_000];
        assert_eq!(written(&mesh).1.len(), 72 + 1_300_000);
    }
}
