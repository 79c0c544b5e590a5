//! All that is known of the methods in the end: what `results.json` holds, and the tables and plots show.

use serde::Serialize;
use tsdfuse_eval::Comparison;
use tsdfuse_eval::held_out::HeldOut;
use tsdfuse_eval::stats::{Histogram, median};
use tsdfuse_run::report::{ScanReport, SkippedScan};
use tsdfuse_run::{Machine, Report, RunConfig};

use crate::form::Form;
use crate::pose_noise::PoseNoise;
use crate::truth::Truth;

/// Methods side by side.
#[derive(Debug, Serialize)]
pub struct Results {
    /// The version of this crate.
    pub version: &'static str,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// Where times were taken.
    pub machine: Machine,
    /// What was fused.
    pub dataset: Data,
    /// What meshes were compared with.
    pub reference: Truth,
    /// The methods.
    pub methods: Vec<Row>,
    /// Methods that could not be used on these data, with the reason.
    pub failed: Vec<Failed>,
}

/// What was fused.
#[derive(Clone, Debug, Serialize)]
pub struct Data {
    /// The last part of the log's path.
    pub name: String,
    /// Its format.
    pub format: String,
    /// Scans that were asked for.
    pub scans: usize,
    /// One of so many scans is held out.
    pub hold_out: Option<usize>,
    /// How many that are.
    pub held_out_scans: usize,
    /// What was added to the poses of the fused scans.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose_noise: Option<PoseNoise>,
}

/// A method that could not be used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Failed {
    /// The form's name.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// One method's results.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The method and its settings.
    #[serde(flatten)]
    pub form: Form,
    /// The command that makes the mesh again.
    pub command: String,
    /// With what it was fused.
    pub config: RunConfig,
    /// The mesh of all scans against the reference.
    pub surface: Comparison,
    /// The map without the held-out scans against these.
    pub held_out: Option<HeldOut>,
    /// |Δr| of the hits.
    pub held_out_histogram: Option<Histogram>,
    /// Medians over the scans of the run of median speed.
    pub speed: Speed,
    /// Scans a second of each run.
    pub scans_per_sec: Vec<f64>,
    /// The most memory that the process of any run held, its mesh included.
    pub peak_memory_bytes: Option<u64>,
    /// Threads that fused.
    pub threads: usize,
    /// Memory of the map.
    pub map_bytes: u64,
    /// Its blocks.
    pub map_blocks: usize,
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Extracting it, seconds.
    pub mesh_secs: f64,
    /// The share of the valid returns that reached the map.
    pub fused_share: f64,
    /// `prepare + fuse` of each scan of the run of median speed, seconds.
    pub scan_secs: Vec<f64>,
    /// Scans that could not be used.
    pub skipped_scans: Vec<SkippedScan>,
}

/// Seconds of wall time, medians over the scans of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Speed {
    /// 1 / median of prepare + fuse. What a method leaves to the end is spread over the scans.
    pub scans_per_sec: f64,
    /// Reading and decoding, in the background.
    pub read_secs: f64,
    /// Dropping invalid returns, placing the others, normals, ….
    pub prepare_secs: f64,
    /// Updating the map.
    pub fuse_secs: f64,
}

impl Speed {
    /// The speed of a run.
    pub fn of(report: &Report) -> Self {
        let scans = &report.scans;
        let of = |secs: fn(&ScanReport) -> f64| median(scans.iter().map(secs));
        let finish = report.totals.finish.seconds / scans.len().max(1) as f64;
        Self {
            scans_per_sec: 1.0 / (of(scan_secs) + finish),
            read_secs: of(|scan| scan.sums.read),
            prepare_secs: of(|scan| scan.sums.prepare),
            fuse_secs: of(|scan| scan.sums.fuse) + finish,
        }
    }
}

/// Seconds of wall time that a scan took to be fused.
pub(crate) fn scan_secs(scan: &ScanReport) -> f64 {
    scan.sums.prepare + scan.sums.fuse
}

impl Row {
    /// Takes the times of the run of median speed, the memory of the largest run, and the range of speeds.
    pub(crate) fn set_speeds(&mut self, mut runs: Vec<Report>) {
        self.scans_per_sec = runs.iter().map(|run| Speed::of(run).scans_per_sec).collect();
        self.peak_memory_bytes = runs.iter().filter_map(|run| run.peak_memory_bytes).max();
        runs.sort_by(|a, b| Speed::of(a).scans_per_sec.total_cmp(&Speed::of(b).scans_per_sec));
        let Some(run) = runs.get(runs.len().saturating_sub(1) / 2) else {
            return;
        };
        self.speed = Speed::of(run);
        self.mesh_secs = run.mesh.as_ref().map_or(f64::NAN, |mesh| mesh.seconds);
        self.scan_secs = run.scans.iter().map(scan_secs).collect();
    }
}
