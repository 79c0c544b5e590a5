//! One scan as kernels see it: `shaders/frame.wgsl` has the same layout.

use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DQuat, Vec3};
use tsdfuse::{Scan, VoxelMap, fuse::FuseError};

use crate::device::GpuError;

/// What a dispatch is told of the scan.
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
    pub(crate) turn_axis: [f32; 3],
    pub(crate) turn_rate: f32,
    pub(crate) velocity: [f32; 3],
    pub(crate) truncation_vox: f32,
    pub(crate) max_weight_sum: u32,
    pub(crate) heavy_sum: u32,
    pub(crate) times_at: u32,
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
    pub(crate) camera: [f32; 4],
}

/// Makes the blocks of voxels that will be updated.
pub(crate) const ALLOCATE: u32 = 0;
/// Updates voxels.
pub(crate) const FUSE: u32 = 1;

impl Frame {
    /// Where a scan is in a map's grid, and how its sensor moves.
    pub(crate) fn of(scan: &Scan, map: &VoxelMap) -> Result<Self, GpuError> {
        let pose = scan.world_from_sensor().map_err(FuseError::from)?;
        let position = pose.translation;
        let anchor = map.grid().anchor(position).ok_or_else(|| FuseError::OutsideGrid {
            scan: scan.name.clone(),
            position,
        })?;
        let (voxel, fraction) = anchor.split();
        let world = DMat3::from_quat(pose.rotation).as_mat3();
        let mut frame = Self {
            world_x: world.x_axis.into(),
            world_y: world.y_axis.into(),
            world_z: world.z_axis.into(),
            anchor_voxel: voxel.into(),
            anchor_fraction: fraction.as_vec3().into(),
            voxels_per_m: (1.0 / map.config().voxel_size_m) as f32,
            truncation_vox: map.config().truncation_vox(),
            max_weight_sum: map.config().max_weight_sum(),
            ..Self::default()
        };
        if let (Some(sweep), [motion, more @ ..]) = (scan.sweep(), scan.motion.as_slice()) {
            if !more.is_empty() {
                let several = "a sweep with more than one further pose".to_owned();
                return Err(GpuError::Unsupported(several));
            }
            let (rotation, shift) = sweep.relative_at(motion.secs);
            let (axis, angle) = rotation_vector(pose.rotation.conjugate() * rotation);
            frame.turn_axis = axis.into();
            frame.turn_rate = (angle / motion.secs) as f32;
            frame.velocity = (shift / motion.secs).as_vec3().into();
        }
        Ok(frame)
    }
}

/// Axis and angle of a rotation, the shorter way.
fn rotation_vector(turn: DQuat) -> (Vec3, f64) {
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let sin_half = turn.xyz().length();
    let axis = (turn.xyz() / sin_half.max(f64::MIN_POSITIVE)).as_vec3();
    (axis, 2.0 * sin_half.atan2(turn.w))
}
