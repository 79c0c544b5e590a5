//! What each kernel takes: `cargo bench -p tsdfuse-cli --bench kernels`, with a name after `--` for some of them only, and
//! `RAYON_NUM_THREADS=1` before it for one core. Each run is compared with the one before.

mod common;

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::Result;
use common::{FORMS, Form, depth_images, sensor, street};
use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, SamplingMode, Throughput};
use tsdfuse::glam::Vec3;
use tsdfuse::normals::{Estimator, NormalsConfig, estimate};
use tsdfuse::sensor::ScanImage;
use tsdfuse::{Integration, Integrator, Scan, SensorModel, VoxelMap, mesh};

/// Scans that take turns; all are in the map before time is taken.
const SCANS: usize = 4;

fn main() -> Result<()> {
    let mut criterion = Criterion::default().sample_size(10).configure_from_args();
    let (sensor, sweeps, images) = (sensor()?, street(SCANS)?, depth_images(SCANS)?);
    let returns = sweeps[0].points.len() as u64;
    raycasting(&mut criterion, &sensor, &sweeps)?;
    normals(&mut criterion, &sensor, &sweeps[0]);

    let mut group = series(&mut criterion, "fuse");
    for form in &FORMS {
        let scans = if form.wants_depth() { &images } else { &sweeps };
        group.throughput(Throughput::Elements(scans[0].points.len() as u64));
        let mut fusing = Fusing::warm(form, &sensor, scans)?;
        group.bench_function(form.name, |b| {
            b.iter_custom(|times| fusing.timed(times, |took, _| took));
        });
    }
    group.finish();

    let mut group = series(&mut criterion, "mesh");
    group.throughput(Throughput::Elements(returns));
    for form in FORMS.iter().filter(|form| form.name.starts_with("raycast")) {
        let map = Fusing::warm(form, &sensor, &sweeps)?.map;
        group.bench_function(form.name, |b| b.iter(|| mesh::extract(black_box(&map))));
    }
    group.finish();
    criterion.final_summary();
    Ok(())
}

/// Samples of as many scans each: a scan takes long.
fn series<'a>(criterion: &'a mut Criterion, name: &str) -> BenchmarkGroup<'a, WallTime> {
    let mut group = criterion.benchmark_group(name);
    group.sampling_mode(SamplingMode::Flat);
    group
}

/// The stages of raycasting.
fn raycasting(criterion: &mut Criterion, sensor: &SensorModel, sweeps: &[Scan]) -> Result<()> {
    type Secs = fn(&Integration) -> f64;
    let mut group = series(criterion, "raycast");
    let stages: [(&str, Secs); 2] = [
        ("place and sort", |done| done.prepare_secs),
        ("find regions", |done| done.find_secs),
    ];
    let mut fusing = Fusing::warm(&FORMS[0], sensor, sweeps)?;
    for (name, secs) in stages {
        group.bench_function(name, |b| {
            b.iter_custom(|times| fusing.timed(times, |_, done| Duration::from_secs_f64(secs(done))));
        });
    }
    group.finish();
    Ok(())
}

/// Normals of one sweep, and the image of neighbours they come from.
fn normals(criterion: &mut Criterion, sensor: &SensorModel, sweep: &Scan) {
    let (Some(rings), Some(pose)) = (&sweep.rings, sweep.pose) else {
        return;
    };
    let rotation = pose.rotation.as_quat();
    let points: Vec<Vec3> = sweep.points.iter().map(|p| rotation * *p).collect();
    let mut image = ScanImage::new();
    let mut group = series(criterion, "normals");
    group.throughput(Throughput::Elements(points.len() as u64));
    group.bench_function("image", |b| b.iter(|| image.update(&sweep.points, rings, sensor)));
    for (name, estimator) in [("adjacent", Estimator::Adjacent), ("holz", Estimator::Holz)] {
        let config = NormalsConfig {
            estimator,
            ..Default::default()
        };
        let mut normals = Vec::new();
        group.bench_function(name, |b| {
            b.iter(|| estimate(&image, black_box(&points), None, &config, &mut normals));
        });
    }
    group.finish();
}

/// A method and its map, in which all scans are already.
struct Fusing<'a> {
    integrator: Box<dyn Integrator>,
    map: VoxelMap,
    scans: &'a [Scan],
}

impl<'a> Fusing<'a> {
    fn warm(form: &Form, sensor: &SensorModel, scans: &'a [Scan]) -> Result<Self> {
        let (mut integrator, mut map) = form.start(sensor)?;
        for scan in scans {
            integrator.integrate(&mut map, scan)?;
        }
        Ok(Self { integrator, map, scans })
    }

    /// Fuses so many scans and adds up what is asked for.
    fn timed(&mut self, times: u64, of: impl Fn(Duration, &Integration) -> Duration) -> Duration {
        let took = (0..times).zip(self.scans.iter().cycle()).map(|(_, scan)| {
            let start = Instant::now();
            let done = self.integrator.integrate(&mut self.map, scan);
            // Each scan went in before, so that none is refused now.
            of(start.elapsed(), &done.unwrap_or_default())
        });
        took.sum()
    }
}
