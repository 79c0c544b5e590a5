//! The poses of whatever has some: a pose file, a log, a saved map, a store.

use std::path::Path;

use anyhow::{Context, Result, bail};
use tsdfuse::{Pose, Trajectory};
use tsdfuse_eval::trajectory::Track;
use tsdfuse_io::map_file::{self, Reader};
use tsdfuse_io::poses::{self, Poses};

use crate::maps::open_store;

/// Reads the poses. Of a log they are those of its scans, `world_from_sensor`.
pub(super) fn read(path: &Path) -> Result<Track> {
    let named = || path.display().to_string();
    if path.is_dir() {
        let log = tsdfuse_io::open(path)?;
        let poses = log.scans().iter().map(|scan| Some((scan.time_ns, scan.pose?)));
        let poses: Option<Vec<_>> = poses.collect();
        let Some(poses) = poses else {
            let unknown = log.scans().iter().filter(|scan| scan.pose.is_none()).count();
            bail!("{}: {unknown} of {} scans have no pose", named(), log.scans().len());
        };
        return track(poses).with_context(named);
    }
    let fused = if tsdfuse_store::recognises(path) {
        open_store(path)?.poses().to_vec()
    } else if map_file::recognises(path) {
        Reader::open(path)?.take_poses()
    } else {
        return Ok(match poses::read(path)? {
            Poses::Listed(poses) => Track::Listed(poses),
            Poses::Timed(trajectory) => Track::Timed(trajectory),
        });
    };
    if fused.is_empty() {
        bail!("{}: does not tell the poses of its scans", named());
    }
    track(fused.iter().map(|fused| (fused.time_ns, fused.pose)).collect()).with_context(named)
}

/// With times where all poses have one.
fn track(poses: Vec<(Option<i64>, Pose)>) -> Result<Track> {
    let timed: Option<Vec<(i64, Pose)>> = poses.iter().map(|&(time_ns, pose)| Some((time_ns?, pose))).collect();
    Ok(match timed {
        Some(timed) if !timed.is_empty() => Track::Timed(Trajectory::new(timed)?),
        _ => Track::Listed(poses.into_iter().map(|(_, pose)| pose).collect()),
    })
}
