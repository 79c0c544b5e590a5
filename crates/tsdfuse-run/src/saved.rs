//! Saved maps and stores, read whichever of them a path is.

use std::io::Read;
use std::path::Path;

use tsdfuse::index::BlockIndex;
use tsdfuse::{Pose, VoxelMap};
use tsdfuse_io::map_file::{self, FusedPose, Reader};
use tsdfuse_io::poses::{self, Poses};
use tsdfuse_store::PagedMap;

use crate::error::{Result, RunError};

/// Blocks of a store that are in memory while it is read, bytes.
pub const STORE_BYTES: usize = 256 << 20;

/// Opens a store to look at it; nothing is loaded yet.
///
/// # Errors
/// As [`PagedMap::open_read_only`].
pub fn open_store(path: &Path) -> Result<PagedMap> {
    Ok(PagedMap::open_read_only(path, Some(STORE_BYTES))?.0)
}

/// Reads a saved map, but no store, and the poses of its scans.
///
/// # Errors
/// [`RunError::Config`] for a store; as [`map_file::read_with_poses`].
pub fn read_map(path: &Path) -> Result<(VoxelMap, Vec<FusedPose>)> {
    if tsdfuse_store::recognises(path) {
        let store = path.display();
        return Err(RunError::config(format_args!(
            "{store}: is a store; tsdfuse map export {store} -o NAME.tsdf makes a map of it"
        )));
    }
    Ok(map_file::read_with_poses(path)?)
}

/// Reads a saved map, or all of a store, and the poses of its scans.
///
/// # Errors
/// As [`whole`] and [`map_file::read_with_poses`].
pub fn read(path: &Path) -> Result<(VoxelMap, Vec<FusedPose>)> {
    if tsdfuse_store::recognises(path) {
        return whole(&mut open_store(path)?);
    }
    Ok(map_file::read_with_poses(path)?)
}

/// All of a store, and the poses of its scans.
///
/// # Errors
/// If the store cannot be read, or there is no memory for all of it.
pub fn whole(store: &mut PagedMap) -> Result<(VoxelMap, Vec<FusedPose>)> {
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

/// Adds the blocks of a saved map to one of the same configuration as they are read, tells of each, and appends the poses; how many voxels
/// would have gone beyond `max_weight`.
///
/// # Errors
/// If the file cannot be read, or there is no memory for its blocks.
pub fn add(
    map: &mut VoxelMap,
    poses: &mut Vec<FusedPose>,
    mut reader: Reader<impl Read>,
    mut added: impl FnMut(BlockIndex),
) -> Result<u64> {
    let integrations = map.integrations().wrapping_add(reader.integrations());
    poses.extend(reader.take_poses());
    let mut limited = 0;
    reader.for_each_block(|index, block| {
        limited += map.add_block(index, &block)?;
        added(index);
        Ok(())
    })?;
    map.set_integrations(integrations);
    Ok(limited)
}

/// Moves the poses of a map's scans with the map.
pub fn move_poses(poses: &mut [FusedPose], new_from_old: &Pose) {
    poses
        .iter_mut()
        .for_each(|fused| fused.pose = *new_from_old * fused.pose);
}

/// Reads the poses of whatever has some: a pose file, a saved map, a store, or the folder of a log (then those of its scans,
/// `world_from_sensor`).
///
/// # Errors
/// If the path cannot be read, or does not tell the poses of all scans.
pub fn poses(path: &Path) -> Result<Poses> {
    let missing = |reason: String| RunError::from(tsdfuse_io::Error::dataset(path, reason));
    if path.is_dir() {
        let log = tsdfuse_io::open(path)?;
        let unknown = log.scans().iter().filter(|scan| scan.pose.is_none()).count();
        if unknown > 0 {
            return Err(missing(format!(
                "{unknown} of {} scans have no pose",
                log.scans().len()
            )));
        }
        let poses = log.scans().iter().filter_map(|scan| Some((scan.time_ns, scan.pose?)));
        return Ok(Poses::of(poses));
    }
    let fused = if tsdfuse_store::recognises(path) {
        open_store(path)?.poses().to_vec()
    } else if map_file::recognises(path) {
        Reader::open(path)?.take_poses()
    } else {
        return Ok(poses::read(path)?);
    };
    if fused.is_empty() {
        return Err(missing("does not tell the poses of its scans".to_owned()));
    }
    Ok(Poses::of(fused.iter().map(|fused| (fused.time_ns, fused.pose))))
}
