//! Writes a map block by block.

use std::io::{self, Error, ErrorKind, Write};

use tsdfuse::MapConfig;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::Block;

use super::format::{GROUP, HEADER, Header, VERSION, checksum, end_bytes};
use super::fused::{FusedPose, pack_poses};
use super::group;
use super::layout::Planes;

/// Writes blocks as they come, which must be region by region and sorted within each. Holds one group at a time.
#[derive(Debug)]
pub struct Writer<W> {
    out: W,
    header: [u8; HEADER],
    group: Planes,
    packed: Vec<u8>,
    last: Option<(RegionIndex, BlockIndex)>,
    blocks: u64,
    groups: u32,
}

impl<W: Write> Writer<W> {
    /// Begins a map.
    ///
    /// # Errors
    /// What the system says.
    pub fn new(out: W, config: &MapConfig, integrations: u32) -> io::Result<Self> {
        Self::with_poses(out, config, integrations, &[])
    }

    /// Begins a map of scans with these poses, in the order in which they were fused.
    ///
    /// # Errors
    /// What the system says; `InvalidInput` for 2³² poses or more.
    pub fn with_poses(mut out: W, config: &MapConfig, integrations: u32, poses: &[FusedPose]) -> io::Result<Self> {
        let header = Header::bytes(VERSION, config, integrations);
        out.write_all(&header)?;
        out.write_all(&checksum(&[&header]).to_le_bytes())?;
        out.write_all(&pack_poses(poses)?)?;
        Ok(Self {
            out,
            header,
            group: Planes::default(),
            packed: Vec::new(),
            last: None,
            blocks: 0,
            groups: 0,
        })
    }

    /// Adds a block. It must follow the one before it: in a later region, or later in the same region.
    ///
    /// # Errors
    /// What the system says; `InvalidInput` if it is out of order.
    pub fn block(&mut self, index: BlockIndex, block: &Block) -> io::Result<()> {
        let place = Some((RegionIndex::of(index), index));
        if self.last >= place {
            let reason = format!("block {:?} is not in order", index.0.to_array());
            return Err(Error::new(ErrorKind::InvalidInput, reason));
        }
        self.last = place;
        self.group.push(index, block);
        self.blocks += 1;
        if self.group.count() == GROUP {
            self.write_group()?;
        }
        Ok(())
    }

    /// Writes the blocks that wait.
    fn write_group(&mut self) -> io::Result<()> {
        self.packed.clear();
        group::push(self.groups, &mut self.group, &mut self.packed);
        self.out.write_all(&self.packed)?;
        self.groups += 1;
        Ok(())
    }

    /// Ends the map. Without this, the file is incomplete and readers refuse it.
    ///
    /// # Errors
    /// What the system says.
    pub fn finish(mut self) -> io::Result<W> {
        if self.group.count() > 0 {
            self.write_group()?;
        }
        self.out.write_all(&end_bytes(&self.header, self.blocks))?;
        Ok(self.out)
    }
}
