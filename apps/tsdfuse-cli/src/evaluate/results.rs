//! What is known of a form in the end: everything that `results.json` says and the tables and plots show.

use serde::Serialize;
use tsdfuse_eval::Comparison;
use tsdfuse_eval::held_out::HeldOut;
use tsdfuse_eval::stats::Histogram;

use super::child::{FuseReport, Skipped};
use super::forms::Form;
use super::reference::Chosen;
use crate::config::RunConfig;
use crate::machine::Machine;

/// Everything.
#[derive(Debug, Serialize)]
pub(crate) struct Results {
    /// The program's version.
    pub(crate) version: &'static str,
    pub(crate) command_line: Vec<String>,
    pub(crate) machine: Machine,
    pub(crate) dataset: Data,
    pub(crate) reference: Chosen,
    pub(crate) methods: Vec<Row>,
    /// Methods that could not be used on these data, with the reason.
    pub(crate) failed: Vec<Skipped>,
}

/// What was fused.
#[derive(Debug, Serialize)]
pub(crate) struct Data {
    pub(crate) name: String,
    pub(crate) format: &'static str,
    pub(crate) scans: usize,
    /// One of so many scans is held out.
    pub(crate) hold_out: Option<u32>,
    pub(crate) held_out_scans: usize,
}

/// One form's results.
#[derive(Debug, Serialize)]
pub(crate) struct Row {
    #[serde(flatten)]
    pub(crate) form: Form,
    /// Reproduces the mesh.
    pub(crate) command: String,
    /// With what it was fused.
    pub(crate) config: RunConfig,
    /// The mesh of all scans against the reference.
    pub(crate) surface: Comparison,
    /// The map without the held-out scans against these.
    pub(crate) held_out: Option<HeldOut>,
    /// |Δr| of the hits.
    pub(crate) held_out_histogram: Option<Histogram>,
    /// Medians over the scans of the run of median speed.
    pub(crate) speed: Speed,
    /// Scans a second of each run.
    pub(crate) scans_per_sec: Vec<f64>,
    /// The most memory of any run, its mesh included.
    pub(crate) peak_memory_bytes: Option<u64>,
    pub(crate) threads: usize,
    pub(crate) map_bytes: u64,
    pub(crate) map_blocks: usize,
    pub(crate) triangles: usize,
    pub(crate) mesh_secs: f64,
    /// The share of the valid returns that reached the map.
    pub(crate) fused_share: f64,
    /// `prepare + fuse` of each scan in that run, seconds.
    pub(crate) scan_secs: Vec<f64>,
    pub(crate) skipped_scans: Vec<Skipped>,
}

/// Seconds of wall time, medians over the scans.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Speed {
    /// 1 / median of prepare + fuse; what a method leaves to the end is spread over the scans.
    pub(crate) scans_per_sec: f64,
    pub(crate) read_secs: f64,
    pub(crate) prepare_secs: f64,
    pub(crate) fuse_secs: f64,
}

impl Speed {
    pub(crate) fn of(report: &FuseReport) -> Self {
        let of = |value: fn(&super::child::ScanTimes) -> f64| median(report.scans.iter().map(value).collect());
        let finish = report.totals.finish.seconds / report.scans.len().max(1) as f64;
        Self {
            scans_per_sec: 1.0 / (of(|s| s.prepare + s.fuse) + finish),
            read_secs: of(|s| s.read),
            prepare_secs: of(|s| s.prepare),
            fuse_secs: of(|s| s.fuse) + finish,
        }
    }
}

/// The middle value, the lower one of two; NaN of none.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len().saturating_sub(1) / 2;
    values.get(middle).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_a_value() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), 2.0);
        assert!(median(vec![]).is_nan());
    }
}
