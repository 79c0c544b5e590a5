//! Noise-free scans of surfaces that are known exactly, fused and meshed: how far is the mesh from the truth, and is it sound?

#![allow(clippy::unwrap_used)] // test helpers

use tsdfuse::{
    MapConfig, Mesh, VoxelMap,
    fuse::{Distance, FuseConfig, Method, RaycastConfig},
    glam::DVec3,
    mesh,
};
use tsdfuse_sim::{NoiseModel, Scene, Simulator, SimulatorConfig, path, scene};

const SCANS: usize = 12;

const METHODS: [(Method, Distance); 4] = [
    (Method::Raycast, Distance::Euclidean),
    (Method::Raycast, Distance::Projective),
    (Method::Normals, Distance::Euclidean),
    (Method::Patch, Distance::Euclidean),
];

/// Fuses noise-free scans of a scene; the scene and the mesh.
fn reconstruct(name: &str, (method, distance): (Method, Distance)) -> (Scene, Mesh) {
    let truth = scene::by_name(name, 0).unwrap();
    let sensor = tsdfuse::sensor::model("os0-128").unwrap();
    let config = SimulatorConfig {
        noise: NoiseModel::none(),
        ..Default::default()
    };
    let poses = path::by_name("orbit", &truth, SCANS).unwrap();
    let simulator = Simulator::new(truth, sensor.clone(), poses, config).unwrap();
    let options = FuseConfig {
        raycast: RaycastConfig { distance },
        ..Default::default()
    };
    let mut integrator = method.build(&options, Some(&sensor));
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    for scan in simulator.scans() {
        integrator.integrate(&mut map, &scan).unwrap();
    }
    (simulator.scene().clone(), mesh::extract(&map).unwrap())
}

/// Mean and largest distance of some vertices to the true surface, metres.
fn error(scene: &Scene, vertices: &[DVec3]) -> (f64, f64) {
    let distances: Vec<f64> = vertices.iter().map(|v| scene.signed_distance(*v).abs()).collect();
    let worst = distances.iter().copied().fold(0.0, f64::max);
    (distances.iter().sum::<f64>() / distances.len() as f64, worst)
}

#[test]
fn a_plane_is_flat_and_without_holes_where_it_is_seen_well() {
    // Farther out rays graze the plane and the rings lie apart: raycasting is known to be poor there (thesis 7.3).
    let near = |v: &DVec3| v.x.hypot(v.y) < 6.0;
    for (method, limit) in METHODS.into_iter().zip([0.002, 0.002, 0.0001, 0.0001]) {
        let (scene, mesh) = reconstruct("plane", method);
        let vertices: Vec<_> = mesh.vertices.iter().copied().filter(near).collect();
        let (mean, _) = error(&scene, &vertices);
        assert!(mean < limit, "{method:?}: {} mm", mean * 1e3);
        assert!(mesh.topology().is_manifold(), "{method:?}: {:?}", mesh.topology());
        let inside = mesh
            .triangles
            .iter()
            .filter(|t| t.iter().all(|&v| near(&mesh.vertices[v as usize])));
        let patch = Mesh {
            triangles: inside.copied().collect(),
            ..mesh.clone()
        };
        let open = patch
            .border_edges()
            .iter()
            .filter(|e| {
                e.iter()
                    .all(|&v| mesh.vertices[v as usize].x.hypot(mesh.vertices[v as usize].y) < 5.8)
            })
            .count();
        assert_eq!(open, 0, "{method:?}: holes in the plane");
        assert!(
            mesh.normals
                .iter()
                .zip(&mesh.vertices)
                .filter(|(_, v)| near(v))
                .all(|(n, _)| n.z > 0.9),
            "{method:?}"
        );
    }
}

#[test]
fn a_sphere_is_closed_and_round() {
    for (method, limit) in METHODS.into_iter().zip([0.005, 0.005, 0.0005, 0.006]) {
        let (scene, mesh) = reconstruct("sphere", method);
        let (mean, worst) = error(&scene, &mesh.vertices);
        assert!(
            mean < limit && worst < 0.05,
            "{method:?}: {} mm, at most {} mm",
            mean * 1e3,
            worst * 1e3
        );
        // Twelve scans are too few for lines as short as those of `patch`: between some rings it stays open.
        if method.0 == Method::Patch {
            assert!(mesh.topology().is_manifold(), "{:?}", mesh.topology());
            continue;
        }
        assert!(mesh.topology().is_closed(), "{method:?}: {:?}", mesh.topology());
        // Counter-clockwise seen from outside: the enclosed volume is positive, and the sphere's.
        let volume: f64 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        assert!((volume - 33.51).abs() < 0.5, "{method:?}: {volume} m³");
        assert!(
            mesh.normals
                .iter()
                .zip(&mesh.vertices)
                .all(|(n, v)| n.as_dvec3().dot(v.normalize()) > 0.8),
            "{method:?}"
        );
    }
}

#[test]
fn a_box_has_flat_sides() {
    for (method, limit) in METHODS.into_iter().zip([0.012, 0.008, 0.003, 0.002]) {
        let (scene, mesh) = reconstruct("box", method);
        let (mean, _) = error(&scene, &mesh.vertices);
        // Most of it at the edges, which the rays reach past.
        assert!(mean < limit, "{method:?}: {} mm", mean * 1e3);
        assert!(mesh.topology().is_manifold(), "{method:?}: {:?}", mesh.topology());
    }
}

#[test]
fn a_wrong_pose_shows() {
    let truth = scene::by_name("sphere", 0).unwrap();
    let (_, mesh) = reconstruct("sphere", METHODS[2]);
    let moved: Vec<_> = mesh.vertices.iter().map(|v| *v + DVec3::X * 0.05).collect();
    assert!(error(&truth, &moved).0 > 0.02);
}
