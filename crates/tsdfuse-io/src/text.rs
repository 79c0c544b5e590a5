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

/// Nanoseconds from a time in text: seconds, or an integer count since 1970 of seconds, milli-, micro- or nanoseconds, told apart
/// by its size. Digits are not lost to rounding. `None` for what is no number or too large.
pub(crate) fn nanoseconds(text: &str) -> Option<i64> {
    let value: f64 = text.parse().ok()?;
    let digits_below = match value {
        1e11..1e14 => 6,
        1e14..1e17 => 3,
        1e17..1e20 => 0,
        _ => 9,
    };
    if let Some(ns) = scaled(text, digits_below) {
        return i64::try_from(ns).ok();
    }
    // With an exponent.
    let ns = (value * 10f64.powi(digits_below as i32)).round();
    (ns.abs() < i64::MAX as f64).then_some(ns as i64)
}

/// A plain decimal number times ten to this power, rounded; `None` for other text and for what is much too large.
fn scaled(text: &str, power: usize) -> Option<i128> {
    let (negative, text) = match text.strip_prefix(['-', '+']) {
        Some(rest) => (text.starts_with('-'), rest),
        None => (false, text),
    };
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let is_plain = |digits: &str| digits.bytes().all(|b| b.is_ascii_digit());
    if !is_plain(whole) || !is_plain(fraction) || whole.len() > 25 {
        return None;
    }
    let kept: String = format!("{fraction:0<power$}").chars().take(power).collect();
    let scaled: i128 = format!("0{whole}{kept}").parse().ok()?;
    let rounded = scaled + i128::from(fraction.as_bytes().get(power).is_some_and(|digit| *digit >= b'5'));
    Some(if negative { -rounded } else { rounded })
}

impl Line<'_> {
    /// An error about this line.
    pub(crate) fn error(&self, reason: impl std::fmt::Display) -> Error {
        Error::format(self.path, format!("line {}: {reason}", self.number))
    }

    /// What stands between blanks or commas.
    pub(crate) fn words(&self) -> impl Iterator<Item = &str> {
        self.text.split([' ', '\t', ',']).filter(|word| !word.is_empty())
    }

    /// Its numbers, separated by blanks or commas.
    pub(crate) fn numbers(&self) -> Result<Vec<f64>> {
        self.words()
            .map(|word| {
                word.parse()
                    .map_err(|_| self.error(format!("{word:?} is not a number")))
            })
            .collect()
    }
}

/// Nanoseconds as seconds, with as many decimals as they have.
pub(crate) fn seconds(ns: i64) -> String {
    let (sign, ns) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    let text = format!("{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_keep_their_nanoseconds() {
        for (text, ns) in [
            ("0", Some(0)),
            ("-1.5", Some(-1_500_000_000)),
            ("12.000000001", Some(12_000_000_001)),
            ("+0.1234567895", Some(123_456_790)),
            (".5", Some(500_000_000)),
            ("5.", Some(5_000_000_000)),
            ("1e-3", Some(1_000_000)),
            ("1.5838365911825909e9", Some(1_583_836_591_182_590_961)),
            ("1583836591.182590976", Some(1_583_836_591_182_590_976)),
            ("1583836591182590976", Some(1_583_836_591_182_590_976)),
            ("1583836591182590", Some(1_583_836_591_182_590_000)),
            ("1583836591182.5", Some(1_583_836_591_182_500_000)),
            ("99999999999999999999", None),
            ("1e300", None),
            ("nan", None),
            ("inf", None),
            ("", None),
            ("x", None),
            ("1.2.3", None),
        ] {
            let near = nanoseconds(text)
                .zip(ns)
                .is_some_and(|(a, b)| a == b || (text.contains('e') && (a - b).abs() < 256));
            assert!(
                near || (nanoseconds(text), ns) == (None, None),
                "{text}: {:?}",
                nanoseconds(text)
            );
        }
    }

    proptest! {
        /// As the number itself says, as far as it can.
        #[test]
        fn times_are_their_numbers(secs in -1e8..1e8f64, places in 0..12usize) {
            let text = format!("{secs:.places$}");
            let want = text.parse::<f64>().unwrap() * 1e9;
            prop_assert!((nanoseconds(&text).unwrap() as f64 - want).abs() <= 0.5 + want.abs() * 1e-15);
        }

        #[test]
        fn any_text_is_bearable(text in "\\PC{0,40}") {
            let _ = nanoseconds(&text);
        }
    }
}
