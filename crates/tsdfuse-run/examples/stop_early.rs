//! Fuses a log, prints progress of its own, and stops early from another thread.
//!
//! ```text
//! cargo run --release -p tsdfuse-run --example stop_early -- sample/pandaset-002
//! ```

#![allow(clippy::print_stdout)] // an example says what it finds

use std::error::Error;
use std::path::Path;
use std::time::Duration;

use tsdfuse_run::{Event, Session, Setup, Silent};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).unwrap_or("sample/pandaset-002".to_owned());
    let log = tsdfuse_io::open(path)?;
    let mut setup = Setup::for_log(&log);
    setup.follow_every = Some(1); // pieces of the surface after every scan
    let mut session = Session::begin(&log, setup, &mut Silent)?;

    // Any thread can stop the session between two scans: here after a tenth of a second.
    let stop = session.stopper();
    std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(100));
        stop.stop();
    });

    session.run(&mut |event: Event<'_>| match event {
        Event::ScanFused { index, report, blocks } => {
            println!("scan {index}: {} returns in {} blocks", report.sums.fused, blocks.len());
        }
        Event::SurfaceChanged(changes) => println!("  {} pieces of the surface changed", changes.len()),
        Event::Done { stopped: true } => println!("stopped: the map holds the scans so far"),
        _ => {}
    })?;
    let mesh = session.write_surface(Path::new("stopped-early.ply"))?;
    println!("{} triangles in {}", mesh.triangles, mesh.path.display());
    Ok(())
}
