//! The header of a PLY file.

use std::path::Path;

use crate::error::{Error, Result};
use crate::scalar::Scalar;

/// What the header of a PLY file says.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Length of the header.
    pub(super) bytes: usize,
}

/// How the numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A kind of rows: vertices, faces, …
#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: String,
    /// The number of rows that the header claims.
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

/// A number of each row, or a list of numbers.
#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) scalar: Scalar,
    /// For a list: the type of its length.
    pub(super) list: Option<Scalar>,
}

impl Header {
    pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let mut header = Self {
            encoding: Encoding::Ascii,
            elements: Vec::new(),
            bytes: 0,
        };
        let mut has_format = false;
        for number in 1.. {
            let rest = bytes.get(header.bytes..).unwrap_or_default();
            let wrong = |what: &str| Error::format(path, format!("header line {number}: {what}"));
            let Some(end) = rest.iter().position(|&b| b == b'\n') else {
                return Err(Error::format(path, "is no PLY file: its header does not end"));
            };
            let line = std::str::from_utf8(&rest[..end]).map_err(|_| wrong("is not text"))?;
            header.bytes += end + 1;
            let words: Vec<_> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["ply"] if number == 1 => {}
                _ if number == 1 => return Err(Error::format(path, "is no PLY file: it does not begin with ply")),
                [] | ["comment" | "obj_info", ..] => {}
                ["format", encoding, _version] => {
                    has_format = true;
                    header.encoding = match *encoding {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        _ => return Err(wrong(&format!("there is no format {encoding}"))),
                    };
                }
                ["element", name, count] => header.elements.push(Element {
                    name: (*name).to_owned(),
                    count: count.parse().map_err(|_| wrong(&format!("{count:?} is not a count")))?,
                    properties: Vec::new(),
                }),
                ["property", words @ ..] => {
                    let property = property(words).ok_or_else(|| wrong(&format!("{line:?} is no property")))?;
                    let element = header
                        .elements
                        .last_mut()
                        .ok_or_else(|| wrong("a property of no element"))?;
                    element.properties.push(property);
                }
                ["end_header"] if has_format => break,
                ["end_header"] => return Err(wrong("the header does not tell the format")),
                _ => return Err(wrong(&format!("{line:?} is not understood"))),
            }
        }
        Ok(header)
    }
}

fn property(words: &[&str]) -> Option<Property> {
    let (list, scalar, name) = match *words {
        ["list", count, scalar, name] => (Some(self::scalar(count).filter(|s| s.is_integer())?), scalar, name),
        [scalar, name] => (None, scalar, name),
        _ => return None,
    };
    Some(Property {
        name: name.to_owned(),
        scalar: self::scalar(scalar)?,
        list,
    })
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "int64" => Scalar::I64,
        "uint64" => Scalar::U64,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}
