//! What a map answers: distances at points, all that was observed, a box as arrays. Against eight look-ups a point, and against planes and
//! balls whose distances are known.

use proptest::prelude::*;
use tsdfuse::{
    Integrator, MapConfig, Patch, Pose, Scan, VoxelMap,
    glam::{DVec3, IVec3, Vec3},
    index::{BlockIndex, voxel_at},
    map::{Block, MapError, Sample, Voxel, WEIGHT_SCALE},
};

/// Blocks about the origin, on both sides of it along each axis, with a distance (metres) and a weight at each voxel's centre.
fn map_of(distance_m: impl Fn(DVec3) -> f64, weight: impl Fn(IVec3) -> u32) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let truncation_m = map.config().truncation_m;
    for n in 0..64 {
        let index = BlockIndex(IVec3::new(n & 3, n >> 2 & 3, n >> 4) - 2);
        let mut block = Block::EMPTY;
        for (local, voxel) in block.voxels.iter_mut().enumerate() {
            let at = voxel_at(index, local);
            let weight_sum = weight(at) * WEIGHT_SCALE;
            let f = (distance_m(map.grid().center(at)) / truncation_m).clamp(-1.0, 1.0);
            *voxel = Voxel {
                weight_sum,
                distance_sum: (f * f64::from(weight_sum)).round() as i32,
            };
        }
        map.insert_block(index, block).unwrap();
    }
    map
}

fn plane(p: DVec3) -> f64 {
    p.dot(DVec3::new(0.48, -0.6, 0.64)) - 0.03
}

fn ball(p: DVec3) -> f64 {
    p.distance(DVec3::new(0.1, -0.07, 0.02)) - 0.4
}

/// Eight look-ups, in `f64`: distance over μ, weight.
fn literal(map: &VoxelMap, point: DVec3) -> Option<(f64, f64)> {
    let at = point / map.config().voxel_size_m - 0.5;
    if !at.is_finite() || at.abs().max_element() > 1e9 {
        return None;
    }
    let first = at.floor();
    let s = at - first;
    let (mut f, mut weight) = (0.0, 0.0);
    for corner in 0..8 {
        let offset = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
        let voxel = map.voxel(first.as_ivec3() + offset);
        let share = DVec3::select(offset.cmpeq(IVec3::ONE), s, 1.0 - s);
        let share = share.x * share.y * share.z;
        if voxel.weight_sum == 0 {
            return None;
        }
        f += share * f64::from(voxel.distance_sum) / f64::from(voxel.weight_sum);
        weight += share * f64::from(voxel.weight_sum) / f64::from(WEIGHT_SCALE);
    }
    Some((f, weight))
}

/// The slope of [`literal`] within the cell of a point, by differences.
fn literal_gradient(map: &VoxelMap, point: DVec3) -> Vec3 {
    let (size, truncation_m) = (map.config().voxel_size_m, map.config().truncation_m);
    let cell = (point / size - 0.5).floor() + 0.5;
    let clamped = |p: DVec3| p.clamp((cell + 1e-9) * size, (cell + 1.0 - 1e-9) * size);
    let along = |axis: DVec3| {
        let (a, b) = (clamped(point - 0.01 * axis), clamped(point + 0.01 * axis));
        let [fa, fb] = [a, b].map(|p| literal(map, p).unwrap().0);
        (truncation_m * (fb - fa) / (b - a).dot(axis)) as f32
    };
    Vec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z))
}

fn check(map: &VoxelMap, point: DVec3, sample: Option<Sample>) -> Result<(), TestCaseError> {
    let expected = literal(map, point);
    prop_assert_eq!(sample.is_some(), expected.is_some(), "{}", point);
    if let (Some(sample), Some((f, weight))) = (sample, expected) {
        let distance_m = f * map.config().truncation_m;
        prop_assert!((f64::from(sample.distance_m) - distance_m).abs() < 2e-7, "{}", point);
        prop_assert!((f64::from(sample.weight) - weight).abs() < 1e-5 * weight, "{}", point);
        let off = sample.gradient - literal_gradient(map, point);
        prop_assert!(off.length() < 1e-4, "{} at {}", off, point);
    }
    Ok(())
}

/// Anywhere, at the borders of blocks, on voxel centres, and beyond the map.
fn any_point() -> impl Strategy<Value = DVec3> {
    let coordinate = prop_oneof![
        -0.9..0.9f64,
        (-40..40i32).prop_map(|i| 0.05 * f64::from(i) + 0.013),
        (-4..4i32, -0.05..0.05f64).prop_map(|(block, off)| 0.4 * f64::from(block) + off),
    ];
    prop::array::uniform3(coordinate).prop_map(DVec3::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn samples_are_those_of_eight_look_ups(points in prop::collection::vec(any_point(), 1..200), holes in 0..9u32) {
        let weight = |v: IVec3| {
            let hash = v.dot(IVec3::new(7919, 104_729, 15_485_863)) as u32 % 101;
            if hash < holes { 0 } else { 1 + hash }
        };
        let map = map_of(ball, weight);
        let all = map.sample_all(&points);
        for (&point, sample) in points.iter().zip(all) {
            prop_assert_eq!(map.sample(point), sample);
            check(&map, point, sample)?;
        }
    }
}

#[test]
fn a_plane_is_flat_and_a_ball_is_round() {
    let (flat, round) = (map_of(plane, |_| 3), map_of(ball, |_| 3));
    let points = (0..20_000).map(|i| {
        let part = |k: u32| f64::from(i * k % 1009) / 1009.0 - 0.5;
        1.5 * DVec3::new(part(7), part(31), part(101))
    });
    let (mut on_plane, mut on_ball) = (0, 0);
    for point in points {
        let sample = flat.sample(point).unwrap();
        // All eight corners within the band.
        if plane(point).abs() < 0.11 {
            on_plane += 1;
            assert!((f64::from(sample.distance_m) - plane(point)).abs() < 1e-5, "{point}");
            assert!(
                (sample.gradient - Vec3::new(0.48, -0.6, 0.64)).length() < 1e-3,
                "{point}"
            );
            assert!((sample.weight - 3.0).abs() < 1e-5);
        }
        let sample = round.sample(point).unwrap();
        if ball(point).abs() < 0.1 {
            on_ball += 1;
            let outwards = (point - DVec3::new(0.1, -0.07, 0.02)).normalize().as_vec3();
            assert!((f64::from(sample.distance_m) - ball(point)).abs() < 0.003, "{point}");
            assert!((sample.gradient - outwards).length() < 0.15, "{point}");
        } else if ball(point) > 0.3 {
            assert!(
                (sample.distance_m, sample.gradient) == (0.2, Vec3::ZERO),
                "{point}: {sample:?}"
            );
        }
    }
    assert!(on_plane > 2000 && on_ball > 2000, "{on_plane}, {on_ball}");
}

#[test]
fn at_a_voxel_s_centre_is_its_own_value() {
    let map = map_of(ball, |v| 1 + v.length_squared() as u32 % 50);
    for v in (-15..15).flat_map(|z| (-15..15).map(move |x| IVec3::new(x, -8, z))) {
        let (sample, voxel) = (map.sample(map.grid().center(v)).unwrap(), map.voxel(v));
        assert!(
            (sample.distance_m - 0.2 * voxel.distance().unwrap()).abs() < 1e-6,
            "{v}"
        );
        assert!((sample.weight - voxel.weight()).abs() < 1e-3, "{v}");
    }
}

#[test]
fn where_nothing_can_be_known_nothing_is_told() {
    let map = map_of(plane, |_| 1);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e9, 2e8, 1.0] {
        for axis in 0..3 {
            let mut point = DVec3::ZERO;
            assert!(map.sample(point).is_some());
            point[axis] = bad;
            assert_eq!(
                (map.sample(point), map.sample_all(&[point])),
                (None, vec![None]),
                "{point}"
            );
        }
    }
    assert_eq!(map.sample_all(&[]), []);
    let empty = VoxelMap::new(MapConfig::default()).unwrap();
    assert_eq!(
        (empty.sample(DVec3::ZERO), empty.bounds(), empty.voxels().count()),
        (None, None, 0)
    );
}

#[test]
fn any_number_of_threads_samples_the_same_bits() {
    let map = map_of(ball, |v| (v.element_sum() as u32) % 7);
    let points: Vec<DVec3> = (0..30_000)
        .map(|i| DVec3::new(f64::from(i % 37), f64::from(i % 101), f64::from(i % 59)) / 60.0 - 0.7)
        .collect();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let bits = |s: Option<Sample>| s.map(|s| (s.distance_m.to_bits(), s.gradient.to_array().map(f32::to_bits)));
        pool.install(|| map.sample_all(&points))
            .into_iter()
            .map(bits)
            .collect::<Vec<_>>()
    };
    let one = with(1);
    assert!(one.iter().flatten().count() > 1000);
    assert!(one == with(3) && one == with(8));
    assert!(
        one != map_of(plane, |_| 1)
            .sample_all(&points)
            .into_iter()
            .map(|s| s.map(|s| (s.distance_m.to_bits(), s.gradient.to_array().map(f32::to_bits))))
            .collect::<Vec<_>>()
    );
}

#[test]
fn a_fused_wall_is_where_it_is() {
    let wall = (-40..40).flat_map(|y| (-30..30).map(move |z| Vec3::new(4.02, 0.03 * y as f32, 0.03 * z as f32)));
    let scan = Scan {
        points: wall.collect(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    Patch::default().integrate(&mut map, &scan).unwrap();
    for offset in [-0.02, 0.0, 0.02] {
        let sample = map.sample(DVec3::new(4.02 - offset, 0.2, -0.1)).unwrap();
        assert!((f64::from(sample.distance_m) - offset).abs() < 0.003, "{sample:?}");
        assert!((sample.gradient + Vec3::X).length() < 0.1, "{sample:?}");
    }
}

#[test]
fn all_that_was_observed_comes_once_and_at_its_place() {
    let map = map_of(ball, |v| (v.x + 3 * v.y + 7 * v.z) as u32 % 3);
    let mut seen = std::collections::BTreeMap::new();
    for voxel in map.voxels() {
        assert_eq!(voxel.center, map.grid().center(voxel.index));
        assert!(
            seen.insert(voxel.index.to_array(), (voxel.distance_m, voxel.weight))
                .is_none()
        );
    }
    let all = (-20..20).flat_map(|z| (-20..20).flat_map(move |y| (-20..20).map(move |x| IVec3::new(x, y, z))));
    for v in all {
        let voxel = map.voxel(v);
        let expected = voxel.distance().map(|f| (0.2 * f, voxel.weight()));
        assert_eq!(seen.get(&v.to_array()).copied(), expected);
    }
    assert_eq!(seen.len(), map.observed_voxel_count());
    let blocks: Vec<_> = map.blocks().collect();
    assert_eq!(blocks.len(), map.block_count());
    for block in &blocks {
        assert!(std::ptr::eq(block.block, map.block(block.index).unwrap()));
        let middle = map.grid().center(block.index.first_voxel()) + 3.5 * 0.05;
        assert!((block.center - middle).length() < 1e-12);
    }
    assert_eq!(map.bounds(), Some((DVec3::splat(-0.8), DVec3::splat(0.8))));
    // Blocks without observations are none.
    let mut other = map.clone();
    other.insert_block(BlockIndex(IVec3::splat(50)), Block::EMPTY).unwrap();
    assert_eq!((other.bounds(), other.blocks().count()), (map.bounds(), blocks.len()));
}

#[test]
fn a_dense_box_has_every_voxel_in_its_place() {
    let map = map_of(ball, |v| (v.x + 3 * v.y + 7 * v.z) as u32 % 3);
    // Partly outside of the map; centres at 0.025, 0.075, …
    let (low, high) = (DVec3::new(-1.0, 0.025, -0.33), DVec3::new(0.374, 0.125, 0.9));
    let dense = map.dense(low, high).unwrap();
    assert_eq!(dense.first, IVec3::new(-20, 0, -7));
    assert_eq!(
        (dense.shape, dense.origin),
        ([25, 2, 27], map.grid().center(dense.first))
    );
    let [_, ny, nx] = dense.shape;
    let mut observed = 0;
    for (i, (distance_m, weight)) in dense.distance_m.iter().zip(&dense.weight).enumerate() {
        let at = dense.first + IVec3::new((i % nx) as i32, (i / nx % ny) as i32, (i / nx / ny) as i32);
        let center = dense.origin + dense.voxel_size_m * (at - dense.first).as_dvec3();
        assert!((center - map.grid().center(at)).length() < 1e-12);
        assert!(center.cmpge(low).all() && center.cmplt(high).all());
        match map.voxel(at).distance() {
            Some(f) => assert_eq!((*distance_m, *weight), (0.2 * f, map.voxel(at).weight())),
            None => assert!(distance_m.is_nan() && *weight == 0.0),
        }
        observed += usize::from(*weight > 0.0);
    }
    assert_eq!(dense.distance_m.len(), 25 * 2 * 27);
    assert!((100..25 * 2 * 27).contains(&observed));
    // All of it, as the map itself counts.
    let (low, high) = map.bounds().unwrap();
    let all = map.dense(low, high).unwrap();
    assert_eq!(all.shape, [32; 3]);
    assert_eq!(
        all.weight.iter().filter(|w| **w > 0.0).count(),
        map.observed_voxel_count()
    );
}

#[test]
fn a_box_that_is_empty_or_endless_is_no_array() {
    let map = map_of(plane, |_| 1);
    let nothing = map.dense(DVec3::splat(0.03), DVec3::splat(0.04)).unwrap();
    assert_eq!((nothing.shape, nothing.weight.len()), ([0; 3], 0));
    for (low, high) in [(DVec3::ONE, DVec3::X), (DVec3::ZERO, DVec3::NAN)] {
        assert!(matches!(map.dense(low, high), Err(MapError::Box { .. })));
    }
    for (low, high) in [
        (DVec3::NEG_INFINITY, DVec3::INFINITY),
        (DVec3::ZERO, DVec3::splat(60.0)),
    ] {
        let told = map.dense(low, high).unwrap_err().to_string();
        assert!(told.contains("too large for arrays"), "{told}");
    }
}
