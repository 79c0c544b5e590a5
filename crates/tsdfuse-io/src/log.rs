//! A log: the scans of one or several sensors, and what was recorded with them, whatever the files look like.

use std::path::Path;
use std::sync::{Arc, PoisonError};

use tsdfuse::sensor::SensorCorrection;
use tsdfuse::{Pose, Scan, SensorModel, Trajectory};

use crate::corrected::{self, Corrected};
use crate::error::{Error, Result};
use crate::pandaset::PandaSet;
use crate::poses;
use crate::read_ahead::{Live, ReadAhead, Scans};
use crate::selection::Selection;
use crate::sensor_file;
use crate::source::{
    GnssFix, ImageRef, ImuSample, OpenOptions, Recorded, ScanRef, Sensor, Source, Stream, read_checked,
};
use crate::suggested::Suggested;
use crate::together::Together;

/// A format: how it is recognised, and how a log of it is opened.
struct Format {
    recognises: fn(&Path) -> bool,
    open: fn(&Path, &OpenOptions) -> Result<Log>,
}

/// All formats, the more particular ones first. A new format is one file and one entry here.
const FORMATS: &[Format] = &[
    Format {
        recognises: PandaSet::recognises,
        open: |path, options| PandaSet::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::nuscenes::recognises,
        open: |path, options| crate::nuscenes::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::argoverse::recognises,
        open: |path, options| crate::argoverse::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::kitti360::recognises,
        open: |path, options| crate::kitti360::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::helipr::recognises,
        open: |path, options| crate::helipr::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::mulran::recognises,
        open: |path, options| crate::mulran::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::nclt::recognises,
        open: |path, options| crate::nclt::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::newer_college::recognises,
        open: |path, options| crate::newer_college::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::kitti_raw::recognises,
        open: |path, options| crate::kitti_raw::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::kitti::recognises,
        open: |path, options| crate::kitti::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::plain::recognises,
        open: |path, options| crate::plain::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::osf::recognises,
        open: |path, options| crate::osf::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::ros::recognises,
        open: |path, options| crate::ros::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::rgbd::recognises,
        open: |path, options| crate::rgbd::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::las::recognises,
        open: |path, options| crate::las::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::e57::recognises,
        open: |path, options| crate::e57::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::clouds::recognises,
        open: |path, options| crate::clouds::open(path, options).map(Log::new),
    },
    Format {
        recognises: crate::capture::recognises,
        open: |path, options| crate::capture::open(path, options).map(Log::new),
    },
];

/// Opens the log at `path`; its format is recognised from what lies there. `udp://HOST:PORT` is a LiDAR that sends packets
/// now, and `-` an MCAP file or a bag that comes through standard input.
///
/// # Errors
/// One line that names the folder, and the file and line where one is wrong.
///
/// # Examples
/// ```no_run
/// for scan in &tsdfuse_io::open("kitti/sequences/00")? {
///     println!("{} points", scan?.points.len());
/// }
/// # Ok::<(), tsdfuse_io::Error>(())
/// ```
pub fn open(path: impl AsRef<Path>) -> Result<Log> {
    open_with(path, &OpenOptions::default())
}

/// Opens the log at `path` with poses, sensors or extrinsics of one's choice.
///
/// # Errors
/// As [`open`].
pub fn open_with(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Log> {
    let (path, asked) = (path.as_ref(), options);
    let told = options
        .sensor_file
        .as_deref()
        .map(sensor_file::read)
        .transpose()?
        .unwrap_or_default();
    // What is known of the body does not matter for the sensor's own poses.
    let is_placed = options.poses.as_deref().is_some_and(poses::is_of_sensor);
    let options = OpenOptions {
        extrinsics: if is_placed {
            Some(Pose::IDENTITY)
        } else {
            options.extrinsics.or(told.body_from_sensor)
        },
        ..options.clone()
    };
    let mut log = open_as_told(path, &options)?.opened_with(asked);
    // A name may ask for another model.
    let wants_model = matches!(log.sensors(), [sensor] if options.sensors.is_empty() || sensor.model.is_none());
    if let Some(model) = told.model.filter(|_| wants_model) {
        log = log.with_model(&model);
    }
    let of_log = log.sensors().first().and_then(|sensor| sensor.time_offset_s);
    if let Some(secs) = told.time_offset_s.or(of_log).filter(|secs| *secs != 0.0 && !is_placed) {
        log = log.with_time_offset(secs)?;
    }
    match told.correction {
        Some(correction) => log.with_correction(&correction),
        None => Ok(log),
    }
}

/// Opens the log at `path`; the errors of its sensors are those that the log tells.
fn open_as_told(path: &Path, options: &OpenOptions) -> Result<Log> {
    if let Some(address) = crate::udp::address(path) {
        return crate::udp::Udp::open(address, options).map(Log::of_stream);
    }
    if path.as_os_str() == "-" {
        return crate::ros::Follow::stdin(options).map(Log::of_stream);
    }
    if options.follow {
        return crate::ros::Follow::open(path, options).map(Log::of_stream);
    }
    match FORMATS.iter().find(|format| (format.recognises)(path)) {
        Some(format) => (format.open)(path, options),
        None if !std::fs::metadata(path).map_err(Error::io(path))?.is_dir() => Err(Error::dataset(
            path,
            "is no ROS bag, no MCAP file, no capture of a LiDAR's packets (PCAP, pcapng), no OSF, no LAS and no E57; other data sets are folders",
        )),
        None => Err(Error::dataset(
            path,
            "holds no scans that are read here: no lidar/*.pkl.gz (PandaSet), velodyne/*.bin (KITTI, plain), \
             velodyne_points/ (KITTI raw, KITTI-360), v1.0-*/ (nuScenes), sensors/lidar/*.feather (Argoverse 2), LiDAR/ (HeLiPR), \
             Ouster/ (MulRan), velodyne_sync/ (NCLT), *.depth.png (7-Scenes), depth/*.png (TUM RGB-D), *.bag, *.mcap, *.db3, *.pcd or *.ply",
        )),
    }
}

/// An opened log. Cheap to clone; scans are read when asked for.
///
/// It is made of a [`Source`], whose scans can be read in any order, or of a [`Stream`], whose scans come once:
///
/// | | source | stream |
/// |---|---|---|
/// | [`len`](Self::len) | `Some` | `None` |
/// | [`scans`](Self::scans), [`images`](Self::images), [`imu`](Self::imu), [`trajectory`](Self::trajectory) | all of it | empty |
/// | [`read`](Self::read), [`read_indices`](Self::read_indices) | any scan | an error |
/// | [`read_ahead`](Self::read_ahead), iteration | again and again | once |
#[derive(Clone)]
pub struct Log(Input);

#[derive(Clone)]
enum Input {
    Source(Arc<dyn Source>),
    Stream(Arc<Live>),
}

impl Log {
    /// A log of a source.
    pub fn new(source: impl Source + 'static) -> Self {
        Self(Input::Source(Arc::new(source)))
    }

    /// A log of a stream.
    pub fn of_stream(stream: impl Stream + 'static) -> Self {
        Self(Input::Stream(Arc::new(Live::new(stream))))
    }

    /// A stream is opened in the same way when it is read again.
    fn opened_with(mut self, options: &OpenOptions) -> Self {
        if let Input::Stream(live) = &mut self.0
            && let Some(live) = Arc::get_mut(live)
        {
            live.options = options.clone();
        }
        self
    }

    /// Several logs as one, their scans in order of time: of several sensors with their own extrinsics, or of several drives in
    /// one world. Trajectory and notes are those of all; the trajectory is that of the first log that has one.
    ///
    /// # Errors
    /// Names the log that is a stream, or whose scans have no times.
    pub fn together(logs: Vec<Self>) -> Result<Self> {
        let sources = logs.into_iter().map(|log| match log.0 {
            Input::Source(source) => Ok(source),
            Input::Stream(live) => Err(Error::dataset(
                &live.format,
                "is a stream: it cannot be put together with others",
            )),
        });
        Ok(Self::new(Together::new(sources.collect::<Result<_>>()?)?))
    }

    /// With sensors of this model.
    #[must_use]
    pub fn with_model(self, model: &SensorModel) -> Self {
        match self.0 {
            Input::Source(source) => Self::new(Corrected::of_model(source, model)),
            Input::Stream(mut live) => {
                if let Some(live) = Arc::get_mut(&mut live) {
                    corrected::set_model(&mut live.sensors, model);
                }
                Self(Input::Stream(live))
            }
        }
    }

    /// With other errors of its sensors to take back than its format tells ([`Sensor::correction`](crate::Sensor::correction)).
    ///
    /// # Errors
    /// If no sensor can be off by that, and for depth images.
    pub fn with_correction(self, correction: &SensorCorrection) -> Result<Self> {
        correction
            .check()
            .map_err(|e| Error::dataset(self.format(), e.to_string()))?;
        if !correction.is_none() && self.sensors().iter().any(|sensor| sensor.camera.is_some()) {
            let reason = "depth images cannot be corrected: their points lie on the rays of pixels";
            return Err(Error::dataset(self.format(), reason));
        }
        Ok(match self.0 {
            Input::Source(source) => Self::new(Corrected::new(source, correction)),
            Input::Stream(mut live) => {
                if let Some(live) = Arc::get_mut(&mut live) {
                    corrected::set(&mut live.sensors, correction);
                }
                Self(Input::Stream(live))
            }
        })
    }

    /// With a clock of the poses that is ahead of the sensor's: scans at time t have the poses of t + `secs`, and those that would lie beyond
    /// the first or the last pose have none.
    ///
    /// # Errors
    /// If the poses have no times, if they are those of several sensors' scans, and for streams.
    pub fn with_time_offset(self, secs: f64) -> Result<Self> {
        match self.0 {
            Input::Source(source) => Ok(Self::new(Corrected::later(source, secs)?)),
            Input::Stream(live) => Err(Error::dataset(
                &live.format,
                "time_offset_s: a stream's poses come with its scans",
            )),
        }
    }

    fn source(&self) -> Option<&dyn Source> {
        match &self.0 {
            Input::Source(source) => Some(source.as_ref()),
            Input::Stream(_) => None,
        }
    }

    /// The format's name for people.
    pub fn format(&self) -> &str {
        match &self.0 {
            Input::Source(source) => source.format(),
            Input::Stream(live) => &live.format,
        }
    }

    /// How many scans there are; `None` where nobody knows: in a stream.
    pub fn len(&self) -> Option<usize> {
        self.source().map(|source| source.scans().len())
    }

    /// Whether it is known that there are no scans.
    pub fn is_empty(&self) -> bool {
        self.len() == Some(0)
    }

    /// The scans, in order of time where times are known; empty for a stream.
    pub fn scans(&self) -> &[ScanRef] {
        self.source().map_or(&[], Source::scans)
    }

    /// The sensors whose scans are read.
    pub fn sensors(&self) -> &[Sensor] {
        match &self.0 {
            Input::Source(source) => source.sensors(),
            Input::Stream(live) => &live.sensors,
        }
    }

    /// `world_from_body` over time, where the log has such poses.
    pub fn trajectory(&self) -> Option<&Trajectory> {
        self.source().and_then(Source::trajectory)
    }

    /// All samples of the inertial measurement unit, in order of time; empty where there is none.
    ///
    /// # Errors
    /// Names the file and the reason.
    pub fn imu(&self) -> Result<Vec<ImuSample>> {
        self.source().map_or(Ok(Vec::new()), Source::imu)
    }

    /// The places of a GNSS receiver, in order of time; empty where there is none.
    ///
    /// # Errors
    /// Names the file and the reason.
    pub fn gnss(&self) -> Result<Vec<GnssFix>> {
        self.source().map_or(Ok(Vec::new()), Source::gnss)
    }

    /// What a recording of messages holds, and what was concluded from it; `None` for other logs.
    pub fn recorded(&self) -> Option<&Recorded> {
        self.source().and_then(Source::recorded)
    }

    /// The images of all cameras, ordered by camera and time.
    pub fn images(&self) -> &[ImageRef] {
        self.source().map_or(&[], Source::images)
    }

    /// The encoded bytes (JPEG, PNG, …) of an image.
    ///
    /// # Errors
    /// Names the file and the reason; also for an `index` beyond the last image.
    pub fn read_image(&self, index: usize) -> Result<Vec<u8>> {
        self.source().ok_or_else(|| self.once())?.read_image(index)
    }

    /// What is missing or odd, one sentence each.
    pub fn notes(&self) -> &[String] {
        match &self.0 {
            Input::Source(source) => source.notes(),
            Input::Stream(live) => &live.notes,
        }
    }

    /// Whether there are scans, and none of them has a pose.
    pub fn is_unplaced(&self) -> bool {
        match &self.0 {
            Input::Source(source) => {
                let scans = source.scans();
                !scans.is_empty() && scans.iter().all(|scan| scan.pose.is_none())
            }
            Input::Stream(live) => !live.is_placed,
        }
    }

    /// What came up while a stream was read, one sentence each, as far as is known by now; empty for other logs.
    pub fn news(&self) -> Vec<String> {
        match &self.0 {
            Input::Source(_) => Vec::new(),
            Input::Stream(live) => live.news.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }

    /// What fusing this log wants where nothing is set: method, voxels and range limits.
    pub fn suggested(&self) -> Suggested {
        Suggested::of(self.sensors())
    }

    /// Reads scan `index`; invalid returns are still in it, as measured.
    ///
    /// # Errors
    /// Names the file and the reason; also for an `index` beyond the last scan, and for a stream.
    pub fn read(&self, index: usize) -> Result<Scan> {
        read_checked(self.source().ok_or_else(|| self.once())?, index)
    }

    /// Reads the selected scans in order, ahead of the caller (see [`ReadAhead`]). Of a stream this can be had once; held-out
    /// scans of a stream are gone then.
    pub fn read_ahead(&self, selection: &Selection) -> ReadAhead {
        match &self.0 {
            Input::Source(source) => ReadAhead::of_source(source.clone(), selection.indices(source.scans().len())),
            Input::Stream(live) => ReadAhead::of_stream(live, selection.clone()),
        }
    }

    /// Reads the scans of the given numbers in that order, ahead of the caller (see [`ReadAhead`]). For a stream, all that
    /// comes is an error for each.
    pub fn read_indices(&self, indices: Vec<usize>) -> ReadAhead {
        match &self.0 {
            Input::Source(source) => ReadAhead::of_source(source.clone(), indices),
            Input::Stream(live) => ReadAhead::refused(live, indices),
        }
    }

    /// From now on, keeps what a stream says, so that it can be read again ([`Self::recording`]), as long as this log exists; whether that is possible. A
    /// recording that grows is a file already, and standard input lies in a temporary one; what a sensor sends is written into the folder as a capture.
    ///
    /// # Errors
    /// Names the folder and the reason.
    pub fn keep(&self, folder: &Path) -> Result<bool> {
        match &self.0 {
            Input::Source(_) => Ok(true),
            Input::Stream(live) => match &live.kept {
                Some(kept) => kept.keep(folder).map(|()| true),
                None => Ok(false),
            },
        }
    }

    /// What a stream said by now, as a log whose scans can be read in any order, with the same sensors; of a log that is no stream, the log itself. It is to be
    /// used as long as the stream's log exists.
    ///
    /// # Errors
    /// If it was not kept ([`Self::keep`]), or could not be; as [`open_with`].
    pub fn recording(&self) -> Result<Self> {
        let Input::Stream(live) = &self.0 else {
            return Ok(self.clone());
        };
        let path = live.kept.as_ref().ok_or_else(|| self.once())?.recording()?;
        let names = |sensors: &[Sensor]| -> Vec<String> { sensors.iter().map(|sensor| sensor.name.clone()).collect() };
        let mut options = OpenOptions {
            follow: false,
            ..live.options.clone()
        };
        let log = open_with(&path, &options)?;
        if names(log.sensors()) == names(&live.sensors) {
            return Ok(log);
        }
        // Others were heard later.
        options.sensors = names(&live.sensors);
        open_with(&path, &options)
    }

    fn once(&self) -> Error {
        Error::dataset(self.format(), "is a stream: it is read once, from its begin")
    }
}

impl IntoIterator for &Log {
    type Item = Result<Scan>;
    type IntoIter = Scans;

    /// All scans in order, without invalid returns: those that the suggested range limits leave out (see [`Log::suggested`]).
    fn into_iter(self) -> Scans {
        Scans::new(self.read_ahead(&Selection::default()), self.suggested().range)
    }
}

impl IntoIterator for Log {
    type Item = Result<Scan>;
    type IntoIter = Scans;

    fn into_iter(self) -> Scans {
        (&self).into_iter()
    }
}

impl std::fmt::Debug for Log {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Log")
            .field("format", &self.format())
            .field("scans", &self.len())
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod datasets;
#[cfg(test)]
mod tests;
