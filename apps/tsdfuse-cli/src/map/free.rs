//! `tsdfuse map free`: what is known to be free, what is occupied, and where the unknown begins.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use indicatif::HumanCount;
use serde::Serialize;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse_io::npz::Arrays;
use tsdfuse_io::{OpenOptions, ReadScan, Selection, atomic, nav2, octomap};
use tsdfuse_plan::occupancy::{Frontier, Occupancy, OccupancyConfig, Slice, State};
use tsdfuse_run::{Input, check_outputs};

use crate::args::parse_extrinsics;
use crate::exit::{self, Outcome, Usage};
use crate::progress::{self, note, say};
use crate::terminal::Terminal;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The log, with poses: a saved map does not hold the rays.
    log: PathBuf,
    /// The file to write: .bt (OctoMap), .yaml (nav2, with a .pgm beside it) or .npz.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Write where free space meets unknown space (.json).
    #[arg(long, value_name = "FILE")]
    frontiers: Option<PathBuf>,
    /// The smallest frontier that is told, voxels.
    #[arg(long, value_name = "N", default_value_t = 20, requires = "frontiers")]
    min_frontier: usize,
    /// With .npz: one array of the whole box (0 unknown, 1 free, 2 occupied) instead of a list of known voxels.
    #[arg(long)]
    dense: bool,
    /// Voxel size, metres.
    #[arg(long, value_name = "M", default_value_t = OccupancyConfig::default().voxel_size_m)]
    voxel_size: f64,
    /// Rays are followed up to this range, metres.
    #[arg(long, value_name = "M", default_value_t = OccupancyConfig::default().max_range_m)]
    max_range: f64,
    /// Heights that obstacles and frontiers lie between, metres, in the world's z (.yaml and frontiers) [default: all].
    #[arg(long, value_name = "LOW..HIGH", value_parser = parse_heights, allow_hyphen_values = true)]
    heights: Option<[f64; 2]>,
    /// Cells of a .yaml cost the less the farther they are from occupied ones, up to this distance, metres.
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    inflate: f64,
    /// Only these scans, counted from 0, TO excluded; every STEP-th of them [default: all].
    #[arg(long, value_name = "FROM..TO[:STEP]")]
    scans: Option<Selection>,
    /// The sensors, with commas [default: the log's first].
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    sensor: Vec<String>,
    /// The poses: a file (KITTI or TUM text), or a topic or frame of a ROS bag [default: the log's].
    #[arg(long, value_name = "FILE|TOPIC|FRAME")]
    poses: Option<PathBuf>,
    /// Where the sensor sits on the body whose poses are used: a file with the 3x4 matrix, or x,y,z,qx,qy,qz,qw (metres, quaternion).
    #[arg(long, value_name = "FILE|POSE", value_parser = parse_extrinsics, allow_hyphen_values = true)]
    extrinsics: Option<tsdfuse::Pose>,
    /// Skip scans that cannot be read; they are listed, and the exit code is 3.
    #[arg(long)]
    skip_bad: bool,
}

/// What is written.
#[derive(Clone, Copy)]
enum Format {
    OctoMap,
    Nav2,
    Npz,
}

/// A frontier as it is told.
#[derive(Serialize)]
struct Told {
    /// World, metres.
    center_m: DVec3,
    voxels: usize,
}

impl Args {
    fn format(&self) -> Result<Format> {
        let extension = self.output.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("bt") => Ok(Format::OctoMap),
            Some("yaml" | "yml") => Ok(Format::Nav2),
            Some("npz") => Ok(Format::Npz),
            _ => {
                let told = "free space is written as .bt, .yaml or .npz";
                Err(Usage::new(format_args!("{}: {told}", self.output.display())).into())
            }
        }
    }

    pub(super) fn run(&self) -> Result<Outcome> {
        let format = self.format()?;
        if self.dense && !matches!(format, Format::Npz) {
            return Err(Usage::new("--dense is for .npz").into());
        }
        let config = OccupancyConfig {
            voxel_size_m: self.voxel_size,
            max_range_m: self.max_range,
        };
        let mut occupancy = Occupancy::new(config).map_err(Usage::new)?;
        let mut outputs = vec![self.output.clone()];
        if let Format::Nav2 = format {
            outputs.push(nav2::picture_beside(&self.output)?);
        }
        outputs.extend(self.frontiers.clone());
        let inputs: Vec<&Path> = [Some(&self.log), self.poses.as_ref()]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect();
        check_outputs(&inputs, &outputs.iter().map(PathBuf::as_path).collect::<Vec<_>>())?;
        let outcome = self.fill(&mut occupancy)?;
        let [low_m, high_m] = self.heights.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        match format {
            Format::OctoMap => {
                let known = occupancy
                    .known()
                    .map(|(voxel, state)| (voxel, state == State::Occupied));
                octomap::write(&self.output, config.voxel_size_m, known)?;
            }
            Format::Nav2 => {
                let slice = occupancy.slice(low_m, high_m);
                let slice = slice.with_context(|| format!("nothing is known between {low_m} and {high_m} m"))?;
                let costs = slice.costs(self.inflate);
                let Slice {
                    origin, cell_m, width, ..
                } = slice;
                nav2::write(
                    &self.output,
                    &nav2::OccupancyGrid {
                        origin,
                        cell_m,
                        width,
                        costs,
                    },
                )?;
            }
            Format::Npz if self.dense => write_dense(&self.output, &occupancy)?,
            Format::Npz => write_arrays(&self.output, &occupancy)?,
        }
        let count = |wanted| occupancy.known().filter(|(_, state)| *state == wanted).count() as u64;
        say(format_args!("  free     {}", HumanCount(count(State::Free))));
        say(format_args!("  occupied {}", HumanCount(count(State::Occupied))));
        if let Some(path) = &self.frontiers {
            let frontiers = occupancy.frontiers(low_m, high_m, self.min_frontier);
            write_frontiers(path, &frontiers)?;
            say(format_args!(
                "  {:<8} {}",
                "frontiers",
                HumanCount(frontiers.len() as u64)
            ));
        }
        for output in &outputs {
            say(format_args!("  wrote    {}", output.display()));
        }
        Ok(outcome)
    }

    /// Takes in all scans.
    fn fill(&self, occupancy: &mut Occupancy) -> Result<Outcome> {
        let input = Input {
            path: self.log.clone(),
            options: OpenOptions {
                poses: self.poses.clone(),
                sensors: self.sensor.clone(),
                extrinsics: self.extrinsics,
                ..OpenOptions::default()
            },
            selection: self.scans.clone().unwrap_or_default(),
            skip_bad: self.skip_bad,
        };
        let log = input.open(&tsdfuse_run::Settings::default(), &mut Terminal::default())?;
        let range = log.suggested().range;
        let stop = exit::stop_on_interrupt()?;
        let bar = progress::scans("following rays", log.len());
        let mut skipped = 0;
        for ReadScan { scan, .. } in log.read_ahead(&input.selection) {
            match scan {
                Ok(mut scan) => {
                    scan.drop_invalid(&range);
                    occupancy.integrate(&scan)?;
                }
                Err(error) if self.skip_bad => {
                    note(error);
                    skipped += 1;
                }
                Err(error) => return Err(error).context("--skip-bad leaves such scans out"),
            }
            bar.inc(1);
            if stop.is_stopped() {
                break;
            }
        }
        Ok(if skipped > 0 || stop.is_stopped() {
            Outcome::ScansSkipped
        } else {
            Outcome::Complete
        })
    }
}

/// Writes all known voxels, sorted by chunks.
fn write_arrays(path: &Path, occupancy: &Occupancy) -> Result<()> {
    let count = occupancy.known().count();
    let voxels = || occupancy.known().map(|(voxel, _)| voxel);
    atomic::write(path, |out| {
        let mut arrays = Arrays::new(out);
        arrays.add(
            "voxels",
            &[count, 3],
            voxels().flat_map(|voxel: IVec3| voxel.to_array()),
        )?;
        let occupied = occupancy.known().map(|(_, state)| u8::from(state == State::Occupied));
        arrays.add("occupied", &[count], occupied)?;
        arrays.add("voxel_size_m", &[], [occupancy.config().voxel_size_m])?;
        arrays.finish()
    })?;
    Ok(())
}

/// Writes the box of all known voxels.
fn write_dense(path: &Path, occupancy: &Occupancy) -> Result<()> {
    let dense = occupancy.dense()?;
    let number = |state: &State| match state {
        State::Unknown => 0_u8,
        State::Free => 1,
        State::Occupied => 2,
    };
    atomic::write(path, |out| {
        let mut arrays = Arrays::new(out);
        arrays.add("states", &dense.size, dense.values.iter().map(number))?;
        arrays.add("low_voxel", &[3], dense.low.to_array())?;
        arrays.add("voxel_size_m", &[], [occupancy.config().voxel_size_m])?;
        arrays.finish()
    })?;
    Ok(())
}

fn write_frontiers(path: &Path, frontiers: &[Frontier]) -> Result<()> {
    let told = |frontier: &Frontier| Told {
        center_m: frontier.center,
        voxels: frontier.voxels.len(),
    };
    let json = serde_json::to_string_pretty(&frontiers.iter().map(told).collect::<Vec<_>>())?;
    atomic::write(path, |out| out.write_all(json.as_bytes()))?;
    Ok(())
}

fn parse_heights(text: &str) -> Result<[f64; 2], String> {
    let wanted = || "two heights are wanted, as in 0.3..1.8".to_owned();
    let (low, high) = text.split_once("..").ok_or_else(wanted)?;
    match [low, high].map(|height| height.trim().parse::<f64>()) {
        [Ok(low), Ok(high)] if low < high => Ok([low, high]),
        _ => Err(wanted()),
    }
}
