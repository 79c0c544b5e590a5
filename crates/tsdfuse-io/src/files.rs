//! Folders of numbered files: lists them in natural order, reads them, and finds numbers and times in their names.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// The file of one scan.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScanFile {
    pub(crate) path: PathBuf,
    /// The file's name, for messages.
    pub(crate) name: String,
}

impl ScanFile {
    fn stem(&self) -> &str {
        self.name.rsplit_once('.').map_or(self.name.as_str(), |(stem, _)| stem)
    }

    /// The number, if the name is nothing else: 12 for `000012.bin`.
    pub(crate) fn number(&self) -> Option<usize> {
        let stem = self.stem();
        stem.bytes().all(|b| b.is_ascii_digit()).then(|| stem.parse().ok())?
    }

    /// The time in the name, seconds: see [`secs_in_name`].
    pub(crate) fn secs(&self) -> Option<f64> {
        secs_in_name(self.stem())
    }
}

/// The time at the end of a file's stem, in seconds: `12.345` and `1583836591.18`, `1583836591_182590976` (seconds and
/// nanoseconds), or an integer since 1970 in seconds, milli-, micro- or nanoseconds, told apart by its magnitude. A smaller
/// integer is a running number.
pub(crate) fn secs_in_name(stem: &str) -> Option<f64> {
    let tail = |s: &str| s.len() - s.bytes().rev().take_while(u8::is_ascii_digit).count();
    let (before, last) = stem.split_at(tail(stem));
    let (separator, first) = match before.strip_suffix(['.', '_']) {
        Some(rest) => (before.get(rest.len()..)?, rest.get(tail(rest)..)?),
        None => ("", ""),
    };
    let integer: f64 = first.parse().unwrap_or(f64::NAN);
    match separator {
        _ if last.is_empty() => None,
        "." if !first.is_empty() => format!("{first}.{last}").parse().ok(),
        "_" if (1e8..1e11).contains(&integer) && last.len() <= 9 => Some(integer + last.parse::<f64>().ok()? * 1e-9),
        _ => epoch_secs(last.parse().ok()?),
    }
}

/// Seconds since 1970 from a count of seconds, milli-, micro- or nanoseconds; `None` if it is too small for a time.
pub(crate) fn epoch_secs(count: f64) -> Option<f64> {
    match count {
        1e8..1e11 => Some(count),
        1e11..1e14 => Some(count / 1e3),
        1e14..1e17 => Some(count / 1e6),
        1e17..1e20 => Some(count / 1e9),
        _ => None,
    }
}

/// The files of a folder with an extension (lower case, without dot), except hidden ones. They are in order of the times in
/// their names if all have one, otherwise in natural order (`2` before `10`). Empty if there is no such folder.
pub(crate) fn list(folder: &Path, extension: &str) -> Result<Vec<ScanFile>> {
    let mut files: Vec<_> = names(folder)?
        .into_iter()
        .filter(|name| {
            Path::new(name)
                .extension()
                .is_some_and(|e| e.eq_ignore_ascii_case(extension))
        })
        .map(|name| ScanFile {
            path: folder.join(&name),
            name,
        })
        .filter(|file| file.path.is_file())
        .collect();
    files.sort_by(|a, b| natural_order(&a.name, &b.name));
    if files.iter().all(|f| f.secs().is_some()) {
        files.sort_by(|a, b| a.secs().partial_cmp(&b.secs()).unwrap_or(Ordering::Equal));
    }
    Ok(files)
}

/// The names in a folder, sorted, except those that are hidden or not text. Empty if there is no such folder.
pub(crate) fn names(folder: &Path) -> Result<Vec<String>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let entries: std::io::Result<Vec<_>> = std::fs::read_dir(folder).map_err(Error::io(folder))?.collect();
    let names = entries.map_err(Error::io(folder))?.into_iter();
    let mut names: Vec<_> = names.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.retain(|name| !name.starts_with('.'));
    names.sort();
    Ok(names)
}

/// The name of a file or folder without the path to it.
pub(crate) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Reads a whole file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(Error::io(path))
}

/// Compares names, runs of digits by their value.
pub(crate) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a.as_bytes(), b.as_bytes());
    loop {
        let order = match (digits(x), digits(y)) {
            ((0, _), _) | (_, (0, _)) => match (x.split_first(), y.split_first()) {
                (Some((p, rest_x)), Some((q, rest_y))) => {
                    (x, y) = (rest_x, rest_y);
                    p.cmp(q)
                }
                _ => return x.len().cmp(&y.len()).then_with(|| a.cmp(b)),
            },
            ((n, number_x), (m, number_y)) => {
                (x, y) = (&x[n..], &y[m..]);
                number_x.len().cmp(&number_y.len()).then_with(|| number_x.cmp(number_y))
            }
        };
        if order != Ordering::Equal {
            return order;
        }
    }
}

/// How many digits `text` starts with, and these without leading zeros.
fn digits(text: &[u8]) -> (usize, &[u8]) {
    let n = text.iter().take_while(|b| b.is_ascii_digit()).count();
    let zeros = text.iter().take_while(|&&b| b == b'0').count();
    (n, &text[zeros..n])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_sort_by_their_numbers() {
        let mut names = vec!["s10.bin", "s9.bin", "s09.bin", "a", "s2_10.bin", "s2_9.bin", "s"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(
            names,
            ["a", "s", "s2_9.bin", "s2_10.bin", "s09.bin", "s9.bin", "s10.bin"]
        );
    }

    #[test]
    fn times_in_names() {
        for (stem, secs) in [
            ("000012", None),
            ("scan", None),
            ("scan.000012", None),
            ("12.5", Some(12.5)),
            ("0.100000", Some(0.1)),
            ("cloud_1583836591_182590976", Some(1_583_836_591.182_591)),
            ("1583836591.25", Some(1583836591.25)),
            ("1583836591", Some(1583836591.0)),
            ("1583836591250", Some(1583836591.25)),
            ("scan-1583836591250000", Some(1583836591.25)),
            ("1583836591250000000", Some(1583836591.25)),
            ("99999999999999999999999999", None),
        ] {
            let found = secs_in_name(stem);
            let near = found.zip(secs).is_some_and(|(a, b)| (a - b).abs() < 1e-6);
            assert!(near || (found, secs) == (None, None), "{stem}: {found:?}");
        }
    }

    #[test]
    fn files_named_by_decimal_seconds_sort_by_time() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["1.5.pcd", "1.25.pcd", "10.0.PCD", "._1.5.pcd", "1.7.txt"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        let names: Vec<_> = list(dir.path(), "pcd").unwrap().into_iter().map(|f| f.name).collect();
        assert_eq!(names, ["1.25.pcd", "1.5.pcd", "10.0.PCD"]);
    }

    proptest! {
        #[test]
        fn natural_order_is_an_order(a in "[a0-2]{0,6}", b in "[a0-2]{0,6}", c in "[a0-2]{0,6}") {
            prop_assert_eq!(natural_order(&a, &b), natural_order(&b, &a).reverse());
            prop_assert_eq!(natural_order(&a, &b) == Ordering::Equal, a == b);
            if natural_order(&a, &b).is_le() && natural_order(&b, &c).is_le() {
                prop_assert!(natural_order(&a, &c).is_le());
            }
        }

        #[test]
        fn any_name_is_bearable(stem in "\\PC{0,40}") {
            let _ = secs_in_name(&stem);
        }
    }
}
