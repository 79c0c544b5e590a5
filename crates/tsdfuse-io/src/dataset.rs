//! A data set: scans with poses, whatever the files look like.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, Scan, SensorModel};

use crate::error::{Error, Result};
use crate::pandaset::PandaSet;
use crate::read_ahead::{ReadAhead, Scans};

/// How to open a data set; the default asks for nothing.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Poses to use instead of those that lie beside the scans (TUM or KITTI text).
    pub poses: Option<PathBuf>,
    /// The sensor: one of several in the log, or the model of the only one.
    pub sensor: Option<String>,
}

/// One scan of a data set, before it is read.
#[derive(Clone, Debug)]
pub struct ScanRef {
    /// What messages call it: the file's name.
    pub name: String,
    /// Seconds, where the data set has times.
    pub timestamp_secs: Option<f64>,
    /// `world_from_sensor`.
    pub pose: Pose,
}

/// One file format: knows its scans and reads any of them.
pub trait Source: Send + Sync {
    /// The format's name for people: `PandaSet`, `KITTI odometry`, …
    fn format(&self) -> &'static str;
    /// The scans in order of time, each with its pose.
    fn scans(&self) -> &[ScanRef];
    /// Reads scan `index` of [`Source::scans`]. Invalid returns are still in it, as measured.
    ///
    /// # Errors
    /// Names the file and the reason.
    fn read(&self, index: usize) -> Result<Scan>;
    /// The sensor's model, where the data set states it.
    fn sensor(&self) -> Option<SensorModel> {
        None
    }
    /// The camera, where the scans are depth images; then there is no [`Source::sensor`].
    fn camera(&self) -> Option<Pinhole> {
        None
    }
    /// Returns nearer than this, metres, are the vehicle that carries the sensor, where that was measured, or nearer than
    /// such sensors measure.
    fn min_range_m(&self) -> Option<f32> {
        None
    }
    /// What is missing or odd, one sentence each: frames without scan, scans without pose, …
    fn notes(&self) -> &[String] {
        &[]
    }
}

/// A format: how its folders are recognised, and how one is opened.
struct Format {
    recognises: fn(&Path) -> bool,
    open: fn(&Path, &OpenOptions) -> Result<Box<dyn Source>>,
}

/// All formats, the more particular ones first. A new format is one file and one entry here.
const FORMATS: &[Format] = &[
    Format {
        recognises: PandaSet::recognises,
        open: |path, options| Ok(Box::new(PandaSet::open(path, options)?)),
    },
    Format {
        recognises: crate::kitti_raw::recognises,
        open: |path, options| Ok(Box::new(crate::kitti_raw::open(path, options)?)),
    },
    Format {
        recognises: crate::kitti::recognises,
        open: |path, options| Ok(Box::new(crate::kitti::open(path, options)?)),
    },
    Format {
        recognises: crate::plain::recognises,
        open: |path, options| Ok(Box::new(crate::plain::open(path, options)?)),
    },
    Format {
        recognises: crate::rgbd::recognises,
        open: |path, options| Ok(Box::new(crate::rgbd::open(path, options)?)),
    },
    Format {
        recognises: crate::clouds::recognises,
        open: |path, options| Ok(Box::new(crate::clouds::open(path, options)?)),
    },
];

/// Opens the data set at `path`, whose format is recognised from what lies there.
///
/// # Errors
/// One line that names the folder, and the file and line where one is wrong.
///
/// # Examples
/// ```no_run
/// for scan in tsdfuse_io::open("kitti/sequences/00")? {
///     println!("{} points", scan?.points.len());
/// }
/// # Ok::<(), tsdfuse_io::Error>(())
/// ```
pub fn open(path: impl AsRef<Path>) -> Result<Dataset> {
    open_with(path, &OpenOptions::default())
}

/// Opens the data set at `path` with poses or a sensor of one's choice.
///
/// # Errors
/// As [`open`].
pub fn open_with(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Dataset> {
    let path = path.as_ref();
    if !std::fs::metadata(path).map_err(Error::io(path))?.is_dir() {
        return Err(Error::dataset(path, "is a file; a data set is a folder"));
    }
    let format = FORMATS.iter().find(|f| (f.recognises)(path)).ok_or_else(|| {
        Error::dataset(
            path,
            "holds no scans that are read here: no lidar/*.pkl.gz (PandaSet), velodyne/*.bin (KITTI, plain), \
             velodyne_points/ (KITTI raw), *.depth.png (7-Scenes), depth/*.png (TUM RGB-D), *.pcd or *.ply",
        )
    })?;
    let source = (format.open)(path, options)?;
    Ok(Dataset { source: source.into() })
}

/// An opened data set. Cheap to clone; scans are read when asked for.
#[derive(Clone)]
pub struct Dataset {
    source: Arc<dyn Source>,
}

impl Dataset {
    /// Makes a data set of a source that was built by hand.
    pub fn new(source: impl Source + 'static) -> Self {
        Self {
            source: Arc::new(source),
        }
    }

    /// The format's name for people.
    pub fn format(&self) -> &'static str {
        self.source.format()
    }

    /// How many scans there are.
    pub fn len(&self) -> usize {
        self.source.scans().len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The scans in order of time, each with its pose.
    pub fn scans(&self) -> &[ScanRef] {
        self.source.scans()
    }

    /// What is missing or odd, one sentence each.
    pub fn notes(&self) -> &[String] {
        self.source.notes()
    }

    /// The sensor's model, where the data set states it.
    pub fn sensor(&self) -> Option<SensorModel> {
        self.source.sensor()
    }

    /// The camera, where the scans are depth images.
    pub fn camera(&self) -> Option<Pinhole> {
        self.source.camera()
    }

    /// Returns nearer than this, metres, are no measurements of the scene (the vehicle that carries the sensor), where that
    /// is known; they are still in the scans.
    pub fn min_range_m(&self) -> Option<f32> {
        self.source.min_range_m()
    }

    /// Reads scan `index`; invalid returns are still in it, as measured.
    ///
    /// # Errors
    /// Names the file and the reason; also for an `index` beyond the last scan.
    pub fn read(&self, index: usize) -> Result<Scan> {
        let reference = self.scans().get(index).ok_or_else(|| {
            Error::dataset(
                self.format(),
                format!("no scan {index}: there are {} scans", self.len()),
            )
        })?;
        let scan = self.source.read(index)?;
        scan.check()
            .map_err(|e| Error::dataset(&reference.name, e.to_string()))?;
        Ok(scan)
    }

    /// Reads every `step`-th scan of `range` in order, ahead of the caller (see [`ReadAhead`]).
    ///
    /// What lies beyond the last scan is left out; a step of 0 counts as 1.
    pub fn iter_range(&self, range: std::ops::Range<usize>, step: usize) -> ReadAhead {
        let range = range.start..range.end.min(self.len());
        self.iter_indices(range.step_by(step.max(1)).collect())
    }

    /// Reads the scans of the given numbers in that order, ahead of the caller (see [`ReadAhead`]).
    pub fn iter_indices(&self, indices: Vec<usize>) -> ReadAhead {
        ReadAhead::new(self.clone(), indices)
    }
}

impl IntoIterator for &Dataset {
    type Item = Result<Scan>;
    type IntoIter = Scans;

    fn into_iter(self) -> Scans {
        Scans::new(self.iter_range(0..self.len(), 1))
    }
}

impl IntoIterator for Dataset {
    type Item = Result<Scan>;
    type IntoIter = Scans;

    fn into_iter(self) -> Scans {
        (&self).into_iter()
    }
}

impl std::fmt::Debug for Dataset {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Dataset")
            .field("format", &self.format())
            .field("scans", &self.len())
            .finish_non_exhaustive()
    }
}
