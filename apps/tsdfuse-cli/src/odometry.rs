//! `tsdfuse odometry`: the poses of a log's scans, without a map.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use tsdfuse_run::{RunConfig, TrackedScan, check_outputs, track, write_poses};

use crate::args::LogArgs;
use crate::exit::{self, Outcome};
use crate::output::print_json;
use crate::progress::say;
use crate::terminal::Terminal;

const EXAMPLES: &str = "\
Examples:
  tsdfuse odometry drive -o drive.tum
  tsdfuse odometry drive -o drive.tum --json
  tsdfuse fuse drive --poses drive.tum -o drive.ply

The world is the sensor's frame at its first scan. A pose belongs to the time of its scan.";

/// Find the poses of a log's scans by LiDAR odometry.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Write the poses: TUM, or KITTI where scans have no times.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    log: LogArgs,
    /// Print each scan's quality as JSON.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Tracks {
    distance_m: f64,
    seconds: f64,
    scans: Vec<TrackedScan>,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    args.log.set_threads()?;
    let input = args.log.input();
    check_outputs(&[&input.path], &[&args.output])?;
    let log = input.open_unplaced(&mut Terminal::default())?;
    let config: RunConfig = args.log.settings(None)?.resolve(&log)?;
    let stop = exit::stop_on_interrupt()?;
    let start = Instant::now();
    let scans = track(
        &log,
        &input.selection,
        config.odometry,
        config.range,
        &stop,
        &mut |_| {},
    )?;
    let seconds = start.elapsed().as_secs_f64();
    let poses: Vec<_> = scans.iter().map(|scan| scan.pose).collect();
    let steps = poses
        .windows(2)
        .map(|pair| pair[0].pose.translation.distance(pair[1].pose.translation));
    let distance_m = steps.sum();
    write_poses(&args.output, &poses)?;
    say(format_args!(
        "{} scans over {distance_m:.1} m in {seconds:.2} s, {:.1} scans/s; poses in {}",
        scans.len(),
        scans.len() as f64 / seconds,
        args.output.display()
    ));
    let count = |is: fn(&TrackedScan) -> bool| scans.iter().skip(1).filter(|scan| is(scan)).count();
    let undetermined = count(|scan| scan.quality.is_undetermined());
    let unmatched = count(|scan| scan.quality.is_unmatched());
    crate::terminal::doubts(undetermined, unmatched, scans.len());
    if args.json {
        print_json(&Tracks {
            distance_m,
            seconds,
            scans,
        })?;
    }
    Ok(if stop.is_stopped() {
        Outcome::ScansSkipped
    } else {
        Outcome::Complete
    })
}
