//! `tsdfuse mesh`: a saved map in, a mesh out.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use tsdfuse::mesh::MeshConfig;
use tsdfuse_run::report::{MapReport, MeshReport};
use tsdfuse_run::saved::open_store;
use tsdfuse_run::{Device, Layers, check_outputs, scene, surface};

use crate::exit::{self, Outcome, Usage};
use crate::output::{self, print_json};
use crate::{progress, terminal};

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 --save-map street.tsdf
  tsdfuse mesh street.tsdf -o street.glb --min-weight 2
  tsdfuse mesh street.tsdf -o street.html
  tsdfuse mesh drive.store -o drive/tileset.json";

/// Extract the surface of a saved map or of a store, with the colours and intensities that were saved beside it.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// A map saved with `tsdfuse fuse --save-map`, or a store.
    map: PathBuf,
    /// The mesh to write, .ply, .glb or .obj; .html for a page that shows it in any browser; a new folder's NAME/tileset.json for 3D Tiles; `-` writes PLY to standard output.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Extract no surface from voxels with less weight than this.
    #[arg(long, value_name = "W", default_value_t = MeshConfig::default().min_weight)]
    min_weight: f32,
    /// Extract on the CPU or a GPU.
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    device: Device,
    /// Print a JSON report.
    #[arg(long)]
    json: bool,
}

/// What was done.
#[derive(Debug, Serialize)]
struct Done {
    /// The file that was read.
    path: PathBuf,
    /// Seconds it took.
    read_seconds: f64,
    map: MapReport,
    config: MeshConfig,
    mesh: MeshReport,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let config = MeshConfig {
        min_weight: args.min_weight,
    };
    exit::quiet_gpu(&args.device);
    config.validate().map_err(Usage::new)?;
    output::check_terminal(&args.output, args.json)?;
    surface::check(&args.output)?;
    check_outputs(&[&args.map], &[&args.output])?;
    let done = if tsdfuse_store::recognises(&args.map) {
        args.of_store(config)?
    } else {
        args.of_map(config)?
    };
    terminal::map(&done.map, None);
    terminal::mesh(&done.mesh);
    terminal::mesh_file(&done.mesh);
    if args.json {
        print_json(&done)?;
    }
    Ok(Outcome::Complete)
}

impl Args {
    fn of_map(&self, config: MeshConfig) -> Result<Done> {
        let start = Instant::now();
        let (map, poses) = tsdfuse_io::map_file::read_with_poses(&self.map)?;
        let read_seconds = start.elapsed().as_secs_f64();
        let _spinner = progress::working("extracting the surface");
        let report = MapReport::of(&map);
        let scene = scene::of_map(&self.map.to_string_lossy(), map.config().voxel_size_m, &report, &poses);
        Ok(Done {
            path: self.map.clone(),
            read_seconds,
            map: report,
            config,
            mesh: surface::write_by(
                || self.device.mesh(&map, &config),
                &map,
                &config,
                &self.output,
                &scene,
                &Layers::read_beside(&self.map)?,
            )?,
        })
    }

    /// Of a store nothing is read before it is meshed.
    fn of_store(&self, config: MeshConfig) -> Result<Done> {
        if self.device != Device::Cpu {
            return Err(Usage::new("a store is meshed by the CPU: leave out --device").into());
        }
        surface::check_in_parts(&self.output)?;
        let mut map = open_store(&self.map)?;
        let _spinner = progress::working("extracting the surface");
        let report = MapReport::of_paged(&map);
        let title = self.map.to_string_lossy();
        let scene = scene::of_map(&title, map.config().voxel_size_m, &report, map.poses());
        let layers = Layers::read_beside(&self.map)?;
        let mesh = surface::write_in_parts_with(&mut map, &config, &self.output, &scene, &layers)?;
        Ok(Done {
            path: self.map.clone(),
            read_seconds: 0.0,
            map: report,
            config,
            mesh,
        })
    }
}
