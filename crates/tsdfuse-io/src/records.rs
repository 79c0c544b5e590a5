//! Files of points that are nothing but records of one layout, little-endian.

use std::path::Path;

use crate::cloud::Cloud;
use crate::columns::Columns;
use crate::error::{Error, Result};
use crate::scalar::Scalar;

/// Parses a file of records with these fields; names mean what [`columns`](crate::columns) says, others are passed over.
///
/// # Errors
/// Names the file if its size is no multiple of a record's.
pub(crate) fn parse(path: &Path, bytes: &[u8], fields: &[(&str, Scalar)]) -> Result<Cloud> {
    let size: usize = fields.iter().map(|(_, scalar)| scalar.size()).sum();
    let records = bytes.chunks_exact(size.max(1));
    if !records.remainder().is_empty() {
        let names: Vec<_> = fields.iter().map(|(name, _)| *name).collect();
        let reason = format!(
            "is truncated: {} bytes are not a multiple of {size} ({})",
            bytes.len(),
            names.join(" ")
        );
        return Err(Error::format(path, reason));
    }
    let mut columns = Columns::pick(path, fields)?;
    for (field, scalar, values) in columns.each() {
        let begin: usize = fields[..field].iter().map(|(_, scalar)| scalar.size()).sum();
        values.extend(records.clone().filter_map(|record| scalar.read(record.get(begin..)?)));
    }
    columns.into_cloud(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::Vec3;

    #[test]
    fn fields_are_where_the_layout_says() {
        let layout = [
            ("x", Scalar::F32),
            ("tag", Scalar::U8),
            ("y", Scalar::F32),
            ("z", Scalar::F32),
            ("t", Scalar::U32),
            ("ring", Scalar::U16),
        ];
        let record = |x: f32, t: u32, ring: u16| {
            [
                &x.to_le_bytes()[..],
                &[7],
                &2f32.to_le_bytes(),
                &3f32.to_le_bytes(),
                &t.to_le_bytes(),
                &ring.to_le_bytes(),
            ]
            .concat()
        };
        let bytes = [record(1.0, 0, 0), record(-1.0, 50_000_000, 1)].concat();
        let cloud = parse(Path::new("a.bin"), &bytes, &layout).unwrap();
        assert_eq!(cloud.points, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(-1.0, 2.0, 3.0)]);
        assert_eq!(cloud.secs, Some(vec![0.0, 0.05]));
        let message = parse(Path::new("a.bin"), &bytes[1..], &layout).unwrap_err().to_string();
        assert_eq!(
            message,
            "a.bin: is truncated: 37 bytes are not a multiple of 19 (x tag y z t ring)"
        );
    }
}
