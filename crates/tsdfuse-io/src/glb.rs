//! Binary glTF: what web viewers and modelling tools read.
//!
//! glTF has y up and positions in `f32`. So positions are relative to the middle of the mesh, rounded to whole metres,
//! which becomes the translation of the mesh's node; the node above it turns z up into y up.

use std::io::{self, Error, ErrorKind, Write};
use std::path::Path;

use serde_json::{Value, json};
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use crate::error::Result;
use crate::ply::{has_normals, in_chunks};

/// Bytes of a position, a normal and a triangle.
const TRIPLE: usize = 12;
/// glTF's numbers for what a part of the buffer is and which type its entries have.
const VERTICES: u32 = 34_962;
const INDICES: u32 = 34_963;
const F32: u32 = 5126;
const U32: u32 = 5125;

/// Writes a mesh to a file, which appears when it is complete.
///
/// # Errors
/// Names the file and what the system says; a mesh of more than 4 GiB does not fit into GLB.
pub fn write(path: impl AsRef<Path>, mesh: &Mesh) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, mesh))
}

/// Writes a mesh.
///
/// # Errors
/// What the system says; `InvalidInput` if there are normals for some vertices only, or more than 4 GiB of data.
pub fn write_to(mut out: impl Write, mesh: &Mesh) -> io::Result<()> {
    has_normals(mesh)?;
    let place = Place::of(mesh);
    let mut json = serde_json::to_vec(&document(mesh, &place))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = TRIPLE * (mesh.vertices.len() + mesh.normals.len() + mesh.triangles.len());
    let [total, json_length, binary_length] = [28 + json.len() + binary, json.len(), binary].map(|n| {
        u32::try_from(n).map_err(|_| Error::new(ErrorKind::InvalidInput, "the mesh exceeds the 4 GiB of GLB"))
    });
    for word in [
        u32::from_le_bytes(*b"glTF"),
        2,
        total?,
        json_length?,
        u32::from_le_bytes(*b"JSON"),
    ] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(&json)?;
    for word in [binary_length?, u32::from_le_bytes(*b"BIN\0")] {
        out.write_all(&word.to_le_bytes())?;
    }
    let floats = |v: Vec3, bytes: &mut Vec<u8>| v.to_array().iter().for_each(|c| bytes.extend(c.to_le_bytes()));
    in_chunks(&mut out, mesh.vertices.len(), |i, bytes| {
        floats(place.relative(mesh.vertices[i]), bytes);
    })?;
    in_chunks(&mut out, mesh.normals.len(), |i, bytes| {
        floats(mesh.normals[i], bytes);
    })?;
    in_chunks(&mut out, mesh.triangles.len(), |i, bytes| {
        mesh.triangles[i].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    })
}

/// Where the mesh is.
struct Place {
    /// In the world, whole metres.
    middle: DVec3,
    /// Of the relative positions.
    min: Vec3,
    max: Vec3,
}

impl Place {
    fn of(mesh: &Mesh) -> Self {
        let vertices = mesh.vertices.iter().copied();
        let bounds = vertices
            .clone()
            .map(|v| (v, v))
            .reduce(|(min, max), (v, _)| (min.min(v), max.max(v)));
        let middle = bounds.map_or(DVec3::ZERO, |(min, max)| ((min + max) / 2.0).round());
        let relative = |v: DVec3| (v - middle).as_vec3();
        let (min, max) = bounds.map_or((Vec3::ZERO, Vec3::ZERO), |(min, max)| (relative(min), relative(max)));
        Self { middle, min, max }
    }

    fn relative(&self, vertex: DVec3) -> Vec3 {
        (vertex - self.middle).as_vec3()
    }
}

/// The JSON part.
fn document(mesh: &Mesh, place: &Place) -> Value {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let mut nodes = vec![json!({ "name": "y up from z up", "rotation": [-half, 0.0, 0.0, half] })];
    let mut document = json!({
        "asset": { "version": "2.0", "generator": "tsdfuse" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
    });
    if !mesh.triangles.is_empty() {
        // glTF has no parts of zero bytes, so an empty mesh is none.
        let counts = [mesh.vertices.len(), mesh.normals.len(), mesh.triangles.len()];
        let (mut views, mut accessors, mut offset) = (Vec::new(), Vec::new(), 0);
        for (count, target) in counts
            .into_iter()
            .zip([VERTICES, VERTICES, INDICES])
            .filter(|(n, _)| *n > 0)
        {
            accessors.push(match target {
                VERTICES => json!({ "bufferView": views.len(), "componentType": F32, "count": count, "type": "VEC3" }),
                _ => json!({ "bufferView": views.len(), "componentType": U32, "count": 3 * count, "type": "SCALAR" }),
            });
            views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": TRIPLE * count, "target": target }));
            offset += TRIPLE * count;
        }
        accessors[0]["min"] = json!(place.min.to_array());
        accessors[0]["max"] = json!(place.max.to_array());
        let attributes = match mesh.normals.len() {
            0 => json!({ "POSITION": 0 }),
            _ => json!({ "POSITION": 0, "NORMAL": 1 }),
        };
        let primitive = json!({ "attributes": attributes, "indices": accessors.len() - 1, "material": 0 });
        nodes[0]["children"] = json!([1]);
        nodes.push(json!({ "name": "tsdfuse", "mesh": 0, "translation": place.middle.to_array() }));
        document["buffers"] = json!([{ "byteLength": offset }]);
        document["bufferViews"] = json!(views);
        document["accessors"] = json!(accessors);
        document["meshes"] = json!([{ "primitives": [primitive] }]);
        document["materials"] = json!([{
            "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.8, 0.8, 1.0], "metallicFactor": 0.0 },
        }]);
    }
    document["nodes"] = json!(nodes);
    document
}

#[cfg(test)]
mod tests;
