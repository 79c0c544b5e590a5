//! The rays of a scan, in voxels.

use rayon::prelude::*;
use tsdfuse::Scan;
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::scan::ScanError;

use crate::marks::Marks;

/// Farther from the origin, in voxels, voxels have no number.
const FAR: f64 = 1e9;

/// The rays of a scan, each from where the sensor was at its time.
pub(crate) struct Rays {
    /// Both ends, in voxels; `None` for those that leave the grid.
    ends: Vec<Option<[DVec3; 2]>>,
    /// The voxel of each return within range.
    pub(crate) hits: Vec<Option<IVec3>>,
}

impl Rays {
    /// The rays, followed up to a range in metres.
    pub(crate) fn of(scan: &Scan, voxel_size_m: f64, max_range_m: f64) -> Result<Self, ScanError> {
        let ray = |(pose, point): (tsdfuse::Pose, &Vec3)| {
            let (from, way) = (pose.translation, pose.rotation * point.as_dvec3());
            let share = (max_range_m / way.length()).min(1.0);
            let ends = [from, from + way * share].map(|end| end / voxel_size_m);
            // Also false for NaN.
            let is_inside = ends.iter().all(|end| end.abs().max_element() < FAR);
            let hit = (is_inside && share == 1.0).then(|| ends[1].floor().as_ivec3());
            (is_inside.then_some(ends), hit)
        };
        let (ends, hits) = scan.poses()?.zip(&scan.points).map(ray).unzip();
        Ok(Self { ends, hits })
    }

    /// What they pass through and where they end. The union does not depend on how rays are divided among threads.
    pub(crate) fn marks(&self) -> Marks {
        let each = self.ends.len().div_ceil(rayon::current_num_threads()).max(1);
        let parts = self.ends.par_chunks(each).zip(self.hits.par_chunks(each));
        let marks = parts.map(|(ends, hits)| {
            let mut marks = Marks::default();
            for (ends, hit) in ends.iter().zip(hits) {
                if let Some([from, to]) = ends {
                    marks.ray(*from, *to, hit.is_some());
                }
            }
            marks
        });
        marks.reduce(Marks::default, Marks::merged)
    }
}
