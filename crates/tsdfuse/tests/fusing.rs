//! Fusing against a literal implementation, and what the map promises: the same bits for any number of threads, any split of
//! a log into scans, and any place in the world.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use common::{Voxels, assert_agrees, scan};
use tsdfuse::{
    Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap,
    fuse::{Distance, RaycastConfig},
    glam::{DQuat, DVec3, IVec3, Vec3},
    mesh,
};

const FORMS: [Distance; 2] = [Distance::Euclidean, Distance::Projective];

fn fuse(scans: &[Scan], distance: Distance) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut method = Raycast::new(RaycastConfig { distance });
    for scan in scans {
        let done = method.integrate(&mut map, scan).unwrap();
        assert_eq!(done.fused_returns as usize, scan.points.len());
    }
    map
}

/// The formulas of raycasting as they stand, for every voxel of a cube about each return, in f64.
fn literal(scans: &[Scan], distance: Distance) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = MapConfig::default();
    let mut sums = Voxels::new();
    for scan in scans {
        let o = scan.pose.unwrap().translation;
        for &point in &scan.points {
            let p = scan.pose.unwrap().transform_point(point.as_dvec3());
            let r = (p - o).normalize();
            let center = (p / k).floor().as_ivec3();
            for (z, y, x) in (-6..=6).flat_map(|z| (-6..=6).flat_map(move |y| (-6..=6).map(move |x| (z, y, x)))) {
                let index = center + IVec3::new(x, y, z);
                let v = (index.as_dvec3() + 0.5) * k;
                let off_axis = (o - v).cross(p - o).length() / (p - o).length(); // (5.5)
                let along = (p - v).dot(r);
                let mut w = (1.0 / (p - o).length()).min(1.0); // (5.8)
                let f = match distance {
                    Distance::Euclidean => along.signum() * (v - p).length() / mu, // (5.7)
                    Distance::Projective => along / mu,
                };
                let touched = match distance {
                    Distance::Euclidean => off_axis < 3_f64.sqrt() * k / 2.0, // (5.6)
                    Distance::Projective => {
                        let (a, b) = ((v - k / 2.0 - p) / r, (v + k / 2.0 - p) / r);
                        a.min(b).max_element() < a.max(b).min_element()
                    }
                };
                if let Distance::Projective = distance {
                    w *= 1.0 - off_axis * off_axis / (0.75 * k * k);
                    if along < -1.5 * k {
                        w *= ((mu + along) / (mu - 1.5 * k)).powi(2);
                    }
                }
                if touched && (v - p).length() <= mu {
                    let sum = sums.entry(index.to_array()).or_default();
                    *sum = (sum.0 + w, sum.1 + w * f);
                }
            }
        }
    }
    sums.into_iter().map(|(v, (w, s))| (v, (w, s / w))).collect()
}

#[test]
fn raycasting_is_what_its_formulas_say() {
    let scans = [scan(0, 3000), scan(1, 3000)];
    for form in FORMS {
        let (fast, slow) = (fuse(&scans, form), literal(&scans, form));
        assert!(fast.observed_voxel_count() > 20_000);
        assert_agrees(&fast, &slow, 0.005, &format!("{form:?}"));
    }
}

#[test]
fn threads_change_no_bit() {
    let scans: Vec<_> = (0..4).map(|n| scan(n, 5000)).collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut map = VoxelMap::new(MapConfig::default()).unwrap();
            let mut method = Raycast::default();
            let updated: Vec<_> = scans
                .iter()
                .map(|s| method.integrate(&mut map, s).unwrap().updated_blocks)
                .collect();
            let mesh = mesh::extract(&map).unwrap();
            (map, updated, mesh)
        })
    };
    let one = run(1);
    assert!(one.2.triangles.len() > 10_000);
    for threads in [2, 3, 7] {
        assert!(run(threads) == one, "{threads} threads");
    }
    // The comparison sees a single voxel.
    let fewer = fuse(&scans[..3], Distance::Euclidean);
    assert!(fewer != one.0);
}

#[test]
fn many_scans_of_one_return_equal_one_scan_of_many() {
    let whole = scan(2, 2000);
    let parts: Vec<_> = whole
        .points
        .chunks(7)
        .map(|c| Scan {
            points: c.to_vec(),
            pose: whole.pose,
            ..Default::default()
        })
        .collect();
    for form in FORMS {
        assert!(
            fuse(std::slice::from_ref(&whole), form) == fuse(&parts, form),
            "{form:?}"
        );
    }
}

#[test]
fn the_map_moves_with_the_data() {
    // A multiple of the block's edge; UTM-sized.
    let shift = DVec3::new(500_000.0, 5_400_000.0, 300.0);
    let near: Vec<_> = (0..3).map(|n| scan(n, 5000)).collect();
    let mut far = near.clone();
    far.iter_mut()
        .for_each(|s| s.pose.as_mut().unwrap().translation += shift);
    for form in FORMS {
        let (here, there) = (
            mesh::extract(&fuse(&near, form)).unwrap(),
            mesh::extract(&fuse(&far, form)).unwrap(),
        );
        assert_eq!(here.triangles, there.triangles);
        assert!(here.triangles.len() > 1000);
        let off = here
            .vertices
            .iter()
            .zip(&there.vertices)
            .map(|(a, b)| (*b - *a - shift).length());
        let worst = off.fold(0.0, f64::max);
        assert!(worst < 1e-6, "a vertex moved by {worst} m");
    }
}

#[test]
fn updated_blocks_are_those_that_changed() {
    let scans = [scan(0, 2000), scan(3, 2000)];
    let mut map = fuse(&scans[..1], Distance::Euclidean);
    let before = map.clone();
    let updated = Raycast::default()
        .integrate(&mut map, &scans[1])
        .unwrap()
        .updated_blocks;
    let mut changed = map.block_indices();
    changed.retain(|&i| map.block(i) != before.block(i));
    let mut sorted = updated.clone();
    sorted.sort();
    sorted.dedup();
    assert_eq!(sorted.len(), updated.len(), "a block is named twice");
    assert_eq!(sorted, changed);
}

#[test]
fn the_weight_is_limited_and_the_map_follows() {
    let mut map = VoxelMap::new(MapConfig {
        max_weight: 2.0,
        ..Default::default()
    })
    .unwrap();
    let wall = |x: f32| Scan {
        points: vec![Vec3::new(x, 0.025, 0.025)],
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mut method = Raycast::new(RaycastConfig {
        distance: Distance::Projective,
    });
    let voxel = IVec3::new(21, 0, 0);
    (0..50).for_each(|_| drop(method.integrate(&mut map, &wall(1.0)).unwrap()));
    assert!((map.voxel(voxel).weight() - 2.0).abs() < 1e-3, "{:?}", map.voxel(voxel));
    assert!(map.voxel(voxel).distance().unwrap() < 0.0);
    (0..50).for_each(|_| drop(method.integrate(&mut map, &wall(1.15)).unwrap()));
    assert!(map.voxel(voxel).distance().unwrap() > 0.3);
}

#[test]
fn the_narrowest_band_still_holds_a_surface() {
    for form in FORMS {
        let config = MapConfig {
            truncation_m: 0.05,
            ..Default::default()
        };
        let mut map = VoxelMap::new(config).unwrap();
        Raycast::new(RaycastConfig { distance: form })
            .integrate(&mut map, &scan(0, 200_000))
            .unwrap();
        assert!(mesh::extract(&map).unwrap().triangles.len() > 10_000, "{form:?}");
    }
}

#[test]
fn hostile_returns_are_skipped_and_counted() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let bad = [
        Vec3::NAN,
        Vec3::ZERO,
        Vec3::new(f32::INFINITY, 0.0, 0.0),
        Vec3::splat(f32::MAX),
        Vec3::splat(-3e9),
        Vec3::new(1.0, f32::NAN, 2.0),
    ];
    for form in FORMS {
        let mut method = Raycast::new(RaycastConfig { distance: form });
        let done = method
            .integrate(
                &mut map,
                &Scan {
                    points: bad.to_vec(),
                    pose: Some(Pose::IDENTITY),
                    ..Default::default()
                },
            )
            .unwrap();
        assert_eq!(done.skipped.outside_grid, bad.len() as u64);
        assert_eq!((done.fused_returns, map.block_count()), (0, 0));
        let lost = Scan {
            name: "lost".into(),
            points: vec![Vec3::X],
            pose: Some(Pose {
                translation: DVec3::splat(1e12),
                ..Pose::IDENTITY
            }),
            ..Default::default()
        };
        let error = method.integrate(&mut map, &lost).unwrap_err().to_string();
        assert!(error.contains("lost") && error.contains("outside"), "{error}");
    }
}

#[test]
fn motion_within_the_sweep_is_undone() {
    // A wall 5 m ahead, seen while driving towards it at 10 m/s for 0.1 s and turning by 0.1 rad.
    let end = Pose {
        rotation: DQuat::from_rotation_z(0.1),
        translation: DVec3::new(1.0, 0.0, 0.0),
    };
    let motion = tsdfuse::scan::PoseAt { pose: end, secs: 0.1 };
    let trajectory = tsdfuse::scan::Sweep::new(Pose::IDENTITY, &[motion]);
    let times: Vec<f32> = (0..2000).map(|i| i as f32 * 0.1 / 2000.0).collect();
    let points = times.iter().enumerate().map(|(i, &t)| {
        let wall = DVec3::new(5.0, (i % 50) as f64 * 0.02, (i / 50) as f64 * 0.02);
        trajectory.at(f64::from(t)).inverse().transform_point(wall).as_vec3()
    });
    let moving = Scan {
        points: points.collect(),
        times: Some(times.clone()),
        pose: Some(Pose::IDENTITY),
        motion: vec![motion],
        ..Default::default()
    };
    let off = |scan: &Scan| {
        let mesh = mesh::extract(&fuse(std::slice::from_ref(scan), Distance::Projective)).unwrap();
        assert!(mesh.vertices.len() > 100);
        mesh.vertices.iter().map(|v| (v.x - 5.0).abs()).sum::<f64>() / mesh.vertices.len() as f64
    };
    assert!(off(&moving) < 0.002, "{}", off(&moving));
    assert!(
        off(&Scan {
            motion: vec![],
            ..moving
        }) > 0.1,
        "without motion the wall must be smeared"
    );
}
