//! What a map answers: how far the nearest surface is, in which direction, and what a ray meets.
//!
//! `cargo run --release --example 02_ask_distances`

#![allow(clippy::print_stdout)] // an example says what it finds

use tsdfuse::{
    Integrator, MapConfig, Pose, Raycast, Renderer, Scan, VoxelMap,
    fuse::{Distance, RaycastConfig},
    glam::{DVec3, Vec3},
    render::Ray,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A wall 2 m ahead of the sensor, which stands at the world's origin.
    let wall = (-150..=150).flat_map(|y| (-100..=100).map(move |z| Vec3::new(2.0, 0.01 * y as f32, 0.01 * z as f32)));
    let scan = Scan {
        points: wall.collect(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mut map = VoxelMap::new(MapConfig {
        voxel_size_m: 0.05,
        truncation_m: 0.30,
        ..Default::default()
    })?;
    Raycast::new(RaycastConfig {
        distance: Distance::Projective,
    })
    .integrate(&mut map, &scan)?;

    // One point, 12 cm in front of the wall: distance in metres, and its gradient, which points away from the wall.
    let sample = map.sample(DVec3::new(1.88, 0.0, 0.0)).ok_or("nothing is known there")?;
    println!(
        "{:.3} m from the wall, away from it is {:.2}",
        sample.distance_m, sample.gradient
    );
    assert!((sample.distance_m - 0.12).abs() < 0.01 && sample.gradient.x < -0.9);

    // Many points at once. What was never observed has no distance.
    let line: Vec<DVec3> = (0..30).map(|i| DVec3::new(0.1 * f64::from(i), 0.2, 0.0)).collect();
    let samples = map.sample_all(&line);
    for (point, sample) in line.iter().zip(&samples) {
        let told = sample.map_or("unknown".into(), |s| format!("{:+.3} m", s.distance_m));
        println!("x = {:.1} m: {told}", point.x);
    }
    assert!(samples[10].is_none() && samples[19].is_some() && samples[29].is_none());

    // All voxels that were observed, or a box of voxels as arrays.
    let behind = map.voxels().filter(|voxel| voxel.distance_m < 0.0).count();
    let dense = map.dense(DVec3::new(1.7, -0.5, -0.5), DVec3::new(2.3, 0.5, 0.5))?;
    println!(
        "{behind} voxels behind the wall; the box has the shape {:?} (z, y, x)",
        dense.shape
    );
    assert!(behind > 0 && dense.shape == [20, 20, 12]);

    // What a ray meets. The renderer finds the surface once, then casts any number of rays.
    let renderer = Renderer::new(&map, &Default::default())?;
    let ray = Ray {
        origin: DVec3::ZERO,
        direction: DVec3::new(1.0, 0.2, 0.0),
        length_m: 10.0,
    };
    let hit = renderer.cast(&[ray])[0].ok_or("the ray meets nothing")?;
    println!("the ray ends after {:.3} m", hit.range_m);
    assert!((f64::from(hit.range_m) - 2.0 * 1.04f64.sqrt()).abs() < 0.01);
    Ok(())
}

#[test]
fn it_runs() -> Result<(), Box<dyn std::error::Error>> {
    main()
}
