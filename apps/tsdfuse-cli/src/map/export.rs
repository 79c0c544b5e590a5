//! `tsdfuse map export`: what other programs read.

use std::path::PathBuf;

use anyhow::Result;
use indicatif::HumanCount;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse_io::{map_file, npz, ply};

use crate::exit::{Outcome, Usage};
use crate::fuse::save_in_parts;
use crate::mesh::open_store;
use crate::output::check_file;
use crate::progress::say;

use super::zarr;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The map, saved by `tsdfuse fuse --save-map`, or the store of `tsdfuse fuse --store`, of which .zarr and .tsdf can be written.
    map: PathBuf,
    /// What to write: .npz, a new folder .zarr, .ply or, of a store, .tsdf.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Voxels of less weight do not become surface (.ply).
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
        let extension = output.extension().map(|e| e.to_string_lossy().to_lowercase());
        let (what, count) = match (extension.as_deref(), tsdfuse_store::recognises(map)) {
            (Some("npz"), false) => {
                check_file(output)?;
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
                check_file(output)?;
                let mesh = extract_with(&map_file::read(map)?, &config)?;
                ply::write_vertices(output, &mesh)?;
                ("points", mesh.vertices.len() as u64)
            }
            (Some("zarr"), true) => {
                zarr::check(output)?;
                let (mut map, mut pager) = open_store(map)?;
                zarr::of_store(output, &mut map, &mut pager)?;
                ("voxels", pager.sizes().observed_voxels)
            }
            (Some("tsdf"), true) => {
                check_file(output)?;
                let (mut map, mut pager) = open_store(map)?;
                save_in_parts(&mut map, &mut pager, output)?;
                ("voxels", pager.sizes().observed_voxels)
            }
            (_, is_store) => {
                let wrong = match is_store {
                    true => "a store is exported as .zarr or .tsdf",
                    false => "a map is exported as .npz, .zarr or .ply",
                };
                return Err(Usage::new(format_args!("{}: {wrong}", output.display())).into());
            }
        };
        say(format_args!("  {what:<8} {}", HumanCount(count)));
        say(format_args!("  wrote    {}", self.output.display()));
        Ok(Outcome::Complete)
    }
}
