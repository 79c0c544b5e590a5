//! Whether a scan takes longer as the map grows: an endless street, and the times of its scans.
//!
//! The street is driven through once. Then it comes again, moved along x by whole regions of the map, so that each pass makes
//! new blocks but does exactly the same work: what differs between passes is the size of the map.

use std::path::Path;

use anyhow::{Context, Result, bail};
use glam::DVec3;
use indicatif::{BinaryBytes, HumanCount};
use serde::Serialize;
use tsdfuse::{Scan, SensorModel};
use tsdfuse_io::dataset::{ScanRef, Source};
use tsdfuse_io::{Dataset, Error};

use super::args::Args;
use super::changes::pieces;
use super::street;
use crate::config::{RunConfig, Suggested};
use crate::evaluate::results::median;
use crate::exit::Outcome;
use crate::fuse::{Fusion, PagingReport};
use crate::machine::Machine;
use crate::report::{MapReport, MeshReport, ScanReport, command_line, peak_memory_bytes, print, print_json};

/// Scans of a pass: whole turns of what is done every few scans (carving: 8).
const PASS: usize = 104;

const SENSOR: &str = "vlp16";

/// Longer than the street, so that passes do not meet.
const STREET_M: f64 = 125.0;

/// Rows of the table.
const ROWS: usize = 10;

/// The scans of one pass, again and again.
struct Drive {
    sensor: SensorModel,
    pass: Vec<Scan>,
    scans: Vec<ScanRef>,
}

impl Drive {
    fn new(scans: usize, voxel_size_m: f64) -> Result<Self> {
        let simulator = street::simulator(SENSOR, PASS)?;
        // A region is 64 voxels wide; moved by whole ones, the map's grid meets the street as before.
        let region_m = 64.0 * voxel_size_m;
        let period_m = region_m * (STREET_M / region_m).ceil();
        let scan = |number: usize| {
            let mut pose = simulator.path()[number % PASS];
            pose.translation += DVec3::X * (number / PASS) as f64 * period_m;
            ScanRef {
                name: number.to_string(),
                timestamp_secs: None,
                pose,
            }
        };
        Ok(Self {
            sensor: simulator.sensor().clone(),
            pass: simulator.scans().collect(),
            scans: (0..scans).map(scan).collect(),
        })
    }
}

impl Drive {
    /// The way of the sensor.
    fn length_m(&self) -> f64 {
        let places = self.scans.iter().map(|scan| scan.pose.translation);
        places.clone().zip(places.skip(1)).map(|(a, b)| a.distance(b)).sum()
    }
}

impl Source for Drive {
    fn format(&self) -> &'static str {
        "simulated"
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> tsdfuse_io::Result<Scan> {
        let reference = self.scans.get(index);
        let reference = reference.ok_or_else(|| Error::dataset("the long drive", format!("has no scan {index}")))?;
        Ok(Scan {
            name: reference.name.clone(),
            pose: reference.pose,
            ..self.pass[index % PASS].clone()
        })
    }

    fn sensor(&self) -> Option<SensorModel> {
        Some(self.sensor.clone())
    }
}

/// Everything.
#[derive(Debug, Serialize)]
struct Results {
    version: &'static str,
    command_line: Vec<String>,
    machine: Machine,
    config: RunConfig,
    passes: Vec<Pass>,
    /// Of a drive with little memory.
    stored: Option<Stored>,
}

/// The whole map at the end of a drive with little memory.
#[derive(Debug, Serialize)]
struct Stored {
    length_km: f64,
    map: MapReport,
    paging: Option<PagingReport>,
    mesh: MeshReport,
    peak_memory_bytes: Option<u64>,
}

impl Stored {
    fn of(fusion: &mut Fusion, config: &RunConfig, length_km: f64, folder: &Path) -> Result<Self> {
        fusion.commit()?;
        let mesh = fusion.surface(&config.mesh, &folder.join("drive.ply"))?;
        let (map, paging) = fusion.state();
        Ok(Self {
            length_km,
            map,
            paging,
            mesh,
            peak_memory_bytes: peak_memory_bytes(),
        })
    }

    fn text(&self) -> String {
        let Self {
            length_km, map, mesh, ..
        } = self;
        let bytes = |bytes: u64| BinaryBytes(bytes).to_string();
        let mut text = format!(
            "\n{length_km:.2} km: {} blocks, {} of voxels; mesh of {} triangles in {:.1} s, written in {:.1} s; peak memory {}\n",
            HumanCount(map.blocks as u64),
            bytes(map.blocks as u64 * size_of::<tsdfuse::map::Block>() as u64),
            HumanCount(mesh.triangles as u64),
            mesh.seconds,
            mesh.write_seconds,
            self.peak_memory_bytes.map_or_else(String::new, bytes),
        );
        if let Some(paging) = &self.paging {
            text += &paging.text(*length_km);
        }
        text
    }
}

/// A drive through the street.
#[derive(Clone, Debug, Serialize)]
struct Pass {
    /// Its first scan.
    from: usize,
    /// `prepare + fuse` of each scan.
    scan_secs: Vec<f64>,
    fused: u64,
    updated_blocks: usize,
    /// The map after it, and how much of it is in memory.
    blocks: usize,
    map_bytes: usize,
}

pub(super) fn run(args: &Args, scans: usize) -> Result<Outcome> {
    let method = args.methods(&Suggested {
        sensor: tsdfuse::sensor::model(SENSOR),
        ..Default::default()
    })?;
    let method = method.into_iter().next().context("a method is wanted")?;
    let drive = Drive::new(scans, method.config.map.voxel_size_m)?;
    let mut fusion = Fusion::new(&args.settings, &method.config, Some(&drive.sensor))?;
    let folder = tempfile::Builder::new().prefix(".tsdfuse-drive-").tempdir_in(".")?;
    if let Some(memory) = args.memory {
        fusion.limit(memory, folder.path().join("drive.store"), &method.config)?;
    }
    let length_km = drive.length_m() / 1e3;
    let dataset = Dataset::new(drive);
    let mut passes: Vec<Pass> = Vec::new();
    for from in (0..scans).step_by(PASS) {
        let to = scans.min(from + PASS);
        fusion.fuse_some(&dataset, (from..to).collect())?;
        let done = &fusion.scans[from..];
        let (map, _) = fusion.state();
        let pass = Pass::of(from, done, map.blocks, map.bytes);
        pass.check(passes.first().unwrap_or(&pass))?;
        passes.push(pass);
    }
    let stored = args
        .memory
        .map(|_| Stored::of(&mut fusion, &method.config, length_km, folder.path()));
    let stored = stored.transpose()?;
    let results = Results {
        stored,
        version: env!("CARGO_PKG_VERSION"),
        command_line: command_line(),
        machine: Machine::here(rayon::current_num_threads()),
        config: method.config,
        passes,
    };
    if args.json {
        print_json(&results)?;
    } else {
        print(&table(&results))?;
    }
    Ok(Outcome::Complete)
}

impl Pass {
    fn of(from: usize, scans: &[ScanReport], blocks: usize, map_bytes: usize) -> Self {
        let secs = |scan: &ScanReport| scan.sums.prepare + scan.sums.fuse;
        Self {
            from,
            scan_secs: scans.iter().map(secs).collect(),
            fused: scans.iter().map(|scan| scan.sums.fused).sum(),
            updated_blocks: scans.iter().map(|scan| scan.updated_blocks).sum(),
            blocks,
            map_bytes,
        }
    }

    /// A whole pass does what the first one does.
    fn check(&self, first: &Self) -> Result<()> {
        let work = |pass: &Self| (pass.fused, pass.updated_blocks);
        if self.fused == 0 {
            bail!("no return could be fused from scan {} on", self.from);
        }
        if self.is_whole() && work(self) != work(first) {
            bail!(
                "passes differ: {:?} returns and blocks in the first, {:?} from scan {} on",
                work(first),
                work(self),
                self.from
            );
        }
        Ok(())
    }

    fn is_whole(&self) -> bool {
        self.scan_secs.len() == PASS
    }
}

fn table(results: &Results) -> String {
    let Results {
        machine,
        config,
        passes,
        ..
    } = results;
    let secs: Vec<f64> = passes.iter().flat_map(|pass| &pass.scan_secs).copied().collect();
    let ms = |secs: &[f64]| 1e3 * median(secs.to_vec());
    let mut text = format!(
        "{}, {} thread{}, {}, {}\n{} scans of a {SENSOR} in a simulated street that comes again and again, {}, voxels of {} m\n\n\
         ms a scan, medians: first ten {:.2}, first pass {:.2}, last {PASS} {:.2}; slowest {:.2}\n",
        machine.processor.as_deref().unwrap_or(machine.system),
        machine.threads,
        if machine.threads == 1 { "" } else { "s" },
        machine.simd,
        machine.date,
        HumanCount(secs.len() as u64),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn pass(secs: f64, fused: u64, updated_blocks: usize) -> Pass {
        Pass {
            from: 0,
            scan_secs: (0..PASS).map(|scan| secs + scan as f64).collect(),
            fused,
            updated_blocks,
            blocks: 9,
            map_bytes: 9,
        }
    }

    #[test]
    fn a_pass_that_does_other_work_is_refused() {
        let first = pass(1.0, 7, 3);
        assert!(pass(2.0, 7, 3).check(&first).is_ok());
        for other in [pass(1.0, 8, 3), pass(1.0, 7, 4)] {
            let told = other.check(&first).unwrap_err().to_string();
            assert!(
                told.starts_with("passes differ: (7, 3) returns and blocks in the first"),
                "{told}"
            );
        }
        let told = pass(1.0, 0, 3).check(&first).unwrap_err().to_string();
        assert_eq!(told, "no return could be fused from scan 0 on");
        // The last pass may be a part of one.
        let mut part = pass(1.0, 6, 2);
        part.scan_secs.pop();
        assert!(part.check(&first).is_ok());
    }

    #[test]
    fn each_scan_counts_with_its_fastest_pass() {
        let mut slow_start = pass(1.0, 7, 3);
        slow_start.scan_secs[0] = 50.0;
        let best = fastest(&[&slow_start, &pass(2.0, 7, 3)]);
        assert_eq!((best.len(), best[0], best[1]), (PASS, 2.0, 2.0));
        assert_eq!(mean(&best[..2]), 2.0);
    }

    /// All of it moves by whole regions, and nothing is seen twice.
    #[test]
    fn the_street_comes_again_elsewhere() {
        for voxel_size_m in [0.1, 0.3] {
            let drive = Drive::new(250, voxel_size_m).unwrap();
            let scan = |number| drive.read(number).unwrap();
            let (first, again) = (scan(30), scan(30 + 2 * PASS));
            assert_eq!(first.points, again.points);
            let moved = again.pose.translation - first.pose.translation;
            let regions = moved.x / 2.0 / (64.0 * voxel_size_m);
            assert!(
                (regions - regions.round()).abs() < 1e-9 && moved.x / 2.0 >= STREET_M,
                "{moved}"
            );
            assert_eq!((moved.y, moved.z), (0.0, 0.0));
            assert!(drive.read(250).is_err());
        }
    }
}
