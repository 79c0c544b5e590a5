//! Just enough of PLY to check what was written, independent of the library's own reader.

use std::path::Path;

use glam::DVec3;

/// Positions of the vertices, and the number of triangles, of a binary PLY with float or double coordinates.
pub(crate) fn read(path: &Path) -> (Vec<DVec3>, usize) {
    parse(&std::fs::read(path).unwrap())
}

pub(crate) fn parse(bytes: &[u8]) -> (Vec<DVec3>, usize) {
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|w| w == END).unwrap() + END.len();
    let (header, body) = (std::str::from_utf8(&bytes[..end]).unwrap(), &bytes[end..]);
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"), "{header}");
    let count = |element: &str| -> usize {
        let line = header.lines().find_map(|line| line.strip_prefix(element)).unwrap();
        line.trim().parse().unwrap()
    };
    let (vertices, faces) = (count("element vertex"), count("element face"));
    let double = header.contains("property double x\n");
    let stride: usize = header
        .lines()
        .map(|line| match line.split(' ').nth(1) {
            Some("float") => 4,
            Some("double") => 8,
            _ => 0,
        })
        .sum();
    assert_eq!(body.len(), vertices * stride + faces * 13, "{header}");
    let coordinate = |bytes: &[u8], i: usize| {
        if double {
            f64::from_le_bytes(bytes[8 * i..8 * i + 8].try_into().unwrap())
        } else {
            f64::from(f32::from_le_bytes(bytes[4 * i..4 * i + 4].try_into().unwrap()))
        }
    };
    let vertex = |bytes: &[u8]| DVec3::from([0, 1, 2].map(|i| coordinate(bytes, i)));
    (body[..vertices * stride].chunks(stride).map(vertex).collect(), faces)
}
