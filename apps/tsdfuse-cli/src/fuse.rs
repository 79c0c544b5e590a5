//! `tsdfuse fuse`: scans and poses in, a mesh or a map out.

mod args;
mod growing;
mod hidden;
mod load;
mod paging;
mod resume;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::MeshConfig;
use tsdfuse::scan::RangeLimits;
use tsdfuse::{Integration, Integrator, Pose, Scan, SensorModel, VoxelMap};
use tsdfuse_io::{Dataset, ReadScan};

pub(crate) use args::{Args, Memory};
use growing::Growing;
pub(crate) use growing::GrowthReport;
pub(crate) use load::LoadedMap;
use load::Loading;
use paging::{AHEAD, Paging, Progress, Resumed};
pub(crate) use paging::{PagingReport, Stored, save_in_parts};
pub(crate) use resume::{Args as ResumeArgs, run as resume};

use crate::config::{RunConfig, Suggested};
use crate::device::{OnDevice, Settled, gpu::is_full};
use crate::exit::{Outcome, one_line};
use crate::mesh::{surface, surface_by};
use crate::progress::{self, say};
use crate::render::preview;
use crate::report::{
    DatasetReport, FinishReport, MapReport, MeshReport, Report, SavedMap, ScanReport, SkippedScan, Sums, Totals,
    command_line, left_out, peak_memory_bytes, print_json,
};
use crate::settings::{Settings, split};

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    run_from(args, None)
}

/// Fuses, from the beginning or from where a store has come to.
fn run_from(args: &Args, resumed: Option<Resumed>) -> Result<Outcome> {
    let start = Instant::now();
    let settings = &args.settings;
    let mut layers = settings.layers(args.method.as_deref())?;
    args.check_outputs()?;
    settings.set_threads()?;
    let dataset = settings.open()?;
    let (mut indices, _) = split(&settings.indices(dataset.len())?, args.hold_out)?;
    let suggested = Suggested::by(&dataset);
    let loading = args.load_map.as_deref().map(Loading::open).transpose()?;
    loading.iter().try_for_each(|loading| loading.suggest(&mut layers))?;
    let config = layers.resolve(&suggested)?;

    let begun = || Progress::begin(&config, suggested.sensor.as_ref(), indices.len());
    let sensor = resumed
        .as_ref()
        .map_or(&suggested.sensor, |resumed| &resumed.progress.sensor);
    let mut fusion = Fusion::new(settings, &config, sensor.as_ref())?;
    let mut loaded_map = None;
    match resumed {
        Some(Resumed { map, pager, progress }) => {
            (fusion.map, fusion.earlier) = (map, (progress.fused, progress.sums));
            fusion.skipped.clone_from(&progress.skipped);
            fusion.paging = Some(Paging::resume(args, pager, progress, &begun()?)?);
        }
        None => {
            loading
                .iter()
                .try_for_each(|loading| loading.check(&config, suggested.sensor.is_some()))?;
            fusion.paging = Paging::begin(args, &fusion.map, begun)?;
            let read = |loading: Loading| loading.read(&mut fusion.map, fusion.paging.as_mut());
            loaded_map = loading.map(read).transpose()?;
        }
    }
    let indices = indices.split_off(fusion.done().min(indices.len()));
    fusion.growing = args.growing(&config.mesh, &fusion.map);
    fusion.device = args.device.open(&fusion.map, &config, suggested.sensor.as_ref())?;
    let device = fusion.device.as_ref().map(|device| device.name());
    let fusing = Instant::now();
    fusion.fuse_all(&dataset, indices)?;
    let finish = fusion.finish();
    let growth = fusion.growing.take().map(|growing| growing.report);
    let fusing_seconds = fusing.elapsed().as_secs_f64() - growth.as_ref().map_or(0.0, |growth| growth.seconds);
    let saved_map = args.save_map.as_deref().map(|path| fusion.save(path)).transpose()?;
    let extract = |path| fusion.surface(&config.mesh, path);
    let mesh = args.output.as_deref().map(extract).transpose()?;
    let picture = |path| preview(&fusion.map, fusion.device.as_deref(), config.mesh.min_weight, path);
    let preview = args.preview.as_deref().map(picture).transpose()?;

    let report = Report {
        version: env!("CARGO_PKG_VERSION"),
        command_line: command_line(),
        threads: rayon::current_num_threads(),
        device,
        dataset: DatasetReport {
            path: settings.dataset.clone(),
            format: dataset.format(),
            scans: dataset.len(),
            sensor: suggested.sensor,
            camera: suggested.camera,
            notes: dataset.notes().to_vec(),
        },
        config,
        totals: Totals {
            scans: fusion.earlier.0 + fusion.scans.len(),
            sums: fusion.sums(),
            finish,
            seconds: fusing_seconds,
        },
        loaded_map,
        map: fusion.map_report(),
        paging: fusion.paging.as_ref().map(Paging::report),
        scans: fusion.scans,
        skipped_scans: fusion.skipped,
        saved_map,
        growth,
        mesh,
        preview,
        peak_memory_bytes: peak_memory_bytes(),
        wall_seconds: start.elapsed().as_secs_f64(),
    };
    if let Some(path) = &args.report {
        report.write(path)?;
    }
    report.summarize();
    if args.json {
        print_json(&report)?;
    }
    if let Some(error) = fusion.full {
        return Err(error.context("only the scans before are in the result"));
    }
    Ok(if report.skipped_scans.is_empty() {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}

/// A map that grows scan by scan, and what became of each scan.
pub(crate) struct Fusion {
    /// The data set's path, for messages.
    dataset: PathBuf,
    skip_bad: bool,
    integrator: Box<dyn Integrator>,
    /// What fuses instead, and still has the map when all scans are fused.
    device: Option<Box<dyn OnDevice>>,
    /// Scans whose reports are complete.
    settled: usize,
    /// Why not all scans are in the map.
    full: Option<anyhow::Error>,
    pub(crate) map: VoxelMap,
    range: RangeLimits,
    growing: Option<Growing>,
    paging: Option<Paging>,
    /// Scans that were fused before a break, and their sums.
    earlier: (usize, Sums),
    pub(crate) scans: Vec<ScanReport>,
    pub(crate) skipped: Vec<SkippedScan>,
}

impl Fusion {
    /// An empty map.
    pub(crate) fn new(settings: &Settings, config: &RunConfig, sensor: Option<&SensorModel>) -> Result<Self> {
        Ok(Self {
            dataset: settings.dataset.clone(),
            skip_bad: settings.skip_bad,
            integrator: config.method.build(&config.methods(), sensor),
            device: None,
            settled: 0,
            full: None,
            map: VoxelMap::new(config.map)?,
            range: config.range,
            growing: None,
            paging: None,
            earlier: (0, Sums::default()),
            scans: Vec::new(),
            skipped: Vec::new(),
        })
    }

    /// From now on, keeps no more of the map in memory than this, and the others in a file that is gone afterwards.
    pub(crate) fn limit(&mut self, memory: Memory, store: PathBuf, config: &RunConfig) -> Result<()> {
        self.paging = Some(Paging::with_memory(memory, store, &self.map, config)?);
        Ok(())
    }

    /// How much the map holds, with that in a file, and what was done for that.
    pub(crate) fn state(&self) -> (MapReport, Option<PagingReport>) {
        (self.map_report(), self.paging.as_ref().map(Paging::report))
    }

    /// Fuses the scans in order; one that cannot be used ends the run, unless it may be skipped.
    ///
    /// # Errors
    /// Also if none of all the scans could be fused.
    pub(crate) fn fuse_all(&mut self, dataset: &Dataset, indices: Vec<usize>) -> Result<()> {
        let fused = self.fuse_some(dataset, indices);
        self.leave_device(fused)?;
        self.commit()?;
        self.check()
    }

    /// Fuses more scans; that none of them could be fused is no error yet.
    pub(crate) fn fuse_some(&mut self, dataset: &Dataset, indices: Vec<usize>) -> Result<()> {
        let bar = progress::scans("fusing", indices.len());
        let mut next = indices.clone().into_iter().skip(1);
        let mut reading = dataset.iter_indices(indices);
        loop {
            let waiting = Instant::now();
            let Some(read) = reading.next() else { break };
            let (index, wait) = (read.index, waiting.elapsed().as_secs_f64());
            let ahead = next
                .clone()
                .take(AHEAD)
                .filter_map(|index| Some(dataset.scans().get(index)?.pose));
            let ahead: Vec<Pose> = ahead.collect();
            next.next();
            match self.fuse(read, wait, &ahead) {
                Ok((scan, updated)) => {
                    self.scans.push(scan);
                    self.follow(&updated)?;
                }
                Err(error) if self.skip_bad => self.skip(&dataset.scans()[index].name, one_line(&error), &bar),
                Err(error) => return Err(error),
            }
            self.scan_done(&bar)?;
            bar.inc(1);
        }
        Ok(())
    }

    /// Whether anything was fused.
    fn check(&self) -> Result<()> {
        let data = self.dataset.display();
        if self.earlier.0 + self.scans.len() == 0 {
            bail!("{data}: none of its scans could be fused");
        }
        let sums = self.sums();
        if sums.fused == 0 {
            bail!(
                "{data}: none of {} points could be fused{}",
                sums.points,
                left_out(&sums)
            );
        }
        Ok(())
    }

    /// Fuses a scan, and says which blocks changed.
    fn fuse(&mut self, read: ReadScan, wait: f64, ahead: &[Pose]) -> Result<(ScanReport, Vec<BlockIndex>)> {
        let mut scan: Scan = read.scan?;
        let start = Instant::now();
        scan.drop_invalid(&self.range);
        let dropping = start.elapsed().as_secs_f64();
        if let Some(paging) = &mut self.paging {
            paging.before(&mut self.map, &scan, ahead)?;
        }
        let (done, settled) = match &mut self.device {
            None => (
                self.integrator.integrate(&mut self.map, &scan).map_err(Into::into),
                Vec::new(),
            ),
            Some(device) => match device.fuse(&scan) {
                Ok(settled) => (Ok(Integration::default()), settled),
                Err(error) => (Err(error), Vec::new()),
            },
        };
        let done = done.with_context(|| self.dataset.display().to_string())?;
        if let Some(paging) = &mut self.paging {
            paging.after(&mut self.map, &done.updated_blocks)?;
        }
        self.settle(settled);
        let (took, prepare) = (start.elapsed().as_secs_f64(), dropping + done.prepare_secs);
        let scan = ScanReport {
            name: scan.name,
            sums: Sums {
                read: read.read_secs,
                wait,
                prepare,
                fuse: took - prepare,
                find: done.find_secs,
                points: scan.points.len() as u64 + scan.dropped.total(),
                fused: done.fused_returns,
                dropped: scan.dropped,
                skipped: done.skipped,
            },
            updated_blocks: done.updated_blocks.len(),
        };
        Ok((scan, done.updated_blocks))
    }

    /// Keeps the mesh file up to date, if there is one; a device that fuses is waited for.
    fn follow(&mut self, updated: &[BlockIndex]) -> Result<()> {
        let Some(growing) = &mut self.growing else {
            return Ok(());
        };
        let mut settled = Vec::new();
        let followed = growing.follow(updated, |surface, config| match &mut self.device {
            None => Ok(surface.mesh(&self.map)?),
            Some(device) => {
                settled = device.finish()?;
                device.mesh(config)
            }
        });
        self.settle(settled);
        followed
    }

    /// Lets a method that collects scans fuse them.
    pub(crate) fn finish(&mut self) -> FinishReport {
        let start = Instant::now();
        let done = self.integrator.finish(&mut self.map);
        FinishReport {
            seconds: start.elapsed().as_secs_f64(),
            updated_blocks: done.updated_blocks.len(),
        }
    }

    /// Completes the reports of the oldest scans that a device fused.
    fn settle(&mut self, settled: Vec<Settled>) {
        for (scan, done) in self.scans.iter_mut().skip(self.settled).zip(settled) {
            (scan.sums.fused, scan.sums.skipped) = (done.fused, done.skipped);
            scan.updated_blocks = done.updated_blocks;
            self.settled += 1;
        }
    }

    /// Waits for the device, if scans were fused there, and brings the map back. If it is full, the map has the scans before.
    fn leave_device(&mut self, fused: Result<()>) -> Result<()> {
        let Some(device) = &mut self.device else {
            return fused;
        };
        let settled = match fused.and_then(|()| device.finish()) {
            Ok(settled) => settled,
            Err(error) if is_full(&error) => {
                self.full = Some(error);
                Vec::new()
            }
            Err(error) => return Err(error),
        };
        self.map = device.map()?;
        self.settle(settled);
        self.scans.truncate(self.settled);
        Ok(())
    }

    fn skip(&mut self, name: &str, reason: String, bar: &ProgressBar) {
        bar.suspend(|| say(format_args!("tsdfuse: warning: {name} is skipped: {reason}")));
        let name = name.to_owned();
        self.skipped.push(SkippedScan { name, reason });
    }

    /// Scans that a store held already, fused or skipped.
    fn done(&self) -> usize {
        self.paging.as_ref().map_or(0, |paging| paging.progress.done)
    }

    /// Notes that a scan is done, fused or not, and commits if it is time.
    fn scan_done(&mut self, bar: &ProgressBar) -> Result<()> {
        let Some(paging) = &mut self.paging else { return Ok(()) };
        if paging.scan_done() {
            self.commit()?;
            self.paging
                .iter()
                .for_each(|paging| bar.suspend(|| paging.say_stored()));
        }
        Ok(())
    }

    /// Writes all that changed to the store, if there is one: from now on no crash takes it away.
    pub(crate) fn commit(&mut self) -> Result<()> {
        let sums = self.sums();
        let Some(paging) = &mut self.paging else { return Ok(()) };
        paging.progress.fused = self.earlier.0 + self.scans.len();
        paging.progress.sums = sums;
        paging.progress.skipped.clone_from(&self.skipped);
        paging.commit(&mut self.map)
    }

    fn map_report(&self) -> MapReport {
        match &self.paging {
            Some(paging) => paging.map_report(&self.map),
            None => MapReport::of(&self.map),
        }
    }

    fn save(&mut self, path: &Path) -> Result<SavedMap> {
        match &mut self.paging {
            Some(paging) => paging.save(&mut self.map, path),
            None => SavedMap::write(&self.map, path),
        }
    }

    /// Extracts the surface, which must not be empty, and writes it.
    pub(crate) fn surface(&mut self, config: &MeshConfig, path: &Path) -> Result<MeshReport> {
        match (&mut self.paging, &mut self.device) {
            (Some(paging), _) => paging.surface(&mut self.map, config, path),
            (None, Some(device)) => surface_by(|| device.mesh(config), &self.map, config, path),
            (None, None) => surface(&self.map, config, path),
        }
    }

    pub(crate) fn sums(&self) -> Sums {
        let mut sums = self.earlier.1;
        self.scans.iter().for_each(|scan| sums += &scan.sums);
        sums
    }
}
