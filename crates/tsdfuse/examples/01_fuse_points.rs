//! From points and poses to a mesh: the whole way in one page.
//!
//! `cargo run --release --example 01_fuse_points`

#![allow(clippy::print_stdout)] // an example says what it finds

use tsdfuse::{
    Integrator, MapConfig, Patch, Pose, Scan, VoxelMap,
    glam::{DQuat, DVec3},
    mesh,
};

/// Half the edges of a room around the world's origin, metres.
const ROOM: DVec3 = DVec3::new(3.0, 2.5, 1.5);

/// What a LiDAR measures in the room: points in the sensor's frame (x forward, y left, z up), ring by ring.
fn scan_from(pose: Pose) -> Scan {
    let (mut points, mut rings) = (Vec::new(), Vec::new());
    for column in 0..900 {
        for ring in 0..48 {
            let azimuth = -f64::from(column) * std::f64::consts::TAU / 900.0;
            let elevation = (1.2 * f64::from(ring) - 28.0).to_radians();
            let direction = DQuat::from_rotation_z(azimuth) * DQuat::from_rotation_y(-elevation) * DVec3::X;
            let in_world = pose.rotation * direction;
            let range = ((in_world.signum() * ROOM - pose.translation) / in_world).min_element();
            points.push((direction * range).as_vec3());
            rings.push(ring);
        }
    }
    Scan {
        points,
        rings: Some(rings),
        pose: Some(pose),
        ..Default::default()
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Voxels of 5 cm, in a band of 20 cm on both sides of surfaces.
    let mut map = VoxelMap::new(MapConfig {
        voxel_size_m: 0.05,
        truncation_m: 0.20,
        ..Default::default()
    })?;
    let mut method = Patch::default();

    for step in 0..5 {
        let pose = Pose {
            rotation: DQuat::from_rotation_z(0.2 * f64::from(step)),
            translation: DVec3::new(0.3 * f64::from(step) - 0.6, 0.1, 0.0),
        };
        let done = method.integrate(&mut map, &scan_from(pose))?;
        println!(
            "scan {step}: {} returns fused, {} blocks updated",
            done.fused_returns,
            done.updated_blocks.len()
        );
    }

    let mesh = mesh::extract(&map)?;
    println!("{} vertices, {} triangles", mesh.vertices.len(), mesh.triangles.len());

    // All of it is wall. Edges of the room are rounded, by less than a voxel.
    let to_wall = |v: &DVec3| (v.abs() - ROOM).abs().min_element();
    let mean = mesh.vertices.iter().map(to_wall).sum::<f64>() / mesh.vertices.len() as f64;
    let worst = mesh.vertices.iter().map(to_wall).fold(0.0, f64::max);
    println!(
        "{:.2} mm from the walls, at most {:.1} mm",
        1000.0 * mean,
        1000.0 * worst
    );
    assert!(mesh.triangles.len() > 10_000 && mean < 0.002 && worst < 0.05);
    Ok(())
}

#[test]
fn it_runs() -> Result<(), Box<dyn std::error::Error>> {
    main()
}
