//! `tsdfuse resume`: a run of `tsdfuse fuse --store` goes on from what was committed last.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Parser;

use super::args::Args as FuseArgs;
use super::paging::Resumed;
use super::run_from;
use crate::exit::Outcome;
use crate::progress::say;

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse drive -o drive.ply --memory 2G --store drive.store
  tsdfuse resume drive.store";

/// Go on with a run of `tsdfuse fuse --store` that was ended early, by a crash for instance: the result is the same.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The store.
    store: PathBuf,
}

/// The arguments of the run.
#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    fuse: FuseArgs,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let named = || args.store.display().to_string();
    let store = args.store.canonicalize().with_context(named)?;
    let resumed = Resumed::open(&store)?;
    let progress = &resumed.progress;
    // The program's name goes; that of the command stands in its place.
    let line = Line::try_parse_from(progress.arguments.iter().skip(1)).with_context(named)?;
    std::env::set_current_dir(&progress.folder).with_context(|| progress.folder.display().to_string())?;
    say(format_args!(
        "{}: going on after {} of {} scans",
        store.display(),
        progress.done,
        progress.asked
    ));
    run_from(&line.fuse, Some(resumed))
}
