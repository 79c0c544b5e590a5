//! Distances that follow a map scan by scan, and what that takes.
//!
//! ```text
//! cargo run --release -p tsdfuse-plan --example follow -- street
//! ```

#![allow(clippy::print_stdout)] // an example says what it finds

use std::error::Error;
use std::time::Instant;

use tsdfuse::VoxelMap;
use tsdfuse::fuse::FuseConfig;
use tsdfuse::mesh::{Changes, Incremental};
use tsdfuse_plan::{Esdf, EsdfConfig};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).unwrap_or("sample/pandaset-002".to_owned());
    let log = tsdfuse_io::open(path)?;
    let suggested = log.suggested();
    let mut map = VoxelMap::new(suggested.map)?;
    let model = log.sensors().first().and_then(|sensor| sensor.model.as_ref());
    let mut fuser = suggested.method.build(&FuseConfig::default(), model);
    let (mut surface, mut changes) = (Incremental::default(), Changes::default());
    let mut esdf = Esdf::new(EsdfConfig::default())?;
    let mut times_ms: [Vec<f64>; 3] = Default::default();
    for scan in &log {
        let scan = scan?;
        let start = Instant::now();
        let done = fuser.integrate(&mut map, &scan)?;
        let fused = Instant::now();
        surface.note(&done.updated_blocks);
        surface.changes(&map, &mut changes);
        let meshed = Instant::now();
        let chunks = esdf.update(changes.iter()).len();
        let ends = [fused - start, meshed - fused, meshed.elapsed()];
        let ms = ends.map(|time| 1e3 * time.as_secs_f64());
        println!(
            "fused in {:.1} ms, meshed in {:.1}, {chunks} chunks of distances in {:.1}",
            ms[0], ms[1], ms[2]
        );
        times_ms.iter_mut().zip(ms).for_each(|(times, ms)| times.push(ms));
    }
    let median = times_ms.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times.get(times.len() / 2).copied().unwrap_or_default()
    });
    println!(
        "median: fused in {:.1} ms, meshed in {:.1}, distances in {:.1}",
        median[0], median[1], median[2]
    );
    println!("{:.1} MB of distances", 1e-6 * esdf.memory_bytes() as f64);
    Ok(())
}
