//! A folder with one file a scan: what all such formats share.
//!
//! Beside the scans' own folder may lie
//!
//! - `times.txt` or `timestamps.txt`: when each scan was taken, seconds or date and time, one line a scan,
//! - `rings/` with one `.u16` a scan: the laser of each point, little-endian `u16`,
//! - `times/` with one `.f32` a scan: seconds of each point after the scan's pose, little-endian `f32`,
//! - `motion.txt`: for each scan a line with a second pose of the sensor, so that the poses of single returns are known:
//!   the seconds from the scan's pose to that pose and its 12 numbers as in `poses.txt`, or `-` for none,
//! - `sensor.toml`: the sensor's model.
//!
//! Lines go to scans as poses do (see [`poses`]). Where returns have times but there is no `motion.txt`, the sensor moves
//! through the trajectory's pose at the time of the outermost return, if poses have times of their own (TUM); otherwise
//! through the pose of the next scan, or of the one before if the next is farther away than [`MAX_STEP_SECS`].

use std::path::{Path, PathBuf};

use tsdfuse::glam::Vec3;
use tsdfuse::scan::PoseAt;
use tsdfuse::trajectory::ns_after;
use tsdfuse::{Scan, SensorModel};

use crate::cloud::{self, Cloud};
use crate::dataset::{OpenOptions, ScanRef, Source};
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::poses::{self, Poses, Trajectory};
use crate::{bin, pcd, ply, times};

mod beside;

pub(crate) use beside::{PoseFile, parse_sensor, poses};
use beside::{motions, sensor};

/// The longest time between two scans over which the sensor is taken to move steadily, seconds.
pub const MAX_STEP_SECS: f64 = 1.0;

/// Scans of one file each.
pub(crate) struct ScanFolder {
    format: &'static str,
    scans: Vec<ScanRef>,
    entries: Vec<Entry>,
    trajectory: Option<Trajectory>,
    sensor: Option<SensorModel>,
    notes: Vec<String>,
}

/// The files of one scan, and how the sensor moves during it where `motion.txt` says so.
struct Entry {
    points: PathBuf,
    rings: Option<PathBuf>,
    times: Option<PathBuf>,
    motion: Vec<PoseAt>,
}

impl ScanFolder {
    /// Puts scans and poses together.
    pub(crate) fn new(
        format: &'static str,
        root: &Path,
        files: &[ScanFile],
        PoseFile { path, poses, note }: PoseFile,
        options: &OpenOptions,
    ) -> Result<Self> {
        let placed = poses::place(&path, &poses, files, times::of_scans(root, files)?)?;
        let scans: Vec<_> = files
            .iter()
            .zip(placed)
            .map(|(file, (pose, timestamp_secs))| ScanRef {
                name: file.name.clone(),
                timestamp_secs,
                pose,
            })
            .collect();
        for pair in scans.windows(2) {
            if let [a, b] = pair
                && let (Some(before), Some(secs)) = (a.timestamp_secs, b.timestamp_secs)
                && before >= secs
            {
                let reason = format!(
                    "{} at {secs:.6} s is not later than the scan before, {}",
                    b.name, a.name
                );
                return Err(Error::dataset(root, reason));
            }
        }
        let motions = motions(&root.join("motion.txt"), files)?;
        let mut folder = Self {
            format,
            scans,
            entries: files
                .iter()
                .zip(motions)
                .map(|(file, motion)| Entry::new(root, file, motion))
                .collect(),
            trajectory: match poses {
                Poses::Timed(trajectory) => Some(trajectory),
                Poses::Listed(_) => None,
            },
            sensor: sensor(root, options)?,
            notes: note.into_iter().collect(),
        };
        folder.note_gaps();
        Ok(folder)
    }

    /// The model for logs that come from one kind of sensor only.
    pub(crate) fn with_usual_sensor(mut self, name: &str) -> Self {
        self.sensor = self.sensor.or_else(|| tsdfuse::sensor::model(name));
        self
    }

    /// Adds a sentence for the user.
    pub(crate) fn note(&mut self, sentence: String) {
        self.notes.push(sentence);
    }

    fn note_gaps(&mut self) {
        let n = self.entries.len();
        let rings = self.entries.iter().filter(|e| e.rings.is_some()).count();
        let times = self.entries.iter().filter(|e| e.times.is_some()).count();
        for (kind, count) in [("rings", rings), ("times", times)] {
            if count > 0 && count < n {
                self.note(format!("only {count} of {n} scans have a file in {kind}/"));
            }
        }
        let still = (0..n)
            .filter(|&i| self.entries[i].times.is_some() && self.motion(i, &[]).is_empty())
            .count();
        if still > 0 {
            self.note(format!(
                "{still} scans have times of their points but no motion: there is no motion.txt, and no scan within {MAX_STEP_SECS} s"
            ));
        }
    }

    /// How the sensor moves while scan `index` measures points at `times`, see the [module](self).
    fn motion(&self, index: usize, times: &[f32]) -> Vec<PoseAt> {
        let given = &self.entries[index].motion;
        if !given.is_empty() {
            return given.clone();
        }
        let Some(now) = self.scans[index].timestamp_secs else {
            return Vec::new();
        };
        if let Some(trajectory) = &self.trajectory {
            let outermost = times
                .iter()
                .copied()
                .filter(|t| t.is_finite())
                .max_by(|a, b| a.abs().total_cmp(&b.abs()));
            let secs = f64::from(outermost.unwrap_or(0.0));
            if secs != 0.0
                && secs.abs() <= MAX_STEP_SECS
                && let Ok(pose) = trajectory.at(now + secs)
            {
                return vec![PoseAt { pose, secs }];
            }
        }
        let neighbours = [index.checked_add(1), index.checked_sub(1)];
        let motions = neighbours.into_iter().flatten().filter_map(|i| {
            let scan = self.scans.get(i)?;
            let secs = scan.timestamp_secs? - now;
            Some(PoseAt { pose: scan.pose, secs })
        });
        motions
            .into_iter()
            .find(|m| m.secs.abs() <= MAX_STEP_SECS)
            .into_iter()
            .collect()
    }
}

impl Entry {
    fn new(root: &Path, file: &ScanFile, motion: Vec<PoseAt>) -> Self {
        let beside = |folder: &str, extension: &str| {
            let path = root.join(folder).join(&file.name).with_extension(extension);
            path.is_file().then_some(path)
        };
        Self {
            points: file.path.clone(),
            rings: beside("rings", "u16"),
            times: beside("times", "f32"),
            motion,
        }
    }
}

impl Source for ScanFolder {
    fn format(&self) -> &'static str {
        self.format
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let (
            ScanRef {
                name,
                timestamp_secs,
                pose,
            },
            entry,
        ) = (&self.scans[index], &self.entries[index]);
        let Cloud {
            mut points,
            mut rings,
            secs,
            intensities,
            ..
        } = read_cloud(&entry.points)?;
        if let Some(path) = &entry.rings {
            rings = Some(bin::column(
                path,
                &files::read(path)?,
                points.len(),
                u16::from_le_bytes,
            )?);
        }
        let times = match (&entry.times, secs) {
            (Some(path), _) => Some(cloud::checked_offsets(
                path,
                bin::column(path, &files::read(path)?, points.len(), f32::from_le_bytes)?,
            )?),
            (None, Some(secs)) => Some(cloud::offsets(&entry.points, &secs, *timestamp_secs)?),
            (None, None) => None,
        };
        // A return without a time cannot be placed.
        for (point, _) in points
            .iter_mut()
            .zip(times.iter().flatten())
            .filter(|(_, t)| t.is_nan())
        {
            *point = Vec3::NAN;
        }
        Ok(Scan {
            name: name.clone(),
            time_ns: timestamp_secs.map(|secs| ns_after(0, secs)),
            motion: times.as_ref().map_or(Vec::new(), |times| self.motion(index, times)),
            points,
            rings,
            times,
            intensities,
            pose: Some(*pose),
            ..Default::default()
        })
    }

    fn sensor(&self) -> Option<SensorModel> {
        self.sensor.clone()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// Reads a file of points; its extension says how.
pub(crate) fn read_cloud(path: &Path) -> Result<Cloud> {
    let bytes = files::read(path)?;
    match path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase()
        .as_str()
    {
        "bin" => bin::parse(path, &bytes),
        "pcd" => pcd::parse(path, &bytes),
        "ply" => ply::parse_cloud(path, &bytes),
        other => Err(Error::format(path, format!("is no file of points: .{other}"))),
    }
}
