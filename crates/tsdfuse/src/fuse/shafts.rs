//! Updating all voxels about lines: what raycasting, local normals and surfels have in common.

use fearless_simd::{Simd, dispatch, f32x8, mask32x8};
use rayon::prelude::*;

use super::{
    Integration,
    cylinder::{Cylinder, Row},
    gather::{Gather, Skip},
};
use crate::map::VoxelMap;

/// A cylinder whose voxels are updated with a weight.
#[derive(Clone, Copy, Debug)]
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

/// Shafts that are fetched at a time.
const AHEAD: usize = 8;

/// Buffers, kept from scan to scan.
#[derive(Debug, Default)]
pub(crate) struct Shafts {
    shafts: Vec<Result<Shaft, Skip>>,
    gather: Gather,
}

impl Shafts {
    /// Makes a shaft of each of `items` items, or tells why there is none, and updates their voxels.
    pub(crate) fn run(
        &mut self,
        map: &mut VoxelMap,
        items: usize,
        make: impl Fn(usize) -> Result<Shaft, Skip> + Sync + Send,
        rule: &impl Rule,
    ) -> Integration {
        let shafts = &mut self.shafts;
        (0..items).into_par_iter().with_min_len(1024).map(make).collect_into_vec(shafts);
        let level = self.gather.level();
        self.gather.run(
            map,
            items,
            |i, near| {
                shafts[i]?.about.name_blocks(i as u32, near);
                Ok(())
            },
            |_| false,
            |block, tags, updates| {
                dispatch!(level, simd => for tags in tags.chunks(AHEAD) {
                    // Fetched together: each is a miss of the cache.
                    let shafts: [_; AHEAD] = std::array::from_fn(|k| tags.get(k).and_then(|&i| shafts[i as usize].ok()));
                    for shaft in shafts.iter().flatten() {
                        let rule = rule.of(simd, shaft);
                        shaft.about.for_each_row(simd, block, |row, voxels| {
                            let (inside, distance, weight) = rule(voxels);
                            updates.add_row(row, inside, distance, weight);
                        });
                    }
                });
            },
        )
    }
}
