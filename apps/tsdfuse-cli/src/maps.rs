//! Reading saved maps and stores.

use std::path::Path;

use anyhow::Result;
use tsdfuse::VoxelMap;
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_store::PagedMap;

use crate::exit::Usage;

/// Blocks of a store that are in memory while it is meshed or exported.
const STORE_BYTES: usize = 256 << 20;

/// Opens a store to look at it; nothing is loaded yet.
pub(crate) fn open_store(path: &Path) -> Result<PagedMap> {
    let (map, _) = PagedMap::open_read_only(path, Some(STORE_BYTES))?;
    Ok(map)
}

/// Reads a saved map and the poses of its scans.
pub(crate) fn read_with_poses(path: &Path) -> Result<(VoxelMap, Vec<FusedPose>)> {
    if tsdfuse_store::recognises(path) {
        let store = path.display();
        let how = format!("{store}: is a store; tsdfuse map export {store} -o NAME.tsdf makes a map of it");
        return Err(Usage::new(how).into());
    }
    Ok(map_file::read_with_poses(path)?)
}

/// Reads a saved map, or all of a store.
pub(crate) fn read_any(path: &Path) -> Result<VoxelMap> {
    Ok(read_any_with_poses(path)?.0)
}

/// Reads a saved map, or all of a store, and the poses of its scans.
pub(crate) fn read_any_with_poses(path: &Path) -> Result<(VoxelMap, Vec<FusedPose>)> {
    if !tsdfuse_store::recognises(path) {
        return Ok(map_file::read_with_poses(path)?);
    }
    let mut store = open_store(path)?;
    let poses = store.poses().to_vec();
    let mut whole = VoxelMap::new(*store.config())?;
    store.for_each_region(|map, region| {
        for (index, block) in map.blocks_of(region) {
            whole.insert_block(index, block.clone())?;
        }
        anyhow::Ok(())
    })?;
    Ok((whole, poses))
}
