//! PCD, the point clouds of PCL: `ascii`, `binary` and `binary_compressed`.
//!
//! [`columns`](crate::columns) says what the fields mean. Invalid points of organized clouds (NaN) are kept. `VIEWPOINT` is the
//! pose of the sensor in the world.

use std::path::Path;

use tsdfuse::glam::DVec3;

use crate::cloud::Cloud;
use crate::columns::Columns;
use crate::error::{Error, Result};

mod header;
mod lzf;
mod write;

use header::Encoding;
pub(crate) use header::Header;
use lzf::Decompress;
pub(crate) use write::write;

/// The most compressed points that are read: 64 times what the largest sensors measure in one sweep. Compressed, a few megabytes
/// can stand for billions of points; uncompressed, the file is as large as its points.
const MAX_COMPRESSED: usize = 1 << 24;

/// Parses a PCD file; `path` is for messages.
///
/// # Errors
/// Names the file and what is wrong: with its header, or with the bytes that should follow.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let header = Header::parse(path, bytes)?;
    let mut cloud = columns(path, bytes, &header)?.into_cloud(path)?;
    cloud.viewpoint = header.viewpoint;
    Ok(cloud)
}

/// Parses only the positions of a PCD file, in double precision.
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
        Encoding::Compressed => compressed(path, header, body, &mut columns)?,
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

/// Reads compressed points, which are stored field after field, each for all points. They are decompressed piece by piece, and
/// only the columns are kept. Only the first number of a field counts.
fn compressed(path: &Path, header: &Header, body: &[u8], columns: &mut Columns) -> Result<()> {
    let wrong = |what: &str| Error::format(path, format!("its compressed points {what}"));
    let size = |at: usize| {
        let bytes = body.get(at..)?.first_chunk()?;
        usize::try_from(u32::from_le_bytes(*bytes)).ok()
    };
    let (Some(packed), Some(unpacked)) = (size(0), size(4)) else {
        return Err(wrong("are missing"));
    };
    let points = header.points;
    if points.checked_mul(header.stride) != Some(unpacked) {
        return Err(wrong(&format!(
            "are {unpacked} bytes for {points} points of {}",
            header.stride
        )));
    }
    if points > MAX_COMPRESSED {
        let reason =
            format!("has {points} compressed points; more than {MAX_COMPRESSED} are read only with DATA binary");
        return Err(Error::format(path, reason));
    }
    let packed = body
        .get(8..)
        .and_then(|rest| rest.get(..packed))
        .ok_or_else(|| wrong("are truncated"))?;
    let mut of_fields: Vec<_> = header.fields.iter().map(|_| None).collect();
    for (field, scalar, values) in columns.each() {
        of_fields[field] = Some((scalar, values));
    }
    let read = || {
        let mut bytes = Decompress::new(packed, unpacked)?;
        for (field, column) in header.fields.iter().zip(of_fields) {
            let Some((scalar, values)) = column else {
                bytes.skip(field.size * points)?;
                continue;
            };
            values.reserve_exact(points);
            for _ in 0..points {
                values.push(scalar.read(bytes.take(scalar.size())?)?);
                bytes.skip(field.size - scalar.size())?;
            }
        }
        bytes.is_at_end().then_some(())
    };
    read().ok_or_else(|| wrong("are damaged"))
}

#[cfg(test)]
mod tests;
