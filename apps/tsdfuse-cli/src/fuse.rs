//! `tsdfuse fuse`: scans and poses in, a mesh or a map out.

mod args;
mod growing;
mod load;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use tsdfuse::index::BlockIndex;
use tsdfuse::scan::RangeLimits;
use tsdfuse::{Integrator, Scan, SensorModel, VoxelMap};
use tsdfuse_io::{Dataset, ReadScan};

pub(crate) use args::Args;
use growing::Growing;
pub(crate) use growing::GrowthReport;
pub(crate) use load::LoadedMap;
use load::Loading;

use crate::config::{RunConfig, Suggested};
use crate::exit::{Outcome, one_line};
use crate::mesh::surface;
use crate::progress::{self, say};
use crate::render::preview;
use crate::report::{
    DatasetReport, FinishReport, MapReport, Report, SavedMap, ScanReport, SkippedScan, Sums, Totals, command_line,
    left_out, peak_memory_bytes, print_json,
};
use crate::settings::{Settings, split};

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let start = Instant::now();
    let settings = &args.settings;
    let mut layers = settings.layers(args.method.as_deref())?;
    args.check_outputs()?;
    settings.set_threads()?;
    let dataset = settings.open()?;
    let (indices, _) = split(&settings.indices(dataset.len())?, args.hold_out)?;
    let suggested = Suggested::by(&dataset);
    let loading = args.load_map.as_deref().map(Loading::open).transpose()?;
    loading.iter().try_for_each(|loading| loading.suggest(&mut layers))?;
    let config = layers.resolve(&suggested)?;

    let mut fusion = Fusion::new(settings, &config, suggested.sensor.as_ref())?;
    let mut loaded_map = None;
    if let Some(loading) = loading {
        loading.check(&config, suggested.sensor.is_some())?;
        let (map, loaded) = loading.map()?;
        (fusion.map, loaded_map) = (map, Some(loaded));
    }
    fusion.growing = args.growing(&config.mesh, &fusion.map);
    let fusing = Instant::now();
    fusion.fuse_all(&dataset, indices)?;
    let finish = fusion.finish();
    let growth = fusion.growing.take().map(|growing| growing.report);
    let fusing_seconds = fusing.elapsed().as_secs_f64() - growth.as_ref().map_or(0.0, |growth| growth.seconds);
    let save = |path| SavedMap::write(&fusion.map, path);
    let saved_map = args.save_map.as_deref().map(save).transpose()?;
    let extract = |path| surface(&fusion.map, &config.mesh, path);
    let mesh = args.output.as_deref().map(extract).transpose()?;
    let picture = |path| preview(&fusion.map, config.mesh.min_weight, path);
    let preview = args.preview.as_deref().map(picture).transpose()?;

    let report = Report {
        version: env!("CARGO_PKG_VERSION"),
        command_line: command_line(),
        threads: rayon::current_num_threads(),
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
        loaded_map,
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
        self.fuse_some(dataset, indices)?;
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
        let done = self.integrator.integrate(&mut self.map, &scan);
        let done = done.with_context(|| self.dataset.display().to_string())?;
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
