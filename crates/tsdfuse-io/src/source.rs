//! What a log is made of, whatever its files look like: sensors, scans, poses, IMU samples, images.
//!
//! A format implements [`Source`] if its scans can be read in any order and any number of times, and [`Stream`] if they come
//! once, one after the other. [`Log`](crate::Log) is what users of either see.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use serde::{Deserialize, Serialize};
pub use tsdfuse::ImuSample;
use tsdfuse::glam::DVec3;
use tsdfuse::sensor::{Pinhole, SensorCorrection};
use tsdfuse::{Pose, Scan, SensorModel, Trajectory};

use crate::error::{Error, Result};
use crate::geodesy::Geographic;

/// How to open a log; the default asks for nothing in particular.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct OpenOptions {
    /// Poses to use instead of those in the log: a file (TUM, KITTI, a table with a header, g2o), or in recordings of messages the topic or the frame
    /// whose poses are used.
    pub poses: Option<PathBuf>,
    /// Which sensors of the log to read, by name; empty: the format's default, usually all or the main one. Where a log has one
    /// sensor that it does not name, this is the name of the sensor's model.
    pub sensors: Vec<String>,
    /// `body_from_sensor` of the only sensor: the poses are those of a body (vehicle, robot) that carries it. Replaces what the
    /// log says. Not used for poses that [`write_of_sensor`](crate::poses::write_of_sensor) wrote.
    pub extrinsics: Option<Pose>,
    /// The calibration of the sensor whose packets are read (Velodyne's XML or YAML, Hesai's CSV, Ouster's metadata); without it,
    /// one is looked for beside the recording.
    pub calibration: Option<PathBuf>,
    /// Whether a recording is still being written: its scans are then read once, as they come.
    pub follow: bool,
    /// Of a large recording of messages, read only the index and some parts: enough to describe it, not to fuse it, as stamps and poses
    /// are then estimates.
    pub glance: bool,
    /// A file that describes the sensor, as the `sensor.toml` of a plain folder does (see [`crate::folder`]): it replaces what the log says of
    /// the sensor's errors and of where it sits.
    pub sensor_file: Option<PathBuf>,
}

/// A sensor of a log.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    /// Unique within the log: a topic, a folder, or a model's name.
    pub name: String,
    /// The beams of a rotating LiDAR, where the log states them.
    pub model: Option<SensorModel>,
    /// The camera, where the scans are depth images; then there is no `model`.
    pub camera: Option<Pinhole>,
    /// Returns nearer than this, metres, are the vehicle that carries the sensor, where that was measured, or nearer than
    /// such sensors measure.
    pub min_range_m: Option<f32>,
    /// Where the sensor sits on the body whose poses the log's trajectory has; the identity if those are the sensor's own.
    pub body_from_sensor: Pose,
    /// The sensor's known errors, which are corrected in what [`Source::read`] and [`Stream::next`] return.
    pub correction: SensorCorrection,
    /// Its scans have the poses of this many seconds later than their own times, where it was told that the clock of the poses differs.
    pub time_offset_s: Option<f64>,
}

impl Sensor {
    /// A sensor of which nothing is known but its name.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            model: None,
            camera: None,
            min_range_m: None,
            body_from_sensor: Pose::IDENTITY,
            correction: SensorCorrection::default(),
            time_offset_s: None,
        }
    }
}

/// One scan of a log, before it is read.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanRef {
    /// What messages call it: the file's name, usually.
    pub name: String,
    /// The sensor that measured it: an index into the log's sensors.
    pub sensor: usize,
    /// Nanoseconds since the log's epoch (1970 where the log gives absolute time).
    pub time_ns: Option<i64>,
    /// `world_from_sensor`, where it is known.
    pub pose: Option<Pose>,
}

/// An image of a camera in the log. It is not decoded here: [`Source::read_image`] gives the encoded bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageRef {
    /// What messages call it: camera and file.
    pub name: String,
    /// Nanoseconds since the log's epoch.
    pub time_ns: Option<i64>,
    /// The camera's intrinsics.
    pub camera: Pinhole,
    /// OpenCV's k1, k2, p1, p2, k3, where the image is distorted and that is known.
    pub distortion: Option<[f64; 5]>,
    /// `world_from_camera`, of the optical frame: x right, y down, z forward.
    pub pose: Option<Pose>,
    /// The file, where the image is one.
    pub path: Option<PathBuf>,
}

/// Where a GNSS receiver was (WGS 84).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct GnssFix {
    /// Nanoseconds since the log's epoch.
    pub time_ns: i64,
    /// Latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, metres, where the receiver tells it.
    pub altitude_m: Option<f64>,
    /// Standard deviations east, north and up, metres, where the receiver tells them.
    pub sigma_m: Option<[f64; 3]>,
    /// What was there (the antenna), in the log's body frame, metres; the body's origin where the log does not tell.
    pub antenna_m: [f64; 3],
}

impl GnssFix {
    /// Metres east, north and up of another fix; as if they were at one height, unless both heights are known.
    pub fn seen_from(&self, origin: &Self) -> DVec3 {
        let known = self.altitude_m.is_some() && origin.altitude_m.is_some();
        let place = |fix: &Self| Geographic {
            latitude_deg: fix.latitude_deg,
            longitude_deg: fix.longitude_deg,
            height_m: fix.altitude_m.filter(|_| known).unwrap_or(0.0),
        };
        place(self).seen_from(&place(origin)).translation
    }
}

/// Messages under one name in a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Topic {
    /// What the recording calls it.
    pub name: String,
    /// The type of its messages, `sensor_msgs/PointCloud2`.
    pub kind: String,
    /// How many there are.
    pub messages: usize,
    /// The rate of most steps.
    pub rate_hz: Option<f64>,
    /// The longest time from one message to the next.
    pub longest_gap_secs: Option<f64>,
    /// From the first message to the last.
    pub span_secs: Option<f64>,
    /// How much later messages were recorded than they are stamped; far from zero if clocks differ.
    pub delay_secs: Option<f64>,
    /// Whether its points are read.
    pub is_read: bool,
}

/// What a recording of messages holds, and what was concluded from it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Recorded {
    /// All topics.
    pub topics: Vec<Topic>,
    /// Of what, and what was concluded: what fields and times mean, which poses are used, and why.
    pub conclusions: Vec<(String, String)>,
}

/// A log whose scans can be read in any order, any number of times.
pub trait Source: Send + Sync {
    /// The format's name for people: `PandaSet`, `KITTI odometry`, …
    fn format(&self) -> &str;

    /// The sensors whose scans are read.
    fn sensors(&self) -> &[Sensor];

    /// The scans, in order of time where times are known.
    fn scans(&self) -> &[ScanRef];

    /// Reads scan `index` of [`Source::scans`]. Invalid returns are still in it, as measured.
    ///
    /// # Errors
    /// Names the file and the reason.
    fn read(&self, index: usize) -> Result<Scan>;

    /// `world_from_body` over time, where the log has such poses.
    fn trajectory(&self) -> Option<&Trajectory> {
        None
    }

    /// All samples of the inertial measurement unit in the log's body frame, in order of time; empty where there is none.
    ///
    /// # Errors
    /// Names the file and the reason.
    fn imu(&self) -> Result<Vec<ImuSample>> {
        Ok(Vec::new())
    }

    /// The places of a GNSS receiver, in order of time; empty where there is none.
    ///
    /// # Errors
    /// Names the file and the reason.
    fn gnss(&self) -> Result<Vec<GnssFix>> {
        Ok(Vec::new())
    }

    /// What a recording of messages holds; `None` for other logs.
    fn recorded(&self) -> Option<&Recorded> {
        None
    }

    /// The images of all cameras, ordered by camera and time.
    fn images(&self) -> &[ImageRef] {
        &[]
    }

    /// The encoded bytes (JPEG, PNG, …) of image `index` of [`Source::images`].
    ///
    /// # Errors
    /// Names the file and the reason; also for an `index` beyond the last image.
    fn read_image(&self, index: usize) -> Result<Vec<u8>> {
        let images = self.images();
        let image = images.get(index).ok_or_else(|| {
            let reason = format!("no image {index}: there are {} images", images.len());
            Error::dataset(self.format(), reason)
        })?;
        let path = image.path.as_ref();
        let path = path.ok_or_else(|| Error::dataset(&image.name, "is no file of its own"))?;
        std::fs::read(path).map_err(Error::io(path))
    }

    /// What is missing or odd, one sentence each: frames without a scan, scans without a pose, …
    fn notes(&self) -> &[String] {
        &[]
    }
}

/// A log that has no length and is read once, from its begin: a pipe, a network port, a recording that still grows.
pub trait Stream: Send {
    /// The format's name for people.
    fn format(&self) -> &str;

    /// The sensors whose scans come.
    fn sensors(&self) -> &[Sensor];

    /// The next scan; waits for it. `None` at the end.
    fn next(&mut self) -> Option<StreamedScan>;

    /// Samples of the inertial measurement unit in the log's body frame that came since this was last asked, in order of time: those of the scan that was
    /// handed out last among them. Those that nobody asks for are forgotten in the end.
    fn imu(&mut self) -> Vec<ImuSample> {
        Vec::new()
    }

    /// What is missing or odd, one sentence each.
    fn notes(&self) -> &[String] {
        &[]
    }

    /// Whether its scans have poses.
    fn is_placed(&self) -> bool {
        true
    }

    /// What comes up while it is read, such as data that were lost: asked for again and again.
    fn news(&self) -> News {
        News::default()
    }

    /// What keeps the stream, if it can be kept.
    fn kept(&self) -> Option<Arc<dyn Kept>> {
        None
    }
}

/// What keeps a [`Stream`], so that it can be read again.
pub trait Kept: Send + Sync {
    /// From now on, what comes is kept: in this folder, until it is forgotten, unless it is a recording already.
    ///
    /// # Errors
    /// Names the folder and the reason.
    fn keep(&self, folder: &Path) -> Result<()>;

    /// The recording of what came by now. Of what comes later, nothing needs to be kept.
    ///
    /// # Errors
    /// If it was not kept, or could not be.
    fn recording(&self) -> Result<PathBuf>;

    /// Nobody needs it any more, though who waits for the stream may hold it still: what is temporary goes.
    fn forget(&self);
}

/// What a [`Stream`] has to tell by now, one sentence each.
pub type News = Arc<Mutex<Vec<String>>>;

/// A scan of a [`Stream`].
#[derive(Debug)]
pub struct StreamedScan {
    /// The sensor that measured it: an index into [`Stream::sensors`].
    pub sensor: usize,
    /// The scan, or why it cannot be used; the stream goes on after it.
    pub scan: Result<Scan>,
}

/// Reads a scan and checks that it does not contradict itself.
///
/// # Errors
/// As [`Source::read`]; also for an `index` beyond the last scan.
pub(crate) fn read_checked(source: &dyn Source, index: usize) -> Result<Scan> {
    let scans = source.scans();
    let reference = scans.get(index).ok_or_else(|| {
        let reason = format!("no scan {index}: there are {} scans", scans.len());
        Error::dataset(source.format(), reason)
    })?;
    checked(
        source.read(index)?,
        &reference.name,
        source.sensors().get(reference.sensor),
    )
}

/// The scan, if its columns fit together, with its sensor's known errors corrected.
pub(crate) fn checked(mut scan: Scan, name: &str, sensor: Option<&Sensor>) -> Result<Scan> {
    scan.check().map_err(|e| Error::dataset(name, e.to_string()))?;
    if let Some(sensor) = sensor {
        sensor.correction.apply(&mut scan);
    }
    Ok(scan)
}
