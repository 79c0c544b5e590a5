//! Maps with other voxels, moved and turned.

use proptest::prelude::*;
use tsdfuse::{
    MapConfig, Pose, VoxelMap,
    glam::{DQuat, DVec3, EulerRot, IVec3},
    index::{BlockIndex, voxel_at},
    map::Block,
};

/// A map of what `distance` says (metres, positive in free space), within a band of `band_m`.
fn map_of(band_m: f64, distance: impl Fn(DVec3) -> f64) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let cube = || -5..5;
    for (z, y, x) in cube().flat_map(|z| cube().flat_map(move |y| cube().map(move |x| (z, y, x)))) {
        let index = BlockIndex(IVec3::new(x, y, z));
        let mut block = Block::EMPTY;
        for (number, voxel) in block.voxels.iter_mut().enumerate() {
            let d = distance(map.grid().center(voxel_at(index, number)));
            if d.abs() <= band_m {
                voxel.weight_sum = 30_000 + 17 * number as u32;
                voxel.distance_sum = (d / 0.2 * f64::from(voxel.weight_sum)).round() as i32;
            }
        }
        if block.is_observed() {
            map.insert_block(index, block).unwrap();
        }
    }
    map
}

/// Errors of voxels within a metre and a half of the origin, metres: the largest of those within 5 cm of the surface, the
/// largest of all; and how many there are.
fn error(map: &VoxelMap, distance: impl Fn(DVec3) -> f64) -> ([f64; 2], usize) {
    let (mut worst, mut count) = ([0.0f64; 2], 0);
    for index in map.block_indices() {
        for (number, voxel) in map.block(index).unwrap().voxels.iter().enumerate() {
            let place = map.grid().center(voxel_at(index, number));
            if let Some(f) = voxel.distance().filter(|_| place.abs().max_element() < 1.5) {
                let truncation = map.config().truncation_m;
                let off = (f64::from(f) * truncation - distance(place).clamp(-truncation, truncation)).abs();
                worst[1] = worst[1].max(off);
                if distance(place).abs() < 0.05 {
                    worst[0] = worst[0].max(off);
                }
                assert!((29_999..=39_000).contains(&voxel.weight_sum), "{voxel:?}");
                count += 1;
            }
        }
    }
    (worst, count)
}

fn plane(p: DVec3) -> f64 {
    DVec3::new(0.48, -0.6, 0.64).dot(p) - 0.1
}

fn sphere(p: DVec3) -> f64 {
    p.length() - 1.2
}

fn moved() -> Pose {
    Pose {
        rotation: DQuat::from_euler(EulerRot::XYZ, 0.4, -0.3, 1.1),
        translation: DVec3::new(0.013, -0.171, 0.2),
    }
}

#[test]
fn a_plane_stays_a_plane() {
    for band in [0.19, 0.07] {
        let map = map_of(band, plane);
        for size in [0.02, 0.04, 0.05, 0.06, 0.1] {
            let ([_, worst], count) = error(&map.resampled(size).unwrap(), plane);
            // All voxels of the band, and no more than one voxel beside it.
            let whole = 9.0 * 2.0 * band / size.powi(3);
            assert!(count as f64 > 0.9 * whole, "{band} {size}: {count} of {whole}");
            assert!(worst < 3e-4, "{band} {size}: {worst}");
        }
        let (turned, exact) = map.transformed(&moved()).unwrap();
        let back = |p| plane(moved().inverse().transform_point(p));
        let ([_, worst], count) = error(&turned, back);
        assert!(!exact && count > 10_000 && worst < 3e-4, "{band}: {worst} {count}");
    }
}

#[test]
fn a_sphere_errs_by_what_its_curvature_makes() {
    let map = map_of(0.19, sphere);
    // A function with second derivative 1/R along two axes, taken for a linear one over ± h, is off by h²/6R at most along each; at the
    // border of the band, where it is extended from one side over ± 2h, by several times as much.
    for (size, limits) in [(0.025, [0.5e-3, 6e-3]), (0.05, [1e-5, 1e-5]), (0.1, [2.2e-3, 20e-3])] {
        let (worst, count) = error(&map.resampled(size).unwrap(), sphere);
        assert!(
            worst[0] < limits[0] && worst[1] < limits[1] && count > 5000,
            "{size}: {worst:?} of {count}"
        );
    }
    let center = moved().translation;
    let (worst, count) = error(&map.transformed(&moved()).unwrap().0, |p| (p - center).length() - 1.2);
    assert!(
        worst[0] < 1e-3 && worst[1] < 6e-3 && count > 20_000,
        "{worst:?} of {count}"
    );
    // And a wrong answer would be seen.
    assert!(error(&map, |p| (p - center).length() - 1.2).0[0] > 0.1);
}

#[test]
fn the_same_voxels_stay_the_same_bits() {
    let map = map_of(0.19, sphere);
    assert!(map.resampled(0.05).unwrap() == map);
    assert!(
        map.resampled(0.001)
            .unwrap_err()
            .to_string()
            .contains("between 1 and 64 voxels")
    );
}

#[test]
fn quarter_turns_and_whole_voxels_renumber_and_come_back() {
    let map = map_of(0.19, |p| (p - DVec3::new(0.3, 0.1, -0.2)).length() - 0.9);
    let half = std::f64::consts::FRAC_PI_2;
    let mut turned = 0;
    for (x, y, z) in (0..4).flat_map(|x| (0..4).flat_map(move |y| (0..4).map(move |z| (x, y, z)))) {
        let [x, y, z] = [x, y, z].map(|quarters| f64::from(quarters) * half);
        let pose = Pose {
            rotation: DQuat::from_euler(EulerRot::XYZ, x, y, z),
            translation: DVec3::new(691_000.05, -3.2, 0.35),
        };
        let (there, exact) = map.transformed(&pose).unwrap();
        assert!(exact);
        let center = pose.transform_point(DVec3::new(0.3, 0.1, -0.2));
        let index = there.block_indices()[there.block_count() / 2];
        let (number, voxel) = (0..)
            .zip(&there.block(index).unwrap().voxels)
            .find(|(_, v)| v.weight_sum > 0)
            .unwrap();
        let d = there.grid().center(voxel_at(index, number)).distance(center) - 0.9;
        assert!((f64::from(voxel.distance().unwrap()) * 0.2 - d).abs() < 1e-5);
        let (back, exact) = there.transformed(&pose.inverse()).unwrap();
        assert!(exact && back == map);
        turned += usize::from(there != map);
    }
    assert_eq!(turned, 64);
    let far = Pose {
        translation: DVec3::X * 1e9,
        ..Pose::IDENTITY
    };
    assert!(map.transformed(&far).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]
    #[test]
    fn motions_between_voxels_are_no_renumberings(off in 0.01..0.99f64, angle in 0.01..1.5f64) {
        let map = VoxelMap::new(MapConfig::default()).unwrap();
        let shift = Pose { translation: DVec3::Y * 0.05 * off, ..Pose::IDENTITY };
        let turn = Pose { rotation: DQuat::from_rotation_z(angle), ..Pose::IDENTITY };
        prop_assert!(!map.transformed(&shift).unwrap().1 && !map.transformed(&turn).unwrap().1);
    }
}
