//! `tsdfuse map esdf`: the distance to the nearest surface.

use std::path::{Path, PathBuf};

use anyhow::Result;
use indicatif::HumanCount;
use tsdfuse::glam::IVec3;
use tsdfuse::mesh::{MeshConfig, Surface};
use tsdfuse_io::npz::Arrays;
use tsdfuse_io::{atomic, map_file};
use tsdfuse_plan::{Esdf, EsdfConfig};
use tsdfuse_run::check_outputs;
use tsdfuse_run::saved::open_store;

use crate::exit::{Outcome, Usage};
use crate::progress::{say, working};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A saved map, or a store.
    map: PathBuf,
    /// The file to write: .npz.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Voxel size, metres.
    #[arg(long, value_name = "M", default_value_t = EsdfConfig::default().voxel_size_m)]
    voxel_size: f64,
    /// The largest distance that is told, metres: at most 45 voxels.
    #[arg(long, value_name = "M", default_value_t = EsdfConfig::default().radius_m)]
    radius: f64,
    /// Write one array of the whole box, NaN beyond the radius, instead of a list of voxels.
    #[arg(long)]
    dense: bool,
    /// Take voxels with less weight than this for no surface.
    #[arg(long, value_name = "W", default_value_t = MeshConfig::default().min_weight)]
    min_weight: f32,
}

impl Args {
    pub(super) fn run(&self) -> Result<Outcome> {
        let mesh = MeshConfig {
            min_weight: self.min_weight,
        };
        mesh.validate().map_err(Usage::new)?;
        let config = EsdfConfig {
            voxel_size_m: self.voxel_size,
            radius_m: self.radius,
        };
        let mut esdf = Esdf::new(config).map_err(Usage::new)?;
        if !self.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz")) {
            let told = "distances are written as .npz";
            return Err(Usage::new(format_args!("{}: {told}", self.output.display())).into());
        }
        check_outputs(&[&self.map], &[&self.output])?;
        let spinner = working("working on the distances");
        if tsdfuse_store::recognises(&self.map) {
            fill(&mut esdf, &mut open_store(&self.map)?.surface(&mesh))?;
        } else {
            fill(&mut esdf, &mut Surface::new(&map_file::read(&self.map)?, &mesh))?;
        }
        let voxels = if self.dense {
            write_dense(&self.output, &esdf)?
        } else {
            write(&self.output, &esdf)?
        };
        drop(spinner);
        say(format_args!("  voxels   {}", HumanCount(voxels as u64)));
        say(format_args!("  wrote    {}", self.output.display()));
        Ok(Outcome::Complete)
    }
}

/// Takes in a surface, cube by cube.
fn fill(esdf: &mut Esdf, surface: &mut Surface<'_>) -> Result<()> {
    for cube in surface.cubes() {
        esdf.update(surface.pieces(cube)?);
    }
    Ok(())
}

/// Writes all voxels within the radius, chunk by chunk; how many there are.
fn write(path: &Path, esdf: &Esdf) -> Result<usize> {
    let mut voxels: Vec<IVec3> = Vec::new();
    let mut distances_m = Vec::new();
    esdf.for_each(|voxel, distance_m| {
        voxels.push(voxel);
        distances_m.push(distance_m);
    });
    let EsdfConfig { voxel_size_m, radius_m } = *esdf.config();
    let count = voxels.len();
    atomic::write(path, |out| {
        let mut arrays = Arrays::new(out);
        arrays.add("voxels", &[count, 3], voxels.iter().flat_map(IVec3::to_array))?;
        arrays.add("distances_m", &[count], distances_m.iter().copied())?;
        arrays.add("voxel_size_m", &[], [voxel_size_m])?;
        arrays.add("radius_m", &[], [radius_m])?;
        arrays.finish()
    })?;
    Ok(count)
}

/// Writes the box of all voxels within the radius; how many it has.
fn write_dense(path: &Path, esdf: &Esdf) -> Result<usize> {
    let dense = esdf.dense()?;
    let EsdfConfig { voxel_size_m, radius_m } = *esdf.config();
    atomic::write(path, |out| {
        let mut arrays = Arrays::new(out);
        arrays.add("distances_m", &dense.size, dense.values.iter().copied())?;
        arrays.add("low_voxel", &[3], dense.low.to_array())?;
        arrays.add("voxel_size_m", &[], [voxel_size_m])?;
        arrays.add("radius_m", &[], [radius_m])?;
        arrays.finish()
    })?;
    Ok(dense.values.len())
}
