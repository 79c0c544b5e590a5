//! Reading the triangles of a GLB file.

use std::path::Path;

use serde::Deserialize;
use tsdfuse::Mesh;
use tsdfuse::glam::{DMat4, DQuat, DVec3, Vec3};

use super::types::{F32, U8, U32};
use crate::error::{Error, Result};

const U16: u32 = 5123;
/// glTF's number for lists of triangles.
const TRIANGLES: u32 = 4;
/// Meshes can be instanced many times. A scene with more vertices or triangles than this per byte of the file is refused.
const MAX_EXPANSION: usize = 16;

/// Parses all triangles of a file's scene, in world coordinates with z up; `path` is for messages. Normals are not read.
///
/// # Errors
/// Names the file, the part of the document and what is wrong.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let read = || {
        let (json, buffer) = chunks(bytes)?;
        let document: Document = serde_json::from_slice(json).map_err(|e| format!("its JSON: {e}"))?;
        let limit = bytes.len().saturating_mul(MAX_EXPANSION);
        document.mesh(buffer, limit)
    };
    read().map_err(|what: String| Error::format(path, what))
}

/// The JSON and the binary part.
fn chunks(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let word = |at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    if bytes.get(..4) != Some(b"glTF") || word(4) != Some(2) {
        return Err("is no GLB file of version 2".to_owned());
    }
    let chunk = |at: usize, kind: &[u8; 4]| {
        let length = word(at)? as usize;
        (bytes.get(at + 4..at + 8)? == kind).then_some(())?;
        bytes.get(at + 8..(at + 8).checked_add(length)?)
    };
    let json = chunk(12, b"JSON").ok_or("its JSON is missing or truncated")?;
    let after = 20 + json.len();
    if bytes.len() <= after {
        return Ok((json, &[]));
    }
    let buffer = chunk(after, b"BIN\0").ok_or("its buffer is missing or truncated")?;
    Ok((json, buffer))
}

// The parts of glTF 2.0 that triangles are made of; all else is ignored.

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
struct Document {
    scene: Option<usize>,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<Meshes>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    extensions_required: Vec<String>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Scene {
    nodes: Vec<usize>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Node {
    mesh: Option<usize>,
    children: Vec<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<DVec3>,
    rotation: Option<DQuat>,
    scale: Option<DVec3>,
}

#[derive(Deserialize)]
struct Meshes {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: Attributes,
    indices: Option<usize>,
    mode: Option<u32>,
}

#[derive(Deserialize)]
struct Attributes {
    #[serde(rename = "POSITION")]
    position: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    count: usize,
    #[serde(rename = "type")]
    kind: String,
    sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct View {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

/// Entry `index` of a list of the document.
fn entry<'a, T>(list: &'a [T], name: &str, index: usize) -> Result<&'a T, String> {
    list.get(index).ok_or_else(|| format!("there is no {name} {index}"))
}

impl Document {
    fn mesh(&self, buffer: &[u8], limit: usize) -> Result<Mesh, String> {
        if let Some(extension) = self.extensions_required.first() {
            return Err(format!("needs the extension {extension}, which is not read here"));
        }
        let mut mesh = Mesh::default();
        let mut seen = vec![false; self.nodes.len()];
        let up = DMat4::from_cols_array(&[1., 0., 0., 0., 0., 0., 1., 0., 0., -1., 0., 0., 0., 0., 0., 1.]);
        if self.scenes.is_empty() {
            return Ok(mesh);
        }
        let roots = &entry(&self.scenes, "scene", self.scene.unwrap_or(0))?.nodes;
        let mut open: Vec<_> = roots.iter().rev().map(|&node| (node, up)).collect();
        while let Some((number, parent)) = open.pop() {
            let node = entry(&self.nodes, "node", number)?;
            if std::mem::replace(&mut seen[number], true) {
                return Err(format!("node {number} has several parents"));
            }
            let world_from_node = parent * node.transform();
            if let Some(number) = node.mesh {
                let primitives = &entry(&self.meshes, "mesh", number)?.primitives;
                for (i, primitive) in primitives.iter().enumerate() {
                    self.append(&mut mesh, primitive, &world_from_node, buffer, limit)
                        .map_err(|what| format!("primitive {i} of mesh {number}: {what}"))?;
                }
            }
            open.extend(node.children.iter().rev().map(|&child| (child, world_from_node)));
        }
        Ok(mesh)
    }

    /// Adds the triangles of a primitive; points and lines have none.
    fn append(
        &self,
        mesh: &mut Mesh,
        primitive: &Primitive,
        world_from_node: &DMat4,
        buffer: &[u8],
        limit: usize,
    ) -> Result<(), String> {
        match primitive.mode.unwrap_or(TRIANGLES) {
            TRIANGLES => {}
            0..TRIANGLES => return Ok(()),
            mode => {
                return Err(format!(
                    "triangles of mode {mode} are not read here, only lists ({TRIANGLES})"
                ));
            }
        }
        let position = primitive.attributes.position.ok_or("it has no positions")?;
        let positions = self.items(position, &[F32], "VEC3", buffer)?;
        let indices = primitive.indices;
        let indices = indices
            .map(|accessor| self.items(accessor, &[U8, U16, U32], "SCALAR", buffer))
            .transpose()?;
        let (first, count) = (mesh.vertices.len(), positions.count);
        let triangles = indices.as_ref().map_or(count, |items| items.count) / 3;
        if first + count > limit.min(u32::MAX as usize) || mesh.triangles.len() + triangles > limit {
            return Err("the file unfolds to more than its size allows".to_owned());
        }
        mesh.vertices.extend((0..count).map(|i| {
            let coordinate = |axis| f32::from_bits(positions.word(i, axis));
            world_from_node.transform_point3(Vec3::from([0, 1, 2].map(coordinate)).as_dvec3())
        }));
        for triangle in 0..triangles {
            let corners = [0, 1, 2].map(|i| 3 * triangle + i);
            let corners = corners.map(|i| indices.as_ref().map_or(i, |items| items.word(i, 0) as usize));
            if let Some(bad) = corners.iter().find(|&&i| i >= count) {
                return Err(format!("corner {bad} is none of {count} vertices"));
            }
            mesh.triangles.push(corners.map(|i| (first + i) as u32));
        }
        Ok(())
    }

    /// The items of an accessor, if it is of one of these types.
    fn items<'a>(
        &self,
        accessor: usize,
        components: &[u32],
        kind: &str,
        buffer: &'a [u8],
    ) -> Result<Items<'a>, String> {
        let wrong = |what: String| format!("accessor {accessor} {what}");
        let of = entry(&self.accessors, "accessor", accessor)?;
        if !components.contains(&of.component_type) || of.kind != kind {
            return Err(wrong(format!(
                "is of component type {} and type {}",
                of.component_type, of.kind
            )));
        }
        let Some(view) = of.buffer_view.filter(|_| of.sparse.is_none()) else {
            return Err(wrong("is sparse, which is not read here".to_owned()));
        };
        let view = entry(&self.buffer_views, "bufferView", view)?;
        if view.buffer != 0 {
            return Err(wrong("lies in another file, which is not read here".to_owned()));
        }
        let component = match of.component_type {
            U8 => 1,
            U16 => 2,
            _ => 4,
        };
        let size = component * if kind == "VEC3" { 3 } else { 1 };
        let stride = view.byte_stride.unwrap_or(size);
        let within = || {
            let bytes = buffer.get(view.byte_offset..view.byte_offset.checked_add(view.byte_length)?)?;
            let bytes = bytes.get(of.byte_offset..)?;
            let needed = of
                .count
                .checked_sub(1)
                .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size))?;
            (stride >= size && needed <= bytes.len()).then_some(bytes)
        };
        Ok(Items {
            bytes: within().ok_or_else(|| wrong("reaches beyond its part of the buffer".to_owned()))?,
            stride,
            component,
            count: of.count,
        })
    }
}

/// Items of one to three numbers, all of them within the bytes.
struct Items<'a> {
    bytes: &'a [u8],
    stride: usize,
    /// Bytes of a number.
    component: usize,
    count: usize,
}

impl Items<'_> {
    /// The bits of a number of an item.
    fn word(&self, item: usize, number: usize) -> u32 {
        let start = item * self.stride + number * self.component;
        let mut word = [0; 4];
        let bytes = self.bytes.get(start..start + self.component).unwrap_or_default();
        bytes.iter().zip(&mut word).for_each(|(from, to)| *to = *from);
        u32::from_le_bytes(word)
    }
}

impl Node {
    fn transform(&self) -> DMat4 {
        match &self.matrix {
            Some(matrix) => DMat4::from_cols_array(matrix),
            None => DMat4::from_scale_rotation_translation(
                self.scale.unwrap_or(DVec3::ONE),
                self.rotation.unwrap_or(DQuat::IDENTITY),
                self.translation.unwrap_or(DVec3::ZERO),
            ),
        }
    }
}
