//! Methods of one's own, as another crate would write them: they must be able to do what the crate's own methods do.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use tsdfuse::{
    Integration, Integrator, MapConfig, Raycast, Reach, Scan, VoxelMap,
    fearless_simd::{Simd, f32x8, mask32x8, prelude::*},
    fuse::{EightVoxels, FuseError, Gather, Line, Lines, Placed, Rule, Shape, Skip, VOXEL_RADIUS},
    glam::IVec3,
    index::{BlockIndex, local_number, voxel_at},
    map::VoxelUpdate,
};

/// Raycasting (5.5)–(5.8), written anew on the public engine; `scale` disturbs its weights.
struct Own {
    scale: f32,
    placed: Placed,
    lines: Lines,
}

impl Own {
    fn new(scale: f32) -> Self {
        Self {
            scale,
            placed: Placed::default(),
            lines: Lines::default(),
        }
    }
}

impl Integrator for Own {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        self.placed.place(map.grid(), scan)?;
        self.placed.sort(map.grid());
        let (placed, reach, scale) = (&self.placed, map.config().truncation_vox(), self.scale);
        let line = |i| {
            let ray = placed.ray(i).ok_or(Skip::OutsideGrid)?;
            let weight = scale * (1.0 / ray.range_m).min(1.0);
            Ok(Line {
                center: ray.end,
                axis: ray.direction,
                reach,
                weight,
            })
        };
        Ok(self.lines.run(map, placed.sorted(), |_| (), line, &Ball)?)
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        false
    }
}

struct Ball;

impl Rule for Ball {
    const SHAPE: Shape = Shape::RoundedCylinder;

    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let (truncation, inverse) = (line.reach, 1.0 / line.reach);
        let weight = f32x8::splat(simd, line.weight);
        #[inline(always)]
        move |v| {
            let inside = v.within(VOXEL_RADIUS, truncation) & v.distance2.simd_le(truncation * truncation);
            (inside, (v.distance2.sqrt() * inverse).copysign(-v.along), weight)
        }
    }
}

fn fused(integrator: &mut dyn Integrator) -> (VoxelMap, Vec<Integration>) {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let done = (0..3).map(|number| integrator.integrate(&mut map, &common::scan(number, 20_000)).unwrap());
    let done = done.collect();
    (map, done)
}

#[test]
fn raycasting_on_the_public_engine_is_raycasting() {
    let ((own, own_done), (crates, done)) = (fused(&mut Own::new(1.0)), fused(&mut Raycast::default()));
    assert!(own == crates && own.block_count() > 1000);
    for (own, done) in own_done.iter().zip(&done) {
        assert_eq!((own.fused_returns, own.skipped), (done.fused_returns, done.skipped));
        assert_eq!(own.updated_blocks, done.updated_blocks);
    }
    assert!(fused(&mut Own::new(0.9)).0 != crates);
}

/// Some updates, many of the same voxels, at the borders of blocks and regions.
fn updates() -> Vec<VoxelUpdate> {
    let update = |i: i32| VoxelUpdate {
        voxel: IVec3::new(i * 7 % 140 - 70, i * 13 % 20 - 10, i * 5 % 9 - 68),
        distance_m: 0.001 * (i * 31 % 500 - 250) as f32,
        weight: 0.01 * (i * 17 % 120) as f32,
    };
    (0..5000).map(update).collect()
}

#[test]
fn single_updates_sum_up_as_the_engine_s() {
    let config = MapConfig {
        max_weight: 3.0,
        ..Default::default()
    };
    let (mut single, mut gathered) = (VoxelMap::new(config).unwrap(), VoxelMap::new(config).unwrap());
    let updates = updates();
    let done = single.update(updates.iter().copied()).unwrap();
    // Limited after each update there, after all of a block here: so few at a time that no limit is reached between.
    let mut engine = Gather::<VoxelUpdate>::default();
    let all = engine
        .run(
            &mut gathered,
            updates.len(),
            |items, near| items.for_each(|i| near.block(BlockIndex::of(updates[i].voxel), i as u32, updates[i])),
            |_| false,
            |_, items, sums| {
                for update in items.iter() {
                    sums.add(
                        local_number(update.voxel),
                        update.distance_m * (1.0 / 0.2),
                        update.weight,
                    );
                }
            },
        )
        .unwrap();
    let (mut blocks, mut others) = (done.blocks.clone(), all.updated_blocks);
    blocks.sort_unstable();
    others.sort_unstable();
    assert_eq!(blocks, others);
    assert_eq!(blocks, single.block_indices());
    assert_eq!(done.left_out, updates.iter().filter(|u| u.weight == 0.0).count() as u64);
    assert_eq!((single.integrations(), gathered.integrations()), (1, 1));
    for &block in &blocks {
        for local in 0..512 {
            let voxel = voxel_at(block, local);
            let (a, b) = (single.voxel(voxel), gathered.voxel(voxel));
            assert_eq!(a.weight_sum, b.weight_sum, "{voxel}");
            if a.weight() < 3.0 {
                assert_eq!(a, b, "{voxel}");
            }
        }
    }
}

#[test]
fn what_is_no_observation_is_left_out_and_counted() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let good = VoxelUpdate {
        voxel: IVec3::new(1, 2, 3),
        distance_m: 0.1,
        weight: 1.0,
    };
    let bad = [
        VoxelUpdate {
            distance_m: f32::NAN,
            ..good
        },
        VoxelUpdate {
            weight: f32::NAN,
            ..good
        },
        VoxelUpdate { weight: -1.0, ..good },
        VoxelUpdate { weight: 0.0, ..good },
        VoxelUpdate {
            voxel: IVec3::new(0, i32::MAX, 0),
            ..good
        },
        VoxelUpdate {
            voxel: IVec3::new(0, 0, i32::MIN),
            ..good
        },
    ];
    let done = map.update(bad).unwrap();
    assert_eq!((done.blocks.len(), done.left_out, map.block_count()), (0, 6, 0));
    // What is too far or too heavy is limited.
    let done = map
        .update([
            good,
            VoxelUpdate {
                distance_m: f32::INFINITY,
                weight: f32::INFINITY,
                ..good
            },
            VoxelUpdate {
                distance_m: -9.0,
                ..good
            },
        ])
        .unwrap();
    assert_eq!((done.blocks.len(), done.left_out), (1, 0));
    let voxel = map.voxel(good.voxel);
    assert_eq!(voxel.weight(), 3.0);
    assert!((voxel.distance().unwrap() - 0.5 / 3.0).abs() < 1e-4);
}
