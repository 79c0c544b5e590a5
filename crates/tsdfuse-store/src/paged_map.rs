//! A map of which only a part is in memory.

use std::io;
use std::path::Path;
use std::time::Instant;

use tsdfuse::glam::DVec3;
use tsdfuse::index::{BlockIndex, Grid, RegionIndex};
use tsdfuse::map::Block;
use tsdfuse::mesh::{MeshConfig, MeshSink, RegionSource, Surface, stitch};
use tsdfuse::{Integration, Integrator, MapConfig, Reach, Scan, VoxelMap};
use tsdfuse_io::atomic;
use tsdfuse_io::map_file::{FusedPose, Writer};

use crate::error::{PagedError, Result, StoreError};
use crate::file::StoreFile;
use crate::format::{Sizes, State};
use crate::pager::Pager;

/// A map whose regions are stored in a file and loaded into memory on demand.
///
/// The map is the same, bit for bit, as a [`VoxelMap`] in memory. Changes since the last [`PagedMap::commit`] are lost
/// if the process ends.
///
/// After an error of the store ([`StoreError::File`], [`StoreError::Damaged`], [`StoreError::Region`],
/// [`StoreError::BeyondReach`]) the map in memory is useless: every later call returns [`StoreError::Broken`] with the
/// message of the first error. The file keeps the last commit.
#[derive(Debug)]
pub struct PagedMap {
    map: VoxelMap,
    pager: Pager,
    /// Of the scans that were fused.
    poses: Vec<FusedPose>,
    is_read_only: bool,
    /// What the last scan could touch.
    reach: Option<Reach>,
    /// The message of the error that made it useless.
    broken: Option<String>,
    /// The highest memory use that [`PagedMap::over_limit`] has returned, and what it returns next.
    told_bytes: usize,
    over_limit: Option<OverLimit>,
    paging_secs: f64,
}

/// A map takes more memory than its limit, because what a single scan can touch does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OverLimit {
    /// Memory used by blocks, in bytes.
    pub bytes: usize,
    /// The limit, in bytes.
    pub limit_bytes: usize,
}

/// Whether memory has grown by more than a quarter.
fn is_much_more(bytes: usize, before: usize) -> bool {
    bytes > before + before / 4
}

impl PagedMap {
    /// Creates a store. It holds an empty map and `checkpoint`; the blocks of `map` follow with the first commit.
    ///
    /// `limit_bytes` limits the memory used by blocks; `None` keeps all of them in memory. What a single scan can touch
    /// stays in memory, even beyond the limit.
    ///
    /// # Errors
    /// [`StoreError::File`], also if the file exists already.
    pub fn create(
        path: impl AsRef<Path>,
        map: VoxelMap,
        checkpoint: &[u8],
        limit_bytes: Option<usize>,
    ) -> Result<Self> {
        let file = StoreFile::create(path.as_ref(), State::begun(&map, checkpoint))?;
        Self::begin(file, map, limit_bytes)
    }

    /// The same in the place of a store that is there: it stays until the new one holds its checkpoint, whatever happens meanwhile. No process may have it open.
    ///
    /// # Errors
    /// [`StoreError::File`].
    pub fn replace(
        path: impl AsRef<Path>,
        map: VoxelMap,
        checkpoint: &[u8],
        limit_bytes: Option<usize>,
    ) -> Result<Self> {
        let file = StoreFile::replace(path.as_ref(), State::begun(&map, checkpoint))?;
        Self::begin(file, map, limit_bytes)
    }

    fn begin(file: StoreFile, map: VoxelMap, limit_bytes: Option<usize>) -> Result<Self> {
        let pager = Pager::start(file, Vec::new(), &map, limit_bytes)?;
        Ok(Self::new(map, pager, Vec::new(), false))
    }

    /// Opens a store at its last commit, and returns the map and the checkpoint. Nothing of the map is in memory yet.
    /// No other process may have the store open.
    ///
    /// # Errors
    /// [`StoreError::File`] and [`StoreError::Damaged`].
    pub fn open(path: impl AsRef<Path>, limit_bytes: Option<usize>) -> Result<(Self, Vec<u8>)> {
        Self::open_as(path.as_ref(), limit_bytes, false)
    }

    /// Opens a store for reading. Several processes can do so at the same time, and the file may be write-protected.
    ///
    /// # Errors
    /// As [`PagedMap::open`].
    pub fn open_read_only(path: impl AsRef<Path>, limit_bytes: Option<usize>) -> Result<(Self, Vec<u8>)> {
        Self::open_as(path.as_ref(), limit_bytes, true)
    }

    fn open_as(path: &Path, limit_bytes: Option<usize>, is_read_only: bool) -> Result<(Self, Vec<u8>)> {
        let (file, state) = StoreFile::open(path, !is_read_only)?;
        let map = VoxelMap::new(state.config);
        let mut map = map.map_err(|reason| StoreError::Map {
            path: path.to_owned(),
            reason,
        })?;
        map.set_integrations(state.integrations);
        let stored = file.regions().collect();
        let pager = Pager::start(file, stored, &map, limit_bytes)?;
        Ok((Self::new(map, pager, state.poses, is_read_only), state.checkpoint))
    }

    fn new(map: VoxelMap, pager: Pager, poses: Vec<FusedPose>, is_read_only: bool) -> Self {
        Self {
            map,
            pager,
            poses,
            is_read_only,
            broken: None,
            reach: None,
            told_bytes: 0,
            over_limit: None,
            paging_secs: 0.0,
        }
    }

    /// The store's file.
    pub fn path(&self) -> &Path {
        self.pager.path()
    }

    /// What the map was made with.
    pub fn config(&self) -> &MapConfig {
        self.map.config()
    }

    /// The voxel grid.
    pub fn grid(&self) -> Grid {
        self.map.grid()
    }

    /// How many scans were fused so far ([`VoxelMap::integrations`]).
    pub fn integrations(&self) -> u32 {
        self.map.integrations()
    }

    /// Continues to count integrations from this number.
    pub fn set_integrations(&mut self, integrations: u32) {
        self.map.set_integrations(integrations);
    }

    /// The poses of the scans that were fused, as [`PagedMap::add_poses`] was told them.
    pub fn poses(&self) -> &[FusedPose] {
        &self.poses
    }

    /// Adds the poses of scans that were fused. Like the map, they are stored with the next [`PagedMap::commit`].
    pub fn add_poses(&mut self, poses: &[FusedPose]) {
        self.poses.extend_from_slice(poses);
    }

    /// The regions of the whole map, sorted.
    pub fn regions(&self) -> Vec<RegionIndex> {
        self.pager.regions()
    }

    /// How much the whole map contains, as of the last commit.
    pub fn sizes(&self) -> Sizes {
        self.pager.sizes()
    }

    /// The part of the map that is in memory.
    pub fn map_in_memory(&self) -> &VoxelMap {
        &self.map
    }

    /// Memory used by blocks and their table, in bytes.
    pub fn memory_bytes(&self) -> usize {
        self.map.memory_bytes()
    }

    /// The highest memory use so far, in bytes.
    pub fn most_bytes(&self) -> usize {
        self.pager.most_bytes()
    }

    /// The memory limit, in bytes.
    pub fn limit_bytes(&self) -> Option<usize> {
        self.pager.limit_bytes()
    }

    /// Changes the memory limit. It applies from the next scan on.
    pub fn set_limit(&mut self, limit_bytes: Option<usize>) {
        self.pager.set_limit(limit_bytes);
        self.told_bytes = 0;
    }

    /// Returns an event when memory use has exceeded the limit for the first time, and whenever it has grown by more
    /// than a quarter since the last event. Each event is returned once.
    pub fn over_limit(&mut self) -> Option<OverLimit> {
        let event = self.over_limit.take()?;
        self.told_bytes = event.bytes;
        Some(event)
    }

    /// The size of the file, in bytes.
    pub fn store_bytes(&self) -> u64 {
        std::fs::metadata(self.path()).map_or(0, |file| file.len())
    }

    /// Seconds spent so far on loading and evicting regions, without commits.
    pub fn paging_secs(&self) -> f64 {
        self.paging_secs
    }

    /// Fuses a scan: loads the regions within its reach, fuses it, and evicts other regions if memory use exceeds the
    /// limit.
    ///
    /// # Errors
    /// [`PagedError::Fuse`] leaves the map as it was. After [`PagedError::Store`] nothing more can be fused.
    pub fn integrate(&mut self, integrator: &mut dyn Integrator, scan: &Scan) -> Result<Integration, PagedError> {
        self.check_writable()?;
        let reach = integrator.reach(self.config(), scan)?;
        self.paging(|map, pager| {
            let near = pager.within(map, &reach);
            pager.load(map, &near)
        })?;
        self.reach = Some(reach);
        let done = integrator.integrate(&mut self.map, scan);
        self.settle(done.as_ref().map_or(&[], |done| &done.updated_blocks))?;
        Ok(done?)
    }

    /// Ends a series of scans ([`Integrator::finish`]). A method that fuses collected scans only now needs all of the
    /// map in memory: a new store without a limit.
    ///
    /// # Errors
    /// [`StoreError::BeyondReach`] if the method changed regions that are not in memory.
    pub fn finish(&mut self, integrator: &mut dyn Integrator) -> Result<Integration, PagedError> {
        self.check_writable()?;
        let done = integrator.finish(&mut self.map)?;
        self.settle(&done.updated_blocks)?;
        Ok(done)
    }

    /// After a change: marks it dirty, and evicts regions if memory use exceeds the limit.
    fn settle(&mut self, updated_blocks: &[BlockIndex]) -> Result<()> {
        let (bytes, is_under) = self.paging(|map, pager| {
            pager.mark_dirty(map, updated_blocks)?;
            Ok((map.memory_bytes(), pager.evict(map)?))
        })?;
        let Some(limit_bytes) = self.limit_bytes() else {
            return Ok(());
        };
        let is_over = !is_under || is_much_more(bytes, limit_bytes);
        let waiting_bytes = self.over_limit.map_or(0, |event| event.bytes);
        if is_over && is_much_more(bytes, self.told_bytes) && bytes > waiting_bytes {
            self.over_limit = Some(OverLimit { bytes, limit_bytes });
        }
        Ok(())
    }

    /// Begins to load the regions that a scan like the last one would touch from another position of the sensor, without
    /// waiting for them.
    ///
    /// # Errors
    /// [`StoreError::File`] and [`StoreError::Region`].
    pub fn prefetch(&mut self, position: DVec3) -> Result<()> {
        let Some(reach) = self.reach.as_ref().map(|reach| reach.at(position)) else {
            return Ok(());
        };
        self.paging(|map, pager| {
            let near = pager.within(map, &reach);
            pager.prefetch(&near)
        })
    }

    /// Adds blocks from elsewhere, such as a map file, and returns how many there were. This is fastest region by
    /// region.
    ///
    /// # Errors
    /// [`StoreError::Map`] if a block exists already or is not valid. The blocks before it have been added.
    pub fn put_blocks(&mut self, blocks: impl IntoIterator<Item = (BlockIndex, Block)>) -> Result<usize> {
        let mut count = 0;
        for (index, block) in blocks {
            self.put_block(index, block)?;
            count += 1;
        }
        Ok(count)
    }

    /// Adds one block; see [`PagedMap::put_blocks`].
    ///
    /// # Errors
    /// As [`PagedMap::put_blocks`].
    pub fn put_block(&mut self, index: BlockIndex, block: Block) -> Result<()> {
        self.check_writable()?;
        self.paging(|map, pager| {
            // Free as long as blocks come region by region.
            pager.load_next(map, RegionIndex::of(index))?;
            map.insert_block(index, block).map_err(|reason| StoreError::Map {
                path: pager.path().to_owned(),
                reason,
            })?;
            pager.mark_dirty(map, &[index])
        })
    }

    /// Writes everything that has changed, together with `checkpoint`; this is what [`PagedMap::open`] finds from now
    /// on. The checkpoint is opaque to the store: the number of the last scan, for instance. Once this returns, the
    /// commit survives a crash.
    ///
    /// # Errors
    /// [`StoreError::File`]. The file keeps the previous commit.
    pub fn commit(&mut self, checkpoint: &[u8]) -> Result<()> {
        self.check_writable()?;
        let poses = std::mem::take(&mut self.poses);
        let done = self.with_pager(|map, pager| pager.commit(map, checkpoint, &poses));
        self.poses = poses;
        done
    }

    /// Visits the regions of the whole map, sorted, each while it is in memory.
    ///
    /// # Errors
    /// [`StoreError::File`] and [`StoreError::Region`], and what `visit` returns.
    pub fn for_each_region<E: From<StoreError>>(
        &mut self,
        mut visit: impl FnMut(&VoxelMap, RegionIndex) -> Result<(), E>,
    ) -> Result<(), E> {
        for region in self.pager.regions() {
            self.load_regions(&[region])?;
            visit(&self.map, region)?;
        }
        Ok(())
    }

    /// The surface of the whole map, cube by cube. Memory use stays within the limit.
    pub fn surface(&mut self, config: &MeshConfig) -> Surface<'_> {
        Surface::new(self, config)
    }

    /// Sends the surface of the whole map to `sink` as one mesh ([`stitch`]). Memory use stays within the limit.
    ///
    /// # Errors
    /// [`StoreError::File`] and [`StoreError::Region`]; [`StoreError::Sink`] if `sink` fails or there are more than 2³²
    /// vertices.
    pub fn mesh(&mut self, config: &MeshConfig, sink: &mut impl MeshSink) -> Result<()> {
        stitch(&mut self.surface(config), sink).map_err(StoreError::from_io)
    }

    /// Saves the whole map as a map file ([`tsdfuse_io::map_file`]). Memory use stays within the limit.
    ///
    /// # Errors
    /// [`StoreError::File`] and [`StoreError::Region`]; [`StoreError::Save`] names the map file.
    pub fn save(&mut self, path: impl AsRef<Path>) -> Result<()> {
        let mut failed = None;
        let written = atomic::write(path, |out| {
            let mut writer = Writer::with_poses(out, self.config(), self.integrations(), &self.poses)?;
            let blocks = self.for_each_region(|map, region| {
                let mut blocks = map.blocks_of(region);
                Ok(blocks.try_for_each(|(index, block)| writer.block(index, block))?)
            });
            blocks.map_err(|error| match error {
                StoreError::Sink(error) => error,
                error => {
                    failed = Some(error);
                    io::ErrorKind::Other.into()
                }
            })?;
            writer.finish().map(drop)
        });
        match failed {
            Some(error) => Err(error),
            None => Ok(written?),
        }
    }

    /// Loads some regions, and evicts others if memory use exceeds the limit.
    fn load_regions(&mut self, regions: &[RegionIndex]) -> Result<()> {
        self.paging(|map, pager| {
            pager.load(map, regions)?;
            pager.evict(map).map(drop)
        })
    }

    fn check_writable(&self) -> Result<()> {
        if self.is_read_only {
            return Err(StoreError::ReadOnly {
                path: self.path().to_owned(),
            });
        }
        Ok(())
    }

    /// As [`PagedMap::with_pager`]; the time counts as paging.
    fn paging<T>(&mut self, act: impl FnOnce(&mut VoxelMap, &mut Pager) -> Result<T>) -> Result<T> {
        let start = Instant::now();
        let done = self.with_pager(act);
        self.paging_secs += start.elapsed().as_secs_f64();
        done
    }

    /// Runs an operation that can break the map, unless the map is broken already.
    fn with_pager<T>(&mut self, act: impl FnOnce(&mut VoxelMap, &mut Pager) -> Result<T>) -> Result<T> {
        if let Some(cause) = &self.broken {
            return Err(StoreError::Broken { cause: cause.clone() });
        }
        let done = act(&mut self.map, &mut self.pager);
        if let Err(error) = &done
            && error.is_final()
        {
            self.broken = Some(error.to_string());
        }
        done
    }
}

impl RegionSource for &mut PagedMap {
    fn map(&self) -> &VoxelMap {
        &self.map
    }

    fn regions(&self) -> Vec<RegionIndex> {
        self.pager.regions()
    }

    fn load(&mut self, regions: &[RegionIndex]) -> io::Result<bool> {
        self.load_regions(regions).map_err(io::Error::other)?;
        Ok(true)
    }
}
