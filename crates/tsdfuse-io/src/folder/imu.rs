//! `imu.csv`: what an inertial measurement unit measured.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::glam::DVec3;

use super::samples::{self, Row};
use crate::error::Result;
use crate::files;
use crate::source::ImuSample;

pub(super) const NAME: &str = "imu.csv";

/// The first line: seconds on the scans' clock; rates of turn, rad/s; specific force, m/s².
const COLUMNS: [&str; 7] = ["t", "gx", "gy", "gz", "ax", "ay", "az"];

/// Reads the samples of a file, which are in the sensor frame, into the body frame.
///
/// # Errors
/// Names the file, the line and the reason.
pub(super) fn read(path: &Path, body_from_sensor: &Pose) -> Result<Vec<ImuSample>> {
    let mut samples = parse(path, &files::read(path)?)?;
    // The identity changes no sample; not multiplying keeps its bits, too.
    if body_from_sensor.rotation != Pose::IDENTITY.rotation {
        for sample in &mut samples {
            sample.angular_velocity = body_from_sensor.rotation * sample.angular_velocity;
            sample.acceleration = body_from_sensor.rotation * sample.acceleration;
        }
    }
    Ok(samples)
}

/// Parses the content of the file; `path` is for messages. The samples are in the file's frame, the sensor's.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<ImuSample>> {
    samples::parse(path, bytes, &COLUMNS, "sample", sample)
}

fn sample(row: &Row<'_, 7>) -> Result<ImuSample> {
    let [_, gx, gy, gz, ax, ay, az] = row.numbers;
    Ok(ImuSample {
        time_ns: row.time_ns,
        angular_velocity: DVec3::new(gx, gy, gz),
        acceleration: DVec3::new(ax, ay, az),
        orientation: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OpenOptions;

    const HEADER: &str = "t,gx,gy,gz,ax,ay,az\n";

    fn samples(lines: &str) -> Result<Vec<ImuSample>, String> {
        parse(Path::new("imu.csv"), (HEADER.to_owned() + lines).as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn columns_are_time_turn_and_force() {
        let read = samples("0.005,1,2,3,4,5,6\r\n# a remark\n1583836591.182590976, 0, 0, 0, 0, 0, 9.8\n").unwrap();
        assert_eq!(
            read[0],
            ImuSample {
                time_ns: 5_000_000,
                angular_velocity: DVec3::new(1.0, 2.0, 3.0),
                acceleration: DVec3::new(4.0, 5.0, 6.0),
                orientation: None,
            }
        );
        assert_eq!((read.len(), read[1].time_ns), (2, 1_583_836_591_182_590_976));
        assert_eq!(samples(""), Ok(Vec::new()));
    }

    #[test]
    fn every_error_names_the_line() {
        for (bad, message) in [
            ("1,2,3", "line 3: 3 numbers where a sample has 7"),
            (
                "0,0,0,0,0,0,0",
                "line 3: the time is not later than that of the sample before",
            ),
            ("1,0,0,nan,0,0,0", "line 3: gz is not finite"),
            ("1,0,0,x,0,0,0", "line 3: \"x\" is not a number"),
            ("1e300,0,0,0,0,0,0", "line 3: the time is too large"),
        ] {
            let told = samples(&format!("0,0,0,0,0,0,0\n{bad}\n"));
            assert_eq!(told, Err(format!("imu.csv: {message}")));
        }
        let headless = parse(Path::new("imu.csv"), b"0,0,0,0,0,0,0\n").unwrap_err();
        assert_eq!(
            headless.to_string(),
            "imu.csv: line 1: the header is not t,gx,gy,gz,ax,ay,az"
        );
    }

    /// Of a folder without poses; the sensor looks to the left of the body, whose x is the sensor's −y.
    #[test]
    fn samples_are_turned_into_the_body_frame() {
        let dir = tempfile::tempdir().unwrap();
        let put = |name: &str, bytes: &[u8]| std::fs::write(dir.path().join(name), bytes).unwrap();
        std::fs::create_dir(dir.path().join("velodyne")).unwrap();
        put("velodyne/0.bin", &[0; 16]);
        put(NAME, format!("{HEADER}0.5,1,2,3,4,5,6\n").as_bytes());
        let of = || {
            let log = crate::open_with(dir.path(), &OpenOptions::default()).unwrap();
            assert!(log.scans()[0].pose.is_none());
            log.imu().unwrap()
        };
        assert_eq!(of()[0].acceleration, DVec3::new(4.0, 5.0, 6.0));
        put("sensor.toml", b"body_from_sensor = [0,-1,0,7, 1,0,0,8, 0,0,1,9]");
        let [sample] = of().try_into().unwrap();
        assert!(sample.angular_velocity.distance(DVec3::new(-2.0, 1.0, 3.0)) < 1e-12);
        assert!(sample.acceleration.distance(DVec3::new(-5.0, 4.0, 6.0)) < 1e-12);
        put(NAME, b"t\n");
        let told = crate::open(dir.path()).unwrap().imu().unwrap_err().to_string();
        assert!(
            told.ends_with("imu.csv: line 1: the header is not t,gx,gy,gz,ax,ay,az"),
            "{told}"
        );
    }
}
