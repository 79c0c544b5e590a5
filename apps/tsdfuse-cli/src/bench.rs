//! `tsdfuse bench`: what each stage takes on this machine, and how far that is from what its memory allows.

mod args;
mod changes;
#[cfg(feature = "gpu")]
mod gpu;
mod limits;
mod long_drive;
mod method;
mod run;
mod street;
mod table;

use anyhow::Result;
use serde::Serialize;
use tempfile::TempDir;

pub(crate) use args::Args;

use crate::config::Suggested;
use crate::device::Device;
#[cfg(not(feature = "gpu"))]
use crate::device::gpu; // says that there is none
use crate::exit::{Outcome, one_line};
use crate::machine::Machine;
use crate::progress;
use crate::report::{SkippedScan, command_line, print, print_json};
use crate::settings::Settings;
use limits::Limits;
use method::Method;

/// Everything.
#[derive(Debug, Serialize)]
struct Results {
    /// The program's version.
    version: &'static str,
    command_line: Vec<String>,
    machine: Machine,
    dataset: Data,
    limits: Limits,
    methods: Vec<Method>,
    /// Methods that could not be used on these data, with the reason.
    failed: Vec<SkippedScan>,
}

/// What was fused.
#[derive(Debug, Serialize)]
struct Data {
    name: String,
    format: &'static str,
    /// Scans that were asked for.
    scans: usize,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    args.check()?;
    args.settings.set_threads()?;
    if let Device::Gpu(name) = &args.device {
        return gpu::run(args, name.as_deref());
    }
    match args.long_drive {
        Some(scans) => long_drive::run(args, scans as usize),
        None => compare(args),
    }
}

fn compare(args: &Args) -> Result<Outcome> {
    let (settings, _simulated) = settings(args)?;
    let dataset = settings.open()?;
    let indices = settings.indices(dataset.len())?;
    let methods = args.methods(&Suggested::by(&dataset))?;
    let spinner = progress::working("measuring memory");
    let limits = Limits::measure();
    drop(spinner);

    let mut failed = Vec::new();
    let mut first_error = None;
    let mut measured: Vec<Method> = Vec::new();
    for mut method in methods {
        // The first run tells whether the method can be used at all.
        match method.run(&settings, &indices) {
            Ok(()) => measured.push(method),
            Err(error) => {
                let (name, reason) = (method.name, one_line(&error));
                failed.push(SkippedScan { name, reason });
                first_error.get_or_insert(error);
            }
        }
    }
    if let Some(error) = first_error.filter(|_| measured.is_empty()) {
        return Err(error);
    }
    // Methods take turns: a machine that others use, too, is slower at one time than at another.
    for _ in 1..args.runs {
        for method in &mut measured {
            method.run(&settings, &indices)?;
        }
    }
    for method in &mut measured {
        method.count(&settings, &dataset, &indices)?;
    }

    let results = Results {
        version: env!("CARGO_PKG_VERSION"),
        command_line: command_line(),
        machine: Machine::here(rayon::current_num_threads()),
        dataset: Data {
            name: args.settings.dataset.display().to_string(),
            format: dataset.format(),
            scans: indices.len(),
        },
        limits,
        methods: measured,
        failed,
    };
    if args.json {
        print_json(&results)?;
    } else {
        print(&table::of(&results))?;
    }
    let complete = results.methods.iter().all(Method::is_complete);
    Ok(if complete {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}

/// The settings, with a simulated data set where none is named; it vanishes with its folder.
fn settings(args: &Args) -> Result<(Settings, Option<TempDir>)> {
    let mut settings = args.settings.clone();
    if !args.is_simulated() {
        return Ok((settings, None));
    }
    let folder = street::write()?;
    settings.dataset = folder.path().to_owned();
    Ok((settings, Some(folder)))
}
