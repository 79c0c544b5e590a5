//! Comparing maps with what literal implementations find.

#![allow(clippy::unwrap_used, dead_code)] // test helpers; not every test needs all of them

use std::collections::BTreeMap;

use tsdfuse::{
    Pose, Scan, VoxelMap,
    glam::{DQuat, DVec3, EulerRot},
    index::voxel_at,
};

/// Weight and distance over μ of each observed voxel.
pub(crate) type Voxels = BTreeMap<[i32; 3], (f64, f64)>;

/// A scan of a room of 6 × 5 × 3 m from somewhere inside it, tilted.
pub(crate) fn scan(number: usize, rays: usize) -> Scan {
    let n = number as f64;
    let pose = Pose {
        rotation: DQuat::from_euler(EulerRot::XYZ, 0.1 * n, -0.07 * n, 0.5 * n),
        translation: DVec3::new(0.3 * n - 0.5, 0.2 * n - 0.4, 0.1 * n),
    };
    let half = DVec3::new(3.0, 2.5, 1.5);
    let points = (0..rays).map(|i| {
        // Fibonacci's sphere.
        let z = 1.0 - 2.0 * (i as f64 + 0.5) / rays as f64;
        let (sin, cos) = (i as f64 * 2.399_963_229_728_653).sin_cos();
        let direction = DVec3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z);
        let in_world = pose.rotation * direction;
        let wall = in_world.signum() * half;
        let range = ((wall - pose.translation) / in_world).min_element();
        let noise = 0.02 * ((i * 7919 + number * 104_729) % 1000) as f64 / 1000.0;
        (direction * (range + noise)).as_vec3()
    });
    Scan {
        name: format!("scan {number}"),
        points: points.collect(),
        pose: Some(pose),
        ..Default::default()
    }
}

/// The observed voxels of a map.
pub(crate) fn observed(map: &VoxelMap) -> Voxels {
    let mut all = BTreeMap::new();
    for index in map.block_indices() {
        for (local, voxel) in map.block(index).unwrap().voxels.iter().enumerate() {
            if let Some(f) = voxel.distance() {
                all.insert(
                    voxel_at(index, local).to_array(),
                    (f64::from(voxel.weight()), f64::from(f)),
                );
            }
        }
    }
    all
}

/// The share of voxels that differ: present in one map only, or apart by more than the fixed point's rounding (half a unit of
/// 1/32768 per update, in the weight and in the weighted distance). Looks from both sides.
pub(crate) fn differing(a: &Voxels, b: &Voxels) -> f64 {
    let apart = |v: &[i32; 3], (wa, fa): &(f64, f64)| {
        b.get(v)
            .is_none_or(|(wb, fb)| (wa - wb).abs() > 1e-3 * wb + 1e-4 || (fa - fb).abs() > 1e-3 + 1e-4 / wb)
    };
    let from_a = a.iter().filter(|(v, x)| apart(v, x)).count();
    let only_in_b = b.keys().filter(|v| !a.contains_key(*v)).count();
    (from_a + only_in_b) as f64 / a.len().max(b.len()) as f64
}

/// Asserts that at most `share` of the voxels differ between the map and the literal result, and that the comparison sees lost
/// voxels, additional ones and wrong distances.
pub(crate) fn assert_agrees(map: &VoxelMap, literal: &Voxels, share: f64, what: &str) {
    // Weights too small for the fixed point are no updates.
    let heavy = |voxels: Voxels| -> Voxels { voxels.into_iter().filter(|(_, (w, _))| *w > 1e-4).collect() };
    let (fast, slow) = (heavy(observed(map)), heavy(literal.clone()));
    let differ = differing(&fast, &slow);
    assert!(
        differ < share,
        "{what}: {differ} of {} and {} voxels differ",
        fast.len(),
        slow.len()
    );
    let stride = (0.5 / share.max(1e-3)) as usize;
    let fewer: Voxels = (fast.clone().into_iter().enumerate())
        .filter(|(i, _)| i % stride != 0)
        .map(|(_, voxel)| voxel)
        .collect();
    assert!(differing(&fewer, &slow) > share && differing(&slow, &fewer) > share);
    let moved = fast.iter().map(|(v, (w, f))| (*v, (*w, f + 0.01))).collect();
    assert!(differing(&moved, &slow) > 0.9);
}
