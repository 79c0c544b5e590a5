//! A run as data: a log, how it is fused, and the files that are made. It can be stored, and sent to another machine.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tsdfuse::Pose;
use tsdfuse_io::{Log, OpenOptions, Selection};

use crate::device::Device;
use crate::error::{Result, RunError};
use crate::event::{Event, Observer};
use crate::outputs::Outputs;
use crate::poses_from::PosesFrom;
use crate::settings::Settings;

/// A log and how it is opened.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Input {
    /// A folder or a file; its format is recognised.
    pub path: PathBuf,
    /// Poses, sensors and extrinsics of one's choice.
    pub options: OpenOptions,
    /// Which of its scans.
    pub selection: Selection,
    /// Whether scans that cannot be used are left out; otherwise the first one ends the run.
    pub skip_bad: bool,
}

impl Input {
    /// Opens the log, and tells what is odd about it.
    ///
    /// # Errors
    /// As [`Self::open_unplaced`]; [`RunError::Nothing`] if no scan has a pose.
    pub fn open(&self, settings: &Settings, observer: &mut dyn Observer) -> Result<Log> {
        let log = settings.open(&self.path, &self.options)?;
        if is_unplaced(&log) {
            let path = self.path.display();
            return Err(RunError::Nothing(format!(
                "{path}: the poses of its scans are not known: there is no poses.txt or other pose file, and --poses names none"
            )));
        }
        self.checked(log, observer)
    }

    /// Opens the log, with or without poses, and tells what is odd about it.
    ///
    /// # Errors
    /// As [`Settings::open`]; [`RunError::Config`] if the selection begins beyond the last scan.
    pub fn open_unplaced(&self, settings: &Settings, observer: &mut dyn Observer) -> Result<Log> {
        let log = settings.open(&self.path, &self.options)?;
        self.checked(log, observer)
    }

    fn checked(&self, log: Log, observer: &mut dyn Observer) -> Result<Log> {
        log.notes().iter().for_each(|note| observer.on(Event::Note(note)));
        let Some(scans) = log.len() else { return Ok(log) };
        if scans == 0 {
            return Err(RunError::Nothing(format!("{}: holds no scans", self.path.display())));
        }
        let Selection { from, to, .. } = self.selection;
        if from >= scans {
            return Err(RunError::config(format_args!(
                "--scans begins at {from}, but there are only {scans} scans"
            )));
        }
        if let Some(to) = to.filter(|&to| to > scans) {
            observer.on(Event::Note(&format!(
                "--scans ends at {to}, but there are only {scans} scans"
            )));
        }
        if let Some(every) = self.selection.hold_out {
            let asked = Selection {
                hold_out: None,
                ..self.selection.clone()
            }
            .indices(scans)
            .len();
            let fused = self.selection.indices(scans).len();
            if fused == 0 || fused == asked {
                return Err(RunError::config(format_args!(
                    "--hold-out {every}: {asked} scans are too few to hold out the middle one of each {every}"
                )));
            }
        }
        Ok(log)
    }

    /// All files and folders that are read.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        std::iter::once(&*self.path).chain(self.options.poses.as_deref())
    }
}

/// Whether no scan has a pose.
pub(crate) fn is_unplaced(log: &Log) -> bool {
    log.is_unplaced()
}

/// A run as data.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Job {
    /// What is fused.
    pub input: Input,
    /// Where the poses come from.
    pub poses: PosesFrom,
    /// Whether loops stay open: the sensor's way is not corrected where it comes back.
    pub open_loops: bool,
    /// What is set of the configuration; the rest is the log's or the default.
    pub settings: Settings,
    /// What fuses.
    pub device: Device,
    /// Most memory for blocks of the map; the others are in a file meanwhile.
    pub memory_bytes: Option<usize>,
    /// The file in which the map is kept as it grows.
    pub store: Option<PathBuf>,
    /// Scans from commit to commit of the store.
    pub commit_every: usize,
    /// A saved map to continue. Odometry looks for the log's place in it.
    pub load_map: Option<PathBuf>,
    /// About where in the saved map the first scan was taken, `world_from_sensor`.
    pub initial_pose: Option<Pose>,
    /// The file that some of the settings were read from, which no output may overwrite.
    pub config_file: Option<PathBuf>,
    /// The files to make.
    pub outputs: Outputs,
    /// The arguments of the program, for the report.
    pub command_line: Vec<String>,
}

impl Job {
    /// All files and folders that are read.
    pub(crate) fn inputs(&self) -> Vec<&Path> {
        self.input
            .paths()
            .chain(self.load_map.as_deref())
            .chain(self.config_file.as_deref())
            .collect()
    }

    /// The same with paths that hold from any folder.
    pub(crate) fn absolute(&self) -> Result<Self> {
        let absolute = |path: &mut PathBuf| {
            if path.as_os_str() != "-" {
                *path = std::path::absolute(&*path).map_err(tsdfuse_io::Error::io(&*path))?;
            }
            Ok::<_, RunError>(())
        };
        let mut job = self.clone();
        absolute(&mut job.input.path)?;
        let outputs = &mut job.outputs;
        let files = [
            &mut outputs.mesh,
            &mut outputs.map,
            &mut outputs.poses,
            &mut outputs.sensor,
            &mut outputs.preview,
            &mut outputs.report,
            &mut outputs.recording,
        ];
        // Of a recording, this may be the name of a topic or a frame.
        let poses = job.input.options.poses.iter_mut().filter(|path| path.exists());
        poses.into_iter().try_for_each(absolute)?;
        let others = [&mut job.store, &mut job.load_map];
        files.into_iter().chain(others).flatten().try_for_each(absolute)?;
        Ok(job)
    }
}
