//! When each scan was taken: `times.txt` or `timestamps.txt`, or the scans' names.

use std::path::Path;

use crate::error::Result;
use crate::files::{self, ScanFile};
use crate::poses::rows_of_scans;
use crate::text::{self, Line};

/// The time of each scan, seconds; `None` where nothing tells it.
pub(crate) fn of_scans(root: &Path, scans: &[ScanFile]) -> Result<Option<Vec<f64>>> {
    for name in ["times.txt", "timestamps.txt"] {
        let path = root.join(name);
        if path.is_file() {
            let secs = parse(&path, &files::read(&path)?)?;
            return rows_of_scans(&path, "times", &secs, scans).map(Some);
        }
    }
    Ok(scans.iter().map(ScanFile::secs).collect())
}

/// Parses one time a line: seconds, an integer since 1970 in ms, µs or ns, or date and time of day (UTC) as
/// `2011-09-26 13:02:25.964389445`. `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<f64>> {
    text::lines(path, bytes)?
        .map(|line| match line.text.parse::<f64>() {
            Ok(secs) if secs.is_finite() => Ok(files::epoch_secs(secs).unwrap_or(secs)),
            _ => date_time(line.text).ok_or_else(|| not_a_time(&line)),
        })
        .collect()
}

fn not_a_time(line: &Line) -> crate::Error {
    line.error(format!(
        "{:?} is neither seconds nor a date with a time of day",
        line.text
    ))
}

/// Seconds since 1970.
fn date_time(text: &str) -> Option<f64> {
    let (date, time) = text.split_once([' ', 'T'])?;
    let date: Vec<i32> = date.split('-').map(|s| s.parse().ok()).collect::<Option<_>>()?;
    let (&[year, month, day], [hours, minutes, secs]) = (date.as_slice(), clock(time)?) else {
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
    Some(f64::from(days) * 86_400.0 + hours * 3600.0 + minutes * 60.0 + secs)
}

fn clock(text: &str) -> Option<[f64; 3]> {
    let parts: Vec<f64> = text
        .trim_end_matches('Z')
        .split(':')
        .map(|s| s.parse().ok())
        .collect::<Option<_>>()?;
    let [h, m, s] = parts.try_into().ok()?;
    ((0.0..24.0).contains(&h) && (0.0..60.0).contains(&m) && (0.0..61.0).contains(&s)).then_some([h, m, s])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(text: &str) -> Result<Vec<f64>, String> {
        parse(Path::new("times.txt"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn all_notations_are_seconds() {
        assert_eq!(times("0.0\n# a remark\n\n1.036224e-01\n"), Ok(vec![0.0, 0.103_622_4]));
        let since_1970 = times("1317042273250000000\n1317042273250000\n1317042273250").unwrap();
        assert!(since_1970.iter().all(|secs| (secs - 1_317_042_273.25).abs() < 1e-6));
        let secs = times("2011-09-26 13:04:33.25\n2000-02-29T00:00:00Z\n1970-01-01 00:00:01").unwrap();
        assert_eq!(secs, [1_317_042_273.25, 951_782_400.0, 1.0]);
    }

    #[test]
    fn what_is_no_time_is_named_with_its_line() {
        for bad in [
            "1.0\nx",
            "1.0\nnan",
            "1.0\n2011-13-26 13:04:33",
            "1.0\n2011-09-26 25:04:33",
            "1.0\n2 3",
        ] {
            let message = times(bad).unwrap_err();
            assert!(message.starts_with("times.txt: line 2: "), "{message}");
        }
    }
}
