//! Marching cubes word by word, voxel by voxel, to compare with.

use std::collections::BTreeMap;

use fearless_simd::Level;
use glam::{IVec3, Vec3};

use super::{
    Mesh, MeshConfig,
    cube::{EDGE_CORNERS, triangles},
    extract::extract_from,
    mesher::Source,
    signs::Signs,
};
use crate::{
    MapConfig,
    index::{BLOCK_VOXELS, BlockIndex, voxel_at},
    map::{Block, Voxel, VoxelMap},
};

const AXES: [IVec3; 3] = [IVec3::X, IVec3::Y, IVec3::Z];

struct Literal<'a> {
    map: &'a VoxelMap,
    min_weight: f32,
}

impl Literal<'_> {
    /// F where the voxel was observed.
    fn f(&self, voxel: IVec3) -> Option<f32> {
        let v = self.map.voxel(voxel);
        v.distance().filter(|_| v.weight() >= self.min_weight)
    }

    fn corner(cell: IVec3, c: usize) -> IVec3 {
        cell + IVec3::new(c as i32 & 1, c as i32 >> 1 & 1, c as i32 >> 2)
    }

    fn is_cell(&self, cell: IVec3) -> bool {
        (0..8).all(|c| self.f(Self::corner(cell, c)).is_some())
    }

    fn has_vertex(&self, v: IVec3, axis: usize) -> bool {
        let (u, w) = (AXES[(axis + 1) % 3], AXES[(axis + 2) % 3]);
        match (self.f(v), self.f(v + AXES[axis])) {
            (Some(a), Some(b)) if (a < 0.0) != (b < 0.0) => {
                [v, v - u, v - w, v - u - w].iter().any(|&c| self.is_cell(c))
            }
            _ => false,
        }
    }

    fn gradient(&self, v: IVec3) -> Vec3 {
        let here = self.f(v).unwrap();
        Vec3::from(AXES.map(|axis| match (self.f(v - axis), self.f(v + axis)) {
            (Some(low), Some(high)) => 0.5 * (high - low),
            (Some(low), None) => here - low,
            (None, Some(high)) => high - here,
            (None, None) => 0.0,
        }))
    }

    fn mesh(&self) -> Mesh {
        let (mut mesh, mut numbers) = (Mesh::default(), BTreeMap::new());
        let (grid, size) = (self.map.grid(), self.map.config().voxel_size_m);
        let voxels = || {
            let all = self.map.block_indices().into_iter();
            all.flat_map(|block| (0..BLOCK_VOXELS).map(move |local| (block, voxel_at(block, local))))
        };
        for (block, v) in voxels() {
            for (axis, &along) in AXES.iter().enumerate().filter(|(axis, _)| self.has_vertex(v, *axis)) {
                numbers.insert((v.to_array(), axis), mesh.vertices.len() as u32);
                let (f0, f1) = (self.f(v).unwrap(), self.f(v + along).unwrap());
                let t = (f0 / (f0 - f1)).clamp(1e-3, 1.0 - 1e-3);
                let gradient = self.gradient(v).lerp(self.gradient(v + along), t);
                let along = along.as_vec3();
                let flat = if f1 > f0 { along } else { -along };
                mesh.normals.push(gradient.try_normalize().unwrap_or(flat));
                let in_block = (v - block.first_voxel()).as_vec3() + along * t;
                mesh.vertices
                    .push(grid.center(block.first_voxel()) + in_block.as_dvec3() * size);
            }
        }
        for (_, cell) in voxels().filter(|(_, cell)| self.is_cell(*cell)) {
            let is_negative = |c| self.f(Self::corner(cell, c)).unwrap() < 0.0;
            let negative = (0..8).fold(0, |set, c| set | usize::from(is_negative(c)) << c);
            let number = |edge: u8| {
                let low = Self::corner(cell, EDGE_CORNERS[edge as usize][0]);
                numbers[&(low.to_array(), edge as usize / 4)]
            };
            mesh.triangles
                .extend(triangles(negative).into_iter().map(|t| t.map(number)));
        }
        mesh
    }
}

fn noise(state: &mut u64) -> u32 {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*state >> 33) as u32
}

/// Blocks about the corner of eight regions, some missing, with random voxels.
fn random_map(seed: u64, config: MapConfig) -> VoxelMap {
    let (mut map, mut state) = (VoxelMap::new(config).unwrap(), seed);
    for n in 0..64 {
        let index = BlockIndex(IVec3::new(n % 4, n / 4 % 4, n / 16) - 2);
        if noise(&mut state).is_multiple_of(5) {
            continue;
        }
        let kind = noise(&mut state) % 3;
        let mut block = Block {
            voxels: [Voxel::default(); BLOCK_VOXELS],
        };
        for (local, voxel) in block.voxels.iter_mut().enumerate() {
            let bits = noise(&mut state);
            let v = voxel_at(index, local);
            // All sorts of cells; a plane; a plane with holes.
            let distance = match kind {
                0 => (bits >> 8 & 7) as i32 - 3,
                _ => (v.x + 2 * v.y - v.z).clamp(-3, 3) * 100 + (bits & 63) as i32,
            };
            *voxel = if bits.is_multiple_of(8) && kind != 1 {
                Voxel::default()
            } else {
                Voxel {
                    weight_sum: 400 + (bits >> 12 & 0xfff),
                    distance_sum: distance,
                }
            };
        }
        map.insert_block(index, block).unwrap();
    }
    map
}

fn extracted(map: &VoxelMap, config: MeshConfig, level: Level) -> Mesh {
    let min_sum = config.min_weight_sum();
    extract_from(&Source { map, min_sum }, &Signs::of_all(map, min_sum, level), level).unwrap()
}

#[test]
fn the_mesh_is_the_literal_one_with_all_instructions() {
    let mut levels = vec![Level::baseline(), Level::new()];
    #[cfg(target_arch = "x86_64")]
    levels.extend(Level::new().as_avx2().map(Level::Avx2));
    for (seed, min_weight) in [(1, 0.0), (2, 0.015), (3, 0.02)] {
        let map = random_map(seed, MapConfig::default());
        let literal = Literal { map: &map, min_weight }.mesh();
        assert!(literal.vertices.len() > 1000 && literal.triangles.len() > 1000);
        for &level in &levels {
            let mesh = extracted(&map, MeshConfig { min_weight }, level);
            assert!(mesh == literal, "seed {seed}, {level:?}");
            // And the comparison sees a weight, and a voxel.
            assert!(extracted(&map, MeshConfig { min_weight: 0.025 }, level) != literal);
            assert!(
                extracted(
                    &random_map(seed + 10, MapConfig::default()),
                    MeshConfig { min_weight },
                    level
                ) != literal
            );
        }
    }
}
