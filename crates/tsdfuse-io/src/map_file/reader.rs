//! Reads a map group by group.

use std::io::Read;
use std::path::{Path, PathBuf};

use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::{Block, MapError};
use tsdfuse::{MapConfig, VoxelMap};

use super::format::{CHANGED, END_MARK, GROUP, Header, Wrong, array, checksum, read_end, wrong};
use super::fused::{FusedPose, read_poses};
use super::group::GroupHeader;
use super::layout::Layout;
use crate::error::{Error, Result};

/// A saved map that is read group by group, so that at most one group is in memory, about 1 MiB, the poses of the scans, and what the
/// caller keeps. A group cannot claim more.
#[derive(Debug)]
pub struct Reader<R> {
    path: PathBuf,
    bytes: R,
    header: Header,
    poses: Vec<FusedPose>,
    groups: u64,
    blocks: u64,
    packed: Vec<u8>,
    plain: Vec<u8>,
}

impl<R: Read> Reader<R> {
    /// Reads the header and the poses of the scans; `path` is for messages.
    ///
    /// # Errors
    /// Names the file and what is wrong.
    pub fn new(path: impl AsRef<Path>, mut bytes: R) -> Result<Self> {
        let path = path.as_ref();
        let header = Header::read(&mut bytes).map_err(|e| e.at(path, "its header"))?;
        let poses = if header.has_poses() {
            read_poses(&mut bytes).map_err(|e| e.at(path, "its trajectory"))?
        } else {
            Vec::new()
        };
        Ok(Self {
            path: path.to_owned(),
            bytes,
            header,
            poses,
            groups: 0,
            blocks: 0,
            packed: Vec::new(),
            plain: Vec::new(),
        })
    }

    /// What the map was made with.
    pub fn config(&self) -> &MapConfig {
        &self.header.config
    }

    /// How many integrations made it; 0 if the file, of version 1, does not tell.
    pub fn integrations(&self) -> u32 {
        self.header.integrations
    }

    /// Whether the file tells how many integrations made it.
    pub fn tells_integrations(&self) -> bool {
        self.header.version > 1
    }

    /// The poses of the scans that made it, in the order in which they were fused; none if the file does not tell.
    pub fn poses(&self) -> &[FusedPose] {
        &self.poses
    }

    /// Hands out [`Reader::poses`]; it has none afterwards.
    pub fn take_poses(&mut self) -> Vec<FusedPose> {
        std::mem::take(&mut self.poses)
    }

    /// Reads all of it into a map.
    ///
    /// # Errors
    /// As [`Reader::for_each_block`].
    pub fn map(self) -> Result<VoxelMap> {
        let mut map = VoxelMap::new(self.header.config).map_err(|e| Error::format(&self.path, e.to_string()))?;
        map.set_integrations(self.header.integrations);
        self.for_each_block(|index, block| map.insert_block(index, block))?;
        Ok(map)
    }

    /// Hands out the blocks: region by region and sorted within each (version 1: sorted).
    ///
    /// # Errors
    /// Names the file and the group of blocks in which something is wrong, or a block of which `take` refused.
    pub fn for_each_block(mut self, mut take: impl FnMut(BlockIndex, Block) -> Result<(), MapError>) -> Result<()> {
        let (mut last, version) = (None, self.header.version);
        let mut in_order = |index: BlockIndex, block| {
            let place = match version {
                1 => (RegionIndex(tsdfuse::glam::IVec3::ZERO), index),
                _ => (RegionIndex::of(index), index),
            };
            if last.replace(place) >= Some(place) {
                return wrong(format!("block {:?} is not in order", index.0.to_array()));
            }
            Ok(take(index, block)?)
        };
        while self
            .next_group(&mut in_order)
            .map_err(|e| e.at(&self.path, &self.part()))?
        {
            self.groups += 1;
        }
        match self.bytes.read(&mut [0]).map_err(Error::io(&self.path))? {
            0 => Ok(()),
            _ => Err(Error::format(
                &self.path,
                format!("bytes follow the last of {} blocks", self.blocks),
            )),
        }
    }

    /// The part of the file that is read, for messages.
    fn part(&self) -> String {
        let group = self.groups + 1;
        match self.header.blocks {
            Some(count) => {
                let blocks = (count - (self.groups * GROUP as u64).min(count)).min(GROUP as u64);
                let groups = count.div_ceil(GROUP as u64);
                format!("group {group} of {groups} ({blocks} of {count} blocks)")
            }
            None => format!("group {group}"),
        }
    }

    /// Hands out the blocks of the next group; false after the last one.
    fn next_group(&mut self, take: impl FnMut(BlockIndex, Block) -> Result<(), Wrong>) -> Result<bool, Wrong> {
        match self.header.blocks {
            Some(count) => self.next_group_1(count, take),
            None => self.next_group_2(take),
        }
    }

    fn next_group_2(&mut self, take: impl FnMut(BlockIndex, Block) -> Result<(), Wrong>) -> Result<bool, Wrong> {
        let mark: [u8; 8] = array(&mut self.bytes)?;
        if mark == END_MARK {
            let (header, blocks) = read_end(&mut self.bytes)?;
            if (header, blocks) != (self.header, self.blocks) {
                return wrong(format!(
                    "the file ends after {} blocks; at its end it says that it has {blocks}, or has another header",
                    self.blocks
                ));
            }
            return Ok(false);
        }
        let Some(layout) = Layout::of(&mark) else {
            return wrong(CHANGED);
        };
        let group = GroupHeader::read(layout, &mut self.bytes)?;
        if u64::from(group.number) != self.groups {
            return wrong(format!(
                "it is group {}, so others are missing",
                u64::from(group.number) + 1
            ));
        }
        self.packed.resize(group.length, 0);
        self.bytes.read_exact(&mut self.packed)?;
        group.unpack(&self.packed, &mut self.plain, take)?;
        self.blocks += group.blocks as u64;
        Ok(true)
    }

    fn next_group_1(
        &mut self,
        count: u64,
        take: impl FnMut(BlockIndex, Block) -> Result<(), Wrong>,
    ) -> Result<bool, Wrong> {
        let blocks = (count - self.blocks).min(GROUP as u64) as usize;
        if blocks == 0 {
            return Ok(false);
        }
        let length: [u8; 4] = array(&mut self.bytes)?;
        let expected = u32::from_le_bytes(array(&mut self.bytes)?);
        let size = u32::from_le_bytes(length) as usize;
        Layout::Blocks.check_length(size, blocks)?;
        self.packed.resize(size, 0);
        self.bytes.read_exact(&mut self.packed)?;
        if checksum(&[&length, &self.packed]) != expected {
            return wrong(CHANGED);
        }
        Layout::Blocks.unpack(&self.packed, blocks, &mut self.plain, take)?;
        self.blocks += blocks as u64;
        Ok(true)
    }
}
