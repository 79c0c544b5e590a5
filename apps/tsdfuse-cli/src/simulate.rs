//! `tsdfuse simulate`: scans of a scene whose true surface is known.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use glam::DVec3;
use indicatif::HumanCount;
use serde::Serialize;
use tsdfuse_io::atomic::Folder;
use tsdfuse_io::plain::Writer;
use tsdfuse_sim::{Hits, NoiseModel, Simulator, SimulatorConfig, path, scene};

use crate::args::parse_triple;
use crate::exit::{Outcome, Usage};
use crate::progress::{self, say};

/// Largest distance between the true surface and `scene.ply`.
const CHORD_M: f64 = 0.002;

const MORE_HELP: &str = "\
Writes a folder that `tsdfuse fuse` reads, with rings, sensor.toml, the scene's true surface (scene.ply), the part that beams hit (hits.ply: noise-free returns, the first one in each 5 cm cell) and how it was made \
(simulation.toml). The same arguments give the same bytes.

Examples:
  tsdfuse simulate --scene street --scans 80 -o street
  tsdfuse simulate --scene hall --sensor os0-128 --path handheld --motion -o hall
  tsdfuse simulate --scene sphere --noise 0 --dropout 0 --grazing-loss off -o sphere";

/// Simulate a LiDAR in a scene whose true surface is known.
#[derive(Debug, clap::Args)]
#[command(after_help = MORE_HELP)]
pub(crate) struct Args {
    /// What is scanned.
    #[arg(long, value_parser = PossibleValuesParser::new(scene::names()))]
    scene: String,
    /// What scans.
    #[arg(long, default_value = "pandar64", value_parser = PossibleValuesParser::new(tsdfuse::sensor::names()))]
    sensor: String,
    /// Number of scans.
    #[arg(long, value_name = "N", default_value_t = 80, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    scans: u32,
    /// The folder to create; it may exist if it is empty.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// How the sensor moves [default: vehicle in the street, drone in the hall, orbit around all else].
    #[arg(long, value_parser = PossibleValuesParser::new(path::names()))]
    path: Option<String>,
    /// Standard deviation of the range noise, metres.
    #[arg(long, value_name = "M", default_value_t = NoiseModel::default().range_sigma_m)]
    noise: f64,
    /// Probability that a return is lost at random.
    #[arg(long, value_name = "P", default_value_t = NoiseModel::default().dropout)]
    dropout: f64,
    /// Lose weak echoes (long range, grazing incidence).
    #[arg(long, value_name = "ON|OFF", default_value = "on", value_parser = PossibleValuesParser::new(["on", "off"]))]
    grazing_loss: String,
    /// Move the sensor during each sweep; every point gets its time.
    #[arg(long)]
    motion: bool,
    /// Seed of the scene and the noise.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Offset of all coordinates, metres, for instance to UTM.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_triple, allow_hyphen_values = true, default_value = "0,0,0")]
    offset: DVec3,
}

/// How a sequence was made, for `simulation.toml`.
#[derive(Debug, Serialize)]
struct Made<'a> {
    tsdfuse: &'a str,
    scene: &'a str,
    sensor: &'a str,
    scans: u32,
    path: &'a str,
    offset_m: DVec3,
    simulator: SimulatorConfig,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let start = Instant::now();
    let simulator = simulator(args, args.noise)?;
    let folder = Folder::begin(&args.output)?;
    let points = write(args, &simulator, folder.path())?;
    folder.finish()?;
    say(format_args!(
        "{}: {} scans of {} with {}, {} points, {:.1} s",
        args.output.display(),
        args.scans,
        args.scene,
        args.sensor,
        HumanCount(points),
        start.elapsed().as_secs_f64()
    ));
    Ok(Outcome::Complete)
}

/// The simulator, with ranges of this standard deviation.
fn simulator(args: &Args, range_sigma_m: f64) -> Result<Simulator> {
    let scene = scene::by_name(&args.scene, args.seed).context("the scene cannot be built")?;
    let scene = scene.translated(args.offset);
    let sensor = tsdfuse::sensor::model(&args.sensor).context("the sensor is not known")?;
    let scans = args.scans as usize;
    let path = match &args.path {
        Some(name) => path::by_name(name, &scene, scans).context("the path is not known")?,
        None => path::default_for(&scene, scans),
    };
    let mut config = config(args);
    config.noise.range_sigma_m = range_sigma_m;
    Ok(Simulator::new(scene, sensor, path, config).map_err(Usage::new)?)
}

fn config(args: &Args) -> SimulatorConfig {
    let usual = NoiseModel::default();
    SimulatorConfig {
        noise: NoiseModel {
            range_sigma_m: args.noise,
            dropout: args.dropout,
            weak_echo: if args.grazing_loss == "on" {
                usual.weak_echo
            } else {
                0.0
            },
            ..usual
        },
        motion: args.motion,
        seed: args.seed,
        ..Default::default()
    }
}

/// Writes all files; returns how many points there are.
fn write(args: &Args, simulator: &Simulator, folder: &Path) -> Result<u64> {
    let mut writer = Writer::create(folder)?;
    writer.write_sensor(simulator.sensor())?;
    let bar = progress::scans("simulating", Some(args.scans as usize));
    let mut points = 0;
    let exact = self::simulator(args, 0.0)?;
    let mut hits = Hits::default();
    for (scan, exact) in simulator.scans().zip(exact.scans()) {
        writer.write_scan(&scan)?;
        hits.add(&exact);
        points += scan.points.len() as u64;
        bar.inc(1);
    }
    drop(bar);
    writer.finish()?;
    tsdfuse_io::mesh::write(folder.join("scene.ply"), &simulator.scene().mesh(CHORD_M))?;
    tsdfuse_io::mesh::write(folder.join("hits.ply"), &hits.into_cloud())?;
    let made = Made {
        tsdfuse: env!("CARGO_PKG_VERSION"),
        scene: &args.scene,
        sensor: &args.sensor,
        scans: args.scans,
        path: args.path.as_deref().unwrap_or("default"),
        offset_m: args.offset,
        simulator: config(args),
    };
    let file = folder.join("simulation.toml");
    fs::write(&file, toml::to_string(&made)?).with_context(|| file.display().to_string())?;
    Ok(points)
}
