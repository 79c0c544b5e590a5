//! A mesh that follows the map scan by scan: after each scan, only the pieces that changed are made again.
//!
//! `cargo run --release --example 03_follow_a_growing_mesh`

#![allow(clippy::print_stdout)] // an example says what it finds

use std::collections::HashMap;

use tsdfuse::{
    Integrator, MapConfig, Raycast, Scan, VoxelMap,
    glam::{DVec3, Vec3},
    mesh::{self, Changes, Incremental},
};

/// A wall beside the way, 2 m to the left; each scan sees 3 m of it.
fn scan_at(x: f64) -> Scan {
    let wall = (-60..=60).flat_map(|x| (-40..=40).map(move |z| Vec3::new(0.025 * x as f32, 2.0, 0.025 * z as f32)));
    let pose = tsdfuse::Pose {
        translation: DVec3::new(x, 0.0, 0.0),
        ..tsdfuse::Pose::IDENTITY
    };
    Scan {
        points: wall.collect(),
        pose: Some(pose),
        ..Default::default()
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut map = VoxelMap::new(MapConfig::default())?;
    let mut raycast = Raycast::default();
    let (mut surface, mut changes) = (Incremental::default(), Changes::default());

    // What a viewer shows: the triangles of each block.
    let mut shown = HashMap::new();
    for step in 0..8 {
        let done = raycast.integrate(&mut map, &scan_at(0.5 * f64::from(step)))?;
        surface.note(&done.updated_blocks);
        surface.changes(&map, &mut changes);
        for piece in changes.iter() {
            // In place of what this block showed before; a piece without triangles removes it.
            shown.insert(piece.block, piece.triangles.len());
        }
        let triangles: usize = shown.values().sum();
        println!(
            "scan {step}: {} pieces changed, {triangles} triangles are shown",
            changes.len()
        );
    }

    let whole = mesh::extract(&map)?;
    assert_eq!(shown.values().sum::<usize>(), whole.triangles.len());
    assert!(whole.triangles.len() > 5000);
    Ok(())
}

#[test]
fn it_runs() -> Result<(), Box<dyn std::error::Error>> {
    main()
}
