//! What `tsdfuse info` tells of a saved map, or of a store.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use glam::{DVec3, IVec3};
use indicatif::{BinaryBytes, HumanCount};
use serde::Serialize;
use tsdfuse::MapConfig;
use tsdfuse::map::Tally;
use tsdfuse::trajectory::{length_m, secs_between};
use tsdfuse_io::map_file::{FusedPose, Reader};

use tsdfuse_run::Checkpoint;
use tsdfuse_run::report::MapReport;
use tsdfuse_store::PagedMap;

use super::rows::{Rows, extent_line};

/// What a saved map or a store holds.
#[derive(Debug, Serialize)]
pub(super) struct MapInfo {
    path: PathBuf,
    format: &'static str,
    file_bytes: u64,
    config: MapConfig,
    #[serde(flatten)]
    map: MapReport,
    /// The corners of the box around all observed voxels, world, metres; of a map.
    extent_m: Option<[DVec3; 2]>,
    /// Where its scans were fused; nothing where the file does not tell.
    trajectory: Option<Travelled>,
    /// How many scans of the run are stored, and how many there are; of a store.
    scans: Option<[Option<usize>; 2]>,
}

/// The trajectory of a map.
#[derive(Debug, Serialize)]
struct Travelled {
    poses: usize,
    /// From pose to pose, in the order in which the scans were fused.
    distance_m: f64,
    /// From the earliest to the latest time, where times are known.
    seconds: Option<f64>,
}

impl Travelled {
    fn of(poses: &[FusedPose]) -> Option<Self> {
        let times = || poses.iter().filter_map(|pose| pose.time_ns);
        let span = times().min().zip(times().max());
        (!poses.is_empty()).then(|| Self {
            poses: poses.len(),
            distance_m: length_m(poses.iter().map(|fused| &fused.pose)),
            seconds: span.map(|(first, last)| secs_between(first, last)),
        })
    }

    fn line(&self) -> String {
        let secs = self.seconds.map_or(String::new(), |secs| format!(" in {secs:.1} s"));
        format!(
            "{} poses, {:.1} m{secs}",
            HumanCount(self.poses as u64),
            self.distance_m
        )
    }
}

impl MapInfo {
    /// Of a saved map, which is read group by group and not kept.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let (config, poses) = (*reader.config(), reader.take_poses());
        let mut tally = Tally::default();
        reader.for_each_block(|index, block| tally.add(index, &block))?;
        let file = std::fs::metadata(path).with_context(|| path.display().to_string())?;
        let corner = |voxel: IVec3| voxel.as_dvec3() * config.voxel_size_m;
        Ok(Self {
            path: path.to_owned(),
            format: "tsdfuse map",
            file_bytes: file.len(),
            config,
            map: MapReport {
                blocks: tally.blocks(),
                observed_voxels: tally.observed_voxels(),
                bytes: tally.memory_bytes(),
            },
            extent_m: tally.extent().map(|[low, high]| [corner(low), corner(high + 1)]),
            trajectory: Travelled::of(&poses),
            scans: None,
        })
    }

    /// Of a store, whose map is not read.
    pub(super) fn of_store(path: &Path) -> Result<Self> {
        let (map, checkpoint) = PagedMap::open_read_only(path, None)?;
        let checkpoint = Checkpoint::parse(path, &checkpoint)?;
        let file = std::fs::metadata(path).with_context(|| path.display().to_string())?;
        Ok(Self {
            path: path.to_owned(),
            format: "tsdfuse store",
            file_bytes: file.len(),
            config: *map.config(),
            map: MapReport::of_paged(&map),
            extent_m: None,
            trajectory: Travelled::of(map.poses()),
            scans: Some([Some(checkpoint.done), checkpoint.asked]),
        })
    }

    /// All that is known, a line each.
    pub(super) fn table(&self) -> String {
        let mut rows = Rows::default();
        rows.add(
            if self.scans.is_some() { "store" } else { "map" },
            format!("{} ({})", self.path.display(), BinaryBytes(self.file_bytes)),
        );
        if let Some([Some(done), asked]) = self.scans {
            let more = if asked.is_some_and(|asked| done < asked) {
                "; tsdfuse resume goes on"
            } else {
                ""
            };
            let of = asked.map_or(String::new(), |asked| format!(" of {asked}"));
            rows.add("scans", format!("{done}{of} stored{more}"));
        }
        rows.add("voxel size", format!("{} m", self.config.voxel_size_m));
        rows.add("truncation", format!("{} m", self.config.truncation_m));
        rows.add("max weight", self.config.max_weight);
        rows.add("blocks", HumanCount(self.map.blocks as u64));
        rows.add(
            "observed",
            format!("{} voxels", HumanCount(self.map.observed_voxels as u64)),
        );
        if self.scans.is_none() {
            rows.add("memory", BinaryBytes(self.map.bytes as u64));
        }
        if let Some([low, high]) = self.extent_m {
            rows.add("extent", extent_line(low, high));
        }
        if let Some(trajectory) = &self.trajectory {
            rows.add("trajectory", trajectory.line());
        }
        rows.finish()
    }
}
