//! How much of the map a scan changes: counted, not timed, by comparing the map before with the map after.

use rayon::prelude::*;
use serde::Serialize;
use tsdfuse::VoxelMap;
use tsdfuse::map::{Block, Voxel};
use tsdfuse_run::{Observer, Session};

use super::limits::LINE_BYTES;
use super::pieces::pieces;
use crate::error::{Error, Result};

/// Scans that are looked at; copies of the map are made for each.
const SAMPLES: usize = 12;

/// Voxels that share a cache line, were blocks to begin at one.
const ROW: usize = LINE_BYTES / size_of::<Voxel>();

/// What differs, on average of the scans that were looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Changes {
    /// Scans that were looked at.
    pub scans: usize,
    /// Voxels.
    pub voxels: f64,
    /// Rows of eight voxels, 64 bytes each.
    pub lines: f64,
    /// Blocks of 8³ voxels.
    pub blocks: f64,
}

impl Changes {
    /// Fuses all scans and looks at some of them. The map must be in memory.
    pub(crate) fn count(mut session: Session, scans: usize, observer: &mut dyn Observer) -> Result<Self> {
        let positions: Vec<usize> = (0..scans).collect();
        let mut sum = Counts::default();
        let mut looked_at = 0;
        for piece in pieces(&positions, SAMPLES) {
            for _ in 1..piece.len() {
                session.step(observer)?;
            }
            let (old, fused) = (map_of(&session)?.clone(), session.scans().len());
            session.step(observer)?;
            looked_at += session.scans().len() - fused;
            sum += Counts::between(&old, map_of(&session)?);
        }
        let per_scan = |counts: Counts, scans: usize| {
            let of = |n: usize| n as f64 / scans.max(1) as f64;
            [of(counts.voxels), of(counts.lines), of(counts.blocks)]
        };
        let mut counts = per_scan(sum, looked_at);
        let old = map_of(&session)?.clone();
        session.finish(observer)?;
        if session.totals().finish.updated_blocks > 0 {
            // What is left to the end belongs to all scans.
            let late = per_scan(Counts::between(&old, map_of(&session)?), session.scans().len());
            counts.iter_mut().zip(late).for_each(|(sum, late)| *sum += late);
        }
        let [voxels, lines, blocks] = counts;
        Ok(Self {
            scans: looked_at,
            voxels,
            lines,
            blocks,
        })
    }

    /// Bytes of the changed lines, read and written back.
    pub(crate) fn bytes(&self) -> f64 {
        2.0 * LINE_BYTES as f64 * self.lines
    }
}

fn map_of(session: &Session) -> Result<&VoxelMap> {
    let map = session.map();
    map.ok_or_else(|| Error::failed("changes are counted in maps that are in memory"))
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counts {
    voxels: usize,
    lines: usize,
    blocks: usize,
}

impl std::ops::Add for Counts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            voxels: self.voxels + other.voxels,
            lines: self.lines + other.lines,
            blocks: self.blocks + other.blocks,
        }
    }
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Counts {
    /// What differs between a map and the same map later, which has all of its blocks.
    fn between(old: &VoxelMap, new: &VoxelMap) -> Self {
        let indices = new.block_indices();
        let counts = indices.par_iter().filter_map(|&index| {
            let block = new.block(index)?;
            Some(Self::in_block(old.block(index), block))
        });
        counts.reduce(Self::default, |a, b| a + b)
    }

    fn in_block(old: Option<&Block>, new: &Block) -> Self {
        let mut counts = Self::default();
        for (row, voxels) in new.voxels.chunks(ROW).enumerate() {
            let old = |i: usize| old.map_or(Voxel::default(), |old| old.voxels[ROW * row + i]);
            let changed = voxels
                .iter()
                .enumerate()
                .filter(|(i, voxel)| **voxel != old(*i))
                .count();
            counts.voxels += changed;
            counts.lines += usize::from(changed > 0);
        }
        counts.blocks = usize::from(counts.voxels > 0);
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::MapConfig;
    use tsdfuse::glam::IVec3;
    use tsdfuse::index::BlockIndex;

    fn map(weights: &[(i32, usize, u32)]) -> VoxelMap {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        for x in 0..3 {
            let mut block = Block {
                voxels: [Voxel::default(); 512],
            };
            let mut any = false;
            for &(_, number, weight_sum) in weights.iter().filter(|(block, ..)| *block == x) {
                block.voxels[number].weight_sum = weight_sum;
                any = true;
            }
            if any {
                map.insert_block(BlockIndex(IVec3::X * x), block).unwrap();
            }
        }
        map
    }

    #[test]
    fn each_voxel_line_and_block_that_differs_is_counted_once() {
        let old = map(&[(0, 0, 5), (0, 100, 7), (1, 511, 1)]);
        let new = map(&[(0, 0, 6), (0, 7, 1), (0, 8, 1), (0, 100, 7), (1, 511, 1), (2, 300, 2)]);
        let counts = Counts::between(&old, &new);
        assert_eq!((counts.voxels, counts.lines, counts.blocks), (4, 3, 2));
        assert_eq!(Counts::between(&new, &new), Counts::default());
    }
}
