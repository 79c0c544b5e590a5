//! Reading meshes.

use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::files;

use super::body::Body;
use super::header::{Element, Header};

/// Reads a mesh.
///
/// # Errors
/// As [`parse`], and what the system says.
pub fn read(path: impl AsRef<Path>) -> Result<Mesh> {
    let path = path.as_ref();
    parse(path, &files::read(path)?)
}

/// Parses a PLY mesh; `path` is for messages. Normals are as in the file, or empty.
///
/// # Errors
/// Names the file, the vertex, face or header line, and what is wrong; a corner that is no vertex, for instance.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let header = Header::parse(path, bytes)?;
    let mut body = Body::new(path, bytes, &header)?;
    let mut mesh = Mesh::default();
    let count = |name: &str| header.elements.iter().find(|e| e.name == name).map_or(0, |e| e.count);
    let vertices = count("vertex");
    if u32::try_from(vertices).is_err() {
        return Err(Error::format(
            path,
            format!("has {vertices} vertices, more than can be numbered"),
        ));
    }
    for element in &header.elements {
        // A row takes at least one byte, so the header cannot make us reserve more than the file has.
        let rows = element.count.min(bytes.len());
        match element.name.as_str() {
            "vertex" => {
                let Some(position) = numbers(element, ["x", "y", "z"]) else {
                    return Err(Error::format(path, "its vertices have no x, y and z"));
                };
                let normal = numbers(element, ["nx", "ny", "nz"]);
                mesh.vertices.reserve_exact(rows / position.len());
                let row = |values: &[f64]| {
                    mesh.vertices.push(DVec3::from(position.map(|p| values[p])));
                    mesh.normals
                        .extend(normal.map(|n| Vec3::from(n.map(|p| values[p] as f32))));
                    Ok(())
                };
                body.element(element, row, |_, _| Ok(()))?;
            }
            "face" => {
                let corners =
                    |p: usize| matches!(element.properties[p].name.as_str(), "vertex_indices" | "vertex_index");
                let face = |p: usize, items: &[f64]| {
                    if !corners(p) {
                        return Ok(());
                    }
                    if let Some(bad) = items.iter().find(|&&i| !(i >= 0.0 && i < vertices as f64)) {
                        return Err(format!("corner {bad} is none of {vertices} vertices"));
                    }
                    let [first, rest @ ..] = items else { return Ok(()) };
                    let fan = rest.windows(2).map(|pair| [*first, pair[0], pair[1]].map(|i| i as u32));
                    mesh.triangles.extend(fan);
                    Ok(())
                };
                body.element(element, |_| Ok(()), face)?;
            }
            _ => body.element(element, |_| Ok(()), |_, _| Ok(()))?,
        }
    }
    Ok(mesh)
}

/// The places in a row of three numbers with these names.
fn numbers(element: &Element, names: [&str; 3]) -> Option<[usize; 3]> {
    let place = |name| {
        element
            .properties
            .iter()
            .position(|p| p.name == name && p.list.is_none())
    };
    let [x, y, z] = names.map(place);
    Some([x?, y?, z?])
}
