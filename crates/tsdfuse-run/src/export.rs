//! Saved maps and stores as other programs read them: arrays for NumPy and xarray, points with normals.

use std::path::Path;

use tsdfuse::VoxelMap;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse_io::{map_file, npz, ply};
use tsdfuse_store::PagedMap;

use crate::error::{Result, RunError};
use crate::saved::open_store;

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exported {
    /// So many observed voxels.
    Voxels(u64),
    /// So many points of the surface.
    Points(u64),
}

/// Writes a saved map (`.npz`, `.zarr`, `.ply`) or a store (`.zarr`, `.tsdf`). Points are those of voxels that the configuration takes for
/// surface.
///
/// # Errors
/// [`RunError::Config`] names what is possible; if the map cannot be read, or the file cannot be written.
pub fn file(path: &Path, config: &MeshConfig, output: &Path) -> Result<Exported> {
    if tsdfuse_store::recognises(path) {
        check(output, STORE)?;
        return store(&mut open_store(path)?, output);
    }
    check(output, MAP)?;
    map(&map_file::read(path)?, config, output)
}

/// Writes a map: `.npz`, `.zarr`, `.ply`.
///
/// # Errors
/// As [`file()`].
pub fn map(map: &VoxelMap, config: &MeshConfig, output: &Path) -> Result<Exported> {
    match check(output, MAP)?.as_str() {
        "npz" => npz::write(output, map)?,
        "ply" => {
            let mesh = extract_with(map, config)?;
            ply::write_vertices(output, &mesh)?;
            return Ok(Exported::Points(mesh.vertices.len() as u64));
        }
        _ => zarr::of_map(output, map)?,
    }
    Ok(Exported::Voxels(map.observed_voxel_count() as u64))
}

/// Writes a store, region by region: `.zarr`, `.tsdf`.
///
/// # Errors
/// As [`file()`].
pub fn store(map: &mut PagedMap, output: &Path) -> Result<Exported> {
    match check(output, STORE)?.as_str() {
        "tsdf" => map.save(output)?,
        _ => zarr::of_store(output, &mut *map)?,
    }
    Ok(Exported::Voxels(map.sizes().observed_voxels))
}

/// Extensions, and the sentence that tells them.
type Formats = (&'static [&'static str], &'static str);
const MAP: Formats = (&["npz", "zarr", "ply"], "a map is exported as .npz, .zarr or .ply");
const STORE: Formats = (&["zarr", "tsdf"], "a store is exported as .zarr or .tsdf");

/// The extension, if it is one of these and the file can be made.
fn check(output: &Path, (possible, told): Formats) -> Result<String> {
    let extension = output.extension().map(|e| e.to_string_lossy().to_lowercase());
    let known = extension.filter(|extension| possible.contains(&extension.as_str()));
    let known = known.ok_or_else(|| RunError::config(format_args!("{}: {told}", output.display())))?;
    if known == "zarr" {
        zarr::check(output)?;
    }
    Ok(known)
}

#[cfg(feature = "zarr")]
mod zarr {
    use std::path::Path;

    use rayon::prelude::*;
    use tsdfuse::VoxelMap;
    use tsdfuse_io::atomic::check_folder;
    use tsdfuse_io::zarr::Volume;
    use tsdfuse_store::PagedMap;

    use crate::error::{Result, RunError};

    pub(super) fn check(path: &Path) -> Result<()> {
        check_folder(path).map_err(RunError::config)
    }

    pub(super) fn of_map(path: &Path, map: &VoxelMap) -> Result<()> {
        let regions = map.regions();
        let volume = Volume::create(path, map.config(), &regions)?;
        let write = |&region| volume.region(region, map.blocks_of(region));
        regions.par_iter().try_for_each(write)?;
        Ok(volume.finish()?)
    }

    pub(super) fn of_store(path: &Path, map: &mut PagedMap) -> Result<()> {
        let volume = Volume::create(path, map.config(), &map.regions())?;
        map.for_each_region(|map, region| Ok::<_, RunError>(volume.region(region, map.blocks_of(region))?))?;
        Ok(volume.finish()?)
    }
}

#[cfg(not(feature = "zarr"))]
mod zarr {
    use std::path::Path;

    use crate::error::{Result, RunError};

    pub(super) fn check(path: &Path) -> Result<()> {
        let told = "this build writes no Zarr arrays: it was made without the feature zarr";
        Err(RunError::config(format_args!("{}: {told}", path.display())))
    }

    pub(super) fn of_map<M>(path: &Path, _: M) -> Result<()> {
        check(path)
    }

    pub(super) fn of_store<M>(path: &Path, _: M) -> Result<()> {
        check(path)
    }
}
