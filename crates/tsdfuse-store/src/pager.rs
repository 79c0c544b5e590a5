//! Which regions of a map are in memory.

use std::path::{Path, PathBuf};

use hashbrown::HashMap;
use rayon::prelude::*;
use redb::Database;
use rustc_hash::FxBuildHasher;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::RegionBlocks;
use tsdfuse::{Reach, VoxelMap};

use crate::error::{Result, StoreError};
use crate::file::{self, Sizes, State};
use crate::worker::{Answer, Worker, packed_blocks};

/// How a map is paged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Blocks in memory are taken away beyond this; what a scan needs stays, though, however much it is.
    pub limit_bytes: usize,
}

/// Regions that are packed at a time.
const PACKED_AT_ONCE: usize = 64;

/// Keeps a map's regions in a file, and in memory those that are in use.
#[derive(Debug)]
pub struct Pager {
    path: PathBuf,
    options: Options,
    worker: Worker,
    regions: HashMap<RegionIndex, Region, FxBuildHasher>,
    /// Counts calls of [`Pager::bring`].
    turn: u64,
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
    /// In memory, and in the file as it is.
    Same,
    /// In memory, and another one or none in the file.
    Changed,
    /// In the file.
    Stored,
    /// In the file, and asked for.
    Coming,
}

impl Place {
    fn is_here(self) -> bool {
        matches!(self, Self::Same | Self::Changed)
    }
}

impl Pager {
    /// Makes a store for a map, which holds nothing so far or is committed next.
    ///
    /// # Errors
    /// [`StoreError::File`], also if there is such a file.
    pub fn create(path: impl AsRef<Path>, map: &VoxelMap, note: &[u8], options: Options) -> Result<Self> {
        let path = path.as_ref();
        let empty = State {
            config: *map.config(),
            integrations: 0,
            note: note.to_owned(),
        };
        let mut pager = Self::start(path, file::create(path, &empty)?, map, options)?;
        pager.note(map, &map.block_indices())?;
        Ok(pager)
    }

    /// Opens a store: the map as it was committed last, of which nothing is in memory, and the note.
    ///
    /// # Errors
    /// [`StoreError::File`], also if nothing was ever committed.
    pub fn open(path: impl AsRef<Path>, options: Options) -> Result<(VoxelMap, Self, Vec<u8>)> {
        let path = path.as_ref();
        let database = file::open(path)?;
        let contents = file::contents(&database).map_err(StoreError::file(path))?;
        let (state, regions) = contents.ok_or_else(|| StoreError::File {
            path: path.to_owned(),
            reason: "nothing was ever committed to it".to_owned(),
        })?;
        let map = VoxelMap::new(state.config);
        let mut map = map.map_err(|reason| StoreError::Map {
            path: path.to_owned(),
            reason,
        })?;
        map.set_integrations(state.integrations);
        let mut pager = Self::start(path, database, &map, options)?;
        let stored = regions.into_iter().map(|(index, sizes)| {
            let (place, used) = (Place::Stored, 0);
            (index, Region { place, used, sizes })
        });
        pager.regions.extend(stored);
        Ok((map, pager, state.note))
    }

    fn start(path: &Path, database: Database, map: &VoxelMap, options: Options) -> Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            options,
            worker: Worker::start(path, database, map.pool())?,
            regions: HashMap::default(),
            turn: 0,
            most_bytes: 0,
        })
    }

    /// Changes how the map is paged.
    pub fn set_options(&mut self, options: Options) {
        self.options = options;
    }

    /// The store's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The most that blocks took in memory so far.
    pub fn most_bytes(&self) -> usize {
        self.most_bytes
    }

    /// The regions of the whole map, sorted.
    pub fn regions(&self) -> Vec<RegionIndex> {
        let mut all: Vec<_> = self.regions.keys().copied().collect();
        all.par_sort_unstable();
        all
    }

    /// Visits the regions of the whole map, sorted, each while it is in memory.
    ///
    /// # Errors
    /// As [`Pager::bring`] and [`Pager::release`], and what `visit` says.
    pub fn for_each_region<E: From<StoreError>>(
        &mut self,
        map: &mut VoxelMap,
        mut visit: impl FnMut(&VoxelMap, RegionIndex) -> Result<(), E>,
    ) -> Result<(), E> {
        for region in self.regions() {
            self.turn_to(map, &[region])?;
            visit(map, region)?;
        }
        Ok(())
    }

    /// Brings some regions into memory, and takes others away for them.
    ///
    /// # Errors
    /// As [`Pager::bring`] and [`Pager::release`].
    pub fn turn_to(&mut self, map: &mut VoxelMap, regions: &[RegionIndex]) -> Result<()> {
        self.bring_all(map, regions)?;
        self.release(map)?;
        Ok(())
    }

    /// How much the whole map holds, as of the last commit.
    pub fn sizes(&self) -> Sizes {
        let mut sizes = Sizes::default();
        self.regions.values().for_each(|region| sizes += region.sizes);
        sizes
    }

    /// Brings what a scan can touch into memory, waiting for what is not there yet.
    ///
    /// # Errors
    /// [`StoreError::File`] and [`StoreError::Region`].
    pub fn bring(&mut self, map: &mut VoxelMap, reach: &Reach) -> Result<()> {
        let near = self.within(map, reach);
        self.bring_all(map, &near)
    }

    /// As [`Pager::bring`], for some regions; those that are nowhere are left out.
    ///
    /// # Errors
    /// As [`Pager::bring`].
    pub fn bring_all(&mut self, map: &mut VoxelMap, needed: &[RegionIndex]) -> Result<()> {
        self.turn += 1;
        self.ask_for(needed)?;
        while let Some(answer) = self.worker.answer_now() {
            self.take(map, answer?)?;
        }
        for index in needed {
            while self
                .regions
                .get(index)
                .is_some_and(|region| region.place == Place::Coming)
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

    /// Asks for what a later scan will touch, without waiting for it.
    ///
    /// # Errors
    /// As [`Pager::bring`].
    pub fn expect(&mut self, map: &VoxelMap, reach: &Reach) -> Result<()> {
        let near = self.within(map, reach);
        self.ask_for(&near)
    }

    /// The known regions that a scan can touch; in any order.
    fn within(&self, map: &VoxelMap, reach: &Reach) -> Vec<RegionIndex> {
        let grid = map.grid();
        let known = self.regions.keys().copied();
        known.filter(|&index| reach.touches(index, grid)).collect()
    }

    fn ask_for(&mut self, indices: &[RegionIndex]) -> Result<()> {
        for &index in indices {
            match self.regions.get_mut(&index) {
                Some(region) if region.place == Place::Stored => {
                    region.place = Place::Coming;
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
            (region.place, region.used) = (Place::Same, self.turn);
        }
        Ok(())
    }

    /// Notes what an integration changed ([`tsdfuse::Integration::updated_blocks`]), or what else was put into the map.
    ///
    /// # Errors
    /// [`StoreError::BeyondReach`] if it was not brought before: the map is no longer to be trusted then.
    pub fn note(&mut self, map: &VoxelMap, updated_blocks: &[BlockIndex]) -> Result<()> {
        let mut last = None;
        for &block in updated_blocks {
            let index = RegionIndex::of(block);
            if last.replace(index) == Some(index) {
                continue;
            }
            let region = self.regions.entry(index).or_insert(Region {
                place: Place::Changed,
                used: self.turn,
                sizes: Sizes::default(),
            });
            if !region.place.is_here() {
                return Err(StoreError::BeyondReach {
                    path: self.path.clone(),
                    region: index,
                });
            }
            (region.place, region.used) = (Place::Changed, self.turn);
        }
        self.most_bytes = self.most_bytes.max(map.memory_bytes());
        Ok(())
    }

    /// Takes regions out of memory that the last [`Pager::bring`] did not need, those that were not needed for the longest time first, as long
    /// as there are more than the limit allows. Whether that suffices.
    ///
    /// # Errors
    /// [`StoreError::File`].
    pub fn release(&mut self, map: &mut VoxelMap) -> Result<bool> {
        let limit_bytes = self.options.limit_bytes;
        if map.memory_bytes() <= limit_bytes {
            return Ok(true);
        }
        map.forget_empty_regions();
        let here = self.regions.iter().filter(|(_, region)| region.place.is_here());
        let idle = here.filter(|(_, region)| region.used < self.turn);
        let mut idle: Vec<(u64, RegionIndex)> = idle.map(|(&index, region)| (region.used, index)).collect();
        idle.par_sort_unstable();
        for (_, index) in idle {
            // Some more than needed, so that it is not for every scan.
            if map.memory_bytes() <= limit_bytes - limit_bytes / 16 {
                break;
            }
            let Some(region) = self.regions.get_mut(&index) else {
                continue;
            };
            let changed = std::mem::replace(&mut region.place, Place::Stored) == Place::Changed;
            match map.take_region(index) {
                Some(blocks) if changed => self.worker.keep(blocks)?,
                _ => {}
            }
        }
        Ok(map.memory_bytes() <= limit_bytes)
    }

    /// Writes all that changed, and makes it and `note` what [`Pager::open`] finds. When this returns, no crash takes it away.
    ///
    /// # Errors
    /// [`StoreError::File`]; the file then holds what was committed before.
    pub fn commit(&mut self, map: &mut VoxelMap, note: &[u8]) -> Result<()> {
        let changed = self.regions.iter().filter(|(_, region)| region.place == Place::Changed);
        let mut changed: Vec<RegionIndex> = changed.map(|(&index, _)| index).collect();
        changed.par_sort_unstable();
        for some in changed.chunks(PACKED_AT_ONCE) {
            let pack = |&index: &RegionIndex| packed_blocks(index, &map.blocks_of(index).collect::<Vec<_>>());
            for packed in some.par_iter().map(pack).collect::<Vec<_>>() {
                if let Some(region) = self.regions.get_mut(&packed.index) {
                    (region.place, region.sizes) = (Place::Same, packed.sizes);
                }
                self.worker.write(packed)?;
            }
        }
        self.worker.commit(State {
            config: *map.config(),
            integrations: map.integrations(),
            note: note.to_owned(),
        })?;
        loop {
            match self.worker.answer()? {
                Answer::Committed => return Ok(()),
                other => self.take(map, other)?,
            }
        }
    }
}
