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
//!
//! The vehicle's poses are the log's trajectory. Its images are those of `camera/*/`, beside `lidar/`.

mod calibration;
pub(crate) mod cameras;
pub(crate) mod frames;
mod motion;
mod returns;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use tsdfuse::scan::PoseAt;
use tsdfuse::trajectory::ns_after;
use tsdfuse::{Pose, Scan, Trajectory};

use crate::error::{Error, Result};
use crate::files::ScanFile;
use crate::pickle::{self, DataFrame};
use crate::poses;
use crate::source::{ImageRef, OpenOptions, ScanRef, Sensor, Source};
use calibration::Lidar;
use frames::Frames;
use motion::Placement;
use returns::Returns;

/// A PandaSet sequence: the scans of one of its two sensors, or of both.
#[derive(Debug)]
pub struct PandaSet {
    lidar: PathBuf,
    lidars: Vec<Lidar>,
    sensors: Vec<Sensor>,
    scans: Vec<ScanRef>,
    /// As long as `scans`.
    entries: Vec<Entry>,
    trajectory: Option<Trajectory>,
    images: Vec<ImageRef>,
    notes: Vec<String>,
}

/// The file of a scan, and where its sensor was by the poses of the data set.
#[derive(Debug)]
struct Entry {
    file: String,
    sweep: Placement,
}

impl PandaSet {
    /// Whether the folder is a sequence (it has `lidar/poses.json`) or the `lidar` folder of one.
    pub fn recognises(dir: &Path) -> bool {
        lidar_folder(dir).is_some()
    }

    /// Opens a sequence, or the `lidar` folder of one. `options.sensors` are `pandar64` (the default), `pandargt`, or both.
    ///
    /// Frames without a scan and scans without a pose are left out and named in [`Source::notes`]. Without
    /// `timestamps.json`, or with a single pose, all returns of a scan are placed from its frame's pose. `options.poses`, of
    /// the first chosen sensor, place the scans elsewhere; what happens within a sweep stays as the data set has it.
    ///
    /// # Errors
    /// Names the folder, or the file and frame, and the reason.
    pub fn open(dir: &Path, options: &OpenOptions) -> Result<Self> {
        let lidar = lidar_folder(dir).ok_or_else(|| Error::dataset(dir, "has no lidar/poses.json"))?;
        let lidars = lidars(dir, &options.sensors)?;
        if options.extrinsics.is_some_and(|pose| pose != Pose::IDENTITY) {
            return Err(Error::dataset(
                dir,
                "knows where its sensors sit on the vehicle: no extrinsics are wanted",
            ));
        }
        let frames = Frames::open(&lidar)?;
        let (images, image_notes) = cameras::images(&lidar.join("../camera"));
        let mut sequence = Self {
            sensors: lidars.iter().copied().map(sensor).collect(),
            scans: Vec::new(),
            entries: Vec::new(),
            trajectory: frames.trajectory(),
            images,
            notes: frames.notes(),
            lidar,
            lidars,
        };
        sequence.notes.extend(image_notes);
        for (&number, file) in &frames.scans {
            for (sensor, lidar) in sequence.lidars.iter().enumerate() {
                let ego_from_sensor = lidar.ego_from_sensor();
                let world_from_sensor = |frame: usize| frames.poses.get(frame).map(|pose| *pose * ego_from_sensor);
                let Some(pose) = world_from_sensor(number) else {
                    continue;
                };
                let motion = frames.neighbour(number).and_then(|(other, secs)| {
                    let pose = world_from_sensor(other)?;
                    Some(PoseAt { pose, secs })
                });
                let secs = frames.time(number);
                sequence.entries.push(Entry {
                    file: file.clone(),
                    sweep: Placement { pose, secs, motion },
                });
                sequence.scans.push(ScanRef {
                    name: match sequence.lidars.len() {
                        1 => file.clone(),
                        _ => format!("{file} ({})", lidar.name()),
                    },
                    sensor,
                    time_ns: secs.map(|secs| ns_after(0, secs)),
                    pose: Some(pose),
                });
            }
        }
        if sequence.scans.is_empty() {
            return Err(Error::dataset(&sequence.lidar, "has no scan NN.pkl.gz with a pose"));
        }
        if let Some(path) = &options.poses {
            sequence.place(path)?;
        }
        Ok(sequence)
    }

    /// Puts the scans at the poses of a file, which are the first sensor's.
    fn place(&mut self, path: &Path) -> Result<()> {
        let first_of_each = (0..self.scans.len()).step_by(self.lidars.len());
        let files = first_of_each.clone().map(|i| ScanFile {
            path: self.lidar.join(&self.entries[i].file),
            name: self.entries[i].file.replace(".pkl.gz", ".pkl"),
        });
        let times_ns = first_of_each.map(|i| self.scans[i].time_ns).collect();
        let placed = poses::place(path, &poses::read(path)?, &files.collect::<Vec<_>>(), times_ns)?;
        let ego_from_first = self.sensors[0].body_from_sensor;
        for (i, scan) in self.scans.iter_mut().enumerate() {
            let (pose, time_ns) = placed[i / self.lidars.len()];
            // The others move rigidly with the first.
            scan.pose = Some(match scan.sensor {
                0 => pose,
                other => pose * (ego_from_first.inverse() * self.sensors[other].body_from_sensor),
            });
            scan.time_ns = time_ns;
        }
        // The vehicle's is another one now.
        self.trajectory = None;
        Ok(())
    }
}

/// The sensors of these names; without any, the Pandar64.
fn lidars(dir: &Path, names: &[String]) -> Result<Vec<Lidar>> {
    let mut lidars = Vec::new();
    for name in names {
        let lidar = Lidar::named(name)
            .ok_or_else(|| Error::dataset(dir, format!("has no sensor '{name}': it is pandar64 or pandargt")))?;
        if !lidars.contains(&lidar) {
            lidars.push(lidar);
        }
    }
    if lidars.is_empty() {
        lidars.push(Lidar::Pandar64);
    }
    Ok(lidars)
}

fn sensor(lidar: Lidar) -> Sensor {
    Sensor {
        model: lidar.model(),
        min_range_m: lidar.min_range_m(),
        body_from_sensor: lidar.ego_from_sensor(),
        ..Sensor::new(lidar.name())
    }
}

impl Source for PandaSet {
    fn format(&self) -> &str {
        "PandaSet"
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    /// Reads one scan. A return whose time is missing or outside of the sweep has no known origin: it is given as a point
    /// that is not finite, so that it is dropped and counted as such.
    fn read(&self, index: usize) -> Result<Scan> {
        let (Some(scan), Some(Entry { file, sweep })) = (self.scans.get(index), self.entries.get(index)) else {
            let reason = format!("has no scan {index}, only {}", self.scans.len());
            return Err(Error::dataset(&self.lidar, reason));
        };
        let file = &self.lidar.join(file);
        let pickle = pickle::load(file)?;
        let returns = DataFrame::new(&pickle).and_then(|table| Returns::new(&table, sweep));
        let measured = returns.and_then(|returns| returns.measured(self.lidars[scan.sensor], sweep));
        let mut measured = measured.map_err(|reason| Error::format(file, reason))?;
        if self.lidars.len() > 1 {
            // They come with their own scan.
            measured.dropped.other_sensor = 0;
        }
        // Other poses than the data set's move the whole sweep.
        let pose = scan.pose.unwrap_or(sweep.pose);
        let moved = |motion: &PoseAt| PoseAt {
            pose: pose * (sweep.pose.inverse() * motion.pose),
            ..*motion
        };
        Ok(Scan {
            name: scan.name.clone(),
            time_ns: scan.time_ns,
            pose: Some(pose),
            motion: measured.motion.iter().map(moved).collect(),
            ..measured
        })
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.trajectory.as_ref()
    }

    fn images(&self) -> &[ImageRef] {
        &self.images
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
