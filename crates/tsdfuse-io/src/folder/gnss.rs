//! `gnss.csv`: where a GNSS receiver was.

use std::path::Path;

use super::samples::{self, Row};
use crate::error::Result;
use crate::source::GnssFix;

pub(super) const NAME: &str = "gnss.csv";

/// The first line: seconds on the scans' clock; degrees and metres above the ellipsoid; standard deviations, metres.
const COLUMNS: [&str; 7] = [
    "t",
    "latitude",
    "longitude",
    "altitude",
    "sigma_east",
    "sigma_north",
    "sigma_up",
];

/// Parses the content of the file; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<GnssFix>> {
    samples::parse(path, bytes, &COLUMNS, "fix", fix)
}

fn fix(row: &Row<'_, 7>) -> Result<GnssFix> {
    let [_, latitude_deg, longitude_deg, altitude_m, east, north, up] = row.numbers;
    if latitude_deg.abs() > 90.0 || longitude_deg.abs() > 360.0 {
        return Err(row.line.error("there is no such latitude or longitude"));
    }
    if [east, north, up].iter().any(|sigma| *sigma <= 0.0) {
        return Err(row.line.error("a standard deviation is not positive"));
    }
    Ok(GnssFix {
        time_ns: row.time_ns,
        latitude_deg,
        longitude_deg,
        altitude_m: Some(altitude_m),
        sigma_m: Some([east, north, up]),
        ..GnssFix::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fixes(lines: &str) -> Result<Vec<GnssFix>, String> {
        let text = COLUMNS.join(",") + "\n" + lines;
        parse(Path::new("gnss.csv"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn a_fix_is_where_the_antenna_was_and_how_sure_that_is() {
        let read = fixes("0.5,48.5,11,300,0.01,0.02,0.03\n1.5,48.500001,11,301,2,2,4\n").unwrap();
        let first = GnssFix {
            time_ns: 500_000_000,
            latitude_deg: 48.5,
            longitude_deg: 11.0,
            altitude_m: Some(300.0),
            sigma_m: Some([0.01, 0.02, 0.03]),
            antenna_m: [0.0; 3],
        };
        assert_eq!((read.len(), read[0]), (2, first));
        // A millionth of a degree of latitude is 11 cm.
        let seen = read[1].seen_from(&first);
        assert!((seen.y - 0.1112).abs() < 1e-3 && seen.x.abs() < 1e-6 && (seen.z - 1.0).abs() < 1e-6);
        assert_eq!(fixes(""), Ok(Vec::new()));
    }

    #[test]
    fn every_error_names_the_line() {
        for (bad, message) in [
            ("1,2,3", "3 numbers where a fix has 7"),
            ("1,nan,0,0,1,1,1", "latitude is not finite"),
            ("1,91,0,0,1,1,1", "there is no such latitude or longitude"),
            ("1,0,0,0,1,0,1", "a standard deviation is not positive"),
            ("0,0,0,0,1,1,1", "the time is not later than that of the fix before"),
        ] {
            let told = fixes(&format!("0,0,0,0,1,1,1\n{bad}\n"));
            assert_eq!(told, Err(format!("gnss.csv: line 3: {message}")));
        }
        let headless = parse(Path::new("gnss.csv"), b"0,0,0,0,1,1,1\n")
            .unwrap_err()
            .to_string();
        assert!(
            headless.starts_with("gnss.csv: line 1: the header is not t,latitude"),
            "{headless}"
        );
    }
}
