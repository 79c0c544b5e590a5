//! What `tsdfuse info` tells of a saved map, or of a store.

use indicatif::{BinaryBytes, HumanCount};
use tsdfuse_run::map_info::{MapInfo, Travelled};

use super::rows::{Rows, extent_line};

/// All that is known, a line each.
pub(super) fn table(info: &MapInfo) -> String {
    let mut rows = Rows::default();
    rows.add(
        if info.scans.is_some() { "store" } else { "map" },
        format!("{} ({})", info.path.display(), BinaryBytes(info.file_bytes)),
    );
    if let Some([Some(done), asked]) = info.scans {
        let more = if asked.is_some_and(|asked| done < asked) {
            "; tsdfuse resume goes on"
        } else {
            ""
        };
        let of = asked.map_or(String::new(), |asked| format!(" of {asked}"));
        rows.add("scans", format!("{done}{of} stored{more}"));
    }
    rows.add("voxel size", format!("{} m", info.config.voxel_size_m));
    rows.add("truncation", format!("{} m", info.config.truncation_m));
    rows.add("max weight", info.config.max_weight);
    rows.add("blocks", HumanCount(info.map.blocks as u64));
    rows.add(
        "observed",
        format!("{} voxels", HumanCount(info.map.observed_voxels as u64)),
    );
    if info.scans.is_none() {
        rows.add("memory", BinaryBytes(info.map.bytes as u64));
    }
    if let Some([low, high]) = info.extent_m {
        rows.add("extent", extent_line(low, high));
    }
    if let Some(trajectory) = &info.trajectory {
        rows.add("trajectory", line(trajectory));
    }
    rows.finish()
}

fn line(travelled: &Travelled) -> String {
    let secs = travelled
        .seconds
        .map_or(String::new(), |secs| format!(" in {secs:.1} s"));
    format!(
        "{} poses, {:.1} m{secs}",
        HumanCount(travelled.poses as u64),
        travelled.distance_m
    )
}
