//! Blocks as bytes, to keep them elsewhere than in a map file, in the same form as its groups.

use std::io::{self, Error, ErrorKind};

use tsdfuse::index::BlockIndex;
use tsdfuse::map::{Block, MapError};

use super::format::{GROUP, Wrong, array, wrong};
use super::group::{self, GroupHeader};
use super::layout::{Layout, Planes};

/// Compresses blocks, with checksums.
pub fn pack<'a>(blocks: impl IntoIterator<Item = (BlockIndex, &'a Block)>) -> Vec<u8> {
    let (mut packed, mut group, mut number) = (Vec::new(), Planes::default(), 0);
    for (index, block) in blocks {
        group.push(index, block);
        if group.count() == GROUP {
            group::push(number, &mut group, &mut packed);
            number += 1;
        }
    }
    if group.count() > 0 {
        group::push(number, &mut group, &mut packed);
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
        next_group(&mut packed, &mut plain, &mut take).map_err(|e| match e {
            Wrong::System(e) if e.kind() == ErrorKind::OutOfMemory => e,
            Wrong::System(e) => Error::new(ErrorKind::InvalidData, e),
            Wrong::Reason(reason) => Error::new(ErrorKind::InvalidData, reason),
        })?;
    }
    Ok(())
}

fn next_group(
    packed: &mut &[u8],
    plain: &mut Vec<u8>,
    take: &mut impl FnMut(BlockIndex, Block) -> Result<(), MapError>,
) -> Result<(), Wrong> {
    let Some(layout) = Layout::of(&array::<8>(packed)?) else {
        return wrong("no blocks begin there");
    };
    let header = GroupHeader::read(layout, packed)?;
    let Some((bytes, rest)) = packed.split_at_checked(header.length) else {
        return wrong("they end early");
    };
    *packed = rest;
    header.unpack(bytes, plain, |index, block| Ok(take(index, block)?))
}
