//! When each scan was taken: `times.txt` or `timestamps.txt`, or the scans' names.

use std::path::Path;

use tsdfuse::trajectory::ns_after;

use crate::error::Result;
use crate::files::{self, ScanFile};
use crate::poses::rows_of_scans;
use crate::present;
use crate::text::{self, Line};

/// Reads a file of times, one a line: seconds, an integer since 1970 in ms, µs or ns, or date and time of day (UTC). They become
/// nanoseconds.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn read(path: impl AsRef<Path>) -> Result<Vec<i64>> {
    let path = path.as_ref();
    parse(path, &files::read(path)?)
}

/// The time of each scan, nanoseconds; `None` where nothing tells it.
pub(crate) fn of_scans(root: &Path, scans: &[ScanFile]) -> Result<Option<Vec<i64>>> {
    for name in ["times.txt", "timestamps.txt"] {
        let path = root.join(name);
        if present::file(&path)? {
            let times_ns = parse(&path, &files::read(&path)?)?;
            return rows_of_scans(&path, "times", &times_ns, scans).map(Some);
        }
    }
    let in_name = |scan: &ScanFile| scan.secs().map(|secs| ns_after(0, secs));
    Ok(scans.iter().map(in_name).collect())
}

/// Parses one time a line: seconds, an integer since 1970 in ms, µs or ns, or date and time of day (UTC) as
/// `2011-09-26 13:02:25.964389445`. They become nanoseconds; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<i64>> {
    let time = |line: Line| {
        text::nanoseconds(line.text)
            .or_else(|| date_time(line.text))
            .ok_or_else(|| not_a_time(&line))
    };
    text::lines(path, bytes)?.map(time).collect()
}

fn not_a_time(line: &Line) -> crate::Error {
    line.error(format!(
        "{:?} is neither seconds nor a date with a time of day",
        line.text
    ))
}

/// Nanoseconds since 1970.
fn date_time(text: &str) -> Option<i64> {
    let (date, time) = text.split_once([' ', 'T'])?;
    let date: Vec<i32> = date.split('-').map(|s| s.parse().ok()).collect::<Option<_>>()?;
    let (&[year, month, day], (hours, minutes, secs_ns)) = (date.as_slice(), clock(time)?) else {
        return None;
    };
    if !((0..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day)) {
        return None;
    }
    // Days since 1970 (H. Hinnant, days_from_civil), years beginning in March.
    let year = if month <= 2 { year - 1 } else { year };
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let days = era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468;
    let whole_minutes = (i64::from(days) * 24 + i64::from(hours)) * 60 + i64::from(minutes);
    // Other years than 1678 to 2261 have no such number.
    whole_minutes.checked_mul(60_000_000_000)?.checked_add(secs_ns)
}

/// Hours, minutes, and nanoseconds of the minute.
fn clock(text: &str) -> Option<(u8, u8, i64)> {
    let mut parts = text.trim_end_matches('Z').split(':');
    let (hours, minutes): (u8, u8) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let secs_ns = text::nanoseconds(parts.next()?)?;
    let is_time = hours < 24 && minutes < 60 && (0..61_000_000_000).contains(&secs_ns) && parts.next().is_none();
    is_time.then_some((hours, minutes, secs_ns))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(text: &str) -> Result<Vec<i64>, String> {
        parse(Path::new("times.txt"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn all_notations_are_nanoseconds() {
        assert_eq!(times("0.0\n# a remark\n\n1.036224e-01\n"), Ok(vec![0, 103_622_400]));
        let since_1970 = times("1317042273250000000\n1317042273250000\n1317042273250").unwrap();
        assert_eq!(since_1970, [1_317_042_273_250_000_000; 3]);
        let ns = times("2011-09-26 13:04:33.250000001\n2000-02-29T00:00:00Z\n1970-01-01 00:00:01").unwrap();
        assert_eq!(ns, [1_317_042_273_250_000_001, 951_782_400_000_000_000, 1_000_000_000]);
    }

    #[test]
    fn what_is_no_time_is_named_with_its_line() {
        for bad in [
            "1.0\nx",
            "1.0\nnan",
            "1.0\n2011-13-26 13:04:33",
            "1.0\n2011-09-26 25:04:33",
            "1.0\n0003-04-01 08:01:00",
            "1.0\n2 3",
        ] {
            let message = times(bad).unwrap_err();
            assert!(message.starts_with("times.txt: line 2: "), "{message}");
        }
    }
}
