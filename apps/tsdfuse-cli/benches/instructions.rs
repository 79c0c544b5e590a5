//! Instructions of one scan, one thread: a figure that other work on the machine does not change.
//!
//! `cargo bench -p tsdfuse-cli --bench instructions`, with names of methods, or `mesh`, after `--` for some of them only. Valgrind counts
//! (callgrind); it knows AVX2, but not AVX-512, so that is what it runs.

#![allow(clippy::print_stdout)]

mod common;

use std::hint::black_box;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};
use common::{FORMS, camera, depth_images, sensor, street};
use rayon::ThreadPoolBuilder;
use tsdfuse::{Scan, mesh};
use tsdfuse_io::plain::Writer;

/// The last one is counted; the others are in the map before.
const SCANS: usize = 3;

/// Asks this program to do the work that is counted.
const COUNTED: &str = "--counted";

/// The extraction of the map of all scans.
const MESH: &str = "mesh";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments[..] {
        [counted, what, folder] if counted == COUNTED => work(what, folder.as_ref()),
        _ => count(&arguments),
    }
}

/// Counts what is asked for and prints a table.
fn count(arguments: &[String]) -> Result<()> {
    let names = || FORMS.iter().map(|form| form.name).chain([MESH]);
    let asked: Vec<&str> = arguments
        .iter()
        .map(String::as_str)
        .filter(|a| !a.starts_with('-'))
        .collect();
    if let Some(unknown) = asked.iter().find(|asked| !names().any(|name| name == **asked)) {
        bail!("no {unknown}; there are {}", names().collect::<Vec<_>>().join(", "));
    }
    let version = Command::new("valgrind").arg("--version").output();
    let version = version.context("valgrind counts the instructions and is not installed")?;
    let folder = tempfile::tempdir()?;
    let (sweeps, images) = (folder.path().join("sweeps"), folder.path().join("images"));
    let returns = [write(&sweeps, &street(SCANS)?)?, write(&images, &depth_images(SCANS)?)?];

    println!(
        "{}, one thread, scan {SCANS} of {SCANS} of a Pandar64 in the street; depth: of a depth camera in the hall\n",
        String::from_utf8_lossy(&version.stdout).trim()
    );
    println!(
        "{:<20} {:>15} {:>10} {:>10}  with",
        "", "instructions", "returns", "a return"
    );
    for name in names().filter(|name| asked.is_empty() || asked.contains(name)) {
        let depth = FORMS.iter().any(|form| form.name == name && form.wants_depth());
        let scans = if depth { &images } else { &sweeps };
        let (count, returns) = (counted(name, scans, folder.path())?, returns[usize::from(depth)]);
        let Counted { instructions, vectors } = count;
        let each = instructions as f64 / returns as f64;
        println!("{name:<20} {instructions:>15} {returns:>10} {each:>10.1}  {vectors}");
    }
    Ok(())
}

/// Writes scans; returns how many points the last one has.
fn write(folder: &Path, scans: &[Scan]) -> Result<usize> {
    let mut writer = Writer::create(folder)?;
    writer.write_sensor(&sensor()?)?;
    scans.iter().try_for_each(|scan| writer.write_scan(scan))?;
    writer.finish()?;
    Ok(scans.last().map_or(0, |scan| scan.points.len()))
}

/// The instructions of [`measured`] in a process of its own.
fn counted(what: &str, scans: &Path, folder: &Path) -> Result<Counted> {
    let out = folder.join("callgrind.out");
    let mut valgrind = Command::new("valgrind");
    valgrind.args(["--tool=callgrind", "--quiet", "--toggle-collect=*measured*"]);
    valgrind.arg(format!("--callgrind-out-file={}", out.display()));
    valgrind.arg(std::env::current_exe()?).args([COUNTED, what]).arg(scans);
    let done = valgrind.output()?;
    if !done.status.success() {
        let told = String::from_utf8_lossy(&done.stderr);
        bail!("{what}: valgrind ended with {}: {}", done.status, told.trim());
    }
    let text = std::fs::read_to_string(&out).with_context(|| out.display().to_string())?;
    let total = text.lines().find_map(|line| line.strip_prefix("totals:"));
    let total = total.and_then(|total| total.trim().parse().ok());
    let total = total.filter(|&total| total > 0);
    Ok(Counted {
        instructions: total.with_context(|| format!("{what}: valgrind has counted nothing"))?,
        vectors: String::from_utf8_lossy(&done.stdout).trim().to_owned(),
    })
}

/// What valgrind told.
struct Counted {
    instructions: u64,
    /// The vector instructions that were used.
    vectors: String,
}

/// What is counted: all of it on this thread.
fn work(what: &str, folder: &Path) -> Result<()> {
    ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()?;
    let vectors = format!("{:?}", fearless_simd::Level::new());
    println!("{}", vectors.split('(').next().unwrap_or_default().to_uppercase());
    // The mesh is that of the map of the first method.
    let form = FORMS.iter().find(|form| form.name == what).unwrap_or(&FORMS[0]);
    let log = tsdfuse_io::open(folder)?;
    let scans = log.scans().len();
    let (mut integrator, mut map) = form.start(&sensor()?)?;
    for number in 0..scans {
        let mut scan = log.read(number)?;
        scan.camera = form.wants_depth().then(camera);
        if what != MESH && number + 1 == scans {
            measured(|| integrator.integrate(&mut map, &scan))?;
        } else {
            integrator.integrate(&mut map, &scan)?;
        }
    }
    if what == MESH {
        black_box(measured(|| mesh::extract(&map))?);
    }
    Ok(())
}

/// Valgrind counts from its beginning to its end.
#[inline(never)]
fn measured<T>(work: impl FnOnce() -> T) -> T {
    black_box(work())
}
