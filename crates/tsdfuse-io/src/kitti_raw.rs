//! KITTI raw: one drive, `velodyne_points/data/*.bin` with poses from `oxts/data/*.txt` (GPS and IMU).
//!
//! Latitude and longitude become metres by KITTI's Mercator projection, scaled for the latitude of the first packet:
//! x east, y north, z up, with the origin at the first packet. A scan's pose is that of the packet of its number, moved
//! along the packets' trajectory to the scan's own time (the packet is up to 5 ms off). `calib_imu_to_velo.txt` is taken
//! from the drive's folder or the one above; without it the scanner is taken to be where the IMU is.

use std::f64::consts::FRAC_PI_4;
use std::path::{Path, PathBuf};

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::pose::Interpolation;

use crate::dataset::OpenOptions;
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::folder::{self, PoseFile, ScanFolder};
use crate::poses::Poses;
use crate::{calib, text, times};

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
    let packets = path.join("oxts/data");
    let poses = if options.poses.is_none() && packets.is_dir() {
        let velodyne_from_imu = velodyne_from_imu(path)?;
        let missing = || "no calib_imu_to_velo.txt: the scanner is taken to be where the IMU is".to_owned();
        let imu_from_velodyne = velodyne_from_imu.unwrap_or_default().inverse();
        let world_from_imu = imu_at_scans(path, &scans)?;
        PoseFile {
            path: packets,
            poses: Poses::Listed(
                world_from_imu
                    .into_iter()
                    .map(|pose| pose * imu_from_velodyne)
                    .collect(),
            ),
            note: velodyne_from_imu.is_none().then(missing),
        }
    } else {
        folder::poses(path, options, Path::new(""))?
    };
    Ok(ScanFolder::new("KITTI raw", &velodyne, &scans, poses, options)?.with_usual_sensor("hdl64e"))
}

/// `world_from_imu` at the time of each scan.
fn imu_at_scans(path: &Path, scans: &[ScanFile]) -> Result<Vec<Pose>> {
    let folder = path.join("oxts/data");
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
    let poses: Vec<_> = packets.iter().map(pose).collect();
    let scan_secs = times::of_scans(&path.join("velodyne_points"), scans)?;
    let secs = scan_secs.zip(times::of_scans(&path.join("oxts"), &files)?);
    let at_scan = |(i, scan): (usize, &ScanFile)| {
        let number = scan.number();
        let k = files
            .iter()
            .position(|f| f.number() == number && number.is_some())
            .ok_or_else(|| Error::dataset(&folder, format!("has no packet for scan {}", scan.name)))?;
        let Some((scan_secs, packet_secs)) = &secs else {
            return Ok(poses[k]);
        };
        let late = scan_secs[i] - packet_secs[k];
        if late.abs() > MAX_DELAY_SECS {
            let reason = format!("the packet of scan {} is {late:.3} s away from it", scan.name);
            return Err(Error::dataset(&folder, reason));
        }
        Ok(moved(&poses, packet_secs, k, late))
    };
    scans.iter().enumerate().map(at_scan).collect()
}

/// Pose `k`, `late` seconds after its time, going towards the neighbour on that side, or on from the other one.
fn moved(poses: &[Pose], secs: &[f64], k: usize, late: f64) -> Pose {
    let (after, before) = (k.checked_add(1), k.checked_sub(1));
    let sides = if late < 0.0 { [before, after] } else { [after, before] };
    let neighbour = sides
        .into_iter()
        .flatten()
        .find(|&n| n < poses.len() && secs[n] != secs[k]);
    neighbour.map_or(poses[k], |n| {
        Interpolation::new(poses[k], poses[n]).at(late / (secs[n] - secs[k]))
    })
}

/// What a packet says of the pose: degrees, metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Packet {
    latitude_deg: f64,
    longitude_deg: f64,
    altitude_m: f64,
    roll_rad: f64,
    pitch_rad: f64,
    yaw_rad: f64,
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
    Ok(Packet {
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
    let places = [path.to_owned(), path.join("..")].map(|folder| folder.join("calib_imu_to_velo.txt"));
    let found: Option<&PathBuf> = places.iter().find(|p| p.is_file());
    found.map(|file| calib::parse_rt(file, &files::read(file)?)).transpose()
}

#[cfg(test)]
mod tests;
