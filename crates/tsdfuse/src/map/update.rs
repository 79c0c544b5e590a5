//! Updating single voxels, for methods that do not need speed.

use glam::IVec3;

use super::{block::fixed, error::MAX_BLOCK, voxel_map::VoxelMap};
use crate::{
    index::{BlockIndex, in_region, local_number, shard_of},
    memory::OutOfMemory,
};

/// An observation of one voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelUpdate {
    /// Which voxel.
    pub voxel: IVec3,
    /// The signed distance from its centre to the surface, metres, positive in front of it. It is limited to the truncation.
    pub distance_m: f32,
    /// How much it counts, limited to 0..=1; less than 1/65536 is no update.
    pub weight: f32,
}

/// What became of single updates.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Updated {
    /// The blocks that were updated, each once.
    pub blocks: Vec<BlockIndex>,
    /// Updates that changed nothing: not a number, without weight, or outside of the grid.
    pub left_out: u64,
}

impl VoxelMap {
    /// Adds observations of single voxels (3.5)(3.6), in any order, a voxel as often as you like. One call counts as one integration:
    /// give it all updates of a scan.
    ///
    /// The sums are the same as if an integrator had made the updates. This is the simple way, on one thread; see
    /// [`fuse::Lines`](crate::fuse::Lines) and [`fuse::Gather`](crate::fuse::Gather) for the fast ones.
    ///
    /// # Errors
    /// There is no memory for a block; the updates before it are made.
    ///
    /// # Examples
    /// ```
    /// use tsdfuse::{MapConfig, VoxelMap, glam::IVec3, map::VoxelUpdate};
    /// let mut map = VoxelMap::new(MapConfig::default())?;
    /// let weight = |distance_m: f32| if distance_m > -0.1 { 1.0 } else { 0.5 }; // your own
    /// let line = [0.15, 0.05, -0.05, -0.15].into_iter().zip(0..);
    /// map.update(line.map(|(distance_m, x)| VoxelUpdate { voxel: IVec3::new(x, 0, 0), distance_m, weight: weight(distance_m) }))?;
    /// assert_eq!((map.voxel(IVec3::X).weight(), map.voxel(IVec3::X).distance()), (1.0, Some(0.25)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn update(&mut self, updates: impl IntoIterator<Item = VoxelUpdate>) -> Result<Updated, OutOfMemory> {
        let (stamp, limit) = self.begin_integration();
        let per_m = (1.0 / self.config.truncation_m) as f32;
        let mut updated = Updated::default();
        for VoxelUpdate {
            voxel,
            distance_m,
            weight,
        } in updates
        {
            let index = BlockIndex::of(voxel);
            let is_inside = index.0.to_array().iter().all(|i| i.unsigned_abs() <= MAX_BLOCK);
            let is_number = !(distance_m.is_nan() || weight.is_nan());
            let (sum, distance) = fixed(distance_m * per_m, weight);
            if !(is_inside && is_number) || sum <= 0 {
                updated.left_out += 1;
                continue;
            }
            let shard = &mut self.shards[shard_of(index)];
            let (region, block) = in_region(index);
            let region = shard.region_to_update(region, stamp)?;
            let slot = shard.slot_to_update(region, block, &mut updated.blocks)?;
            let voxel = &mut shard.blocks[slot as usize].voxels[local_number(voxel)];
            voxel.add_sums(sum, distance);
            voxel.limit(limit);
        }
        Ok(updated)
    }
}
