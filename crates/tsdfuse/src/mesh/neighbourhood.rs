//! A block with a rim of its neighbours' voxels: what a cell, its vertices and their normals need to see.

use glam::IVec3;

use crate::{
    index::{BLOCK_EDGE, BlockIndex, local_number},
    map::{Block, Voxel, VoxelMap},
};

/// Voxels −1 … 9 of each axis.
const EDGE: usize = 11;

/// The voxels of one block and of the rim around it, by coordinates relative to the block's first voxel, −1..=9.
///
/// Rows along x also exist as bits, so that a whole row of cells or edges is judged at once: voxel x is bit x + 1.
pub(crate) struct Neighbourhood {
    voxels: [Voxel; EDGE * EDGE * EDGE],
    /// Was the voxel observed?
    valid: [u16; EDGE * EDGE],
    /// Does the voxel lie behind the surface?
    negative: [u16; EDGE * EDGE],
    /// Are all eight corners of the cell above the voxel observed? For y, z in −1..=7.
    cells: [u16; EDGE * EDGE],
    min_sum: u32,
}

/// The bits of the block's own voxels in a row.
const OWN: u16 = 0b1_1111_1110;

impl Neighbourhood {
    /// A neighbourhood to load blocks into; voxels with a weight sum below `min_sum` count as unobserved.
    pub(crate) fn new(min_sum: u32) -> Self {
        Self {
            voxels: [Voxel::default(); EDGE * EDGE * EDGE],
            valid: [0; EDGE * EDGE],
            negative: [0; EDGE * EDGE],
            cells: [0; EDGE * EDGE],
            min_sum: min_sum.max(1),
        }
    }

    /// Loads a block and its rim.
    pub(crate) fn load(&mut self, map: &VoxelMap, index: BlockIndex) {
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
                let (mut valid, mut negative) = (0, 0);
                for (x, voxel) in row.iter().enumerate() {
                    valid |= u16::from(voxel.weight_sum >= self.min_sum) << x;
                    negative |= u16::from(voxel.distance_sum < 0) << x;
                }
                (self.valid[row_of(y, z)], self.negative[row_of(y, z)]) = (valid, negative);
            }
        }
        for z in -1..=7 {
            for y in -1..=7 {
                let [a, b, c, d] = four(&self.valid, y, z);
                let all = a & b & c & d;
                self.cells[row_of(y, z)] = all & all >> 1;
            }
        }
    }

    /// Which of the block's voxels in row (y, z) have a vertex on their grid edge along x, y and z: where the sign changes
    /// between two observed voxels and at least one of the four cells about the edge is observed.
    #[inline]
    pub(super) fn vertices_in_row(&self, y: i32, z: i32) -> [u16; 3] {
        let cells = |y, z| self.cells[row_of(y, z)];
        let (here, below, behind, both) = (cells(y, z), cells(y - 1, z), cells(y, z - 1), cells(y - 1, z - 1));
        let (n, v) = (self.negative[row_of(y, z)], self.valid[row_of(y, z)]);
        let towards = |row: usize| (n ^ self.negative[row]) & v & self.valid[row];
        let along_x = (n ^ n >> 1) & v & v >> 1 & (here | below | behind | both);
        // A cell's bit shifted up by one stands for the cell at x − 1.
        let (about_y, about_z) = (here | behind, here | below);
        let along_y = towards(row_of(y + 1, z)) & (about_y | about_y << 1);
        let along_z = towards(row_of(y, z + 1)) & (about_z | about_z << 1);
        [along_x, along_y, along_z].map(|bits| (bits & OWN) >> 1)
    }

    /// Which of the block's cells in row (y, z) the surface passes: observed at all corners, on both sides of the surface.
    #[inline]
    pub(crate) fn surface_cells_in_row(&self, y: i32, z: i32) -> u16 {
        let [a, b, c, d] = four(&self.negative, y, z);
        let (any, all) = (a | b | c | d, a & b & c & d);
        let mixed = (any | any >> 1) & !(all & all >> 1);
        (mixed & self.cells[row_of(y, z)] & OWN) >> 1
    }

    /// The set of a cell's negative corners, as numbered in [`super::cube`].
    #[inline]
    pub(super) fn case(&self, cell: IVec3) -> usize {
        let pairs = four(&self.negative, cell.y, cell.z).map(|row| usize::from(row >> (cell.x + 1) & 3));
        pairs[0] | pairs[1] << 2 | pairs[2] << 4 | pairs[3] << 6
    }

    #[inline]
    fn at(&self, voxel: IVec3) -> Voxel {
        self.voxels[offset(voxel)]
    }

    /// Was the voxel observed?
    #[inline]
    fn is_valid(&self, voxel: IVec3) -> bool {
        self.at(voxel).weight_sum >= self.min_sum
    }

    /// F of an observed voxel.
    #[inline]
    pub(super) fn distance(&self, voxel: IVec3) -> f32 {
        let v = self.at(voxel);
        v.distance_sum as f32 / v.weight_sum.max(1) as f32
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

#[inline]
fn row_of(y: i32, z: i32) -> usize {
    ((y + 1) + EDGE as i32 * (z + 1)) as usize
}

/// The rows of the four voxels of a cell that differ in y and z.
#[inline]
fn four(rows: &[u16], y: i32, z: i32) -> [u16; 4] {
    [
        rows[row_of(y, z)],
        rows[row_of(y + 1, z)],
        rows[row_of(y, z + 1)],
        rows[row_of(y + 1, z + 1)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block and its rim with voxels from a simple generator of random numbers.
    fn random(seed: u64) -> Neighbourhood {
        let mut map = VoxelMap::new(crate::MapConfig::default()).unwrap();
        let mut state = seed;
        for n in 0..27 {
            let index = BlockIndex(IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1));
            let shard = &mut map.shards[crate::map::shard_of(index)];
            let slot = shard.slot_or_insert(index);
            for voxel in &mut shard.blocks_mut()[slot as usize].voxels {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let bits = (state >> 33) as u32;
                *voxel = Voxel {
                    weight_sum: 1000 * u32::from(!bits.is_multiple_of(8)),
                    distance_sum: (bits >> 8 & 7) as i32 - 3,
                };
            }
        }
        let mut near = Neighbourhood::new(1);
        near.load(&map, BlockIndex(IVec3::ZERO));
        near
    }

    #[test]
    fn rows_of_bits_say_what_each_voxel_says() {
        let mut seen = [0; 2];
        for seed in 0..20 {
            let near = random(seed);
            let negative = |v| near.at(v).distance_sum < 0;
            let is_cell = |v| (0..8).all(|c| near.is_valid(v + corner(c)));
            for local in 0..512 {
                let v = crate::index::voxel_at(BlockIndex(IVec3::ZERO), local);
                let vertices = near.vertices_in_row(v.y, v.z);
                let axes = [IVec3::X, IVec3::Y, IVec3::Z];
                for k in 0..3 {
                    let (u, w) = (axes[(k + 1) % 3], axes[(k + 2) % 3]);
                    let other = v + axes[k];
                    let literal = near.is_valid(v)
                        && near.is_valid(other)
                        && negative(v) != negative(other)
                        && [v, v - u, v - w, v - u - w].into_iter().any(is_cell);
                    assert_eq!(vertices[k] >> v.x & 1 == 1, literal, "{v} along {k}");
                    seen[0] += usize::from(literal);
                }
                let case = (0..8).fold(0, |case, c| case | usize::from(negative(v + corner(c))) << c);
                assert_eq!(near.case(v), case);
                let literal = is_cell(v) && case != 0 && case != 255;
                assert_eq!(near.surface_cells_in_row(v.y, v.z) >> v.x & 1 == 1, literal, "{v}");
                seen[1] += usize::from(literal);
            }
        }
        assert!(seen.iter().all(|&n| n > 1000), "{seen:?}");
    }
}
