//! The times of a long drive as text.

use tsdfuse_eval::stats::median;
use tsdfuse_run::report::with_commas;

use super::drive::{PASS, SENSOR};
use super::long_drive::{LongDriveResults, Pass, Stored};
use super::pieces::pieces;

/// Rows of the table.
const ROWS: usize = 10;

impl LongDriveResults {
    /// All figures.
    pub fn text(&self) -> String {
        table(self)
    }
}

fn table(results: &LongDriveResults) -> String {
    let LongDriveResults {
        machine,
        config,
        passes,
        ..
    } = results;
    let secs: Vec<f64> = passes.iter().flat_map(|pass| &pass.scan_secs).copied().collect();
    let ms = |secs: &[f64]| 1e3 * median(secs.iter().copied());
    let mut text = format!(
        "{}, {} thread{}, {}, {}\n{} scans of a {SENSOR} in a repeating simulated street, {}, voxels of {} m\n\n\
         ms a scan, medians: first ten {:.2}, first pass {:.2}, last {PASS} {:.2}; slowest {:.2}\n",
        machine.processor.as_deref().unwrap_or(&machine.system),
        machine.threads,
        if machine.threads == 1 { "" } else { "s" },
        machine.simd,
        machine.date,
        with_commas(secs.len() as u64),
        config.method.name(),
        config.map.voxel_size_m,
        ms(&secs[..secs.len().min(10)]),
        ms(&secs[..secs.len().min(PASS)]),
        ms(&secs[secs.len().saturating_sub(PASS)..]),
        1e3 * secs.iter().copied().fold(0.0, f64::max),
    );
    text += &results.stored.as_ref().map_or_else(String::new, Stored::text);
    let whole: Vec<&Pass> = passes.iter().filter(|pass| pass.is_whole()).collect();
    if whole.len() < 2 {
        return text;
    }
    text += &format!(
        "\n{:>15} {:>9} {:>11} {:>9} {:>9} {:>13} {:>8}\n",
        "scans", "median", "first scan", "first ten", "all", "blocks after", "map MB"
    );
    let rows: Vec<_> = pieces(&whole, ROWS).collect();
    for row in &rows {
        let ([first, ..], [.., last]) = (row, row) else {
            continue;
        };
        let every: Vec<f64> = row.iter().flat_map(|pass| &pass.scan_secs).copied().collect();
        let best = fastest(row);
        text += &format!(
            "{:>15} {:>9.2} {:>11.2} {:>9.2} {:>9.2} {:>13} {:>8.0}\n",
            format!("{}–{}", first.from, last.from + PASS - 1),
            ms(&every),
            1e3 * best[0],
            1e3 * mean(&best[..10]),
            1e3 * mean(&best),
            last.blocks,
            last.map_bytes as f64 / 1e6,
        );
    }
    let [first, .., last] = &rows[..] else { return text };
    let growth = mean(&fastest(last)) / mean(&fastest(first));
    text + &format!(
        "\nEach pass of {PASS} scans does the same work in a new street. First scan, first ten and all: each scan of a pass the\n\
         fastest of its row, so that other work on the machine counts little. Last row to first: {growth:.3}.\n"
    )
}

/// Each scan of a pass, the fastest of these passes.
fn fastest(passes: &[&Pass]) -> Vec<f64> {
    let of = |scan: usize| {
        let secs = passes.iter().filter_map(|pass| pass.scan_secs.get(scan));
        secs.copied().fold(f64::INFINITY, f64::min)
    };
    (0..PASS).map(of).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

impl Stored {
    fn text(&self) -> String {
        let Self {
            length_km, map, mesh, ..
        } = self;
        let mut text = format!(
            "\n{length_km:.2} km: {} blocks, {} of voxels; mesh of {} triangles in {:.1} s, written in {:.1} s; peak memory {}\n",
            with_commas(map.blocks as u64),
            binary(map.blocks * size_of::<tsdfuse::map::Block>()),
            with_commas(mesh.triangles as u64),
            mesh.seconds,
            mesh.write_seconds,
            self.peak_memory_bytes
                .map_or_else(String::new, |bytes| binary(bytes as usize)),
        );
        if let Some(paging) = &self.paging {
            text += &format!(
                "blocks in memory: peak {}, limit {}; file: {} ({} per km); paging {:.1} s, commits {:.1} s\n",
                binary(paging.most_bytes),
                paging.limit_bytes.map_or_else(|| "none".to_owned(), binary),
                binary(paging.store_bytes as usize),
                binary((paging.store_bytes as f64 / length_km) as usize),
                paging.paging_seconds,
                paging.commit_seconds,
            );
        }
        text
    }
}

/// Bytes in the largest unit of which there is one: `1.50 GiB`.
fn binary(bytes: usize) -> String {
    let (mut value, mut unit) = (bytes as f64, "B");
    for larger in ["KiB", "MiB", "GiB", "TiB"] {
        if value >= 1024.0 {
            (value, unit) = (value / 1024.0, larger);
        }
    }
    format!("{value:.2} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_scan_counts_with_its_fastest_pass() {
        let pass = |secs: f64| Pass {
            from: 0,
            scan_secs: (0..PASS).map(|scan| secs + scan as f64).collect(),
            fused: 7,
            updated_blocks: 3,
            blocks: 9,
            map_bytes: 9,
        };
        let mut slow_start = pass(1.0);
        slow_start.scan_secs[0] = 50.0;
        let best = fastest(&[&slow_start, &pass(2.0)]);
        assert_eq!((best.len(), best[0], best[1]), (PASS, 2.0, 2.0));
        assert_eq!(mean(&best[..2]), 2.0);
    }

    #[test]
    fn sizes_are_told_in_the_largest_unit() {
        let told = [0, 1023, 1024, 3 << 29, 5 << 40].map(binary);
        assert_eq!(told, ["0.00 B", "1023.00 B", "1.00 KiB", "1.50 GiB", "5.00 TiB"]);
    }
}
