//! Layers as arrays.

use tsdfuse::glam::IVec3;

use crate::error::PlanError;

/// The box of voxels that holds all that is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense<T> {
    /// The voxel at the lowest corner.
    pub low: IVec3,
    /// Voxels along x, y, z.
    pub size: [usize; 3],
    /// Values, x slowest.
    pub values: Vec<T>,
}

/// An array has no more voxels than this.
const MOST: usize = 1 << 31;

impl<T: Clone> Dense<T> {
    /// The box around known voxels, each with its value; what is not among them has the value `unknown`. `visit` calls for each of
    /// them, and is called twice. Nothing is known: a box without voxels.
    pub(crate) fn of(unknown: T, visit: impl Fn(&mut dyn FnMut(IVec3, T))) -> Result<Self, PlanError> {
        let mut bounds = None;
        visit(&mut |voxel, _| {
            let (low, high) = bounds.unwrap_or((voxel, voxel));
            bounds = Some((voxel.min(low), voxel.max(high)));
        });
        let Some((low, high)) = bounds else {
            let (low, values) = (IVec3::ZERO, Vec::new());
            return Ok(Self {
                low,
                size: [0; 3],
                values,
            });
        };
        let size = (high.as_i64vec3() - low.as_i64vec3() + 1)
            .to_array()
            .map(|edge| edge as usize);
        let count = size.iter().try_fold(1_usize, |count, edge| count.checked_mul(*edge));
        let Some(count) = count.filter(|count| *count <= MOST) else {
            let voxels = size.iter().map(|edge| *edge as f64).product();
            let wanted = "an array of no more than 2,147,483,648 voxels: a part of it, or larger voxels";
            return Err(PlanError::new("voxels", voxels, wanted));
        };
        let mut values = vec![unknown; count];
        visit(&mut |voxel, value| {
            let at = (voxel - low).to_array().map(|i| i as usize);
            values[(at[0] * size[1] + at[1]) * size[2] + at[2]] = value;
        });
        Ok(Self { low, size, values })
    }

    /// The value of a voxel; `None` outside of the box.
    pub fn get(&self, voxel: IVec3) -> Option<&T> {
        let at = voxel.checked_sub(self.low)?.to_array();
        let is_inside = at
            .iter()
            .zip(self.size)
            .all(|(i, size)| usize::try_from(*i).is_ok_and(|i| i < size));
        let [x, y, z] = at.map(|i| i as usize);
        is_inside.then(|| &self.values[(x * self.size[1] + y) * self.size[2] + z])
    }
}
