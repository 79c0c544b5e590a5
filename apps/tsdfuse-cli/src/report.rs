//! What a run did, as `report.json` and as a few lines for people.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use indicatif::{BinaryBytes, HumanCount};
use serde::{Deserialize, Serialize};
use tsdfuse::fuse::Skipped;
use tsdfuse::scan::Dropped;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Mesh, SensorModel, VoxelMap};
use tsdfuse_store::Pager;

use crate::config::RunConfig;
use crate::fuse::{GrowthReport, LoadedMap, PagingReport};
use crate::progress::say;
use crate::render::ViewReport;

/// The arguments as they were given, the program's name first.
pub(crate) fn command_line() -> Vec<String> {
    std::env::args_os().map(|a| a.to_string_lossy().into_owned()).collect()
}

/// Everything about one run of `tsdfuse fuse`. Times are seconds of wall time.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    /// The program's version.
    pub(crate) version: &'static str,
    /// The arguments as they were given, the program's name first.
    pub(crate) command_line: Vec<String>,
    /// Threads that fused.
    pub(crate) threads: usize,
    /// The GPU that fused, if one did.
    pub(crate) device: Option<String>,
    /// What was read.
    pub(crate) dataset: DatasetReport,
    /// With what it was fused.
    pub(crate) config: RunConfig,
    /// Each scan that was fused.
    pub(crate) scans: Vec<ScanReport>,
    /// Each scan that could not be used.
    pub(crate) skipped_scans: Vec<SkippedScan>,
    /// Sums over all scans.
    pub(crate) totals: Totals,
    /// The map that was continued.
    pub(crate) loaded_map: Option<LoadedMap>,
    /// The map after the last scan.
    pub(crate) map: MapReport,
    /// The file that the map was saved to.
    pub(crate) saved_map: Option<SavedMap>,
    /// The surface, if it was asked for.
    pub(crate) mesh: Option<MeshReport>,
    /// What was done for a map that is not all in memory.
    pub(crate) paging: Option<PagingReport>,
    /// What became of the mesh file before that, if it was kept up to date.
    pub(crate) growth: Option<GrowthReport>,
    /// The picture of the result, if it was asked for.
    pub(crate) preview: Option<ViewReport>,
    /// The most memory that the process held, where the system tells.
    pub(crate) peak_memory_bytes: Option<u64>,
    /// From start to the last file that was finished, but this report.
    pub(crate) wall_seconds: f64,
}

/// What was read.
#[derive(Debug, Serialize)]
pub(crate) struct DatasetReport {
    pub(crate) path: PathBuf,
    pub(crate) format: &'static str,
    /// Scans there are, of which some were asked for.
    pub(crate) scans: usize,
    /// Its sensor, where it or the user states it.
    pub(crate) sensor: Option<SensorModel>,
    /// Its camera, where the scans are depth images.
    pub(crate) camera: Option<Pinhole>,
    /// What is missing or odd.
    pub(crate) notes: Vec<String>,
}

/// One scan: `points` are all that were in the file, each of them either fused, dropped or skipped.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct ScanReport {
    pub(crate) name: String,
    #[serde(flatten)]
    pub(crate) sums: Sums,
    /// Blocks of the map that were made or updated.
    pub(crate) updated_blocks: usize,
}

/// What can be added over scans.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Sums {
    /// Reading and decoding, in the background.
    pub(crate) read: f64,
    /// Waiting for that.
    pub(crate) wait: f64,
    /// Leaving out invalid returns, placing the others, normals, ….
    pub(crate) prepare: f64,
    /// Updating the map.
    pub(crate) fuse: f64,
    /// Of that, finding out which parts of the map returns reach into.
    pub(crate) find: f64,
    pub(crate) points: u64,
    pub(crate) fused: u64,
    /// Not measurements.
    pub(crate) dropped: Dropped,
    /// Measurements that the method had no use for.
    pub(crate) skipped: Skipped,
}

/// Sums over all scans.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Totals {
    pub(crate) scans: usize,
    #[serde(flatten)]
    pub(crate) sums: Sums,
    /// What a method that collects scans did after the last one.
    pub(crate) finish: FinishReport,
    /// From the first scan to the last and the finish, waiting for files included.
    pub(crate) seconds: f64,
}

/// A scan that could not be used.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SkippedScan {
    pub(crate) name: String,
    pub(crate) reason: String,
}

/// What was done after the last scan.
#[derive(Debug, Default, Serialize)]
pub(crate) struct FinishReport {
    pub(crate) seconds: f64,
    /// Blocks of the map that were made or updated.
    pub(crate) updated_blocks: usize,
}

/// The map after the last scan.
#[derive(Debug, Default, Serialize)]
pub(crate) struct MapReport {
    pub(crate) blocks: usize,
    pub(crate) observed_voxels: usize,
    pub(crate) bytes: usize,
}

/// The file that the map was saved to.
#[derive(Debug, Serialize)]
pub(crate) struct SavedMap {
    pub(crate) path: PathBuf,
    pub(crate) bytes: u64,
    /// Writing it.
    pub(crate) seconds: f64,
}

/// The surface.
#[derive(Debug, Default, Serialize)]
pub(crate) struct MeshReport {
    pub(crate) path: PathBuf,
    pub(crate) vertices: usize,
    pub(crate) triangles: usize,
    /// Extracting it.
    pub(crate) seconds: f64,
    /// Writing it, where that comes afterwards.
    pub(crate) write_seconds: f64,
    /// What it is written as, if not as one file.
    pub(crate) tiles: Option<TilesReport>,
}

/// A surface as 3D Tiles.
#[derive(Debug, Serialize)]
pub(crate) struct TilesReport {
    pub(crate) tiles: usize,
    /// The most that lie one below the other.
    pub(crate) levels: usize,
    /// Of all files.
    pub(crate) bytes: u64,
}

impl std::ops::AddAssign<&Sums> for Sums {
    fn add_assign(&mut self, other: &Self) {
        self.read += other.read;
        self.wait += other.wait;
        self.prepare += other.prepare;
        self.fuse += other.fuse;
        self.find += other.find;
        self.points += other.points;
        self.fused += other.fused;
        self.dropped += other.dropped;
        self.skipped += other.skipped;
    }
}

impl MapReport {
    pub(crate) fn of(map: &VoxelMap) -> Self {
        Self {
            blocks: map.block_count(),
            observed_voxels: map.observed_voxel_count(),
            bytes: map.memory_bytes(),
        }
    }

    /// Of a map that is paged, as of the last commit; its bytes are those in memory.
    pub(crate) fn of_store(pager: &Pager, map: &VoxelMap) -> Self {
        let sizes = pager.sizes();
        Self {
            blocks: sizes.blocks as usize,
            observed_voxels: sizes.observed_voxels as usize,
            bytes: map.memory_bytes(),
        }
    }

    /// A line for people.
    pub(crate) fn summarize(&self, peak_memory_bytes: Option<u64>) {
        say(format_args!(
            "  map      {} blocks, {} voxels observed, {}{}",
            HumanCount(self.blocks as u64),
            HumanCount(self.observed_voxels as u64),
            BinaryBytes(self.bytes as u64),
            peak_memory_bytes.map_or(String::new(), |bytes| format!("; peak memory {}", BinaryBytes(bytes)))
        ));
    }
}

impl SavedMap {
    /// Saves a map.
    pub(crate) fn write(map: &VoxelMap, path: &Path) -> Result<Self> {
        let start = Instant::now();
        tsdfuse_io::map_file::write(path, map)?;
        Ok(Self::written(path, start))
    }

    /// Of a file that was written since `start`.
    pub(crate) fn written(path: &Path, start: Instant) -> Self {
        Self {
            path: path.to_owned(),
            bytes: std::fs::metadata(path).map_or(0, |file| file.len()),
            seconds: start.elapsed().as_secs_f64(),
        }
    }

    /// A line for people.
    pub(crate) fn say_where(&self) {
        let Self { path, bytes, .. } = self;
        say(format_args!("  wrote    {}, {}", path.display(), BinaryBytes(*bytes)));
    }
}

impl MeshReport {
    pub(crate) fn of(mesh: &Mesh, path: &Path, seconds: f64) -> Self {
        Self {
            path: path.to_owned(),
            vertices: mesh.vertices.len(),
            triangles: mesh.triangles.len(),
            seconds,
            write_seconds: 0.0,
            tiles: None,
        }
    }

    /// A line for people.
    pub(crate) fn summarize(&self) {
        let count = |n: usize| HumanCount(n as u64);
        let (vertices, triangles) = (count(self.vertices), count(self.triangles));
        say(format_args!("  mesh     {triangles} triangles, {vertices} vertices"));
        if let Some(TilesReport { tiles, levels, bytes }) = self.tiles {
            let (tiles, bytes) = (count(tiles), BinaryBytes(bytes));
            say(format_args!("  tiles    {tiles} in {levels} levels, {bytes}"));
        }
    }

    /// A line for people: where the mesh lies, if it is a file.
    pub(crate) fn say_where(&self) {
        if self.path.as_os_str() != "-" {
            say(format_args!("  wrote    {}", self.path.display()));
        }
    }
}

impl Report {
    /// Writes `report.json`, complete or not at all.
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let mut text = serde_json::to_vec_pretty(self)?;
        text.push(b'\n');
        Ok(tsdfuse_io::atomic::write(path, |file| file.write_all(&text))?)
    }

    /// The few lines for people, on standard error.
    pub(crate) fn summarize(&self) {
        let Totals {
            scans,
            sums,
            finish,
            seconds,
        } = &self.totals;
        let rate = *scans as f64 / seconds;
        let on = self
            .device
            .as_ref()
            .map_or(String::new(), |device| format!(" on {device}"));
        say(format_args!(
            "{scans} scans fused in {seconds:.2} s, {rate:.1} scans/s{on}"
        ));
        let (points, fused) = (HumanCount(sums.points), HumanCount(sums.fused));
        say(format_args!("  points   {fused} of {points} fused{}", left_out(sums)));
        self.map.summarize(self.peak_memory_bytes);
        let (saved, mesh) = (self.saved_map.as_ref(), self.mesh.as_ref());
        mesh.inspect(|mesh| mesh.summarize());
        say(format_args!(
            "  seconds  read {:.2} (in the background), prepare {:.2}, fuse {:.2}{}{}{}{}; in all {:.2}",
            sums.read,
            sums.prepare,
            sums.fuse,
            match finish {
                FinishReport { updated_blocks: 0, .. } => String::new(),
                FinishReport { seconds, .. } => format!(", finish {seconds:.2}"),
            },
            saved.map_or(String::new(), |map| format!(", save map {:.2}", map.seconds)),
            self.growth.as_ref().map_or(String::new(), |growth| format!(
                ", {} meshes on the way {:.2}",
                growth.meshes, growth.seconds
            )),
            mesh.map_or(String::new(), |mesh| format!(
                ", mesh {:.2}, write {:.2}",
                mesh.seconds, mesh.write_seconds
            )),
            self.wall_seconds
        ));
        saved.inspect(|map| map.say_where());
        mesh.inspect(|mesh| mesh.say_where());
        self.preview.as_ref().inspect(|view| view.say_where());
    }
}

/// Returns that were not fused, by reason: `; 12 no return, 3 too near`.
pub(crate) fn left_out(sums: &Sums) -> String {
    let reasons = [counted(&sums.dropped), counted(&sums.skipped)].concat();
    let lead = if reasons.is_empty() { "" } else { "; " };
    lead.to_owned() + &reasons.join(", ")
}

/// The counters that are not 0, by name: `12 no return`.
pub(crate) fn counted(counters: &impl Serialize) -> Vec<String> {
    // Counters are plain structs of numbers, which cannot fail to become JSON.
    let counters = serde_json::to_value(counters).unwrap_or_default();
    let counters = counters.as_object().into_iter().flatten();
    let nonzero = counters.filter_map(|(name, n)| Some((name.replace('_', " "), n.as_u64().filter(|&n| n > 0)?)));
    nonzero.map(|(name, n)| format!("{} {name}", HumanCount(n))).collect()
}

/// The most memory this process has held so far, where the system tells (Linux).
pub(crate) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()
        .map(|kb| kb * 1024)
}

/// Prints a value as JSON on standard output.
pub(crate) fn print_json(value: &impl Serialize) -> Result<()> {
    print(&(serde_json::to_string_pretty(value)? + "\n"))
}

/// Prints text on standard output.
pub(crate) fn print(text: &str) -> Result<()> {
    std::io::stdout().write_all(text.as_bytes()).context("standard output")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_counted_is_told() {
        let dropped = Dropped {
            too_near: 3,
            other_sensor: 1200,
            ..Default::default()
        };
        let mut sums = Sums {
            dropped,
            ..Default::default()
        };
        assert_eq!(left_out(&sums), "; 3 too near, 1,200 other sensor");
        sums.dropped = Dropped::default();
        assert_eq!(left_out(&sums), "");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn linux_tells_the_peak_memory() {
        assert!(peak_memory_bytes().unwrap() > 1 << 20);
    }
}
