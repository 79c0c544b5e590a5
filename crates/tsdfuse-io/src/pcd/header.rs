//! The header of a PCD file.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};

use crate::error::{Error, Result};
use crate::scalar::Scalar;

/// What a PCD file says of its points.
#[derive(Debug)]
pub(crate) struct Header {
    pub(super) fields: Vec<Field>,
    pub(super) points: usize,
    pub(super) encoding: Encoding,
    /// `world_from_sensor`, where the file says more than the identity.
    pub(crate) viewpoint: Option<Pose>,
    /// Bytes of one point.
    pub(super) stride: usize,
    /// Numbers of one point.
    pub(super) words: usize,
    /// Length of the header.
    pub(super) bytes: usize,
}

/// A field of each point.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) scalar: Scalar,
    /// Where in the point's bytes it begins.
    pub(super) offset: usize,
    /// Which of the point's numbers is its first.
    pub(super) first_word: usize,
    /// Bytes of all its numbers.
    pub(super) size: usize,
}

/// How the points are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary,
    Compressed,
}

impl Header {
    /// Parses the header that `bytes` begin with; the points need not be there.
    pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let mut entries = Entries::default();
        let mut rest = bytes;
        loop {
            let Some(end) = rest.iter().position(|&b| b == b'\n') else {
                return Err(Error::format(path, "is no PCD file: its header has no DATA line"));
            };
            let line = std::str::from_utf8(&rest[..end])
                .map_err(|_| Error::format(path, "is no PCD file: its header is not text"))?;
            rest = &rest[end + 1..];
            let mut words = line.split_ascii_whitespace();
            if let Some(key) = words.next() {
                entries.set(key, words.map(str::to_owned).collect());
            }
            if !entries.data.is_empty() {
                return entries
                    .header(bytes.len() - rest.len())
                    .map_err(|reason| Error::format(path, reason));
            }
        }
    }
}

/// The words after each key.
#[derive(Default)]
struct Entries {
    fields: Vec<String>,
    size: Vec<String>,
    kind: Vec<String>,
    count: Vec<String>,
    width: Vec<String>,
    height: Vec<String>,
    viewpoint: Vec<String>,
    points: Vec<String>,
    data: Vec<String>,
}

impl Entries {
    fn set(&mut self, key: &str, words: Vec<String>) {
        match key {
            "FIELDS" | "COLUMNS" => self.fields = words,
            "SIZE" => self.size = words,
            "TYPE" => self.kind = words,
            "COUNT" => self.count = words,
            "WIDTH" => self.width = words,
            "HEIGHT" => self.height = words,
            "VIEWPOINT" => self.viewpoint = words,
            "POINTS" => self.points = words,
            "DATA" => self.data = words,
            _ => {} // comments and VERSION
        }
    }

    fn header(self, bytes: usize) -> Result<Header, String> {
        let encoding = match self.data.first().map(String::as_str) {
            Some("ascii") => Encoding::Ascii,
            Some("binary") => Encoding::Binary,
            Some("binary_compressed") => Encoding::Compressed,
            _ => return Err(format!("DATA {} is not known", self.data.join(" "))),
        };
        let (fields, stride, words) = self.layout()?;
        Ok(Header {
            points: self.number_of_points()?,
            viewpoint: self.pose()?,
            fields,
            encoding,
            stride,
            words,
            bytes,
        })
    }

    /// The fields, and how many bytes and numbers a point has.
    fn layout(&self) -> Result<(Vec<Field>, usize, usize), String> {
        let n = self.fields.len();
        for (key, words) in [("SIZE", &self.size), ("TYPE", &self.kind), ("COUNT", &self.count)] {
            if words.len() != n && !(key == "COUNT" && words.is_empty()) {
                return Err(format!("{n} FIELDS but {} entries in {key}", words.len()));
            }
        }
        let mut fields = Vec::new();
        let (mut offset, mut first_word) = (0_usize, 0_usize);
        for (i, name) in self.fields.iter().enumerate() {
            let scalar = scalar(&self.kind[i], &self.size[i]).ok_or_else(|| {
                format!(
                    "field {name}: there is no TYPE {} of SIZE {}",
                    self.kind[i], self.size[i]
                )
            })?;
            let count = self.count.get(i).map_or(Some(1), |c| c.parse().ok().filter(|&c| c > 0));
            let size = count.and_then(|c: usize| c.checked_mul(scalar.size()));
            let ends = size
                .and_then(|s| offset.checked_add(s))
                .zip(count.and_then(|c| first_word.checked_add(c)));
            let (Some(size), Some(ends)) = (size, ends) else {
                return Err(format!("field {name}: its COUNT is not possible"));
            };
            fields.push(Field {
                name: name.clone(),
                scalar,
                offset,
                first_word,
                size,
            });
            (offset, first_word) = ends;
        }
        Ok((fields, offset, first_word))
    }

    fn number_of_points(&self) -> Result<usize, String> {
        let number = |key: &str, words: &[String]| match words {
            [] => Ok(None),
            [n] if n.parse::<usize>().is_ok() => Ok(n.parse().ok()),
            words => Err(format!("{key} {} is not a number", words.join(" "))),
        };
        let (width, height) = (number("WIDTH", &self.width)?, number("HEIGHT", &self.height)?);
        let points = number("POINTS", &self.points)?;
        match (width.zip(height).map(|(w, h): (usize, usize)| w.checked_mul(h)), points) {
            (Some(image), Some(points)) if image != Some(points) => {
                Err(format!("{points} POINTS are not WIDTH x HEIGHT"))
            }
            (_, Some(points)) | (Some(Some(points)), None) => Ok(points),
            _ => Err("does not say how many POINTS it has".to_owned()),
        }
    }

    /// Where the sensor was, if that is more than the identity.
    fn pose(&self) -> Result<Option<Pose>, String> {
        let numbers: Option<Vec<f64>> = self.viewpoint.iter().map(|w| w.parse().ok()).collect();
        let &[x, y, z, qw, qx, qy, qz] = numbers.as_deref().unwrap_or(&[f64::NAN]) else {
            return if self.viewpoint.is_empty() {
                Ok(None)
            } else {
                Err("VIEWPOINT has 7 numbers".to_owned())
            };
        };
        if [qw, qx, qy, qz] == [0.0; 4] {
            return Ok(None); // not filled in
        }
        let pose =
            Pose::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z)).map_err(|e| format!("VIEWPOINT: {e}"))?;
        Ok((pose != Pose::IDENTITY).then_some(pose))
    }
}

fn scalar(kind: &str, size: &str) -> Option<Scalar> {
    Some(match (kind, size) {
        ("I", "1") => Scalar::I8,
        ("I", "2") => Scalar::I16,
        ("I", "4") => Scalar::I32,
        ("I", "8") => Scalar::I64,
        ("U", "1") => Scalar::U8,
        ("U", "2") => Scalar::U16,
        ("U", "4") => Scalar::U32,
        ("U", "8") => Scalar::U64,
        ("F", "4") => Scalar::F32,
        ("F", "8") => Scalar::F64,
        _ => return None,
    })
}
