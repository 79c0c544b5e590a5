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
    /// Makes a shaft of each of some items, or tells why there is none, and updates their voxels. It is faster if items that
    /// follow each other are neighbours.
    pub(crate) fn run(
        &mut self,
        map: &mut VoxelMap,
        items: &[u32],
        make: impl Fn(usize) -> Result<Shaft, Skip> + Sync,
        rule: &impl Rule,
    ) -> Integration {
        let level = self.gather.level();
        self.gather.run(
            map,
            items.len(),
            |range, near| {
                dispatch!(level, simd => for i in range {
                    let shaft = make(items[i] as usize);
                    near.count(shaft.map(|_| ()));
                    if let Ok(shaft) = shaft {
                        shaft.about.for_each_block(simd, #[inline(always)] |block| near.block(block, i as u32, shaft));
                    }
                });
            },
            |_| false,
            |block, shafts, updates| {
                dispatch!(level, simd => for shaft in shafts.iter() {
                    let rule = rule.of(simd, shaft);
                    shaft.about.for_each_row(simd, block, #[inline(always)] |row, voxels| {
                        let (inside, distance, weight) = rule(voxels);
                        updates.add_row(row, inside, distance, weight);
                    });
                });
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        fuse::cylinder::{VOXEL_RADIUS, tests::any_cylinder},
        map::MapConfig,
    };
    use fearless_simd::{Level, prelude::*};
    use proptest::prelude::{Strategy, prop_assert, prop_oneof, proptest};

    struct Cone;

    impl Rule for Cone {
        #[inline(always)]
        fn of<S: Simd>(&self, simd: S, shaft: &Shaft) -> impl Fn(&Row<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
            let Cylinder {
                radius, half_length, ..
            } = shaft.about;
            let weight = f32x8::splat(simd, shaft.weight);
            move |v| {
                let distance = v.distance2.sqrt().copysign(v.along) / half_length;
                (v.within(radius, half_length), distance, weight)
            }
        }
    }

    /// The instructions that can be tried on this CPU, the plainest first.
    fn levels() -> Vec<Level> {
        let mut levels = vec![Level::fallback(), Level::baseline(), Level::new()];
        #[cfg(target_arch = "x86_64")]
        levels.extend(Level::new().as_avx2().map(Level::Avx2));
        levels
    }

    fn fused(level: Level, shafts: &[Shaft]) -> VoxelMap {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let gather = Gather::with(level);
        let all: Vec<u32> = (0..shafts.len() as u32).collect();
        Shafts { gather }.run(&mut map, &all, |i| Ok(shafts[i]), &Cone);
        map
    }

    fn any_shaft() -> impl Strategy<Value = Shaft> {
        let radius = prop_oneof![proptest::strategy::Just(VOXEL_RADIUS), 1.0..9.0f32];
        (any_cylinder(radius), 0.01..1.0f32).prop_map(|(about, weight)| Shaft { about, weight })
    }

    proptest! {
        #[test]
        fn all_instructions_give_the_same_map(shafts in proptest::collection::vec(any_shaft(), 1..30)) {
            let maps: Vec<VoxelMap> = levels().into_iter().map(|level| fused(level, &shafts)).collect();
            prop_assert!(maps.iter().all(|map| *map == maps[0]));
            // And the comparison would see one that is missing.
            prop_assert!(fused(Level::new(), &shafts[1..]) != maps[0] || shafts[0].weight * 32_768.0 < 1.0);
        }
    }
}
