//! Scans, meshes and views a second on a GPU, and what its kernels take.
//!
//! Scans are read beforehand, so that files do not count. All else does: dropping invalid returns, what the CPU prepares, the
//! way to the device.

use std::time::Instant;

use serde::Serialize;
use tsdfuse::render::Camera;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, Scan, SensorModel};
use tsdfuse_eval::stats::median;
use tsdfuse_gpu::{DeviceMap, Fuser, Gpu, Mesher, Renderer};
use tsdfuse_run::{Machine, RunConfig, pool};

use super::compare::{Bench, Opened};
use crate::error::{Error, Result};
use crate::progress::Watch;
use crate::results::Failed;

/// The picture that is rendered.
const SIZE: (u32, u32) = (1280, 720);
/// Pictures of a run; one where the GPU is software.
const VIEWS: usize = 20;

/// Methods on a GPU.
#[derive(Clone, Debug, Serialize)]
pub struct GpuResults {
    /// The version of this crate.
    pub version: &'static str,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// This machine.
    pub machine: Machine,
    /// The GPU's name.
    pub gpu: String,
    /// The log's path, or [`super::STREET`].
    pub dataset: String,
    /// Scans that were fused.
    pub scans: usize,
    /// The methods.
    pub methods: Vec<MeasuredGpu>,
    /// Methods that could not be used, with the reason.
    pub failed: Vec<Failed>,
}

/// A method; seconds of wall time unless they are kernels'.
#[derive(Clone, Debug, Serialize)]
pub struct MeasuredGpu {
    /// The form's name.
    pub name: String,
    /// With what it fuses.
    pub config: RunConfig,
    /// Per scan, of each run: into an empty map, which grows.
    pub scan: Vec<f64>,
    /// The mesh in the host's memory, of each run.
    pub mesh: Vec<f64>,
    /// A picture in the host's memory, of each run.
    pub view: Vec<f64>,
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Blocks of the map.
    pub blocks: u32,
    /// Memory of the map on the device.
    pub map_bytes: u64,
    /// What kernels took, by the device's clock: per scan, mesh or view.
    pub kernels: Vec<Kernel>,
}

/// What a kernel took.
#[derive(Clone, Debug, Serialize)]
pub struct Kernel {
    /// Its name.
    pub name: &'static str,
    /// Of the median pass.
    pub seconds: f64,
    /// How often it ran.
    pub passes: usize,
}

/// Measures the best GPU, or the first whose name contains this. Methods do not take turns.
///
/// # Errors
/// As [`Bench::run`]; if there is no such GPU.
pub fn on_gpu(bench: &Bench, name: Option<&str>, watch: &mut Watch<'_>) -> Result<GpuResults> {
    bench.check()?;
    let gpu = Gpu::open(name)?;
    let opened = bench.open(watch)?;
    let Opened { input, log, .. } = &opened;
    let sensor = log.sensors().first().and_then(|sensor| sensor.model.as_ref());
    let mut scans = Vec::new();
    for read in log.read_ahead(&input.selection) {
        match read.scan {
            Err(_) if input.skip_bad => {}
            scan => scans.push(scan?),
        }
    }
    let (mut methods, mut failed) = (Vec::new(), Vec::new());
    for (name, config) in bench.methods(log)? {
        match measure(&gpu, &name, &config, sensor, &scans, bench.runs) {
            Ok(measured) => methods.push(measured),
            Err(error) => {
                let reason = error.to_string();
                failed.push(Failed { name, reason });
            }
        }
    }
    if let (true, Some(first)) = (methods.is_empty(), failed.first()) {
        return Err(Error::failed(&first.reason));
    }
    Ok(GpuResults {
        version: env!("CARGO_PKG_VERSION"),
        command_line: bench.command_line.clone(),
        machine: Machine::here(rayon::current_num_threads()),
        gpu: gpu.name(),
        dataset: bench.input.path.display().to_string(),
        scans: scans.len(),
        methods,
        failed,
    })
}

fn measure(
    gpu: &Gpu,
    name: &str,
    config: &RunConfig,
    sensor: Option<&SensorModel>,
    scans: &[Scan],
    runs: usize,
) -> Result<MeasuredGpu> {
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
    let pose = scans
        .get(scans.len() / 2)
        .and_then(|scan| scan.pose)
        .unwrap_or(Pose::IDENTITY);
    renderer.view(&map, &camera, pose)?;
    let views = if gpu.is_software() { 1 } else { VIEWS };
    let mut triangles = 0;
    for _ in 0..runs.max(1) {
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
    Ok(MeasuredGpu {
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

impl GpuResults {
    /// All figures.
    pub fn text(&self) -> String {
        table(self)
    }
}

fn table(results: &GpuResults) -> String {
    let mut text = format!("{}\n{}: {} scans\n", results.gpu, results.dataset, results.scans);
    for method in &results.methods {
        let [scan, mesh, view] = [&method.scan, &method.mesh, &method.view].map(|runs| median(runs.iter().copied()));
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
