//! A box of the map as plain arrays.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::{error::MapError, recent::Recent, voxel_map::VoxelMap};

/// The most voxels that a dense box can have: 4 GiB of distances, and as much of weights.
const MAX_VOXELS: u64 = 1 << 30;

/// A box of voxels as arrays of the shape (z, y, x): `distance_m[(z * shape[1] + y) * shape[2] + x]`, x running fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense {
    /// The grid index of the first voxel, the one with the lowest coordinates.
    pub first: IVec3,
    /// The centre of the first voxel in the world, metres; the others follow at multiples of `voxel_size_m`.
    pub origin: DVec3,
    /// The edge of a voxel.
    pub voxel_size_m: f64,
    /// How many voxels there are along z, y and x.
    pub shape: [usize; 3],
    /// The signed distance at each voxel's centre, metres, as in [`Sample`](super::Sample); NaN where nothing was observed.
    pub distance_m: Vec<f32>,
    /// The accumulated weight of each voxel; 0 where nothing was observed.
    pub weight: Vec<f32>,
}

impl VoxelMap {
    /// The voxels whose centres lie in a box (world, metres; `low` included, `high` not), observed or not. For all that was
    /// observed, take [`Self::bounds`].
    ///
    /// # Errors
    /// [`MapError::Box`] if no point lies in the box, [`MapError::Dense`] if it has more than 2³⁰ voxels or there is no memory for them.
    pub fn dense(&self, low: DVec3, high: DVec3) -> Result<Dense, MapError> {
        let (first, end) = self
            .grid()
            .voxels_within(low, high)
            .ok_or(MapError::Box { low, high })?;
        let size = (end.as_i64vec3() - first.as_i64vec3()).as_u64vec3();
        let voxels = u128::from(size.x) * u128::from(size.y) * u128::from(size.z);
        if voxels > u128::from(MAX_VOXELS) {
            return Err(MapError::Dense { voxels });
        }
        let filled = |value: f32| {
            let mut all = Vec::new();
            let room = all.try_reserve_exact(voxels as usize);
            room.map_err(|_| MapError::Dense { voxels })?;
            all.resize(voxels as usize, value);
            Ok::<_, MapError>(all)
        };
        let shape = [size.z, size.y, size.x].map(|n| n as usize);
        let mut dense = Dense {
            first,
            origin: self.grid().center(first),
            voxel_size_m: self.config.voxel_size_m,
            shape,
            distance_m: filled(f32::NAN)?,
            weight: filled(0.0)?,
        };
        let truncation_m = self.config.truncation_m as f32;
        let row = shape[2].max(1);
        let rows = dense
            .distance_m
            .par_chunks_mut(row)
            .zip(dense.weight.par_chunks_mut(row));
        rows.enumerate().with_min_len(64).for_each_init(
            || Recent::new(self),
            |recent, (number, (distances, weights))| {
                let start = first + IVec3::new(0, (number % shape[1]) as i32, (number / shape[1]) as i32);
                for (x, (to_distance, to_weight)) in (0..).zip(distances.iter_mut().zip(weights)) {
                    let voxel = recent.voxel(start + IVec3::new(x, 0, 0));
                    if let Some(distance) = voxel.distance() {
                        (*to_distance, *to_weight) = (truncation_m * distance, voxel.weight());
                    }
                }
            },
        );
        Ok(dense)
    }
}
