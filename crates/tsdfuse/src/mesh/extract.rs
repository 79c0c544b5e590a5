//! Marching cubes over blocks: shared vertices, no cracks, the same mesh for any number of threads.
//!
//! A vertex lies on the grid edge between two neighbouring voxel centres. The block that holds the edge's lower voxel owns
//! the vertex; it exists if any of the four cells about the edge is observed at all eight corners. Each block notes its
//! vertices as set bits, so that any block finds the number of a neighbour's vertex by counting bits: no table of vertices,
//! no merging afterwards. Pass 1 notes vertices and counts triangles, pass 2 fills arrays of the final size.

use glam::{IVec3, Vec3};
use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;

use super::{
    Mesh, MeshConfig, MeshError,
    cube::{EDGE_CORNERS, TRIANGLES},
    neighbourhood::{Neighbourhood, corner},
};
use crate::{
    index::{BLOCK_VOXELS, BlockIndex, local_number, voxel_at},
    map::{VoxelMap, min_weight_sum},
};

const AXES: [IVec3; 3] = [IVec3::X, IVec3::Y, IVec3::Z];

/// Vertices keep this distance, in voxels, from the voxel centres: so no two share a position and no triangle is degenerate.
const MARGIN: f32 = 1e-3;

/// Blocks that one task handles in pass 2.
const BLOCKS_PER_TASK: usize = 64;

/// The surface of the map: every voxel that was observed counts.
///
/// # Errors
/// [`MeshError::TooManyVertices`] beyond 2³² vertices.
///
/// ```
/// use tsdfuse::{Integrator, MapConfig, Raycast, Scan, VoxelMap, glam::Vec3};
/// // A wall one metre ahead, seen by a fan of rays.
/// let points = (-20..=20).flat_map(|y| (-20..=20).map(move |z| Vec3::new(1.0, 0.02 * y as f32, 0.02 * z as f32)));
/// let mut map = VoxelMap::new(MapConfig::default())?;
/// Raycast::default().integrate(&mut map, &Scan { points: points.collect(), ..Default::default() })?;
/// let mesh = tsdfuse::mesh::extract(&map)?;
/// assert!(mesh.vertices.iter().all(|v| (v.x - 1.0).abs() < 0.03));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn extract(map: &VoxelMap) -> Result<Mesh, MeshError> {
    extract_with(map, &MeshConfig::default())
}

/// The surface of the map.
///
/// # Errors
/// [`MeshError::TooManyVertices`] beyond 2³² vertices.
pub fn extract_with(map: &VoxelMap, config: &MeshConfig) -> Result<Mesh, MeshError> {
    let min_sum = min_weight_sum(config.min_weight);

    let patches: Vec<Patch> = map
        .block_indices()
        .into_par_iter()
        .map_init(
            || Neighbourhood::new(min_sum),
            |near, index| Patch::find(map, near, index),
        )
        .filter(|patch| patch.vertices + patch.triangles > 0)
        .collect();

    // Where each block's vertices begin in the mesh.
    let mut numbers = HashMap::with_capacity_and_hasher(patches.len(), FxBuildHasher);
    let mut total: u64 = 0;
    for (i, patch) in patches.iter().enumerate() {
        numbers.insert(patch.index, (i, total as u32));
        total += u64::from(patch.vertices);
    }
    if total > u64::from(u32::MAX) {
        return Err(MeshError::TooManyVertices(total));
    }
    let triangles: usize = patches.iter().map(|p| p.triangles as usize).sum();
    let mut mesh = Mesh {
        vertices: vec![glam::DVec3::ZERO; total as usize],
        normals: vec![Vec3::ZERO; total as usize],
        triangles: vec![[0; 3]; triangles],
    };

    let mut tasks = Vec::with_capacity(patches.len() / BLOCKS_PER_TASK + 1);
    let (mut vertices, mut normals, mut triangles) = (
        mesh.vertices.as_mut_slice(),
        mesh.normals.as_mut_slice(),
        mesh.triangles.as_mut_slice(),
    );
    for patches in patches.chunks(BLOCKS_PER_TASK) {
        let vertex_count = patches.iter().map(|p| p.vertices as usize).sum();
        let triangle_count = patches.iter().map(|p| p.triangles as usize).sum();
        tasks.push((
            patches,
            vertices.split_off_mut(..vertex_count).unwrap_or_default(),
            normals.split_off_mut(..vertex_count).unwrap_or_default(),
            triangles.split_off_mut(..triangle_count).unwrap_or_default(),
        ));
    }
    tasks.into_par_iter().for_each(|(own, vertices, normals, triangles)| {
        let mut near = Neighbourhood::new(min_sum);
        let mut places = vertices.iter_mut().zip(normals);
        let mut triangles = triangles.iter_mut();
        for patch in own {
            near.load(map, patch.index);
            for edge in patch.edges() {
                if let Some((vertex, normal)) = places.next() {
                    let (position, n) = near.vertex(edge);
                    *vertex =
                        map.grid().center(patch.index.first_voxel()) + position.as_dvec3() * map.config().voxel_size_m;
                    *normal = n;
                }
            }
            let number = VertexNumbers::new(patch.index, &patches, &numbers);
            near.for_each_triangle(|cell, edges| {
                if let Some(triangle) = triangles.next() {
                    *triangle = edges.map(|e| number.of(cell, e as usize));
                }
            });
        }
    });
    Ok(mesh)
}

/// The part of the surface that one block owns.
struct Patch {
    index: BlockIndex,
    /// One bit per grid edge with a vertex: 3·(voxel in the block) + axis.
    bits: [u64; BLOCK_VOXELS * 3 / 64],
    vertices: u32,
    triangles: u32,
}

/// A grid edge of a block: from the voxel (relative to the block's first) along the axis.
#[derive(Clone, Copy)]
struct GridEdge {
    voxel: IVec3,
    axis: usize,
}

impl Patch {
    fn find(map: &VoxelMap, near: &mut Neighbourhood, index: BlockIndex) -> Self {
        let mut patch = Self {
            index,
            bits: [0; BLOCK_VOXELS * 3 / 64],
            vertices: 0,
            triangles: 0,
        };
        near.load(map, index);
        for row in 0..64 {
            for (axis, mut voxels) in near.vertices_in_row(row % 8, row / 8).into_iter().enumerate() {
                patch.vertices += voxels.count_ones();
                while voxels != 0 {
                    let edge = 3 * (8 * row as usize + voxels.trailing_zeros() as usize) + axis;
                    patch.bits[edge / 64] |= 1 << (edge % 64);
                    voxels &= voxels - 1;
                }
            }
        }
        near.for_each_triangle(|_, _| patch.triangles += 1);
        patch
    }

    /// The grid edges with a vertex, in the order of their numbers.
    fn edges(&self) -> impl Iterator<Item = GridEdge> {
        self.bits.iter().enumerate().flat_map(|(word, &bits)| {
            let mut rest = bits;
            std::iter::from_fn(move || {
                (rest != 0).then(|| {
                    let edge = word * 64 + rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    GridEdge {
                        voxel: voxel_at(BlockIndex(IVec3::ZERO), edge / 3),
                        axis: edge % 3,
                    }
                })
            })
        })
    }

    /// How many vertices come before the one on this edge.
    fn rank(&self, edge: usize) -> u32 {
        let (word, bit) = (edge / 64, edge % 64);
        let before: u32 = self.bits[..word].iter().map(|b| b.count_ones()).sum();
        before + (self.bits[word] & ((1 << bit) - 1)).count_ones()
    }
}

/// Finds the mesh's vertices on the grid edges of one block's cells, which reach into seven neighbours.
struct VertexNumbers<'a> {
    owners: [Option<(&'a Patch, u32)>; 8],
}

impl<'a> VertexNumbers<'a> {
    fn new(
        index: BlockIndex,
        patches: &'a [Patch],
        numbers: &HashMap<BlockIndex, (usize, u32), FxBuildHasher>,
    ) -> Self {
        let owner = |c| {
            numbers
                .get(&BlockIndex(index.0 + corner(c)))
                .map(|&(i, first)| (&patches[i], first))
        };
        Self {
            owners: std::array::from_fn(owner),
        }
    }

    /// The number of the vertex on edge `edge` of a cell.
    #[inline]
    fn of(&self, cell: IVec3, edge: usize) -> u32 {
        let voxel = cell + corner(EDGE_CORNERS[edge][0]);
        let block = BlockIndex::of(voxel).0;
        let grid_edge = 3 * local_number(voxel) + edge / 4;
        self.owners[(block.x + 2 * block.y + 4 * block.z) as usize]
            .map_or(0, |(patch, first)| first + patch.rank(grid_edge))
    }
}

impl Neighbourhood {
    /// Position, relative to the centre of the block's first voxel and in voxels, and normal of the vertex on a grid edge.
    fn vertex(&self, edge: GridEdge) -> (Vec3, Vec3) {
        let (low, high) = (edge.voxel, edge.voxel + AXES[edge.axis]);
        let (f0, f1) = (self.distance(low), self.distance(high));
        let t = (f0 / (f0 - f1)).clamp(MARGIN, 1.0 - MARGIN);
        let gradient = self.gradient(low).lerp(self.gradient(high), t);
        let along = AXES[edge.axis].as_vec3();
        let normal = gradient.try_normalize().unwrap_or(if f1 > f0 { along } else { -along });
        (low.as_vec3() + along * t, normal)
    }

    /// Calls back with the cell and the three edges of each triangle in the block's own cells.
    fn for_each_triangle(&self, mut found: impl FnMut(IVec3, [u8; 3])) {
        let table = &*TRIANGLES;
        for row in 0..64 {
            let (y, z) = (row % 8, row / 8);
            let mut cells = self.surface_cells_in_row(y, z);
            while cells != 0 {
                let cell = IVec3::new(cells.trailing_zeros() as i32, y, z);
                table[self.case(cell)].iter().for_each(|&edges| found(cell, edges));
                cells &= cells - 1;
            }
        }
    }
}
