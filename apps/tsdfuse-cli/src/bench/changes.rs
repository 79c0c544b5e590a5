//! How much of the map a scan changes: counted, not timed, by comparing the map before with the map after.

use anyhow::Result;
use rayon::prelude::*;
use serde::Serialize;
use tsdfuse::VoxelMap;
use tsdfuse::map::{Block, Voxel};
use tsdfuse_io::Dataset;

use super::limits::LINE_BYTES;
use crate::fuse::Fusion;

/// Scans that are looked at; copies of the map are made for each.
const SAMPLES: usize = 12;

/// Voxels that share a cache line, were blocks to begin at one.
const ROW: usize = LINE_BYTES / size_of::<Voxel>();

/// What differs, on average of the scans that were looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Changes {
    /// Scans that were looked at.
    pub(crate) scans: usize,
    pub(crate) voxels: f64,
    /// Rows of eight voxels, 64 bytes each.
    pub(crate) lines: f64,
    pub(crate) blocks: f64,
}

impl Changes {
    /// Fuses all scans once more and looks at some of them.
    pub(crate) fn count(mut fusion: Fusion, dataset: &Dataset, indices: &[usize]) -> Result<Self> {
        let mut sum = Counts::default();
        let mut looked_at = 0;
        for piece in pieces(indices, SAMPLES) {
            let [before @ .., last] = piece else { continue };
            fusion.fuse_some(dataset, before.to_vec())?;
            let (old, fused) = (fusion.map.clone(), fusion.scans.len());
            fusion.fuse_some(dataset, vec![*last])?;
            looked_at += fusion.scans.len() - fused;
            sum += Counts::between(&old, &fusion.map);
        }
        let per_scan = |counts: Counts, scans: usize| {
            let of = |n: usize| n as f64 / scans.max(1) as f64;
            [of(counts.voxels), of(counts.lines), of(counts.blocks)]
        };
        let mut counts = per_scan(sum, looked_at);
        let old = fusion.map.clone();
        if fusion.finish().updated_blocks > 0 {
            // What is left to the end belongs to all scans.
            let late = per_scan(Counts::between(&old, &fusion.map), fusion.scans.len());
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

/// At most `count` pieces of nearly the same length.
pub(super) fn pieces<T>(all: &[T], count: usize) -> impl Iterator<Item = &[T]> {
    let count = count.min(all.len());
    (0..count).map(move |i| &all[i * all.len() / count..(i + 1) * all.len() / count])
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
    use glam::IVec3;
    use tsdfuse::MapConfig;
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

    #[test]
    fn pieces_hold_every_scan_once() {
        let scans: Vec<usize> = (5..34).collect();
        for count in [1, 2, 12, 29, 99] {
            let pieces: Vec<_> = pieces(&scans, count).collect();
            assert_eq!(pieces.concat(), scans);
            assert_eq!(pieces.len(), count.min(29));
            assert!(pieces.iter().all(|piece| !piece.is_empty()));
        }
        assert_eq!(pieces::<usize>(&[], 3).count(), 0);
    }
}
