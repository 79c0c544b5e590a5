//! `--memory` and `--store`: a map of which only a part is in memory, and that outlives a crash.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use tsdfuse::fuse::{FuseConfig, Method, RoldaoForm};
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::mesh::MeshConfig;
use tsdfuse::scan::Scan;
use tsdfuse::{MapConfig, Pose, SensorModel, VoxelMap};
use tsdfuse_io::map_file::{Reader, Writer};
use tsdfuse_store::{Options, Pager, StoreError};

use super::args::{Args, Memory};
use super::hidden::{Removed, hidden_store, remove_stale};
use crate::config::RunConfig;
use crate::exit::Usage;
use crate::mesh::{check_in_parts, surface_in_parts};
use crate::progress::{note, say};
use crate::report::{MapReport, MeshReport, SavedMap, SkippedScan, Sums, command_line};

/// Scans whose regions are read ahead.
pub(super) const AHEAD: usize = 3;

/// How far a run has come: what a store holds beside the map.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Progress {
    /// The arguments of the run, and where it was started.
    pub(super) arguments: Vec<String>,
    pub(super) folder: PathBuf,
    /// What these, and what they name, came to.
    pub(super) config: RunConfig,
    /// The sensor, stated or guessed.
    pub(super) sensor: Option<SensorModel>,
    /// Whether the map that is continued, if any, is in the store.
    pub(super) is_loaded: bool,
    /// Scans that were asked for, how many of them are done, and how many of these were fused.
    pub(super) asked: usize,
    pub(super) done: usize,
    pub(super) fused: usize,
    pub(super) sums: Sums,
    pub(super) skipped: Vec<SkippedScan>,
}

/// What a store holds, as of its last commit.
#[derive(Debug)]
pub(crate) struct Stored {
    pub(crate) config: MapConfig,
    pub(crate) map: MapReport,
    /// Scans that are done, and that were asked for.
    pub(crate) scans: [usize; 2],
}

impl Stored {
    pub(crate) fn open(store: &Path) -> Result<Self> {
        let Resumed { map, pager, progress } = Resumed::open(store)?;
        Ok(Self {
            config: *map.config(),
            map: MapReport::of_store(&pager, &map),
            scans: [progress.done, progress.asked],
        })
    }
}

/// What was done for a map that is not all in memory.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PagingReport {
    /// The most that blocks were to take in memory.
    limit_bytes: Option<usize>,
    /// The most that they took.
    most_bytes: usize,
    /// The file.
    store_bytes: u64,
    commits: usize,
    /// Bringing regions and taking them away.
    paging_seconds: f64,
    commit_seconds: f64,
}

impl PagingReport {
    /// A line for people, about a drive of this length.
    pub(crate) fn text(&self, length_km: f64) -> String {
        let bytes = |bytes: usize| indicatif::BinaryBytes(bytes as u64);
        format!(
            "blocks in memory: {} at most, {} wanted; file: {} ({} per km); paging {:.1} s, commits {:.1} s\n",
            bytes(self.most_bytes),
            self.limit_bytes
                .map_or_else(|| "all".to_owned(), |limit| bytes(limit).to_string()),
            bytes(self.store_bytes as usize),
            bytes((self.store_bytes as f64 / length_km) as usize),
            self.paging_seconds,
            self.commit_seconds,
        )
    }
}

/// Pages a map while scans are fused into it.
pub(super) struct Paging {
    pager: Pager,
    /// Of a run that wants no store but for its memory; gone afterwards.
    temporary: Option<Removed>,
    limit_bytes: Option<usize>,
    commit_every: Option<usize>,
    method: Method,
    options: FuseConfig,
    pub(super) progress: Progress,
    is_over: bool,
    commits: usize,
    paging_seconds: f64,
    commit_seconds: f64,
}

impl Progress {
    /// Of a run that begins.
    pub(super) fn begin(config: &RunConfig, sensor: Option<&SensorModel>, asked: usize) -> Result<Self> {
        Ok(Self {
            arguments: command_line(),
            folder: std::env::current_dir().context("the current folder")?,
            config: config.clone(),
            sensor: sensor.cloned(),
            is_loaded: false,
            asked,
            done: 0,
            fused: 0,
            sums: Sums::default(),
            skipped: Vec::new(),
        })
    }

    pub(super) fn parse(store: &Path, bytes: &[u8]) -> Result<Self> {
        let progress = serde_json::from_slice(bytes);
        progress.with_context(|| format!("{}: is no store of a run of tsdfuse fuse", store.display()))
    }
}

/// A store that was opened again.
pub(super) struct Resumed {
    pub(super) map: VoxelMap,
    pub(super) pager: Pager,
    pub(super) progress: Progress,
}

impl Paging {
    /// `None` if the whole map is to be in memory only.
    pub(super) fn begin(args: &Args, map: &VoxelMap, begun: impl FnOnce() -> Result<Progress>) -> Result<Option<Self>> {
        let store = match (&args.store, args.memory) {
            (None, None) => return Ok(None),
            (Some(store), _) => store.clone(),
            (None, Some(_)) => args.hidden_store()?,
        };
        let progress = begun()?;
        args.check_paging(&progress.config)?;
        let every = args.store.is_some().then_some(args.commit_every as usize);
        Self::create(store, args.memory, every, map, progress).map(Some)
    }

    /// With a new store, which is temporary unless it is committed to.
    fn create(
        store: PathBuf,
        memory: Option<Memory>,
        commit_every: Option<usize>,
        map: &VoxelMap,
        progress: Progress,
    ) -> Result<Self> {
        let pager = Pager::create(&store, map, &serde_json::to_vec(&progress)?, options(memory))?;
        let mut paging = Self::new(pager, memory, commit_every, progress);
        paging.temporary = commit_every.is_none().then(|| Removed(store));
        Ok(paging)
    }

    /// With no more memory than this, and a store that is gone afterwards.
    pub(super) fn with_memory(memory: Memory, store: PathBuf, map: &VoxelMap, config: &RunConfig) -> Result<Self> {
        Self::create(store, Some(memory), None, map, Progress::begin(config, None, 0)?)
    }

    /// Goes on with a store.
    ///
    /// # Errors
    /// If the run that was stored had other settings, or other data.
    pub(super) fn resume(args: &Args, mut pager: Pager, progress: Progress, begun: &Progress) -> Result<Self> {
        let store = pager.path().display();
        if progress.config != begun.config {
            bail!("{store}: its run had other settings; a file that --config names has changed, perhaps");
        }
        if args.load_map.is_some() && !progress.is_loaded {
            bail!(
                "{store}: the run ended before all of the map that it continues was stored; remove the store and run it again"
            );
        }
        if progress.asked != begun.asked {
            bail!(
                "{store}: its run had {} scans, and now there are {}",
                progress.asked,
                begun.asked
            );
        }
        pager.set_options(options(args.memory));
        let every = Some(args.commit_every as usize);
        Ok(Self::new(pager, args.memory, every, progress))
    }

    fn new(pager: Pager, memory: Option<Memory>, commit_every: Option<usize>, progress: Progress) -> Self {
        Self {
            pager,
            temporary: None,
            commit_every,
            limit_bytes: memory.map(|memory| memory.0),
            method: progress.config.method,
            options: progress.config.methods(),
            progress,
            is_over: false,
            commits: 0,
            paging_seconds: 0.0,
            commit_seconds: 0.0,
        }
    }

    /// Before a scan is fused: brings what it can touch. Scans after it will be at the poses `next`.
    pub(super) fn before(&mut self, map: &mut VoxelMap, scan: &Scan, next: &[Pose]) -> Result<()> {
        let start = Instant::now();
        if self.progress.sensor.is_none() && self.progress.config.wants_sensor() {
            // As the method does that is not told of a sensor.
            self.progress.sensor = tsdfuse::sensor::guess(&scan.points, scan.rings.as_deref());
        }
        let reach = self.method.reach(&self.options, map.config(), scan);
        self.pager.bring(map, &reach)?;
        for pose in next {
            self.pager.expect(map, &reach.at(pose.translation))?;
        }
        self.paging_seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// After it was fused.
    pub(super) fn after(&mut self, map: &mut VoxelMap, updated: &[BlockIndex]) -> Result<()> {
        let start = Instant::now();
        self.pager.note(map, updated)?;
        if !self.pager.release(map)? && !self.is_over {
            self.is_over = true;
            note(format_args!(
                "--memory: what a scan can touch takes more, {}",
                indicatif::BinaryBytes(map.memory_bytes() as u64)
            ));
        }
        self.paging_seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Counts a scan that is done, fused or not; whether it is time to commit.
    pub(super) fn scan_done(&mut self) -> bool {
        self.progress.done += 1;
        self.commit_every
            .is_some_and(|every| self.progress.done.is_multiple_of(every))
    }

    /// Says how many scans are stored.
    pub(super) fn say_stored(&self) {
        let Progress { done, asked, .. } = self.progress;
        say(format_args!(
            "  stored   {done} of {asked} scans in {}",
            self.pager.path().display()
        ));
    }

    /// Makes the map and the progress so far what is there after a crash.
    pub(super) fn commit(&mut self, map: &mut VoxelMap) -> Result<()> {
        let start = Instant::now();
        self.pager.commit(map, &serde_json::to_vec(&self.progress)?)?;
        self.commits += 1;
        self.commit_seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    pub(super) fn report(&self) -> PagingReport {
        PagingReport {
            limit_bytes: self.limit_bytes,
            most_bytes: self.pager.most_bytes(),
            store_bytes: std::fs::metadata(self.pager.path()).map_or(0, |file| file.len()),
            commits: self.commits,
            paging_seconds: self.paging_seconds,
            commit_seconds: self.commit_seconds,
        }
    }

    /// The whole map, after the last commit.
    pub(super) fn map_report(&self, map: &VoxelMap) -> MapReport {
        MapReport::of_store(&self.pager, map)
    }

    /// Puts a saved map into the store, for good; tells how many blocks it has.
    pub(super) fn load(&mut self, map: &mut VoxelMap, reader: Reader<impl std::io::Read>) -> Result<usize> {
        map.set_integrations(reader.integrations());
        let (mut failed, mut last, mut blocks) = (None::<anyhow::Error>, None, 0);
        let path = self.pager.path().to_owned();
        reader.for_each_block(|index, block| {
            let region = RegionIndex::of(index);
            // Regions come one after the other, or (version 1) in layers.
            if last.replace(region) != Some(region) && failed.is_none() {
                failed = self.pager.turn_to(map, &[region]).err().map(Into::into);
            }
            if failed.is_some() {
                return Ok(());
            }
            map.insert_block(index, block)?;
            blocks += 1;
            failed = self.pager.note(map, &[index]).err().map(Into::into);
            Ok(())
        })?;
        if let Some(error) = failed {
            return Err(error.context(path.display().to_string()));
        }
        self.progress.is_loaded = true;
        self.commit(map)?;
        Ok(blocks)
    }

    /// Saves the whole map.
    pub(super) fn save(&mut self, map: &mut VoxelMap, path: &Path) -> Result<SavedMap> {
        save_in_parts(map, &mut self.pager, path)
    }

    /// Extracts the surface of the whole map, which must not be empty, and writes it.
    pub(super) fn surface(&mut self, map: &mut VoxelMap, config: &MeshConfig, path: &Path) -> Result<MeshReport> {
        surface_in_parts(map, &mut self.pager, config, path)
    }
}

/// Saves a map that is not all in memory.
pub(crate) fn save_in_parts(map: &mut VoxelMap, pager: &mut Pager, path: &Path) -> Result<SavedMap> {
    let start = Instant::now();
    let mut failed: Option<anyhow::Error> = None;
    tsdfuse_io::atomic::write(path, |out| {
        let mut writer = Writer::new(out, map.config(), map.integrations())?;
        let saved = pager.for_each_region(map, |map, region| {
            let mut blocks = map.blocks_of(region);
            Ok(blocks.try_for_each(|(index, block)| writer.block(index, block))?)
        });
        saved.map_err(|error: StoreError| match error {
            StoreError::Sink(error) => error,
            error => {
                failed = Some(error.into());
                std::io::Error::other("the store cannot be read")
            }
        })?;
        writer.finish().map(drop)
    })
    .map_err(|error| failed.unwrap_or_else(|| error.into()))?;
    Ok(SavedMap::written(path, start))
}

fn options(memory: Option<Memory>) -> Options {
    Options {
        limit_bytes: memory.map_or(usize::MAX, |memory| memory.0),
    }
}

impl Resumed {
    /// Opens the store of a run.
    pub(super) fn open(store: &Path) -> Result<Self> {
        // The limit stands among the arguments.
        let (map, pager, note) = Pager::open(store, options(None))?;
        let progress = Progress::parse(store, &note)?;
        Ok(Self { map, pager, progress })
    }
}

impl Args {
    /// A store that nobody asked for, beside the first result.
    fn hidden_store(&self) -> Result<PathBuf> {
        let result = self.output.as_ref().or(self.save_map.as_ref());
        let result = result.context("--memory needs --output or --save-map")?;
        let store = hidden_store(result);
        remove_stale(&store);
        Ok(store)
    }

    /// Refuses what needs the whole map, or what a store cannot hold.
    fn check_paging(&self, config: &RunConfig) -> Result<()> {
        let reason = if config.method == Method::Roldao && config.roldao.form == RoldaoForm::Batch {
            "roldao.form = batch keeps the points of all scans in memory"
        } else if self.mesh_every.is_some() {
            "--mesh-every needs the whole map in memory"
        } else if self.preview.is_some() {
            "--preview needs the whole map in memory"
        } else if let Some(Err(reason)) = self.output.as_deref().map(check_in_parts) {
            reason
        } else {
            return Ok(());
        };
        Err(Usage::new(format_args!("--memory and --store: {reason}")).into())
    }
}
