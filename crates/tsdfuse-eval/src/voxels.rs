//! Down-sampling to one point per voxel, like Open3D's `voxel_down_sample`.

use rayon::prelude::*;
use tsdfuse::glam::DVec3;

use crate::bounds::Bounds;

/// The mean of the points of each voxel, in the order of the voxels. The grid starts half a voxel below the
/// smallest coordinates, as in Open3D.
pub(crate) fn down_sample(points: &[DVec3], voxel_m: f64) -> Vec<DVec3> {
    let Some(bounds) = Bounds::of(points) else {
        return Vec::new();
    };
    let origin = bounds.min - voxel_m / 2.0;
    let voxel = |p: DVec3| ((p - origin) / voxel_m).floor().as_i64vec3().to_array();
    let mut numbered: Vec<_> = (0_u32..).zip(points).map(|(i, &p)| (voxel(p), i)).collect();
    numbered.par_sort_unstable();
    let mean =
        |voxel: &[([i64; 3], u32)]| voxel.iter().map(|&(_, i)| points[i as usize]).sum::<DVec3>() / voxel.len() as f64;
    numbered.chunk_by(|a, b| a.0 == b.0).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_voxel_becomes_the_mean_of_its_points() {
        let at = |x: f64| DVec3::new(x, 0.0, 0.0);
        // The grid begins at -0.5: voxels end at 0.5, 1.5, …
        let sampled = down_sample(&[at(3.0), at(0.0), at(0.4), at(0.6), at(1.4), at(1.6)], 1.0);
        let expected = [at(0.2), at(1.0), at(1.6), at(3.0)];
        assert_eq!(sampled.len(), 4);
        assert!(
            sampled.iter().zip(expected).all(|(a, b)| a.distance(b) < 1e-12),
            "{sampled:?}"
        );
        assert!(down_sample(&[], 1.0).is_empty());
    }
}
