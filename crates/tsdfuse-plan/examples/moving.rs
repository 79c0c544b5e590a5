//! Labels of the returns that move: a byte each, a file for each scan.
//!
//! ```text
//! cargo run --release -p tsdfuse-plan --example moving -- drive labels drive/poses.tum
//! ```

#![allow(clippy::print_stdout)] // an example says what it finds

use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::Instant;

use tsdfuse_io::{OpenOptions, Selection};
use tsdfuse_plan::{Moving, MovingConfig};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (path, labels) = arguments
        .next()
        .zip(arguments.next())
        .ok_or("a log and a folder are wanted")?;
    let options = OpenOptions {
        poses: arguments.next().map(Into::into),
        ..OpenOptions::default()
    };
    let log = tsdfuse_io::open_with(&path, &options)?;
    fs::create_dir_all(&labels)?;
    let mut moving = Moving::new(MovingConfig::default())?;
    let mut times_ms = Vec::new();
    for read in log.read_ahead(&Selection::default()) {
        let (index, scan) = (read.index, read.scan?);
        let start = Instant::now();
        let is_moving = moving.classify(&scan)?;
        times_ms.push(1e3 * start.elapsed().as_secs_f64());
        let found = is_moving.iter().filter(|is_moving| **is_moving).count();
        println!("scan {index}: {found} of {} returns move", is_moving.len());
        let bytes: Vec<u8> = is_moving.into_iter().map(u8::from).collect();
        fs::write(Path::new(&labels).join(format!("{index:06}.u8")), bytes)?;
    }
    times_ms.sort_by(f64::total_cmp);
    if let Some(median) = times_ms.get(times_ms.len() / 2) {
        println!(
            "{median:.1} ms a scan (median), {:.1} MB",
            1e-6 * moving.memory_bytes() as f64
        );
    }
    Ok(())
}
