//! Scenes, their meshes and the paths through them.

#![allow(clippy::unwrap_used)] // test helpers

use glam::DVec3;
use tsdfuse_sim::{Scene, path, scene};

fn named(name: &str, seed: u64) -> Scene {
    scene::by_name(name, seed).unwrap()
}

/// Every vertex is on a surface: at distance 0, or within another solid that overlaps.
#[test]
fn no_mesh_vertex_is_in_free_space() {
    for &name in scene::names() {
        let scene = named(name, 5).translated(DVec3::new(32.0, -64.0, 8.0));
        let mesh = scene.mesh(0.005);
        assert_eq!(mesh.vertices.len(), mesh.normals.len());
        let mut on_surface = 0;
        for &v in &mesh.vertices {
            let distance = scene.signed_distance(v);
            assert!(distance < 1e-6, "{name} {v}: {distance}");
            on_surface += usize::from(distance > -1e-6);
        }
        assert!(
            on_surface > mesh.vertices.len() / 2,
            "{name}: {on_surface} of {}",
            mesh.vertices.len()
        );
    }
}

#[test]
fn simple_scenes_have_the_distance_one_expects() {
    assert_eq!(named("plane", 0).signed_distance(DVec3::new(3.0, 4.0, 1.25)), 1.25);
    assert_eq!(named("sphere", 0).signed_distance(DVec3::new(0.0, -3.0, 4.0)), 3.0);
    let cuboid = named("box", 0);
    assert!((cuboid.signed_distance(DVec3::ZERO) + 0.75).abs() < 1e-12);
    let area: f64 = cuboid
        .mesh(0.1)
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| cuboid.mesh(0.1).vertices[v as usize]);
            (b - a).cross(c - a).length() / 2.0
        })
        .sum();
    assert!((area - 27.0).abs() < 1e-9, "{area}");
}

/// Finer meshes come closer to the true area of a sphere, which they approach from below.
#[test]
fn chord_error_bounds_the_mesh() {
    let sphere = named("sphere", 0);
    for chord in [0.1, 0.01, 0.001] {
        let mesh = sphere.mesh(chord);
        let deepest = mesh.triangles.iter().map(|t| {
            let centre: DVec3 = t.map(|v| mesh.vertices[v as usize]).iter().sum::<DVec3>() / 3.0;
            -sphere.signed_distance(centre)
        });
        let deepest = deepest.fold(0.0, f64::max);
        assert!(deepest < chord && deepest > 0.1 * chord, "{chord}: {deepest}");
    }
}

#[test]
fn buried_triangles_are_left_out() {
    use tsdfuse_sim::Primitive;
    let [big, small] = [2.0, 0.5].map(|r| Primitive::ellipsoid(DVec3::splat(r)));
    let alone = Scene::new("big", vec![big.clone()]).mesh(0.01);
    let both = Scene::new("both", vec![small.clone(), big.clone()]).mesh(0.01);
    assert_eq!(alone, both);
    let apart = Scene::new("apart", vec![small.at(3.0, 0.0, 0.0), big]).mesh(0.01);
    assert!(apart.triangles.len() > alone.triangles.len());
}

#[test]
fn paths_keep_clear_of_the_scene() {
    let paths = [
        ("street", "vehicle", 1.0),
        ("street", "handheld", 0.7),
        ("hall", "drone", 0.7),
        ("hall", "handheld", 0.7),
        ("plane", "orbit", 1.5),
        ("sphere", "orbit", 3.0),
        ("box", "orbit", 3.0),
    ];
    for (name, by, clearance_m) in paths {
        for seed in 0..8 {
            let scene = named(name, seed);
            for scans in [1, 2, 150] {
                let poses = path::by_name(by, &scene, scans).unwrap();
                assert_eq!(poses.len(), scans);
                for pose in poses {
                    let distance = scene.signed_distance(pose.translation);
                    assert!(
                        distance > clearance_m,
                        "{name} {seed} {by}: {distance} m at {}",
                        pose.translation
                    );
                    assert!((pose.rotation.length() - 1.0).abs() < 1e-12);
                }
            }
        }
    }
    assert!(path::by_name("teleport", &named("box", 0), 3).is_none());
    assert!(
        path::names()
            .iter()
            .all(|by| path::by_name(by, &named("hall", 0), 0).is_some())
    );
}

/// Largest and smallest step, and largest turn, from pose to pose.
fn steps(poses: &[tsdfuse_sim::Pose]) -> (f64, f64, f64) {
    poses
        .windows(2)
        .fold((f64::INFINITY, 0.0, 0.0), |(least, most, turn), w| {
            let way = w[0].translation.distance(w[1].translation);
            (
                least.min(way),
                most.max(way),
                turn.max(w[0].rotation.angle_between(w[1].rotation)),
            )
        })
}

#[test]
fn paths_move_as_their_carriers_do() {
    let (street, hall) = (named("street", 1), named("hall", 1));
    let (least, most, turn) = steps(&path::vehicle(&street, 80));
    assert!(
        least > 0.99 && most < 1.05 && turn < 0.1,
        "vehicle {least} {most} {turn}"
    );
    let (least, most, turn) = steps(&path::drone(&hall, 60));
    assert!(least > 0.2 && most < 1.3 && turn < 0.5, "drone {least} {most} {turn}");
    let (least, most, turn) = steps(&path::handheld(&hall, 100));
    assert!(
        least > 0.12 && most < 0.16 && turn < 0.1,
        "handheld {least} {most} {turn}"
    );
    // The vehicle's height over the ground, straight below the sensor.
    for pose in path::vehicle(&street, 80) {
        let ground = street.cast(pose.translation, -DVec3::Z).unwrap();
        assert!((ground.range_m - 1.9).abs() < 0.12, "{}", ground.range_m);
    }
    // Longer than the street: closer together.
    let (_, most, _) = steps(&path::vehicle(&street, 200));
    assert!(most < 0.55);
    for pose in path::orbit(&named("sphere", 0), 30) {
        assert!((pose.rotation * DVec3::X).dot(-pose.translation.normalize()) > 1.0 - 1e-6);
    }
    let seen_from_below = |name| path::orbit(&named(name, 0), 30).iter().any(|p| p.translation.z < -1.0);
    assert!(seen_from_below("box") && !seen_from_below("plane"));
}
