//! The arguments of `tsdfuse fuse`, and what they mean.

use std::path::PathBuf;

use anyhow::Result;
use clap::ArgGroup;
use clap::builder::PossibleValuesParser;
use tsdfuse::fuse::Method;
use tsdfuse::mesh::MeshConfig;

use super::growing::Growing;
use crate::device::Device;
use crate::exit::Usage;
use crate::output;
use crate::settings::{Settings, hold_out_range};

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 -o street.ply
  tsdfuse fuse kitti/sequences/00 -o street.ply --scans 0..80 --voxel-size 0.1 --truncation 0.3
  tsdfuse fuse pandaset/002 -o street.ply --mesh-every 10
  tsdfuse fuse pandaset/002 --save-map street.tsdf
  tsdfuse fuse street -o street.ply --config run.toml --set raycast.distance=projective

Settings: defaults < --config < --set < flags. A report holds all of them.";

/// Fuse scans into a map and extract its surface.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, group(ArgGroup::new("result").args(["output", "save_map", "preview"]).required(true).multiple(true)))]
pub(crate) struct Args {
    /// The mesh to write, .ply, .glb or .obj; `-` writes PLY to standard output.
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Write the mesh so far to --output after every N scans, too, for a viewer that reads it again and again.
    #[arg(long, value_name = "N", requires = "output", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) mesh_every: Option<u32>,
    /// Save the map, for `tsdfuse mesh` and `tsdfuse render`; --output may then be missing.
    #[arg(long, value_name = "FILE")]
    pub(super) save_map: Option<PathBuf>,
    /// A picture of the whole result, .png.
    #[arg(long, value_name = "FILE")]
    pub(super) preview: Option<PathBuf>,
    #[arg(long, value_parser = PossibleValuesParser::new(Method::ALL.iter().map(|m| m.name())),
        help = format!("How scans are fused [default: {}, or depth for depth cameras]", Method::default().name()))]
    pub(super) method: Option<String>,
    /// What fuses: the CPU, or a GPU (of several, the one whose name contains NAME).
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    pub(super) device: Device,
    #[command(flatten)]
    pub(super) settings: Settings,
    /// Leave out the middle one of each K scans, to see how well the others foretell it (`tsdfuse evaluate` does).
    #[arg(long, value_name = "K", value_parser = hold_out_range())]
    pub(super) hold_out: Option<u32>,
    /// Write what was done, with the configuration, counts and times of each scan, as JSON.
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    /// Print the report on standard output.
    #[arg(long)]
    pub(super) json: bool,
}

impl Args {
    /// What keeps the mesh file up to date, if the user wants that.
    pub(super) fn growing(&self, config: &MeshConfig) -> Option<Growing> {
        Some(Growing::new(self.mesh_every? as usize, self.output.clone()?, config))
    }

    /// Finds out before the work, not after it, that its results could not be written.
    pub(super) fn check_outputs(&self) -> Result<()> {
        if let Some(mesh) = &self.output {
            if self.mesh_every.is_some() && mesh.as_os_str() == "-" {
                return Err(Usage::new("--mesh-every needs a file as --output, not standard output").into());
            }
            if self.mesh_every.is_some() && self.device != Device::Cpu {
                return Err(Usage::new("--mesh-every follows a map that the CPU fuses: leave out --device").into());
            }
            output::check_mesh(mesh, self.json)?;
        }
        if let Some(preview) = &self.preview {
            tsdfuse_io::png::check(preview).map_err(Usage::new)?;
        }
        let files: Vec<_> = self.save_map.iter().chain(&self.report).chain(&self.preview).collect();
        let results: Vec<_> = self.output.iter().chain(files.iter().copied()).collect();
        if let Some(twice) = results
            .iter()
            .enumerate()
            .find_map(|(i, file)| results[..i].contains(file).then_some(file))
        {
            return Err(Usage::new(format_args!("{}: two results cannot be one file", twice.display())).into());
        }
        files.into_iter().try_for_each(|file| output::check_file(file))
    }
}
