//! Running a [`Job`], from its log to its files, and going on with one.

use std::path::Path;
use std::time::Instant;

use tsdfuse_io::Log;
use tsdfuse_store::PagedMap;

use crate::checkpoint::Checkpoint;
use crate::error::{Result, RunError};
use crate::event::{Event, Observer, Stop};
use crate::job::{Job, is_unplaced};
use crate::load::Loading;
use crate::machine::peak_memory_bytes;
use crate::poses_from::PosesFrom;
use crate::recording::Recording;
use crate::report::{GrowthReport, LogReport, Report};
use crate::session::Session;
use crate::setup::{Placing, Setup};

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
        let log = self.open(observer)?;
        let setup = self.setup(&log)?;
        let session = Session::begin_job(&log, setup, Some(self.absolute()?), false, observer)?;
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
        let log = self.open(observer)?;
        let setup = self.setup(&log)?;
        map.set_limit(self.memory_bytes);
        let session = Session::resume(&log, setup, map, checkpoint, observer)?;
        self.go_on(start, &log, session, stop, observer)
    }

    fn open(&self, observer: &mut dyn Observer) -> Result<Log> {
        match self.poses {
            PosesFrom::Log | PosesFrom::Refine => self.input.open(&self.settings, observer),
            PosesFrom::Any | PosesFrom::Track => self.input.open_unplaced(&self.settings, observer),
        }
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
        let growth = match &self.outputs.recording {
            Some(path) => {
                let mut recording = Recording::create(path, log, stop)?;
                let growth = self.fuse(&mut session, &mut Recorded(observer, &mut recording));
                recording.finish()?;
                growth?
            }
            None => self.fuse(&mut session, observer)?,
        };
        log.news().iter().for_each(|news| observer.on(Event::Note(news)));
        let device = session.device();
        if let Some(path) = &self.outputs.poses {
            session.write_poses(path)?;
        }
        if let Some(path) = &self.outputs.sensor {
            session.write_sensor(path)?;
        }
        let saved_map = self.outputs.map.as_deref().map(|path| {
            observer.on(Event::Working("saving the map"));
            session.save_map(path)
        });
        let saved_map = saved_map.transpose()?;
        let mesh = self.outputs.mesh.as_deref().map(|path| {
            observer.on(Event::Working("extracting the surface"));
            session.write_painted(path, self.outputs.color, observer)
        });
        let mesh = mesh.transpose()?;
        if let Some(path) = &self.outputs.map {
            session.save_colors(path)?;
        }
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
            odometry: session.odometry(),
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
        let mut skipped = session.skipped().len();
        let mut fused = 0;
        while session.step(observer)? {
            let is_fused = session.skipped().len() == skipped;
            (fused, skipped) = (fused + usize::from(is_fused), session.skipped().len());
            // Of a stream that is fused again, the mesh so far is more than the first scans.
            if is_fused && fused.is_multiple_of(every.max(1)) && !session.is_again() {
                let start = Instant::now();
                session.wait(observer)?;
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
            placing: match self.poses {
                PosesFrom::Track => Placing::Track,
                PosesFrom::Any if is_unplaced(log) => Placing::Track,
                PosesFrom::Any | PosesFrom::Log => Placing::Given,
                PosesFrom::Refine => Placing::Refine,
            },
            loops: !self.open_loops,
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
            initial_pose: self.initial_pose,
            intensity: self.outputs.intensity,
            labels: self.outputs.labels.clone(),
            follow_every: None,
            follow_near_m: None,
        })
    }
}

/// A run that is watched and recorded.
struct Recorded<'a>(&'a mut dyn Observer, &'a mut Recording);

impl Observer for Recorded<'_> {
    fn on(&mut self, event: Event<'_>) {
        self.0.on(event);
        self.1.on(event);
    }

    fn surface_share(&self) -> Option<f64> {
        let shares = [self.0.surface_share(), self.1.surface_share()];
        shares.into_iter().flatten().reduce(f64::max)
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
