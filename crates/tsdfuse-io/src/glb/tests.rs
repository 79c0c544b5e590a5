use gltf_json::Root;
use gltf_json::validation::Validate;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

/// The document and the buffer of a GLB file, by an independent parser.
fn parsed(mesh: &Mesh) -> (Root, Vec<u8>) {
    let mut bytes = Vec::new();
    super::write_to(&mut bytes, mesh).unwrap();
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
