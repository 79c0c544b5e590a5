//! `tsdfuse mesh`: a saved map in, a mesh out.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use serde::Serialize;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse::{Mesh, VoxelMap};

use crate::device::Device;
use crate::exit::{Outcome, Usage};
use crate::output;
use crate::progress;
use crate::report::{MapReport, MeshReport, print_json};

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 --save-map street.tsdf
  tsdfuse mesh street.tsdf -o street.glb --min-weight 2";

/// Extract the surface of a saved map.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The map, saved by `tsdfuse fuse --save-map`.
    map: PathBuf,
    /// The mesh to write, .ply, .glb or .obj; `-` writes PLY to standard output.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Voxels of less weight do not become surface.
    #[arg(long, value_name = "W", default_value_t = MeshConfig::default().min_weight)]
    min_weight: f32,
    /// What extracts it.
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    device: Device,
    /// Print what was done as JSON.
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
    config.validate().map_err(Usage::new)?;
    output::check_mesh(&args.output, args.json)?;
    let start = Instant::now();
    let map = tsdfuse_io::map_file::read(&args.map)?;
    let done = Done {
        path: args.map.clone(),
        read_seconds: start.elapsed().as_secs_f64(),
        map: MapReport::of(&map),
        config,
        mesh: surface_by(|| args.device.mesh(&map, &config), &map, &config, &args.output)?,
    };
    done.map.summarize(None);
    done.mesh.summarize();
    done.mesh.say_where();
    if args.json {
        print_json(&done)?;
    }
    Ok(Outcome::Complete)
}

/// Extracts the mesh, which must not be empty, and writes it.
pub(crate) fn surface(map: &VoxelMap, config: &MeshConfig, path: &Path) -> Result<MeshReport> {
    surface_by(|| Ok(extract_with(map, config)?), map, config, path)
}

/// As [`surface`], where something else extracts the map's mesh.
pub(crate) fn surface_by(
    extract: impl FnOnce() -> Result<Mesh>,
    map: &VoxelMap,
    config: &MeshConfig,
    path: &Path,
) -> Result<MeshReport> {
    let start = Instant::now();
    let spinner = progress::working("extracting the surface");
    let mesh = extract()?;
    drop(spinner);
    if mesh.triangles.is_empty() {
        bail!(
            "the map has no surface: {} blocks of voxels, but no triangle at a weight of {} or more",
            map.block_count(),
            config.min_weight
        );
    }
    let mut report = MeshReport::of(&mesh, path, start.elapsed().as_secs_f64());
    let writing = Instant::now();
    tsdfuse_io::mesh::write(path, &mesh)?;
    report.write_seconds = writing.elapsed().as_secs_f64();
    Ok(report)
}
