//! Tables of numbers as text, one row a line; and TOML.

use std::path::Path;

use crate::error::{Error, Result};

/// A line that holds something, with its number (the first is 1).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line<'a> {
    pub(crate) path: &'a Path,
    pub(crate) number: usize,
    pub(crate) text: &'a str,
}

/// The lines of a text file that hold something: blank ones and those that start with `#` are left out.
pub(crate) fn lines<'a>(path: &'a Path, bytes: &'a [u8]) -> Result<impl Iterator<Item = Line<'a>>> {
    let text = std::str::from_utf8(bytes)
        .map_err(|e| Error::format(path, format!("is not text: byte {} is not UTF-8", e.valid_up_to())))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = text.lines().enumerate().map(move |(i, text)| Line {
        path,
        number: i + 1,
        text: text.trim(),
    });
    Ok(lines.filter(|line| !line.text.is_empty() && !line.text.starts_with('#')))
}

/// Parses a TOML file; an error names the line.
pub(crate) fn toml<T: serde::de::DeserializeOwned>(path: &Path, bytes: &[u8]) -> Result<T> {
    let text = std::str::from_utf8(bytes).map_err(|e| Error::format(path, format!("is not text: {e}")))?;
    toml::from_str(text).map_err(|e| {
        let line = text
            .get(..e.span().map_or(0, |s| s.start))
            .map_or(1, |before| before.matches('\n').count() + 1);
        Error::format(path, format!("line {line}: {}", e.message().replace('\n', " ")))
    })
}

impl Line<'_> {
    /// An error about this line.
    pub(crate) fn error(&self, reason: impl std::fmt::Display) -> Error {
        Error::format(self.path, format!("line {}: {reason}", self.number))
    }

    /// Its numbers, separated by blanks or commas.
    pub(crate) fn numbers(&self) -> Result<Vec<f64>> {
        let words = self.text.split([' ', '\t', ',']).filter(|word| !word.is_empty());
        words
            .map(|word| {
                word.parse()
                    .map_err(|_| self.error(format!("{word:?} is not a number")))
            })
            .collect()
    }
}
