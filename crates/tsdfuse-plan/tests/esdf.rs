//! Distances against brute force, and distances that follow a map against those computed at its end.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // test helpers

use proptest::prelude::*;
use tsdfuse::fuse::{FuseConfig, Method};
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::mesh::{Changes, Incremental, Mesh, MeshConfig, Nearby, Piece, Surface, extract, triangle::closest_on};
use tsdfuse::{MapConfig, Pose, Scan, VoxelMap};
use tsdfuse_plan::esdf::CHUNK;
use tsdfuse_plan::{Esdf, EsdfConfig};
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};

fn simulated(name: &str, scans: usize) -> Vec<Scan> {
    let scene = scene::by_name(name, 0).unwrap();
    let poses = path::default_for(&scene, scans);
    let sensor = tsdfuse::sensor::model("os0-128").unwrap();
    let config = SimulatorConfig {
        noise: NoiseModel::none(),
        ..Default::default()
    };
    let simulator = Simulator::new(scene, sensor, poses, config).unwrap();
    simulator.scans().collect()
}

/// Returns on a sphere around the sensor's origin moved by `center`, seen from the origin.
fn sphere(center: DVec3) -> Scan {
    let points = (0..4000).filter_map(|i| {
        let (z, turn) = (1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0, f64::from(i) * 2.399_963);
        let side = (1.0 - z * z).sqrt();
        let normal = DVec3::new(side * turn.cos(), side * turn.sin(), z);
        let point = center + 0.8 * normal;
        (normal.dot(point) < 0.0).then(|| point.as_vec3())
    });
    Scan {
        points: points.collect::<Vec<Vec3>>(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}

fn map_of(scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut method = Method::Raycast.build(&FuseConfig::default(), None);
    for scan in scans {
        method.integrate(&mut map, scan).unwrap();
    }
    map
}

fn esdf_of(map: &VoxelMap, config: EsdfConfig) -> Esdf {
    let mut esdf = Esdf::new(config).unwrap();
    let mut surface = Surface::new(map, &MeshConfig::default());
    for cube in surface.cubes() {
        esdf.update(surface.pieces(cube).unwrap());
    }
    esdf
}

/// The distance to the nearest triangle, all tried.
fn brute_force(mesh: &Mesh, point: DVec3) -> f64 {
    let corners = mesh.triangles.iter().map(|t| t.map(|i| mesh.vertices[i as usize]));
    let distances = corners.map(|triangle| closest_on(triangle, point).distance(point));
    distances.fold(f64::INFINITY, f64::min)
}

/// Compares voxels around the mesh with brute force; the largest difference in voxels.
fn compare(mesh: &Mesh, esdf: &Esdf, voxels: usize) -> f64 {
    let EsdfConfig { voxel_size_m, radius_m } = *esdf.config();
    let grid = esdf.grid();
    let (mut worst, mut near) = (0.0_f64, 0);
    for i in 0..voxels {
        // Near a vertex, at all distances.
        let vertex = mesh.vertices[i * 7919 % mesh.vertices.len()];
        let away = DVec3::new((i * 37 % 101) as f64, (i * 53 % 103) as f64, (i * 71 % 107) as f64) / 51.0 - 1.0;
        let voxel = ((vertex + away * 1.2 * radius_m) / voxel_size_m).floor().as_ivec3();
        let exact = brute_force(mesh, grid.center(voxel));
        // Beyond the radius: at least that.
        let found = esdf.distance_m(voxel).map(f64::from);
        let off_m = found.map_or((radius_m - exact).max(0.0), |found| (found - exact).abs());
        worst = worst.max(off_m / voxel_size_m);
        near += usize::from(found.is_some());
    }
    assert!(near > voxels / 3, "{near} of {voxels}");
    worst
}

#[test]
fn distances_are_within_half_a_voxel_of_brute_force() {
    // What lies 3 m around a sensor in the hall: pillars, racks, stairs.
    let hall = simulated("hall", 40)[18..20].to_vec();
    let middle = hall[0].pose.unwrap().translation;
    let hall = map_of(&hall).cropped(middle - 3.0, middle + 3.0).unwrap();
    for (name, map) in [("box", map_of(&simulated("box", 8))), ("hall", hall)] {
        let mesh = extract(&map).unwrap();
        for (voxel_size_m, radius_m) in [
            (0.05, 0.6),
            (0.05, 2.0),
            (0.1, 1.0),
            (0.15, 1.0),
            (0.2, 2.0),
            (0.4, 2.0),
        ] {
            let esdf = esdf_of(&map, EsdfConfig { voxel_size_m, radius_m });
            let worst = compare(&mesh, &esdf, 300);
            println!("{name}, voxels of {voxel_size_m} m, radius {radius_m} m: at most {worst:.3} voxels off");
            assert!(worst <= 0.5, "{name} {voxel_size_m} {radius_m}: {worst}");
        }
    }
}

/// The comparison notices distances to another surface.
#[test]
fn another_surface_is_noticed() {
    let [map, other] = [DVec3::X * 3.0, DVec3::new(3.0, 0.15, 0.0)].map(|center| map_of(&[sphere(center)]));
    let config = EsdfConfig {
        voxel_size_m: 0.1,
        radius_m: 1.0,
    };
    let mesh = extract(&map).unwrap();
    assert!(compare(&mesh, &esdf_of(&map, config), 300) <= 0.5);
    assert!(compare(&mesh, &esdf_of(&other, config), 300) > 0.5);
}

/// A sphere that moves away in front of a wall: `patch` erases it where it was.
fn moving() -> Vec<Scan> {
    let wall = |y: i32| (-80..80).map(move |z| Vec3::new(6.0, 0.04 * y as f32, 0.04 * z as f32));
    let scan = |i: i32| {
        let mut scan = sphere(DVec3::new(3.0, 0.5 * f64::from(i - 3), 0.0));
        scan.points.extend((-80..80).flat_map(wall));
        scan
    };
    (0..12).map(|i| scan(i.min(6))).collect()
}

#[test]
fn distances_that_follow_a_map_are_those_of_its_end() {
    for method in [Method::Raycast, Method::Patch] {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let sensor = tsdfuse::sensor::model("os0-128");
        let mut fuser = method.build(&FuseConfig::default(), sensor.as_ref());
        let (mut surface, mut changes) = (Incremental::default(), Changes::default());
        let config = EsdfConfig::default();
        let mut esdf = Esdf::new(config).unwrap();
        let mut farthest = 0;
        for scan in &moving() {
            surface.note(&fuser.integrate(&mut map, scan).unwrap().updated_blocks);
            surface.changes(&map, &mut changes);
            esdf.update(changes.iter());
            farthest = farthest.max(esdf.chunks().len());
            let anew = esdf_of(&map, config);
            assert!(esdf == anew, "{method:?}");
            assert_eq!(esdf.chunks(), anew.chunks());
        }
        assert!(farthest > 0 && esdf != Esdf::new(config).unwrap());
    }
}

#[test]
fn what_is_near_follows_at_once_and_the_rest_in_turns() {
    const NEAR_M: f64 = 2.0;
    let map = map_of(&simulated("hall", 4));
    let (mut surface, mut changes) = (Incremental::default(), Changes::default());
    let blocks: Vec<_> = map
        .regions()
        .into_iter()
        .flat_map(|region| map.blocks_of(region))
        .collect();
    surface.note(&blocks.iter().map(|(index, _)| *index).collect::<Vec<_>>());
    surface.changes(&map, &mut changes);
    let config = EsdfConfig::default();
    let whole = esdf_of(&map, config);
    let mut nearby = Nearby::new(NEAR_M);
    let new = || {
        let mut esdf = Esdf::new(config).unwrap();
        let computed = esdf.update_near(changes.iter(), &Nearby::new(NEAR_M));
        (esdf, computed)
    };
    let (mut esdf, mut computed) = new();
    // Chunks are 6.4 m long.
    let is_near = |index: &IVec3| {
        let low = index.as_dvec3() * 6.4;
        DVec3::ZERO.clamp(low, low + 6.4).length() <= NEAR_M
    };
    let (near, far): (Vec<IVec3>, Vec<IVec3>) = whole.chunks().into_iter().partition(is_near);
    assert!(near.len() >= 4 && far.len() > 20, "{} {}", near.len(), far.len());
    assert!(near.iter().all(|index| computed.contains(index)));
    assert!(far.iter().filter(|index| computed.contains(index)).count() < far.len() / 4);
    for voxel in near
        .iter()
        .flat_map(|&index| (0..CHUNK).map(move |i| index * CHUNK + IVec3::new(i, 7 * i % CHUNK, 3 * i % CHUNK)))
    {
        assert_eq!(esdf.distance_m(voxel), whole.distance_m(voxel));
    }
    assert!(esdf != whole);
    // Each of the others once.
    for _ in 1..10 {
        nearby.move_to(DVec3::ZERO);
        let turn = esdf.update_near([], &nearby);
        assert!(!turn.iter().any(|index| computed.contains(index)));
        computed.extend(turn);
    }
    assert!(esdf == whole && esdf.memory_bytes() == whole.memory_bytes());
    // Or all at once.
    let (mut esdf, computed) = new();
    let rest = esdf.update([]);
    assert!(rest.len() > computed.len() && esdf == whole && esdf.update([]).is_empty());
}

/// That a block has no surface any more.
fn erased(piece: Piece<'_>) -> Piece<'_> {
    Piece {
        vertices: &[],
        normals: &[],
        triangles: &[],
        ..piece
    }
}

#[test]
fn erased_surface_is_forgotten() {
    let config = EsdfConfig::default();
    let map = map_of(&[sphere(DVec3::X * 3.0)]);
    let mut esdf = esdf_of(&map, config);
    assert!(!esdf.chunks().is_empty());
    let mut surface = Surface::new(&map, &MeshConfig::default());
    for cube in surface.cubes() {
        let erased = surface.pieces(cube).unwrap().map(erased);
        assert!(!esdf.update(erased).is_empty());
    }
    assert!(esdf == Esdf::new(config).unwrap());
    // Of two pieces of a block, the last counts.
    for cube in surface.cubes() {
        let pieces: Vec<_> = surface.pieces(cube).unwrap().collect();
        let erased = pieces.iter().copied().map(erased);
        esdf.update(pieces.iter().copied().chain(erased));
    }
    assert!(esdf == Esdf::new(config).unwrap());
    assert_eq!((esdf.chunks().len(), esdf.memory_bytes()), (0, 0));
}

#[test]
fn any_number_of_threads_gives_the_same_distances() {
    let map = map_of(&simulated("box", 8));
    let of = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| esdf_of(&map, EsdfConfig::default()))
    };
    let one = of(1);
    assert!(one == of(2) && one == of(5));
}

#[test]
fn gradients_lead_away_from_the_nearest_surface() {
    let center = DVec3::X * 3.0;
    let esdf = esdf_of(&map_of(&[sphere(center)]), EsdfConfig::default());
    // In front of the sphere, towards the sensor.
    let points: Vec<DVec3> = (0..200)
        .map(|i| {
            let [y, z] = [i % 20 - 10, i / 20 - 5].map(|n| 0.05 * f64::from(n));
            DVec3::new(1.2 + 0.001 * f64::from(i), y, z)
        })
        .collect();
    let found = esdf.sample_all(&points);
    for (point, nearest) in points.iter().zip(&found) {
        let nearest = nearest.unwrap();
        let from_center = *point - center;
        assert!(
            (f64::from(nearest.distance_m) - (from_center.length() - 0.8)).abs() < 0.1,
            "{point} {nearest:?}"
        );
        let direction = nearest.gradient.as_dvec3().normalize();
        assert!(direction.dot(from_center.normalize()) > 0.97, "{point} {nearest:?}");
        assert!((nearest.gradient.length() - 1.0).abs() < 0.2, "{point} {nearest:?}");
        assert_eq!(esdf.sample(*point), Some(nearest));
    }
    assert_eq!(esdf.sample(DVec3::new(-3.0, 0.0, 0.0)), None);
    assert_eq!(esdf.sample(DVec3::NAN), None);
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let told = |voxel_size_m, radius_m| {
        Esdf::new(EsdfConfig { voxel_size_m, radius_m })
            .unwrap_err()
            .to_string()
    };
    assert_eq!(told(0.0, 2.0), "voxel_size_m = 0: 1 mm to 1 km");
    assert_eq!(told(f64::NAN, 2.0), "voxel_size_m = NaN: 1 mm to 1 km");
    assert_eq!(told(0.05, 2.5), "radius_m = 2.5: 1 to 45 voxels of 0.05 m");
    assert_eq!(told(0.2, 0.1), "radius_m = 0.1: 1 to 45 voxels of 0.2 m");
    assert_eq!(told(0.2, f64::NAN), "radius_m = NaN: 1 to 45 voxels of 0.2 m");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// Moved by whole voxels, the distances are the same.
    #[test]
    fn distances_move_with_the_map(x in -40..40_i32, y in -40..40_i32, z in -40..40_i32) {
        let config = EsdfConfig { voxel_size_m: 0.25, radius_m: 1.0 };
        let map = map_of(&[sphere(DVec3::X * 3.0)]);
        let offset = IVec3::new(x, y, z);
        let pose = Pose { translation: offset.as_dvec3() * 0.25, ..Pose::IDENTITY };
        let (moved, exact) = map.transformed(&pose).unwrap();
        prop_assert!(exact);
        let (here, there) = (esdf_of(&map, config), esdf_of(&moved, config));
        let mut voxels = 0;
        here.for_each(|voxel, distance| {
            voxels += 1;
            let same = there.distance_m(voxel + offset).unwrap_or(f32::NAN);
            // Vertices far from the origin are rounded otherwise, so others may stand for the surface: half a voxel is what distances promise.
            assert!((same - distance).abs() < 0.25 / 2.0, "{voxel} {distance} {same}");
        });
        prop_assert!(voxels > 1000);
    }
}
