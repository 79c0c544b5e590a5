//! Which regions of a map are in memory.

use std::path::{Path, PathBuf};

use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::RegionBlocks;
use tsdfuse::{Reach, VoxelMap};
use tsdfuse_io::map_file::FusedPose;

use crate::error::{Result, StoreError};
use crate::file::StoreFile;
use crate::format::{Sizes, State};
use crate::worker::{Answer, Worker, packed_blocks};

/// Regions that are packed at a time.
const PACKED_AT_ONCE: usize = 64;

/// Loads and evicts the regions of a map. A change follows this protocol: load what it can touch, change the map, mark
/// dirty what changed, evict. [`crate::PagedMap`] follows it.
#[derive(Debug)]
pub(crate) struct Pager {
    path: PathBuf,
    limit_bytes: Option<usize>,
    worker: Worker,
    regions: HashMap<RegionIndex, Region, FxBuildHasher>,
    /// Counts calls of [`Pager::load`].
    turn: u64,
    /// The region that [`Pager::load_next`] loaded last, if nothing else was loaded since.
    last: Option<RegionIndex>,
    most_bytes: usize,
}

/// What is known of a region.
#[derive(Clone, Copy, Debug)]
struct Region {
    place: Place,
    /// The turn that needed it last.
    used: u64,
    /// As of when it was packed last.
    sizes: Sizes,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// In memory, and the same in the file.
    Clean,
    /// In memory; the file has another version or none.
    Dirty,
    /// In the file only.
    Stored,
    /// In the file only, and requested.
    Loading,
}

impl Place {
    fn is_in_memory(self) -> bool {
        matches!(self, Self::Clean | Self::Dirty)
    }
}

impl Pager {
    /// Pages `map`, whose blocks are in memory but not in the file, or the other way round if `stored` says so.
    pub(crate) fn start(
        file: StoreFile,
        stored: Vec<(RegionIndex, Sizes)>,
        map: &VoxelMap,
        limit_bytes: Option<usize>,
    ) -> Result<Self> {
        let region = |(index, sizes)| {
            let (place, used) = (Place::Stored, 0);
            (index, Region { place, used, sizes })
        };
        let mut pager = Self {
            path: file.path().to_owned(),
            limit_bytes,
            worker: Worker::start(file, map.pool())?,
            regions: stored.into_iter().map(region).collect(),
            turn: 0,
            last: None,
            most_bytes: 0,
        };
        pager.mark_dirty(map, &map.block_indices())?;
        Ok(pager)
    }

    /// Regions are evicted while blocks take more memory than this.
    pub(crate) fn set_limit(&mut self, limit_bytes: Option<usize>) {
        self.limit_bytes = limit_bytes;
    }

    pub(crate) fn limit_bytes(&self) -> Option<usize> {
        self.limit_bytes
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The most memory that blocks have taken so far.
    pub(crate) fn most_bytes(&self) -> usize {
        self.most_bytes
    }

    /// The regions of the whole map, sorted.
    pub(crate) fn regions(&self) -> Vec<RegionIndex> {
        let mut all: Vec<_> = self.regions.keys().copied().collect();
        all.par_sort_unstable();
        all
    }

    /// How much the whole map holds, as of when its regions were packed last.
    pub(crate) fn sizes(&self) -> Sizes {
        let mut sizes = Sizes::default();
        self.regions.values().for_each(|region| sizes += region.sizes);
        sizes
    }

    /// The known regions that a scan can touch, in any order.
    pub(crate) fn within(&self, map: &VoxelMap, reach: &Reach) -> Vec<RegionIndex> {
        let grid = map.grid();
        let known = self.regions.keys().copied();
        known.filter(|&index| reach.touches(index, grid)).collect()
    }

    /// Loads these regions, as far as they exist, and waits for them.
    pub(crate) fn load(&mut self, map: &mut VoxelMap, needed: &[RegionIndex]) -> Result<()> {
        self.turn += 1;
        self.last = None;
        self.prefetch(needed)?;
        while let Some(answer) = self.worker.answer_now() {
            self.take(map, answer?)?;
        }
        for index in needed {
            while self
                .regions
                .get(index)
                .is_some_and(|region| region.place == Place::Loading)
            {
                let answer = self.worker.answer()?;
                self.take(map, answer)?;
            }
            if let Some(region) = self.regions.get_mut(index) {
                region.used = self.turn;
            }
        }
        self.most_bytes = self.most_bytes.max(map.memory_bytes());
        Ok(())
    }

    /// Loads a region unless it was the last one to be loaded, and evicts others for it.
    pub(crate) fn load_next(&mut self, map: &mut VoxelMap, index: RegionIndex) -> Result<()> {
        if self.last != Some(index) {
            self.load(map, &[index])?;
            self.evict(map)?;
            self.last = Some(index);
        }
        Ok(())
    }

    /// Requests these regions without waiting for them.
    pub(crate) fn prefetch(&mut self, indices: &[RegionIndex]) -> Result<()> {
        for &index in indices {
            match self.regions.get_mut(&index) {
                Some(region) if region.place == Place::Stored => {
                    region.place = Place::Loading;
                    self.worker.read(index)?;
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn take(&mut self, map: &mut VoxelMap, answer: Answer) -> Result<()> {
        match answer {
            Answer::Region(blocks) => self.put(map, blocks)?,
            Answer::Kept(index, sizes) => {
                if let Some(region) = self.regions.get_mut(&index) {
                    region.sizes = sizes;
                }
            }
            Answer::Committed => {}
        }
        Ok(())
    }

    fn put(&mut self, map: &mut VoxelMap, blocks: RegionBlocks) -> Result<()> {
        let index = blocks.index();
        map.put_region(blocks).map_err(|e| StoreError::Region {
            path: self.path.clone(),
            region: index,
            reason: e.to_string(),
        })?;
        if let Some(region) = self.regions.get_mut(&index) {
            (region.place, region.used) = (Place::Clean, self.turn);
        }
        Ok(())
    }

    /// Marks the regions of blocks that changed.
    ///
    /// # Errors
    /// [`StoreError::BeyondReach`] if a region was not loaded before: its blocks in the file and in memory contradict
    /// each other then.
    pub(crate) fn mark_dirty(&mut self, map: &VoxelMap, updated_blocks: &[BlockIndex]) -> Result<()> {
        let mut last = None;
        for &block in updated_blocks {
            let index = RegionIndex::of(block);
            if last.replace(index) == Some(index) {
                continue;
            }
            let region = self.regions.entry(index).or_insert(Region {
                place: Place::Dirty,
                used: self.turn,
                sizes: Sizes::default(),
            });
            if !region.place.is_in_memory() {
                return Err(StoreError::BeyondReach {
                    path: self.path.clone(),
                    region: index,
                });
            }
            (region.place, region.used) = (Place::Dirty, self.turn);
        }
        self.most_bytes = self.most_bytes.max(map.memory_bytes());
        Ok(())
    }

    /// Evicts least recently used regions until memory is under the limit, but none that the last [`Pager::load`]
    /// needed. Returns whether it got there.
    pub(crate) fn evict(&mut self, map: &mut VoxelMap) -> Result<bool> {
        let Some(limit_bytes) = self.limit_bytes else {
            return Ok(true);
        };
        if map.memory_bytes() <= limit_bytes {
            return Ok(true);
        }
        map.forget_empty_regions();
        let in_memory = self.regions.iter().filter(|(_, region)| region.place.is_in_memory());
        let idle = in_memory.filter(|(_, region)| region.used < self.turn);
        let mut idle: Vec<(u64, RegionIndex)> = idle.map(|(&index, region)| (region.used, index)).collect();
        idle.par_sort_unstable();
        for (_, index) in idle {
            // A little more than needed, so that not every scan has to evict.
            if map.memory_bytes() <= limit_bytes - limit_bytes / 16 {
                break;
            }
            let Some(region) = self.regions.get_mut(&index) else {
                continue;
            };
            let was_dirty = std::mem::replace(&mut region.place, Place::Stored) == Place::Dirty;
            match map.take_region(index) {
                Some(blocks) if was_dirty => self.worker.keep(blocks)?,
                _ => {}
            }
        }
        Ok(map.memory_bytes() <= limit_bytes)
    }

    /// Writes everything that is dirty, and makes it, `checkpoint` and `poses` the state that the next opening finds.
    pub(crate) fn commit(&mut self, map: &mut VoxelMap, checkpoint: &[u8], poses: &[FusedPose]) -> Result<()> {
        let dirty = self.regions.iter().filter(|(_, region)| region.place == Place::Dirty);
        let mut dirty: Vec<RegionIndex> = dirty.map(|(&index, _)| index).collect();
        dirty.par_sort_unstable();
        for some in dirty.chunks(PACKED_AT_ONCE) {
            let pack = |&index: &RegionIndex| packed_blocks(index, &map.blocks_of(index).collect::<Vec<_>>());
            for packed in some.par_iter().map(pack).collect::<Vec<_>>() {
                if let Some(region) = self.regions.get_mut(&packed.index) {
                    (region.place, region.sizes) = (Place::Clean, packed.sizes);
                }
                self.worker.write(packed)?;
            }
        }
        self.worker.commit(State {
            config: *map.config(),
            integrations: map.integrations(),
            checkpoint: checkpoint.to_owned(),
            poses: poses.to_owned(),
        })?;
        loop {
            match self.worker.answer()? {
                Answer::Committed => return Ok(()),
                other => self.take(map, other)?,
            }
        }
    }
}
