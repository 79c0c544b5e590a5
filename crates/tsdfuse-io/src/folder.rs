//! A folder with one file a scan: what all such formats share.
//!
//! Beside the scans' own folder may lie
//!
//! - `times.txt` or `timestamps.txt`: when each scan was taken, seconds or date and time, one line a scan,
//! - `rings/` with one `.u16` a scan: the laser of each point, little-endian `u16`,
//! - `times/` with one `.f32` a scan: seconds of each point after the scan's pose, little-endian `f32`,
//! - `motion.txt`: for each scan a line with further poses of the sensor, so that the poses of single returns are known:
//!   the seconds from the scan's pose to such a pose and its 12 numbers as in `poses.txt`, once or several times, or `-` for none,
//! - `sensor.toml` ([`crate::sensor_file`]): the sensor's model, its errors, and where it sits on a body (vehicle, robot); then
//!   `poses.txt` and `motion.txt` are `world_from_body`,
//! - `imu.csv`: what an inertial measurement unit measured, in the sensor frame: after the header `t,gx,gy,gz,ax,ay,az`, seconds
//!   on the clock of `times.txt`, rad/s and m/s²,
//! - `gnss.csv`: where a GNSS receiver was: after the header `t,latitude,longitude,altitude,sigma_east,sigma_north,sigma_up`, seconds on the
//!   same clock, degrees, metres above the ellipsoid (WGS 84), and standard deviations in metres. The antenna is taken to be at the origin of the
//!   body.
//!
//! Lines go to scans as poses do (see [`poses`]). Where returns have times but there is no `motion.txt`, the sensor moves
//! along the trajectory, if poses have times of their own (TUM) and these have no gap within the sweep: through all poses
//! within it. Otherwise it moves through the pose of the next scan, or of the one before if the next is farther away than
//! [`MAX_STEP_SECS`].

use std::path::{Path, PathBuf};

use tsdfuse::glam::Vec3;
use tsdfuse::scan::PoseAt;
use tsdfuse::sensor::SensorCorrection;
use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Scan, Trajectory};

use crate::cloud::{self, Cloud};
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::poses::{self, Poses};
use crate::source::{GnssFix, ImageRef, ImuSample, OpenOptions, ScanRef, Sensor, Source};
use crate::{bin, las, pcd, placed, ply, present, times};

mod beside;
mod gnss;
mod imu;
mod samples;

pub(crate) use beside::{PoseFile, parse_motions, poses};
use beside::{motions, of_model, sensor};
pub(crate) use gnss::parse as parse_gnss;
pub(crate) use imu::parse as parse_imu;

pub use crate::placed::MAX_STEP_SECS;

/// What reads a file of points.
type Reader = fn(&Path, &[u8]) -> Result<Cloud>;

/// Scans of one file each, of one sensor.
pub(crate) struct ScanFolder {
    format: &'static str,
    scans: Vec<ScanRef>,
    entries: Vec<Entry>,
    reader: Reader,
    /// `world_from_body`.
    trajectory: Option<Trajectory>,
    imu: Samples<ImuSample>,
    gnss: Samples<GnssFix>,
    images: Vec<ImageRef>,
    sensors: [Sensor; 1],
    /// Whether `sensor.toml` says how far elevations are off.
    tells_errors: bool,
    notes: Vec<String>,
}

/// What other sensors measured.
enum Samples<T> {
    /// In the body frame.
    Known(Vec<T>),
    /// In a file that is read when asked for.
    InFile(PathBuf),
}

impl<T> Samples<T> {
    /// Those of a file, if it is there.
    fn of(path: PathBuf) -> Result<Self> {
        Ok(if present::file(&path)? {
            Self::InFile(path)
        } else {
            Self::Known(Vec::new())
        })
    }
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
        pose_file: Option<PoseFile>,
        options: &OpenOptions,
    ) -> Result<Self> {
        let (sensor, tells_errors) = sensor(root, options)?;
        // The identity changes no pose; not multiplying keeps its bits, too.
        let on_body = Some(sensor.body_from_sensor).filter(|pose| *pose != Pose::IDENTITY);
        let of_sensor = |body: Pose| on_body.map_or(body, |body_from_sensor| body * body_from_sensor);
        let times_ns = times::of_scans(root, files)?;
        let (mut trajectory, mut notes) = (None, Vec::new());
        let placed: Vec<(Option<Pose>, Option<i64>)> = match pose_file {
            Some(PoseFile { path, poses, note }) => {
                let placed = poses::place(&path, &poses, files, times_ns)?;
                notes.extend(note);
                if let Poses::Timed(timed) = poses {
                    trajectory = Some(timed);
                }
                placed
                    .into_iter()
                    .map(|(pose, time_ns)| (Some(of_sensor(pose)), time_ns))
                    .collect()
            }
            None => {
                notes.push("there is no poses.txt or other pose file: the scans' poses are not known".to_owned());
                let times_ns = times_ns.into_iter().flatten().map(Some).chain(std::iter::repeat(None));
                times_ns.take(files.len()).map(|time_ns| (None, time_ns)).collect()
            }
        };
        let scans = files.iter().zip(placed).map(|(file, (pose, time_ns))| ScanRef {
            name: file.name.clone(),
            sensor: 0,
            time_ns,
            pose,
        });
        let scans: Vec<_> = scans.collect();
        in_order(root, &scans)?;
        let sides = [("rings", "u16"), ("times", "f32")];
        let [rings, times] = sides.map(|(name, _)| present::folder(&root.join(name)));
        let beside = |file: &ScanFile, (name, extension): (&str, &str), there: bool| {
            let path = root.join(name).join(&file.name).with_extension(extension);
            Ok((there && present::file(&path)?).then_some(path))
        };
        let (rings, times) = (rings?, times?);
        let entries = files
            .iter()
            .zip(motions(&root.join("motion.txt"), files)?)
            .map(|(file, motion)| {
                let of_sensor = |at: PoseAt| PoseAt {
                    pose: of_sensor(at.pose),
                    ..at
                };
                Ok(Entry {
                    points: file.path.clone(),
                    rings: beside(file, sides[0], rings)?,
                    times: beside(file, sides[1], times)?,
                    motion: motion.into_iter().map(of_sensor).collect(),
                })
            });
        let mut folder = Self {
            format,
            entries: entries.collect::<Result<_>>()?,
            reader: parse_cloud,
            scans,
            trajectory,
            imu: Samples::of(root.join(imu::NAME))?,
            gnss: Samples::of(root.join(gnss::NAME))?,
            images: Vec::new(),
            sensors: [sensor],
            tells_errors,
            notes,
        };
        folder.note_gaps();
        Ok(folder)
    }

    /// The model for logs that come from one kind of sensor only, and by how much these sensors' elevations are known to be off, unless
    /// `sensor.toml` tells the sensor's errors.
    pub(crate) fn with_usual_sensor(mut self, name: &str, elevation_correction_deg: f64) -> Self {
        let [sensor] = &mut self.sensors;
        if sensor.model.is_none() {
            *sensor = Sensor {
                body_from_sensor: sensor.body_from_sensor,
                correction: std::mem::take(&mut sensor.correction),
                ..of_model(tsdfuse::sensor::model(name))
            };
        }
        if !self.tells_errors && sensor.name == name {
            sensor.correction = SensorCorrection::of_elevation(elevation_correction_deg);
        }
        self
    }

    /// What else the log knows: the body's trajectory and where the sensor sits on the body, IMU samples and GNSS fixes.
    pub(crate) fn with_body(
        mut self,
        trajectory: Option<Trajectory>,
        body_from_sensor: Pose,
        imu: Vec<ImuSample>,
        gnss: Vec<GnssFix>,
    ) -> Self {
        let [sensor] = &mut self.sensors;
        (self.trajectory, sensor.body_from_sensor) = (trajectory, body_from_sensor);
        (self.imu, self.gnss) = (Samples::Known(imu), Samples::Known(gnss));
        self
    }

    /// What cameras saw meanwhile.
    pub(crate) fn with_images(mut self, images: Vec<ImageRef>) -> Self {
        self.images = images;
        self
    }

    /// Adds a sentence for the user.
    pub(crate) fn note(&mut self, sentence: String) {
        self.notes.push(sentence);
    }

    /// Scans whose files are read by a function of the format.
    pub(crate) fn with_reader(mut self, reader: Reader) -> Self {
        self.reader = reader;
        self
    }

    /// The name of the sensor.
    pub(crate) fn called(mut self, name: &str) -> Self {
        let [sensor] = &mut self.sensors;
        name.clone_into(&mut sensor.name);
        self
    }

    /// Tells how many scans were left out by [`covered`].
    pub(crate) fn without(mut self, scans: usize) -> Self {
        if scans > 0 {
            self.note(format!("{scans} scans at times without a pose are left out"));
        }
        self
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
            .filter(|&i| {
                self.scans[i].pose.is_some() && self.entries[i].times.is_some() && self.motion(i, &[]).is_empty()
            })
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
        let [sensor] = &self.sensors;
        placed::motion(
            &self.scans,
            index,
            times,
            self.trajectory.as_ref(),
            &sensor.body_from_sensor,
        )
    }
}

/// The scans at whose times there is a pose, and how many others there are. Data sets have truth for a part of their scans.
pub(crate) fn covered(
    root: &Path,
    mut scans: Vec<ScanFile>,
    poses: Option<&PoseFile>,
) -> Result<(Vec<ScanFile>, usize)> {
    let all = scans.len();
    if let Some(PoseFile {
        poses: Poses::Timed(trajectory),
        path,
        ..
    }) = poses
        && let Some(times_ns) = times::of_scans(root, &scans)?
    {
        let mut times_ns = times_ns.into_iter();
        scans.retain(|_| {
            times_ns
                .next()
                .is_some_and(|time_ns| poses::at(trajectory, time_ns).is_ok())
        });
        if scans.is_empty() {
            return Err(Error::dataset(path, "has no pose at the time of any scan"));
        }
    }
    let left_out = all - scans.len();
    Ok((scans, left_out))
}

/// Checks that times ascend.
fn in_order(root: &Path, scans: &[ScanRef]) -> Result<()> {
    for pair in scans.windows(2) {
        if let [a, b] = pair
            && let (Some(before), Some(time_ns)) = (a.time_ns, b.time_ns)
            && before >= time_ns
        {
            let secs = secs_between(0, time_ns);
            let reason = format!(
                "{} at {secs:.6} s is not later than the scan before, {}",
                b.name, a.name
            );
            return Err(Error::dataset(root, reason));
        }
    }
    Ok(())
}

impl Source for ScanFolder {
    fn format(&self) -> &str {
        self.format
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let (scan, entry) = (&self.scans[index], &self.entries[index]);
        let Cloud {
            mut points,
            mut rings,
            secs,
            intensities,
            ..
        } = (self.reader)(&entry.points, &files::read(&entry.points)?)?;
        if let Some(path) = &entry.rings {
            let column = bin::column(path, &files::read(path)?, points.len(), u16::from_le_bytes);
            rings = Some(column?);
        }
        let times = match (&entry.times, secs) {
            (Some(path), _) => {
                let column = bin::column(path, &files::read(path)?, points.len(), f32::from_le_bytes);
                Some(cloud::checked_offsets(path, column?)?)
            }
            (None, Some(secs)) => {
                let scan_secs = scan.time_ns.map(|time_ns| secs_between(0, time_ns));
                Some(cloud::offsets(&entry.points, &secs, scan_secs)?)
            }
            (None, None) => None,
        };
        // A return without a time cannot be placed.
        let timed = points.iter_mut().zip(times.iter().flatten());
        timed
            .filter(|(_, t)| t.is_nan())
            .for_each(|(point, _)| *point = Vec3::NAN);
        Ok(Scan {
            name: scan.name.clone(),
            time_ns: scan.time_ns,
            motion: times.as_ref().map_or(Vec::new(), |times| self.motion(index, times)),
            points,
            rings,
            times,
            intensities,
            pose: scan.pose,
            ..Default::default()
        })
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.trajectory.as_ref()
    }

    fn imu(&self) -> Result<Vec<ImuSample>> {
        let [sensor] = &self.sensors;
        match &self.imu {
            Samples::Known(samples) => Ok(samples.clone()),
            Samples::InFile(path) => imu::read(path, &sensor.body_from_sensor),
        }
    }

    fn gnss(&self) -> Result<Vec<GnssFix>> {
        match &self.gnss {
            Samples::Known(fixes) => Ok(fixes.clone()),
            Samples::InFile(path) => gnss::parse(path, &files::read(path)?),
        }
    }

    fn images(&self) -> &[ImageRef] {
        &self.images
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// Parses a file of points; its extension says how.
fn parse_cloud(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    match path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase()
        .as_str()
    {
        "bin" => bin::parse(path, bytes),
        "pcd" => pcd::parse(path, bytes),
        "ply" => ply::parse_cloud(path, bytes),
        "las" | "laz" => las::parse(path, bytes),
        other => Err(Error::format(path, format!("is no file of points: .{other}"))),
    }
}
