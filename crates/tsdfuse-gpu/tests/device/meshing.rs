//! Meshes made on the device, against the CPU's of the same map.

use tsdfuse::{
    Mesh, VoxelMap,
    glam::IVec3,
    index::{BLOCK_VOXELS, BlockIndex, voxel_at},
    map::{Block, MapConfig, Voxel},
    mesh::{MeshConfig, extract_with},
};
use tsdfuse_gpu::{DeviceMap, Mesher, PoolConfig};

use crate::{
    gpu,
    map::{LARGE, SMALL, room},
};

/// Whether two meshes are one, but for rounding: the same triangles, vertices within some share of a voxel.
fn agree(a: &Mesh, b: &Mesh, voxel_m: f64) -> bool {
    let near = |(a, b): (&tsdfuse::glam::DVec3, &tsdfuse::glam::DVec3)| a.distance(*b) < 1e-4 * voxel_m;
    let along = |(a, b): (&tsdfuse::glam::Vec3, &tsdfuse::glam::Vec3)| a.distance(*b) < 2e-3;
    a.triangles == b.triangles
        && a.vertices.len() == b.vertices.len()
        && a.vertices.iter().zip(&b.vertices).all(near)
        && a.normals.iter().zip(&b.normals).all(along)
}

fn assert_agrees(map: &VoxelMap, pool: PoolConfig, config: MeshConfig) {
    let Some(gpu) = gpu() else { return };
    let device = DeviceMap::upload(gpu, map, pool).unwrap();
    let mesh = Mesher::new(&device).unwrap().extract(&device, &config).unwrap();
    let want = extract_with(map, &config).unwrap();
    assert!(want.triangles.len() > 1000, "{}", want.triangles.len());
    assert_eq!(
        (mesh.vertices.len(), mesh.triangles.len()),
        (want.vertices.len(), want.triangles.len())
    );
    let size = map.config().voxel_size_m;
    assert!(agree(&mesh, &want, size));
    // The comparison sees a vertex that is a little off, a normal, a triangle the other way around.
    let mut off = mesh.clone();
    off.vertices[7].x += 1e-3 * size;
    assert!(!agree(&off, &want, size));
    let mut off = mesh.clone();
    off.normals[7] = -off.normals[7];
    assert!(!agree(&off, &want, size));
    let mut off = mesh;
    off.triangles[7].reverse();
    assert!(!agree(&off, &want, size));
}

#[test]
fn the_mesh_of_a_room_is_the_cpus() {
    for pool in [LARGE, SMALL] {
        for min_weight in [0.0, 0.7] {
            assert_agrees(&room(), pool, MeshConfig { min_weight });
        }
    }
}

/// Blocks, some missing, with all sorts of cells.
fn noise() -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut state = 7_u64;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as u32
    };
    for n in 0..64 {
        let index = BlockIndex(IVec3::new(n % 4, n / 4 % 4, n / 16) - 2);
        if next() % 5 == 0 {
            continue;
        }
        let kind = next() % 3;
        let mut voxels = [Voxel::default(); BLOCK_VOXELS];
        for (local, voxel) in voxels.iter_mut().enumerate() {
            let (bits, v) = (next(), voxel_at(index, local));
            let distance_sum = match kind {
                0 => (bits >> 8 & 7) as i32 - 3,
                _ => (v.x + 2 * v.y - v.z).clamp(-3, 3) * 100 + (bits & 63) as i32,
            };
            if kind == 1 || bits % 8 != 0 {
                let weight_sum = 400 + (bits >> 12 & 0xfff);
                *voxel = Voxel {
                    weight_sum,
                    distance_sum,
                };
            }
        }
        map.insert_block(index, Block { voxels }).unwrap();
    }
    map
}

#[test]
fn all_sorts_of_cells_and_missing_blocks() {
    for min_weight in [0.0, 0.02] {
        assert_agrees(&noise(), SMALL, MeshConfig { min_weight });
    }
}

#[test]
fn a_map_without_surface_has_an_empty_mesh() {
    let Some(gpu) = gpu() else { return };
    let device = DeviceMap::new(gpu, MapConfig::default(), SMALL).unwrap();
    let mut mesher = Mesher::new(&device).unwrap();
    assert_eq!(
        mesher.extract(&device, &MeshConfig::default()).unwrap(),
        Mesh::default()
    );
    let told = mesher.extract(&device, &MeshConfig { min_weight: -1.0 }).unwrap_err();
    assert_eq!(told.to_string(), "min_weight must be 0 or more, not -1");
}
