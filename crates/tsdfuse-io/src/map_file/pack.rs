//! Blocks as bytes, to keep them elsewhere than in a map file, in the same form as its groups.

use std::io::{self, Error, ErrorKind};

use lz4_flex::block::compress;
use tsdfuse::index::BlockIndex;
use tsdfuse::map::{Block, MapError};

use super::format::{BLOCK, GROUP, GROUP_MARK, GroupHeader, Wrong, array, block_of, push_block, wrong};

/// Compresses blocks, with checksums.
pub fn pack<'a>(blocks: impl IntoIterator<Item = (BlockIndex, &'a Block)>) -> Vec<u8> {
    let mut blocks = blocks.into_iter().peekable();
    let (mut packed, mut plain, mut number) = (Vec::new(), Vec::new(), 0);
    while blocks.peek().is_some() {
        plain.clear();
        for (index, block) in blocks.by_ref().take(GROUP) {
            push_block(index, block, &mut plain);
        }
        let group = compress(&plain);
        packed.extend(GroupHeader::bytes(number, plain.len() / BLOCK, &group));
        packed.extend(group);
        number += 1;
    }
    packed
}

/// Hands out blocks that were packed.
///
/// # Errors
/// `InvalidData` says what is wrong with the bytes, or why `take` refused a block; `OutOfMemory` if there is no memory for it.
pub fn unpack(mut packed: &[u8], mut take: impl FnMut(BlockIndex, Block) -> Result<(), MapError>) -> io::Result<()> {
    let mut plain = Vec::new();
    while !packed.is_empty() {
        group(&mut packed, &mut plain, &mut take).map_err(|e| match e {
            Wrong::System(e) if e.kind() == ErrorKind::OutOfMemory => e,
            Wrong::System(e) => Error::new(ErrorKind::InvalidData, e),
            Wrong::Reason(reason) => Error::new(ErrorKind::InvalidData, reason),
        })?;
    }
    Ok(())
}

fn group(
    packed: &mut &[u8],
    plain: &mut Vec<u8>,
    take: &mut impl FnMut(BlockIndex, Block) -> Result<(), MapError>,
) -> Result<(), Wrong> {
    if array(packed)? != GROUP_MARK {
        return wrong("no blocks begin there");
    }
    let header = GroupHeader::read(packed)?;
    let Some((bytes, rest)) = packed.split_at_checked(header.length) else {
        return wrong("they end early");
    };
    *packed = rest;
    header.unpack(bytes, plain)?;
    for block in plain.chunks_exact(BLOCK) {
        let (index, block) = block_of(block)?;
        take(index, block)?;
    }
    Ok(())
}
