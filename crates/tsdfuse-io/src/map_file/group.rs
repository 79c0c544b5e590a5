//! Groups of blocks: a header with checksums, then the compressed blocks.

use std::io::Read;

use tsdfuse::index::BlockIndex;
use tsdfuse::map::Block;

use super::format::{CHANGED, GROUP, GROUP_HEADER, Wrong, array, checksum, wrong};
use super::layout::{Layout, Planes};

/// Appends the blocks that were collected as a group, and forgets them.
pub(super) fn push(number: u32, blocks: &mut Planes, out: &mut Vec<u8>) {
    let count = blocks.count();
    let packed = blocks.compress();
    out.extend(GroupHeader::bytes(Layout::Planes, number, count, &packed));
    out.extend(packed);
}

/// What precedes the blocks of a group (from version 2 on).
pub(super) struct GroupHeader {
    layout: Layout,
    pub(super) number: u32,
    pub(super) blocks: usize,
    pub(super) length: usize,
    checksum: u32,
}

impl GroupHeader {
    /// The bytes, their checksum included.
    pub(super) fn bytes(layout: Layout, number: u32, blocks: usize, packed: &[u8]) -> Vec<u8> {
        let mut bytes = layout.mark().to_vec();
        for field in [number, blocks as u32, packed.len() as u32, checksum(&[packed])] {
            bytes.extend(field.to_le_bytes());
        }
        bytes.extend(checksum(&[&bytes]).to_le_bytes());
        bytes
    }

    /// Reads what follows the mark of such a group.
    pub(super) fn read(layout: Layout, bytes: &mut impl Read) -> Result<Self, Wrong> {
        let fields: [u8; GROUP_HEADER - 8] = array(bytes)?;
        if u32::from_le_bytes(array(bytes)?) != checksum(&[layout.mark(), &fields]) {
            return wrong(CHANGED);
        }
        let mut fields = fields.as_slice();
        let mut field = || array(&mut fields).map(u32::from_le_bytes);
        let header = Self {
            layout,
            number: field()?,
            blocks: field()? as usize,
            length: field()? as usize,
            checksum: field()?,
        };
        if !(1..=GROUP).contains(&header.blocks) {
            return wrong(format!("it has {} blocks; 1 to {GROUP} are possible", header.blocks));
        }
        layout.check_length(header.length, header.blocks)?;
        Ok(header)
    }

    /// Checks the compressed bytes of the group and hands out its blocks; `plain` is scratch space.
    pub(super) fn unpack(
        &self,
        packed: &[u8],
        plain: &mut Vec<u8>,
        take: impl FnMut(BlockIndex, Block) -> Result<(), Wrong>,
    ) -> Result<(), Wrong> {
        if checksum(&[packed]) != self.checksum {
            return wrong(CHANGED);
        }
        self.layout.unpack(packed, self.blocks, plain, take)
    }
}
