use std::path::Path;

use proptest::prelude::*;
use tsdfuse::glam::{DVec3, Vec3};

use super::parse;
use crate::cloud::Cloud;

fn read(bytes: &[u8]) -> Result<Cloud, String> {
    parse(Path::new("a.pcd"), bytes).map_err(|e| e.to_string())
}

/// A header for x, a padding of two bytes, y, z, and a time in nanoseconds.
fn header(points: &str, data: &str) -> String {
    format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x _ y z t\nSIZE 4 1 4 8 4\nTYPE F U F F U\nCOUNT 1 2 1 1 1\n\
         WIDTH {points}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
    )
}

/// The same two points in each encoding.
fn samples() -> [Vec<u8>; 3] {
    let points = [(1.0_f32, 2.0_f32, 3.0_f64, 7_u32), (f32::NAN, -5.0, 6.5, 50_000_000)];
    let mut ascii = header("2", "ascii").into_bytes();
    let mut binary = header("2", "binary").into_bytes();
    let mut columns: [Vec<u8>; 5] = Default::default();
    for (x, y, z, t) in points {
        ascii.extend(format!("{x} 0 0 {y} {z} {t}\n").into_bytes());
        let fields = [
            x.to_le_bytes().to_vec(),
            vec![9, 9],
            y.to_le_bytes().to_vec(),
            z.to_le_bytes().to_vec(),
            t.to_le_bytes().to_vec(),
        ];
        binary.extend(fields.concat());
        columns
            .iter_mut()
            .zip(&fields)
            .for_each(|(column, bytes)| column.extend(bytes));
    }
    // Literal runs are valid LZF.
    let unpacked = columns.concat();
    let packed: Vec<u8> = unpacked
        .chunks(32)
        .flat_map(|run| [vec![run.len() as u8 - 1], run.to_vec()].concat())
        .collect();
    let mut compressed = header("2", "binary_compressed").into_bytes();
    compressed.extend((packed.len() as u32).to_le_bytes());
    compressed.extend((unpacked.len() as u32).to_le_bytes());
    compressed.extend(packed);
    [ascii, binary, compressed]
}

#[test]
fn all_encodings_give_the_same_cloud() {
    for sample in samples() {
        let cloud = read(&sample).unwrap();
        assert_eq!(cloud.points[0], Vec3::new(1.0, 2.0, 3.0));
        assert!(cloud.points[1].x.is_nan() && cloud.points[1].z == 6.5);
        assert_eq!(cloud.secs, Some(vec![7e-9, 0.05]));
        assert_eq!(cloud.viewpoint.unwrap().translation, DVec3::new(1.0, 2.0, 3.0));
    }
}

#[test]
fn a_header_that_lies_is_told_so() {
    let body = &[0_u8; 44][..];
    for (head, message) in [
        (
            header("4294967295", "binary"),
            "is truncated: 44 bytes for 4294967295 points of 22",
        ),
        (
            header("18446744073709551615", "binary"),
            "is truncated: 44 bytes for 18446744073709551615 points of 22",
        ),
        (
            header("99999999999999999999", "binary"),
            "WIDTH 99999999999999999999 is not a number",
        ),
        (header("3", "binary"), "is truncated: 44 bytes for 3 points of 22"),
        (
            header("2", "binary").replace("HEIGHT 1", "HEIGHT 2"),
            "2 POINTS are not WIDTH x HEIGHT",
        ),
        (
            header("2", "binary").replace("SIZE 4 1", "SIZE 3 1"),
            "field x: there is no TYPE F of SIZE 3",
        ),
        (
            header("2", "binary").replace("COUNT 1 2", "COUNT 1 99999999999999999999"),
            "field _: its COUNT is not possible",
        ),
        (
            header("2", "binary").replace("COUNT 1 2", "COUNT 1 18446744073709551615"),
            "field _: its COUNT is not possible",
        ),
        (
            header("2", "binary").replace("COUNT 1 2", "COUNT 1"),
            "5 FIELDS but 4 entries in COUNT",
        ),
        (header("2", "binary").replace("FIELDS x", "FIELDS a"), "has no field x"),
        (
            header("2", "binary").replace("1 2 3 1 0", "1 2 3 5 0"),
            "VIEWPOINT: the pose is not rigid: its 3x3 part is 2.40e1 away from a rotation",
        ),
        (
            header("2", "binary").replace("1 2 3 1 0", "3 1 0"),
            "VIEWPOINT has 7 numbers",
        ),
        (header("2", "zip"), "DATA zip is not known"),
        (
            header("2", "binary_compressed"),
            "its compressed points are 0 bytes for 2 points of 22",
        ),
        (header("2", "ascii"), "point 0 of 2: has 1 numbers, not 6"),
        (
            "VERSION 0.7\n".to_owned(),
            "is no PCD file: its header has no DATA line",
        ),
    ] {
        assert_eq!(
            read(&[head.as_bytes(), body].concat()).unwrap_err(),
            format!("a.pcd: {message}")
        );
    }
    // A header's word reserves nothing, and a few bytes do not become billions of points.
    for (points, message) in [
        (
            "16777217",
            "has 16777217 compressed points; more than 16777216 are read only with DATA binary",
        ),
        ("16777216", "its compressed points are damaged"),
    ] {
        let mut bomb = header(points, "binary_compressed").into_bytes();
        let size: u32 = points.parse().unwrap();
        bomb.extend([100, 0, 0, 0]);
        bomb.extend((size * 22).to_le_bytes());
        bomb.extend([0xff; 100]);
        assert_eq!(read(&bomb).unwrap_err(), format!("a.pcd: {message}"));
    }
    let mut damaged = samples()[2].clone();
    let at = damaged.len() - 20;
    damaged[at] ^= 0xff;
    damaged.truncate(at + 10);
    assert_eq!(
        read(&damaged).unwrap_err(),
        "a.pcd: its compressed points are truncated"
    );
}

#[test]
fn rings_of_an_upside_down_numbering_are_turned_over() {
    let mut text = "FIELDS x y z ring\nSIZE 4 4 4 1\nTYPE F F F U\nWIDTH 4\nHEIGHT 16\nDATA ascii\n".to_owned();
    for ring in 0..16 {
        for x in 1..5 {
            text += &format!("{x} 1 {} {ring}\n", f64::from(x) * (0.3 - 0.02 * f64::from(ring)));
        }
    }
    let cloud = read(text.as_bytes()).unwrap();
    let rings = cloud.rings.unwrap();
    assert_eq!((rings[0], rings[63], rings.len()), (15, 0, 64));
}

proptest! {
    #[test]
    fn any_bytes_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = read(&bytes);
    }

    #[test]
    fn damaged_files_are_bearable(
        which in 0_usize..3,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        end in any::<prop::sample::Index>(),
    ) {
        let mut bytes = samples()[which].clone();
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let _ = read(&bytes);
        let _ = read(&bytes[..end.index(bytes.len())]);
    }
}

/// Files of PCL's and Open3D's writers: `testdata/cloud*.pcd` are the same 40 points.
#[test]
fn files_of_other_programs_are_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/pcd");
    let of = |name: &str| {
        let path = folder.join(name);
        parse(&path, &std::fs::read(&path).unwrap()).unwrap()
    };
    let ascii = of("ascii.pcd");
    assert_eq!(ascii.points.len(), 40);
    for name in ["binary.pcd", "compressed.pcd"] {
        let other = of(name);
        let largest = ascii
            .points
            .iter()
            .zip(&other.points)
            .map(|(a, b)| a.distance(*b))
            .fold(0.0, f32::max);
        assert!(largest < 1e-5, "{name}: {largest}");
    }
}
