//! Hesai's calibration: a CSV of angles.

use crate::error::{PacketError, Result};

/// More lasers than any sensor has.
const MAX_LASERS: usize = 1024;

/// Angles of each laser.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Angles {
    /// Elevation above the horizontal plane and azimuth offset, degrees, of lasers 1, 2, 3, …
    pub deg: Vec<[f64; 2]>,
}

/// Reads lines of laser, elevation and azimuth; words before them are headings.
pub(crate) fn parse_csv(text: &str) -> Result<Angles> {
    let mut lasers: Vec<(usize, [f64; 2])> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let fields: Vec<Option<f64>> = line
            .split([',', ';', '\t'])
            .map(|field| field.trim().parse().ok())
            .collect();
        let &[Some(laser), Some(elevation), Some(azimuth), ..] = fields.as_slice() else {
            let is_heading = lasers.is_empty() || line.trim().is_empty();
            // What stands behind the table (a checksum, a version) has other shapes.
            if is_heading || !line.trim_start().starts_with(|c: char| c.is_ascii_digit()) || fields.len() < 3 {
                continue;
            }
            let reason = format!(
                "line {} of the calibration is not laser, elevation, azimuth",
                number + 1
            );
            return Err(PacketError::calibration(reason));
        };
        let is_possible = laser >= 1.0
            && laser <= MAX_LASERS as f64
            && laser.fract() == 0.0
            && elevation.abs() < 90.0
            && azimuth.abs() <= 180.0;
        if !is_possible {
            let reason = format!("line {} of the calibration holds numbers that no laser has", number + 1);
            return Err(PacketError::calibration(reason));
        }
        lasers.push((laser as usize, [elevation, azimuth]));
        if lasers.len() > MAX_LASERS {
            return Err(PacketError::calibration(format!(
                "the calibration has more than {MAX_LASERS} lasers"
            )));
        }
    }
    lasers.sort_by_key(|(laser, _)| *laser);
    if lasers.is_empty() || lasers.iter().enumerate().any(|(i, (laser, _))| i + 1 != *laser) {
        let reason =
            "is no calibration: neither Ouster's JSON, Hesai's CSV of lasers 1, 2, 3, …, nor Velodyne's YAML or XML";
        return Err(PacketError::calibration(reason));
    }
    Ok(Angles {
        deg: lasers.into_iter().map(|(_, angles)| angles).collect(),
    })
}
