//! `tsdfuse poses`: trajectories side by side, and from one kind of file to the other.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Subcommand, ValueEnum};
use serde::Serialize;
use tsdfuse::Trajectory;
use tsdfuse_eval::trajectory::{TrajectoryComparison, compare};
use tsdfuse_evaluate::trajectories::{self, Plot};
use tsdfuse_io::g2o;
use tsdfuse_io::poses::{self, Poses};
use tsdfuse_run::{check_outputs, saved};

use crate::exit::{Outcome, Usage};
use crate::measuring::told;
use crate::output::{print, print_json};
use crate::progress::say;

const EXAMPLES: &str = "\
Examples:
  tsdfuse poses compare odometry.tum groundtruth.tum --plot odometry.png --graph odometry.g2o
  tsdfuse poses compare drive.tsdf kitti/sequences/00 --json
  tsdfuse poses convert poses.txt --times times.txt -o poses.tum

Poses are read from a TUM or KITTI file, a log, a saved map or a store.";

/// Compare trajectories, and convert pose files.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Tell how far a trajectory is from a reference: absolute errors after rigid alignment, and drift.
    Compare(Compare),
    /// Write poses as a TUM or KITTI file.
    Convert(Convert),
}

#[derive(Debug, clap::Args)]
struct Compare {
    /// The trajectory.
    track: PathBuf,
    /// What it is compared with. If both have times, its poses are interpolated at those of the trajectory; otherwise both need as many poses.
    reference: PathBuf,
    /// Both are of one world: do not align them.
    #[arg(long)]
    no_align: bool,
    /// Draw both from above, and the error over the distance, as a picture (.png or .svg).
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// With --plot: also draw the loops that were closed, of the trajectory's pose graph (`tsdfuse odometry --save-graph`).
    #[arg(long, value_name = "FILE.g2o", requires = "plot")]
    graph: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Convert {
    /// The poses.
    input: PathBuf,
    /// The file to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The kind of file [default: tum where times are known, otherwise kitti].
    #[arg(long, value_name = "KIND")]
    format: Option<Format>,
    /// The times of the poses, one a line, as in times.txt.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
}

/// A kind of pose file.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Format {
    /// secs x y z qx qy qz qw
    Tum,
    /// The row-major 3×4 matrix
    Kitti,
}

/// What was compared, and how far apart it is.
#[derive(Debug, Serialize)]
struct Report<'a> {
    /// The program's version.
    version: &'static str,
    trajectory: &'a Path,
    reference: &'a Path,
    #[serde(flatten)]
    found: &'a TrajectoryComparison,
}

pub(crate) fn run(Args { command }: &Args) -> Result<Outcome> {
    match command {
        Command::Compare(compare) => compare.run(),
        Command::Convert(convert) => convert.run(),
    }
}

impl Compare {
    fn run(&self) -> Result<Outcome> {
        if let Some(path) = &self.plot {
            check_plot(path)?;
            let inputs = [Some(&self.track), Some(&self.reference), self.graph.as_ref()];
            check_outputs(
                &inputs.into_iter().flatten().map(PathBuf::as_path).collect::<Vec<_>>(),
                &[path],
            )?;
        }
        let (track, reference) = (saved::poses(&self.track)?, saved::poses(&self.reference)?);
        let found = compare(&track, &reference, !self.no_align);
        let found = found.with_context(|| format!("{} and {}", self.track.display(), self.reference.display()))?;
        if let Some(path) = &self.plot {
            let mut plot = Plot::of_both(&found);
            if let Some(graph) = &self.graph {
                plot = plot.with_closures(&g2o::read(graph)?, &found.alignment.unwrap_or_default());
            }
            plot.write(path).map_err(told)?;
        }
        if self.json {
            print_json(&Report {
                version: env!("CARGO_PKG_VERSION"),
                trajectory: &self.track,
                reference: &self.reference,
                found: &found,
            })?;
        } else {
            print(&trajectories::figures(&self.track, &self.reference, &found))?;
        }
        Ok(Outcome::Complete)
    }
}

/// Refuses a file that is no plot.
pub(crate) fn check_plot(path: &Path) -> Result<(), Usage> {
    let extension = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
    if extension.is_some_and(|extension| extension == "svg" || extension == "png") {
        return Ok(());
    }
    Err(Usage::new(format_args!(
        "{}: a plot is drawn as .png or .svg",
        path.display()
    )))
}

impl Convert {
    fn run(&self) -> Result<Outcome> {
        let inputs = [Some(&self.input), self.times.as_ref()];
        let inputs: Vec<&Path> = inputs.into_iter().flatten().map(PathBuf::as_path).collect();
        check_outputs(&inputs, &[&self.output])?;
        let mut track = saved::poses(&self.input)?;
        if let Some(path) = &self.times {
            track = with_times(&track, path)?;
        }
        let poses = match (track, self.format) {
            (Poses::Timed(trajectory), Some(Format::Kitti)) => Poses::Listed(trajectory.poses().to_vec()),
            (Poses::Listed(_), Some(Format::Tum)) => {
                let told = "its poses have no times, which TUM needs: name a file of --times";
                return Err(Usage::new(format_args!("{}: {told}", self.input.display())).into());
            }
            (poses, _) => poses,
        };
        let (kind, count) = match &poses {
            Poses::Timed(_) => ("TUM", poses.poses().len()),
            Poses::Listed(_) => ("KITTI", poses.poses().len()),
        };
        let write = if poses::is_of_sensor(&self.input) {
            poses::write_of_sensor
        } else {
            poses::write
        };
        write(&self.output, &poses)?;
        say(format_args!("  poses    {count}, {kind}"));
        say(format_args!("  wrote    {}", self.output.display()));
        Ok(Outcome::Complete)
    }
}

/// The poses at the times of a file.
fn with_times(track: &Poses, path: &Path) -> Result<Poses> {
    let times_ns = tsdfuse_io::times::read(path)?;
    let poses = track.poses();
    if times_ns.len() != poses.len() {
        let (times, poses) = (times_ns.len(), poses.len());
        return Err(Usage::new(format_args!("{}: {times} times for {poses} poses", path.display())).into());
    }
    let timed = times_ns.into_iter().zip(poses.iter().copied()).collect();
    let trajectory = Trajectory::new(timed).with_context(|| path.display().to_string())?;
    Ok(Poses::Timed(trajectory))
}
