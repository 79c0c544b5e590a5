use gltf_json::Root;
use gltf_json::validation::Validate;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

/// The document and the buffer of a GLB file, by an independent parser.
fn parsed(mesh: &Mesh) -> (Root, Vec<u8>) {
    let mut bytes = Vec::new();
    super::write_to(&mut bytes, mesh).unwrap();
    parsed_bytes(bytes)
}

fn parsed_bytes(mut bytes: Vec<u8>) -> (Root, Vec<u8>) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let json = word(12);
    assert_eq!((json % 4, &bytes[16..20]), (0, &b"JSON"[..]));
    let root = Root::from_slice(&bytes[20..20 + json]).unwrap();
    root.validate(&root, gltf_json::Path::new, &mut |path, error| {
        panic!("{}: {error}", path())
    });
    let binary = 20 + json;
    assert_eq!(
        (word(binary), &bytes[binary + 4..binary + 8]),
        (bytes.len() - binary - 8, &b"BIN\0"[..])
    );
    (root, bytes.split_off(binary + 8))
}

fn triangle() -> Mesh {
    Mesh {
        vertices: vec![
            DVec3::new(5e6, 4e5, 100.25),
            DVec3::new(5e6 + 3.0, 4e5, 100.25),
            DVec3::new(5e6, 4e5 + 1.0, 102.5),
        ],
        normals: vec![Vec3::Z; 3],
        triangles: vec![[0, 1, 2]],
    }
}

#[test]
fn positions_are_relative_to_whole_metres() {
    let (root, buffer) = parsed(&triangle());
    assert_eq!(root.nodes[1].translation, Some([5_000_002.0, 400_001.0, 101.0]));
    let floats: Vec<f32> = buffer[..36]
        .chunks(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!(floats, [-2.0, -1.0, -0.75, 1.0, -1.0, -0.75, -2.0, 0.0, 1.5]);
    assert_eq!(root.accessors[0].min, Some(serde_json::json!([-2.0, -1.0, -0.75])));
    assert_eq!(root.accessors[0].max, Some(serde_json::json!([1.0, 0.0, 1.5])));
    assert_eq!(buffer[72..], [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
    assert_eq!(root.accessors[2].count.0, 3);
}

#[test]
fn the_root_turns_z_to_y() {
    let (root, _) = parsed(&triangle());
    let [x, y, z, w] = root.nodes[0].rotation.unwrap().0;
    let turned = tsdfuse::glam::Quat::from_xyzw(x, y, z, w) * Vec3::Z;
    assert!(turned.distance(Vec3::Y) < 1e-6, "{turned}");
    assert_eq!(root.nodes[0].children.as_ref().map(|c| c[0].value()), Some(1));
}

#[test]
fn without_normals_or_without_anything_it_is_still_valid() {
    let mut mesh = triangle();
    mesh.normals.clear();
    let (root, buffer) = parsed(&mesh);
    assert_eq!((root.accessors.len(), buffer.len()), (2, 48));
    let (root, buffer) = parsed(&Mesh::default());
    assert!(root.meshes.is_empty() && buffer.is_empty());
}

#[test]
fn colors_are_stored_in_linear_light() {
    let mut bytes = Vec::new();
    super::write_colored_to(&mut bytes, &triangle(), &[[0, 128, 255], [10, 188, 1], [0; 3]]).unwrap();
    let (root, buffer) = parsed_bytes(bytes);
    assert_eq!(root.accessors.len(), 4);
    assert!(root.accessors[2].normalized && root.accessors[2].count.0 == 3);
    // 0.5 of sRGB is a fifth of the light.
    assert_eq!(buffer[72..84], [0, 55, 255, 255, 1, 128, 0, 255, 0, 0, 0, 255]);
    assert_eq!(buffer.len(), 72 + 12 + 12);
    let refused = super::write_colored_to(std::io::sink(), &triangle(), &[]).unwrap_err();
    assert_eq!(refused.to_string(), "the mesh has 3 vertices but 0 colours");
}

/// A GLB file of a document and a buffer.
fn file(document: &serde_json::Value, buffer: &[u8]) -> Vec<u8> {
    let json = document.to_string();
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, part) in [(b"JSON", json.as_bytes()), (b"BIN\0", buffer)] {
        bytes.extend((part.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(part);
    }
    bytes
}

/// A triangle of one accessor of positions, without indices.
fn document() -> serde_json::Value {
    serde_json::json!({
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "children": [1, 2] }, { "mesh": 0 }, { "mesh": 0, "scale": [2, 2, 2], "translation": [0, 0, 7] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
    })
}

fn read(document: &serde_json::Value) -> Result<Mesh, String> {
    let buffer: Vec<u8> = (1_u8..10).flat_map(|i| f32::from(i).to_le_bytes()).collect();
    super::parse(std::path::Path::new("a.glb"), &file(document, &buffer)).map_err(|e| e.to_string())
}

#[test]
fn nodes_place_meshes_and_y_up_becomes_z_up() {
    let mesh = read(&document()).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [3, 4, 5]]);
    assert_eq!(
        (mesh.vertices[0], mesh.vertices[3]),
        (DVec3::new(1.0, -3.0, 2.0), DVec3::new(2.0, -13.0, 4.0))
    );
    let mut with_matrix = document();
    with_matrix["nodes"][1]["matrix"] = serde_json::json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]);
    assert_eq!(read(&with_matrix).unwrap().vertices[0], DVec3::new(6.0, -3.0, 2.0));
}

#[test]
fn lies_and_foreign_parts_are_named() {
    let told = |path: &str, value: serde_json::Value| {
        let mut document = document();
        *document.pointer_mut(path).unwrap() = value;
        read(&document).unwrap_err()
    };
    use serde_json::json;
    assert_eq!(
        told("/nodes/0/children", json!([0])),
        "a.glb: node 0 has several parents"
    );
    assert_eq!(told("/nodes/0/children", json!([7])), "a.glb: there is no node 7");
    assert_eq!(told("/nodes/1/mesh", json!(3)), "a.glb: there is no mesh 3");
    let beyond = "a.glb: primitive 0 of mesh 0: accessor 0 reaches beyond its part of the buffer";
    assert_eq!(told("/accessors/0/count", json!(4)), beyond);
    assert_eq!(told("/accessors/0/count", json!(u64::MAX)), beyond);
    assert_eq!(told("/bufferViews/0/byteLength", json!(37)), beyond);
    assert_eq!(
        told("/accessors/0/componentType", json!(5123)),
        "a.glb: primitive 0 of mesh 0: accessor 0 is of component type 5123 and type VEC3"
    );
    assert!(told("/accessors", json!(3)).starts_with("a.glb: its JSON: invalid type"));
    let mut draco = document();
    draco["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    let told = read(&draco).unwrap_err();
    assert_eq!(
        told,
        "a.glb: needs the extension KHR_draco_mesh_compression, which is not read here"
    );
    let mut bomb = document();
    bomb["meshes"][0]["primitives"] = json!(vec![bomb["meshes"][0]["primitives"][0].clone(); 2]);
    bomb["nodes"] = json!([{ "children": (1..9).collect::<Vec<_>>() }, {"mesh": 0}, {"mesh": 0}, {"mesh": 0}, {"mesh": 0},
        {"mesh": 0}, {"mesh": 0}, {"mesh": 0}, {"mesh": 0}]);
    assert_eq!(read(&bomb).unwrap().triangles.len(), 16);
    bomb["accessors"][0]["count"] = json!(1 << 20);
    bomb["bufferViews"][0]["byteStride"] = json!(0);
    assert_eq!(read(&bomb).unwrap_err(), beyond);
}

proptest::proptest! {
    #[test]
    fn damaged_files_are_bearable(damage in proptest::collection::vec((proptest::prelude::any::<proptest::sample::Index>(), proptest::prelude::any::<u8>()), 0..6)) {
        let mut bytes = Vec::new();
        super::write_to(&mut bytes, &triangle()).unwrap();
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let _ = super::parse(std::path::Path::new("a.glb"), &bytes);
    }
}
