//! What meshing costs on one thread: the whole map at the end, and after each scan what that scan changed.
//!
//! ```text
//! cargo run --release -p tsdfuse-io --example meshing -- FOLDER
//! ```

#![allow(clippy::print_stdout)] // what it is for

use std::error::Error;
use std::sync::LazyLock;
use std::time::Instant;

use tsdfuse::mesh::{Changes, Incremental, MeshError, extract};
use tsdfuse::scan::RangeLimits;
use tsdfuse::{Integrator, MapConfig, Raycast, Scan, VoxelMap};

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let folder = std::env::args().nth(1).ok_or("which data set?")?;
    let read = |scan: Result<Scan, _>| {
        let mut scan = scan?;
        scan.drop_invalid(&RangeLimits::default());
        Ok::<Scan, tsdfuse_io::Error>(scan)
    };
    let scans = tsdfuse_io::open(&folder)?
        .into_iter()
        .map(read)
        .collect::<Result<Vec<_>, _>>()?;
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    one.install(|| measure(&scans))
}

fn measure(scans: &[Scan]) -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut map = VoxelMap::new(MapConfig::default())?;
    let (mut raycast, mut surface) = (Raycast::default(), Incremental::default());
    let (mut rows, mut pieces) = (Vec::new(), Changes::default());
    for scan in scans {
        let start = thread_ms();
        let updated = raycast.integrate(&mut map, scan)?.updated_blocks;
        let fused = thread_ms() - start;
        let start = thread_ms();
        surface.note(&updated);
        surface.changes(&map, &mut pieces);
        let meshed = thread_ms() - start;
        let vertices: usize = pieces.iter().map(|p| p.vertices.len()).sum();
        rows.push([
            fused,
            meshed,
            updated.len() as f64,
            pieces.len() as f64,
            vertices as f64,
        ]);
    }
    println!("medians of {} scans, one thread:", rows.len());
    for (k, name) in [
        "fusing, ms",
        "meshing what changed, ms",
        "blocks updated",
        "pieces",
        "their vertices",
    ]
    .iter()
    .enumerate()
    {
        rows.sort_by(|a, b| a[k].total_cmp(&b[k]));
        println!("{:10.2} {name}", rows[rows.len() / 2][k]);
    }
    let whole = |name, mesh: &mut dyn FnMut() -> Result<usize, MeshError>| {
        let mut times = Vec::new();
        let mut count = 0;
        for _ in 0..5 {
            let start = thread_ms();
            count = mesh()?;
            times.push(thread_ms() - start);
        }
        times.sort_by(f64::total_cmp);
        println!("{:10.2} {name}, ms ({count} vertices)", times[2]);
        Ok::<(), MeshError>(())
    };
    whole("meshing all", &mut || Ok(extract(&map)?.vertices.len()))?;
    whole("meshing all, signs known", &mut || {
        Ok(surface.mesh(&map)?.vertices.len())
    })?;
    println!(
        "{:10.1} bytes kept per block of {}",
        surface.memory_bytes() as f64 / map.block_count() as f64,
        map.block_count()
    );
    Ok(())
}

/// CPU time of this thread where the system tells it (Linux), else the time that passed.
fn thread_ms() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|told| told.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
}
