//! `tsdfuse resume`: a run of `tsdfuse fuse --store` goes on from what was committed last.

use std::path::PathBuf;

use anyhow::{Context, Result};
use tsdfuse_run::Job;

use crate::exit::{self, Outcome};
use crate::fuse;
use crate::output;
use crate::terminal::Terminal;

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse drive -o drive.ply --memory 2G --store drive.store
  tsdfuse resume drive.store";

/// Continue an interrupted run of `tsdfuse fuse --store`; the result is that of an uninterrupted run.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The store.
    store: PathBuf,
    /// Write the mesh here instead of where the run was to write it.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print the report on standard output.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let store = args
        .store
        .canonicalize()
        .with_context(|| args.store.display().to_string())?;
    let (mut job, resumed) = Job::of_store(&store)?;
    job.store = Some(store);
    job.command_line = output::command_line();
    if let Some(output) = &args.output {
        output::check_terminal(output, args.json)?;
        job.outputs.mesh = Some(output.clone());
    }
    let report = job.resume(resumed, &exit::stop_on_interrupt()?, &mut Terminal::resumed())?;
    fuse::done(&report, args.json)
}
