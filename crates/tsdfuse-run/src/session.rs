//! The loop: scans are read ahead, cleaned, fused, followed and committed, one after the other.

use std::collections::{BTreeSet, VecDeque};
use std::path::Path;
use std::time::Instant;

use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Changes, Mesh, Nearby};
use tsdfuse::{Pose, Scan, SensorModel, VoxelMap};
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::{Log, ReadAhead, ReadScan, Selection};
use tsdfuse_store::PagedMap;
use tsdfuse_view::Scene;

use crate::backend::{Backend, Failed, Integrators, Settled};
use crate::checkpoint::Checkpoint;
use crate::config::RunConfig;
use crate::device::Device;
use crate::error::{BadScan, Result, RunError};
use crate::event::{Event, Observer, Stop};
use crate::gpu;
use crate::intensity::Intensity;
use crate::job::Job;
use crate::labels;
use crate::layers::{Colors, Layers, Painting};
use crate::load::Loading;
use crate::loops::Loops;
use crate::memory::InMemory;
use crate::paged::Paged;
use crate::paint;
use crate::report::{
    ColorReport, FinishReport, LoadedMap, MapReport, MeshReport, OdometryReport, PagingReport, SavedMap, ScanReport,
    SkippedScan, Sums, Totals, ViewReport,
};
use crate::scene;
use crate::setup::{Placing, Setup};
use crate::surface;
use crate::tracking::{self, Refinement, Tracking};
use crate::view;
use tsdfuse_odometry::Quality;
use tsdfuse_plan::{Moving, MovingConfig};

/// Scans whose regions are loaded ahead.
const AHEAD: usize = 3;

/// Blocks that were updated since changes were told are listed up to this length before those that are in it several times are removed.
const MOST_UNFOLLOWED: usize = 1 << 20;

/// The share of the time spent waiting for a sensor that telling changes may take besides.
const WAITING_SHARE: f64 = 0.5;

/// A map on the device that fuses.
fn open(map: VoxelMap, setup: &Setup, sensors: &[Option<SensorModel>]) -> Result<Box<dyn Backend>> {
    let config = &setup.config;
    match &setup.device {
        Device::Cpu => {
            let integrators = Integrators::new(config, sensors);
            Ok(Box::new(InMemory::new(map, integrators, config.mesh)))
        }
        Device::Gpu(name) => gpu::open(name.as_deref(), &map, config, sensors),
    }
}

/// A log that is being fused.
///
/// ```no_run
/// use tsdfuse_run::{Event, Session, Setup, Silent};
///
/// let log = tsdfuse_io::open("pandaset/002")?;
/// let mut session = Session::begin(&log, Setup::for_log(&log), &mut Silent)?;
/// while session.step(&mut |event: Event<'_>| println!("{event:?}"))? {}
/// session.finish(&mut Silent)?;
/// session.write_surface("street.ply".as_ref())?;
/// # Ok::<(), tsdfuse_run::RunError>(())
/// ```
pub struct Session {
    setup: Setup,
    log: Log,
    /// The stream of which the log is what was recorded.
    stream: Option<Log>,
    /// The loops of a stream, which are closed when it is over.
    loops: Option<Loops>,
    /// Blocks whose surface was told of a stream, and not again since its loops are closed.
    shown: BTreeSet<BlockIndex>,
    /// What messages call it.
    name: String,
    reading: Option<ReadAhead>,
    placer: Placer,
    /// Scans that odometry has placed, which are fused while it tracks the next one; and how long was waited for them, seconds.
    placed: (Vec<(ReadScan, Option<Quality>)>, f64),
    /// Whether the poses are known that must be before anything is fused.
    is_prepared: bool,
    /// Scans that were done before the run was broken off, and are read once more: poses, and what is known to be free, follow from all
    /// scans before.
    repeated: usize,
    /// Poses of the scans to come, where they are known.
    next: VecDeque<Option<Pose>>,
    /// What is wanted beside the map.
    layers: Layers,
    /// Tells which returns move, if those are wanted.
    moving: Option<Moving>,
    backend: Box<dyn Backend>,
    /// Scans that were given to the backend but are not settled.
    under_way: VecDeque<UnderWay>,
    /// Of the scans that are in the map, those of a map that is continued and those before a break included.
    poses: Vec<FusedPose>,
    checkpoint: Checkpoint,
    /// Scans that were done when the store was committed last.
    committed: Option<usize>,
    /// Scans that were fused in this process.
    scans: Vec<ScanReport>,
    loaded: Option<LoadedMap>,
    changes: Changes,
    /// Blocks that were updated since changes were told.
    unfollowed: Vec<BlockIndex>,
    /// Around the sensor, if what is near is told first.
    nearby: Option<Nearby>,
    /// Beyond this length, blocks that are in it several times are removed.
    most_unfollowed: usize,
    /// Seconds that telling changes took.
    following_secs: f64,
    last_following_secs: f64,
    /// Seconds that a sensor's scans were waited for; files are read by others meanwhile, who need the processors.
    waiting_secs: f64,
    full: Option<String>,
    stopped: bool,
    finish: FinishReport,
    begun: Instant,
    seconds: f64,
    stop: Stop,
}

/// What gives scans their poses.
enum Placer {
    /// The log did.
    Log,
    /// `None` while it tracks.
    Odometry(Option<Box<Tracking>>),
    Refinement(Box<Refinement>),
}

/// A scan that was given to the backend.
struct UnderWay {
    index: usize,
    report: ScanReport,
    pose: Option<FusedPose>,
}

impl Session {
    /// Begins to fuse a log.
    ///
    /// # Errors
    /// [`RunError::Config`] for a setup that does not go together, and what keeps the map from being made or loaded.
    pub fn begin(log: &Log, setup: Setup, observer: &mut dyn Observer) -> Result<Self> {
        Self::begin_job(log, setup, None, false, observer)
    }

    /// A store that is there already is an error, unless it `replaces` it.
    pub(crate) fn begin_job(
        log: &Log,
        setup: Setup,
        job: Option<Job>,
        replaces: bool,
        observer: &mut dyn Observer,
    ) -> Result<Self> {
        setup.check()?;
        let sensors: Vec<_> = log.sensors().iter().map(|sensor| sensor.model.clone()).collect();
        let mut checkpoint = Checkpoint {
            job,
            config: setup.config.clone(),
            sensors: sensors.clone(),
            is_loaded: false,
            asked: log.len().map(|scans| setup.selection.indices(scans).len()),
            done: 0,
            fused: 0,
            sums: Sums::default(),
            skipped: Vec::new(),
            response: None,
        };
        let mut loading = setup.load_map.as_deref().map(Loading::open).transpose()?;
        let poses = loading.as_mut().map(Loading::take_poses).unwrap_or_default();
        if let Some(loading) = &loading {
            loading.check(&setup.config, &sensors, observer)?;
        }
        let (backend, loaded): (Box<dyn Backend>, _) = if setup.is_paged() {
            let mut paged = Paged::begin(&setup, &sensors, &checkpoint, replaces, observer)?;
            let load = |loading: Loading| {
                let loaded = loading.read_into(&mut paged)?;
                checkpoint.is_loaded = true;
                paged.commit(&checkpoint.bytes(), &poses)?;
                Ok::<_, RunError>(loaded)
            };
            match loading.map(load).transpose() {
                Ok(loaded) => (Box::new(paged), loaded),
                Err(error) => {
                    // A store without the map that it continues is of no use.
                    paged.remove();
                    return Err(error);
                }
            }
        } else {
            let loaded = loading.map(Loading::read).transpose()?;
            let (map, loaded) = match loaded {
                Some((map, loaded)) => (map, Some(loaded)),
                None => (VoxelMap::new(setup.config.map)?, None),
            };
            (open(map, &setup, &sensors)?, loaded)
        };
        let mut session = Self::with(log, setup, backend, checkpoint)?;
        (session.loaded, session.poses) = (loaded, poses);
        session.started(observer)
    }

    /// Goes on with a store, after what was committed last.
    ///
    /// # Errors
    /// If the store was not begun with this configuration and these scans.
    pub(crate) fn resume(
        log: &Log,
        mut setup: Setup,
        store: PagedMap,
        checkpoint: Checkpoint,
        observer: &mut dyn Observer,
    ) -> Result<Self> {
        setup.check()?;
        let path = store.path().display().to_string();
        let (mut log, mut stream) = (log.clone(), None);
        if let (None, Some(scans)) = (log.len(), checkpoint.asked) {
            // A stream that was over, and was fused again.
            log.recording()?;
            log.read_ahead(&Selection::default()).for_each(drop);
            let recording = log.recording()?;
            let indices = setup.selection.indices(recording.scans().len());
            setup.selection.to = indices.get(scans).copied().or(setup.selection.to);
            stream = Some(std::mem::replace(&mut log, recording));
        }
        if checkpoint.config != setup.config {
            return Err(RunError::config(format_args!(
                "{path}: was begun with other settings, or the log has changed"
            )));
        }
        if setup.load_map.is_some() && !checkpoint.is_loaded {
            return Err(RunError::config(format_args!(
                "{path}: the run ended before all of the map that it continues was stored; remove the store and run it again"
            )));
        }
        let asked = log.len().map(|scans| setup.selection.indices(scans).len());
        if checkpoint.asked != asked {
            let count = |scans: Option<usize>| scans.map_or("unknown".to_owned(), |n| n.to_string());
            return Err(RunError::config(format_args!(
                "{path}: its run had {} scans, and now there are {}",
                count(checkpoint.asked),
                count(asked)
            )));
        }
        let poses = store.poses().to_vec();
        let backend = Paged::resume(store, &setup, &checkpoint.sensors);
        let mut session = Self::with(&log, setup, Box::new(backend), checkpoint)?;
        (session.stream, session.poses) = (stream, poses);
        session.started(observer)
    }

    fn with(log: &Log, setup: Setup, backend: Box<dyn Backend>, checkpoint: Checkpoint) -> Result<Self> {
        let placer = match setup.placing {
            // Before it begins: see `prepare`.
            Placing::Track if setup.tracks_first(log) => Placer::Log,
            Placing::Track => {
                let RunConfig { odometry, range, .. } = setup.config;
                let tracking = match &setup.load_map {
                    Some(map) => Tracking::in_map(log, odometry, range, map, setup.initial_pose)?,
                    None => Tracking::new(log, odometry, range)?,
                };
                Placer::Odometry(Some(Box::new(tracking)))
            }
            Placing::Refine | Placing::Given => Placer::Log,
        };
        let is_repeated = matches!(placer, Placer::Odometry(_)) || setup.tells_moving();
        let repeated = if is_repeated { checkpoint.done } else { 0 };
        let is_kept = setup.tracks_again(log) && log.keep(setup.spool())?;
        let loops = is_kept.then(|| Loops::of(log, setup.config.loops)).transpose()?;
        let mut next = VecDeque::new();
        let reading = match log.len() {
            Some(scans) => {
                let mut indices = setup.selection.indices(scans);
                indices.drain(..(checkpoint.done - repeated).min(indices.len()));
                if setup.placing != Placing::Track {
                    next.extend(indices.iter().map(|&index| log.scans()[index].pose));
                }
                log.read_indices(indices)
            }
            None => log.read_ahead(&setup.selection),
        };
        let nearby = setup.follow_near_m.map(Nearby::new);
        Ok(Self {
            setup,
            name: match &checkpoint.job {
                Some(job) => job.input.path.display().to_string(),
                None => log.format().to_owned(),
            },
            log: log.clone(),
            stream: None,
            loops,
            shown: BTreeSet::new(),
            reading: Some(reading),
            is_prepared: false,
            placer,
            placed: Default::default(),
            repeated,
            next,
            layers: Layers::default(),
            moving: None,
            backend,
            under_way: VecDeque::new(),
            poses: Vec::new(),
            checkpoint,
            committed: None,
            scans: Vec::new(),
            loaded: None,
            changes: Changes::default(),
            unfollowed: Vec::new(),
            nearby,
            most_unfollowed: MOST_UNFOLLOWED,
            following_secs: 0.0,
            last_following_secs: 0.0,
            waiting_secs: 0.0,
            full: None,
            stopped: false,
            finish: FinishReport::default(),
            begun: Instant::now(),
            seconds: 0.0,
            stop: Stop::default(),
        })
    }

    fn started(mut self, observer: &mut dyn Observer) -> Result<Self> {
        let device = self.backend.device();
        if self.setup.intensity {
            self.layers.intensity = Some(self.begun_intensity()?);
        }
        if self.setup.tells_moving() {
            self.moving = Some(Moving::new(MovingConfig::default()).map_err(RunError::config)?);
        }
        if let Some(folder) = &self.setup.labels {
            labels::begin(folder)?;
        }
        if let Some(loaded) = &self.loaded {
            observer.on(Event::MapLoaded(loaded));
        }
        observer.on(Event::Begun {
            scans: self.checkpoint.asked,
            done: self.checkpoint.done,
            device: device.as_deref(),
            voxel_size_m: self.setup.config.map.voxel_size_m,
        });
        self.begun = Instant::now();
        Ok(self)
    }

    /// The layer of intensities as it was: that of the map that is continued, or of the store at its last commit.
    fn begun_intensity(&self) -> Result<Intensity> {
        if let (Some(store), true) = (&self.setup.store, self.checkpoint.done > 0) {
            let response = self.checkpoint.response.clone().unwrap_or_default();
            return Intensity::read_beside_store(store, self.checkpoint.done, response);
        }
        match &self.setup.load_map {
            Some(map) => Intensity::read(&Intensity::path_beside(map)),
            None => Intensity::beside(&self.setup.config.map),
        }
    }

    /// Finds the poses that must be known before anything is fused.
    fn prepare(&mut self, observer: &mut dyn Observer) -> Result<()> {
        // Scans that are held out are placed, too: whoever looks them up needs their poses as good.
        let all = Selection {
            hold_out: None,
            ..self.setup.selection.clone()
        };
        let scans = self.log.len().unwrap_or_default();
        let indices = all.indices(scans);
        let RunConfig {
            odometry, range, loops, ..
        } = self.setup.config;
        let placed = if self.setup.placing == Placing::Refine {
            let loops = self.setup.loops.then_some(loops);
            Refinement::of(&self.log, &indices, odometry, loops, &range, &self.stop, observer)?
        } else if self.setup.tracks_first(&self.log) {
            observer.on(Event::Working("finding the poses"));
            Refinement::tracked(&self.log, &indices, odometry, loops, range, &self.stop)?
        } else {
            return Ok(());
        };
        let mut to_fuse = self.setup.selection.indices(scans);
        to_fuse.drain(..(self.checkpoint.done - self.repeated).min(to_fuse.len()));
        self.next = to_fuse.into_iter().map(|index| placed.pose(index)).collect();
        if let Some(loops) = &placed.loops {
            let place = |index| placed.pose(index).map(|pose: Pose| pose.translation);
            let ends = loops
                .closures
                .iter()
                .filter_map(|c| Some([place(c.earlier)?, place(c.later)?]));
            observer.on(Event::LoopsClosed(&ends.collect::<Vec<_>>()));
        }
        self.placer = Placer::Refinement(Box::new(placed));
        self.begun = Instant::now();
        Ok(())
    }

    /// What stops this session between two scans, from any thread.
    pub fn stopper(&self) -> Stop {
        self.stop.clone()
    }

    /// Lets something that exists already stop this session.
    pub fn stop_by(&mut self, stop: &Stop) {
        self.stop = stop.clone();
    }

    /// Reads and fuses the next scan; whether there may be more. After the last one, and when it was stopped, all scans are
    /// in the map and the store is committed.
    ///
    /// # Errors
    /// [`RunError::BadScan`] for a scan that cannot be used, unless [`Setup::skip_bad`] is set. All else ends the run; a store
    /// then holds what was committed last.
    pub fn step(&mut self, observer: &mut dyn Observer) -> Result<bool> {
        if !self.is_prepared {
            self.is_prepared = true;
            self.prepare(observer)?;
        }
        let Some(reading) = &mut self.reading else {
            return Ok(false);
        };
        let waiting = Instant::now();
        let read = reading.next_unless(|| self.stop.is_stopped());
        // A stream that was stopped is fused again to the end.
        self.stopped |= read.is_none() && self.stop.is_stopped();
        let Some(read) = read else {
            self.reading = None;
            // Of a run that was stopped, scans that are not placed yet wait for its going on.
            if !self.stopped {
                self.fuse_placed(observer)?;
                if let Placer::Odometry(Some(tracking)) = &mut self.placer {
                    self.placed = (tracking.finish(), 0.0);
                    self.fuse_placed(observer)?;
                }
            }
            self.settle_all(observer)?;
            return self.begin_again(observer);
        };
        let wait = waiting.elapsed().as_secs_f64();
        if self.log.len().is_none() {
            self.waiting_secs += wait;
        }
        self.next.pop_front();
        match &mut self.placer {
            Placer::Odometry(tracking) => {
                let tracking = tracking.take();
                self.track(tracking, read, wait, observer)?;
            }
            Placer::Log | Placer::Refinement(_) => self.fuse_read(read, None, wait, observer)?,
        }
        Ok(self.full.is_none())
    }

    /// Tracks a scan while those before it are fused.
    fn track(
        &mut self,
        mut tracking: Option<Box<Tracking>>,
        read: ReadScan,
        wait: f64,
        observer: &mut dyn Observer,
    ) -> Result<()> {
        let mut placed = Vec::new();
        let fused = rayon::in_place_scope(|scope| {
            let (tracking, placed) = (&mut tracking, &mut placed);
            scope.spawn(move |_| *placed = tracking.as_mut().map_or_else(Vec::new, |tracking| tracking.push(read)));
            self.fuse_placed(observer)
        });
        self.placer = Placer::Odometry(tracking);
        self.placed = (placed, wait);
        fused?;
        // Who watches a stream does not want to wait for its next scan.
        if self.log.len().is_none() {
            self.fuse_placed(observer)?;
        }
        Ok(())
    }

    /// Fuses the scans that odometry has placed.
    fn fuse_placed(&mut self, observer: &mut dyn Observer) -> Result<()> {
        let (placed, wait) = std::mem::take(&mut self.placed);
        for (read, quality) in placed {
            if let (Some(loops), Ok(scan), Some(quality)) = (&mut self.loops, &read.scan, &quality)
                && loops.push(read.index, scan, quality)
            {
                observer.on(Event::LoopsClosed(&loops.ends()));
            }
            if self.full.is_none() {
                self.fuse_read(read, quality, wait, observer)?;
            }
        }
        Ok(())
    }

    /// When a stream is over, begins to fuse what was recorded of it, as any log, if that is to change anything; whether it does. Then loops are closed, and an IMU and
    /// GNSS of the recording are known.
    fn begin_again(&mut self, observer: &mut dyn Observer) -> Result<bool> {
        let Some(loops) = self.loops.take() else {
            return Ok(false);
        };
        let Some(last) = self.poses.last().filter(|_| self.full.is_none()) else {
            return Ok(false);
        };
        let log = match self.recording(loops) {
            Ok(Some(log)) => log,
            Ok(None) => return Ok(false),
            Err(error) => {
                observer.on(Event::Note(&format!("{error}; so the loops stay open")));
                return Ok(false);
            }
        };
        observer.on(Event::Note(
            "the stream is over, and is fused again with corrected poses",
        ));
        let mut setup = self.setup.clone();
        if self.stopped {
            // What came later is not waited for.
            let scans = log.scans().partition_point(|scan| scan.time_ns <= last.time_ns);
            setup.selection.to = Some(setup.selection.to.unwrap_or(scans).min(scans));
        }
        // The map so far goes first: there might not be room for both in memory.
        self.backend = Box::new(InMemory::new(
            VoxelMap::new(setup.config.map)?,
            Integrators::new(&setup.config, &[]),
            setup.config.mesh,
        ));
        let again = Self::begin_job(&log, setup, self.checkpoint.job.take(), true, observer)?;
        let before = std::mem::replace(self, again);
        self.stopped = before.stopped;
        if !before.stopped {
            self.stop = before.stop;
        }
        (self.name, self.shown, self.stream) = (before.name, before.shown, Some(before.log));
        Ok(true)
    }

    /// What was recorded of the stream, if that leads to other poses.
    fn recording(&self, loops: Loops) -> Result<Option<Log>> {
        let log = self.log.recording()?;
        let RunConfig {
            odometry,
            loops: config,
            ..
        } = self.setup.config;
        let is_corrected = !loops.finish().report.closures.is_empty()
            || (odometry.imu || config.gravity) && !log.imu()?.is_empty()
            || config.gnss && !log.gnss()?.is_empty();
        Ok(is_corrected.then_some(log))
    }

    /// Whether this is a stream that is over, and that is fused once more.
    pub fn is_again(&self) -> bool {
        self.stream.is_some()
    }

    /// Fuses a scan that does not come from the log: of a sensor by its number in the log.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn fuse(&mut self, sensor: usize, scan: Scan, observer: &mut dyn Observer) -> Result<()> {
        let read = ReadScan {
            index: self.checkpoint.done,
            sensor,
            scan: Ok(scan),
            imu: Vec::new(),
            read_secs: 0.0,
        };
        self.fuse_read(read, None, 0.0, observer)
    }

    /// Fuses all scans, lets methods that collect scans fuse them, and checks that something came of it.
    ///
    /// # Errors
    /// As [`Self::step`]; [`RunError::Nothing`] if no point of any scan could be fused.
    pub fn run(&mut self, observer: &mut dyn Observer) -> Result<()> {
        while self.step(observer)? {}
        self.finish(observer)
    }

    /// Ends the fusing: all scans are in the map, and methods that collect scans have fused them.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn finish(&mut self, observer: &mut dyn Observer) -> Result<()> {
        self.reading = None;
        self.settle_all(observer)?;
        self.check()?;
        let start = Instant::now();
        let updated = self.backend.finish()?;
        self.finish = FinishReport {
            seconds: start.elapsed().as_secs_f64(),
            updated_blocks: updated.len(),
        };
        self.unfollowed.extend(updated);
        self.seconds = self.begun.elapsed().as_secs_f64();
        if self.setup.follow_every.is_some() || observer.surface_share().is_some() {
            self.nearby = None;
            self.tell_changes(observer)?;
            if self.is_again() {
                observer.on(Event::SurfaceChanged(&Changes::gone(std::mem::take(&mut self.shown))));
            }
        }
        observer.on(Event::Done { stopped: self.stopped });
        Ok(())
    }

    /// Fuses a scan, or skips it, and counts it as done; unless it was done before.
    fn fuse_read(
        &mut self,
        read: ReadScan,
        quality: Option<Quality>,
        wait: f64,
        observer: &mut dyn Observer,
    ) -> Result<()> {
        let index = read.index;
        let name = match self.log.scans().get(index) {
            Some(scan) => scan.name.clone(),
            None => format!("scan {index}"),
        };
        if self.repeated > 0 {
            self.repeated -= 1;
            return match self.prepared(read, &name) {
                // That it could not be used was told then.
                Ok(_) | Err(RunError::BadScan(_)) => Ok(()),
                Err(error) => Err(error),
            };
        }
        match self.take(read, quality, &name, wait, observer) {
            Ok(()) => {}
            Err(RunError::BadScan(BadScan { reason, .. })) if self.setup.skip_bad => {
                self.skip(index, SkippedScan { name, reason }, observer);
            }
            Err(RunError::Full(reason)) => {
                self.fill_up(index, name, reason, observer);
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        self.checkpoint.done += 1;
        if self.setup.store.is_some() && self.checkpoint.done.is_multiple_of(self.setup.commit_every.max(1)) {
            self.commit(observer)?;
        }
        Ok(())
    }

    /// A scan as it is fused: placed, without returns that are invalid or left out; and how well its pose was refined.
    fn prepared(&mut self, read: ReadScan, name: &str) -> Result<(Scan, Option<Quality>)> {
        let bad = |reason: String| BadScan {
            scan: name.to_owned(),
            reason,
        };
        let mut scan = read.scan.map_err(|error| bad(error.to_string()))?;
        let quality = match &self.placer {
            Placer::Refinement(refinement) => refinement.place(read.index, &mut scan),
            Placer::Log | Placer::Odometry(_) => None,
        };
        if scan.pose.is_none() && matches!(self.placer, Placer::Odometry(_)) {
            let reason = "its place in the saved map was not found: name a rough pose with --initial-pose, or go on looking with --skip-bad";
            return Err(bad(reason.to_owned()).into());
        }
        let measured = self.setup.labels.is_some().then(|| scan.points.clone());
        scan.drop_invalid(&self.setup.config.range);
        if let Some(moving) = &mut self.moving {
            let is_moving = moving.classify(&scan).map_err(|error| bad(error.to_string()))?;
            if let (Some(folder), Some(measured)) = (&self.setup.labels, &measured) {
                labels::write(folder, read.index, measured, &scan.points, &is_moving)?;
            }
            if self.setup.config.leaves_out_moving() {
                scan.drop_moving(&is_moving);
            }
        }
        Ok((scan, quality))
    }

    fn take(
        &mut self,
        read: ReadScan,
        quality: Option<Quality>,
        name: &str,
        wait: f64,
        observer: &mut dyn Observer,
    ) -> Result<()> {
        let ReadScan {
            index,
            sensor,
            read_secs,
            ..
        } = read;
        let start = Instant::now();
        let (scan, refined) = self.prepared(read, name)?;
        let quality = refined.or(quality);
        self.guess_sensor(sensor, &scan);
        let dropping = start.elapsed().as_secs_f64();
        observer.on(Event::ScanRead { index, scan: &scan });
        let start = Instant::now();
        let next = self.next.iter().take(AHEAD).flatten();
        self.backend.prefetch(&next.copied().collect::<Vec<_>>())?;
        let settled = self.backend.fuse(sensor, &scan).map_err(|failed| match failed {
            Failed::Scan(reason) => BadScan {
                scan: scan.name.clone(),
                reason: format!("{}: {reason}", self.name),
            }
            .into(),
            Failed::Run(error) => error,
        })?;
        if let (Some(layer), Some(map)) = (&mut self.layers.intensity, self.backend.map_around()) {
            layer.add(map, &scan)?;
        }
        let took = start.elapsed().as_secs_f64();
        let sums = Sums {
            read: read_secs,
            wait,
            prepare: dropping,
            fuse: took,
            points: scan.points.len() as u64 + scan.dropped.total(),
            dropped: scan.dropped,
            ..Sums::default()
        };
        let report = ScanReport {
            name: scan.name,
            sums,
            updated_blocks: 0,
            odometry: quality,
        };
        let time_ns = scan.time_ns;
        let pose = scan.pose.map(|pose| FusedPose { time_ns, pose });
        self.under_way.push_back(UnderWay { index, report, pose });
        if let Some(bytes) = self.backend.over_limit() {
            observer.on(Event::OverLimit { bytes });
        }
        self.settle(settled, observer)
    }

    /// As methods do that are told of no sensor: so a run that goes on knows the same one.
    fn guess_sensor(&mut self, sensor: usize, scan: &Scan) {
        if let Some(model @ None) = self.checkpoint.sensors.get_mut(sensor)
            && self.setup.store.is_some()
            && self.backend.needs_sensor()
        {
            *model = tsdfuse::sensor::guess(&scan.points, scan.rings.as_deref());
        }
    }

    /// Completes the reports of the oldest scans that are under way.
    fn settle(&mut self, settled: Vec<Settled>, observer: &mut dyn Observer) -> Result<()> {
        for done in settled {
            let Some(UnderWay {
                index,
                mut report,
                pose,
            }) = self.under_way.pop_front()
            else {
                continue;
            };
            self.poses.extend(pose);
            report.sums.fused = done.fused;
            report.sums.skipped = done.skipped;
            report.sums.prepare += done.prepare_secs;
            report.sums.fuse -= done.prepare_secs;
            report.sums.find = done.find_secs;
            report.updated_blocks = done.updated_blocks.len();
            observer.on(Event::ScanFused {
                index,
                report: &report,
                blocks: &done.updated_blocks,
            });
            self.checkpoint.fused += 1;
            self.checkpoint.sums += &report.sums;
            self.scans.push(report);
            self.follow(done.updated_blocks, observer)?;
        }
        Ok(())
    }

    /// Tells what changed of the surface, if somebody wants to know it now.
    fn follow(&mut self, updated: Vec<BlockIndex>, observer: &mut dyn Observer) -> Result<()> {
        let is_due = match (self.setup.follow_every, observer.surface_share()) {
            (Some(every), _) => self.scans.len().is_multiple_of(every.max(1)),
            // What was evicted meanwhile could not be meshed any more.
            (None, Some(_)) if self.setup.is_paged() => true,
            (None, Some(share)) if share <= 0.0 => false,
            (None, Some(share)) => {
                let budget_secs = share * self.begun.elapsed().as_secs_f64() + WAITING_SHARE * self.waiting_secs;
                // The next time takes about as long as the last one, and shall still be within the budget.
                self.following_secs + self.last_following_secs < budget_secs
            }
            (None, None) => return Ok(()),
        };
        self.unfollowed.extend(updated);
        if is_due {
            return self.tell_changes(observer);
        }
        if self.unfollowed.len() > self.most_unfollowed {
            self.unfollowed.sort_unstable();
            self.unfollowed.dedup();
            self.most_unfollowed = (2 * self.unfollowed.len()).max(MOST_UNFOLLOWED);
        }
        Ok(())
    }

    /// Waits until all scans are in the map.
    ///
    /// # Errors
    /// If the device fails. That it is full is no error here: see [`Self::full`].
    pub fn wait(&mut self, observer: &mut dyn Observer) -> Result<()> {
        match self.backend.wait() {
            Ok(settled) => self.settle(settled, observer),
            Err(RunError::Full(reason)) => {
                self.lose_under_way(&reason, observer);
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    /// Waits until all scans are in the map, and commits them.
    fn settle_all(&mut self, observer: &mut dyn Observer) -> Result<()> {
        self.wait(observer)?;
        if self.committed == Some(self.checkpoint.done) {
            return Ok(());
        }
        self.commit(observer)
    }

    /// The device is full: it has the scans that are settled, and takes no more.
    fn fill_up(&mut self, index: usize, name: String, reason: String, observer: &mut dyn Observer) {
        self.reading = None;
        self.lose_under_way(&reason, observer);
        self.skip(index, SkippedScan { name, reason }, observer);
    }

    fn lose_under_way(&mut self, reason: &str, observer: &mut dyn Observer) {
        for UnderWay { index, report, .. } in std::mem::take(&mut self.under_way) {
            let (name, reason) = (report.name, reason.to_owned());
            self.skip(index, SkippedScan { name, reason }, observer);
        }
        self.full = Some(reason.to_owned());
    }

    fn skip(&mut self, index: usize, skipped: SkippedScan, observer: &mut dyn Observer) {
        observer.on(Event::ScanSkipped {
            index,
            skipped: &skipped,
        });
        self.checkpoint.skipped.push(skipped);
    }

    fn tell_changes(&mut self, observer: &mut dyn Observer) -> Result<()> {
        let start = Instant::now();
        let updated = std::mem::take(&mut self.unfollowed);
        if let (Some(nearby), Some(pose)) = (&mut self.nearby, self.poses.last()) {
            nearby.move_to(pose.pose.translation);
        }
        self.backend.follow(&updated, self.nearby.as_ref(), &mut self.changes)?;
        for piece in self.changes.iter() {
            if self.loops.is_some() && !piece.triangles.is_empty() {
                self.shown.insert(piece.block);
            } else {
                self.shown.remove(&piece.block);
            }
        }
        observer.on(Event::SurfaceChanged(&self.changes));
        self.last_following_secs = start.elapsed().as_secs_f64();
        self.following_secs += self.last_following_secs;
        Ok(())
    }

    /// Writes all that changed to the store, if there is one: from now on no crash takes it away.
    ///
    /// # Errors
    /// If the store cannot be written; it then holds what was committed before.
    pub fn commit(&mut self, observer: &mut dyn Observer) -> Result<()> {
        let layer = self.layers.intensity.as_mut().zip(self.setup.store.as_deref());
        let is_layered = layer.is_some();
        if let Some((layer, store)) = layer {
            layer.save_before_commit(store, self.checkpoint.done)?;
        }
        let response = self.layers.intensity.as_ref().map(Intensity::response);
        self.checkpoint.response = response.filter(|_| is_layered).cloned();
        let is_stored = self.backend.commit(&self.checkpoint.bytes(), &self.poses)?;
        if let (true, Some(store)) = (is_layered, self.setup.store.as_deref()) {
            Intensity::committed(store)?;
        }
        self.committed = Some(self.checkpoint.done);
        if is_stored && let Some(path) = &self.setup.store {
            observer.on(Event::MapStored {
                path,
                done: self.checkpoint.done,
                asked: self.checkpoint.asked,
            });
        }
        Ok(())
    }

    /// Whether anything was fused.
    fn check(&self) -> Result<()> {
        let (name, sums) = (&self.name, &self.checkpoint.sums);
        if self.checkpoint.fused == 0 {
            return Err(RunError::Nothing(match &self.full {
                Some(reason) => reason.clone(),
                None => format!("{name}: none of its scans could be fused"),
            }));
        }
        if sums.fused == 0 {
            return Err(RunError::Nothing(format!(
                "{name}: none of {} points could be fused{}",
                sums.points,
                sums.left_out()
            )));
        }
        Ok(())
    }

    /// With what the scans are fused.
    pub fn config(&self) -> &RunConfig {
        &self.setup.config
    }

    /// Why the map does not hold all scans: the device or the memory is full.
    pub fn full(&self) -> Option<&str> {
        self.full.as_deref()
    }

    /// Scans that are done, fused or skipped, those before a break included. On a GPU some may still be under way.
    pub fn done(&self) -> usize {
        self.checkpoint.done
    }

    /// The scans that were fused by this session.
    pub fn scans(&self) -> &[ScanReport] {
        &self.scans
    }

    /// The scans that were skipped, those before a break included.
    pub fn skipped(&self) -> &[SkippedScan] {
        &self.checkpoint.skipped
    }

    /// Sums over all scans, those before a break included.
    pub fn totals(&self) -> Totals {
        Totals {
            scans: self.checkpoint.fused,
            sums: self.checkpoint.sums,
            finish: self.finish,
            seconds: self.seconds,
        }
    }

    /// What odometry did, if it found the poses.
    pub fn odometry(&self) -> Option<OdometryReport> {
        let qualities = self.scans.iter().filter_map(|scan| scan.odometry.as_ref());
        let of = |seconds| OdometryReport::of(seconds, &self.poses, qualities);
        match &self.placer {
            Placer::Log => None,
            Placer::Odometry(tracking) => tracking.as_ref().map(|tracking| OdometryReport {
                pieces: tracking.pieces(),
                imu: tracking.imu(),
                ..of(tracking.seconds)
            }),
            Placer::Refinement(placed) => Some(OdometryReport {
                pieces: placed.pieces,
                imu: placed.imu.clone(),
                loops: placed.loops.clone(),
                correction: placed.correction.clone(),
                mounting: placed.mounting,
                ..of(placed.seconds)
            }),
        }
    }

    /// Whether the session was stopped before the last scan.
    pub fn was_stopped(&self) -> bool {
        self.stopped
    }

    /// The GPU that fuses, if one does.
    pub fn device(&self) -> Option<String> {
        self.backend.device()
    }

    /// The saved map that is continued.
    pub fn loaded_map(&self) -> Option<&LoadedMap> {
        self.loaded.as_ref()
    }

    /// The poses of the scans that are in the map, in the order in which they were fused: those of a map that is continued, as far as
    /// it tells them, and those before a break included.
    pub fn poses(&self) -> &[FusedPose] {
        &self.poses
    }

    /// The map, if all of it is in memory.
    pub fn map(&self) -> Option<&VoxelMap> {
        self.backend.map()
    }

    /// How much the map holds; of a store, as of the last commit.
    pub fn map_report(&self) -> MapReport {
        self.backend.report()
    }

    /// What was done for a map that is not all in memory.
    pub fn paging(&self) -> Option<PagingReport> {
        self.backend.paging()
    }

    /// The surface of the scans so far.
    ///
    /// # Errors
    /// [`RunError::Config`] for a map that is not all in memory: use [`Self::write_surface`].
    pub fn mesh(&mut self) -> Result<Mesh> {
        self.backend.mesh(&self.setup.config.mesh)
    }

    /// Extracts the surface of the scans so far, which must not be empty, and writes it as `.ply`, `.glb`, `.obj`, `.html` or
    /// `NAME/tileset.json`.
    ///
    /// # Errors
    /// [`RunError::Nothing`] if there is none; if the file cannot be written.
    pub fn write_surface(&mut self, path: &Path) -> Result<MeshReport> {
        let scene = self.scene();
        self.backend
            .write_surface(&self.setup.config.mesh, path, &scene, &self.layers)
    }

    /// As [`Self::write_surface`], also with the colours that the log's cameras saw, if they are wanted; then as `.ply`, `.glb`,
    /// `.html` or `NAME/tileset.json`, and the whole mesh is in memory. Colours stay known: [`Self::save_map`] saves them.
    ///
    /// # Errors
    /// As [`Self::write_surface`]; [`RunError::Config`] if colours are wanted and the log has no images with known poses.
    pub fn write_painted(&mut self, path: &Path, color: bool, observer: &mut dyn Observer) -> Result<MeshReport> {
        if !color {
            return self.write_surface(path);
        }
        let start = Instant::now();
        let config = self.setup.config.mesh;
        let mesh = self.backend.whole_mesh(&config)?;
        let painted = paint::paint(&mesh, self.setup.config.map.voxel_size_m, &self.log, observer)?;
        let before = self.setup.load_map.as_deref().map(Colors::read_beside).transpose()?;
        let mut colors = match before.flatten() {
            Some(colors) => colors,
            None => Colors::beside(&self.setup.config.map)?,
        };
        colors.add(&mesh, &painted)?;
        self.layers.colors = Some(colors);
        let scene = self.scene();
        if surface::is_tileset(path) {
            let report = self.backend.write_surface(&config, path, &scene, &self.layers)?;
            let color = ColorReport {
                images: painted.images,
                ..ColorReport::default()
            };
            return Ok(MeshReport {
                color: Some(color),
                ..report
            });
        }
        // Finer than the layers: what each vertex was seen as.
        let painting = Painting {
            colors: Some(painted),
            intensities: self.layers.intensity.as_ref().map(|layer| layer.of_vertices(&mesh)),
        };
        let seconds = start.elapsed().as_secs_f64();
        let report = surface::write_painted(&mesh, &painting, path, &scene)?;
        Ok(MeshReport { seconds, ..report })
    }

    /// What a page shows beside the surface.
    fn scene(&self) -> Scene {
        scene::of_run(
            &self.name,
            &self.setup.config,
            &self.totals(),
            &self.map_report(),
            &self.poses,
        )
    }

    /// Writes the poses of the scans so far: as TUM where all have times, else as KITTI.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_poses(&self, path: &Path) -> Result<()> {
        tracking::write_poses(path, &self.poses)
    }

    /// Writes what is known of the log's first sensor, the errors included that refinement found.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_sensor(&self, path: &Path) -> Result<()> {
        let (correction, mounting) = match &self.placer {
            Placer::Refinement(placed) => (placed.correction.as_ref(), placed.mounting.as_ref()),
            Placer::Log | Placer::Odometry(_) => (None, None),
        };
        tracking::write_sensor(path, &self.log, correction, mounting)
    }

    /// Saves the map of the scans so far, with their poses; intensities and colours, as far as they are known, as layers of their own
    /// beside it ([`Layers::read_beside`]).
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_map(&mut self, path: &Path) -> Result<SavedMap> {
        if let Some(layer) = &self.layers.intensity {
            layer.save(&Intensity::path_beside(path))?;
        }
        self.save_colors(path)?;
        self.backend.save(path, &self.poses)
    }

    /// Saves the colours, if they are known, beside a saved map.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save_colors(&self, map: &Path) -> Result<()> {
        let colors = self.layers.colors.as_ref();
        colors.map_or(Ok(()), |colors| colors.save_beside(map))
    }

    /// Writes a picture of the whole map.
    ///
    /// # Errors
    /// [`RunError::Nothing`] for a map without surface; if the file cannot be written.
    pub fn write_preview(&mut self, path: &Path) -> Result<ViewReport> {
        let mut report = None;
        let driven: Vec<_> = self.poses.iter().map(|fused| fused.pose.translation).collect();
        let mut look = |see: view::See<'_>| {
            report = Some(view::preview(see, &driven, path)?);
            Ok(())
        };
        self.backend.viewer(self.setup.config.mesh.min_weight, &mut look)?;
        report.ok_or_else(|| RunError::Nothing("the map has no surface".to_owned()))
    }
}
