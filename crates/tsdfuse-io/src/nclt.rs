//! NCLT (University of Michigan North Campus): one session, `velodyne_sync/*.bin` with `groundtruth_DATE.csv`.
//!
//! Scans are named by their time in microseconds. A point is five little-endian numbers, x y z (`u16`, 5 mm a unit, from −100 m),
//! intensity and laser (`u8`), in the body's frame, whose z points down. Here they are brought into the scanner's frame with the
//! makers' calibration, z up. The ground truth has a line `utime,x,y,z,roll,pitch,yaw` (metres, radians), also z down; the world here
//! has z up.

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3, EulerRot, Vec3};
use tsdfuse::{Pose, Trajectory};

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::files;
use crate::folder::{self, PoseFile, ScanFolder};
use crate::poses::Poses;
use crate::source::OpenOptions;
use crate::text;

const UNIT_M: f32 = 0.005;
const FIRST_M: f32 = -100.0;

/// Whether there are scans as in a session.
pub(crate) fn recognises(path: &Path) -> bool {
    files::list(&path.join("velodyne_sync"), "bin").is_ok_and(|scans| !scans.is_empty())
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let scans = files::list(&path.join("velodyne_sync"), "bin")?;
    let poses = match (&options.poses, ground_truth(path)?) {
        (None, Some(file)) => Some(PoseFile {
            poses: Poses::Timed(parse_poses(&file, &files::read(&file)?)?),
            path: file,
            note: None,
        }),
        _ => folder::poses(path, options, Path::new(""))?,
    };
    let (scans, left_out) = folder::covered(path, scans, poses.as_ref())?;
    let options = OpenOptions {
        extrinsics: Some(options.extrinsics.unwrap_or_else(body_from_velodyne)),
        ..options.clone()
    };
    let log = ScanFolder::new("NCLT", path, &scans, poses, &options)?;
    Ok(log
        .with_reader(parse)
        .with_usual_sensor("hdl32e", 0.0)
        .without(left_out))
}

/// `groundtruth_DATE.csv`, in the session's folder or in `ground_truth/` beside it.
fn ground_truth(path: &Path) -> Result<Option<PathBuf>> {
    let session = std::fs::canonicalize(path).map_err(Error::io(path))?;
    let beside = format!("groundtruth_{}.csv", files::name(&session));
    let names = files::names(path)?.into_iter();
    let here = names.filter(|name| name.starts_with("groundtruth_") && name.ends_with(".csv"));
    let mut all = here
        .map(|name| path.join(name))
        .chain([path.join("../ground_truth").join(beside)]);
    Ok(all.find(|file| file.is_file()))
}

/// Half a turn about x: z down becomes z up.
fn upright() -> DQuat {
    DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0)
}

/// Where the scanner, z up, sits on the body, z down: the makers' x y z (metres) and roll, pitch, heading (degrees).
fn body_from_velodyne() -> Pose {
    let [roll, pitch, heading] = [0.807_f64, 0.166, -90.703].map(f64::to_radians);
    Pose {
        rotation: DQuat::from_euler(EulerRot::ZYX, heading, pitch, roll) * upright(),
        translation: DVec3::new(0.002, -0.004, -0.957),
    }
}

/// Parses a file of `velodyne_sync`; `path` is for messages.
///
/// # Errors
/// Names the file if its size is no multiple of 8 bytes.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let (records, []) = bytes.as_chunks::<8>() else {
        let reason = format!("is truncated: {} bytes are not a multiple of 8", bytes.len());
        return Err(Error::format(path, reason));
    };
    let velodyne_from_body = body_from_velodyne().inverse();
    let point = |r: &[u8; 8]| {
        let metres = |low: u8, high: u8| f32::from(u16::from_le_bytes([low, high])) * UNIT_M + FIRST_M;
        let in_body = Vec3::new(metres(r[0], r[1]), metres(r[2], r[3]), metres(r[4], r[5]));
        velodyne_from_body.transform_point(in_body.as_dvec3()).as_vec3()
    };
    let points: Vec<Vec3> = records.iter().map(point).collect();
    let mut rings: Vec<u16> = records.iter().map(|r| u16::from(r[7])).collect();
    tsdfuse::sensor::sort_rings(&points, &mut rings);
    Ok(Cloud {
        points,
        rings: Some(rings),
        intensities: Some(records.iter().map(|r| f32::from(r[6])).collect()),
        ..Cloud::default()
    })
}

/// Parses the ground truth; lines without a pose (NaN) are passed over. `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse_poses(path: &Path, bytes: &[u8]) -> Result<Trajectory> {
    let mut timed: Vec<(i64, Pose)> = Vec::new();
    for line in text::lines(path, bytes)? {
        let numbers = line.numbers()?;
        let &[_, x, y, z, roll, pitch, yaw] = numbers.as_slice() else {
            return Err(line.error(format!(
                "{} numbers where utime x y z roll pitch yaw were expected",
                numbers.len()
            )));
        };
        if numbers.iter().any(|number| !number.is_finite()) {
            continue;
        }
        let time_ns = line.words().next().and_then(text::nanoseconds);
        let time_ns = time_ns.ok_or_else(|| line.error("its time is too large"))?;
        if timed.last().is_some_and(|(last, _)| *last >= time_ns) {
            return Err(line.error("its time is not later than that of the pose before"));
        }
        let pose = Pose {
            rotation: upright() * DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
            translation: upright() * DVec3::new(x, y, z),
        };
        timed.push((time_ns, pose));
    }
    Trajectory::new(timed).map_err(|e| Error::format(path, e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_turn_from_the_body_to_the_scanner() {
        // 10 m to the right of the body and 3 m above it: z counts downwards.
        let record = |x: f32, y: f32, z: f32, laser: u8| {
            let number = |v: f32| (((v - FIRST_M) / UNIT_M).round() as u16).to_le_bytes();
            [number(x), number(y), number(z), [9, laser]].concat()
        };
        let cloud = parse(
            Path::new("1.bin"),
            &[record(0.0, 10.0, -3.0, 4), record(0.0, 10.0, 1.0, 2)].concat(),
        )
        .unwrap();
        let there = body_from_velodyne().transform_point(cloud.points[0].as_dvec3());
        assert!(there.distance(DVec3::new(0.0, 10.0, -3.0)) < 0.01, "{there}");
        // The scanner sits 0.957 m above the body, tilted by less than a degree.
        assert!((cloud.points[0].z - 2.04).abs() < 0.2, "{}", cloud.points[0]);
        assert_eq!(cloud.rings, Some(vec![4, 2]));
        let message = parse(Path::new("1.bin"), &[0; 9]).unwrap_err().to_string();
        assert_eq!(message, "1.bin: is truncated: 9 bytes are not a multiple of 8");
    }

    #[test]
    fn the_world_has_z_up() {
        let read = |text: &str| parse_poses(Path::new("g.csv"), text.as_bytes()).map_err(|e| e.to_string());
        let truth = read("1326030975726043,nan,nan,nan,nan,nan,nan\n1326030975826043,1,2,-3,0,0,0.5\n").unwrap();
        assert_eq!(truth.times_ns(), [1_326_030_975_826_043_000]);
        let pose = truth.poses()[0];
        assert!(pose.translation.distance(DVec3::new(1.0, -2.0, 3.0)) < 1e-9, "{pose:?}");
        // Heading counts from north to east, and so turns the other way round here.
        let forward = pose.rotation * DVec3::X;
        assert!(
            forward.distance(DVec3::new(0.5f64.cos(), -0.5f64.sin(), 0.0)) < 1e-9,
            "{forward}"
        );
        assert!(read("1,2,3").unwrap_err().contains("line 1: 3 numbers where"));
        assert!(
            read("2,0,0,0,0,0,0\n1,0,0,0,0,0,0")
                .unwrap_err()
                .contains("line 2: its time")
        );
    }
}
