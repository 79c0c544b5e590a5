//! KITTI raw: one drive, `velodyne_points/data/*.bin` with poses from `oxts/data/*.txt` (GPS and IMU).
//!
//! Latitude and longitude become metres by KITTI's Mercator projection, scaled for the latitude of the first packet:
//! x east, y north, z up, with the origin at the first packet. A scan's pose is that of the packet of its number, moved
//! along the packets' trajectory to the scan's own time (the packet is up to 5 ms off). `calib_imu_to_velo.txt` is taken
//! from the drive's folder or the one above; without it the scanner is taken to be where the IMU is.
//!
//! The body is the IMU: the packets' poses are the log's trajectory, and their rates and accelerations its IMU samples.

use std::f64::consts::FRAC_PI_4;
use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::pose::Interpolation;
use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Trajectory};

use crate::calib::KITTI_HDL64E_DEG;
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::folder::{self, PoseFile, ScanFolder};
use crate::poses::Poses;
use crate::source::{GnssFix, ImuSample, OpenOptions};
use crate::{calib, present, text, times};

/// Equatorial radius of the Earth, metres.
const EARTH_RADIUS_M: f64 = 6_378_137.0;
/// A packet farther than this from its scan was not taken with it.
const MAX_DELAY_SECS: f64 = 0.2;

/// Whether there is a folder of Velodyne scans as in a drive.
pub(crate) fn recognises(path: &Path) -> bool {
    files::list(&path.join("velodyne_points/data"), "bin").is_ok_and(|scans| !scans.is_empty())
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let velodyne = path.join("velodyne_points");
    let scans = files::list(&velodyne.join("data"), "bin")?;
    let new = |poses| {
        Ok(ScanFolder::new("KITTI raw", &velodyne, &scans, poses, options)?
            .with_usual_sensor("hdl64e", KITTI_HDL64E_DEG))
    };
    let packets = path.join("oxts/data");
    if options.poses.is_some() || !present::folder(&packets)? {
        return new(folder::poses(path, options, Path::new(""))?);
    }
    let velodyne_from_imu = velodyne_from_imu(path)?;
    let missing = || "no calib_imu_to_velo.txt: the scanner is taken to be where the IMU is".to_owned();
    let imu_from_velodyne = options
        .extrinsics
        .unwrap_or(velodyne_from_imu.unwrap_or_default().inverse());
    let packets = Packets::read(path, packets)?;
    let world_from_imu = packets.at_scans(path, &scans)?;
    let poses = PoseFile {
        path: packets.folder.clone(),
        // Of the scanner already.
        poses: Poses::Listed(
            world_from_imu
                .into_iter()
                .map(|pose| pose * imu_from_velodyne)
                .collect(),
        ),
        note: (velodyne_from_imu.is_none() && options.extrinsics.is_none()).then(missing),
    };
    let of_scanner = OpenOptions {
        extrinsics: Some(Pose::IDENTITY),
        ..options.clone()
    };
    let log = ScanFolder::new("KITTI raw", &velodyne, &scans, Some(poses), &of_scanner)?
        .with_usual_sensor("hdl64e", KITTI_HDL64E_DEG);
    Ok(log.with_body(packets.trajectory()?, imu_from_velodyne, packets.imu(), packets.gnss()))
}

/// What `oxts/` holds.
struct Packets {
    folder: PathBuf,
    files: Vec<ScanFile>,
    packets: Vec<Packet>,
    /// `world_from_imu`.
    poses: Vec<Pose>,
    times_ns: Option<Vec<i64>>,
}

impl Packets {
    fn read(path: &Path, folder: PathBuf) -> Result<Self> {
        let files = files::list(&folder, "txt")?;
        let packets: Vec<_> = files
            .iter()
            .map(|f| packet(&f.path, &files::read(&f.path)?))
            .collect::<Result<_>>()?;
        let first = packets
            .first()
            .ok_or_else(|| Error::dataset(&folder, "holds no packets"))?;
        let scale = first.latitude_deg.to_radians().cos();
        let origin = first.position(scale);
        let pose = |packet: &Packet| Pose {
            rotation: packet.rotation(),
            translation: packet.position(scale) - origin,
        };
        Ok(Self {
            poses: packets.iter().map(pose).collect(),
            times_ns: times::of_scans(&path.join("oxts"), &files)?,
            folder,
            files,
            packets,
        })
    }

    /// `world_from_imu` at the time of each scan.
    fn at_scans(&self, path: &Path, scans: &[ScanFile]) -> Result<Vec<Pose>> {
        let scans_ns = times::of_scans(&path.join("velodyne_points"), scans)?;
        let times_ns = scans_ns.zip(self.times_ns.as_ref());
        let at_scan = |(i, scan): (usize, &ScanFile)| {
            let number = scan.number();
            let k = self
                .files
                .iter()
                .position(|f| f.number() == number && number.is_some())
                .ok_or_else(|| Error::dataset(&self.folder, format!("has no packet for scan {}", scan.name)))?;
            let Some((scans_ns, packets_ns)) = &times_ns else {
                return Ok(self.poses[k]);
            };
            let late = secs_between(packets_ns[k], scans_ns[i]);
            if late.abs() > MAX_DELAY_SECS {
                let reason = format!("the packet of scan {} is {late:.3} s away from it", scan.name);
                return Err(Error::dataset(&self.folder, reason));
            }
            Ok(moved(&self.poses, packets_ns, k, late))
        };
        scans.iter().enumerate().map(at_scan).collect()
    }

    /// `world_from_imu` over time, where the packets have times.
    fn trajectory(&self) -> Result<Option<Trajectory>> {
        let Some(times_ns) = &self.times_ns else {
            return Ok(None);
        };
        let mut timed: Vec<_> = times_ns.iter().copied().zip(self.poses.iter().copied()).collect();
        // KITTI has some packets twice, or out of order by a moment.
        timed.sort_by_key(|(time_ns, _)| *time_ns);
        timed.dedup_by_key(|(time_ns, _)| *time_ns);
        let trajectory = Trajectory::new(timed).map_err(|e| Error::dataset(&self.folder, e.to_string()))?;
        Ok(Some(trajectory))
    }

    /// Where the packets say that the unit was, where they have times.
    fn gnss(&self) -> Vec<GnssFix> {
        let timed = self.times_ns.iter().flatten().zip(&self.packets);
        let fix = |(&time_ns, packet): (&i64, &Packet)| GnssFix {
            time_ns,
            latitude_deg: packet.latitude_deg,
            longitude_deg: packet.longitude_deg,
            altitude_m: Some(packet.altitude_m),
            sigma_m: packet.sigma_m.map(|sigma| [sigma; 3]),
            ..GnssFix::default()
        };
        let mut fixes: Vec<_> = timed.map(fix).collect();
        fixes.sort_by_key(|fix| fix.time_ns);
        fixes
    }

    /// The packets that have rates and accelerations, where they have times.
    fn imu(&self) -> Vec<ImuSample> {
        let timed = self.times_ns.iter().flatten().zip(&self.packets);
        let sample = |(&time_ns, packet): (&i64, &Packet)| {
            let (acceleration, angular_velocity) = packet.inertial?;
            Some(ImuSample {
                time_ns,
                angular_velocity,
                acceleration,
                orientation: Some(packet.rotation()),
            })
        };
        let mut samples: Vec<_> = timed.filter_map(sample).collect();
        samples.sort_by_key(|sample| sample.time_ns);
        samples
    }
}

/// Pose `k`, `late` seconds after its time, going towards the neighbour on that side, or on from the other one.
fn moved(poses: &[Pose], times_ns: &[i64], k: usize, late: f64) -> Pose {
    let (after, before) = (k.checked_add(1), k.checked_sub(1));
    let sides = if late < 0.0 { [before, after] } else { [after, before] };
    let neighbour = sides
        .into_iter()
        .flatten()
        .find(|&n| n < poses.len() && times_ns[n] != times_ns[k]);
    neighbour.map_or(poses[k], |n| {
        Interpolation::new(poses[k], poses[n]).at(late / secs_between(times_ns[k], times_ns[n]))
    })
}

/// What a packet says: degrees, metres and radians, m/s² and rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Packet {
    latitude_deg: f64,
    longitude_deg: f64,
    altitude_m: f64,
    roll_rad: f64,
    pitch_rad: f64,
    yaw_rad: f64,
    /// Acceleration and rates of turn about the IMU's axes, where the packet has them.
    inertial: Option<(DVec3, DVec3)>,
    /// Accuracy of the position, where the packet tells it.
    sigma_m: Option<f64>,
}

/// Parses a file of `oxts/data`; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn packet(path: &Path, bytes: &[u8]) -> Result<Packet> {
    let line = text::lines(path, bytes)?
        .next()
        .ok_or_else(|| Error::format(path, "is empty"))?;
    let numbers = line.numbers()?;
    let &[
        latitude_deg,
        longitude_deg,
        altitude_m,
        roll_rad,
        pitch_rad,
        yaw_rad,
        ..,
    ] = numbers.as_slice()
    else {
        return Err(line.error(format!(
            "{} numbers where lat lon alt roll pitch yaw were expected",
            numbers.len()
        )));
    };
    if !(numbers[..6].iter().all(|v| v.is_finite()) && latitude_deg.abs() < 85.0) {
        return Err(line.error("latitude, longitude, altitude or an angle is not possible"));
    }
    let vector = |at: usize| numbers.get(at..at + 3).map(DVec3::from_slice).filter(|v| v.is_finite());
    Ok(Packet {
        // ax ay az and wx wy wz of KITTI's dataformat.txt.
        inertial: vector(11).zip(vector(17)),
        // pos_accuracy.
        sigma_m: numbers
            .get(23)
            .copied()
            .filter(|sigma| sigma.is_finite() && *sigma > 0.0),
        latitude_deg,
        longitude_deg,
        altitude_m,
        roll_rad,
        pitch_rad,
        yaw_rad,
    })
}

impl Packet {
    /// Metres east and north on the Mercator map of this scale, and up.
    fn position(&self, scale: f64) -> DVec3 {
        let north = (FRAC_PI_4 + self.latitude_deg.to_radians() / 2.0).tan().ln();
        let on_map = DVec3::new(self.longitude_deg.to_radians(), north, 0.0) * (scale * EARTH_RADIUS_M);
        on_map.with_z(self.altitude_m)
    }

    /// `world_from_imu`: roll about x (forward), then pitch about y (left), then yaw about z (up, 0 = east).
    fn rotation(&self) -> DQuat {
        DQuat::from_rotation_z(self.yaw_rad)
            * DQuat::from_rotation_y(self.pitch_rad)
            * DQuat::from_rotation_x(self.roll_rad)
    }
}

/// `calib_imu_to_velo.txt` of the folder or the one above.
fn velodyne_from_imu(path: &Path) -> Result<Option<Pose>> {
    for folder in [path.to_owned(), path.join("..")] {
        let file = folder.join("calib_imu_to_velo.txt");
        if present::file(&file)? {
            return calib::parse_rt(&file, &files::read(&file)?).map(Some);
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests;
