//! What a saved map or a store holds: its voxels, its extent, and the way of the sensor.

use std::path::{Path, PathBuf};

use serde::Serialize;
use tsdfuse::MapConfig;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::map::Tally;
use tsdfuse::trajectory::{length_m, secs_between};
use tsdfuse_io::map_file::{FusedPose, Reader};
use tsdfuse_store::PagedMap;

use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::report::MapReport;

/// What a saved map or a store holds.
#[derive(Debug, Serialize)]
pub struct MapInfo {
    /// The file.
    pub path: PathBuf,
    /// `tsdfuse map` or `tsdfuse store`.
    pub format: &'static str,
    /// Its size.
    pub file_bytes: u64,
    /// What the map was made with.
    pub config: MapConfig,
    /// Its blocks.
    #[serde(flatten)]
    pub map: MapReport,
    /// The corners of the box around all observed voxels, world, metres; of a map.
    pub extent_m: Option<[DVec3; 2]>,
    /// Where its scans were fused; nothing where the file does not tell.
    pub trajectory: Option<Travelled>,
    /// How many scans of the run are stored, and how many there are; of a store.
    pub scans: Option<[Option<usize>; 2]>,
}

/// The trajectory of a map.
#[derive(Debug, Serialize)]
pub struct Travelled {
    /// How many poses it has.
    pub poses: usize,
    /// From pose to pose, in the order in which the scans were fused.
    pub distance_m: f64,
    /// From the earliest to the latest time, where times are known.
    pub seconds: Option<f64>,
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
}

impl MapInfo {
    /// Of a saved map, which is read group by group and not kept.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn read(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let (config, poses) = (*reader.config(), reader.take_poses());
        let mut tally = Tally::default();
        reader.for_each_block(|index, block| tally.add(index, &block))?;
        let file = std::fs::metadata(path).map_err(tsdfuse_io::Error::io(path))?;
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
    ///
    /// # Errors
    /// If the store or its checkpoint cannot be read.
    pub fn of_store(path: &Path) -> Result<Self> {
        let (map, checkpoint) = PagedMap::open_read_only(path, None)?;
        let checkpoint = Checkpoint::parse(path, &checkpoint)?;
        let file = std::fs::metadata(path).map_err(tsdfuse_io::Error::io(path))?;
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
}
