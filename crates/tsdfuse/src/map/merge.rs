//! Maps of two parts of a log make the map of the whole log: their sums are added.

use super::{
    block::{Block, Voxel},
    error::{MapError, check_block},
    voxel_map::VoxelMap,
};
use crate::index::{BlockIndex, shard_of};

impl VoxelMap {
    /// Adds the observations of another map. The same bits as fusing all scans into one map, in any order and grouping, as long as
    /// nothing but additions made the maps: no voxel reaches `max_weight`, and no method looks at what came before: `patch`
    /// with `carve` erases, `depth` and `caminal` also update existing blocks in view, and `roldao` in `batch` fits planes to all scans
    /// at once.
    ///
    /// Tells how many voxels would have gone beyond `max_weight`: they are the mean of both maps, but not the bits that fusing all
    /// would give.
    ///
    /// # Errors
    /// [`MapError::Differ`] if voxel size, truncation or `max_weight` differ; nothing is changed then.
    pub fn merge(&mut self, other: &Self) -> Result<u64, MapError> {
        self.config.check_same(&other.config)?;
        let mut limited = 0;
        for region in other.regions() {
            for (index, block) in other.blocks_of(region) {
                limited += self.add_block(index, block)?;
            }
        }
        self.integrations = self.integrations.wrapping_add(other.integrations);
        Ok(limited)
    }

    /// Adds the observations of a block of another map; tells how many voxels would have gone beyond `max_weight`.
    ///
    /// # Errors
    /// Like [`VoxelMap::insert_block`], but the block may already exist.
    pub fn add_block(&mut self, index: BlockIndex, block: &Block) -> Result<u64, MapError> {
        check_block(index, block)?;
        let limit = self.config.max_weight_sum();
        let shard = &mut self.shards[shard_of(index)];
        let slot = shard.slot_or_insert(index)?;
        let own = &mut shard.blocks_mut()[slot as usize];
        let added = own.voxels.iter_mut().zip(&block.voxels);
        Ok(added.map(|(own, other)| u64::from(own.add(*other, limit))).sum())
    }
}

impl Voxel {
    /// Adds the sums of another voxel, up to a limit; whether that was reached.
    fn add(&mut self, other: Self, limit: u32) -> bool {
        // No weight exceeds 2³⁰: twice that fits a u32, and an i64 holds the products.
        let weight = self.weight_sum + other.weight_sum;
        let distance = i64::from(self.distance_sum) + i64::from(other.distance_sum);
        self.weight_sum = weight.min(limit);
        self.distance_sum = if weight > limit {
            (distance * i64::from(limit) / i64::from(weight)) as i32
        } else {
            distance as i32
        };
        weight > limit
    }
}

#[cfg(test)]
mod tests {
    use glam::{IVec3, Vec3};
    use proptest::prelude::*;

    use super::*;
    use crate::{
        Integrator, MapConfig, Pose, Raycast, Scan,
        index::BLOCK_VOXELS,
        map::block::{MAX_WEIGHT_SUM, WEIGHT_SCALE},
    };

    fn scan(number: i32) -> Scan {
        let points = (-20..20).flat_map(|y| (-20..20).map(move |z| Vec3::new(3.0, 0.05 * y as f32, 0.05 * z as f32)));
        Scan {
            points: points.collect(),
            pose: Some(Pose {
                translation: glam::DVec3::new(0.13, 0.4, -0.1) * f64::from(number),
                ..Pose::IDENTITY
            }),
            ..Default::default()
        }
    }

    fn fused(scans: impl IntoIterator<Item = i32>, max_weight: f32) -> VoxelMap {
        let config = MapConfig {
            max_weight,
            ..Default::default()
        };
        let mut map = VoxelMap::new(config).unwrap();
        let mut raycast = Raycast::default();
        for number in scans {
            raycast.integrate(&mut map, &scan(number)).unwrap();
        }
        map
    }

    #[test]
    fn maps_of_parts_add_up_to_the_map_of_all() {
        let all = fused(0..6, 100.0);
        for (part, rest) in [(vec![0, 1, 2], vec![3, 4, 5]), (vec![5, 1], vec![0, 4, 2, 3])] {
            let mut merged = fused(part, 100.0);
            assert_eq!(merged.merge(&fused(rest, 100.0)), Ok(0));
            assert!(merged == all);
            assert_eq!(merged.integrations(), 6);
        }
        // And one scan twice is seen.
        let mut merged = fused(0..4, 100.0);
        merged.merge(&fused(3..6, 100.0)).unwrap();
        assert!(merged != all);
    }

    #[test]
    fn where_the_limit_is_reached_it_is_counted_and_the_mean_stays() {
        let mut merged = fused(0..3, 1.0);
        let limited = merged.merge(&fused(3..6, 1.0)).unwrap();
        assert!(limited > 1000, "{limited}");
        let all = merged.block_indices().into_iter().filter_map(|i| merged.block(i));
        assert!(all.flat_map(|b| &b.voxels).all(|v| v.weight() <= 1.0));
    }

    #[test]
    fn maps_that_mean_something_else_are_refused() {
        let (mut map, other) = (fused(0..1, 100.0), fused(0..1, 7.0));
        let before = map.clone();
        let told = map.merge(&other).unwrap_err().to_string();
        assert_eq!(told, "the maps differ in max_weight: 100 and 7");
        assert!(map == before);
        let impossible = Block {
            voxels: [Voxel {
                weight_sum: 1,
                distance_sum: 2,
            }; BLOCK_VOXELS],
        };
        assert!(map.add_block(BlockIndex(IVec3::ZERO), &impossible).is_err());
    }

    fn any_voxel() -> impl Strategy<Value = Voxel> {
        let weight = prop_oneof![0..=MAX_WEIGHT_SUM, Just(MAX_WEIGHT_SUM), 0..100u32];
        (weight, -1.0..=1.0f64).prop_map(|(weight_sum, f)| Voxel {
            weight_sum,
            distance_sum: (f * f64::from(weight_sum)) as i32,
        })
    }

    proptest! {
        #[test]
        fn sums_never_overflow_and_stay_possible(a in any_voxel(), b in any_voxel(), limit in 1..=MAX_WEIGHT_SUM) {
            let mut sum = a;
            let limited = sum.add(b, limit);
            prop_assert!(sum.is_possible());
            prop_assert_eq!(limited, a.weight_sum + b.weight_sum > limit);
            prop_assert_eq!(sum.weight_sum, limit.min(a.weight_sum + b.weight_sum));
            let mut other = b;
            other.add(a, limit);
            prop_assert_eq!(other, sum);
            let total = f64::from(a.weight_sum) + f64::from(b.weight_sum);
            if sum.weight_sum > WEIGHT_SCALE {
                let mean = (f64::from(a.distance_sum) + f64::from(b.distance_sum)) / total;
                prop_assert!((f64::from(sum.distance().unwrap()) - mean).abs() < 1e-4);
            }
        }
    }
}
