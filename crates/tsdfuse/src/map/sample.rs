//! The field at any point: signed distance, gradient and weight.

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use super::{
    block::{Block, Voxel},
    recent::Recent,
    voxel_map::VoxelMap,
};
use crate::{
    index::{BLOCK_EDGE, BLOCK_VOXELS, BlockIndex, GridPoint, local_number},
    trilinear::{Corners, slope, trilinear},
};

/// What a map holds at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The signed distance to the nearest surface, metres: positive on the side that the sensor saw it from, negative behind it, and
    /// at most [`truncation_m`](super::MapConfig::truncation_m) in magnitude.
    pub distance_m: f32,
    /// The gradient of the distance, metres per metre, world axes. Near a surface it is about a unit vector and points to free space;
    /// where distances are truncated it goes to zero. It is exactly the slope of the interpolated distance, so it changes
    /// abruptly at the planes through voxel centres.
    pub gradient: Vec3,
    /// The accumulated weight W.
    pub weight: f32,
}

impl VoxelMap {
    /// The field at a point (world, metres), interpolated trilinearly between the eight voxel centres around it.
    ///
    /// Voxel i covers [iκ, (i+1)κ) along each axis, κ being [`voxel_size_m`](super::MapConfig::voxel_size_m), and its value belongs to
    /// its centre, (i+½)κ:
    ///
    /// ```text
    ///      voxel i        voxel i+1
    ///   |──────●───────|───────●──────|      between the two ● the field is linear
    ///   iκ   (i+½)κ  (i+1)κ  (i+1½)κ
    /// ```
    ///
    /// `None` if any of the eight voxels was never observed, as well as outside of the grid and for coordinates that are not finite:
    /// no distance is made up. So the field ends half a voxel or more inside of what was observed.
    ///
    /// For many points, [`Self::sample_all`] is faster.
    ///
    /// ```
    /// use tsdfuse::{Integrator, MapConfig, Patch, Pose, Scan, VoxelMap, glam::{DVec3, Vec3}};
    /// # let wall = (-30..30).flat_map(|y| (-20..20).map(move |z| Vec3::new(4.02, 0.03 * y as f32, 0.03 * z as f32)));
    /// let mut map = VoxelMap::new(MapConfig::default())?;
    /// Patch::default().integrate(&mut map, &Scan { points: wall.collect(), pose: Some(Pose::IDENTITY), ..Default::default() })?; // a wall at x = 4.02 m
    ///
    /// let here = map.sample(DVec3::new(4.0, 0.1, 0.1)).ok_or("nothing is known here")?;
    /// assert!((here.distance_m - 0.02).abs() < 0.003); // 2 cm in front of the wall
    /// assert!((here.gradient + Vec3::X).length() < 0.1); // away from it
    /// assert_eq!(map.sample(DVec3::ZERO), None);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn sample(&self, point: DVec3) -> Option<Sample> {
        self.sample_from(point, |index| self.block(index))
    }

    /// [`Self::sample`] at many points, in parallel, with one entry per point. It is fastest if points that follow each other are
    /// near each other. The result does not depend on the number of threads.
    pub fn sample_all(&self, points: &[DVec3]) -> Vec<Option<Sample>> {
        let sampled = points.par_iter().with_min_len(256).map_init(
            || Recent::new(self),
            |recent, &point| self.sample_from(point, |index| recent.block(index)),
        );
        sampled.collect()
    }

    #[inline]
    fn sample_from<'a>(&self, point: DVec3, block: impl FnMut(BlockIndex) -> Option<&'a Block>) -> Option<Sample> {
        let GridPoint { voxel, fraction } = self.grid().cell(point)?;
        let corners = corners(voxel, block)?;
        let distances = corners.map(|voxel| voxel.distance_sum as f32 / voxel.weight_sum as f32);
        let truncation_m = self.config.truncation_m as f32;
        Some(Sample {
            distance_m: truncation_m * trilinear(&distances, fraction),
            gradient: self.config.truncation_vox() * slope(&distances, fraction),
            weight: trilinear(&corners.map(Voxel::weight), fraction),
        })
    }
}

/// The voxels at the corners of a cell, if all of them were observed.
#[inline]
fn corners<'a>(first: IVec3, mut block: impl FnMut(BlockIndex) -> Option<&'a Block>) -> Option<Corners<Voxel>> {
    let mut corners = [Voxel::default(); 8];
    if (first & (BLOCK_EDGE - 1)).max_element() < BLOCK_EDGE - 1 {
        let block = block(BlockIndex::of(first))?;
        let first = local_number(first);
        for (corner, offset) in corners.iter_mut().zip([0, 1, 8, 9, 64, 65, 72, 73]) {
            *corner = block.voxels[(first + offset) % BLOCK_VOXELS];
        }
    } else {
        for (c, corner) in (0..8).zip(&mut corners) {
            let voxel = first + IVec3::new(c & 1, c >> 1 & 1, c >> 2);
            *corner = block(BlockIndex::of(voxel))?.voxels[local_number(voxel)];
        }
    }
    corners.iter().all(|voxel| voxel.weight_sum > 0).then_some(corners)
}
