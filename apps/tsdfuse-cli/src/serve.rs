//! `tsdfuse serve`: a run, or a map, for Foxglove and what else speaks its protocol.

use std::net::SocketAddr;
use std::path::Path;

use anyhow::Result;
use clap::builder::PossibleValuesParser;
use tsdfuse::Pose;
use tsdfuse::fuse::Method;
use tsdfuse::mesh::{MeshConfig, Surface};
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_io::ros::Server;
use tsdfuse_run::{Both, Device, Job, Recording, Stop};

use crate::args::{LogArgs, Loops};
use crate::exit::{self, Outcome, Usage};
use crate::fuse;
use crate::output::command_line;
use crate::serving;
use crate::terminal::Terminal;

const EXAMPLES: &str = "\
Open it in Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765.

Examples:
  tsdfuse serve udp://:2368
  tsdfuse serve drive --leave-out-moving
  tsdfuse serve street.tsdf --address 0.0.0.0:8765";

/// Serve a run, or a map, by Foxglove's WebSocket protocol: points, tf, odometry, the surface as it grows, an occupancy grid.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, mut_arg("log", |log| log.help(
    "The log to fuse (see `tsdfuse fuse`), udp://:PORT for a LiDAR that sends packets now; or a saved map or a store to show")))]
pub(crate) struct Args {
    /// Where to serve it; with the default, only this machine can connect.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8765")]
    address: SocketAddr,
    /// Leave out returns of things that move: those in space that was known to be free.
    #[arg(long)]
    leave_out_moving: bool,
    #[arg(long, value_parser = PossibleValuesParser::new(Method::ALL.iter().map(|m| m.name())),
        help = format!("The fusion method [default: {}, or depth for depth cameras]", Method::default().name()))]
    method: Option<String>,
    /// Fuse on the CPU or a GPU (gpu:NAME: the one whose name contains NAME).
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    device: Device,
    /// Correct the poses that odometry finds, or that are refined, where the sensor comes back, before anything is fused.
    #[arg(long, value_name = "on|off", default_value = "on")]
    loops: Loops,
    #[command(flatten)]
    log: LogArgs,
}

/// What a server calls what it serves.
const WHAT: &str = "foxglove";

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let path = &args.log.log;
    let stop = exit::stop_on_interrupt()?;
    if tsdfuse_store::recognises(path) {
        let store = crate::maps::open_store(path)?;
        let poses = store.poses().to_vec();
        let mut store = store;
        return show(args, &stop, &poses, &mut store.surface(&args.mesh()?));
    }
    if map_file::recognises(path) {
        let (map, poses) = map_file::read_with_poses(path)?;
        return show(args, &stop, &poses, &mut Surface::new(&map, &args.mesh()?));
    }
    exit::quiet_gpu(&args.device);
    let job = args.job()?;
    args.log.set_threads()?;
    let server = start(args.address, path)?;
    let mut watched = Both(Terminal::default(), Recording::serve(&server, &stop)?);
    let report = job.run(&stop, &mut watched)?;
    let Both(_, mut recording) = watched;
    let outcome = fuse::done(&report, false)?;
    stay(&server, &stop, &mut recording);
    recording.finish()?;
    Ok(outcome)
}

/// Shows a map as it is.
fn show(args: &Args, stop: &Stop, poses: &[FusedPose], surface: &mut Surface<'_>) -> Result<Outcome> {
    let server = start(args.address, &args.log.log)?;
    let mut recording = Recording::serve(&server, stop)?;
    recording.path(&poses.iter().map(|fused| fused.pose).collect::<Vec<Pose>>());
    for cube in surface.cubes() {
        recording.show(surface.pieces(cube)?);
    }
    stay(&server, stop, &mut recording);
    recording.finish()?;
    Ok(Outcome::Complete)
}

fn start(address: SocketAddr, path: &Path) -> Result<Server> {
    let server = Server::start(address, &format!("tsdfuse: {}", path.display()))?;
    serving::tell(WHAT, &server.url(), server.address());
    Ok(server)
}

fn stay(server: &Server, stop: &Stop, recording: &mut Recording) {
    serving::stay("it", &server.url(), stop, || recording.attend());
}

impl Args {
    fn mesh(&self) -> Result<MeshConfig> {
        let default = MeshConfig::default();
        let config = MeshConfig {
            min_weight: self.log.min_weight.map_or(default.min_weight, |weight| weight as f32),
        };
        config.validate().map_err(Usage::new)?;
        Ok(config)
    }

    fn job(&self) -> Result<Job> {
        let mut settings = self.log.settings(self.method.as_deref())?;
        if self.leave_out_moving {
            settings.set("--leave-out-moving", "moving.leave_out", true)?;
        }
        let mut job = Job {
            input: self.log.input(),
            poses: self.log.poses_from(),
            open_loops: !self.loops.is_on(),
            settings,
            device: self.device.clone(),
            ..Job::default()
        };
        job.command_line = command_line();
        job.config_file.clone_from(&self.log.config);
        Ok(job)
    }
}
