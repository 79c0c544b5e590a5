//! `tsdfuse fuse`: scans and poses in, a mesh or a map out.

mod args;
mod growing;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::MeshConfig;
use tsdfuse::scan::RangeLimits;
use tsdfuse::{Integration, Integrator, Scan, SensorModel, VoxelMap};
use tsdfuse_io::{Dataset, ReadScan};

pub(crate) use args::Args;
use growing::Growing;
pub(crate) use growing::GrowthReport;

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
    let start = Instant::now();
    let settings = &args.settings;
    let layers = settings.layers(args.method.as_deref())?;
    args.check_outputs()?;
    settings.set_threads()?;
    let dataset = settings.open()?;
    let (indices, _) = split(&settings.indices(dataset.len())?, args.hold_out)?;
    let suggested = Suggested::by(&dataset);
    let config = layers.resolve(&suggested)?;

    let mut fusion = Fusion::new(settings, &config, suggested.sensor.as_ref())?;
    fusion.device = args.device.open(&config, suggested.sensor.as_ref())?;
    let device = fusion.device.as_ref().map(|device| device.name());
    fusion.growing = args.growing(&config.mesh);
    let fusing = Instant::now();
    fusion.fuse_all(&dataset, indices)?;
    let finish = fusion.finish();
    let growth = fusion.growing.take().map(|growing| growing.report);
    let fusing_seconds = fusing.elapsed().as_secs_f64() - growth.as_ref().map_or(0.0, |growth| growth.seconds);
    let save = |path| SavedMap::write(&fusion.map, path);
    let saved_map = args.save_map.as_deref().map(save).transpose()?;
    let extract = |path| fusion.surface(&config.mesh, path);
    let mesh = args.output.as_deref().map(extract).transpose()?;
    let picture = |path| preview(&fusion.map, config.mesh.min_weight, path);
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
            scans: fusion.scans.len(),
            sums: fusion.sums(),
            finish,
            seconds: fusing_seconds,
        },
        map: MapReport::of(&fusion.map),
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
            scans: Vec::new(),
            skipped: Vec::new(),
        })
    }

    /// Fuses the scans in order; one that cannot be used ends the run, unless it may be skipped.
    ///
    /// # Errors
    /// Also if none of all the scans could be fused.
    pub(crate) fn fuse_all(&mut self, dataset: &Dataset, indices: Vec<usize>) -> Result<()> {
        let fused = self.fuse_some(dataset, indices);
        self.leave_device(fused)?;
        self.check()
    }

    /// Fuses more scans; that none of them could be fused is no error yet.
    pub(crate) fn fuse_some(&mut self, dataset: &Dataset, indices: Vec<usize>) -> Result<()> {
        let bar = progress::scans("fusing", indices.len());
        let mut reading = dataset.iter_indices(indices);
        loop {
            let waiting = Instant::now();
            let Some(read) = reading.next() else { break };
            let (index, wait) = (read.index, waiting.elapsed().as_secs_f64());
            match self.fuse(read, wait) {
                Ok((scan, updated)) => {
                    self.scans.push(scan);
                    if let Some(growing) = &mut self.growing {
                        growing.follow(&self.map, &updated)?;
                    }
                }
                Err(error) if self.skip_bad => self.skip(&dataset.scans()[index].name, one_line(&error), &bar),
                Err(error) => return Err(error),
            }
            bar.inc(1);
        }
        Ok(())
    }

    /// Whether anything was fused.
    fn check(&self) -> Result<()> {
        let data = self.dataset.display();
        if self.scans.is_empty() {
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
    fn fuse(&mut self, read: ReadScan, wait: f64) -> Result<(ScanReport, Vec<BlockIndex>)> {
        let mut scan: Scan = read.scan?;
        let start = Instant::now();
        scan.drop_invalid(&self.range);
        let dropping = start.elapsed().as_secs_f64();
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

    /// Extracts the mesh, where the map was made, and writes it.
    fn surface(&self, config: &MeshConfig, path: &Path) -> Result<MeshReport> {
        match &self.device {
            Some(device) => surface_by(|| device.mesh(config), &self.map, config, path),
            None => surface(&self.map, config, path),
        }
    }

    fn skip(&mut self, name: &str, reason: String, bar: &ProgressBar) {
        bar.suspend(|| say(format_args!("tsdfuse: warning: {name} is skipped: {reason}")));
        let name = name.to_owned();
        self.skipped.push(SkippedScan { name, reason });
    }

    pub(crate) fn sums(&self) -> Sums {
        let mut sums = Sums::default();
        self.scans.iter().for_each(|scan| sums += &scan.sums);
        sums
    }
}
