//! The arguments of `tsdfuse fuse`, and what they mean.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use clap::ArgGroup;
use clap::builder::PossibleValuesParser;
use tsdfuse::VoxelMap;
use tsdfuse::fuse::Method;
use tsdfuse::mesh::MeshConfig;

use super::growing::Growing;
use crate::device::Device;
use crate::exit::Usage;
use crate::output::{self, is_tileset};
use crate::settings::{Settings, hold_out_range};

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 -o street.ply
  tsdfuse fuse kitti/sequences/00 -o street.ply --scans 0..80 --voxel-size 0.1 --truncation 0.3
  tsdfuse fuse pandaset/002 -o street.ply --mesh-every 10
  tsdfuse fuse pandaset/002 --save-map street.tsdf --scans 0..40
  tsdfuse fuse pandaset/002 --load-map street.tsdf -o street.ply --scans 40..80
  tsdfuse fuse drive -o drive.ply --memory 2G --store drive.store
  tsdfuse fuse street -o street.ply --config run.toml --set raycast.distance=projective

Settings: defaults < --config < --set < flags. A report holds all of them.";

/// Fuse scans into a map and extract its surface.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, group(ArgGroup::new("result").args(["output", "save_map", "preview", "store"]).required(true).multiple(true)))]
pub(crate) struct Args {
    /// The mesh to write, .ply, .glb or .obj; a new folder's NAME/tileset.json for 3D Tiles; `-` writes PLY to standard output.
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Write the mesh so far to --output after every N scans, too, for a viewer that reads it again and again.
    #[arg(long, value_name = "N", requires = "output", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) mesh_every: Option<u32>,
    /// Save the map, for `tsdfuse mesh` and `tsdfuse render`; --output may then be missing.
    #[arg(long, value_name = "FILE")]
    pub(super) save_map: Option<PathBuf>,
    /// Continue a saved map, with its voxels.
    #[arg(long, value_name = "FILE")]
    pub(super) load_map: Option<PathBuf>,
    /// Keep no more blocks of the map in memory than this (512M, 8G, ...); the others are in a file meanwhile. The result is the same.
    #[arg(long, value_name = "SIZE")]
    pub(super) memory: Option<Memory>,
    /// Keep the map in this file, too, as it grows: after a crash `tsdfuse resume FILE` goes on.
    #[arg(long, value_name = "FILE")]
    pub(super) store: Option<PathBuf>,
    /// How often the store is made safe.
    #[arg(long, value_name = "SCANS", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) commit_every: u32,
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

/// Bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Memory(pub(super) usize);

impl FromStr for Memory {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || "a size is wanted, as in 512M or 8G".to_owned();
        let units = [('K', 10), ('M', 20), ('G', 30), ('T', 40)];
        let unit = units
            .iter()
            .find(|(unit, _)| text.to_ascii_uppercase().ends_with(*unit));
        let number = unit.map_or(text, |_| &text[..text.len() - 1]);
        let bytes =
            number.trim().parse::<f64>().map_err(|_| wanted())? * unit.map_or(1.0, |(_, bits)| f64::from(*bits).exp2());
        match bytes >= f64::from(1 << 20) && bytes < f64::from(1 << 30) * 1e6 {
            true => Ok(Self(bytes as usize)),
            false => Err("at least 1M is wanted".to_owned()),
        }
    }
}

impl Args {
    /// What keeps the mesh file up to date, if the user wants that.
    pub(super) fn growing(&self, config: &MeshConfig, map: &VoxelMap) -> Option<Growing> {
        Some(Growing::new(
            self.mesh_every? as usize,
            self.output.clone()?,
            config,
            map,
        ))
    }

    /// Finds out before the work, not after it, that its results could not be written.
    pub(super) fn check_outputs(&self) -> Result<()> {
        if (self.memory.is_some() || self.store.is_some()) && self.device != Device::Cpu {
            let told = "--memory and --store are for maps that the CPU fuses: leave out --device";
            return Err(Usage::new(told).into());
        }
        if let Some(mesh) = &self.output {
            if self.mesh_every.is_some() && mesh.as_os_str() == "-" {
                return Err(Usage::new("--mesh-every needs a file as --output, not standard output").into());
            }
            if self.mesh_every.is_some() && is_tileset(mesh) {
                return Err(Usage::new("--mesh-every writes one file again and again, not tiles").into());
            }
            output::check_mesh(mesh, self.json)?;
        }
        if let Some(preview) = &self.preview {
            tsdfuse_io::png::check(preview).map_err(Usage::new)?;
        }
        let files: Vec<_> = [&self.save_map, &self.report, &self.preview, &self.store]
            .into_iter()
            .flatten()
            .collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units() {
        let bytes = |text: &str| text.parse::<Memory>().map(|m| m.0);
        assert_eq!(bytes("512M"), Ok(512 << 20));
        assert_eq!(bytes("1.5g"), Ok(3 << 29));
        assert_eq!(bytes("2000000"), Ok(2_000_000));
        for bad in ["", "M", "-1G", "5", "nanG", "1e30G", "G5"] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
    }
}
