//! How often a scan is fused where the map knows the surface.
//!
//! On a drive the same wall is in dozens of scans, and most updates tell the map what it knows. So where a voxel holds 2 × [`KNOWN`] times what
//! one scan adds, only every second scan is fused, with twice the weight; where it holds twice as much, every fourth, and so on up to
//! [`MOST_TIMES`]. In the mean the sums are those of all scans, and no scan weighs more than one in [`KNOWN`]. Blocks take turns, so that
//! scans cost alike. What is new, what contradicts the map, and what does not agree with it well, so that only many scans average its
//! errors, is fused in full.

use glam::IVec3;
use rayon::prelude::*;

use super::agreement::Agreement;
use crate::{
    index::{Anchor, BlockIndex, local_number, shard_of},
    map::{Recent, Voxel, VoxelMap, WEIGHT_SCALE},
    memory::prefetch,
    patch::{Patch, Turn},
};

/// Where only some scans are fused, each weighs at most one in this many.
pub const KNOWN: f32 = 8.0;

/// At least every such scan is fused: a power of two.
pub const MOST_TIMES: u32 = 8;

/// A surface of the map that is farther than this from a patch, in voxels, is another one.
pub const OTHER_SURFACE: f32 = 1.0;

/// Patches with a greater standard deviation from the map, in voxels, are always fused.
pub const AGREES: f32 = 0.3;

/// A voxel lies near the lines of at least so many patches of a scan.
pub const LEAST_LINES: f32 = 1.5;

/// Patches whose voxels are fetched from memory at a time.
const BURST: usize = 64;

/// Patches that one thread takes at a time.
const PART: usize = 4096;

/// Finds the turns of a scan's patches. Keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Settled {
    /// By parts of the scan: blocks that the scan shows, but that wait for another one.
    waiting: Vec<Vec<BlockIndex>>,
}

impl Settled {
    /// All take part.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
    }

    /// Says of each return of a scan, which comes next, whether it takes part, and for how many scans. `crowd` planes meet in a voxel that faces the
    /// sensor 1 m away.
    pub(super) fn find(
        &mut self,
        map: &VoxelMap,
        anchor: Anchor,
        crowd: f32,
        agreement: Agreement,
        returns: &mut [Patch],
    ) {
        let scan = map.integrations().wrapping_add(1);
        let truncation = map.config().truncation_vox();
        self.waiting.resize_with(returns.len().div_ceil(PART), Vec::new);
        let parts = returns.par_chunks_mut(PART).zip(&mut self.waiting);
        parts.for_each(|(returns, waiting)| {
            waiting.clear();
            let mut recent = Recent::new(map);
            for patches in returns.chunks_mut(BURST) {
                let mut known = [(BlockIndex(IVec3::ZERO), None); BURST];
                for (patch, known) in patches.iter().zip(&mut known) {
                    let Some(center) = anchor.locate(patch.center).filter(|_| patch.is_plane()) else {
                        continue;
                    };
                    let index = BlockIndex::of(center.voxel);
                    let voxel = recent
                        .block(index)
                        .map(|block| &block.voxels[local_number(center.voxel)]);
                    voxel.into_iter().for_each(prefetch);
                    *known = (index, voxel);
                }
                for (patch, (block, voxel)) in patches.iter_mut().zip(known) {
                    let Some(voxel) = voxel.filter(|_| agreement.sigma_of(patch) <= AGREES) else {
                        continue;
                    };
                    let times = times(voxel, patch, crowd, truncation);
                    let is_due = (block.0.element_sum() as u32).wrapping_add(scan).is_multiple_of(times);
                    patch.turn = Turn {
                        times: times as u8,
                        is_due,
                    };
                    if !is_due && waiting.last() != Some(&block) {
                        waiting.push(block);
                    }
                }
            }
        });
    }

    /// Counts the blocks that wait among those that the last integration updated, since the scan shows that their surface is still there.
    pub(super) fn mark(&self, map: &mut VoxelMap) {
        let stamp = map.integrations();
        for &block in self.waiting.iter().flatten() {
            map.shards[shard_of(block)].mark_updated(block, stamp);
        }
    }
}

/// A patch takes part in one of so many scans.
#[inline(always)]
fn times(voxel: &Voxel, patch: &Patch, crowd: f32, truncation: f32) -> u32 {
    let held = voxel.weight_sum as f32;
    if (voxel.distance_sum as f32).abs() * truncation > OTHER_SURFACE * held {
        return 1;
    }
    let weight = patch.weight();
    let lines = (crowd * patch.cosine() / patch.center.length_squared()).max(LEAST_LINES);
    let scans = held / (KNOWN * WEIGHT_SCALE as f32 * weight * lines);
    // No update weighs more than 1. Conversion takes what is not a number for 0.
    let most = scans.min(1.0 / weight).min(MOST_TIMES as f32) as u32;
    1 << (most | 1).ilog2()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Integrator, MapConfig, Pose, Scan,
        fuse::PatchConfig,
        patch::Kind,
        sensor::{model, testing::scan_room},
    };
    use glam::Vec3;

    #[test]
    fn what_the_map_knows_takes_turns() {
        let facing = |range_m: f32| Patch {
            center: range_m * Vec3::X,
            normal: -Vec3::X,
            kind: Kind::Whole,
            ..Patch::default()
        };
        // A voxel that holds what so many scans add, at some distance in voxels.
        let after = |scans: f32, range_m: f32, off_vox: f32| {
            let weight = scans * LEAST_LINES * WEIGHT_SCALE as f32 / range_m;
            let voxel = Voxel {
                weight_sum: weight as u32,
                distance_sum: (weight * off_vox / 4.0) as i32,
            };
            times(&voxel, &facing(range_m), 1.0, 4.0)
        };
        assert_eq!(
            [1.0, 15.0, 17.0, 33.0, 65.0, 1000.0].map(|scans| after(scans, 10.0, 0.5)),
            [1, 1, 2, 4, 8, 8]
        );
        assert_eq!([0.9, -0.9, 1.1, -1.1].map(|off| after(100.0, 10.0, off)), [8, 8, 1, 1]);
        // 1 is the most that an update can weigh.
        assert_eq!([1.5, 3.0, 5.0].map(|range| after(100.0, range, 0.0)), [1, 2, 4]);
        // More lines of each scan.
        assert_eq!(
            times(
                &Voxel {
                    weight_sum: 20 * WEIGHT_SCALE / 10 * 3 / 2,
                    distance_sum: 0
                },
                &facing(10.0),
                300.0,
                4.0
            ),
            1
        );
        assert_eq!(times(&Voxel::default(), &facing(10.0), 1.0, 4.0), 1);
    }

    /// A map of many scans of a room, and how many blocks the later ones updated in the mean.
    fn seen_often(agreement: bool) -> (VoxelMap, f64) {
        let sensor = model("os1-64").unwrap();
        let config = PatchConfig {
            agreement,
            ..PatchConfig::default()
        };
        let mut method = crate::Patch::new(config, Some(sensor.clone()));
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let (points, rings) = scan_room(&sensor, |_| 0.0);
        let scan = Scan {
            points,
            rings: Some(rings),
            pose: Some(Pose::IDENTITY),
            ..Scan::default()
        };
        let mut updated = 0;
        for number in 0..48 {
            let done = method.integrate(&mut map, &scan).unwrap();
            assert_eq!(done.fused_returns, scan.points.len() as u64);
            updated += if number >= 24 { done.updated_blocks.len() } else { 0 };
        }
        (map, updated as f64 / 24.0)
    }

    #[test]
    fn in_the_mean_the_map_is_that_of_all_scans() {
        let ((all, every), (some, few)) = (seen_often(false), seen_often(true));
        assert!(few < 0.9 * every, "{few} of {every} blocks");
        let total = |map: &VoxelMap| -> f64 {
            let blocks = map.block_indices();
            let weights = blocks
                .iter()
                .flat_map(|&b| map.block(b).unwrap().voxels.iter().map(|v| f64::from(v.weight_sum)));
            weights.sum()
        };
        let ratio = total(&some) / total(&all);
        assert!((0.95..1.05).contains(&ratio), "{ratio}");
        // The surface stays where it is, and nothing is erased.
        assert_eq!(all.block_indices(), some.block_indices());
        let mut worst = 0.0_f32;
        for block in all.block_indices() {
            let pairs = all
                .block(block)
                .unwrap()
                .voxels
                .iter()
                .zip(some.block(block).unwrap().voxels.iter());
            for (a, b) in pairs.filter(|(a, _)| a.weight_sum > WEIGHT_SCALE) {
                let (a, b) = (a.distance().unwrap(), b.distance().expect("it was observed"));
                worst = worst.max((a - b).abs());
            }
        }
        assert!(worst < 0.05, "{worst}");
    }
}
