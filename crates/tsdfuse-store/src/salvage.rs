//! Recovering the intact regions of a damaged store.

use std::path::{Path, PathBuf};

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::{Block, BlockPool};
use tsdfuse::{MapConfig, VoxelMap};
use tsdfuse_io::atomic;
use tsdfuse_io::map_file::{FusedPose, Writer};

use crate::disk::Disk;
use crate::error::{Result, StoreError};
use crate::file::{header, read_index, read_region};
use crate::format::{Extent, INDEX_HEADER, Index, PAGE, REGION_HEADER, REGION_MARK, RegionHeader, Row};

/// The intact regions of a damaged store.
///
/// As long as one copy of the index is intact, the result is the last commit without the lost regions, and the lost
/// regions are known. Without an index, the file is searched for regions, and the newest intact version of each is
/// used; some may be older or newer than the last commit.
#[derive(Debug)]
pub struct Salvage {
    path: PathBuf,
    disk: Disk,
    /// Regions that are read take their memory from it.
    pool: BlockPool,
    config: MapConfig,
    integrations: u32,
    checkpoint: Option<Vec<u8>>,
    poses: Vec<FusedPose>,
    regions: Vec<Row>,
    damage: Damage,
}

/// What is wrong with a store.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Damage {
    /// A sentence for each part that is damaged.
    pub places: Vec<String>,
    /// The lost regions, sorted, and how many blocks they had. `None` if the index is lost, so that nobody knows.
    pub lost: Option<(Vec<RegionIndex>, u64)>,
}

/// The result of searching the whole file.
#[derive(Default)]
struct Found {
    index: Option<Index>,
    /// The newest version of each region, and the number of its commit.
    regions: HashMap<RegionIndex, (u64, Row), FxBuildHasher>,
}

impl Salvage {
    /// Reads a whole store and finds the regions that are intact.
    ///
    /// # Errors
    /// [`StoreError::File`] if the file cannot be read, [`StoreError::Damaged`] if neither its header nor its index is
    /// intact, or if it is not a store.
    pub fn scan(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let wrong = StoreError::file(path);
        let disk = Disk::open(path, false).map_err(&wrong)?;
        let damaged = |reason: String| StoreError::Damaged {
            path: path.to_owned(),
            reason,
        };
        let pool = BlockPool::default();
        let mut damage = Damage::default();
        let header = header(&disk);
        if let Err(reason) = &header {
            damage.places.push(reason.clone());
        }
        let index = header.as_ref().ok().map(|(header, _)| read_index(&disk, header));
        if let Some(Err(reason)) = &index {
            damage.places.push(format!("its index: {reason}"));
        }
        let index = match index {
            Some(Ok(index)) => Ok(index),
            _ => {
                let found = Found::search(&disk, &pool).map_err(&wrong)?;
                let newest = header.as_ref().ok().map(|(header, _)| header.sequence);
                found.newest_index(newest)
            }
        };
        let mut salvage = match (index, header) {
            (Ok(index), _) => Self {
                path: path.to_owned(),
                disk,
                pool,
                config: index.state.config,
                integrations: index.state.integrations,
                checkpoint: Some(index.state.checkpoint),
                poses: index.state.poses,
                regions: index.regions,
                damage: Damage {
                    lost: Some((Vec::new(), 0)),
                    ..damage
                },
            },
            (Err(regions), Ok((header, _))) => Self {
                path: path.to_owned(),
                disk,
                pool,
                config: header.config,
                integrations: header.integrations,
                checkpoint: None,
                poses: Vec::new(),
                regions,
                damage: Damage {
                    places: [damage.places, vec!["the trajectory is lost".to_owned()]].concat(),
                    ..damage
                },
            },
            (Err(_), Err(reason)) => return Err(damaged(reason)),
        };
        salvage.drop_damaged();
        Ok(salvage)
    }

    /// Removes the regions that cannot be read, and records them.
    fn drop_damaged(&mut self) {
        let Self {
            disk,
            pool,
            regions,
            damage,
            ..
        } = self;
        regions.retain(|row| {
            let Err(reason) = read_region(disk, row, pool) else {
                return true;
            };
            let index = row.index;
            damage.places.push(format!("region {:?}: {reason}", index.0.to_array()));
            if let Some((regions, blocks)) = &mut damage.lost {
                regions.push(index);
                *blocks += row.sizes.blocks;
            }
            false
        });
    }

    /// What the map was made with.
    pub fn config(&self) -> &MapConfig {
        &self.config
    }

    /// How many scans were fused before the last commit.
    pub fn integrations(&self) -> u32 {
        self.integrations
    }

    /// The checkpoint of the last commit; `None` if it is lost.
    pub fn checkpoint(&self) -> Option<&[u8]> {
        self.checkpoint.as_deref()
    }

    /// The poses of the scans that were fused before the last commit; none if they are lost.
    pub fn poses(&self) -> &[FusedPose] {
        &self.poses
    }

    /// What is damaged and what is lost.
    pub fn damage(&self) -> &Damage {
        &self.damage
    }

    /// The intact regions, sorted.
    pub fn regions(&self) -> impl Iterator<Item = RegionIndex> {
        self.regions.iter().map(|row| row.index)
    }

    /// Visits the blocks of each intact region: sorted, region by region. Holds one region in memory at a time.
    ///
    /// # Errors
    /// [`StoreError::Region`] if the file has changed since [`Salvage::scan`], and what `visit` returns.
    pub fn for_each_block<E: From<StoreError>>(
        &self,
        mut visit: impl FnMut(BlockIndex, &Block) -> Result<(), E>,
    ) -> Result<(), E> {
        for row in &self.regions {
            let region = read_region(&self.disk, row, &self.pool).map_err(|reason| StoreError::Region {
                path: self.path.clone(),
                region: row.index,
                reason,
            })?;
            let mut blocks: Vec<_> = region.blocks().collect();
            blocks.sort_unstable_by_key(|(index, _)| *index);
            blocks.into_iter().try_for_each(|(index, block)| visit(index, block))?;
        }
        Ok(())
    }

    /// All intact regions as a map in memory.
    ///
    /// # Errors
    /// As [`Salvage::for_each_block`]; [`StoreError::Map`] if the blocks do not make a map.
    pub fn map(&self) -> Result<VoxelMap> {
        let wrong = |reason| StoreError::Map {
            path: self.path.clone(),
            reason,
        };
        let mut map = VoxelMap::new(self.config).map_err(wrong)?;
        map.set_integrations(self.integrations);
        self.for_each_block(|index, block| map.insert_block(index, block.clone()).map_err(wrong))?;
        Ok(map)
    }

    /// Saves all intact regions as a map file ([`tsdfuse_io::map_file`]), also if they are larger than memory.
    ///
    /// # Errors
    /// As [`Salvage::for_each_block`]; [`StoreError::Save`] names the map file.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let written = atomic::write(path, |out| {
            let mut writer = Writer::with_poses(out, &self.config, self.integrations, &self.poses)?;
            let blocks = self.for_each_block(|index, block| Ok::<_, StoreError>(writer.block(index, block)?));
            blocks.map_err(|error| match error {
                StoreError::Sink(error) => error,
                error => std::io::Error::other(error),
            })?;
            writer.finish().map(drop)
        });
        Ok(written?)
    }
}

impl Found {
    /// Looks at the beginning of every page.
    fn search(disk: &Disk, pool: &BlockPool) -> std::io::Result<Self> {
        let mut found = Self::default();
        let pages = disk.length()?.div_ceil(PAGE);
        for offset in (0..pages).map(|page| page * PAGE) {
            let mut start = [0; INDEX_HEADER];
            let read = disk.read_exact(offset, &mut start);
            if read.is_err() {
                continue;
            }
            // Damaged records are skipped.
            if Index::begins(&start) {
                let _ = found.try_index(disk, offset, &start);
            } else if start.starts_with(&REGION_MARK) {
                let _ = found.try_region(disk, offset, &start, pool);
            }
        }
        Ok(found)
    }

    fn try_index(&mut self, disk: &Disk, offset: u64, start: &[u8]) -> Result<(), String> {
        let length = Index::length(start)?;
        let index = Index::parse(&disk.read(Extent { offset, length })?)?;
        if self.index.as_ref().is_none_or(|known| known.sequence < index.sequence) {
            self.index = Some(index);
        }
        Ok(())
    }

    fn try_region(&mut self, disk: &Disk, offset: u64, start: &[u8], pool: &BlockPool) -> Result<(), String> {
        let header = RegionHeader::parse(start)?;
        if self
            .regions
            .get(&header.index)
            .is_some_and(|(known, _)| *known > header.sequence)
        {
            return Ok(());
        }
        let length = REGION_HEADER as u64 + u64::from(header.length);
        let row = Row {
            index: header.index,
            sizes: header.sizes,
            extent: Extent { offset, length },
        };
        read_region(disk, &row, pool)?;
        self.regions.insert(header.index, (header.sequence, row));
        Ok(())
    }

    /// The index of the last commit, or else the newest regions, sorted.
    fn newest_index(self, sequence: Option<u64>) -> Result<Index, Vec<Row>> {
        let newest = self.regions.values().map(|(sequence, _)| *sequence).max();
        // Regions written after the last commit carry the number of the next one.
        let sequence = sequence.or(newest.map(|newest| newest.saturating_sub(1)));
        match self.index {
            Some(index) if sequence.is_none_or(|sequence| index.sequence >= sequence) => Ok(index),
            _ => {
                let mut rows: Vec<Row> = self.regions.into_values().map(|(_, row)| row).collect();
                rows.sort_unstable_by_key(|row| row.index);
                Err(rows)
            }
        }
    }
}
