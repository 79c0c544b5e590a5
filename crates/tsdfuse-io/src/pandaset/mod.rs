//! PandaSet: a folder `lidar/` of pickled scans `NN.pkl.gz`, `poses.json` and `timestamps.json`.
//!
//! What the files hold and what a [`Scan`] wants differ in four ways, all undone here:
//!
//! - Points are stored in **world** coordinates; the sensor saw them from where it was at each point's own time `t`.
//! - Poses are those of the **vehicle** (y forward). Where the sensors sit on it was measured on the data: the Pandar64 0.78 m
//!   ahead of the vehicle's origin and 1.86 m above it, the PandarGT 0.61 m further ahead and 0.30 m lower.
//! - A frame's time is the **end** of the Pandar64's sweep. Within it the sensor comes from the previous frame's pose at
//!   constant rates; those of pitch, roll, forward and vertical motion are refined so that the returns of the Pandar64 lie
//!   on its beams, which poses at 10 Hz alone do not achieve. The PandarGT sweeps on its own clock, up to 0.05 s earlier or
//!   later.
//! - Both sensors share a file: `d` is 0 for the Pandar64, 1 for the PandarGT.

mod calibration;
pub(crate) mod frames;
mod motion;
mod returns;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use tsdfuse::scan::PoseAt;
use tsdfuse::trajectory::ns_after;
use tsdfuse::{Pose, Scan, SensorModel};

use crate::dataset::{OpenOptions, ScanRef, Source};
use crate::error::{Error, Result};
use crate::files::ScanFile;
use crate::pickle::{self, DataFrame};
use crate::poses;
use calibration::Sensor;
use frames::Frames;
use returns::Returns;

/// A PandaSet sequence: the scans of one of its two sensors.
#[derive(Debug)]
pub struct PandaSet {
    lidar: PathBuf,
    sensor: Sensor,
    scans: Vec<ScanRef>,
    sweeps: Vec<Sweep>,
    notes: Vec<String>,
}

/// Where the sensor was during a sweep, by the poses of the data set, in whose world its points are stored.
#[derive(Clone, Copy, Debug)]
struct Sweep {
    /// `world_from_sensor` at the frame's time.
    pose: Pose,
    /// Seconds of the frame.
    secs: Option<f64>,
    motion: Option<PoseAt>,
}

impl PandaSet {
    /// Whether the folder is a sequence (it has `lidar/poses.json`) or the `lidar` folder of one.
    pub fn recognises(dir: &Path) -> bool {
        lidar_folder(dir).is_some()
    }

    /// Opens a sequence, or the `lidar` folder of one. `options.sensor` is `pandar64` (the default) or `pandargt`.
    ///
    /// Frames without a scan and scans without a pose are left out and named in [`Source::notes`]. Without
    /// `timestamps.json`, or with a single pose, all returns of a scan are placed from its frame's pose. `options.poses`, of
    /// the chosen sensor, place the scans elsewhere; what happens within a sweep stays as the data set has it.
    ///
    /// # Errors
    /// Names the folder, or the file and frame, and the reason.
    pub fn open(dir: &Path, options: &OpenOptions) -> Result<Self> {
        let lidar = lidar_folder(dir).ok_or_else(|| Error::dataset(dir, "has no lidar/poses.json"))?;
        let sensor = match options.sensor.as_deref() {
            None => Sensor::Pandar64,
            Some(name) => Sensor::named(name)
                .ok_or_else(|| Error::dataset(dir, format!("has no sensor '{name}': it is pandar64 or pandargt")))?,
        };
        let ego_from_sensor = sensor.ego_from_sensor();
        let frames = Frames::open(&lidar)?;
        let world_from_sensor = |frame: usize| frames.poses.get(frame).map(|pose| *pose * ego_from_sensor);
        let mut sequence = Self {
            lidar,
            sensor,
            scans: Vec::new(),
            sweeps: Vec::new(),
            notes: frames.notes(),
        };
        for (&number, name) in &frames.scans {
            let Some(pose) = world_from_sensor(number) else {
                continue;
            };
            let motion = frames.neighbour(number).and_then(|(other, secs)| {
                let pose = world_from_sensor(other)?;
                Some(PoseAt { pose, secs })
            });
            let (name, secs) = (name.clone(), frames.time(number));
            sequence.sweeps.push(Sweep { pose, secs, motion });
            sequence.scans.push(ScanRef {
                name,
                timestamp_secs: secs,
                pose,
            });
        }
        if let Some(path) = &options.poses {
            sequence.place(path)?;
        }
        match sequence.scans.is_empty() {
            true => Err(Error::dataset(&sequence.lidar, "has no scan NN.pkl.gz with a pose")),
            false => Ok(sequence),
        }
    }

    /// Puts the scans at the poses of a file.
    fn place(&mut self, path: &Path) -> Result<()> {
        let files = self.scans.iter().map(|scan| ScanFile {
            path: self.lidar.join(&scan.name),
            name: scan.name.replace(".pkl.gz", ".pkl"),
        });
        let secs = self.scans.iter().map(|scan| scan.timestamp_secs).collect();
        let placed = poses::place(path, &poses::read(path)?, &files.collect::<Vec<_>>(), secs)?;
        for (scan, (pose, secs)) in self.scans.iter_mut().zip(placed) {
            scan.pose = pose;
            scan.timestamp_secs = secs;
        }
        Ok(())
    }
}

impl Source for PandaSet {
    fn format(&self) -> &'static str {
        "PandaSet"
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    /// Reads one scan. A return whose time is missing or outside of the sweep has no known origin: it is given as a point
    /// that is not finite, so that it is dropped and counted as such.
    fn read(&self, index: usize) -> Result<Scan> {
        let (Some(scan), Some(sweep)) = (self.scans.get(index), self.sweeps.get(index)) else {
            let reason = format!("has no scan {index}, only {}", self.scans.len());
            return Err(Error::dataset(&self.lidar, reason));
        };
        let file = &self.lidar.join(&scan.name);
        let pickle = pickle::load(file)?;
        let returns = DataFrame::new(&pickle).and_then(|table| Returns::new(&table, sweep));
        let measured = returns.and_then(|returns| returns.measured(self.sensor, sweep));
        let measured = measured.map_err(|reason| Error::format(file, reason))?;
        // Other poses than the data set's move the whole sweep.
        let moved = |motion: PoseAt| PoseAt {
            pose: scan.pose * (sweep.pose.inverse() * motion.pose),
            ..motion
        };
        Ok(Scan {
            name: scan.name.clone(),
            time_ns: scan.timestamp_secs.map(|secs| ns_after(0, secs)),
            pose: Some(scan.pose),
            motion: measured.motion.iter().copied().map(moved).collect(),
            ..measured
        })
    }

    fn sensor(&self) -> Option<SensorModel> {
        self.sensor.model()
    }

    fn min_range_m(&self) -> Option<f32> {
        self.sensor.min_range_m()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// The folder with the scans: `dir/lidar`, or `dir` itself.
fn lidar_folder(dir: &Path) -> Option<PathBuf> {
    let inside = dir.join("lidar");
    if inside.join("poses.json").is_file() {
        return Some(inside);
    }
    let has_scans = || frames::scan_files(dir).is_ok_and(|(scans, _)| !scans.is_empty());
    (dir.join("poses.json").is_file() && has_scans()).then(|| dir.to_owned())
}
