//! The centres of a block's voxels, as a sensor sees them.

use fearless_simd::{Simd, f32x8, prelude::*};
use glam::{Mat3, Vec3};

use super::gather::ROW;
use crate::index::{Anchor, BLOCK_EDGE, BlockIndex};

/// Half the diagonal of a block, in voxels.
pub(crate) const BLOCK_RADIUS: f32 = 0.5 * 1.732_050_8 * BLOCK_EDGE as f32;

/// Voxel centres relative to a sensor, in axes of one's choice, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Centers {
    pub(crate) anchor: Anchor,
    /// Where the sensor is: from the anchor, world axes.
    pub(crate) origin: Vec3,
    /// Turns world axes into those of the result.
    pub(crate) rotation: Mat3,
    pub(crate) voxel_size_m: f32,
}

impl Centers {
    /// The centre of a block.
    #[inline]
    pub(crate) fn of_block(&self, block: BlockIndex) -> Vec3 {
        let to_middle = 0.5 * (BLOCK_EDGE - 1) as f32 * self.voxel_size_m;
        self.rotation * (self.anchor.offset_of(block.first_voxel()) + to_middle - self.origin)
    }

    /// Calls `visit` with each row of the block, in order: the number of its first voxel, and the centres' coordinates, which
    /// compilers turn into vectors.
    #[inline(always)]
    pub(crate) fn for_each_row(&self, block: BlockIndex, mut visit: impl FnMut(usize, &Row)) {
        let rows = self.rows(block);
        for z in 0..BLOCK_EDGE {
            for y in 0..BLOCK_EDGE {
                visit((BLOCK_EDGE * (y + BLOCK_EDGE * z)) as usize, &rows.at(y, z));
            }
        }
    }

    /// The rows of a block.
    #[inline(always)]
    pub(crate) fn rows(&self, block: BlockIndex) -> Rows {
        Rows {
            first: self.rotation * (self.anchor.offset_of(block.first_voxel()) - self.origin),
            step: self.rotation * self.voxel_size_m,
        }
    }
}

/// A block's first voxel, and the steps to the next ones.
pub(crate) struct Rows {
    first: Vec3,
    step: Mat3,
}

impl Rows {
    /// The row at some y and z.
    #[inline(always)]
    pub(crate) fn at(&self, y: i32, z: i32) -> Row {
        let start = self.first + self.step.z_axis * z as f32 + self.step.y_axis * y as f32;
        let mut row = [[0.0; ROW]; 3];
        for (k, row) in row.iter_mut().enumerate() {
            let (start, step) = (start[k], self.step.x_axis[k]);
            for (x, coordinate) in row.iter_mut().enumerate() {
                *coordinate = start + step * x as f32;
            }
        }
        row
    }
}

/// The depths that an image has in the pixels of a row's voxels.
#[inline(always)]
pub(crate) fn depths_at<S: Simd>(simd: S, image_m: &[f32], pixels: [i32; ROW]) -> f32x8<S> {
    let mut depths_m = [0.0; ROW];
    for (depth_m, pixel) in depths_m.iter_mut().zip(pixels) {
        *depth_m = image_m[pixel as usize];
    }
    f32x8::simd_from(simd, depths_m)
}

/// The x, y and z coordinates of the voxels in a row.
pub(crate) type Row = [[f32; ROW]; 3];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::index::{Grid, voxel_at};
    use glam::{DVec3, IVec3};

    #[test]
    fn centers_are_those_of_the_grid() {
        let grid = Grid::new(0.05);
        let anchor = DVec3::new(500_000.125, 5_400_000.25, 311.5);
        let origin = anchor + DVec3::new(0.3, -0.2, 0.1);
        let centers = Centers {
            anchor: grid.anchor(anchor).unwrap(),
            origin: (origin - anchor).as_vec3(),
            rotation: Mat3::from_rotation_z(0.3),
            voxel_size_m: 0.05,
        };
        let block = BlockIndex(IVec3::new(1_250_010, 13_500_003, 770));
        let middle = block.first_voxel().as_dvec3() + 4.0;
        let off = centers.of_block(block) - centers.rotation * (middle * 0.05 - origin).as_vec3();
        assert!(off.length() < 2e-5, "{off}");
        let mut next = 0;
        centers.for_each_row(block, |first, [x, y, z]| {
            for i in 0..ROW {
                assert_eq!(first + i, next);
                next += 1;
                let exact = (grid.center(voxel_at(block, first + i)) - origin).as_vec3();
                assert!((Vec3::new(x[i], y[i], z[i]) - centers.rotation * exact).length() < 2e-5);
            }
        });
        assert_eq!(next, 512);
    }
}
