//! `tsdfuse fuse`: scans and poses in, a mesh out.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::builder::PossibleValuesParser;
use indicatif::ProgressBar;
use tsdfuse::fuse::Method;
use tsdfuse::mesh::extract_with;
use tsdfuse::scan::RangeLimits;
use tsdfuse::{Integrator, MapConfig, Mesh, Scan, SensorModel, VoxelMap};
use tsdfuse_io::{Dataset, OpenOptions, ReadScan};

use crate::config::{Layers, RunConfig};
use crate::exit::{Outcome, Usage, one_line};
use crate::progress::{self, note, say};
use crate::report::{
    DatasetReport, MapReport, MeshReport, Report, ScanReport, SkippedScan, Sums, Totals, peak_memory_bytes, print_json,
};

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 -o street.ply
  tsdfuse fuse kitti/sequences/00 -o street.ply --scans 0..80 --voxel-size 0.1 --truncation 0.3
  tsdfuse fuse street -o street.ply --config run.toml --set raycast.distance=projective --report report.json

The data set's format is recognised. Settings: defaults < --config < --set < flags; a report holds all of them.";

/// Fuse scans into a map and extract its surface.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The data set's folder: PandaSet, KITTI, a plain folder, ....
    dataset: PathBuf,
    /// The mesh to write, .ply, .glb or .obj; `-` writes PLY to standard output.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[arg(long, value_parser = PossibleValuesParser::new(Method::ALL.iter().map(|m| m.name())),
        help = format!("How scans are fused [default: {}]", Method::default().name()))]
    method: Option<String>,
    #[arg(long, value_name = "M",
        help = format!("Edge of a voxel, metres [default: {}]", MapConfig::default().voxel_size_m))]
    voxel_size: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Half width of the band around the surface, metres [default: {}]", MapConfig::default().truncation_m))]
    truncation: Option<f64>,
    /// Which scans are fused, counted from 0, the last one excluded; every STEP-th of them [default: all].
    #[arg(long, value_name = "FROM..TO[:STEP]")]
    scans: Option<Selection>,
    /// Poses to use instead of the data set's own (KITTI or TUM text).
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// The sensor: one of several in the log, or the model of the only one (pandar64, hdl64e, vlp16, ...).
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    #[arg(long, value_name = "M",
        help = format!("Nearer returns are left out, metres [default: {}]", RangeLimits::default().min_range_m))]
    min_range: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Farther returns are left out, metres [default: the sensor's, or {}]", RangeLimits::default().max_range_m))]
    max_range: Option<f64>,
    /// Threads; their number does not change the result [default: one for each core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    #[arg(
        long,
        value_name = "W",
        help = "Voxels of less weight do not become surface [default: 0]"
    )]
    min_weight: Option<f64>,
    /// Write what was done, with the configuration, counts and times of each scan, as JSON.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Read settings from a TOML file.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set anything a --config file can set, for instance raycast.distance=projective.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Go on without scans that cannot be used; they are named, and the exit code is 3.
    #[arg(long)]
    skip_bad: bool,
    /// Print the report on standard output.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let start = Instant::now();
    let layers = args.layers()?;
    args.check_outputs()?;
    args.set_threads()?;
    let options = OpenOptions {
        poses: args.poses.clone(),
        sensor: args.sensor.clone(),
    };
    let dataset = tsdfuse_io::open_with(&args.dataset, &options)?;
    dataset.notes().iter().for_each(note);
    let indices = args.indices(dataset.len())?;
    let (sensor, sensor_guessed) = sensor(&dataset, &indices);
    let config = layers.resolve(dataset.sensor().as_ref())?;

    let mut fusion = Fusion {
        integrator: config.method.build(&config.methods(), sensor.as_ref()),
        map: VoxelMap::new(config.map)?,
        range: config.range,
        scans: Vec::new(),
        skipped: Vec::new(),
    };
    let fusing = Instant::now();
    fusion.fuse_all(&dataset, indices, args)?;
    let fusing_seconds = fusing.elapsed().as_secs_f64();
    let (mesh, mut mesh_report) = surface(&fusion.map, &config, &args.output)?;
    let writing = Instant::now();
    tsdfuse_io::mesh::write(&args.output, &mesh)?;
    mesh_report.write_seconds = writing.elapsed().as_secs_f64();

    let report = Report {
        version: env!("CARGO_PKG_VERSION"),
        command_line: std::env::args_os().map(|a| a.to_string_lossy().into_owned()).collect(),
        threads: rayon::current_num_threads(),
        dataset: DatasetReport {
            path: args.dataset.clone(),
            format: dataset.format(),
            scans: dataset.len(),
            sensor,
            sensor_guessed,
            notes: dataset.notes().to_vec(),
        },
        config,
        totals: fusion.totals(fusing_seconds),
        map: MapReport::of(&fusion.map),
        scans: fusion.scans,
        skipped_scans: fusion.skipped,
        mesh: mesh_report,
        peak_memory_bytes: peak_memory_bytes(),
        wall_seconds: start.elapsed().as_secs_f64(),
    };
    if let Some(path) = &args.report {
        report.write(path)?;
    }
    report.summarize();
    if args.json {
        print_json(&report)?;
    }
    Ok(if report.skipped_scans.is_empty() {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}

impl Args {
    /// All settings but those that only the data can tell.
    fn layers(&self) -> Result<Layers> {
        let mut layers = self
            .config
            .as_deref()
            .map(Layers::read)
            .transpose()?
            .unwrap_or_default();
        for setting in &self.set {
            layers.set_text(setting)?;
        }
        if let Some(method) = &self.method {
            layers.set("--method", "method", method.as_str())?;
        }
        let numbers = [
            ("--voxel-size", "map.voxel_size_m", self.voxel_size),
            ("--truncation", "map.truncation_m", self.truncation),
            ("--min-range", "range.min_range_m", self.min_range),
            ("--max-range", "range.max_range_m", self.max_range),
            ("--min-weight", "mesh.min_weight", self.min_weight),
        ];
        for (flag, key, value) in numbers {
            if let Some(value) = value {
                layers.set(flag, key, value)?;
            }
        }
        Ok(layers)
    }

    /// Finds out before the work, not after it, that its results could not be written.
    fn check_outputs(&self) -> Result<()> {
        let to_stdout = self.output.as_os_str() == "-";
        if to_stdout && self.json {
            return Err(Usage::new("--output - and --json cannot both have standard output").into());
        }
        let mesh = Some(&self.output).filter(|_| !to_stdout);
        for path in mesh.into_iter().chain(&self.report) {
            let folder = path
                .parent()
                .filter(|p| !p.as_os_str().is_empty())
                .unwrap_or(Path::new("."));
            if !folder.is_dir() {
                bail!("{}: there is no folder {}", path.display(), folder.display());
            }
            if path.is_dir() {
                bail!("{}: is a folder, not a file to write", path.display());
            }
        }
        Ok(())
    }

    fn set_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().with_context(|| format!("--threads {threads}"))
    }

    /// The numbers of the scans to fuse.
    fn indices(&self, scans: usize) -> Result<Vec<usize>> {
        let Some(Selection { from, to, step }) = self.scans else {
            return Ok((0..scans).collect());
        };
        if from >= scans {
            bail!(Usage::new(format_args!(
                "--scans begins at {from}, but there are only {scans} scans"
            )));
        }
        if let Some(to) = to.filter(|&to| to > scans) {
            note(format_args!("--scans ends at {to}, but there are only {scans} scans"));
        }
        let range = from..to.unwrap_or(scans).min(scans);
        Ok(range.step_by(step).collect())
    }
}

/// The model of the sensor, and whether it was guessed from the first scan that can be read.
fn sensor(dataset: &Dataset, indices: &[usize]) -> (Option<SensorModel>, bool) {
    if let Some(stated) = dataset.sensor() {
        return (Some(stated), false);
    }
    let first = indices.iter().find_map(|&i| dataset.read(i).ok());
    let guess = first.and_then(|scan| tsdfuse::sensor::guess(&scan.points, scan.rings.as_deref()));
    let guessed = guess.is_some();
    (guess, guessed)
}

/// A map that grows scan by scan, and what became of each scan.
struct Fusion {
    integrator: Box<dyn Integrator>,
    map: VoxelMap,
    range: RangeLimits,
    scans: Vec<ScanReport>,
    skipped: Vec<SkippedScan>,
}

impl Fusion {
    /// Fuses the scans in order; one that cannot be used ends the run, unless it may be skipped.
    fn fuse_all(&mut self, dataset: &Dataset, indices: Vec<usize>, args: &Args) -> Result<()> {
        let bar = progress::scans("fusing", indices.len());
        for read in dataset.iter_indices(indices) {
            let name = dataset
                .scans()
                .get(read.index)
                .map_or_else(String::new, |s| s.name.clone());
            match self.fuse(read) {
                Ok(scan) => self.scans.push(scan),
                Err(error) if args.skip_bad => self.skip(name, one_line(&error), &bar),
                Err(error) => return Err(error.context(args.dataset.display().to_string())),
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        if self.scans.is_empty() {
            bail!("{}: none of its scans could be fused", args.dataset.display());
        }
        if self.scans.iter().all(|scan| scan.sums.fused == 0) {
            let range = &self.range;
            bail!(
                "{}: no scan has a return between {} m and {} m that could be fused",
                args.dataset.display(),
                range.min_range_m,
                range.max_range_m
            );
        }
        Ok(())
    }

    fn fuse(&mut self, read: ReadScan) -> Result<ScanReport> {
        let mut scan: Scan = read.scan?;
        let start = Instant::now();
        scan.drop_invalid(&self.range);
        let dropping = start.elapsed().as_secs_f64();
        let done = self.integrator.integrate(&mut self.map, &scan)?;
        let prepare = dropping + done.prepare_secs;
        Ok(ScanReport {
            name: scan.name,
            sums: Sums {
                read: read.read_secs,
                prepare,
                fuse: start.elapsed().as_secs_f64() - prepare,
                points: scan.points.len() as u64 + scan.dropped.total(),
                fused: done.fused_returns,
                dropped: scan.dropped,
                skipped: done.skipped,
            },
            updated_blocks: done.updated_blocks.len(),
        })
    }

    fn skip(&mut self, name: String, reason: String, bar: &ProgressBar) {
        bar.suspend(|| say(format_args!("tsdfuse: warning: {name} is skipped: {reason}")));
        self.skipped.push(SkippedScan { name, reason });
    }

    fn totals(&self, seconds: f64) -> Totals {
        let mut sums = Sums::default();
        self.scans.iter().for_each(|scan| sums += &scan.sums);
        Totals {
            scans: self.scans.len(),
            sums,
            seconds,
        }
    }
}

/// Extracts the mesh, which must not be empty.
fn surface(map: &VoxelMap, config: &RunConfig, path: &Path) -> Result<(Mesh, MeshReport)> {
    let start = Instant::now();
    let spinner = progress::working("extracting the surface");
    let mesh = extract_with(map, &config.mesh)?;
    spinner.finish_and_clear();
    if mesh.triangles.is_empty() {
        bail!(
            "the map has no surface: {} blocks of voxels, but no triangle at a weight of {} or more",
            map.block_count(),
            config.mesh.min_weight
        );
    }
    let report = MeshReport::of(&mesh, path, start.elapsed().as_secs_f64());
    Ok((mesh, report))
}

/// Every `step`-th scan of `from..to`.
#[derive(Clone, Debug, PartialEq)]
struct Selection {
    from: usize,
    to: Option<usize>,
    step: usize,
}

impl FromStr for Selection {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || "FROM..TO or FROM..TO:STEP is wanted, as in 0..80:2; FROM or TO may be left out".to_owned();
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| wanted());
        let (range, step) = text
            .split_once(':')
            .map_or((text, None), |(range, step)| (range, Some(step)));
        let (from, to) = range.split_once("..").ok_or_else(wanted)?;
        let selection = Self {
            from: if from.is_empty() { 0 } else { number(from)? },
            to: if to.is_empty() { None } else { Some(number(to)?) },
            step: step.map_or(Ok(1), number)?,
        };
        match selection {
            Self { step: 0, .. } => Err("a step is 1 or more".to_owned()),
            Self { from, to: Some(to), .. } if from >= to => Err("it selects no scan".to_owned()),
            selection => Ok(selection),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_selected_by_range_and_step() {
        let select = |text: &str| text.parse::<Selection>().map(|s| (s.from, s.to, s.step));
        assert_eq!(select("0..80"), Ok((0, Some(80), 1)));
        assert_eq!(select("5..80:3"), Ok((5, Some(80), 3)));
        assert_eq!(select("5.."), Ok((5, None, 1)));
        assert_eq!(select("..7:2"), Ok((0, Some(7), 2)));
        for bad in ["", "5", "a..b", "-1..3", "0..5:", "0..5:0", "5..5", "7..3", "0..5:x"] {
            assert!(select(bad).is_err(), "{bad}");
        }
    }
}
