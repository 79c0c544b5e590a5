//! Surfels against a literal implementation of their formulas, and the drawbacks that the thesis names.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use std::collections::BTreeMap;

use common::{Voxels, assert_agrees, differing, observed};
use tsdfuse::{
    Integrator, MapConfig, Pose, Scan, SensorModel, Surfels, VoxelMap,
    fuse::Skipped,
    glam::{DMat3, DQuat, DVec3, EulerRot, IVec3, Vec3},
    mesh,
    scan::{PoseAt, RangeLimits},
    surfel::{SurfelConfig, SurfelMap},
};

/// A number in [0, 1) from a number: enough chance for a test.
fn chance(seed: u64) -> f64 {
    let mut x = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (x >> 11) as f64 / (1_u64 << 53) as f64
}

/// A scan of a tilted room with noise from somewhere inside it, with the sensor in any position; moving, if asked for.
fn scan(number: u64, rays: u64, moving: bool) -> Scan {
    let random = |k: u64| chance(number * 1_000_003 + k);
    let pose_at = |k: u64| Pose {
        rotation: DQuat::from_euler(EulerRot::XYZ, random(k), 6.0 * random(k + 1), 3.0 * random(k + 2)),
        translation: DVec3::new(random(k + 3), random(k + 4), random(k + 5)) - 0.5,
    };
    let pose = pose_at(0);
    let later = Pose {
        rotation: pose.rotation * DQuat::from_rotation_z(0.3),
        translation: pose.translation + DVec3::new(0.4, -0.3, 0.2),
    };
    let motion = moving.then_some(PoseAt { pose: later, secs: 0.1 });
    let room = pose_at(10).rotation;
    let half = DVec3::new(2.5, 2.0, 1.4);
    let times: Vec<f32> = (0..rays).map(|i| 0.1 * i as f32 / rays as f32).collect();
    let points = times.iter().zip(0_u64..).map(|(&secs, i)| {
        let sensor = motion.map_or(pose, |m| tsdfuse::scan::Sweep::new(pose, &[m]).at(secs.into()));
        let any = |k| random(100 + 4 * i + k);
        let direction = DVec3::new(any(0) - 0.5, any(1) - 0.5, any(2) - 0.5).normalize();
        let (start, along) = (
            room.inverse() * sensor.translation,
            room.inverse() * (sensor.rotation * direction),
        );
        let range = ((along.signum() * half - start) / along).min_element() + 0.03 * any(3);
        (direction * range).as_vec3()
    });
    Scan {
        name: format!("scan {number}"),
        points: points.collect(),
        times: moving.then(|| times.clone()),
        pose: Some(pose),
        motion: motion.into_iter().collect(),
        ..Default::default()
    }
}

/// A sensor of which only the range counts here.
fn sensor(max_range_m: f32) -> SensorModel {
    SensorModel::from_beams("test", vec![0.0], 360, (0.1, max_range_m)).unwrap()
}

const MAP: MapConfig = MapConfig {
    voxel_size_m: 0.05,
    truncation_m: 0.2,
    max_weight: tsdfuse::map::MAX_WEIGHT,
};

/// Coarse next to fine within the few metres of the test's room.
fn config() -> SurfelConfig {
    SurfelConfig {
        finest_cell_m: 0.3,
        finest_range_m: 1.5,
        levels: 2,
        min_points: 4,
        radius_sigmas: 1.5,
        ground_flip: false,
    }
}

fn fuse(scans: &[Scan], config: SurfelConfig) -> (VoxelMap, Skipped) {
    let mut map = VoxelMap::new(MAP).unwrap();
    let mut method = Surfels::new(config, Some(&sensor(30.0)));
    let mut skipped = Skipped::default();
    for scan in scans {
        let done = method.integrate(&mut map, scan).unwrap();
        let Skipped {
            outside_grid,
            without_normal,
            without_weight,
            ..
        } = done.skipped;
        let all = done.fused_returns + outside_grid + without_normal + without_weight;
        assert_eq!(all as usize, scan.points.len());
        skipped += done.skipped;
    }
    (map, skipped)
}

/// The unit vector in whose direction points vary least, and the variance where they vary most, by brute force: rotate the
/// covariance until it is diagonal.
fn least_and_most(points: &[DVec3], mean: DVec3) -> (DVec3, f64) {
    let mut axes = DMat3::IDENTITY;
    let variance = |a: DVec3, b: DVec3| {
        points
            .iter()
            .map(|&p| (p - mean).dot(a) * (p - mean).dot(b))
            .sum::<f64>()
            / points.len() as f64
    };
    for _ in 0..8 {
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (axes.col(i), axes.col(j));
            let angle = 0.5 * (2.0 * variance(a, b)).atan2(variance(a, a) - variance(b, b));
            *axes.col_mut(i) = a * angle.cos() + b * angle.sin();
            *axes.col_mut(j) = b * angle.cos() - a * angle.sin();
        }
    }
    let mut by_variance: Vec<_> = (0..3)
        .map(|i| (variance(axes.col(i), axes.col(i)), axes.col(i)))
        .collect();
    by_variance.sort_by(|a, b| a.0.total_cmp(&b.0));
    (by_variance[0].1, by_variance[2].0)
}

/// The formulas as they stand, in f64: every cell by comparing points, every voxel of a cube about each surfel.
fn literal(scans: &[Scan], config: SurfelConfig, max_range_m: f64) -> (Voxels, usize) {
    let (k, mu) = (MAP.voxel_size_m, MAP.truncation_m);
    let mut sums = Voxels::new();
    let mut too_few = 0;
    for scan in scans {
        let home = scan.pose.unwrap().translation;
        let placed: Vec<(DVec3, DVec3)> = (scan.points.iter().enumerate())
            .map(|(i, p)| {
                let sensor = scan
                    .sweep()
                    .map_or(scan.pose.unwrap(), |t| t.at(scan.times.as_ref().unwrap()[i].into()));
                (sensor.transform_point(p.as_dvec3()), sensor.translation)
            })
            .collect();
        let cell_of = |p: DVec3| {
            let finest_range: f64 = config.finest_range_m.into();
            let mut level = 0;
            while (p - home).length() > finest_range * 2_f64.powi(level) && level + 1 < config.levels as i32 {
                level += 1;
            }
            let edge = f64::from(config.finest_cell_m) * 2_f64.powi(level);
            (level, ((p - home) / edge).floor().as_ivec3().to_array())
        };
        let mut cells = BTreeMap::<_, Vec<(DVec3, DVec3)>>::new();
        placed
            .iter()
            .for_each(|&(p, o)| cells.entry(cell_of(p)).or_default().push((p, o)));
        for cell in cells.values() {
            if cell.len() < config.min_points as usize {
                too_few += cell.len();
                continue;
            }
            let points: Vec<DVec3> = cell.iter().map(|c| c.0).collect();
            let c = points.iter().sum::<DVec3>() / points.len() as f64;
            let o = cell.iter().map(|c| c.1).sum::<DVec3>() / points.len() as f64;
            let (n, most) = least_and_most(&points, c);
            let mut n = if n.dot(o - c) < 0.0 { -n } else { n };
            let in_sensor = |v: DVec3| scan.pose.unwrap().rotation.inverse() * v;
            if config.ground_flip && in_sensor(c - o).z < 0.0 && in_sensor(n).z < 0.0 {
                n = -n;
            }
            let r = f64::from(config.radius_sigmas) * most.sqrt();
            let reach = ((r * r + mu * mu).sqrt() / k).ceil() as i32 + 1;
            let at = (c / k).floor().as_ivec3();
            let range = -reach..=reach;
            for (z, y) in range.clone().flat_map(|z| range.clone().map(move |y| (z, y))) {
                for x in range.clone() {
                    let index = at + IVec3::new(x, y, z);
                    let v = (index.as_dvec3() + 0.5) * k;
                    if (c - v).cross(n).length() <= r && (c - v).dot(n).abs() <= mu {
                        // (5.21)(5.22)
                        let f = (v - c).dot(n) / mu; // (5.24)
                        let near = 1.0 / (1.0 + (v - c).length() / mu); // (5.25)
                        let w = (1.0 - (o - c).length() / max_range_m) * near; // (5.26)(5.27)
                        let sum = sums.entry(index.to_array()).or_default();
                        *sum = (sum.0 + w, sum.1 + w * f);
                    }
                }
            }
        }
    }
    (sums.into_iter().map(|(v, (w, s))| (v, (w, s / w))).collect(), too_few)
}

#[test]
fn surfels_are_what_their_formulas_say() {
    for moving in [false, true] {
        for ground_flip in [false, true] {
            let scans = [scan(1, 1200, moving), scan(2, 1200, moving)];
            let config = SurfelConfig {
                ground_flip,
                ..config()
            };
            let (map, skipped) = fuse(&scans, config);
            let fast = observed(&map);
            let (slow, too_few) = literal(&scans, config, 30.0);
            assert!(fast.len() > 50_000, "{} voxels", fast.len());
            assert!(too_few > 100, "cells with few returns must occur: {too_few}");
            assert_eq!(
                skipped,
                Skipped {
                    without_normal: too_few as u64,
                    ..Default::default()
                }
            );
            assert_agrees(&map, &slow, 0.002, &format!("moving {moving}, flip {ground_flip}"));

            // The comparison sees wrong weights, and every option.
            let heavier = fast.iter().map(|(v, (w, f))| (*v, (w * 1.01, *f))).collect();
            assert!(differing(&heavier, &slow) > 0.9);
            let still = |scan: &Scan| Scan {
                motion: vec![],
                ..scan.clone()
            };
            let others = [
                SurfelConfig {
                    ground_flip: !ground_flip,
                    ..config
                },
                SurfelConfig {
                    min_points: 5,
                    ..config
                },
                SurfelConfig {
                    radius_sigmas: 1.51,
                    ..config
                },
                SurfelConfig {
                    finest_range_m: 1.6,
                    ..config
                },
                SurfelConfig { levels: 1, ..config },
            ];
            for other in others.into_iter().filter(|_| !moving && ground_flip) {
                assert!(differing(&fast, &literal(&scans, other, 30.0).0) > 0.01, "{other:?}");
            }
            assert!(differing(&fast, &literal(&scans, config, 29.0).0) > 0.5);
            let without_motion = literal(&scans.clone().map(|s| still(&s)), config, 30.0).0;
            assert_eq!(differing(&fast, &without_motion) > 0.5, moving);
        }
    }
}

#[test]
fn threads_change_no_bit() {
    let scans: Vec<_> = (0..4).map(|n| scan(n, 5000, n % 2 == 1)).collect();
    let run = |threads, scans: &[Scan]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut map = VoxelMap::new(MAP).unwrap();
            let mut method = Surfels::new(SurfelConfig::default(), None);
            let all = scans
                .iter()
                .map(|s| method.integrate(&mut map, s).unwrap().updated_blocks);
            (all.collect::<Vec<_>>(), map)
        })
    };
    let one = run(1, &scans);
    assert!(one.1.observed_voxel_count() > 100_000);
    for threads in [2, 7] {
        assert!(run(threads, &scans) == one, "{threads} threads");
    }
    // The comparison sees that a few returns moved by a millimetre.
    let mut other = scans.clone();
    other[3].points.iter_mut().take(20).for_each(|p| p.x += 0.001);
    assert!(run(1, &other).1 != one.1);
}

#[test]
fn the_map_moves_with_the_data() {
    let shift = DVec3::new(500_000.0, 5_400_000.0, 300.0); // a multiple of the block's edge; UTM-sized
    let near = [scan(0, 3000, false), scan(1, 3000, true)];
    let far = near.clone().map(|mut s| {
        s.pose.as_mut().unwrap().translation += shift;
        s.motion.iter_mut().for_each(|m| m.pose.translation += shift);
        s
    });
    let moved: Voxels = (observed(&fuse(&near, config()).0).into_iter())
        .map(|(v, x)| {
            (
                (IVec3::from(v) + IVec3::new(10_000_000, 108_000_000, 6_000)).to_array(),
                x,
            )
        })
        .collect();
    let share = differing(&observed(&fuse(&far, config()).0), &moved);
    assert!(share < 0.01, "{share} of the voxels differ");
}

#[test]
fn weights_are_limited_as_in_every_method() {
    let mut map = VoxelMap::new(MapConfig { max_weight: 0.5, ..MAP }).unwrap();
    let mut method = Surfels::new(config(), Some(&sensor(30.0)));
    (0..5).for_each(|_| drop(method.integrate(&mut map, &scan(1, 1500, false)).unwrap()));
    let limited = observed(&map);
    let once = observed(&fuse(&[scan(1, 1500, false)], config()).0);
    assert_eq!(limited.len(), once.len());
    for (v, (w, f)) in once {
        let (limited_w, limited_f) = limited[&v];
        assert!((limited_w - (5.0 * w).min(0.5)).abs() < 1e-4, "{w} became {limited_w}");
        assert!((limited_f - f).abs() < 1e-3, "{f} became {limited_f}");
    }
}

#[test]
fn hostile_returns_are_skipped_and_counted() {
    let bad = [
        Vec3::NAN,
        Vec3::new(f32::INFINITY, 0.0, 0.0),
        Vec3::new(1.0, f32::NAN, 2.0),
        Vec3::splat(f32::MAX),
        Vec3::splat(-3e9),
        Vec3::new(0.0, 1e9, 0.0),
    ];
    let repeated = |points: &[Vec3]| points.iter().flat_map(|&p| [p; 10]).collect();
    let run = |points: Vec<Vec3>| {
        let mut map = VoxelMap::new(MAP).unwrap();
        let mut method = Surfels::new(SurfelConfig::default(), None);
        let scan = Scan {
            points,
            pose: Some(Pose::IDENTITY),
            ..Default::default()
        };
        let done = method.integrate(&mut map, &scan).unwrap();
        (done.skipped, done.fused_returns, map.block_count())
    };
    let skipped = |outside_grid, without_normal, without_weight| Skipped {
        outside_grid,
        without_normal,
        without_weight,
        ..Default::default()
    };
    assert_eq!(run(repeated(&bad)), (skipped(60, 0, 0), 0, 0));
    // Beyond the range of the sensor, which is the default where no beams show.
    let max = RangeLimits::default().max_range_m;
    assert_eq!(run(repeated(&[Vec3::X * (max + 1.0)])), (skipped(0, 0, 10), 0, 0));
    assert_eq!(run(vec![Vec3::X, Vec3::Y, Vec3::Z]), (skipped(0, 3, 0), 0, 0));
    // Beside good ones.
    let mut mixed = scan(1, 1500, false);
    mixed.points.splice(700..700, bad);
    let (map, skipped) = fuse(&[mixed], config());
    assert_eq!(skipped.outside_grid, 6);
    assert!(map == fuse(&[scan(1, 1500, false)], config()).0);
    // Many returns at the same place are a surfel without size; nothing happens, nothing fails.
    assert_eq!(run(vec![Vec3::new(1.01, 1.02, 1.03); 1000]).2, 0);
    let empty = Scan {
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let done = Surfels::default()
        .integrate(&mut VoxelMap::new(MAP).unwrap(), &empty)
        .unwrap();
    assert_eq!(done, Default::default());
    let lost = Scan {
        name: "lost".into(),
        points: vec![Vec3::X],
        pose: Some(Pose {
            translation: DVec3::splat(1e12),
            ..Pose::IDENTITY
        }),
        ..Default::default()
    };
    let error = Surfels::default()
        .integrate(&mut VoxelMap::new(MAP).unwrap(), &lost)
        .unwrap_err()
        .to_string();
    assert!(error.contains("lost") && error.contains("outside"), "{error}");
}

/// The surfels of points relative to a sensor that stands upright.
fn surfels_of(points: &[Vec3], config: SurfelConfig) -> SurfelMap {
    let mut map = SurfelMap::default();
    map.update(points, None, Vec3::Z, &config);
    map
}

/// A grid of 9 × 9 points, 2 cm apart.
fn patch(center: Vec3, u: Vec3, v: Vec3) -> Vec<Vec3> {
    let steps = (-4..=4).flat_map(|i| (-4..=4).map(move |j| (0.02 * i as f32, 0.02 * j as f32)));
    steps.map(|(a, b)| center + a * u + b * v).collect()
}

/// One cell around the sensor's positive octant, another level nowhere near.
const ONE_CELL: SurfelConfig = SurfelConfig {
    finest_cell_m: 8.0,
    finest_range_m: 50.0,
    levels: 1,
    min_points: 3,
    radius_sigmas: 2.0,
    ground_flip: false,
};

#[test]
fn normals_look_at_the_sensor_from_everywhere() {
    for i in 0..200_u64 {
        let any = |k| chance(10 * i + k) as f32 - 0.5;
        let center = 4.0 + 3.0 * Vec3::new(any(0), any(1), any(2)) * Vec3::new(1.0, 1.0, 1.0);
        let (u, v) = Vec3::new(any(3), any(4), any(5)).normalize().any_orthonormal_pair();
        let map = surfels_of(&patch(center, u, v), ONE_CELL);
        let [surfel] = map.surfels() else { panic!("one cell") };
        let expected = u.cross(v) * -u.cross(v).dot(center).signum();
        assert!(surfel.normal.distance(expected) < 1e-4, "{surfel:?}, not {expected}");
        assert!(surfel.center.distance(center) < 1e-5);
        // 9 points 2 cm apart: variance (9² − 1)/12 steps².
        assert!((surfel.radius_m - 2.0 * 0.02 * (80.0_f32 / 12.0).sqrt()).abs() < 1e-4);
        assert!((surfel.distance_m - center.length()).abs() < 1e-4);
        // Seen from behind, while the map's centre is in front.
        let mut behind = SurfelMap::default();
        behind.update(&patch(center, u, v), Some(&[2.0 * center; 81]), Vec3::Z, &ONE_CELL);
        assert!(behind.surfels()[0].normal.distance(-expected) < 1e-4);
    }
}

#[test]
fn ground_that_seems_to_look_down_is_flipped_if_asked_for() {
    // A road below the sensor that drops away more steeply than it is seen (thesis 7.5, figure 7.5).
    let road = |up: Vec3| {
        let along = Vec3::new(1.0, 0.0, -0.5).normalize();
        let points = patch(Vec3::new(4.0, 1.0, -1.0), along, Vec3::Y);
        let flip = |ground_flip| {
            let mut map = SurfelMap::default();
            map.update(
                &points,
                None,
                up,
                &SurfelConfig {
                    ground_flip,
                    ..ONE_CELL
                },
            );
            map.surfels()[0].normal
        };
        (flip(false), flip(true))
    };
    let (faithful, flipped) = road(Vec3::Z);
    assert!(faithful.z < -0.8, "{faithful}");
    assert_eq!(flipped, -faithful);
    // For a sensor that hangs upside down the road is above it.
    let (faithful, flipped) = road(-Vec3::Z);
    assert_eq!(flipped, faithful);
    // What looks up is right already.
    let floor = patch(Vec3::new(4.0, 1.0, -1.0), Vec3::X, Vec3::Y);
    for ground_flip in [false, true] {
        let map = surfels_of(
            &floor,
            SurfelConfig {
                ground_flip,
                ..ONE_CELL
            },
        );
        assert!(map.surfels()[0].normal.z > 0.999);
    }
}

/// A wall 6.5 m ahead, crossed by `rings` scan lines 1.5° apart, with up to 1 cm of noise in range.
fn wall(rings: u32) -> Scan {
    let columns = -300..300;
    let points = columns.flat_map(|column| {
        (0..rings).map(move |ring| {
            let azimuth = 0.001 * f64::from(column);
            let elevation = (1.5 * f64::from(ring) - 4.0).to_radians();
            let (sin, cos) = azimuth.sin_cos();
            let at_wall = DVec3::new(cos, sin, elevation.tan()) * (6.5 / cos);
            let noise = 0.01 * (chance(u64::from(ring) * 1000 + (column + 300) as u64) - 0.5);
            (at_wall + noise * at_wall.normalize()).as_vec3()
        })
    });
    Scan {
        points: points.collect(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}

/// Thesis 7.5, figure 7.7: the points of one scan line lie on a line; in which direction they vary least across it is up to
/// their noise, not to the surface.
#[test]
fn a_cell_crossed_by_a_single_scan_line_has_a_wrong_normal() {
    let config = SurfelConfig {
        finest_cell_m: 0.5,
        min_points: 10,
        ..Default::default()
    };
    // How far normals lean from that of the wall, in the middle.
    let lean_deg = |rings| {
        let map = surfels_of(&wall(rings).points, config);
        let mut lean: Vec<_> = map
            .surfels()
            .iter()
            .map(|s| s.normal.x.abs().min(1.0).acos().to_degrees())
            .collect();
        assert!(lean.len() >= 8, "{} surfels", lean.len());
        lean.sort_by(f32::total_cmp);
        lean[lean.len() / 2]
    };
    assert!(lean_deg(6) < 2.0, "many scan lines: {}°", lean_deg(6));
    assert!(lean_deg(1) > 60.0, "one scan line: {}°", lean_deg(1));

    // And what it does to the map: instead of the wall, plates across it.
    let off = |rings| {
        let mesh = mesh::extract(&fuse(&[wall(rings)], config).0).unwrap();
        assert!(mesh.vertices.len() > 1000);
        mesh.vertices.iter().map(|v| (v.x - 6.5).abs()).sum::<f64>() / mesh.vertices.len() as f64
    };
    assert!(off(6) < 0.01, "many scan lines: off by {} m", off(6));
    assert!(off(1) > 0.05, "one scan line: off by {} m", off(1));
}

#[test]
fn options_without_sense_are_refused_by_name() {
    let told = |change: fn(&mut SurfelConfig)| {
        let mut config = SurfelConfig::default();
        change(&mut config);
        config.validate().err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert_eq!(told(|_| ()), "");
    let impossible: [fn(&mut SurfelConfig); 6] = [
        |c| c.finest_cell_m = 0.0,
        |c| c.finest_cell_m = f32::NAN,
        |c| c.finest_cell_m = f32::INFINITY,
        |c| c.levels = 0,
        |c| c.levels = 12,
        |c| c.levels = u32::MAX,
    ];
    for change in impossible {
        assert!(told(change).starts_with("surfel.finest_cell_m is "), "{}", told(change));
    }
    assert!(told(|c| c.finest_range_m = f32::INFINITY).starts_with("surfel.finest_range_m is inf"));
    assert!(told(|c| c.finest_range_m = -1.0).starts_with("surfel.finest_range_m is -1"));
    assert!(told(|c| c.min_points = 2).starts_with("surfel.min_points is 2"));
    assert!(told(|c| c.radius_sigmas = f32::NAN).starts_with("surfel.radius_sigmas is NaN"));
    assert!(told(|c| c.radius_sigmas = 5.0).starts_with("surfel.radius_sigmas is 5"));
}
