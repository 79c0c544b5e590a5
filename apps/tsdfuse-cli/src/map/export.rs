//! `tsdfuse map export`: what other programs read.

use std::path::PathBuf;

use anyhow::Result;
use indicatif::HumanCount;
use tsdfuse::mesh::MeshConfig;
use tsdfuse_run::check_outputs;
use tsdfuse_run::export::{self, Exported};

use crate::exit::{Outcome, Usage};
use crate::progress::say;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A saved map, or a store (only to .zarr and .tsdf).
    map: PathBuf,
    /// The file to write: .npz, .ply, a new folder .zarr, or (from a store) .tsdf.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Extract no surface from voxels with less weight than this (.ply).
    #[arg(long, value_name = "W", default_value_t = MeshConfig::default().min_weight)]
    min_weight: f32,
}

impl Args {
    pub(super) fn run(&self) -> Result<Outcome> {
        let config = MeshConfig {
            min_weight: self.min_weight,
        };
        config.validate().map_err(Usage::new)?;
        let (map, output) = (&self.map, &self.output);
        if !output.is_dir() {
            check_outputs(&[map], &[output])?;
        }
        let (what, count) = match export::file(map, &config, output)? {
            Exported::Voxels(count) => ("voxels", count),
            Exported::Points(count) => ("points", count),
        };
        say(format_args!("  {what:<8} {}", HumanCount(count)));
        say(format_args!("  wrote    {}", self.output.display()));
        Ok(Outcome::Complete)
    }
}
