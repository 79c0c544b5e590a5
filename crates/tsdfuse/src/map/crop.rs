//! A part of a map.

use glam::{DVec3, IVec3};

use super::{block::Voxel, error::MapError, voxel_map::VoxelMap};
use crate::index::voxel_at;

impl VoxelMap {
    /// The voxels whose centres lie in a box (world, metres; `low` included, `high` not), and nothing else. Corners may be
    /// infinite.
    ///
    /// # Errors
    /// [`MapError::Box`] if no point lies in it.
    pub fn cropped(&self, low: DVec3, high: DVec3) -> Result<Self, MapError> {
        let (first, end) = self
            .grid()
            .voxels_within(low, high)
            .ok_or(MapError::Box { low, high })?;
        let mut cropped = Self::new(self.config)?;
        cropped.integrations = self.integrations;
        for region in self.regions() {
            for (index, block) in self.blocks_of(region) {
                let inside = |voxel: IVec3| voxel.cmpge(first).all() && voxel.cmplt(end).all();
                let (low, high) = (index.first_voxel(), index.first_voxel() + 7);
                if high.cmplt(first).any() || low.cmpge(end).any() {
                    continue;
                }
                let mut kept = block.clone();
                for (number, voxel) in kept.voxels.iter_mut().enumerate() {
                    if !inside(voxel_at(index, number)) {
                        *voxel = Voxel::default();
                    }
                }
                if kept.is_observed() || (inside(low) && inside(high)) {
                    cropped.insert_block(index, kept)?;
                }
            }
        }
        Ok(cropped)
    }
}
