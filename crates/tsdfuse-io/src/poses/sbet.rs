//! Smoothed best estimates of trajectories (SBET), as Applanix's POSPac and other programs for inertial navigation write them.
//!
//! Records of 17 numbers (f64, little-endian): time (s), latitude, longitude (rad), height (m), three velocities, roll, pitch, platform
//! heading, wander angle (rad), three accelerations, three rates. The platform's heading counts from an axis that wanders: the true
//! heading is the difference of the two.

use std::path::Path;

use tsdfuse::Trajectory;

use super::Poses;
use crate::error::{Error, Result};
use crate::geodesy::{Geographic, attitude};

const RECORD: usize = 17 * 8;

/// Whether a file is made of such records: no text has a zero in it, and numbers with so many digits do not lack one for long.
pub(super) fn recognises(bytes: &[u8]) -> bool {
    !bytes.is_empty() && bytes.len().is_multiple_of(RECORD) && is_binary(bytes.get(..64 * RECORD).unwrap_or(bytes))
}

fn is_binary(bytes: &[u8]) -> bool {
    bytes.contains(&0) || std::str::from_utf8(bytes).is_err_and(|e| e.error_len().is_some())
}

/// Reads the records. The world is x east, y north, z up from the first one on.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Poses> {
    let mut timed: Vec<(i64, tsdfuse::Pose)> = Vec::with_capacity(bytes.len() / RECORD);
    let mut origin = None;
    for (number, record) in bytes.chunks_exact(RECORD).enumerate() {
        let wrong = |what: &str| Error::format(path, format!("record {number} of a binary trajectory (SBET): {what}"));
        let mut values = [0.0; 11];
        for (value, bytes) in values.iter_mut().zip(record.as_chunks::<8>().0) {
            *value = f64::from_le_bytes(*bytes);
        }
        let [
            secs,
            latitude,
            longitude,
            height_m,
            _,
            _,
            _,
            roll,
            pitch,
            heading,
            wander,
        ] = values;
        if !(values.iter().all(|value| value.is_finite()) && secs.abs() < 9e9) {
            return Err(wrong("has a number that cannot be"));
        }
        let time_ns = (secs * 1e9).round() as i64;
        if timed.last().is_some_and(|&(last, _)| last >= time_ns) {
            return Err(wrong("its time is not later than that of the record before"));
        }
        let here = Geographic {
            latitude_deg: latitude.to_degrees(),
            longitude_deg: longitude.to_degrees(),
            height_m,
        };
        let rotation = attitude([roll, pitch, heading - wander]);
        timed.push((time_ns, here.body(rotation, &mut origin).map_err(wrong)?));
    }
    let trajectory = Trajectory::new(timed).map_err(|e| Error::format(path, e.to_string()))?;
    Ok(Poses::Timed(trajectory))
}

#[cfg(test)]
mod tests {
    use tsdfuse::glam::DVec3;

    use super::*;

    fn record(secs: f64, latitude_deg: f64, heading_deg: f64, wander_deg: f64) -> Vec<u8> {
        let [latitude, heading, wander] = [latitude_deg, heading_deg, wander_deg].map(f64::to_radians);
        let values = [secs, latitude, 0.14, 110.0, 1.0, 0.0, 0.0, 0.0, 0.0, heading, wander];
        values.into_iter().chain([0.0; 6]).flat_map(f64::to_le_bytes).collect()
    }

    fn read(bytes: &[u8]) -> Result<Trajectory, String> {
        match super::super::parse(Path::new("a.out"), bytes).map_err(|e| e.to_string())? {
            Poses::Timed(trajectory) => Ok(trajectory),
            Poses::Listed(_) => Err("no times".to_owned()),
        }
    }

    #[test]
    fn headings_do_not_wander() {
        // A metre is 9e-6° along a meridian.
        let bytes = [
            record(10.5, 49.0, 90.0, 0.0),
            record(10.505, 49.000_008_991_4, -20.0, -20.0),
        ]
        .concat();
        let poses = read(&bytes).unwrap();
        assert_eq!(poses.times_ns(), [10_500_000_000, 10_505_000_000]);
        let [east, north] = [0, 1].map(|i| poses.poses()[i].rotation * DVec3::X);
        assert!(
            east.distance(DVec3::X) < 1e-9 && north.distance(DVec3::Y) < 1e-6,
            "{east} {north}"
        );
        assert!(poses.poses()[1].translation.distance(DVec3::Y) < 1e-4);
    }

    #[test]
    fn damaged_records_are_named() {
        let good = record(1.0, 49.0, 0.0, 0.0);
        for (second, why) in [
            (
                good.clone(),
                "record 1 of a binary trajectory (SBET): its time is not later",
            ),
            (
                record(2.0, 99.0, 0.0, 0.0),
                "record 1 of a binary trajectory (SBET): no place on the earth",
            ),
            (
                record(f64::NAN, 49.0, 0.0, 0.0),
                "record 1 of a binary trajectory (SBET): has a number that cannot be",
            ),
        ] {
            let told = read(&[good.clone(), second].concat()).unwrap_err();
            assert!(told.starts_with("a.out: ") && told.contains(why), "{told}");
        }
        // Cut off: then it is no longer of records.
        assert!(read(&good[..130]).unwrap_err().starts_with("a.out: "));
    }
}
