//! The points of a scan as rows of little-endian numbers, of which PCD files and messages of clouds are made.

use tsdfuse::Scan;

use crate::scalar::Scalar;

/// The columns of a row, in order: `x y z`, metres, and as far as the scan has them `intensity`, `time` (seconds after its pose) and `ring`.
pub(crate) fn columns(scan: &Scan) -> Vec<(&'static str, Scalar)> {
    let all = [
        ("x", Scalar::F32, true),
        ("y", Scalar::F32, true),
        ("z", Scalar::F32, true),
        ("intensity", Scalar::F32, scan.intensities.is_some()),
        ("time", Scalar::F32, scan.times.is_some()),
        ("ring", Scalar::U16, scan.rings.is_some()),
    ];
    let there = all.into_iter().filter(|(.., is_there)| *is_there);
    there.map(|(name, scalar, _)| (name, scalar)).collect()
}

/// Appends a row for each point.
pub(crate) fn append(scan: &Scan, bytes: &mut Vec<u8>) {
    let stride: usize = columns(scan).iter().map(|(_, scalar)| scalar.size()).sum();
    bytes.reserve(stride * scan.points.len());
    for (i, point) in scan.points.iter().enumerate() {
        bytes.extend(point.to_array().into_iter().flat_map(f32::to_le_bytes));
        for column in [&scan.intensities, &scan.times] {
            let value = column.iter().filter_map(|values| values.get(i));
            bytes.extend(value.flat_map(|v| v.to_le_bytes()));
        }
        let ring = scan.rings.iter().filter_map(|rings| rings.get(i));
        bytes.extend(ring.flat_map(|v| v.to_le_bytes()));
    }
}
