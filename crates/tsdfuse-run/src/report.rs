//! What a run did, as data: everything that `report.json` holds. Times are seconds of wall time.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use tsdfuse::fuse::Skipped;
use tsdfuse::scan::Dropped;
use tsdfuse::sensor::{Pinhole, SensorCorrection};
use tsdfuse::trajectory::length_m;
use tsdfuse::{SensorModel, VoxelMap};
use tsdfuse_io::Sensor;
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_odometry::{ImuReport, Mounting, Quality};
use tsdfuse_store::PagedMap;

use crate::config::RunConfig;
use crate::error::Result;
use crate::loops::LoopsReport;

/// Everything about one run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// The version of this crate.
    pub version: String,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// Threads that fused.
    pub threads: usize,
    /// The GPU that fused, if one did.
    pub device: Option<String>,
    /// What was read.
    pub dataset: LogReport,
    /// With what it was fused.
    pub config: RunConfig,
    /// Each scan that was fused.
    pub scans: Vec<ScanReport>,
    /// Each scan that could not be used.
    pub skipped_scans: Vec<SkippedScan>,
    /// Sums over all scans.
    pub totals: Totals,
    /// What odometry did, if it found the poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub odometry: Option<OdometryReport>,
    /// Whether the run was stopped before the last scan.
    pub stopped: bool,
    /// The map that was continued.
    pub loaded_map: Option<LoadedMap>,
    /// The map after the last scan.
    pub map: MapReport,
    /// The file that the map was saved to.
    pub saved_map: Option<SavedMap>,
    /// The surface, if it was asked for.
    pub mesh: Option<MeshReport>,
    /// What was done for a map that is not all in memory.
    pub paging: Option<PagingReport>,
    /// What became of the mesh file before that, if it was kept up to date.
    pub growth: Option<GrowthReport>,
    /// The picture of the result, if it was asked for.
    pub preview: Option<ViewReport>,
    /// The most memory that the process held, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// From start to the last file that was finished, but the report itself.
    pub wall_seconds: f64,
}

impl Report {
    /// Writes `report.json`, complete or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        // Plain data with text as keys cannot fail to become JSON.
        let mut text = serde_json::to_vec_pretty(self).unwrap_or_default();
        text.push(b'\n');
        Ok(tsdfuse_io::atomic::write(path, |file| file.write_all(&text))?)
    }
}

/// What was read.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LogReport {
    /// The log's path; empty if it has none.
    pub path: PathBuf,
    /// Its format's name.
    pub format: String,
    /// Scans there are, of which some were asked for; not known of a stream.
    pub scans: Option<usize>,
    /// The model of the first sensor, where it is known.
    pub sensor: Option<SensorModel>,
    /// The first sensor's camera, where the scans are depth images.
    pub camera: Option<Pinhole>,
    /// The names of all sensors that were fused.
    pub sensors: Vec<String>,
    /// What is missing or odd.
    pub notes: Vec<String>,
}

impl LogReport {
    /// Describes a log.
    pub fn of(path: &Path, log: &tsdfuse_io::Log) -> Self {
        let first = log.sensors().first();
        Self {
            path: path.to_owned(),
            format: log.format().to_owned(),
            scans: log.len(),
            sensor: first.and_then(|sensor: &Sensor| sensor.model.clone()),
            camera: first.and_then(|sensor| sensor.camera),
            sensors: log.sensors().iter().map(|sensor| sensor.name.clone()).collect(),
            notes: [log.notes(), &log.news()].concat(),
        }
    }
}

/// One scan: `points` are all that were in the file, each of them either fused, dropped or skipped.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ScanReport {
    /// The scan's name.
    pub name: String,
    /// Its counts and times.
    #[serde(flatten)]
    pub sums: Sums,
    /// Blocks of the map that were made or updated.
    pub updated_blocks: usize,
    /// How well odometry placed it, if it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub odometry: Option<Quality>,
}

/// What odometry did.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct OdometryReport {
    /// Seconds that it took.
    pub seconds: f64,
    /// Distance travelled, metres.
    pub distance_m: f64,
    /// Scans whose returns do not tell the position along some direction; there the motion before went on.
    pub undetermined: usize,
    /// Scans of which most returns do not lie on what was seen before: the trajectory may be broken there.
    pub unmatched: usize,
    /// Pieces of the trajectory that have nothing to do with each other: one if the sensor was never lost.
    #[serde(default)]
    pub pieces: usize,
    /// The loops, if any were looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loops: Option<LoopsReport>,
    /// What was found out about the log's IMU, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imu: Option<ImuReport>,
    /// Systematic errors of the sensor that refinement found, and that were taken back besides those that were known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correction: Option<SensorCorrection>,
    /// Where the sensor is, seen from where the given poses put it, if refinement found it elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mounting: Option<Mounting>,
}

impl OdometryReport {
    /// Of scans that took so long; the first one is placed by no other.
    pub fn of<'a>(seconds: f64, poses: &[FusedPose], qualities: impl Iterator<Item = &'a Quality>) -> Self {
        let mut report = Self {
            seconds,
            distance_m: length_m(poses.iter().map(|fused| &fused.pose)),
            undetermined: 0,
            unmatched: 0,
            pieces: 1,
            loops: None,
            imu: None,
            correction: None,
            mounting: None,
        };
        for quality in qualities.skip(1) {
            report.undetermined += usize::from(quality.is_undetermined());
            report.unmatched += usize::from(quality.is_unmatched());
        }
        report
    }
}

/// What can be added over scans.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Sums {
    /// Reading and decoding, in the background.
    pub read: f64,
    /// Waiting for that.
    pub wait: f64,
    /// Leaving out invalid returns, placing the others, normals, ….
    pub prepare: f64,
    /// Updating the map.
    pub fuse: f64,
    /// Of that, finding out which parts of the map returns reach into.
    pub find: f64,
    /// Points in the file.
    pub points: u64,
    /// Points that were fused.
    pub fused: u64,
    /// Points that are no measurements.
    pub dropped: Dropped,
    /// Measurements that the method had no use for.
    pub skipped: Skipped,
}

impl Sums {
    /// Points that were not fused, by reason: `; 12 no return, 3 too near`.
    pub fn left_out(&self) -> String {
        let reasons = [counted(&self.dropped), counted(&self.skipped)].concat();
        let lead = if reasons.is_empty() { "" } else { "; " };
        lead.to_owned() + &reasons.join(", ")
    }
}

/// The counters that are not 0, by name: `1,200 no return`.
pub fn counted(counters: &impl Serialize) -> Vec<String> {
    // Counters are plain structs of numbers, which cannot fail to become JSON.
    let counters = serde_json::to_value(counters).unwrap_or_default();
    let counters = counters.as_object().into_iter().flatten();
    let nonzero = counters.filter_map(|(name, n)| Some((name.replace('_', " "), n.as_u64().filter(|&n| n > 0)?)));
    nonzero.map(|(name, n)| format!("{} {name}", with_commas(n))).collect()
}

/// A number with its thousands apart: `1,200`.
pub fn with_commas(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
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

/// Sums over all scans.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Totals {
    /// Scans that were fused.
    pub scans: usize,
    /// Their counts and times.
    #[serde(flatten)]
    pub sums: Sums,
    /// What a method that collects scans did after the last one.
    pub finish: FinishReport,
    /// From the first scan to the last and the finish, waiting for files included.
    pub seconds: f64,
}

/// A scan that could not be used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SkippedScan {
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// What was done after the last scan.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct FinishReport {
    /// Time it took.
    pub seconds: f64,
    /// Blocks of the map that were made or updated.
    pub updated_blocks: usize,
}

/// How much a map holds.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct MapReport {
    /// Blocks of 8³ voxels.
    pub blocks: usize,
    /// Voxels that were observed.
    pub observed_voxels: usize,
    /// Memory of the blocks that are in memory, and of their table.
    pub bytes: usize,
}

impl MapReport {
    /// Of a map in memory.
    pub fn of(map: &VoxelMap) -> Self {
        Self {
            blocks: map.block_count(),
            observed_voxels: map.observed_voxel_count(),
            bytes: map.memory_bytes(),
        }
    }

    /// Of a paged map, as of the last commit.
    pub fn of_paged(map: &PagedMap) -> Self {
        let sizes = map.sizes();
        Self {
            blocks: sizes.blocks as usize,
            observed_voxels: sizes.observed_voxels as usize,
            bytes: map.memory_bytes(),
        }
    }
}

/// The map that was continued.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LoadedMap {
    /// Its file.
    pub path: PathBuf,
    /// Scans (or images made of them) that it was made of, where the file tells.
    pub integrations: Option<u32>,
    /// Its blocks.
    pub blocks: usize,
}

/// The file that a map was saved to.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedMap {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Writing it.
    pub seconds: f64,
}

impl SavedMap {
    /// Of a file that was written since `start`.
    pub fn written(path: &Path, start: Instant) -> Self {
        Self {
            path: path.to_owned(),
            bytes: std::fs::metadata(path).map_or(0, |file| file.len()),
            seconds: start.elapsed().as_secs_f64(),
        }
    }
}

/// The surface.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct MeshReport {
    /// The file that it was written to.
    pub path: PathBuf,
    /// Its vertices.
    pub vertices: usize,
    /// Its triangles.
    pub triangles: usize,
    /// Extracting it.
    pub seconds: f64,
    /// Writing it, where that comes afterwards.
    pub write_seconds: f64,
    /// What it was written as, if not as one file.
    pub tiles: Option<TilesReport>,
    /// Where its colours come from, if it has some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<ColorReport>,
}

/// The colours of a surface.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct ColorReport {
    /// Images that were projected onto it.
    pub images: usize,
    /// Vertices that some image sees.
    pub vertices: usize,
}

/// A surface as 3D Tiles.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct TilesReport {
    /// How many.
    pub tiles: usize,
    /// The most that lie one below the other.
    pub levels: usize,
    /// Of all files.
    pub bytes: u64,
}

/// What was done for a map that is not all in memory.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct PagingReport {
    /// The most that blocks were to take in memory.
    pub limit_bytes: Option<usize>,
    /// The most that they took.
    pub most_bytes: usize,
    /// Size of the store.
    pub store_bytes: u64,
    /// Times that the store was made safe.
    pub commits: usize,
    /// Loading and evicting regions.
    pub paging_seconds: f64,
    /// Making the store safe.
    pub commit_seconds: f64,
}

/// What became of a mesh file that is kept up to date.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct GrowthReport {
    /// How often it was written before the last scan.
    pub meshes: usize,
    /// Extracting and writing.
    pub seconds: f64,
}

/// A picture, or several of one view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ViewReport {
    /// `world_from_camera`, the row-major matrix `[R | t]`.
    pub pose: [f64; 12],
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Pixels that see surface.
    pub surface_pixels: usize,
    /// The pictures that were written.
    pub files: Vec<PathBuf>,
    /// Rendering.
    pub seconds: f64,
    /// Writing.
    pub write_seconds: f64,
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
        assert_eq!(sums.left_out(), "; 3 too near, 1,200 other sensor");
        sums.dropped = Dropped::default();
        assert_eq!(sums.left_out(), "");
        assert_eq!(
            [0, 999, 1000, 1_234_567].map(with_commas),
            ["0", "999", "1,000", "1,234,567"]
        );
    }
}
