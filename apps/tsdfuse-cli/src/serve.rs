//! `tsdfuse serve`: a run, or a map, for Foxglove and what else speaks its protocol.

use std::net::SocketAddr;
use std::path::Path;

use anyhow::Result;
use tsdfuse::Pose;
use tsdfuse::mesh::{MeshConfig, Surface};
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_io::ros::Server;
use tsdfuse_run::{Both, Recording, Stop};

use crate::args::RunArgs;
use crate::exit::{self, Outcome, Usage};
use crate::fuse;
use crate::serving;
use crate::terminal::Terminal;

const EXAMPLES: &str = "\
Open it in Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765.

Examples:
  tsdfuse serve udp://:2368
  tsdfuse serve drive
  tsdfuse serve street.tsdf --address 0.0.0.0:8765";

/// Serve a run, or a map, by Foxglove's WebSocket protocol: points, tf, odometry, the surface as it grows, an occupancy grid.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, mut_arg("log", |log| log.help(
    "The log to fuse (see `tsdfuse fuse`), udp://:PORT for a LiDAR that sends packets now; or a saved map or a store to show")))]
pub(crate) struct Args {
    /// Where to serve it; with the default, only this machine can connect.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8765")]
    address: SocketAddr,
    #[command(flatten)]
    run: RunArgs,
}

/// What a server calls what it serves.
const WHAT: &str = "foxglove";

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let path = &args.run.log.log;
    let stop = exit::stop_on_interrupt()?;
    if tsdfuse_store::recognises(path) {
        let mut store = tsdfuse_run::saved::open_store(path)?;
        let poses = store.poses().to_vec();
        return show(args, &stop, &poses, &mut store.surface(&args.mesh()?));
    }
    if map_file::recognises(path) {
        let (map, poses) = map_file::read_with_poses(path)?;
        return show(args, &stop, &poses, &mut Surface::new(&map, &args.mesh()?));
    }
    exit::quiet_gpu(&args.run.device);
    let job = args.run.job()?;
    args.run.log.set_threads()?;
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
    let server = start(args.address, &args.run.log.log)?;
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
            min_weight: self
                .run
                .log
                .min_weight
                .map_or(default.min_weight, |weight| weight as f32),
        };
        config.validate().map_err(Usage::new)?;
        Ok(config)
    }
}
