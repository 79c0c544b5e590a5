//! The methods that fuse images (depth, caminal, cylindrical, kuehner) against their formulas as they stand.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use std::collections::BTreeSet;

use common::{Voxels, assert_agrees, scan};
use tsdfuse::{
    Integrator, MapConfig, Scan, VoxelMap,
    fuse::Depth,
    glam::{DVec3, IVec3},
    index::{BlockIndex, voxel_at},
    sensor::Pinhole,
};

const CAMERA: Pinhole = Pinhole {
    width: 72,
    height: 56,
    fx: 50.0,
    fy: 52.0,
    cx: 34.0,
    cy: 29.0,
};

/// A depth image of the room in which [`scan`] is, with a pixel missing here and there.
fn frame(number: usize) -> Scan {
    let room = scan(number, 1);
    let half = DVec3::new(3.0, 2.5, 1.5);
    let points = (0..CAMERA.pixels()).filter(|i| i % 11 != 3).map(|i| {
        let ray = CAMERA.ray((i % 72) as f32, (i / 72) as f32);
        let in_world = room.pose.rotation * ray.as_dvec3();
        let depth = ((in_world.signum() * half - room.pose.translation) / in_world).min_element();
        ray * (depth + 0.02 * ((i * 7919) % 1000) as f64 / 1000.0) as f32
    });
    Scan {
        points: points.collect(),
        camera: Some(CAMERA),
        ..room
    }
}

/// A band that does not end on a border of blocks, as walls are multiples of their edge away.
fn config() -> MapConfig {
    MapConfig {
        truncation_m: 0.19,
        ..Default::default()
    }
}

fn fuse(method: &mut dyn Integrator, scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(config()).unwrap();
    for scan in scans {
        method.integrate(&mut map, scan).unwrap();
    }
    map
}

/// The blocks within the grid's unit cubes of 8³ voxels that a line from `a` to `b` passes, by testing all in its bounding box.
fn blocks_on(a: DVec3, b: DVec3, edge: f64) -> Vec<BlockIndex> {
    let (lo, hi) = (
        (a.min(b) / edge).floor().as_ivec3(),
        (a.max(b) / edge).floor().as_ivec3(),
    );
    let all =
        (lo.z..=hi.z).flat_map(|z| (lo.y..=hi.y).flat_map(move |y| (lo.x..=hi.x).map(move |x| IVec3::new(x, y, z))));
    let crossed = |block: &IVec3| {
        let (t0, t1) = (
            (block.as_dvec3() * edge - a) / (b - a),
            ((block.as_dvec3() + 1.0) * edge - a) / (b - a),
        );
        t0.min(t1).max_element().max(0.0) < t0.max(t1).min_element().min(1.0)
    };
    all.filter(crossed).map(BlockIndex).collect()
}

/// (5.2) and (5.3) for all voxels of all blocks, after allocation along the lines of sight.
fn literal_depth(frames: &[Scan]) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = config();
    let mut sums = Voxels::new();
    for frame in frames {
        // Blocks that hold something stay.
        let mut blocks: BTreeSet<_> = sums.keys().map(|&v| BlockIndex::of(v.into())).collect();
        let mut image = vec![0.0; CAMERA.pixels()];
        for p in &frame.points {
            let (u, v) = CAMERA.project(*p);
            image[v.round() as usize * 72 + u.round() as usize] = f64::from(p.x);
            let at = |depth: f64| frame.pose.transform_point(p.as_dvec3() * (depth / f64::from(p.x)));
            blocks.extend(blocks_on(at(f64::from(p.x) - mu), at(f64::from(p.x) + mu), 8.0 * k));
        }
        for voxel in blocks
            .iter()
            .flat_map(|&b| (0..512).map(move |local| voxel_at(b, local)))
        {
            let x = frame.pose.inverse().transform_point((voxel.as_dvec3() + 0.5) * k);
            let (u, v) = (34.0 - 50.0 * x.y / x.x, 29.0 - 52.0 * x.z / x.x);
            let (u, v) = (u.round(), v.round());
            if x.x > 0.0 && (0.0..72.0).contains(&u) && (0.0..56.0).contains(&v) {
                let depth = image[v as usize * 72 + u as usize];
                let eta = depth - x.x;
                if depth > 0.0 && eta >= -mu {
                    let sum = sums.entry(voxel.to_array()).or_default();
                    *sum = (sum.0 + 1.0, sum.1 + (eta / mu).min(1.0));
                }
            }
        }
    }
    sums.into_iter().map(|(v, (w, f))| (v, (w, f / w))).collect()
}

#[test]
fn depth_is_what_its_formulas_say() {
    let frames = [frame(0), frame(1), frame(2)];
    let map = fuse(&mut Depth::default(), &frames);
    assert!(map.observed_voxel_count() > 20_000);
    assert_agrees(&map, &literal_depth(&frames), 0.005, "depth");
}
