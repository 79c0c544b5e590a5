//! Views against a literal ray marcher, against known shapes, and against the scan that made the map.

use glam::{DQuat, DVec3, IVec3, Vec3};
use proptest::prelude::*;

use super::*;
use crate::index::{BLOCK_VOXELS, BlockIndex, voxel_at};
use crate::map::{Block, MapConfig, Voxel, WEIGHT_SCALE};
use crate::sensor::{Pinhole, SensorModel};
use crate::{Integrator, Raycast, Scan};
use crate::{Pose, VoxelMap};

/// A map of the blocks −n..n about a block, with a signed distance (metres) and a weight at each voxel's centre.
fn map_of(n: i32, about: IVec3, field: impl Fn(DVec3) -> f64, weight: impl Fn(IVec3) -> u32) -> VoxelMap {
    let config = MapConfig::default();
    let mut map = VoxelMap::new(config).unwrap();
    let grid = map.grid();
    for i in 0..(2 * n).pow(3) {
        let index = IVec3::new(i % (2 * n), i / (2 * n) % (2 * n), i / (2 * n).pow(2)) - n;
        let mut block = Block {
            voxels: [Voxel::default(); BLOCK_VOXELS],
        };
        for (number, voxel) in block.voxels.iter_mut().enumerate() {
            let at = voxel_at(BlockIndex(index), number);
            let f = (field(grid.center(at)) / config.truncation_m).clamp(-1.0, 1.0);
            let weight_sum = weight(at);
            let distance_sum = (f * f64::from(weight_sum)).round() as i32;
            *voxel = Voxel {
                weight_sum,
                distance_sum,
            };
        }
        map.insert_block(BlockIndex(index + about), block).unwrap();
    }
    map
}

const HEAVY: u32 = 100 * WEIGHT_SCALE;

/// A ball of 0.8 m about the origin, seen from outside.
fn ball(about: IVec3) -> VoxelMap {
    map_of(3, about, |p| p.length() - 0.8, |_| HEAVY)
}

/// A wavy field with several layers; one voxel in `holes` was never observed.
fn waves(about: IVec3, holes: u32) -> VoxelMap {
    let field = |p: DVec3| 0.15 * ((4.0 * p.x).sin() + (5.0 * p.y + 1.0).sin() + (6.0 * p.z + 2.0).cos()) + 0.05;
    let weight = |v: IVec3| {
        let bits = v.x.wrapping_mul(73_856_093) ^ v.y.wrapping_mul(19_349_669) ^ v.z.wrapping_mul(83_492_791);
        let bits = (bits as u32).wrapping_mul(0x9E37_79B9) >> 12;
        if bits.is_multiple_of(holes) {
            0
        } else {
            1000 + bits % 1000
        }
    };
    map_of(3, about, field, weight)
}

fn looking(from: DVec3, to: DVec3) -> Pose {
    let d = (to - from).normalize();
    let rotation = DQuat::from_rotation_z(d.y.atan2(d.x)) * DQuat::from_rotation_y(-d.z.asin());
    Pose {
        rotation,
        translation: from,
    }
}

fn pinhole() -> Camera {
    Camera::Pinhole(Pinhole::with_fov(80, 60, 1.0))
}

fn lidar() -> Camera {
    let beams = (-20..=20).map(|i| 2.0 * i as f32).collect();
    Camera::Lidar(SensorModel::from_beams("test", beams, 90, (0.1, 50.0)).unwrap())
}

/// Trilinear F at a place in voxels, by eight look-ups; `None` where a voxel was never observed.
fn literal_field(map: &VoxelMap, at: DVec3) -> Option<f64> {
    let first = (at - 0.5).floor();
    let s = at - 0.5 - first;
    let mut sum = 0.0;
    for c in 0..8 {
        let corner = IVec3::new(c & 1, c >> 1 & 1, c >> 2);
        let w = DVec3::select(corner.cmpeq(IVec3::ONE), s, 1.0 - s);
        sum += w.x * w.y * w.z * f64::from(map.voxel(first.as_ivec3() + corner).distance()?);
    }
    Some(sum)
}

/// The range at which small steps along the ray first fall from F ≥ 0 to F < 0.
fn literal_range(map: &VoxelMap, camera: &Camera, pose: Pose, pixel: usize) -> Option<f64> {
    const STEP: f64 = 0.02;
    let (width, _) = camera.size();
    let direction = pose.rotation * camera.rays().of(pixel % width, pixel / width).0;
    let (origin, kappa) = (pose.translation / map.config().voxel_size_m, map.config().voxel_size_m);
    let mut before: Option<f64> = None;
    for i in 0..(6.0 / kappa / STEP) as usize {
        let now = literal_field(map, origin + direction * (i as f64 * STEP));
        if let (Some(a), Some(b)) = (before, now)
            && a >= 0.0
            && b < 0.0
        {
            return Some((i as f64 - 1.0 + a / (a - b)) * STEP * kappa);
        }
        before = now;
    }
    None
}

/// Pixels on which two views disagree: one sees and the other does not, or by more than 2 mm.
fn disagreements(ranges: &[Option<f64>], view: &View) -> usize {
    assert_eq!(ranges.len(), view.hits.len());
    let differ = |(want, got): &(&Option<f64>, &Option<Hit>)| match (want, got) {
        (Some(want), Some(got)) => (want - f64::from(got.range_m)).abs() > 0.002,
        (want, got) => want.is_some() != got.is_some(),
    };
    ranges.iter().zip(&view.hits).filter(differ).count()
}

#[test]
fn views_show_what_a_literal_march_finds() {
    let mut seen = 0;
    for (map, from) in [
        (ball(IVec3::ZERO), DVec3::new(-1.1, 0.3, 0.2)),
        (waves(IVec3::ZERO, u32::MAX), DVec3::new(0.9, -1.0, 1.6)),
        (waves(IVec3::ZERO, 40), DVec3::new(-1.7, 0.2, -0.3)),
        (waves(IVec3::ZERO, 200), DVec3::new(0.05, 0.1, 0.02)),
    ] {
        for camera in [pinhole(), lidar()] {
            let pose = looking(from, DVec3::new(0.1, 0.05, -0.02));
            let view = render(&map, &camera, pose, &RenderConfig::default()).unwrap();
            let want: Vec<_> = (0..view.hits.len())
                .map(|p| literal_range(&map, &camera, pose, p))
                .collect();
            let differ = disagreements(&want, &view);
            // Steps miss what is thinner than a step.
            assert!(differ * 500 <= want.len(), "{differ} of {}", want.len());
            seen += view.hit_count();

            // The comparison sees what is wrong.
            let moved = Pose {
                translation: pose.translation + pose.rotation * DVec3::X * 0.01,
                ..pose
            };
            let moved = render(&map, &camera, moved, &RenderConfig::default()).unwrap();
            assert!(disagreements(&want, &moved) * 10 > view.hit_count());
            let mut blind = view.clone();
            blind.hits.iter_mut().step_by(40).for_each(|hit| *hit = None);
            assert!(disagreements(&want, &blind) * 500 > want.len());
        }
    }
    assert!(seen > 15_000, "{seen}");
}

#[test]
fn a_ball_has_its_ranges_and_normals() {
    let map = ball(IVec3::ZERO);
    let from = DVec3::new(-3.0, 0.4, 0.9);
    for camera in [pinhole(), lidar()] {
        let pose = looking(from, DVec3::ZERO);
        let view = render(&map, &camera, pose, &RenderConfig::default()).unwrap();
        let (width, _) = camera.size();
        let mut met = 0;
        for (pixel, hit) in view.hits.iter().enumerate() {
            let (ray, depth_per_range) = camera.rays().of(pixel % width, pixel / width);
            let d = pose.rotation * ray;
            // |from + r d| = 0.8
            let (half, c) = (from.dot(d), from.length_squared() - 0.64);
            let inside = half * half - c;
            if inside < 0.0 {
                assert!(inside > -0.005 || hit.is_none());
                continue;
            }
            // Flat rays at the rim magnify the field's error; the ball is not behind the camera.
            if inside < 0.05 || half > 0.0 {
                continue;
            }
            let range = -half - inside.sqrt();
            let (hit, cos) = (hit.unwrap(), inside.sqrt() / 0.8);
            assert!(
                (f64::from(hit.range_m) - range).abs() < 0.001 / cos,
                "{} {range}",
                hit.range_m
            );
            assert!((hit.depth_m - hit.range_m * depth_per_range).abs() < 1e-6);
            let normal = ((from + d * range) / 0.8).as_vec3();
            assert!(hit.normal.angle_between(normal) < 0.02, "{} {normal}", hit.normal);
            assert!((hit.incidence_cos + hit.normal.dot(d.as_vec3())).abs() < 1e-5);
            assert!((hit.weight - 100.0).abs() < 1e-3);
            met += 1;
        }
        assert!(met > 40, "{met}");
    }
}

#[test]
fn from_behind_rays_pass() {
    let map = ball(IVec3::ZERO);
    // From the middle of the ball, which is behind its surface.
    let view = render(&map, &lidar(), Pose::IDENTITY, &RenderConfig::default()).unwrap();
    assert_eq!(view.hit_count(), 0);
}

#[test]
fn a_scan_is_seen_again_from_its_own_pose() {
    let Camera::Lidar(sensor) = lidar() else { panic!() };
    let camera = Camera::Lidar(SensorModel { columns: 360, ..sensor });
    let (width, height) = camera.size();
    let pose = looking(
        DVec3::new(691_000.3, 5_335_000.2, 520.1),
        DVec3::new(691_003.0, 5_335_002.0, 520.4),
    );
    // A room of 3 x 2.4 x 2 m about the sensor.
    let half = DVec3::new(1.5, 1.2, 1.0);
    let returns: Vec<Vec3> = (0..width * height)
        .map(|p| {
            let ray = camera.rays().of(p % width, p / width).0;
            let towards = pose.rotation * ray;
            (ray * (half / towards.abs()).min_element()).as_vec3()
        })
        .collect();
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut fuser = Raycast::new(crate::fuse::RaycastConfig {
        distance: crate::fuse::Distance::Projective,
    });
    fuser
        .integrate(
            &mut map,
            &Scan {
                points: returns.clone(),
                pose: Some(pose),
                ..Default::default()
            },
        )
        .unwrap();
    let view = render(&map, &camera, pose, &RenderConfig::default()).unwrap();
    let mut off: Vec<f32> = view
        .hits
        .iter()
        .zip(&returns)
        .filter_map(|(hit, point)| Some((hit.as_ref()?.range_m - point.length()).abs()))
        .collect();
    off.sort_by(f32::total_cmp);
    assert!(off.len() * 10 > returns.len() * 9, "{} of {}", off.len(), returns.len());
    let (median, most) = (off[off.len() / 2], off[off.len() * 95 / 100]);
    assert!(median < 0.002 && most < 0.02, "{median} {most}");
}

#[test]
fn far_from_the_origin_nothing_changes_and_threads_do_not_matter() {
    let blocks = IVec3::new(1_728_000, 13_338_000, 1_300);
    let shift = blocks.as_dvec3() * 0.4;
    let (near, far) = (waves(IVec3::ZERO, 100), waves(blocks, 100));
    let in_threads = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    for camera in [pinhole(), lidar()] {
        // A power of two divides the camera's place: it is the same after the shift.
        let pose = looking(DVec3::new(-1.75, 0.25, 0.5), DVec3::new(0.5, 0.0, 0.0));
        let moved = Pose {
            translation: pose.translation + shift,
            ..pose
        };
        let one = in_threads(1).install(|| render(&near, &camera, pose, &RenderConfig::default()).unwrap());
        let four = in_threads(4).install(|| render(&near, &camera, pose, &RenderConfig::default()).unwrap());
        let there = render(&far, &camera, moved, &RenderConfig::default()).unwrap();
        assert!(one == four && one == there);
        assert!(one.hit_count() > 500, "{}", one.hit_count());
    }
}

#[test]
fn weights_and_ranges_limit_what_is_seen() {
    let map = waves(IVec3::ZERO, u32::MAX);
    let pose = looking(DVec3::new(-1.7, 0.2, 0.3), DVec3::ZERO);
    let with = |min_weight, max_range_m| {
        let config = RenderConfig {
            min_weight,
            max_range_m,
        };
        render(&map, &pinhole(), pose, &config)
    };
    let all = with(0.0, 100.0).unwrap();
    let range = |hit: &Hit| f64::from(hit.range_m);
    let near = with(0.0, 1.0).unwrap();
    for (all, near) in all.hits.iter().zip(&near.hits) {
        assert_eq!(near.as_ref(), all.as_ref().filter(|hit| range(hit) <= 1.0));
    }
    assert!(near.hit_count() > 100 && near.hit_count() < all.hit_count());
    // Weights are 1000 to 1999 of 32768.
    assert_eq!(with(999.0 / 32768.0, 100.0).unwrap(), all);
    assert!(with(1100.0 / 32768.0, 100.0).unwrap().hit_count() < all.hit_count() * 9 / 10);
    assert_eq!(with(2000.0 / 32768.0, 100.0).unwrap().hit_count(), 0);
    assert!(
        with(f32::NAN, 1.0)
            .unwrap_err()
            .to_string()
            .contains("min_weight must be 0 or more, not NaN")
    );
    assert!(
        with(0.0, 0.0)
            .unwrap_err()
            .to_string()
            .contains("max_range_m must be a positive")
    );
}

/// The rays of a LiDAR's view, one by one; the turned ones begin elsewhere.
#[test]
fn single_rays_meet_what_a_camera_there_sees() {
    let map = waves(IVec3::ZERO, 200);
    let renderer = Renderer::new(&map, &RenderConfig::default()).unwrap();
    let Camera::Lidar(model) = lidar() else { unreachable!() };
    let poses = [DVec3::new(0.05, 0.1, 0.02), DVec3::new(-1.7, 0.2, -0.3)].map(|from| looking(from, DVec3::ZERO));
    let mut rays = Vec::new();
    let mut wanted = Vec::new();
    for pose in poses {
        wanted.extend(renderer.view(&lidar(), pose).unwrap().hits);
        let rows = (0..model.rings()).flat_map(|row| (0..model.columns as usize).map(move |column| (column, row)));
        rays.extend(rows.map(|(column, row)| Ray {
            origin: pose.translation,
            direction: pose.rotation * lidar().rays().of(column, row).0 * 3.0,
            length_m: f64::from(model.max_range_m),
        }));
    }
    let differ = |rays: &[Ray]| {
        let same = |(a, b): (Option<Hit>, Option<Hit>)| match (a, b) {
            (Some(a), Some(b)) => (a.range_m - b.range_m).abs() < 1e-5,
            (a, b) => a == b,
        };
        let pairs = renderer.cast(rays).into_iter().zip(wanted.iter().copied());
        pairs.filter(|pair| !same(*pair)).count()
    };
    assert!(wanted.iter().flatten().count() > 1000);
    // A tile begins where its widest ray may meet something: a ray through a corner of a cell may round otherwise.
    assert!(differ(&rays) <= 2, "{}", differ(&rays));
    // Disturbed: from 10 cm aside.
    rays.iter_mut().for_each(|ray| ray.origin.y += 0.1);
    assert!(differ(&rays) > 1000, "{}", differ(&rays));
}

#[test]
fn a_ray_sees_no_farther_than_it_goes_and_only_where_it_is_a_ray() {
    let map = ball(IVec3::ZERO);
    let renderer = Renderer::new(&map, &RenderConfig::default()).unwrap();
    let ray = |origin, direction, length_m| Ray {
        origin,
        direction,
        length_m,
    };
    let start = -DVec3::X;
    let met = renderer.cast(&[
        ray(start, DVec3::X, 0.25),
        ray(start, DVec3::X, 0.15),
        ray(start, DVec3::ZERO, 1.0),
        ray(start, DVec3::X, f64::NAN),
        ray(DVec3::NAN, DVec3::X, 1.0),
        ray(DVec3::splat(1e12), DVec3::X, 1.0),
        ray(start, DVec3::X * f64::NAN, 1.0),
    ]);
    assert!((met[0].unwrap().range_m - 0.2).abs() < 1e-3);
    assert_eq!(met[1..], [None; 6]);
}

#[test]
fn cameras_and_poses_without_sense_are_refused() {
    let map = ball(IVec3::ZERO);
    let told = |camera: &Camera, pose| {
        render(&map, camera, pose, &RenderConfig::default())
            .unwrap_err()
            .to_string()
    };
    let at = |translation| Pose {
        translation,
        ..Pose::IDENTITY
    };
    assert!(told(&pinhole(), at(DVec3::new(1e9, 0.0, 0.0))).contains("outside of the map's grid, at [1000000000.0"));
    assert!(told(&pinhole(), at(DVec3::NAN)).contains("not finite"));
    let turned = Pose {
        rotation: DQuat::from_xyzw(f64::NAN, 0.0, 0.0, 1.0),
        ..Pose::IDENTITY
    };
    assert!(told(&pinhole(), turned).contains("not finite"));
    let flat = Camera::Pinhole(Pinhole {
        height: 0,
        ..Pinhole::with_fov(10, 10, 1.0)
    });
    assert!(told(&flat, Pose::IDENTITY).contains("10 x 0 pixels"));
    let empty = VoxelMap::new(MapConfig::default()).unwrap();
    let view = render(&empty, &pinhole(), at(DVec3::ONE), &RenderConfig::default()).unwrap();
    assert_eq!((view.hit_count(), view.hits.len()), (0, 80 * 60));
    // A map wider than the tree: two surfaces at opposite ends of the grid.
    let mut wide = VoxelMap::new(MapConfig::default()).unwrap();
    let block = ball(IVec3::ZERO).block(BlockIndex(IVec3::X)).unwrap().clone();
    for x in [-(1 << 28) + 2, (1 << 28) - 2] {
        wide.insert_block(BlockIndex(IVec3::new(x, 0, 0)), block.clone())
            .unwrap();
    }
    assert_eq!(
        Renderer::new(&wide, &RenderConfig::default()).err(),
        Some(RenderError::TooWide)
    );
}

#[test]
fn overviews_show_nearly_all_blocks_and_stray_ones_do_not_count() {
    for blocks in [IVec3::ZERO, IVec3::new(1_728_000, 13_338_000, 1_300)] {
        let mut map = waves(blocks, u32::MAX);
        let stray = map.block(BlockIndex(blocks)).unwrap().clone();
        map.insert_block(BlockIndex(blocks + IVec3::new(900, -700, 300)), stray)
            .unwrap();
        let renderer = Renderer::new(&map, &RenderConfig::default()).unwrap();
        let camera = Pinhole::with_fov(80, 60, 1.0);
        let poses = turntable(&renderer, &camera, &[], 5);
        assert_eq!(poses.len(), 5);
        for pose in poses.into_iter().chain(overview(&renderer, &camera, &[])) {
            let back = pose.inverse();
            let inside = renderer.surface_blocks().filter(|block| {
                let center = map.grid().center(voxel_at(*block, 0)) + 0.175;
                camera.pixel(back.transform_point(center).as_vec3()).is_some()
            });
            let (inside, all) = (inside.count() + 1, renderer.surface_blocks().len());
            assert!(inside <= all && 10 * inside >= 9 * all, "{inside} of {all}");
            let view = renderer.view(&Camera::Pinhole(camera), pose).unwrap();
            assert!(view.hit_count() * 12 > view.hits.len(), "{}", view.hit_count());
        }
    }
    let empty = VoxelMap::new(MapConfig::default()).unwrap();
    let nothing = Renderer::new(&empty, &RenderConfig::default()).unwrap();
    assert_eq!(overview(&nothing, &Pinhole::with_fov(80, 60, 1.0), &[]), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn no_surface_is_invented(holes in 2..60u32, from in prop::array::uniform3(-1.6..1.6f64), to in prop::array::uniform3(-0.5..0.5f64)) {
        prop_assume!(DVec3::from(from).distance(to.into()) > 0.1);
        let map = waves(IVec3::ZERO, holes);
        // Where anchoring leaves it.
        let from = (DVec3::from(from) / 0.05 * 4096.0).round() / 4096.0 * 0.05;
        let pose = looking(from, to.into());
        let view = render(&map, &pinhole(), pose, &RenderConfig::default()).unwrap();
        for (pixel, hit) in view.hits.iter().enumerate() {
            let Some(hit) = hit else { continue };
            let direction = pose.rotation * pinhole().rays().of(pixel % 80, pixel / 80).0;
            // The cell may end right there: look into all that touch the place.
            let at = (pose.translation + direction * f64::from(hit.range_m)) / 0.05;
            let off = |c: i32, bit: i32| if c & bit == 0 { -5e-5 } else { 5e-5 };
            let about: Vec<_> = (0..8)
                .map(|c| literal_field(&map, at + DVec3::new(off(c, 1), off(c, 2), off(c, 4))))
                .collect();
            prop_assert!(about.iter().flatten().any(|f| f.abs() < 2e-3), "{:?}", about);
        }
    }
}
