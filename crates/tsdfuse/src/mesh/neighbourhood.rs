//! A block with a rim of its neighbours' voxels: what a cell, its vertices and their normals need to see.

use glam::IVec3;

use crate::{
    index::{BLOCK_EDGE, BlockIndex, local_number},
    map::{Block, Voxel, VoxelMap},
};

/// Voxels −1 … 9 of each axis.
const EDGE: usize = 11;

/// The voxels of one block and of the rim around it, by coordinates relative to the block's first voxel, −1..=9.
pub(super) struct Neighbourhood {
    voxels: [Voxel; EDGE * EDGE * EDGE],
    min_sum: u32,
}

impl Neighbourhood {
    /// A neighbourhood to load blocks into; voxels with a weight sum below `min_sum` count as unobserved.
    pub(super) fn new(min_sum: u32) -> Self {
        Self {
            voxels: [Voxel::default(); EDGE * EDGE * EDGE],
            min_sum: min_sum.max(1),
        }
    }

    /// Loads a block and its rim.
    pub(super) fn load(&mut self, map: &VoxelMap, index: BlockIndex) {
        let blocks: [Option<&Block>; 27] = std::array::from_fn(|n| {
            let n = n as i32;
            map.block(BlockIndex(index.0 + IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)))
        });
        let part = |v: i32| if v < 0 { 0 } else { 1 + v / BLOCK_EDGE };
        for z in -1..=9 {
            for y in -1..=9 {
                let row = offset(IVec3::new(-1, y, z));
                let first = (3 * part(y) + 9 * part(z)) as usize;
                let local = local_number(IVec3::new(0, y, z));
                let row = &mut self.voxels[row..row + EDGE];
                let copy = |target: &mut [Voxel], block: Option<&Block>, from: usize| match block {
                    Some(b) => target.copy_from_slice(&b.voxels[from..from + target.len()]),
                    None => target.fill(Voxel::default()),
                };
                copy(&mut row[..1], blocks[first], local + 7);
                copy(&mut row[1..9], blocks[first + 1], local);
                copy(&mut row[9..], blocks[first + 2], local);
            }
        }
    }

    #[inline]
    fn at(&self, voxel: IVec3) -> Voxel {
        self.voxels[offset(voxel)]
    }

    /// Was the voxel observed?
    #[inline]
    pub(super) fn is_valid(&self, voxel: IVec3) -> bool {
        self.at(voxel).weight_sum >= self.min_sum
    }

    /// Does the voxel lie behind the surface?
    #[inline]
    pub(super) fn is_negative(&self, voxel: IVec3) -> bool {
        self.at(voxel).distance_sum < 0
    }

    /// F of an observed voxel.
    #[inline]
    pub(super) fn distance(&self, voxel: IVec3) -> f32 {
        let v = self.at(voxel);
        v.distance_sum as f32 / v.weight_sum.max(1) as f32
    }

    /// Are all eight corners of the cell above `voxel` observed?
    #[inline]
    pub(super) fn is_cell(&self, voxel: IVec3) -> bool {
        (0..8).all(|c| self.is_valid(voxel + corner(c)))
    }

    /// The field's gradient at an observed voxel, per voxel: central differences where both sides are observed.
    pub(super) fn gradient(&self, voxel: IVec3) -> glam::Vec3 {
        let here = self.distance(voxel);
        let along = |axis: IVec3| {
            let side = |v: IVec3| self.is_valid(v).then(|| self.distance(v));
            match (side(voxel - axis), side(voxel + axis)) {
                (Some(low), Some(high)) => 0.5 * (high - low),
                (Some(low), None) => here - low,
                (None, Some(high)) => high - here,
                (None, None) => 0.0,
            }
        };
        glam::Vec3::new(along(IVec3::X), along(IVec3::Y), along(IVec3::Z))
    }
}

/// The corner of a cell, as numbered in [`super::cube`].
#[inline]
pub(super) fn corner(c: usize) -> IVec3 {
    IVec3::new(c as i32 & 1, c as i32 >> 1 & 1, c as i32 >> 2)
}

#[inline]
fn offset(v: IVec3) -> usize {
    ((v.x + 1) + EDGE as i32 * ((v.y + 1) + EDGE as i32 * (v.z + 1))) as usize
}
