//! Maps as Zarr arrays: `tsdfuse map export MAP -o NAME.zarr`.

use std::path::Path;

use anyhow::Result;
use rayon::prelude::*;
use tsdfuse::VoxelMap;
use tsdfuse_io::atomic::check_folder;
use tsdfuse_io::zarr::Volume;
use tsdfuse_store::PagedMap;

use crate::exit::Usage;

/// Finds out before the work whether arrays can be written there.
pub(super) fn check(path: &Path) -> Result<()> {
    Ok(check_folder(path).map_err(Usage::new)?)
}

/// Writes a map.
pub(super) fn of_map(path: &Path, map: &VoxelMap) -> Result<()> {
    let regions = map.regions();
    let volume = Volume::create(path, map.config(), &regions)?;
    let write = |&region| volume.region(region, map.blocks_of(region));
    regions.par_iter().try_for_each(write)?;
    Ok(volume.finish()?)
}

/// Writes a map of which only some is in memory.
pub(super) fn of_store(path: &Path, map: &mut PagedMap) -> Result<()> {
    let volume = Volume::create(path, map.config(), &map.regions())?;
    map.for_each_region(|map, region| anyhow::Ok(volume.region(region, map.blocks_of(region))?))?;
    Ok(volume.finish()?)
}
