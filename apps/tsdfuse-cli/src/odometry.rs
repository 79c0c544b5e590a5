//! `tsdfuse odometry`: the poses of a log's scans, without a map.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use tsdfuse::Pose;
use tsdfuse_evaluate::trajectories::Plot;
use tsdfuse_io::g2o;
use tsdfuse_run::report::OdometryReport;
use tsdfuse_run::{PosesFrom, RunConfig, TrackedScan, check_outputs, refine, track, write_poses, write_sensor};

use crate::args::{LogArgs, Loops};
use crate::exit::{self, Outcome};
use crate::measuring::told;
use crate::output::print_json;
use crate::poses::check_plot;
use crate::progress::say;
use crate::terminal::Terminal;

const EXAMPLES: &str = "\
Examples:
  tsdfuse odometry drive -o drive.tum
  tsdfuse odometry drive -o drive.tum --json
  tsdfuse fuse drive --poses drive.tum -o drive.ply

The world is the sensor's frame at its first scan; where the log has an IMU, it is levelled. A pose is that of the sensor at the time of its scan; the file says so, and --poses moves it by no extrinsics.";

/// Find the poses of a log's scans by LiDAR odometry.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Write the poses: TUM, or KITTI where scans have no times.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    log: LogArgs,
    /// Correct the poses where the sensor comes back.
    #[arg(long, value_name = "on|off", default_value = "on")]
    loops: Loops,
    /// Write the pose graph of the loops for g2o or GTSAM: local maps along the way, odometry and closures between them.
    #[arg(long, value_name = "FILE.g2o")]
    save_graph: Option<PathBuf>,
    /// Draw the trajectory from above, with the loops that were closed, as a picture (.png or .svg).
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Write what is known of the sensor: with --poses refine, the systematic errors that were found, too. `--sensor FILE` takes it.
    #[arg(long, value_name = "FILE.toml")]
    save_sensor: Option<PathBuf>,
    /// Print each scan's quality as JSON.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Tracks {
    #[serde(flatten)]
    report: OdometryReport,
    scans: Vec<TrackedScan>,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    args.log.set_threads()?;
    let (input, settings) = (args.log.input(), args.log.settings(None)?);
    if let Some(path) = &args.plot {
        check_plot(path)?;
    }
    let outputs = [&args.save_graph, &args.plot, &args.save_sensor].map(Option::as_ref);
    let outputs: Vec<_> = std::iter::once(Some(&args.output))
        .chain(outputs)
        .flatten()
        .map(PathBuf::as_path)
        .collect();
    check_outputs(&[&input.path], &outputs)?;
    let refines = args.log.poses_from() == PosesFrom::Refine;
    let mut terminal = Terminal::default();
    let log = if refines {
        input.open(&settings, &mut terminal)?
    } else {
        input.open_unplaced(&settings, &mut terminal)?
    };
    let config: RunConfig = settings.resolve(&log)?;
    let stop = exit::stop_on_interrupt()?;
    let start = Instant::now();
    let RunConfig { odometry, range, .. } = config;
    let loops = args.loops.is_on().then_some(config.loops);
    let found = if refines {
        refine(&log, &input.selection, odometry, loops, range, &stop, &mut terminal)?
    } else {
        track(&log, &input.selection, odometry, loops, range, &stop)?
    };
    let seconds = start.elapsed().as_secs_f64();
    let report = found.report(seconds);
    let poses: Vec<_> = found.scans.iter().map(|scan| scan.pose).collect();
    write_poses(&args.output, &poses)?;
    if let (Some(path), Some(graph)) = (&args.save_graph, &found.graph) {
        g2o::write(path, graph)?;
    }
    if let Some(path) = &args.plot {
        let poses: Vec<Pose> = poses.iter().map(|fused| fused.pose).collect();
        let graph = found.graph.as_ref();
        let plot = Plot::of(&poses).with_closures(graph.unwrap_or(&g2o::Graph::default()), &Pose::IDENTITY);
        plot.write(path).map_err(told)?;
    }
    if let Some(path) = &args.save_sensor {
        write_sensor(path, &log, found.correction.as_ref(), found.mounting.as_ref())?;
    }
    say(format_args!(
        "{} scans over {:.1} m in {seconds:.2} s, {:.1} scans/s; poses in {}",
        found.scans.len(),
        report.distance_m,
        found.scans.len() as f64 / seconds,
        args.output.display()
    ));
    crate::terminal::loops(&report);
    crate::terminal::doubts(&report, found.scans.len());
    if args.json {
        print_json(&Tracks {
            report,
            scans: found.scans,
        })?;
    }
    Ok(if stop.is_stopped() {
        Outcome::ScansSkipped
    } else {
        Outcome::Complete
    })
}
