//! Comparing maps of two devices.
//!
//! Sums are integers on both sides, but what is summed is not: compilers of kernels may fuse or reorder operations, and returns
//! are placed in f32. So a distance may be off by a little, and a voxel at the rim of what a return touches may be in or out.
//! Hence two numbers: how far voxels may be apart, and what share of them may be farther.

use std::collections::BTreeMap;

use tsdfuse::{VoxelMap, index::voxel_at, map::Voxel};

/// What is tolerated.
#[derive(Clone, Copy)]
pub(crate) struct Tolerance {
    /// Largest difference of F.
    pub(crate) distance: f64,
    /// Largest relative difference of W.
    pub(crate) weight: f64,
    /// The share of voxels that may differ more, or be there on one side only.
    pub(crate) share: f64,
}

/// 100 m away, f32 knows a place to 1/4000 voxel, 1/16000 of the truncation.
pub(crate) const ROUNDING: Tolerance = Tolerance {
    distance: 2e-4,
    weight: 1e-3,
    share: 2e-4,
};

/// A plane may be one on one side only, where it is nearly none.
pub(crate) const PLANES: Tolerance = Tolerance {
    share: 1e-3,
    ..ROUNDING
};

pub(crate) type Voxels = BTreeMap<[i32; 3], Voxel>;

pub(crate) fn voxels(map: &VoxelMap) -> Voxels {
    let indices = map.block_indices().into_iter();
    let voxels = indices.flat_map(|index| {
        let voxels = map.block(index).unwrap().voxels.iter().enumerate();
        voxels.map(move |(local, &v)| (voxel_at(index, local).to_array(), v))
    });
    voxels.filter(|(_, v)| v.weight_sum > 0).collect()
}

/// The share of voxels that differ by more than the tolerance, or that only one side has.
pub(crate) fn differing(a: &Voxels, b: &Voxels, tolerance: Tolerance) -> f64 {
    let apart = |place: &[i32; 3], a: &Voxel| {
        b.get(place).is_none_or(|b| {
            let (wa, wb) = (f64::from(a.weight_sum), f64::from(b.weight_sum));
            let (fa, fb) = (f64::from(a.distance_sum) / wa, f64::from(b.distance_sum) / wb);
            // An update is rounded to half a unit of its sums.
            let unit = 4.0 / wa.min(wb);
            (wa - wb).abs() > tolerance.weight * wb + 4.0 || (fa - fb).abs() > tolerance.distance + unit
        })
    };
    let from_a = a.iter().filter(|(place, v)| apart(place, v)).count();
    let only_in_b = b.keys().filter(|place| !a.contains_key(*place)).count();
    (from_a + only_in_b) as f64 / a.len().max(b.len()) as f64
}

/// Asserts that two maps agree, looking from both sides, and that the comparison would see it if they did not.
pub(crate) fn assert_agrees(device: &VoxelMap, cpu: &VoxelMap, tolerance: Tolerance, what: &str) {
    let (a, b) = (voxels(device), voxels(cpu));
    let share = differing(&a, &b, tolerance);
    eprintln!("{what}: {share:.2e} of {} voxels differ", b.len());
    assert!(
        share <= tolerance.share,
        "{what}: {share} of {} and {} voxels differ",
        a.len(),
        b.len()
    );
    let (blocks, want) = (device.block_indices(), cpu.block_indices());
    let missing = want.iter().filter(|b| blocks.binary_search(b).is_err()).count();
    let extra = blocks.iter().filter(|b| want.binary_search(b).is_err()).count();
    eprintln!(
        "{what}: {missing} of {} blocks are missing, {extra} too many",
        want.len()
    );
    // A voxel at the rim may be its block's only one.
    assert!(
        (missing + extra) as f64 <= (tolerance.share * want.len() as f64).max(2.0),
        "{what}: blocks"
    );

    // Lost voxels are seen from both sides, and a distance that is a little off, and a weight.
    let every = (0.2 / tolerance.share) as usize;
    let fewer: Voxels = a
        .iter()
        .enumerate()
        .filter(|(i, _)| i % every != 0)
        .map(|(_, (p, v))| (*p, *v))
        .collect();
    assert!(differing(&fewer, &b, tolerance) > tolerance.share || a.len() < every);
    assert!(differing(&b, &fewer, tolerance) > tolerance.share || a.len() < every);
    let moved = |distance: f64, weight: f64| -> Voxels {
        // Beyond what is allowed for rounding, of which voxels of little weight have most.
        let rounding = if distance > 0.0 { 8.0 } else { 0.0 };
        let off = |v: &Voxel| Voxel {
            weight_sum: (f64::from(v.weight_sum) * weight) as u32 + 1,
            distance_sum: (f64::from(v.distance_sum) * weight + distance * f64::from(v.weight_sum) + rounding) as i32,
        };
        a.iter().map(|(p, v)| (*p, off(v))).collect()
    };
    assert!(differing(&moved(10.0 * tolerance.distance, 1.0), &b, tolerance) > 0.5);
    assert!(differing(&moved(0.0, 1.0 + 10.0 * tolerance.weight), &b, tolerance) > 0.5);
}
