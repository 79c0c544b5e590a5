//! What was observed: blocks and voxels, one after the other, with their places in the world.

use glam::{DVec3, IVec3};

use super::{block::Block, voxel_map::VoxelMap};
use crate::index::{BLOCK_EDGE, BlockIndex, voxel_at};

/// A block in which something was observed.
#[derive(Clone, Copy, Debug)]
pub struct ObservedBlock<'a> {
    /// Its place in the grid.
    pub index: BlockIndex,
    /// Its centre in the world, metres.
    pub center: DVec3,
    /// Its voxels.
    pub block: &'a Block,
}

/// A voxel that was observed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedVoxel {
    /// Its place in the grid.
    pub index: IVec3,
    /// Its centre in the world, metres.
    pub center: DVec3,
    /// The signed distance from its centre to the nearest surface, metres; as in [`Sample`](super::Sample).
    pub distance_m: f32,
    /// The accumulated weight W.
    pub weight: f32,
}

impl VoxelMap {
    /// All blocks in which anything was observed, region by region, in an order that does not depend on how the map was made.
    pub fn blocks(&self) -> impl Iterator<Item = ObservedBlock<'_>> {
        let voxel_size_m = self.config.voxel_size_m;
        let blocks = self.regions().into_iter().flat_map(|region| self.blocks_of(region));
        blocks
            .filter(|(_, block)| block.is_observed())
            .map(move |(index, block)| ObservedBlock {
                index,
                center: (index.first_voxel() + BLOCK_EDGE / 2).as_dvec3() * voxel_size_m,
                block,
            })
    }

    /// All voxels that were observed, block by block, in an order that does not depend on how the map was made.
    ///
    /// ```
    /// use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3};
    /// let mut map = VoxelMap::new(MapConfig::default())?;
    /// Raycast::default().integrate(&mut map, &Scan { points: vec![Vec3::new(4.0, 0.0, 0.0)], pose: Some(Pose::IDENTITY), ..Default::default() })?;
    /// assert_eq!(map.voxels().count(), map.observed_voxel_count());
    /// assert!(map.voxels().all(|v| (v.center.x - 4.0).abs() < 0.25 && v.distance_m.abs() <= 0.2));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn voxels(&self) -> impl Iterator<Item = ObservedVoxel> {
        let (grid, truncation_m) = (self.grid(), self.config.truncation_m as f32);
        self.blocks().flat_map(move |ObservedBlock { index, block, .. }| {
            (0..).zip(&block.voxels).filter_map(move |(number, voxel)| {
                let index = voxel_at(index, number);
                Some(ObservedVoxel {
                    index,
                    center: grid.center(index),
                    distance_m: truncation_m * voxel.distance()?,
                    weight: voxel.weight(),
                })
            })
        })
    }

    /// The smallest box of whole blocks around all that was observed: its lowest and its highest corner (world, metres). `None` if
    /// nothing was observed.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let blocks = self.blocks().map(|block| (block.index.0, block.index.0));
        let (low, high) = blocks.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        let edge_m = f64::from(BLOCK_EDGE) * self.config.voxel_size_m;
        Some((low.as_dvec3() * edge_m, (high + 1).as_dvec3() * edge_m))
    }
}
