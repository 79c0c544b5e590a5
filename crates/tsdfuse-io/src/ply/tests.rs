use std::path::Path;

use proptest::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use super::{parse_cloud, parse_mesh};
use crate::cloud::Cloud;

fn cloud(bytes: &[u8]) -> Result<Cloud, String> {
    parse_cloud(Path::new("a.ply"), bytes).map_err(|e| e.to_string())
}

fn mesh(bytes: &[u8]) -> Result<Mesh, String> {
    parse_mesh(Path::new("a.ply"), bytes).map_err(|e| e.to_string())
}

fn written(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = Vec::new();
    super::write_to(&mut bytes, mesh).unwrap();
    bytes
}

fn square(scale: f64) -> Mesh {
    Mesh {
        vertices: vec![DVec3::ZERO, DVec3::X * scale, DVec3::new(scale, scale, 0.125), DVec3::Y],
        normals: vec![Vec3::Z; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// The square with a quadrilateral face, as other programs write it, in each encoding.
fn quadrilaterals() -> [Vec<u8>; 3] {
    let header = |format: &str| {
        format!(
            "ply\r\nformat {format} 1.0\r\ncomment hello\r\nobj_info x\r\nelement camera 1\r\nproperty float f\r\n\
             element vertex 4\r\nproperty list uchar short tags\r\nproperty double x\r\nproperty double y\r\n\
             property float z\r\nelement face 1\r\nproperty uchar red\r\nproperty list uint8 int32 vertex_index\r\nend_header\r\n"
        )
    };
    let mut ascii = header("ascii").into_bytes();
    ascii.extend(b"50\n1 7 0 0 0\n0 1 0 0\n2 1 1 1 1 0.125\n0 0 1 0\n255 4 0 1 2 3\n");
    let mut little = header("binary_little_endian").into_bytes();
    let mut big = header("binary_big_endian").into_bytes();
    let mut put = |values: &[&[u8]]| {
        for bytes in values {
            little.extend(*bytes);
            big.extend(bytes.iter().rev());
        }
    };
    put(&[&50_f32.to_le_bytes()]);
    for (tags, vertex) in [
        (1_u8, DVec3::ZERO),
        (0, DVec3::X),
        (2, DVec3::new(1.0, 1.0, 0.125)),
        (0, DVec3::Y),
    ] {
        put(&[&[tags]]);
        (0..tags).for_each(|_| put(&[&7_i16.to_le_bytes()]));
        put(&[
            &vertex.x.to_le_bytes(),
            &vertex.y.to_le_bytes(),
            &(vertex.z as f32).to_le_bytes(),
        ]);
    }
    put(&[&[255], &[4]]);
    (0..4_i32).for_each(|i| put(&[&i.to_le_bytes()]));
    [ascii, little, big]
}

#[test]
fn what_is_written_is_read() {
    for scale in [1.0, 5e6] {
        assert_eq!(mesh(&written(&square(scale))), Ok(square(scale)));
    }
    assert_eq!(mesh(&written(&Mesh::default())), Ok(Mesh::default()));
}

#[test]
fn polygons_become_fans_in_every_encoding() {
    for bytes in quadrilaterals() {
        let read = mesh(&bytes).unwrap();
        assert_eq!(
            (read.vertices, read.triangles),
            (square(1.0).vertices, square(1.0).triangles)
        );
        assert!(read.normals.is_empty());
        assert_eq!(cloud(&bytes).unwrap().points[2], Vec3::new(1.0, 1.0, 0.125));
    }
}

#[test]
fn columns_of_clouds_are_read() {
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
                property float scalar_Intensity\nproperty uchar ring\nproperty uint t\nend_header\n\
                1 2 3 0.5 0 0\n2 3 nan 0.25 0 100000000\n";
    let read = cloud(text.as_bytes()).unwrap();
    assert_eq!(read.points[0], Vec3::new(1.0, 2.0, 3.0));
    assert!(read.points[1].z.is_nan());
    assert_eq!(
        (read.intensities, read.rings),
        (Some(vec![0.5, 0.25]), Some(vec![0, 0]))
    );
    assert_eq!(read.secs, Some(vec![0.0, 0.1]));
}

#[test]
fn lies_and_damage_are_named() {
    let vertices = |count: &str| {
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{xyz}end_header\n").into_bytes()
    };
    let with = |mut head: Vec<u8>, n: usize| {
        head.extend(vec![0; n]);
        cloud(&head).unwrap_err()
    };
    assert_eq!(
        with(vertices("1000000000000"), 24),
        "a.ply: vertex 2 of 1000000000000: the file ends before it"
    );
    assert_eq!(with(vertices("3"), 35), "a.ply: vertex 2 of 3: the file ends before it");
    assert_eq!(with(vertices("-3"), 35), "a.ply: header line 3: \"-3\" is not a count");
    let header = |text: &str| cloud(text.as_bytes()).unwrap_err();
    assert_eq!(header("plx\n"), "a.ply: is no PLY file: it does not begin with ply");
    assert_eq!(
        header("ply\nformat ascii 1.0\n"),
        "a.ply: is no PLY file: its header does not end"
    );
    assert_eq!(
        header("ply\nend_header\n"),
        "a.ply: header line 2: the header does not tell the format"
    );
    assert_eq!(
        header("ply\nproperty float x\n"),
        "a.ply: header line 2: a property of no element"
    );
    assert_eq!(
        header("ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int a\n"),
        "a.ply: header line 4: \"property list float int a\" is no property"
    );
    assert_eq!(
        header("ply\nformat ascii 1.0\nelement face 1\nend_header\n"),
        "a.ply: has no vertices"
    );
    // Rows of nothing take no time, however many there are.
    assert_eq!(
        header("ply\nformat ascii 1.0\nelement a 99999999999999\nend_header\n"),
        "a.ply: has no vertices"
    );
    let faces = String::from_utf8(quadrilaterals()[0].clone()).unwrap();
    let message = |from: &str, to: &str| mesh(faces.replace(from, to).as_bytes()).unwrap_err();
    assert_eq!(
        message("4 0 1 2 3", "4 0 1 2 4"),
        "a.ply: face 0 of 1: corner 4 is none of 4 vertices"
    );
    assert_eq!(
        message("4 0 1 2 3", "4 0 1 2 -1"),
        "a.ply: face 0 of 1: corner -1 is none of 4 vertices"
    );
    assert_eq!(
        message("4 0 1 2 3", "4 0 1 2 nan"),
        "a.ply: face 0 of 1: corner NaN is none of 4 vertices"
    );
    assert_eq!(message("4 0 1 2 3", "-4"), "a.ply: face 0 of 1: a list of -4 numbers");
    assert_eq!(
        message("4 0 1 2 3", "4000000000 0"),
        "a.ply: face 0 of 1: the file ends before it"
    );
    assert_eq!(
        message("vertex 4", "vertex 5000000000"),
        "a.ply: has 5000000000 vertices, more than can be numbered"
    );
    assert_eq!(
        message("double x", "double a"),
        "a.ply: its vertices have no x, y and z"
    );
}

proptest! {
    #[test]
    fn any_bytes_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = (cloud(&bytes), mesh(&bytes));
    }

    #[test]
    fn damaged_files_are_bearable(
        which in 0_usize..4,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        end in any::<prop::sample::Index>(),
    ) {
        let mut bytes = quadrilaterals().get(which).cloned().unwrap_or_else(|| written(&square(1.0)));
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let _ = (cloud(&bytes), mesh(&bytes));
        let _ = (cloud(&bytes[..end.index(bytes.len())]), mesh(&bytes[..end.index(bytes.len())]));
    }
}
