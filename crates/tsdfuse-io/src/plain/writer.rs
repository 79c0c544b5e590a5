//! Writing the plain folder.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use tsdfuse::{Pose, Scan, SensorModel};

use crate::error::{Error, Result};
use crate::source::ImuSample;
use crate::text;

/// How the scans of a folder lie in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// `velodyne/*.bin`, `rings/`, `times/` and `motion.txt`.
    #[default]
    Plain,
    /// `*.pcd` with rings and times, and `motion.txt`.
    Pcd,
    /// As KITTI odometry: `velodyne/*.bin` and poses. Rings, times and motion are left out, so scans should be undistorted.
    Kitti,
}

/// Writes scans as a folder, one after another; see the [module](super) for the files.
///
/// Points, rings, times and intensities come back bit for bit, poses up to rounding (1e-15). A scan without intensities
/// gets zeros.
#[derive(Debug)]
pub struct Writer {
    folder: PathBuf,
    layout: Layout,
    scans: usize,
    /// `poses.txt`; `None` if the scans have no poses.
    poses: Option<BufWriter<File>>,
    /// `times.txt`; `None` if the scans have no times.
    secs: Option<BufWriter<File>>,
    motion: String,
    any_motion: bool,
}

impl Writer {
    /// Begins a data set in `folder`, which is made if it does not exist and must hold none yet.
    ///
    /// # Errors
    /// Names the folder and what the system, or the folder's content, has against it.
    pub fn create(folder: impl AsRef<Path>) -> Result<Self> {
        Self::create_as(folder, Layout::Plain)
    }

    /// As [`Self::create`], in another layout.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn create_as(folder: impl AsRef<Path>, layout: Layout) -> Result<Self> {
        let folder = folder.as_ref();
        // What is left of another data set would be read as part of this one.
        const OURS: [&str; 9] = [
            "velodyne",
            "rings",
            "times",
            "poses.txt",
            "times.txt",
            "motion.txt",
            "sensor.toml",
            "imu.csv",
            "calib.txt",
        ];
        if let Some(old) = OURS.iter().map(|name| folder.join(name)).find(|path| path.exists()) {
            return Err(Error::dataset(
                old,
                "exists already; scans are written into a new folder",
            ));
        }
        let scans = if layout == Layout::Pcd {
            folder.to_owned()
        } else {
            folder.join("velodyne")
        };
        fs::create_dir_all(&scans).map_err(Error::io(&scans))?;
        if layout == Layout::Pcd && !crate::files::list(folder, "pcd")?.is_empty() {
            return Err(Error::dataset(
                folder,
                "holds PCD files already; scans are written into a new folder",
            ));
        }
        if layout == Layout::Kitti {
            let path = folder.join("calib.txt");
            // The poses are the scanner's own.
            fs::write(&path, "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n").map_err(Error::io(&path))?;
            // What is read of a log is corrected already.
            let path = folder.join("sensor.toml");
            fs::write(&path, "elevation_correction_deg = 0.0\n").map_err(Error::io(&path))?;
        }
        Ok(Self {
            folder: folder.to_owned(),
            layout,
            scans: 0,
            poses: None,
            secs: None,
            motion: String::new(),
            any_motion: false,
        })
    }

    /// Writes the sensor's model.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn write_sensor(&mut self, sensor: &SensorModel) -> Result<()> {
        let path = self.folder.join("sensor.toml");
        let text = toml::to_string(sensor).map_err(|e| Error::format(&path, e.to_string()))?;
        fs::write(&path, text).map_err(Error::io(&path))
    }

    /// Writes what an inertial measurement unit measured, in the sensor's frame and in order of time; of two samples at one time, the
    /// first.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn write_imu(&mut self, samples: &[ImuSample]) -> Result<()> {
        let mut text = "t,gx,gy,gz,ax,ay,az\n".to_owned();
        let mut last = i64::MIN;
        for sample in samples {
            if sample.time_ns <= last {
                continue;
            }
            last = sample.time_ns;
            let (g, a) = (sample.angular_velocity, sample.acceleration);
            let time = text::seconds(sample.time_ns);
            text += &format!("{time},{},{},{},{},{},{}\n", g.x, g.y, g.z, a.x, a.y, a.z);
        }
        let path = self.folder.join("imu.csv");
        fs::write(&path, text).map_err(Error::io(&path))
    }

    /// Writes the next scan. Either all scans have a time or none, and the same holds for poses.
    ///
    /// # Errors
    /// Names the file and what the system says, or the scan and what is wrong with it.
    pub fn write_scan(&mut self, scan: &Scan) -> Result<()> {
        scan.check().map_err(|e| Error::dataset(&self.folder, e.to_string()))?;
        if self.layout == Layout::Pcd {
            let path = self.folder.join(format!("{:06}.pcd", self.scans));
            crate::pcd::write(&path, scan)?;
        } else {
            self.columns(scan)?;
        }
        self.write_time(scan)?;
        self.write_pose(scan)?;
        let motion = scan.motion.iter().map(|m| format!("{} {}", m.secs, numbers(&m.pose)));
        let motion = motion.collect::<Vec<_>>().join(" ");
        self.motion += if motion.is_empty() { "-" } else { &motion };
        self.motion += "\n";
        self.any_motion |= !scan.motion.is_empty() && self.layout != Layout::Kitti;
        self.scans += 1;
        Ok(())
    }

    fn columns(&self, scan: &Scan) -> Result<()> {
        let intensities = scan.intensities.iter().flatten().copied().chain(std::iter::repeat(0.0));
        let points = scan.points.iter().zip(intensities);
        self.column(
            "velodyne",
            "bin",
            points.flat_map(|(p, i)| [p.x, p.y, p.z, i].map(f32::to_le_bytes)),
        )?;
        if self.layout == Layout::Kitti {
            return Ok(());
        }
        if let Some(rings) = &scan.rings {
            self.column("rings", "u16", rings.iter().map(|r| r.to_le_bytes()))?;
        }
        if let Some(times) = &scan.times {
            self.column("times", "f32", times.iter().map(|t| t.to_le_bytes()))?;
        }
        Ok(())
    }

    /// Finishes the data set. Without this call the last poses may be missing.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn finish(mut self) -> Result<()> {
        if let Some(poses) = &mut self.poses {
            poses.flush().map_err(Error::io(self.folder.join("poses.txt")))?;
        }
        if let Some(secs) = &mut self.secs {
            secs.flush().map_err(Error::io(self.folder.join("times.txt")))?;
        }
        let path = self.folder.join("motion.txt");
        if self.any_motion {
            fs::write(&path, self.motion).map_err(Error::io(&path))?;
        }
        Ok(())
    }

    fn column<const N: usize>(&self, kind: &str, extension: &str, values: impl Iterator<Item = [u8; N]>) -> Result<()> {
        let folder = self.folder.join(kind);
        fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
        let path = folder.join(format!("{:06}.{extension}", self.scans));
        let bytes: Vec<u8> = values.flatten().collect();
        fs::write(&path, bytes).map_err(Error::io(&path))
    }

    fn write_pose(&mut self, scan: &Scan) -> Result<()> {
        let path = self.folder.join("poses.txt");
        if self.scans == 0 && scan.pose.is_some() {
            self.poses = Some(create(&path)?);
        }
        match (&mut self.poses, scan.pose) {
            (None, None) => Ok(()),
            (Some(file), Some(pose)) => writeln!(file, "{}", numbers(&pose)).map_err(Error::io(path)),
            _ => {
                let reason = format!("either all scans have a pose or none, but not {}", scan.name);
                Err(Error::dataset(&self.folder, reason))
            }
        }
    }

    fn write_time(&mut self, scan: &Scan) -> Result<()> {
        let path = self.folder.join("times.txt");
        match (scan.time_ns, &mut self.secs) {
            (None, None) => return Ok(()),
            (Some(_), None) if self.scans == 0 => self.secs = Some(create(&path)?),
            (Some(_), Some(_)) => {}
            (None, Some(_)) | (Some(_), None) => {
                let reason = format!("either all scans have a time or none, but not {}", scan.name);
                return Err(Error::dataset(&self.folder, reason));
            }
        }
        match (&mut self.secs, scan.time_ns) {
            (Some(file), Some(ns)) => writeln!(file, "{}", text::seconds(ns)).map_err(Error::io(path)),
            _ => Ok(()),
        }
    }
}

fn create(path: &Path) -> Result<BufWriter<File>> {
    File::create(path).map(BufWriter::new).map_err(Error::io(path))
}

/// The 12 numbers of a pose, each with as many digits as it takes to read the same number.
fn numbers(pose: &Pose) -> String {
    pose.to_row_major_3x4().map(|v| v.to_string()).join(" ")
}
