//! `tsdfuse map export`: what other programs read.

use std::path::PathBuf;

use anyhow::Result;
use indicatif::HumanCount;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse_io::{map_file, npz, ply};

use tsdfuse_run::{check_outputs, surface};

#[cfg(feature = "zarr")]
use super::zarr;
use crate::exit::{Outcome, Usage};
use crate::maps::open_store;
use crate::progress::say;

#[cfg(not(feature = "zarr"))]
mod zarr {
    //! What `-o NAME.zarr` says in a build without the feature `zarr`.

    use std::path::Path;

    use crate::exit::Usage;

    pub(super) fn check(path: &Path) -> anyhow::Result<()> {
        let told = "this build writes no Zarr arrays: it was made without the feature zarr";
        Err(Usage::new(format_args!("{}: {told}", path.display())).into())
    }

    pub(super) fn of_map<M>(path: &Path, _: M) -> anyhow::Result<()> {
        check(path)
    }

    pub(super) fn of_store<M>(path: &Path, _: M) -> anyhow::Result<()> {
        check(path)
    }
}

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
        let extension = output.extension().map(|e| e.to_string_lossy().to_lowercase());
        let (what, count) = match (extension.as_deref(), tsdfuse_store::recognises(map)) {
            (Some("npz"), false) => {
                let map = map_file::read(map)?;
                npz::write(output, &map)?;
                ("voxels", map.observed_voxel_count() as u64)
            }
            (Some("zarr"), false) => {
                zarr::check(output)?;
                let map = map_file::read(map)?;
                zarr::of_map(output, &map)?;
                ("voxels", map.observed_voxel_count() as u64)
            }
            (Some("ply"), false) => {
                let mesh = extract_with(&map_file::read(map)?, &config)?;
                ply::write_vertices(output, &mesh)?;
                ("points", mesh.vertices.len() as u64)
            }
            (Some("zarr"), true) => {
                zarr::check(output)?;
                let mut map = open_store(map)?;
                zarr::of_store(output, &mut map)?;
                ("voxels", map.sizes().observed_voxels)
            }
            (Some("tsdf"), true) => {
                let mut map = open_store(map)?;
                surface::save_in_parts(&mut map, output)?;
                ("voxels", map.sizes().observed_voxels)
            }
            (_, is_store) => {
                let wrong = if is_store {
                    "a store is exported as .zarr or .tsdf"
                } else {
                    "a map is exported as .npz, .zarr or .ply"
                };
                return Err(Usage::new(format_args!("{}: {wrong}", output.display())).into());
            }
        };
        say(format_args!("  {what:<8} {}", HumanCount(count)));
        say(format_args!("  wrote    {}", self.output.display()));
        Ok(Outcome::Complete)
    }
}
