//! The numbers of a PLY file, one after another.

use std::path::Path;
use std::str::SplitAsciiWhitespace;

use crate::error::{Error, Result};
use crate::scalar::Scalar;

use super::header::{Element, Encoding, Header, Property};

/// Reads the elements of a PLY file in their order.
pub(super) struct Body<'a> {
    path: &'a Path,
    numbers: Numbers<'a>,
}

enum Numbers<'a> {
    Ascii(SplitAsciiWhitespace<'a>),
    Binary { rest: &'a [u8], big_endian: bool },
}

impl<'a> Body<'a> {
    /// What follows the header.
    pub(super) fn new(path: &'a Path, bytes: &'a [u8], header: &Header) -> Result<Self> {
        let rest = bytes.get(header.bytes..).unwrap_or_default();
        let numbers = match header.encoding {
            Encoding::Ascii => {
                let text = std::str::from_utf8(rest).map_err(|_| Error::format(path, "its numbers are not text"))?;
                Numbers::Ascii(text.split_ascii_whitespace())
            }
            encoding => Numbers::Binary {
                rest,
                big_endian: encoding == Encoding::BigEndian,
            },
        };
        Ok(Self { path, numbers })
    }

    /// Reads all rows of an element. `list` is called for each list of a row, with its property's place and its numbers; then
    /// `row` with the row's values, one for each property (0 for lists).
    pub(super) fn element(
        &mut self,
        element: &Element,
        mut row: impl FnMut(&[f64]) -> Result<(), String>,
        mut list: impl FnMut(usize, &[f64]) -> Result<(), String>,
    ) -> Result<()> {
        if element.properties.is_empty() {
            return Ok(()); // such rows take no bytes, however many the header claims
        }
        let mut values = vec![0.0; element.properties.len()];
        let mut items = Vec::new();
        for i in 0..element.count {
            let mut read_row = || {
                for (p, property) in element.properties.iter().enumerate() {
                    match self.number_or_list(property, &mut items)? {
                        Some(number) => values[p] = number,
                        None => list(p, &items)?,
                    }
                }
                row(&values)
            };
            read_row().map_err(|what| {
                Error::format(self.path, format!("{} {i} of {}: {what}", element.name, element.count))
            })?;
        }
        Ok(())
    }

    /// A number, or `None` and the list's numbers in `items`.
    fn number_or_list(&mut self, property: &Property, items: &mut Vec<f64>) -> Result<Option<f64>, String> {
        let Some(length) = property.list else {
            return self.numbers.next(property.scalar).map(Some);
        };
        let length = self.numbers.next(length)?;
        if !(0.0..=f64::from(u32::MAX)).contains(&length) {
            return Err(format!("a list of {length} numbers"));
        }
        items.clear();
        for _ in 0..length as u64 {
            items.push(self.numbers.next(property.scalar)?);
        }
        Ok(None)
    }
}

impl Numbers<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<f64, String> {
        let truncated = || "the file ends before it".to_owned();
        match self {
            Self::Ascii(words) => {
                let word = words.next().ok_or_else(truncated)?;
                word.parse().map_err(|_| format!("{word:?} is not a number"))
            }
            Self::Binary { rest, big_endian } => {
                let (number, after) = rest.split_at_checked(scalar.size()).ok_or_else(truncated)?;
                *rest = after;
                if !*big_endian {
                    return scalar.read(number).ok_or_else(truncated);
                }
                let mut reversed = [0; 8];
                number
                    .iter()
                    .rev()
                    .zip(&mut reversed)
                    .for_each(|(from, to)| *to = *from);
                scalar.read(&reversed).ok_or_else(truncated)
            }
        }
    }
}
