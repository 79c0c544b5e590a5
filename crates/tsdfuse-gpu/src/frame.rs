//! The parameters of a dispatch: `shaders/frame.wgsl` has the same layout.

use bytemuck::{Pod, Zeroable};
use glam::DMat3;
use tsdfuse::{Scan, VoxelMap, fuse::FuseError};

/// What a dispatch needs to know about its scan.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Frame {
    pub(crate) world_x: [f32; 3],
    pub(crate) mode: u32,
    pub(crate) world_y: [f32; 3],
    pub(crate) first: u32,
    pub(crate) world_z: [f32; 3],
    pub(crate) count: u32,
    pub(crate) anchor_voxel: [i32; 3],
    pub(crate) stamp: u32,
    pub(crate) anchor_fraction: [f32; 3],
    pub(crate) voxels_per_m: f32,
    pub(crate) truncation_vox: f32,
    pub(crate) max_weight_sum: u32,
    pub(crate) heavy_sum: u32,
    pub(crate) times_at: u32,
    pub(crate) segments_at: u32,
    pub(crate) segments: u32,
    pub(crate) rings_at: u32,
    pub(crate) rings: u32,
    pub(crate) columns: u32,
    pub(crate) max_range_m: f32,
    pub(crate) min_dot: f32,
    pub(crate) total: u32,
    pub(crate) window_m: f32,
    pub(crate) noise_m: f32,
    pub(crate) step_m: f32,
    pub(crate) max_gap_m: f32,
    pub(crate) column_rad: f32,
    pub(crate) columns_per_rad: f32,
    pub(crate) gaps_at: u32,
    pub(crate) nearest_at: u32,
    pub(crate) towards_at: u32,
    pub(crate) top: f32,
    pub(crate) per_pitch: f32,
    pub(crate) crowd: f32,
    pub(crate) neighbour_cells: u32,
    pub(crate) unused: [u32; 3],
    pub(crate) camera: [f32; 4],
}

/// Mode: creates the blocks of the voxels that will be updated.
pub(crate) const ALLOCATE: u32 = 0;
/// Mode: updates these voxels.
pub(crate) const FUSE: u32 = 1;

impl Frame {
    /// Where a scan is in a map's grid.
    pub(crate) fn of(scan: &Scan, map: &VoxelMap) -> Result<Self, FuseError> {
        let pose = scan.world_from_sensor()?;
        let position = pose.translation;
        let anchor = map.grid().anchor(position).ok_or_else(|| FuseError::OutsideGrid {
            scan: scan.name.clone(),
            position,
        })?;
        let (voxel, fraction) = anchor.split();
        let world = DMat3::from_quat(pose.rotation).as_mat3();
        Ok(Self {
            world_x: world.x_axis.into(),
            world_y: world.y_axis.into(),
            world_z: world.z_axis.into(),
            anchor_voxel: voxel.into(),
            anchor_fraction: fraction.as_vec3().into(),
            voxels_per_m: (1.0 / map.config().voxel_size_m) as f32,
            truncation_vox: map.config().truncation_vox(),
            max_weight_sum: map.config().max_weight_sum(),
            ..Self::default()
        })
    }
}
