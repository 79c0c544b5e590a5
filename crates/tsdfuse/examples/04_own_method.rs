//! A method of your own, in a crate of your own: projective distances, with a weight that falls linearly behind the surface, as
//! voxblox (Oleynikova et al. 2017) has it. It runs on the same engine, and as fast, as the methods of this crate.
//!
//! `cargo run --release --example 04_own_method`

#![allow(clippy::print_stdout)] // an example says what it finds

use tsdfuse::{
    Integration, Integrator, MapConfig, Pose, Reach, Scan, VoxelMap,
    fearless_simd::{Simd, f32x8, mask32x8, prelude::*},
    fuse::{EightVoxels, FuseError, Line, Lines, Placed, Rule, Shape, Skip, VOXEL_RADIUS},
    glam::Vec3,
    map::VoxelUpdate,
    mesh,
};

/// The integrator; it keeps its buffers from scan to scan.
#[derive(Default)]
struct DropOff {
    placed: Placed,
    lines: Lines,
}

impl Integrator for DropOff {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        // Returns go into the world, motion undone, and are sorted by place: neighbours are fused one after the other.
        self.placed.place(map.grid(), scan)?;
        self.placed.sort(map.grid());
        let (placed, reach) = (&self.placed, map.config().truncation_vox());
        // Each return becomes a line along its ray, as long as the band.
        Ok(self.lines.run(
            map,
            placed.sorted(),
            |_| (),
            #[inline(always)]
            |i| {
                let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
                Ok(Line {
                    center: ray.end,
                    axis: ray.direction,
                    reach,
                    weight: own_weight(ray.range_m),
                })
            },
            &AlongRay,
        )?)
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?) // nothing beside the rays
    }

    fn needs_sensor(&self) -> bool {
        false
    }
}

/// The weight of a return.
fn own_weight(range_m: f32) -> f32 {
    1.0 / (1.0 + range_m)
}

/// Which voxels about a line are updated, with what distance over the truncation, and with what weight: eight at a time.
struct AlongRay;

impl Rule for AlongRay {
    const SHAPE: Shape = Shape::Cylinder;

    #[inline(always)]
    fn of<S: Simd>(&self, _: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (truncation, per_truncation, weight) = (line.reach, 1.0 / line.reach, line.weight);
        #[inline(always)]
        move |voxels| {
            let inside = voxels.within(VOXEL_RADIUS, truncation);
            let known = ((truncation - voxels.along) * per_truncation).min(1.0);
            (inside, -voxels.along * per_truncation, known * weight)
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let wall = (-60..=60).flat_map(|y| (-40..=40).map(move |z| Vec3::new(3.0, 0.025 * y as f32, 0.025 * z as f32)));
    let scan = Scan {
        points: wall.collect(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mut map = VoxelMap::new(MapConfig::default())?;
    let mut method: Box<dyn Integrator> = Box::<DropOff>::default();
    let done = method.integrate(&mut map, &scan)?;
    let mesh = mesh::extract(&map)?;
    let mean_m = mesh.vertices.iter().map(|v| (v.x - 3.0).abs()).sum::<f64>() / mesh.vertices.len() as f64;
    println!(
        "{} triangles, {:.1} mm from the wall",
        mesh.triangles.len(),
        1000.0 * mean_m
    );
    assert!(done.fused_returns == scan.points.len() as u64 && mesh.triangles.len() > 4000 && mean_m < 0.01);

    // Where speed does not matter, voxels can be updated one by one: here those on the rays, every half voxel.
    let mut simple = VoxelMap::new(MapConfig::default())?;
    let (grid, anchor) = (
        simple.grid(),
        simple.grid().anchor(scan.world_from_sensor()?.translation),
    );
    let anchor = anchor.ok_or("outside of the grid")?;
    let updates = scan.points.iter().flat_map(|&point| {
        (-8..8).filter_map(move |step| {
            let along_m = 0.025 * step as f32;
            let place = anchor.locate(point + along_m * point.normalize())?;
            let center = grid.center(place.voxel).as_vec3();
            let distance_m = (point - center).dot(point.normalize());
            Some(VoxelUpdate {
                voxel: place.voxel,
                distance_m,
                weight: own_weight(point.length()),
            })
        })
    });
    let done = simple.update(updates)?;
    println!(
        "{} blocks updated, {} updates left out",
        done.blocks.len(),
        done.left_out
    );
    let near = simple
        .sample(tsdfuse::glam::DVec3::new(2.95, 0.0, 0.0))
        .ok_or("nothing is known there")?;
    assert!((near.distance_m - 0.05).abs() < 0.01, "{near:?}");
    Ok(())
}

#[test]
fn it_runs() -> Result<(), Box<dyn std::error::Error>> {
    main()
}
