//! `tsdfuse bench --device gpu`: scans, meshes and views a second on a GPU, and what its kernels take.
//!
//! Scans are read beforehand, so that files do not count; all else does: invalid returns, what the CPU prepares, the way to
//! the device.

use std::time::Instant;

use anyhow::{Result, bail};
use serde::Serialize;
use tsdfuse::render::Camera;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, Scan, SensorModel};
use tsdfuse_gpu::{DeviceMap, Fuser, Gpu, Mesher, Renderer};

use super::method::Method;
use super::{Args, settings};
use crate::config::{RunConfig, Suggested};
use crate::device::gpu::pool;
use crate::evaluate::results::median;
use crate::exit::{Outcome, one_line};
use crate::machine::Machine;
use crate::report::{SkippedScan, command_line, print, print_json};

/// The picture that is rendered.
const SIZE: (u32, u32) = (1280, 720);
/// Pictures of a run; one where a CPU does as a GPU would.
const VIEWS: usize = 20;

/// Everything.
#[derive(Debug, Serialize)]
struct Results {
    version: &'static str,
    command_line: Vec<String>,
    machine: Machine,
    gpu: String,
    dataset: String,
    scans: usize,
    methods: Vec<Measured>,
    failed: Vec<SkippedScan>,
}

/// A method; seconds of wall time unless they are kernels'.
#[derive(Debug, Serialize)]
struct Measured {
    name: String,
    config: RunConfig,
    /// Per scan, of each run: into an empty map, which grows.
    scan: Vec<f64>,
    /// The mesh in the host's memory, of each run.
    mesh: Vec<f64>,
    /// A picture in the host's memory, of each run.
    view: Vec<f64>,
    triangles: usize,
    blocks: u32,
    map_bytes: u64,
    /// What kernels took, by the device's clock: per scan, mesh or view.
    kernels: Vec<Kernel>,
}

#[derive(Debug, Serialize)]
struct Kernel {
    name: &'static str,
    /// Of the median pass.
    seconds: f64,
    /// How often it ran.
    passes: usize,
}

pub(super) fn run(args: &Args, name: Option<&str>) -> Result<Outcome> {
    let gpu = Gpu::open(name)?;
    let (settings, _simulated) = settings(args)?;
    let dataset = settings.open()?;
    let suggested = Suggested::by(&dataset);
    let indices = settings.indices(dataset.len())?;
    let mut scans = Vec::new();
    for read in dataset.iter_indices(indices) {
        scans.push(read.scan?);
    }
    let (mut methods, mut failed) = (Vec::new(), Vec::new());
    for Method { name, config, .. } in args.methods(&suggested)? {
        match measure(&gpu, &name, &config, suggested.sensor.as_ref(), &scans, args.runs) {
            Ok(measured) => methods.push(measured),
            Err(error) => failed.push(SkippedScan {
                name,
                reason: one_line(&error),
            }),
        }
    }
    if let (true, Some(first)) = (methods.is_empty(), failed.first()) {
        bail!("{}", first.reason);
    }
    let results = Results {
        version: env!("CARGO_PKG_VERSION"),
        command_line: command_line(),
        machine: Machine::here(rayon::current_num_threads()),
        gpu: gpu.name(),
        dataset: args.settings.dataset.display().to_string(),
        scans: scans.len(),
        methods,
        failed,
    };
    if args.json {
        print_json(&results)?;
    } else {
        print(&table(&results))?;
    }
    Ok(Outcome::Complete)
}

fn measure(
    gpu: &Gpu,
    name: &str,
    config: &RunConfig,
    sensor: Option<&SensorModel>,
    scans: &[Scan],
    runs: u32,
) -> Result<Measured> {
    let (mut scan, mut mesh, mut view) = (Vec::new(), Vec::new(), Vec::new());
    let fuse = || -> Result<(DeviceMap, f64)> {
        let map = DeviceMap::new(gpu, config.map, pool(gpu))?;
        let mut fuser = Fuser::new(map, config.method, &config.methods(), sensor)?;
        let start = Instant::now();
        for scan in scans {
            let mut scan = scan.clone();
            scan.drop_invalid(&config.range);
            fuser.integrate(&scan)?;
        }
        Ok((fuser.into_map()?, start.elapsed().as_secs_f64() / scans.len() as f64))
    };
    let (map, _) = fuse()?; // compiles
    let mut mesher = Mesher::new(&map)?;
    let mut renderer = Renderer::new(&map, &Default::default())?;
    let camera = Camera::Pinhole(Pinhole::with_fov(SIZE.0, SIZE.1, 1.2));
    let pose = scans.get(scans.len() / 2).map_or(Pose::IDENTITY, |scan| scan.pose);
    renderer.view(&map, &camera, pose)?;
    let views = if gpu.is_software() { 1 } else { VIEWS };
    let mut triangles = 0;
    for _ in 0..runs {
        scan.push(fuse()?.1);
        let start = Instant::now();
        triangles = mesher.extract(&map, &config.mesh)?.triangles.len();
        mesh.push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        for _ in 0..views {
            renderer.view(&map, &camera, pose)?;
        }
        view.push(start.elapsed().as_secs_f64() / views as f64);
    }
    Ok(Measured {
        name: name.to_owned(),
        config: config.clone(),
        scan,
        mesh,
        view,
        triangles,
        blocks: map.block_count()?,
        map_bytes: map.memory_bytes(),
        kernels: {
            gpu.record_timeline();
            fuse()?;
            mesher.extract(&map, &config.mesh)?;
            renderer.view(&map, &camera, pose)?;
            kernels(gpu)?
        },
    })
}

/// What kernels took since recording began.
fn kernels(gpu: &Gpu) -> Result<Vec<Kernel>> {
    let stages = gpu.timeline()?;
    let mut names: Vec<_> = stages.iter().map(|stage| stage.name).collect();
    names.sort_unstable();
    names.dedup();
    let kernel = |name| {
        let of = stages.iter().filter(|stage| stage.name == name);
        let seconds: Vec<f64> = of.map(|stage| stage.seconds).collect();
        Kernel {
            name,
            passes: seconds.len(),
            seconds: median(seconds),
        }
    };
    Ok(names.into_iter().map(kernel).collect())
}

fn table(results: &Results) -> String {
    let mut text = format!("{}\n{}: {} scans\n", results.gpu, results.dataset, results.scans);
    for method in &results.methods {
        let [scan, mesh, view] = [&method.scan, &method.mesh, &method.view].map(|runs| median(runs.clone()));
        text += &format!(
            "\n{}: median of {} runs; {} blocks, {:.0} MiB\n  {:>9.1} scans/s\n  {:>9.1} ms a mesh ({} triangles)\n  {:>9.1} views/s ({} x {})\n",
            method.name,
            method.scan.len(),
            method.blocks,
            method.map_bytes as f64 / f64::from(1 << 20),
            1.0 / scan,
            1e3 * mesh,
            method.triangles,
            1.0 / view,
            SIZE.0,
            SIZE.1,
        );
        for kernel in &method.kernels {
            let Kernel { name, seconds, passes } = kernel;
            text += &format!("  {:>9.3} ms {name} ({passes} passes)\n", 1e3 * seconds);
        }
    }
    for failed in &results.failed {
        text += &format!("\n{}: {}\n", failed.name, failed.reason);
    }
    text
}
