//! A run as data: a log, how it is fused, and the files that are made. It can be stored, sent to another machine, and gone on with.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use tsdfuse_io::{Log, OpenOptions, Selection};
use tsdfuse_store::PagedMap;

use crate::checkpoint::Checkpoint;
use crate::device::Device;
use crate::error::{Result, RunError};
use crate::event::{Event, Observer, Stop};
use crate::load::Loading;
use crate::machine::peak_memory_bytes;
use crate::outputs::Outputs;
use crate::report::{GrowthReport, LogReport, Report};
use crate::session::{Session, Setup};
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
    /// As [`tsdfuse_io::open_with`]; [`RunError::Config`] if the selection begins beyond the last scan.
    pub fn open(&self, observer: &mut dyn Observer) -> Result<Log> {
        let log = tsdfuse_io::open_with(&self.path, &self.options)?;
        log.notes().iter().for_each(|note| observer.on(Event::Note(note)));
        let Some(scans) = log.len() else { return Ok(log) };
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
            let asked = Selection { hold_out: None, ..self.selection.clone() }.indices(scans).len();
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

/// A run as data.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Job {
    /// What is fused.
    pub input: Input,
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
    /// A saved map to continue.
    pub load_map: Option<PathBuf>,
    /// The files to make.
    pub outputs: Outputs,
    /// The arguments of the program, for the report.
    pub command_line: Vec<String>,
}

impl Job {
    /// Runs from the beginning to the last file.
    ///
    /// # Errors
    /// What is wrong with the job is said before anything is read. If the device or the memory was full, the scans before are
    /// written first.
    pub fn run(&self, stop: &Stop, observer: &mut dyn Observer) -> Result<Report> {
        let start = Instant::now();
        self.outputs.check(&self.inputs(), self.store.as_deref())?;
        if self.memory_bytes.is_some() || self.store.is_some() {
            self.outputs.check_in_parts()?;
        }
        let log = self.input.open(observer)?;
        let setup = self.setup(&log)?;
        let session = Session::begin_job(&log, setup, Some(self.absolute()?), observer)?;
        self.go_on(start, &log, session, stop, observer)
    }

    /// The job of a store, with how far it has come.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn of_store(store: &Path) -> Result<(Self, Resumed)> {
        let (map, bytes) = PagedMap::open(store, None)?;
        let checkpoint = Checkpoint::parse(store, &bytes)?;
        let job = checkpoint.job.clone().ok_or_else(|| {
            RunError::config(format_args!(
                "{}: was not made by a job that could go on",
                store.display()
            ))
        })?;
        Ok((job, Resumed { map, checkpoint }))
    }

    /// Goes on with a store that was opened by [`Self::of_store`].
    ///
    /// # Errors
    /// As [`Self::run`]; also if the log or what is set is not as it was.
    pub fn resume(&self, resumed: Resumed, stop: &Stop, observer: &mut dyn Observer) -> Result<Report> {
        let start = Instant::now();
        let Resumed { mut map, checkpoint } = resumed;
        self.outputs.check(&self.inputs(), self.store.as_deref())?;
        let log = self.input.open(observer)?;
        let setup = self.setup(&log)?;
        map.set_limit(self.memory_bytes);
        let session = Session::resume(&log, setup, map, checkpoint, observer)?;
        self.go_on(start, &log, session, stop, observer)
    }

    fn go_on(
        &self,
        start: Instant,
        log: &Log,
        mut session: Session,
        stop: &Stop,
        observer: &mut dyn Observer,
    ) -> Result<Report> {
        session.stop_by(stop);
        let growth = self.fuse(&mut session, observer)?;
        let device = session.device();
        let saved_map = self.outputs.map.as_deref().map(|path| {
            observer.on(Event::Working("saving the map"));
            session.save_map(path)
        });
        let saved_map = saved_map.transpose()?;
        let mesh = self.outputs.mesh.as_deref().map(|path| {
            observer.on(Event::Working("extracting the surface"));
            session.write_surface(path)
        });
        let mesh = mesh.transpose()?;
        let preview = self.outputs.preview.as_deref().map(|path| {
            observer.on(Event::Working("rendering"));
            session.write_preview(path)
        });
        let preview = preview.transpose()?;
        let mut totals = session.totals();
        totals.seconds -= growth.map_or(0.0, |growth| growth.seconds);
        let report = Report {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            command_line: self.command_line.clone(),
            threads: rayon::current_num_threads(),
            device,
            dataset: LogReport::of(&self.input.path, log),
            config: session.config().clone(),
            totals,
            stopped: session.was_stopped(),
            loaded_map: session.loaded_map().cloned(),
            map: session.map_report(),
            paging: session.paging(),
            scans: session.scans().to_vec(),
            skipped_scans: session.skipped().to_vec(),
            saved_map,
            growth,
            mesh,
            preview,
            peak_memory_bytes: peak_memory_bytes(),
            wall_seconds: start.elapsed().as_secs_f64(),
        };
        if let Some(path) = &self.outputs.report {
            report.write(path)?;
        }
        match session.full() {
            Some(reason) => Err(RunError::Full(reason.to_owned())),
            None => Ok(report),
        }
    }

    /// Fuses all scans; the mesh file is kept up to date meanwhile, if that is asked for.
    fn fuse(&self, session: &mut Session, observer: &mut dyn Observer) -> Result<Option<GrowthReport>> {
        let (Some(every), Some(path)) = (self.outputs.mesh_every, &self.outputs.mesh) else {
            session.run(observer)?;
            return Ok(None);
        };
        let mut growth = GrowthReport::default();
        let mut written = 0;
        while session.step(observer)? {
            let fused = session.scans().len();
            if fused > written && fused.is_multiple_of(every.max(1)) {
                written = fused;
                let start = Instant::now();
                match session.write_surface(path) {
                    Ok(_) => {
                        growth.meshes += 1;
                        observer.on(Event::MeshWritten(path));
                    }
                    Err(RunError::Nothing(_)) => {} // no surface yet
                    Err(error) => return Err(error),
                }
                growth.seconds += start.elapsed().as_secs_f64();
            }
        }
        session.finish(observer)?;
        Ok(Some(growth))
    }

    fn setup(&self, log: &Log) -> Result<Setup> {
        let mut settings = self.settings.clone();
        if let Some(path) = &self.load_map {
            settings.set_missing("--load-map", Loading::open(path)?.config())?;
        }
        let defaults = Setup::default();
        Ok(Setup {
            config: settings.resolve(log)?,
            selection: self.input.selection.clone(),
            skip_bad: self.input.skip_bad,
            device: self.device.clone(),
            memory_bytes: self.memory_bytes,
            store: self.store.clone(),
            commit_every: match self.commit_every {
                0 => defaults.commit_every,
                every => every,
            },
            temporary: self.outputs.first().map_or(defaults.temporary, Path::to_owned),
            load_map: self.load_map.clone(),
            follow_every: None,
        })
    }

    /// All files and folders that are read.
    fn inputs(&self) -> Vec<&Path> {
        self.input.paths().chain(self.load_map.as_deref()).collect()
    }

    /// The same with paths that hold from any folder.
    fn absolute(&self) -> Result<Self> {
        let absolute = |path: &mut PathBuf| {
            if path.as_os_str() != "-" {
                *path = std::path::absolute(&*path).map_err(tsdfuse_io::Error::io(&*path))?;
            }
            Ok::<_, RunError>(())
        };
        let mut job = self.clone();
        absolute(&mut job.input.path)?;
        let outputs = &mut job.outputs;
        let files = [&mut outputs.mesh, &mut outputs.map, &mut outputs.preview, &mut outputs.report];
        let others = [&mut job.input.options.poses, &mut job.store, &mut job.load_map];
        files.into_iter().chain(others).flatten().try_for_each(absolute)?;
        Ok(job)
    }
}

/// A store that was opened to go on with.
#[derive(Debug)]
pub struct Resumed {
    map: PagedMap,
    checkpoint: Checkpoint,
}

impl Resumed {
    /// How far the run has come.
    pub fn checkpoint(&self) -> &Checkpoint {
        &self.checkpoint
    }
}
