//! Whether a scan takes longer as the map grows: an endless street, and the times of its scans.
//!
//! The street is driven through once. Then it comes again, moved along x by whole regions of the map, so that each pass makes
//! new blocks but does exactly the same work: what differs between passes is the size of the map.

use anyhow::{Context, Result, bail};
use glam::DVec3;
use indicatif::HumanCount;
use serde::Serialize;
use tsdfuse::{Scan, SensorModel};
use tsdfuse_io::dataset::{ScanRef, Source};
use tsdfuse_io::{Dataset, Error};

use super::args::Args;
use super::street;
use crate::config::{RunConfig, Suggested};
use crate::evaluate::results::median;
use crate::exit::Outcome;
use crate::fuse::Fusion;
use crate::machine::Machine;
use crate::report::{ScanReport, print, print_json};

/// Scans of a pass.
const PASS: usize = 100;

const SENSOR: &str = "vlp16";

/// Longer than the street, so that passes do not meet.
const STREET_M: f64 = 125.0;

/// Passes that the table shows.
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
    /// `prepare + fuse` of each scan.
    scan_secs: Vec<f64>,
    /// New and updated blocks of each scan.
    updated_blocks: Vec<usize>,
}

/// A drive through the street.
#[derive(Clone, Copy, Debug, Serialize)]
struct Pass {
    /// Its first scan.
    from: usize,
    scans: usize,
    /// Of its first ten scans, seconds: the first of them makes more new blocks than any other.
    first_ten_secs: f64,
    median_secs: f64,
    max_secs: f64,
    fused: u64,
    updated_blocks: usize,
    /// The map after it.
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
    let dataset = Dataset::new(drive);
    let mut passes: Vec<Pass> = Vec::new();
    for from in (0..scans).step_by(PASS) {
        let to = scans.min(from + PASS);
        fusion.fuse_some(&dataset, (from..to).collect())?;
        let done = &fusion.scans[from..];
        let pass = Pass::of(from, done, fusion.map.block_count(), fusion.map.memory_bytes());
        if pass.fused == 0 {
            bail!("no return of scans {from} to {to} could be fused");
        }
        if let Some(first) = passes.first().filter(|first| first.scans == pass.scans) {
            let work = |pass: &Pass| (pass.fused, pass.updated_blocks);
            if work(first) != work(&pass) {
                bail!(
                    "passes differ: {:?} returns and blocks in the first, {:?} from scan {from} on",
                    work(first),
                    work(&pass)
                );
            }
        }
        passes.push(pass);
    }
    let results = Results {
        version: env!("CARGO_PKG_VERSION"),
        command_line: std::env::args_os().map(|a| a.to_string_lossy().into_owned()).collect(),
        machine: Machine::here(rayon::current_num_threads()),
        config: method.config,
        passes,
        scan_secs: fusion.scans.iter().map(secs).collect(),
        updated_blocks: fusion.scans.iter().map(|scan| scan.updated_blocks).collect(),
    };
    if args.json {
        print_json(&results)?;
    } else {
        print(&table(&results))?;
    }
    Ok(Outcome::Complete)
}

fn secs(scan: &ScanReport) -> f64 {
    scan.sums.prepare + scan.sums.fuse
}

impl Pass {
    fn of(from: usize, scans: &[ScanReport], blocks: usize, map_bytes: usize) -> Self {
        let times: Vec<f64> = scans.iter().map(secs).collect();
        Self {
            from,
            scans: scans.len(),
            first_ten_secs: median(times[..times.len().min(10)].to_vec()),
            max_secs: times.iter().copied().fold(0.0, f64::max),
            median_secs: median(times),
            fused: scans.iter().map(|scan| scan.sums.fused).sum(),
            updated_blocks: scans.iter().map(|scan| scan.updated_blocks).sum(),
            blocks,
            map_bytes,
        }
    }
}

fn table(results: &Results) -> String {
    let Results {
        machine,
        config,
        passes,
        scan_secs,
        ..
    } = results;
    let mut text = format!(
        "{}, {} threads, {}, {}\n{} scans of a {SENSOR} in a simulated street that repeats itself, {}, voxels of {} m: ms a scan\n\n\
         {:>15} {:>12} {:>8} {:>8} {:>12} {:>9}\n",
        machine.processor.as_deref().unwrap_or(machine.system),
        machine.threads,
        machine.simd,
        machine.date,
        HumanCount(scan_secs.len() as u64),
        config.method.name(),
        config.map.voxel_size_m,
        "scans",
        "first ten",
        "median",
        "slowest",
        "blocks after",
        "map MB"
    );
    let whole: Vec<&Pass> = passes.iter().filter(|pass| pass.scans == passes[0].scans).collect();
    for pass in shown(&whole) {
        text += &format!(
            "{:>15} {:>12.2} {:>8.2} {:>8.2} {:>12} {:>9.0}\n",
            format!("{}–{}", pass.from, pass.from + pass.scans - 1),
            1e3 * pass.first_ten_secs,
            1e3 * pass.median_secs,
            1e3 * pass.max_secs,
            pass.blocks,
            pass.map_bytes as f64 / 1e6,
        );
    }
    if let [first, .., last] = whole[..] {
        let tenth = whole.len().div_ceil(10);
        let of = |passes: &[&Pass]| median(passes.iter().map(|pass| pass.median_secs).collect());
        text += &format!(
            "\nEach pass does the same work. Last to first: first ten {:.2}, median {:.2}; last tenth of the passes to first tenth {:.2}.\n",
            last.first_ten_secs / first.first_ten_secs,
            last.median_secs / first.median_secs,
            of(&whole[whole.len() - tenth..]) / of(&whole[..tenth]),
        );
    }
    text
}

/// The first, the last, and some between.
fn shown<'a>(passes: &[&'a Pass]) -> Vec<&'a Pass> {
    let last = passes.len().saturating_sub(1);
    let rows = ROWS.min(last);
    let numbers = (0..=rows).map(|row| row * last / rows.max(1));
    numbers.map(|number| passes[number]).collect()
}
