//! Writes a map block by block.

use std::io::{self, Error, ErrorKind, Write};

use lz4_flex::block::{compress_into, get_maximum_output_size};
use tsdfuse::MapConfig;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::Block;

use super::format::{
    BLOCK, GROUP, GroupHeader, HEADER, Header, VERSION, WITHOUT_POSES, checksum, end_bytes, push_block,
};
use super::fused::{FusedPose, pack_poses};

/// Writes blocks as they come, which must be region by region and sorted within each. Holds one group at a time.
#[derive(Debug)]
pub struct Writer<W> {
    out: W,
    header: [u8; HEADER],
    plain: Vec<u8>,
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
        let version = if poses.is_empty() { WITHOUT_POSES } else { VERSION };
        let header = Header::bytes(version, config, integrations);
        out.write_all(&header)?;
        out.write_all(&checksum(&[&header]).to_le_bytes())?;
        if !poses.is_empty() {
            out.write_all(&pack_poses(poses)?)?;
        }
        Ok(Self {
            out,
            header,
            plain: Vec::with_capacity(GROUP * BLOCK),
            packed: vec![0; get_maximum_output_size(GROUP * BLOCK)],
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
        push_block(index, block, &mut self.plain);
        self.blocks += 1;
        if self.plain.len() == GROUP * BLOCK {
            self.group()?;
        }
        Ok(())
    }

    /// Writes the blocks that wait.
    fn group(&mut self) -> io::Result<()> {
        let length = compress_into(&self.plain, &mut self.packed).map_err(Error::other)?;
        let packed = self.packed.get(..length).unwrap_or_default();
        let header = GroupHeader::bytes(self.groups, self.plain.len() / BLOCK, packed);
        self.out.write_all(&header)?;
        self.out.write_all(packed)?;
        self.groups += 1;
        self.plain.clear();
        Ok(())
    }

    /// Ends the map. Without this, the file is incomplete and readers refuse it.
    ///
    /// # Errors
    /// What the system says.
    pub fn finish(mut self) -> io::Result<W> {
        if !self.plain.is_empty() {
            self.group()?;
        }
        self.out.write_all(&end_bytes(&self.header, self.blocks))?;
        Ok(self.out)
    }
}
