//! The poses of whatever has some: a pose file, a log, a saved map, a store.

use std::path::Path;

use anyhow::{Result, bail};
use tsdfuse_io::map_file::{self, Reader};
use tsdfuse_io::poses::{self, Poses};

use crate::maps::open_store;

/// Reads the poses. Of a log they are those of its scans, `world_from_sensor`.
pub(super) fn read(path: &Path) -> Result<Poses> {
    let named = || path.display().to_string();
    if path.is_dir() {
        let log = tsdfuse_io::open(path)?;
        let unknown = log.scans().iter().filter(|scan| scan.pose.is_none()).count();
        if unknown > 0 {
            bail!("{}: {unknown} of {} scans have no pose", named(), log.scans().len());
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
        bail!("{}: does not tell the poses of its scans", named());
    }
    Ok(Poses::of(fused.iter().map(|fused| (fused.time_ns, fused.pose))))
}
