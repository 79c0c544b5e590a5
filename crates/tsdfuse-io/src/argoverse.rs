//! Argoverse 2 (sensor and lidar data sets): one log, `sensors/lidar/*.feather` with `city_SE3_egovehicle.feather` and
//! `calibration/egovehicle_SE3_sensor.feather`.
//!
//! Two scanners of 32 beams, `up_lidar` and `down_lidar`, are in each file, one with the lasers 0 to 31 and the other with 32 to 63;
//! which is which is told by the frame in which each laser has a constant elevation. Their points are stored in the
//! vehicle's frame as it was at the sweep's time, motion taken out; `offset_ns` is when each was measured, counted from there. Here
//! they are brought back to where the scanner saw them. Each scanner is a sensor of its own.

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::trajectory::ns_after;
use tsdfuse::{Pose, Scan, Trajectory};

use crate::error::{Error, Result};
use crate::feather::{self, Columns};
use crate::files::{self, ScanFile};
use crate::listed::Listed;
use crate::poses;
use crate::source::{OpenOptions, ScanRef, Sensor};
use crate::{placed, present};

const SCANNERS: [&str; 2] = ["up_lidar", "down_lidar"];
/// Lasers of each of them.
const LASERS: i64 = 32;
/// The numbers of a pose, as its columns are called.
const POSE: [&str; 7] = ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"];

/// Whether there are sweeps as in a log of Argoverse 2.
pub(crate) fn recognises(path: &Path) -> bool {
    files::list(&path.join("sensors/lidar"), "feather").is_ok_and(|sweeps| !sweeps.is_empty())
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Listed> {
    let sweeps = files::list(&path.join("sensors/lidar"), "feather")?;
    let calibration = extrinsics(&path.join("calibration/egovehicle_SE3_sensor.feather"))?;
    let mut notes = Vec::new();
    let trajectory = trajectory(path, options, &mut notes)?;
    let mut known: Vec<Scanner> = SCANNERS
        .iter()
        .enumerate()
        .filter_map(|(number, name)| {
            let (_, ego_from_sensor) = calibration.iter().find(|(known, _)| known == name)?;
            Some(Scanner {
                name,
                first_laser: LASERS * number as i64,
                ego_from_sensor: *ego_from_sensor,
            })
        })
        .collect();
    if let ([up, down], Some(first)) = (&mut known[..], sweeps.first()) {
        Scanner::tell_apart(up, down, first, trajectory.as_ref())?;
    }
    for name in &options.sensors {
        if !known.iter().any(|known| known.name == name) {
            let names: Vec<_> = known.iter().map(|known| known.name).collect();
            let reason = format!("there is no scanner {name:?}; there are {}", names.join(", "));
            return Err(Error::dataset(path, reason));
        }
    }
    let is_asked = |name: &str| options.sensors.is_empty() || options.sensors.iter().any(|asked| asked == name);
    let scanners: Vec<Scanner> = known
        .into_iter()
        .filter(|scanner| is_asked(scanner.name))
        .map(|scanner| Scanner {
            ego_from_sensor: options.extrinsics.unwrap_or(scanner.ego_from_sensor),
            ..scanner
        })
        .collect();
    if scanners.is_empty() {
        return Err(Error::dataset(
            path,
            "its calibration tells of no up_lidar and no down_lidar",
        ));
    }
    let mut scans = Vec::new();
    let mut places = Vec::new();
    let mut unplaced = 0;
    for sweep in &sweeps {
        let time_ns = time_ns(sweep)?;
        let ego = trajectory.as_ref().map(|trajectory| poses::at(trajectory, time_ns));
        if matches!(ego, Some(Err(_))) {
            unplaced += 1;
            continue;
        }
        for (number, scanner) in scanners.iter().enumerate() {
            scans.push(ScanRef {
                name: format!("{} {}", scanner.name, sweep.name),
                sensor: number,
                time_ns: Some(time_ns),
                pose: ego
                    .as_ref()
                    .and_then(|ego| ego.as_ref().ok())
                    .map(|ego| *ego * scanner.ego_from_sensor),
            });
            places.push(sweep.path.clone());
        }
    }
    if unplaced > 0 {
        notes.push(format!("{unplaced} sweeps at times without a pose are left out"));
    }
    let sensors = scanners.iter().map(|scanner| Sensor {
        body_from_sensor: scanner.ego_from_sensor,
        ..Sensor::new(scanner.name)
    });
    let (sensors, refs, moved) = (sensors.collect(), scans.clone(), trajectory.clone());
    let read = move |index: usize| {
        let (reference, file): (&ScanRef, &PathBuf) = (&refs[index], &places[index]);
        let scan = scanners[reference.sensor].read(file, reference.time_ns.unwrap_or_default(), moved.as_ref())?;
        let ego_from_sensor = &scanners[reference.sensor].ego_from_sensor;
        let times = scan.times.as_deref().unwrap_or_default();
        Ok(Scan {
            motion: placed::motion(&refs, index, times, moved.as_ref(), ego_from_sensor),
            ..scan
        })
    };
    Ok(Listed {
        format: "Argoverse 2",
        sensors,
        scans,
        trajectory,
        images: Vec::new(),
        notes,
        read: Box::new(read),
    })
}

/// A sweep is named by its time.
fn time_ns(sweep: &ScanFile) -> Result<i64> {
    let number = sweep.number().and_then(|number| i64::try_from(number).ok());
    number.ok_or_else(|| Error::format(&sweep.path, "is not named by its time in nanoseconds"))
}

/// One of the two.
struct Scanner {
    name: &'static str,
    first_laser: i64,
    ego_from_sensor: Pose,
}

impl Scanner {
    /// Gives the lasers 32 to 63 to the first scanner if elevations say so.
    fn tell_apart(up: &mut Self, down: &mut Self, sweep: &ScanFile, trajectory: Option<&Trajectory>) -> Result<()> {
        let spread = |scanner: &Self, first_laser: i64| {
            let scanner = Self {
                first_laser,
                ..*scanner
            };
            let scan = scanner.read(&sweep.path, time_ns(sweep)?, trajectory)?;
            let mut of_ring = vec![Vec::new(); LASERS as usize];
            for (point, ring) in scan.points.iter().zip(scan.rings.iter().flatten()) {
                if let Some(all) = of_ring.get_mut(usize::from(*ring)) {
                    all.push(point.z.atan2(point.x.hypot(point.y)));
                }
            }
            // From the first to the last quarter of each laser's elevations.
            let spreads = of_ring.iter_mut().map(|all| {
                all.sort_by(f32::total_cmp);
                let at = |i: usize| all.get(i).copied().unwrap_or(0.0);
                f64::from(at(all.len() * 3 / 4) - at(all.len() / 4))
            });
            Ok::<f64, Error>(spreads.sum())
        };
        let told = spread(up, 0)? + spread(down, LASERS)?;
        if spread(up, LASERS)? + spread(down, 0)? < told {
            (up.first_laser, down.first_laser) = (LASERS, 0);
        }
        Ok(())
    }

    /// Its points of a sweep, each as it saw it at its own time.
    fn read(&self, path: &Path, time_ns: i64, trajectory: Option<&Trajectory>) -> Result<Scan> {
        let names = ["x", "y", "z", "intensity", "laser_number", "offset_ns"];
        let table = feather::parse(path, &files::read(path)?, &names)?;
        let [x, y, z, intensity] = [0, 1, 2, 3].map(|column| table.floats(column));
        let (lasers, offsets) = (table.integers(4), table.integers(5));
        let lengths = [&y, &z, &intensity].map(Vec::len);
        if lengths.iter().any(|n| *n != x.len()) || lasers.len() != x.len() || offsets.len() != x.len() {
            return Err(Error::format(path, "its columns differ in length"));
        }
        let world_from_ego = trajectory.and_then(|trajectory| trajectory.at(time_ns));
        let sensor_from_ego = self.ego_from_sensor.inverse();
        // Returns of one firing have one time: the transform is computed anew only where it changes.
        let (mut last, mut sensor_then_from_ego) = (0, sensor_from_ego);
        let mut scan = Scan::default();
        let (mut rings, mut times, mut intensities) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..x.len() {
            let laser = lasers[i] - self.first_laser;
            if !(0..LASERS).contains(&laser) {
                continue;
            }
            let secs = offsets[i] as f64 * 1e-9;
            if offsets[i] != last {
                last = offsets[i];
                let then = trajectory.and_then(|trajectory| trajectory.at(ns_after(time_ns, secs)));
                sensor_then_from_ego = match then.zip(world_from_ego) {
                    Some((then, now)) => sensor_from_ego * then.inverse() * now,
                    None => sensor_from_ego,
                };
            }
            let point = sensor_then_from_ego.transform_point(DVec3::new(x[i], y[i], z[i]));
            scan.points.push(point.as_vec3());
            rings.push(laser as u16);
            times.push(secs as f32);
            intensities.push(intensity[i] as f32);
        }
        tsdfuse::sensor::sort_rings(&scan.points, &mut rings);
        (scan.rings, scan.times, scan.intensities) = (Some(rings), Some(times), Some(intensities));
        Ok(scan)
    }
}

/// `city_from_egovehicle`, or the poses that are asked for.
fn trajectory(path: &Path, options: &OpenOptions, notes: &mut Vec<String>) -> Result<Option<Trajectory>> {
    if let Some(file) = &options.poses {
        return match poses::read(file)? {
            poses::Poses::Timed(trajectory) => Ok(Some(trajectory)),
            poses::Poses::Listed(_) => Err(Error::dataset(file, "has no times, which these sweeps need")),
        };
    }
    let file = path.join("city_SE3_egovehicle.feather");
    if !present::file(&file)? {
        notes.push("there is no city_SE3_egovehicle.feather: the scans' poses are not known".to_owned());
        return Ok(None);
    }
    let table = feather::parse(&file, &files::read(&file)?, &[&["timestamp_ns"], &POSE[..]].concat())?;
    let mut timed: Vec<_> = table.integers(0).into_iter().zip(rigid(&file, &table, 1)?).collect();
    timed.sort_by_key(|(time_ns, _)| *time_ns);
    timed.dedup_by_key(|(time_ns, _)| *time_ns);
    let trajectory = Trajectory::new(timed).map_err(|e| Error::format(&file, e.to_string()))?;
    Ok(Some(trajectory))
}

/// Where each sensor sits on the vehicle.
fn extrinsics(path: &Path) -> Result<Vec<(String, Pose)>> {
    let table = feather::parse(path, &files::read(path)?, &[&["sensor_name"], &POSE[..]].concat())?;
    let names = table.texts(0).iter().cloned();
    Ok(names.zip(rigid(path, &table, 1)?).collect())
}

/// The poses of seven columns.
fn rigid(path: &Path, table: &Columns, first: usize) -> Result<Vec<Pose>> {
    let columns: Vec<Vec<f64>> = (first..first + POSE.len()).map(|column| table.floats(column)).collect();
    let rows = columns.iter().map(Vec::len).min().unwrap_or(0);
    let pose = |row: usize| {
        let [w, x, y, z, tx, ty, tz] = [0, 1, 2, 3, 4, 5, 6].map(|column: usize| columns[column][row]);
        let pose = Pose::new(DQuat::from_xyzw(x, y, z, w), DVec3::new(tx, ty, tz));
        pose.map_err(|e| Error::format(path, format!("row {row}: {e}")))
    };
    (0..rows).map(pose).collect()
}
