//! `tsdfuse info`: what lies in a log, a saved map or a store.

mod log;
mod map;
mod rows;

use std::path::PathBuf;

use anyhow::Result;
use tsdfuse_io::OpenOptions;
use tsdfuse_run::log_info::{LogInfo, Reading};
use tsdfuse_run::map_info::MapInfo;

use crate::args::SensorArgs;
use crate::exit::Outcome;
use crate::output::print_results;
use crate::progress;

const EXAMPLES: &str = "\
Examples:
  tsdfuse info pandaset/002
  tsdfuse info kitti/sequences/00 --sample 200 --json
  tsdfuse info drive.bag
  tsdfuse info street.tsdf";

/// Describe a log (format, sensor, scans, points, extent), a saved map or a store.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The log, or the file of a saved map or a store.
    path: PathBuf,
    /// Read this many scans, spread evenly over the log.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    sample: u32,
    /// The poses to look at: a file, or a topic or frame of a recording.
    #[arg(long, value_name = "FILE|TOPIC|FRAME")]
    poses: Option<PathBuf>,
    #[command(flatten)]
    sensor: SensorArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let map = if tsdfuse_store::recognises(&args.path) {
        Some(MapInfo::of_store(&args.path)?)
    } else if tsdfuse_io::map_file::recognises(&args.path) {
        Some(MapInfo::read(&args.path)?)
    } else {
        None
    };
    if let Some(info) = map {
        print_results(&info, args.json, map::table)?;
        return Ok(Outcome::Complete);
    }
    let options = OpenOptions {
        glance: true,
        ..args.sensor.options(args.poses.clone())
    };
    let mut bar = None;
    let info = LogInfo::read(
        &args.path,
        &options,
        args.sample as usize,
        &mut |reading| match reading {
            Reading::Begun(scans) => bar = Some(progress::scans("reading", Some(scans))),
            Reading::Scan => bar.iter().for_each(|bar| bar.inc(1)),
        },
    );
    drop(bar);
    let info = info?;
    print_results(&info, args.json, log::table)?;
    Ok(if info.is_complete() {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}
