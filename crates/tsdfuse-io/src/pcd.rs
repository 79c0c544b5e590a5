//! PCD, the point clouds of PCL: `ascii`, `binary` and `binary_compressed`.
//!
//! The fields are those of [`columns`](crate::columns). Invalid points of organized clouds (NaN) stay in. A `VIEWPOINT`
//! is where the sensor was in the world.

use std::path::Path;

use tsdfuse::glam::DVec3;

use crate::cloud::Cloud;
use crate::columns::Columns;
use crate::error::{Error, Result};

mod header;
mod lzf;

use header::Encoding;
pub(crate) use header::Header;

/// Parses a PCD file; `path` is for messages.
///
/// # Errors
/// Names the file and what its header promises but its bytes do not keep.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let header = Header::parse(path, bytes)?;
    let mut cloud = columns(path, bytes, &header)?.into_cloud(path)?;
    cloud.viewpoint = header.viewpoint;
    Ok(cloud)
}

/// Parses the points of a PCD file alone, with all their digits.
///
/// # Errors
/// As [`parse`].
pub(crate) fn parse_points(path: &Path, bytes: &[u8]) -> Result<Vec<DVec3>> {
    Ok(columns(path, bytes, &Header::parse(path, bytes)?)?.into_points())
}

fn columns(path: &Path, bytes: &[u8], header: &Header) -> Result<Columns> {
    let body = bytes.get(header.bytes..).unwrap_or_default();
    let names: Vec<_> = header.fields.iter().map(|f| (f.name.as_str(), f.scalar)).collect();
    let mut columns = Columns::pick(path, &names)?;
    match header.encoding {
        Encoding::Ascii => ascii(path, header, body, &mut columns)?,
        Encoding::Binary => {
            let stride = header.stride;
            let wanted = header.points.checked_mul(stride);
            let records = wanted.and_then(|n| body.get(..n)).ok_or_else(|| {
                let reason = format!(
                    "is truncated: {} bytes for {} points of {stride}",
                    body.len(),
                    header.points
                );
                Error::format(path, reason)
            })?;
            for (field, scalar, values) in columns.each() {
                let offset = header.fields[field].offset;
                values.extend(
                    records
                        .chunks_exact(stride)
                        .filter_map(|r| scalar.read(r.get(offset..)?)),
                );
            }
        }
        Encoding::Compressed => {
            let body = decompress(path, header, body)?;
            for (field, scalar, values) in columns.each() {
                // Field after field, each for all points. Only the first of a field's numbers counts.
                let field = &header.fields[field];
                let start = field.offset * header.points;
                let of_field = body.get(start..start + field.size * header.points).unwrap_or_default();
                values.extend(of_field.chunks_exact(field.size).filter_map(|v| scalar.read(v)));
            }
        }
    }
    Ok(columns)
}

fn ascii(path: &Path, header: &Header, body: &[u8], columns: &mut Columns) -> Result<()> {
    let text = std::str::from_utf8(body).map_err(|_| Error::format(path, "its points are not text"))?;
    let mut rows = text.lines().map(str::trim).filter(|row| !row.is_empty());
    for point in 0..header.points {
        let wrong = |what: String| Error::format(path, format!("point {point} of {}: {what}", header.points));
        let row = rows.next().ok_or_else(|| wrong("is missing".to_owned()))?;
        let words: Vec<_> = row.split_ascii_whitespace().collect();
        if words.len() != header.words {
            return Err(wrong(format!("has {} numbers, not {}", words.len(), header.words)));
        }
        for (field, _, values) in columns.each() {
            let word = words[header.fields[field].first_word];
            values.push(word.parse().map_err(|_| wrong(format!("{word:?} is not a number")))?);
        }
    }
    Ok(())
}

fn decompress(path: &Path, header: &Header, body: &[u8]) -> Result<Vec<u8>> {
    let wrong = |what: &str| Error::format(path, format!("its compressed points {what}"));
    let size = |at: usize| {
        let bytes = body.get(at..)?.first_chunk()?;
        usize::try_from(u32::from_le_bytes(*bytes)).ok()
    };
    let (Some(packed), Some(unpacked)) = (size(0), size(4)) else {
        return Err(wrong("are missing"));
    };
    if header.points.checked_mul(header.stride) != Some(unpacked) {
        return Err(wrong(&format!(
            "are {unpacked} bytes for {} points of {}",
            header.points, header.stride
        )));
    }
    let packed = body
        .get(8..)
        .and_then(|rest| rest.get(..packed))
        .ok_or_else(|| wrong("are truncated"))?;
    lzf::decompress(packed, unpacked).ok_or_else(|| wrong("are damaged"))
}

#[cfg(test)]
mod tests;
