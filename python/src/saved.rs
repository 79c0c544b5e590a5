//! Maps in files, whichever kind of file.

use std::path::Path;

use pyo3::prelude::*;
use tsdfuse::VoxelMap;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_io::{npz, ply};
use tsdfuse_run::RunError;
use tsdfuse_store::PagedMap;

use crate::error::{OrRaise, wrong};

/// Blocks of a store that are in memory while it is read.
pub(crate) const STORE_BYTES: usize = 256 << 20;

/// All of a store.
pub(crate) fn whole(store: &mut PagedMap) -> Result<(VoxelMap, Vec<FusedPose>), RunError> {
    let mut map = VoxelMap::new(*store.config())?;
    map.set_integrations(store.integrations());
    store.for_each_region(|part, region| {
        for (index, block) in part.blocks_of(region) {
            map.insert_block(index, block.clone())?;
        }
        Ok::<_, RunError>(())
    })?;
    Ok((map, store.poses().to_vec()))
}

/// Reads a saved map or a store, with the poses of its scans.
pub(crate) fn read_any(path: &Path) -> Result<(VoxelMap, Vec<FusedPose>), RunError> {
    if tsdfuse_store::recognises(path) {
        return whole(&mut PagedMap::open_read_only(path, Some(STORE_BYTES))?.0);
    }
    Ok(map_file::read_with_poses(path)?)
}

/// Writes a map as arrays (`.npz`, `.zarr`), or its surface as points (`.ply`).
pub(crate) fn export(map: &VoxelMap, config: &MeshConfig, path: &Path) -> PyResult<()> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("npz") => npz::write(path, map).or_raise(),
        Some("ply") => ply::write_vertices(path, &extract_with(map, config).or_raise()?).or_raise(),
        Some("zarr") => zarr(map, path),
        _ => Err(wrong(format_args!(
            "{}: a map is exported as .npz, .zarr or .ply",
            path.display()
        ))),
    }
}

#[cfg(feature = "zarr")]
fn zarr(map: &VoxelMap, path: &Path) -> PyResult<()> {
    use rayon::prelude::*;
    use tsdfuse_io::zarr::Volume;

    tsdfuse_io::atomic::check_folder(path).or_raise()?;
    let regions = map.regions();
    let volume = Volume::create(path, map.config(), &regions).or_raise()?;
    let write = |&region| volume.region(region, map.blocks_of(region));
    regions.par_iter().try_for_each(write).or_raise()?;
    volume.finish().or_raise()
}

#[cfg(not(feature = "zarr"))]
fn zarr(_: &VoxelMap, path: &Path) -> PyResult<()> {
    let told = "this build writes no Zarr arrays: it was made without the feature zarr";
    Err(wrong(format_args!("{}: {told}", path.display())))
}
