//! What marching cubes asks of voxels first, as bits: observed or not, in front of the surface or behind it.

use fearless_simd::{Level, Simd, dispatch, i32x8, prelude::*};

use super::near::{CORNERS, Near, PerBlock, Place};
use crate::map::{Block, Voxel, VoxelMap};

/// A bit for each voxel of a block: bit x of byte y of layer z.
pub(super) type Bits = [[u8; 8]; 8];

/// No bit is set.
pub(super) const NO_BITS: Bits = [[0; 8]; 8];

/// The bits of a block's voxels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Signs {
    /// Was the voxel observed?
    pub(super) valid: Bits,
    /// Does the voxel lie behind the surface?
    pub(super) negative: Bits,
}

impl Signs {
    /// Of a block that was never observed.
    pub(super) const NONE: Self = Self {
        valid: NO_BITS,
        negative: NO_BITS,
    };

    /// Voxels with a weight sum below `min_sum` count as unobserved.
    #[inline(always)]
    pub(super) fn of<S: Simd>(simd: S, block: &Block, min_sum: i32) -> Self {
        let mut signs = Self::NONE;
        for (r, voxels) in block.voxels.as_chunks().0.iter().enumerate() {
            let (weights, distances) = load(simd, voxels);
            signs.valid[r / 8 % 8][r % 8] = weights.simd_ge(min_sum).to_bitmask() as u8;
            signs.negative[r / 8 % 8][r % 8] = distances.simd_lt(0).to_bitmask() as u8;
        }
        signs
    }

    /// Of all blocks of a map.
    pub(crate) fn of_all(map: &VoxelMap, min_sum: i32, level: Level) -> PerBlock<Self> {
        PerBlock::of_all(map, |block| dispatch!(level, simd => Self::of(simd, block, min_sum)))
    }
}

impl PerBlock<Signs> {
    /// Whether a block's cells can have surface: whether any two of the voxels about them, which are those of the block and of the
    /// blocks after it, lie on different sides.
    #[inline(always)]
    pub(super) fn may_have_surface(&self, near: &Near<Place>) -> bool {
        let (mut front, mut back) = ([0; 64], [0; 64]);
        for signs in CORNERS.iter().filter_map(|&n| self.get(near[n]?)) {
            let (valid, negative) = (signs.valid.as_flattened(), signs.negative.as_flattened());
            for i in 0..64 {
                front[i] |= valid[i] & !negative[i];
                back[i] |= valid[i] & negative[i];
            }
        }
        front != [0; 64] && back != [0; 64]
    }
}

/// The weight and distance sums of eight voxels. (Weights fit an i32: see [`crate::map::MAX_WEIGHT`].)
#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, v: &[Voxel; 8]) -> (i32x8<S>, i32x8<S>) {
    let four = |a: Voxel, b: Voxel, c: Voxel, d: Voxel| {
        let sums = [
            a.weight_sum as i32,
            a.distance_sum,
            b.weight_sum as i32,
            b.distance_sum,
            c.weight_sum as i32,
            c.distance_sum,
            d.weight_sum as i32,
            d.distance_sum,
        ];
        i32x8::simd_from(simd, sums)
    };
    four(v[0], v[1], v[2], v[3]).deinterleave(four(v[4], v[5], v[6], v[7]))
}
