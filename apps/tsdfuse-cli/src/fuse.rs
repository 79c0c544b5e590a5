//! `tsdfuse fuse`: scans and poses in, a mesh or a map out.

use std::path::PathBuf;

use anyhow::Result;
use clap::ArgGroup;
use tsdfuse::Pose;
use tsdfuse_run::report::Report;
use tsdfuse_run::{Job, Outputs};

use crate::args::{Memory, RunArgs, hold_out_range, parse_rough_pose};
use crate::exit::{self, Outcome};
use crate::output;
use crate::terminal::{self, Terminal};

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 -o street.ply
  tsdfuse fuse pandaset/002 -o street.html --color
  tsdfuse fuse kitti/sequences/00 -o street.ply --scans 0..80 --voxel-size 0.1 --truncation 0.3
  tsdfuse fuse pandaset/002 -o street.ply --mesh-every 10
  tsdfuse fuse pandaset/002 --save-map street.tsdf --scans 0..40
  tsdfuse fuse pandaset/002 --load-map street.tsdf -o street.ply --scans 40..80
  tsdfuse fuse second-drive --load-map street.tsdf --initial-pose 12,3,0,90 -o both.ply
  tsdfuse fuse drive -o drive.ply --memory 2G --store drive.store
  tsdfuse fuse drive -o drive.ply --record drive.mcap
  tsdfuse fuse drive -o drive.ply --poses track --save-poses drive.tum
  tsdfuse fuse street -o street.ply --config run.toml --set raycast.distance=projective

Settings: defaults < the log's suggestions < --config < --set < flags. A report records the resolved settings.
`picture = true` in ~/.config/tsdfuse/settings.toml leaves a picture beside each mesh.
Ctrl-C stops after the current scan and writes the result so far; a second Ctrl-C exits at once.";

/// What a run can be for.
const RESULTS: &[&str] = if cfg!(feature = "view") {
    &["output", "save_map", "preview", "store", "record", "view"]
} else {
    &["output", "save_map", "preview", "store", "record"]
};

/// Fuse scans into a map and extract its surface.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, group(ArgGroup::new("result").args(RESULTS).required(true).multiple(true)))]
pub(crate) struct Args {
    /// Write the mesh: .ply, .glb or .obj; .html for a page that shows it in any browser; NAME/tileset.json for 3D Tiles in a new folder; `-` for PLY on standard output.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Give the mesh the colours that the log's cameras saw: .ply, .glb, .html or tiles; with --save-map they are saved beside the map.
    #[arg(long, requires = "output")]
    color: bool,
    /// Average how strongly surfaces reflect: as grey in .ply, .glb and tiles (unless --color), as numbers in .html, and beside
    /// --save-map or --store as NAME.intensity.tsdf.
    #[arg(long)]
    intensity: bool,
    /// Write into this folder for each scan which of its returns move: NUMBER.label as SemanticKITTI has them (9 stays, 251 moves,
    /// 0 was not looked at).
    #[arg(long, value_name = "DIR")]
    labels: Option<PathBuf>,
    /// Record the run for Foxglove and RViz (.mcap): scans, tf, odometry, the surface as it grows, and an occupancy grid.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Also write the mesh so far to --output after every N scans, for a viewer that reloads it.
    #[arg(long, value_name = "N", requires = "output", value_parser = clap::value_parser!(u32).range(1..))]
    mesh_every: Option<u32>,
    /// Save the map, for `tsdfuse mesh` and `tsdfuse render`; --output is then optional.
    #[arg(long, value_name = "FILE")]
    save_map: Option<PathBuf>,
    /// Continue a saved map, with its voxel size and truncation.
    #[arg(long, value_name = "FILE")]
    load_map: Option<PathBuf>,
    /// About where in the saved map the first scan was taken, if the log has no poses: within some 3 m and 30° [default: sought
    /// along the poses of the map's scans].
    #[arg(long, value_name = "X,Y,Z[,YAW_DEG]|POSE", requires = "load_map", value_parser = parse_rough_pose, allow_hyphen_values = true)]
    initial_pose: Option<Pose>,
    /// Limit the memory for blocks of the map (512M, 8G, ...); the rest is paged to a file. The map has the same bits.
    #[arg(long, value_name = "SIZE")]
    memory: Option<Memory>,
    /// Keep the map in this file as it grows; after a crash, `tsdfuse resume FILE` continues.
    #[arg(long, value_name = "FILE")]
    store: Option<PathBuf>,
    /// Commit the store after every SCANS scans.
    #[arg(long, value_name = "SCANS", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    commit_every: u32,
    /// Write the poses of the scans: TUM, or KITTI where scans have no times.
    #[arg(long, value_name = "FILE")]
    save_poses: Option<PathBuf>,
    /// Write what is known of the sensor: with --poses refine, the systematic errors that were found, too. `--sensor FILE` takes it.
    #[arg(long, value_name = "FILE.toml")]
    save_sensor: Option<PathBuf>,
    /// Write a picture of the whole result (.png).
    #[arg(long, value_name = "FILE")]
    preview: Option<PathBuf>,
    /// Watch the run in a browser: prints a URL that only this machine can open, unless ADDRESS (--view=0.0.0.0:8642) says
    /// otherwise. It stays open until Ctrl-C.
    #[cfg(feature = "view")]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = crate::view::DEFAULT)]
    view: Option<std::net::SocketAddr>,
    #[command(flatten)]
    run: RunArgs,
    /// Leave out the middle one of every K scans, to test how well the map predicts it (see `tsdfuse evaluate`).
    #[arg(long, value_name = "K", value_parser = hold_out_range())]
    hold_out: Option<u32>,
    /// Write a JSON report: configuration, and counts and times of each scan.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print the report on standard output.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    exit::quiet_gpu(&args.run.device);
    let job = args.job()?;
    args.run.log.set_threads()?;
    let stop = exit::stop_on_interrupt()?;
    #[cfg(feature = "view")]
    if let Some(address) = args.view {
        let live = crate::view::open(address, &args.run.log.log)?;
        let watched = tsdfuse_run::LiveRun::new(live.clone());
        let report = job.run(&stop, &mut tsdfuse_run::Both(Terminal::default(), watched))?;
        let outcome = done(&report, args.json)?;
        crate::view::stay(&live, &stop);
        return Ok(outcome);
    }
    let report = job.run(&stop, &mut Terminal::default())?;
    done(&report, args.json)
}

/// Tells people and programs what was done.
pub(crate) fn done(report: &Report, json: bool) -> Result<Outcome> {
    terminal::summarize(report);
    if json {
        output::print_json(report)?;
    }
    Ok(if report.skipped_scans.is_empty() && !report.stopped {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}

impl Args {
    /// The picture: the one that is asked for, or the one beside the mesh, if the user's settings ask for that once and for all.
    fn preview(&self) -> Result<Option<PathBuf>> {
        let beside = || {
            let mesh = self
                .output
                .as_ref()
                .filter(|_| self.memory.is_none() && self.store.is_none())?;
            let is_file = mesh.as_os_str() != "-" && mesh.extension().is_some_and(|e| e != "json");
            is_file.then(|| mesh.with_extension("png"))
        };
        Ok(match &self.preview {
            Some(preview) => Some(preview.clone()),
            None if crate::user::settings()?.picture => beside(),
            None => None,
        })
    }

    fn job(&self) -> Result<Job> {
        if let Some(mesh) = &self.output {
            output::check_terminal(mesh, self.json)?;
        }
        let mut job = self.run.job()?;
        job.input.selection.hold_out = self.hold_out.map(|every| every as usize);
        Ok(Job {
            memory_bytes: self.memory.map(|memory| memory.0),
            store: self.store.clone(),
            commit_every: self.commit_every as usize,
            load_map: self.load_map.clone(),
            initial_pose: self.initial_pose,
            outputs: Outputs {
                mesh: self.output.clone(),
                color: self.color,
                intensity: self.intensity,
                recording: self.record.clone(),
                labels: self.labels.clone(),
                mesh_every: self.mesh_every.map(|every| every as usize),
                map: self.save_map.clone(),
                poses: self.save_poses.clone(),
                sensor: self.save_sensor.clone(),
                preview: self.preview()?,
                report: self.report.clone(),
            },
            ..job
        })
    }
}
