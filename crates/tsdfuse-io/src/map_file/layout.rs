//! The blocks of a group as bytes, before they are compressed.

use std::io;

use lz4_flex::block::{compress, decompress_into, get_maximum_output_size};
use tsdfuse::glam::IVec3;
use tsdfuse::index::{BLOCK_VOXELS, BlockIndex};
use tsdfuse::map::{Block, Voxel};

use super::format::{Wrong, array, wrong};

/// Bytes of a block's coordinates.
const PLACE: usize = 12;
/// Bytes with a bit for each voxel of a block.
const MASK: usize = BLOCK_VOXELS / 8;
/// Bytes of a block in [`Layout::Blocks`]: its coordinates, then two sums for each voxel.
pub(super) const BLOCK: usize = PLACE + 8 * BLOCK_VOXELS;
/// The most bytes of a block in [`Layout::Planes`].
const MOST: usize = BLOCK + MASK;

/// How the blocks of a group are laid out; its mark says which.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Layout {
    /// One block after another, with all voxels: versions 1 to 3.
    Blocks,
    /// All coordinates, then which voxels were observed, then the sums of these, byte by byte: first the lowest bytes of all weights,
    /// at last the highest ones of all distances. High bytes are nearly all the same, so LZ4 has half as much left.
    Planes,
}

impl Layout {
    /// Of the group that begins with this mark.
    pub(super) fn of(mark: &[u8]) -> Option<Self> {
        [Self::Blocks, Self::Planes]
            .into_iter()
            .find(|layout| layout.mark() == mark)
    }

    /// The first bytes of a group.
    pub(super) fn mark(self) -> &'static [u8; 8] {
        match self {
            Self::Blocks => b"TSDFGRP\n",
            Self::Planes => b"TSDFPLN\n",
        }
    }

    /// Bytes that so many blocks take at most.
    fn most(self, blocks: usize) -> usize {
        match self {
            Self::Blocks => blocks * BLOCK,
            Self::Planes => blocks * MOST,
        }
    }

    /// Refuses more compressed bytes than this number of blocks can take.
    pub(super) fn check_length(self, length: usize, blocks: usize) -> Result<(), Wrong> {
        if length > get_maximum_output_size(self.most(blocks)) {
            return wrong(format!("{length} bytes are more than its blocks can take"));
        }
        Ok(())
    }

    /// Decompresses a group of blocks and hands them out; `plain` is scratch space.
    pub(super) fn unpack(
        self,
        packed: &[u8],
        blocks: usize,
        plain: &mut Vec<u8>,
        mut take: impl FnMut(BlockIndex, Block) -> Result<(), Wrong>,
    ) -> Result<(), Wrong> {
        plain.resize(self.most(blocks), 0);
        let length = decompress_into(packed, plain).or_else(|e| wrong(e.to_string()))?;
        let plain = plain.get(..length).unwrap_or_default();
        match self {
            Self::Blocks if length == blocks * BLOCK => {
                let mut blocks = plain.chunks_exact(BLOCK);
                blocks.try_for_each(|block| {
                    let (index, block) = block_of(block)?;
                    take(index, block)
                })
            }
            Self::Blocks => wrong(format!("{length} bytes instead of {}", blocks * BLOCK)),
            Self::Planes => planes(plain, blocks, take),
        }
    }
}

/// Hands out the blocks of [`Layout::Planes`].
fn planes(
    plain: &[u8],
    blocks: usize,
    mut take: impl FnMut(BlockIndex, Block) -> Result<(), Wrong>,
) -> Result<(), Wrong> {
    let (places, rest) = plain.split_at_checked(blocks * PLACE).unwrap_or_default();
    let (masks, bytes) = rest.split_at_checked(blocks * MASK).unwrap_or_default();
    let masks = masks.as_chunks::<8>().0.iter().map(|&word| u64::from_le_bytes(word));
    let masks: Vec<u64> = masks.collect();
    let voxels = masks.iter().map(|word| word.count_ones() as usize).sum::<usize>();
    if plain.len() != blocks * (PLACE + MASK) + 8 * voxels {
        return wrong(format!("{} bytes do not fit its blocks", plain.len()));
    }
    let (weights, distances) = bytes.split_at(4 * voxels);
    let mut voxels = whole(weights).zip(whole(distances));
    let words = BLOCK_VOXELS / u64::BITS as usize;
    for (place, words) in places.chunks_exact(PLACE).zip(masks.chunks_exact(words)) {
        let mut block = Block::EMPTY;
        for (part, &word) in block.voxels.chunks_exact_mut(u64::BITS as usize).zip(words) {
            for at in ones(word) {
                if let Some((weight_sum, folded)) = voxels.next() {
                    part[at] = Voxel {
                        weight_sum,
                        distance_sum: unfold(folded),
                    };
                }
            }
        }
        take(index_of(place)?, block)?;
    }
    Ok(())
}

/// The numbers of four planes.
fn whole(planes: &[u8]) -> impl Iterator<Item = u32> {
    let (low, high) = planes.split_at(planes.len() / 2);
    let [(a, b), (c, d)] = [low, high].map(|half| half.split_at(half.len() / 2));
    let bytes = a.iter().zip(b).zip(c.iter().zip(d));
    bytes.map(|((&a, &b), (&c, &d))| u32::from_le_bytes([a, b, c, d]))
}

/// The places of the ones of a word, from the lowest on.
fn ones(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let at = (word != 0).then(|| word.trailing_zeros() as usize);
        word &= word.wrapping_sub(1);
        at
    })
}

/// 0, −1, 1, −2, ... as 0, 1, 2, 3, ...: small numbers of both signs have zeros as their high bytes.
fn fold(number: i32) -> u32 {
    (number << 1 ^ number >> 31) as u32
}

fn unfold(folded: u32) -> i32 {
    (folded >> 1) as i32 ^ -((folded & 1) as i32)
}

/// Collects the blocks of a group and compresses them, by planes.
#[derive(Debug, Default)]
pub(super) struct Planes {
    places: Vec<u8>,
    masks: Vec<u8>,
    weights: Vec<u32>,
    distances: Vec<u32>,
    plain: Vec<u8>,
}

impl Planes {
    /// Adds a block.
    pub(super) fn push(&mut self, index: BlockIndex, block: &Block) {
        for coordinate in index.0.to_array() {
            self.places.extend(coordinate.to_le_bytes());
        }
        for part in block.voxels.chunks_exact(u64::BITS as usize) {
            let bits = (0..).zip(part).map(|(at, voxel)| u64::from(voxel.weight_sum > 0) << at);
            let mask = bits.fold(0, |mask, bit| mask | bit);
            self.masks.extend(mask.to_le_bytes());
            self.weights.extend(ones(mask).map(|at| part[at].weight_sum));
            self.distances.extend(ones(mask).map(|at| fold(part[at].distance_sum)));
        }
    }

    /// How many blocks there are.
    pub(super) fn count(&self) -> usize {
        self.places.len() / PLACE
    }

    /// Compresses all blocks and forgets them.
    pub(super) fn compress(&mut self) -> Vec<u8> {
        self.plain.clear();
        self.plain.append(&mut self.places);
        self.plain.append(&mut self.masks);
        for sums in [&mut self.weights, &mut self.distances] {
            for shift in [0, 8, 16, 24] {
                self.plain.extend(sums.iter().map(|sum| (sum >> shift) as u8));
            }
            sums.clear();
        }
        compress(&self.plain)
    }
}

fn index_of(mut bytes: &[u8]) -> io::Result<BlockIndex> {
    let mut coordinate = || array(&mut bytes).map(i32::from_le_bytes);
    Ok(BlockIndex(IVec3::new(coordinate()?, coordinate()?, coordinate()?)))
}

/// Parses a block of [`Layout::Blocks`].
fn block_of(bytes: &[u8]) -> io::Result<(BlockIndex, Block)> {
    let (place, sums) = bytes.split_at_checked(PLACE).unwrap_or_default();
    let mut block = Block::EMPTY;
    let (sums, _) = sums.as_chunks::<4>();
    let (sums, _) = sums.as_chunks::<2>();
    for (voxel, &[weight, distance]) in block.voxels.iter_mut().zip(sums) {
        *voxel = Voxel {
            weight_sum: u32::from_le_bytes(weight),
            distance_sum: i32::from_le_bytes(distance),
        };
    }
    Ok((index_of(place)?, block))
}

/// The bytes of a block in [`Layout::Blocks`].
#[cfg(test)]
pub(super) fn push_block(index: BlockIndex, block: &Block, plain: &mut Vec<u8>) {
    index.0.to_array().iter().for_each(|c| plain.extend(c.to_le_bytes()));
    for voxel in &block.voxels {
        plain.extend(voxel.weight_sum.to_le_bytes());
        plain.extend(voxel.distance_sum.to_le_bytes());
    }
}
