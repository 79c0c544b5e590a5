//! The results as Markdown.

use std::fmt::Write;

use crate::measure::Accuracy;

/// One run of `tsdfuse fuse`: medians over its scans.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    pub(crate) prepare_secs: f64,
    pub(crate) fuse_secs: f64,
    /// Both together.
    pub(crate) scan_secs: f64,
    pub(crate) peak_memory_bytes: f64,
}

/// All about one method on one sequence.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) name: String,
    pub(crate) runs: Vec<Run>,
    pub(crate) accuracy: Accuracy,
    pub(crate) completeness: f64,
}

pub(crate) const HEADER: &str = "\
| method | scans/s | prepare ms | fuse ms | mean mm | RMSE mm | p95 mm | complete | precision | F | peak MB |
|---|---|---|---|---|---|---|---|---|---|---|
";

impl Row {
    /// The line of the table: medians over the runs, for scans/s with their range.
    pub(crate) fn line(&self) -> String {
        let of = |value: fn(&Run) -> f64| {
            let mut values: Vec<f64> = self.runs.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let rates = of(|run| 1.0 / run.scan_secs);
        let range = match rates[..] {
            [least, .., most] => format!(" ({least:.1}–{most:.1})"),
            _ => String::new(),
        };
        let (a, c) = (&self.accuracy, self.completeness);
        let f = 2.0 * a.precision * c / (a.precision + c).max(f64::MIN_POSITIVE);
        let mut line = format!("| {} | {:.1}{range} ", self.name, median(&rates));
        for (value, decimals) in [
            (1e3 * median(&of(|run| run.prepare_secs)), 1),
            (1e3 * median(&of(|run| run.fuse_secs)), 1),
            (1e3 * a.mean_m, 2),
            (1e3 * a.rmse_m, 1),
            (1e3 * a.p95_m, 1),
            (c, 4),
            (a.precision, 4),
            (f, 4),
            (1e-6 * median(&of(|run| run.peak_memory_bytes)), 0),
        ] {
            // Writing to a string cannot fail.
            let _ = write!(line, "| {value:.decimals$} ");
        }
        line + "|\n"
    }
}

/// The middle of sorted values, the lower one of two; NaN without any.
pub(crate) fn median(sorted: &[f64]) -> f64 {
    sorted
        .get(sorted.len().saturating_sub(1) / 2)
        .copied()
        .unwrap_or(f64::NAN)
}
