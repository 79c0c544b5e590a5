//! Tables as Arrow's IPC files (Feather, version 2): columns of numbers and texts, uncompressed or packed by LZ4 or Zstandard.
//!
//! Written for the few types that LiDAR data sets use; the crates of Arrow would make the first build noticeably longer. Layout:
//! <https://arrow.apache.org/docs/format/Columnar.html>. Nothing is allocated by a number in the file alone.

use std::path::Path;

use crate::compression::Compression;
use crate::error::{Error, Result};
use crate::flatbuffer::Table;

const MAGIC: &[u8] = b"ARROW1";
/// More columns or batches than any file has.
const MAX_PARTS: usize = 1 << 16;

/// The columns that were asked for.
#[derive(Debug)]
pub(crate) struct Columns(Vec<Values>);

#[derive(Debug)]
enum Values {
    Floats(Vec<f64>),
    Integers(Vec<i64>),
    Texts(Vec<String>),
}

/// A type that is read.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    F16,
    F32,
    F64,
    /// Bytes of one, and whether it has a sign.
    Integer(usize, bool),
    /// Bytes of an offset.
    Text(usize),
    /// How many buffers a column of it has.
    Other(usize),
}

impl Kind {
    /// The type of a field of the schema, and its name.
    fn of<'a>(field: &Table<'a>) -> Option<(&'a str, Self)> {
        let details = field.table(3)?;
        let kind = match field.u8(2)? {
            1 => Self::Other(0), // null
            2 => match details.u32(0).unwrap_or(0) {
                bits @ (8 | 16 | 32 | 64) => Self::Integer(bits as usize / 8, details.u8(1).unwrap_or(0) != 0),
                _ => return None,
            },
            3 => match details.u8(0).unwrap_or(0) {
                0 => Self::F16,
                1 => Self::F32,
                2 => Self::F64,
                _ => return None,
            },
            4 | 19 => Self::Other(3), // bytes
            5 => Self::Text(4),
            20 => Self::Text(8),
            6..=11 | 15 | 18 => Self::Other(2), // booleans, decimals, dates, times, bytes of fixed length, durations
            _ => return None,                   // nested
        };
        // Values by dictionary are indices.
        let kind = if field.table(4).is_some() { Self::Other(2) } else { kind };
        Some((field.text(0)?, kind))
    }

    fn buffers(self) -> usize {
        match self {
            Self::Text(_) => 3,
            Self::Other(buffers) => buffers,
            _ => 2,
        }
    }

    fn size(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
            Self::Integer(bytes, _) => bytes,
            Self::Text(bytes) => bytes,
            Self::Other(_) => 0,
        }
    }

    fn empty(self) -> Option<Values> {
        Some(match self {
            Self::F16 | Self::F32 | Self::F64 => Values::Floats(Vec::new()),
            Self::Integer(..) => Values::Integers(Vec::new()),
            Self::Text(_) => Values::Texts(Vec::new()),
            Self::Other(_) => return None,
        })
    }
}

/// Reads the columns of these names; `path` is for messages.
///
/// # Errors
/// Names the file and what is wrong, or the column that is missing.
pub(crate) fn parse(path: &Path, bytes: &[u8], names: &[&str]) -> Result<Columns> {
    let damaged = || Error::format(path, "is no Feather file, or damaged");
    let wrong = |reason: String| Error::format(path, reason);
    let footer = footer(bytes).ok_or_else(damaged)?;
    let fields = footer
        .table(1)
        .and_then(|schema| schema.tables(1))
        .ok_or_else(damaged)?;
    let fields: Vec<_> = fields.take(MAX_PARTS).map(|field| Kind::of(&field)).collect();
    let mut wanted = Vec::new();
    for name in names {
        let found = fields.iter().position(|field| field.is_some_and(|(n, _)| n == *name));
        let found = found.ok_or_else(|| wrong(format!("has no column {name}")))?;
        let empty = fields[found].and_then(|(_, kind)| Some((kind, kind.empty()?)));
        wanted.push((
            found,
            empty.ok_or_else(|| wrong(format!("column {name} has a type that is not read")))?,
        ));
    }
    let blocks = footer.vector(3, 24).into_iter().flatten().take(MAX_PARTS);
    for block in blocks {
        let batch = Batch::read(bytes, block).ok_or_else(damaged)?;
        for (found, (kind, values)) in &mut wanted {
            let before: Option<usize> = fields[..*found]
                .iter()
                .map(|field| Some(field.as_ref()?.1.buffers()))
                .sum();
            let before = before.ok_or_else(|| wrong("has columns of columns before those that are read".to_owned()))?;
            batch.append(*kind, before, values).map_err(wrong)?;
        }
    }
    Ok(Columns(wanted.into_iter().map(|(_, (_, values))| values).collect()))
}

fn footer(bytes: &[u8]) -> Option<Table<'_>> {
    let rest = bytes.strip_suffix(MAGIC).filter(|_| bytes.starts_with(MAGIC))?;
    let (rest, size) = rest.split_last_chunk::<4>()?;
    let begin = rest.len().checked_sub(u32::from_le_bytes(*size) as usize)?;
    Table::root_without_size(&rest[begin..])
}

/// Some rows of all columns.
struct Batch<'a> {
    rows: usize,
    buffers: Vec<&'a [u8]>,
    compression: Compression,
}

impl<'a> Batch<'a> {
    /// The batch at a block of the footer: where its message begins, the length of its metadata and that of its body.
    fn read(bytes: &'a [u8], block: &[u8]) -> Option<Self> {
        let at = |range: std::ops::Range<usize>| -> Option<usize> {
            let mut number = [0; 8];
            let part = block.get(range)?;
            number.get_mut(..part.len())?.copy_from_slice(part);
            usize::try_from(u64::from_le_bytes(number)).ok()
        };
        let (begin, head, length) = (at(0..8)?, at(8..12)?, at(16..24)?);
        let message = bytes.get(begin..begin.checked_add(head)?)?;
        let body = bytes.get(begin + head..(begin + head).checked_add(length)?)?;
        // Since 2019 there is a mark before the length.
        let message = message.strip_prefix(&[0xFF; 4]).unwrap_or(message).get(4..)?;
        let batch = Table::root_without_size(message)?.table(2)?;
        let buffers = batch.vector(2, 16)?.take(4 * MAX_PARTS).map(|buffer| {
            let number = |at: usize| usize::try_from(u64::from_le_bytes(buffer.get(at..at + 8)?.try_into().ok()?)).ok();
            let (begin, length) = (number(0)?, number(8)?);
            body.get(begin..begin.checked_add(length)?)
        });
        let compression = match batch.table(3) {
            None => Compression::None,
            Some(packed) if packed.u8(0).unwrap_or(0) == 0 => Compression::Lz4,
            Some(_) => Compression::Zstd,
        };
        Some(Self {
            rows: usize::try_from(batch.u64(0).unwrap_or(0)).ok()?,
            buffers: buffers.collect::<Option<_>>()?,
            compression,
        })
    }

    /// A buffer, unpacked.
    fn buffer(&self, number: usize) -> Result<Vec<u8>, String> {
        let short = || "ends within a column".to_owned();
        let packed = self.buffers.get(number).copied().ok_or_else(short)?;
        if self.compression == Compression::None || packed.is_empty() {
            return Ok(packed.to_vec());
        }
        let (size, packed) = packed.split_first_chunk::<8>().ok_or_else(short)?;
        match i64::from_le_bytes(*size) {
            -1 => Ok(packed.to_vec()),
            size => {
                let size = u64::try_from(size).map_err(|_| short())?;
                let unpacked = self.compression.unpack(packed.to_vec(), size);
                unpacked.map_err(|reason| format!("a column {reason}"))
            }
        }
    }

    /// Appends the rows of a column whose buffers begin with this one. Rows without a value get NaN, 0 or an empty text.
    fn append(&self, kind: Kind, first: usize, values: &mut Values) -> Result<(), String> {
        let short = || "ends within a column".to_owned();
        let valid = self.buffer(first)?;
        let is_valid =
            |row: usize| valid.is_empty() || valid.get(row / 8).is_some_and(|bits| (bits >> (row % 8)) & 1 == 1);
        let bytes = self.buffer(first + 1)?;
        let size = kind.size();
        if let Values::Texts(texts) = values {
            let all = self.buffer(first + 2)?;
            let offset = |row: usize| {
                let bytes = bytes.chunks_exact(size).nth(row)?;
                let mut number = [0; 8];
                number.get_mut(..size)?.copy_from_slice(bytes);
                usize::try_from(u64::from_le_bytes(number)).ok()
            };
            for row in 0..self.rows {
                let (begin, end) = offset(row).zip(offset(row + 1)).ok_or_else(short)?;
                let text = all.get(begin..end).ok_or_else(short)?;
                texts.push(String::from_utf8_lossy(text).into_owned());
            }
            return Ok(());
        }
        let needed = self.rows.checked_mul(size).ok_or_else(short)?;
        let numbers = bytes.get(..needed).ok_or_else(short)?.chunks_exact(size).enumerate();
        match values {
            Values::Floats(floats) => floats.extend(numbers.map(|(row, bytes)| {
                let value = match *bytes {
                    [a, b] => half(u16::from_le_bytes([a, b])),
                    [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
                    [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
                    _ => f64::NAN,
                };
                if is_valid(row) { value } else { f64::NAN }
            })),
            Values::Integers(integers) => integers.extend(numbers.map(|(row, bytes)| {
                let is_negative = kind == Kind::Integer(size, true) && bytes.last().is_some_and(|last| last >> 7 == 1);
                let mut number = [if is_negative { 0xFF } else { 0 }; 8];
                number[..size].copy_from_slice(bytes);
                if is_valid(row) { i64::from_le_bytes(number) } else { 0 }
            })),
            Values::Texts(_) => {}
        }
        Ok(())
    }
}

/// A number of 16 bits (IEEE 754 binary16).
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    };
    if bits >> 15 == 1 { -size } else { size }
}

impl Columns {
    /// Column `number` of those asked for, as real numbers; empty if it holds texts.
    pub(crate) fn floats(&self, number: usize) -> Vec<f64> {
        match self.0.get(number) {
            Some(Values::Floats(values)) => values.clone(),
            Some(Values::Integers(values)) => values.iter().map(|v| *v as f64).collect(),
            _ => Vec::new(),
        }
    }

    /// Column `number` of those asked for, as whole numbers; empty if it holds texts.
    pub(crate) fn integers(&self, number: usize) -> Vec<i64> {
        match self.0.get(number) {
            Some(Values::Integers(values)) => values.clone(),
            Some(Values::Floats(values)) => values.iter().map(|v| *v as i64).collect(),
            _ => Vec::new(),
        }
    }

    /// Column `number` of those asked for, if it holds texts.
    pub(crate) fn texts(&self, number: usize) -> &[String] {
        match self.0.get(number) {
            Some(Values::Texts(texts)) => texts,
            _ => &[],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_16_bits_are_those_of_the_standard() {
        for (bits, value) in [
            (0x0000, 0.0),
            (0x3C00, 1.0),
            (0xC000, -2.0),
            (0x7BFF, 65504.0),
            (0x0001, 5.960_464_477_539_063e-8),
            (0x3555, 0.333_251_953_125),
            (0x7C00, f64::INFINITY),
            (0xFC00, f64::NEG_INFINITY),
        ] {
            assert_eq!(half(bits), value);
        }
        assert!(half(0x7E00).is_nan());
    }

    fn file(name: &str) -> Vec<u8> {
        std::fs::read(
            Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("testdata/datasets")
                .join(name),
        )
        .unwrap()
    }

    /// Written by pyarrow in two batches.
    #[test]
    fn tables_are_read_packed_or_not() {
        for packing in ["lz4", "zstd", "uncompressed"] {
            let bytes = file(&format!("table_{packing}.feather"));
            let table = parse(Path::new("a.feather"), &bytes, &["l", "x", "n", "u", "s", "y"]).unwrap();
            assert_eq!(table.texts(0), ["a", "bc", "d"]);
            assert_eq!(table.floats(1)[..2], [0.5, -2.0]);
            assert!(table.floats(1)[2].is_nan());
            assert_eq!(table.integers(2), [-3, 0, 1 << 40]);
            assert_eq!(table.floats(3), [250.0, 0.0, 255.0]);
            assert_eq!(table.texts(4), ["up", "", "größer"]);
            let y = table.floats(5);
            assert!(y[0] == 1.5 && y[1].is_nan() && y[2] == 3.0);
            let told = |name: &str| parse(Path::new("a.feather"), &bytes, &[name]).unwrap_err().to_string();
            assert_eq!(told("z"), "a.feather: has no column z");
            assert_eq!(told("b"), "a.feather: column b has a type that is not read");
        }
        let told = parse(Path::new("a.feather"), &file("nested.feather"), &["x"])
            .unwrap_err()
            .to_string();
        assert_eq!(told, "a.feather: has columns of columns before those that are read");
    }

    #[test]
    fn damaged_tables_are_bearable() {
        for packing in ["lz4", "zstd", "uncompressed"] {
            let whole = file(&format!("table_{packing}.feather"));
            for end in (0..whole.len()).step_by(7) {
                assert!(parse(Path::new("a.feather"), &whole[..end], &["x"]).is_err());
            }
            for at in 0..whole.len() {
                let mut bytes = whole.clone();
                bytes[at] ^= 0xFF;
                let _ = parse(Path::new("a.feather"), &bytes, &["x", "n", "s", "y"]);
            }
        }
    }

    #[test]
    fn what_is_no_table_is_refused() {
        for bytes in [
            &b""[..],
            b"ARROW1",
            b"ARROW1ARROW1",
            b"ARROW1\0\0\xFF\xFF\xFF\xFFARROW1",
        ] {
            let message = parse(Path::new("a.feather"), bytes, &["x"]).unwrap_err().to_string();
            assert_eq!(message, "a.feather: is no Feather file, or damaged");
        }
    }
}
