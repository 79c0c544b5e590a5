//! Results as text.

use std::fmt::Write;

use super::limits::LINE_BYTES;
use super::results::{Measured, Results, Spread};
use super::run::Run;

/// A stage's name and its seconds.
type Stage = (&'static str, fn(&Run) -> f64);

/// One after the other, they make up a run.
const STAGES: [Stage; 8] = [
    ("wait for reading", |run| run.wait),
    ("prepare", |run| run.prepare),
    ("find", |run| run.find),
    ("update", |run| run.update),
    ("finish", |run| run.finish),
    ("mesh", |run| run.mesh),
    ("write", |run| run.write),
    ("other", Run::other),
];

impl Results {
    /// All figures.
    pub fn text(&self) -> String {
        of(self)
    }
}

fn of(results: &Results) -> String {
    let machine = &results.machine;
    let limits = &results.limits;
    let (gb, millions) = (|bytes: f64| bytes / 1e9, |n: f64| n / 1e6);
    let mut text = format!(
        "{}, {} thread{}, {}, {}\n{}: {} scans\n\
         memory: copy {:.1} GB/s, triad {:.1}, update in place {:.1}; random lines {:.0} million/s ({:.1} GB/s)\n",
        machine.processor.as_deref().unwrap_or(&machine.system),
        machine.threads,
        if machine.threads == 1 { "" } else { "s" },
        machine.simd,
        machine.date,
        results.dataset.name,
        results.dataset.scans,
        gb(limits.copy_bytes_per_sec),
        gb(limits.triad_bytes_per_sec),
        gb(limits.in_place_bytes_per_sec),
        millions(limits.random_lines_per_sec),
        gb(2.0 * LINE_BYTES as f64 * limits.random_lines_per_sec),
    );
    for method in &results.methods {
        text += "\n";
        text += &stages(method);
        text += &rates(method);
        text += &moved(method, results);
    }
    if results.methods.len() > 1 {
        text += "\n";
        text += &side_by_side(&results.methods);
    }
    for failed in &results.failed {
        text += &format!("\n{}: {}\n", failed.name, failed.reason);
    }
    text
}

/// Seconds, milliseconds a scan, and shares.
fn stages(method: &Measured) -> String {
    let runs = method.runs.len();
    let mut text = format!(
        "{:<18} {:>24} {:>9} {:>7}\n",
        method.name,
        if runs == 1 {
            "s".to_owned()
        } else {
            format!("s, median of {runs} runs")
        },
        "ms/scan",
        "share"
    );
    let total = method.spread(|run| run.total).median;
    let mut row = |name: &str, of: fn(&Run) -> f64, is_part: bool| {
        let seconds = method.spread(of);
        let scans = method.spread(|run| run.scans as f64).median;
        let share = if is_part {
            format!("{:.1} %", 100.0 * seconds.median / total)
        } else {
            String::new()
        };
        let (spread, per_scan) = (with_range(&seconds, 3), 1e3 * seconds.median / scans);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {name:<16} {spread:>24} {per_scan:>9.2} {share:>7}");
    };
    row("read, meanwhile", |run| run.read, false);
    for (name, of) in STAGES {
        if name != "finish" || method.spread(of).max > 1e-3 {
            row(name, of, true);
        }
    }
    row("in all", |run| run.total, true);
    text
}

/// Scans and points a second.
fn rates(method: &Measured) -> String {
    let (fusing, end_to_end) = (method.spread(|run| 1.0 / run.scan), method.spread(files_to_mesh));
    let points = method.spread(|run| run.points as f64 / run.fusing());
    let Some(last) = method.runs.last() else {
        return String::new();
    };
    format!(
        "  {} scans/s fusing (1 / median scan), {} scans/s from files to mesh, {:.2} of that\n  \
         {:.2} million points/s fusing; {:.0} points a scan; a map of {} blocks, {:.0} MB; {:.2} million triangles\n",
        with_range(&fusing, 1),
        with_range(&end_to_end, 1),
        end_to_end.median / fusing.median,
        points.median / 1e6,
        last.points as f64 / last.scans as f64,
        last.blocks,
        last.map_bytes as f64 / 1e6,
        last.triangles as f64 / 1e6,
    )
}

/// What a scan changes, and how long memory alone would take for it.
fn moved(method: &Measured, results: &Results) -> String {
    let (changes, limits) = (&method.changes, &results.limits);
    let secs = method.spread(updating).median;
    let in_order = changes.bytes() / limits.in_place_bytes_per_sec;
    let at_random = changes.lines / limits.random_lines_per_sec;
    let percent = |part: f64| 100.0 * part / secs;
    format!(
        "  a scan changes {:.0} voxels ({:.1} million/s) in {:.0} lines of 64 bytes in {:.0} blocks: {:.1} MB read and written back, {:.1} GB/s\n  \
         of the {:.2} ms that find and update take, memory alone would take {:.2} ms in order ({:.0} %), {:.2} ms line by line at random ({:.0} %)\n",
        changes.voxels,
        changes.voxels / secs / 1e6,
        changes.lines,
        changes.blocks,
        changes.bytes() / 1e6,
        changes.bytes() / secs / 1e9,
        1e3 * secs,
        1e3 * in_order,
        percent(in_order),
        1e3 * at_random,
        percent(at_random),
    )
}

/// One line for each method.
fn side_by_side(methods: &[Measured]) -> String {
    let mut text = format!(
        "{:<18} {:>20} {:>20} {:>9} {:>9} {:>9} {:>9}\n",
        "", "scans/s fused", "files to mesh", "prepare", "find", "update", "mesh"
    );
    for method in methods {
        let ms = |of: fn(&Run) -> f64| method.spread(|run| 1e3 * of(run) / run.scans as f64).median;
        let _ = writeln!(
            text,
            "{:<18} {:>20} {:>20} {:>9.2} {:>9.2} {:>9.2} {:>9.2}",
            method.name,
            with_range(&method.spread(|run| 1.0 / run.scan), 1),
            with_range(&method.spread(files_to_mesh), 1),
            ms(|run| run.prepare),
            ms(|run| run.find),
            ms(|run| run.update + run.finish),
            ms(|run| run.mesh),
        );
    }
    text + "                                                                 milliseconds a scan\n"
}

fn files_to_mesh(run: &Run) -> f64 {
    run.scans as f64 / run.total
}

/// Seconds a scan in which the map is found and updated.
fn updating(run: &Run) -> f64 {
    (run.find + run.update + run.finish) / run.scans as f64
}

/// `1.23 (1.20–1.30)`, or the one value that there is.
fn with_range(spread: &Spread, digits: usize) -> String {
    let Spread { median, min, max } = spread;
    if min == max {
        return format!("{median:.digits$}");
    }
    format!("{median:.digits$} ({min:.digits$}–{max:.digits$})")
}
