//! Updating all voxels about lines: what raycasting, local normals and surfels have in common.

use fearless_simd::{Simd, dispatch, f32x8, mask32x8};

use super::{
    Integration,
    cylinder::{Cylinder, Row},
    gather::{Gather, Skip},
};
use crate::map::VoxelMap;

/// A cylinder whose voxels are updated with a weight.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Shaft {
    pub(crate) about: Cylinder,
    pub(crate) weight: f32,
}

/// What a method does to the voxels of a shaft, eight at a time.
pub(crate) trait Rule: Sync {
    /// Prepares for one shaft; what is returned tells for voxels of its cylinder's surroundings which of them are updated,
    /// with what distance over μ, and with what weight.
    fn of<S: Simd>(&self, simd: S, shaft: &Shaft) -> impl Fn(&Row<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>);
}

/// Buffers, kept from scan to scan.
#[derive(Debug, Default)]
pub(crate) struct Shafts {
    gather: Gather<Shaft>,
}

impl Shafts {
    /// Makes a shaft of each of `items` items, or tells why there is none, and updates their voxels.
    pub(crate) fn run(
        &mut self,
        map: &mut VoxelMap,
        items: usize,
        make: impl Fn(usize) -> Result<Shaft, Skip> + Sync,
        rule: &impl Rule,
    ) -> Integration {
        let level = self.gather.level();
        self.gather.run(
            map,
            items,
            |i, near| {
                let shaft = make(i)?;
                shaft.about.for_each_block(|block| near.block(block, i as u32, shaft));
                Ok(())
            },
            |_| false,
            |block, shafts, updates| {
                dispatch!(level, simd => for shaft in shafts.iter() {
                    let rule = rule.of(simd, shaft);
                    shaft.about.for_each_row(simd, block, |row, voxels| {
                        let (inside, distance, weight) = rule(voxels);
                        updates.add_row(row, inside, distance, weight);
                    });
                });
            },
        )
    }
}
