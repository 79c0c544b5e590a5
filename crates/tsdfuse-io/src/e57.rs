//! E57: the scans of a terrestrial scanner, each with its pose.
//!
//! Points are in the scanner's frame, Cartesian or spherical; a scan without a pose stands at the origin, as the standard
//! (ASTM E2807) says. `--poses FILE` replaces the poses, by order, or by the times at which the scans were begun.

use std::path::Path;

use crate::error::{Error, Result};
use crate::listed::Listed;
use crate::source::OpenOptions;

/// Whether a file begins as E57 does.
pub(crate) fn recognises(path: &Path) -> bool {
    use std::io::Read;
    let mut head = [0; 8];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && &head == b"ASTM-E57"
}

#[cfg(not(feature = "e57"))]
pub(crate) fn open(path: &Path, _: &OpenOptions) -> Result<Listed> {
    Err(Error::dataset(
        path,
        "is E57, which is read if tsdfuse is built with --features e57",
    ))
}

#[cfg(feature = "e57")]
pub(crate) use reading::open;
#[cfg(feature = "e57")]
pub(crate) use reading::parse;

#[cfg(feature = "e57")]
mod reading {
    use std::fs::File;
    use std::io::{BufReader, Cursor, Read, Seek};
    use std::sync::{Mutex, PoisonError};

    use e57::{CartesianCoordinate, E57Reader, PointCloud};
    use tsdfuse::glam::{DQuat, DVec3, Vec3};
    use tsdfuse::trajectory::ns_after;
    use tsdfuse::{Pose, Scan};

    use super::*;
    use crate::files::ScanFile;
    use crate::poses;
    use crate::source::{ScanRef, Sensor};

    pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Listed> {
        let file = File::open(path).map_err(Error::io(path))?;
        let reader = E57Reader::new(BufReader::new(file)).map_err(wrong(path))?;
        let clouds = reader.pointclouds();
        if let Some(name) = options.sensors.first() {
            return Err(Error::dataset(
                path,
                format!("has no sensors by name, and so no {name:?}"),
            ));
        }
        let sensor = Sensor {
            body_from_sensor: options.extrinsics.unwrap_or_default(),
            ..Sensor::new("scanner")
        };
        let mut scans = Vec::new();
        for (number, cloud) in clouds.iter().enumerate() {
            let given = cloud.name.clone().filter(|name| !name.is_empty());
            scans.push(ScanRef {
                name: given.unwrap_or_else(|| format!("scan {number}")),
                sensor: 0,
                time_ns: cloud
                    .acquisition_start
                    .as_ref()
                    .map(|start| ns_after(0, start.gps_time)),
                pose: Some(pose(path, cloud)? * sensor.body_from_sensor),
            });
        }
        let is_timed =
            scans.iter().all(|scan| scan.time_ns.is_some()) && scans.is_sorted_by(|a, b| a.time_ns < b.time_ns);
        if !is_timed {
            scans.iter_mut().for_each(|scan| scan.time_ns = None);
        }
        if let Some(file) = &options.poses {
            let named = scans.iter().map(|scan| ScanFile {
                path: path.to_owned(),
                name: scan.name.clone(),
            });
            let named: Vec<ScanFile> = named.collect();
            let times_ns = scans.iter().map(|scan| scan.time_ns).collect();
            for (scan, (pose, _)) in scans
                .iter_mut()
                .zip(poses::place(file, &poses::read(file)?, &named, times_ns)?)
            {
                scan.pose = Some(pose * sensor.body_from_sensor);
            }
        }
        let mut notes = Vec::new();
        let without = clouds.iter().filter(|cloud| cloud.transform.is_none()).count();
        if without > 0 && options.poses.is_none() {
            notes.push(format!(
                "{without} of {} scans have no pose, and so the scanner stood at the origin; --poses FILE tells others",
                clouds.len()
            ));
        }
        let (reader, path) = (Mutex::new(reader), path.to_owned());
        let read = move |index: usize| {
            let mut reader = reader.lock().unwrap_or_else(PoisonError::into_inner);
            cloud(&path, &mut reader, &clouds[index])
        };
        Ok(Listed {
            format: "E57",
            sensors: vec![sensor],
            scans,
            trajectory: None,
            images: Vec::new(),
            notes,
            read: Box::new(read),
        })
    }

    fn wrong(path: &Path) -> impl Fn(e57::Error) -> Error {
        move |reason| {
            Error::format(
                path,
                reason.to_string().split_whitespace().collect::<Vec<_>>().join(" "),
            )
        }
    }

    /// `world_from_scanner`.
    fn pose(path: &Path, cloud: &PointCloud) -> Result<Pose> {
        let Some(transform) = &cloud.transform else {
            return Ok(Pose::IDENTITY);
        };
        let (q, t) = (&transform.rotation, &transform.translation);
        let pose = Pose::new(DQuat::from_xyzw(q.x, q.y, q.z, q.w), DVec3::new(t.x, t.y, t.z));
        pose.map_err(|e| Error::format(path, e.to_string()))
    }

    fn cloud<T: Read + Seek>(path: &Path, reader: &mut E57Reader<T>, cloud: &PointCloud) -> Result<Scan> {
        let mut points = reader.pointcloud_simple(cloud).map_err(wrong(path))?;
        points.apply_pose(false);
        points.intensity_to_color(false);
        points.normalize_intensity(false);
        let mut scan = Scan::default();
        let mut intensities = Vec::new();
        for point in points {
            let point = point.map_err(wrong(path))?;
            scan.points.push(match point.cartesian {
                CartesianCoordinate::Valid { x, y, z } => Vec3::new(x as f32, y as f32, z as f32),
                _ => Vec3::NAN,
            });
            intensities.push(point.intensity.unwrap_or(0.0));
        }
        scan.intensities = cloud.has_intensity().then_some(intensities);
        Ok(scan)
    }

    /// All scans of a file in memory, for tests of hostile bytes.
    pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<usize> {
        let mut reader = E57Reader::new(Cursor::new(bytes)).map_err(wrong(path))?;
        let mut points = 0;
        for one in reader.pointclouds() {
            pose(path, &one)?;
            points += cloud(path, &mut reader, &one)?.points.len();
        }
        Ok(points)
    }
}
