//! KITTI's point files: x y z intensity of each point as little-endian `f32`; and side files with one number per point.

use std::path::Path;

use tsdfuse::glam::Vec3;

use crate::cloud::Cloud;
use crate::error::{Error, Result};

/// Parses a `.bin` file; `path` is for messages.
///
/// # Errors
/// Names the file if its size is no multiple of 16 bytes.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let (records, []) = bytes.as_chunks::<16>() else {
        let reason = format!(
            "is truncated: {} bytes are not a multiple of 16 (x y z intensity)",
            bytes.len()
        );
        return Err(Error::format(path, reason));
    };
    let number = |r: &[u8; 16], i: usize| f32::from_le_bytes([r[i], r[i + 1], r[i + 2], r[i + 3]]);
    Ok(Cloud {
        points: records
            .iter()
            .map(|r| Vec3::new(number(r, 0), number(r, 4), number(r, 8)))
            .collect(),
        intensities: Some(records.iter().map(|r| number(r, 12)).collect()),
        ..Default::default()
    })
}

/// Parses a side file: one little-endian number of `N` bytes for each of `points` points.
pub(crate) fn column<T, const N: usize>(
    path: &Path,
    bytes: &[u8],
    points: usize,
    number: fn([u8; N]) -> T,
) -> Result<Vec<T>> {
    match bytes.as_chunks::<N>() {
        (values, []) if values.len() == points => Ok(values.iter().map(|v| number(*v)).collect()),
        _ => {
            let reason = format!("{} bytes where {points} points of {N} bytes were expected", bytes.len());
            Err(Error::format(path, reason))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_come_as_they_are_and_truncation_is_told() {
        let values = [1.0_f32, 2.0, 3.0, 0.5, f32::NAN, -0.0, 0.0, 255.0];
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let cloud = parse(Path::new("7.bin"), &bytes).unwrap();
        assert_eq!(cloud.points[0], Vec3::new(1.0, 2.0, 3.0));
        assert!(cloud.points[1].x.is_nan());
        assert_eq!(cloud.intensities, Some(vec![0.5, 255.0]));
        let message = parse(Path::new("7.bin"), &bytes[..31]).unwrap_err().to_string();
        assert_eq!(
            message,
            "7.bin: is truncated: 31 bytes are not a multiple of 16 (x y z intensity)"
        );
        assert_eq!(parse(Path::new("7.bin"), &[]).unwrap().points.len(), 0);
    }

    #[test]
    fn a_column_has_one_number_a_point() {
        let column = |bytes: &[u8]| column(Path::new("7.u16"), bytes, 2, u16::from_le_bytes).map_err(|e| e.to_string());
        assert_eq!(column(&[1, 0, 0, 1]), Ok(vec![1, 256]));
        assert_eq!(
            column(&[1, 0, 0]).unwrap_err(),
            "7.u16: 3 bytes where 2 points of 2 bytes were expected"
        );
        assert!(column(&[0; 6]).is_err());
    }
}
