//! `tsdfuse mesh`: a saved map in, a mesh out.

mod parts;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use serde::Serialize;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse::{Mesh, VoxelMap};
use tsdfuse_store::{Options, Pager, Surface};

use crate::device::Device;
use crate::exit::{Outcome, Usage};
use crate::output::{self, is_tileset};
use crate::progress;
use crate::report::{MapReport, MeshReport, print_json};
use crate::tiles;

pub(crate) use parts::{check_in_parts, surface_in_parts};

/// Blocks of a store that are in memory while it is meshed or exported.
const STORE_BYTES: usize = 256 << 20;

/// Opens a store, of which nothing is read yet.
pub(crate) fn open_store(path: &Path) -> Result<(VoxelMap, Pager)> {
    let limit_bytes = STORE_BYTES;
    let (map, pager, _) = Pager::open(path, Options { limit_bytes })?;
    Ok((map, pager))
}

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 --save-map street.tsdf
  tsdfuse mesh street.tsdf -o street.glb --min-weight 2
  tsdfuse mesh drive.store -o drive/tileset.json";

/// Extract the surface of a saved map or of a store.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The map, saved by `tsdfuse fuse --save-map`, or the store of `tsdfuse fuse --store`.
    map: PathBuf,
    /// The mesh to write, .ply, .glb or .obj; a new folder's NAME/tileset.json for 3D Tiles; `-` writes PLY to standard output.
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
    let done = match tsdfuse_store::recognises(&args.map) {
        true => args.of_store(config)?,
        false => args.of_map(config)?,
    };
    done.map.summarize(None);
    done.mesh.summarize();
    done.mesh.say_where();
    if args.json {
        print_json(&done)?;
    }
    Ok(Outcome::Complete)
}

impl Args {
    fn of_map(&self, config: MeshConfig) -> Result<Done> {
        let start = Instant::now();
        let map = tsdfuse_io::map_file::read(&self.map)?;
        Ok(Done {
            path: self.map.clone(),
            read_seconds: start.elapsed().as_secs_f64(),
            map: MapReport::of(&map),
            config,
            mesh: surface_by(|| self.device.mesh(&map, &config), &map, &config, &self.output)?,
        })
    }

    /// Of a store nothing is read before it is meshed.
    fn of_store(&self, config: MeshConfig) -> Result<Done> {
        if self.device != Device::Cpu {
            return Err(Usage::new("a store is meshed by the CPU: leave out --device").into());
        }
        check_in_parts(&self.output).map_err(Usage::new)?;
        let (mut map, mut pager) = open_store(&self.map)?;
        let mesh = surface_in_parts(&mut map, &mut pager, &config, &self.output)?;
        Ok(Done {
            path: self.map.clone(),
            read_seconds: 0.0,
            map: MapReport::of_store(&pager, &map),
            config,
            mesh,
        })
    }
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
    if is_tileset(path) {
        return tiles::write(path, &mut Surface::whole(map, config));
    }
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
