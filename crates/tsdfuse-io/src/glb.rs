//! Binary glTF: what web viewers and modelling tools read; meshes are written and read.
//!
//! In glTF, y points up and positions are `f32`. So positions are relative to the middle of the mesh, rounded to whole metres,
//! which becomes the translation of the mesh's node. Its parent node rotates z up into y up.

use std::io::{self, Error, ErrorKind, Write};
use std::path::Path;

use serde_json::{Value, json};
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use crate::error::Result;
use crate::ply::{has_normals, in_chunks, one_color_each};

mod read;
mod types;

pub use read::parse;
use types::{F32, U8, U32};

/// Bytes of a position, a normal or a triangle, and of a colour.
const TRIPLE: usize = 12;
const COLOR: usize = 4;
/// glTF's constants for the targets of buffer views.
const VERTICES: u32 = 34_962;
const INDICES: u32 = 34_963;

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
pub fn write_to(out: impl Write, mesh: &Mesh) -> io::Result<()> {
    write_parts(out, mesh, &[])
}

/// As [`write_to`], with an sRGB colour for each vertex. They are stored as linear colours, as glTF requires.
///
/// # Errors
/// As [`write_to`]; `InvalidInput` also if there are not as many colours as vertices.
pub fn write_colored_to(out: impl Write, mesh: &Mesh, colors: &[[u8; 3]]) -> io::Result<()> {
    one_color_each(mesh, colors)?;
    write_parts(out, mesh, colors)
}

/// Writes a mesh with colours or with none.
fn write_parts(mut out: impl Write, mesh: &Mesh, colors: &[[u8; 3]]) -> io::Result<()> {
    has_normals(mesh)?;
    let place = Place::of(mesh);
    let mut json = serde_json::to_vec(&document(mesh, colors.len(), &place))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = TRIPLE * (mesh.vertices.len() + mesh.normals.len() + mesh.triangles.len()) + COLOR * colors.len();
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
    in_chunks(&mut out, colors.len(), |i, bytes| {
        bytes.extend(colors[i].map(linear));
        bytes.push(u8::MAX);
    })?;
    in_chunks(&mut out, mesh.triangles.len(), |i, bytes| {
        mesh.triangles[i].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    })
}

/// Linear light of an sRGB value (IEC 61966-2-1), both of 255.
fn linear(srgb: u8) -> u8 {
    let value = f32::from(srgb) / 255.0;
    let light = if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    };
    (light * 255.0).round() as u8
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
fn document(mesh: &Mesh, colors: usize, place: &Place) -> Value {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let mut nodes = vec![json!({ "name": "y up from z up", "rotation": [-half, 0.0, 0.0, half] })];
    let mut document = json!({
        "asset": { "version": "2.0", "generator": "tsdfuse" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
    });
    if !mesh.triangles.is_empty() {
        // glTF has no parts of zero bytes, so an empty mesh is none.
        let parts = [
            ("POSITION", mesh.vertices.len(), TRIPLE),
            ("NORMAL", mesh.normals.len(), TRIPLE),
            ("COLOR_0", colors, COLOR),
            ("", mesh.triangles.len(), TRIPLE),
        ];
        let (mut views, mut accessors, mut attributes, mut offset) = (Vec::new(), Vec::new(), json!({}), 0);
        for (name, count, size) in parts.into_iter().filter(|(_, count, _)| *count > 0) {
            let view = views.len();
            let of = |component, count, kind| json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
            let mut accessor = match (name, size) {
                ("", _) => of(U32, 3 * count, "SCALAR"),
                (_, TRIPLE) => of(F32, count, "VEC3"),
                _ => of(U8, count, "VEC4"),
            };
            if size == COLOR {
                accessor["normalized"] = json!(true);
            }
            let target = if name.is_empty() { INDICES } else { VERTICES };
            if !name.is_empty() {
                attributes[name] = json!(view);
            }
            accessors.push(accessor);
            views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": size * count, "target": target }));
            offset += size * count;
        }
        accessors[0]["min"] = json!(place.min.to_array());
        accessors[0]["max"] = json!(place.max.to_array());
        let primitive = json!({ "attributes": attributes, "indices": accessors.len() - 1, "material": 0 });
        nodes[0]["children"] = json!([1]);
        nodes.push(json!({ "name": "tsdfuse", "mesh": 0, "translation": place.middle.to_array() }));
        document["buffers"] = json!([{ "byteLength": offset }]);
        document["bufferViews"] = json!(views);
        document["accessors"] = json!(accessors);
        document["meshes"] = json!([{ "primitives": [primitive] }]);
        let gray = if colors > 0 { 1.0 } else { 0.8 };
        document["materials"] = json!([{
            "doubleSided": true,
            // Colours of the vertices are multiplied by this one.
            "pbrMetallicRoughness": { "baseColorFactor": [gray, gray, gray, 1.0], "metallicFactor": 0.0 },
        }]);
    }
    document["nodes"] = json!(nodes);
    document
}

#[cfg(test)]
mod tests;
