//! Marching cubes over blocks: shared vertices, no cracks, the same mesh for any number of threads.
//!
//! A vertex lies on the grid edge between two neighbouring voxel centres. The block that holds the edge's lower voxel owns
//! the vertex; it exists if all eight corners of at least one of the four cells around the edge are observed. Each block marks its
//! vertices as set bits, so that any block can find the number of a neighbour's vertex by counting bits. There is no table of
//! vertices, and nothing is merged afterwards.
//!
//! ```text
//!   voxels ─▶ signs of each block, as bits            pass 1: the only one to read all voxels
//!   signs of a block and its rim ─▶ cells, edges      pass 2: counts vertices and triangles
//!   voxels near the edges ─▶ vertices, triangles      pass 3: fills arrays of the final size
//! ```

use fearless_simd::{Level, dispatch};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{
    Mesh, MeshConfig, MeshError,
    distances::GridEdge,
    mesher::{Mesher, Source},
    near::{CORNERS, Finder, OWN, PerBlock, Place, offset_to},
    neighbourhood::Cells,
    signs::Signs,
};
use crate::{index::BlockIndex, map::VoxelMap};

/// Blocks that one task handles.
pub(super) const BLOCKS_PER_TASK: usize = 64;

/// The surface of the map, from all observed voxels.
///
/// # Errors
/// [`MeshError::TooManyVertices`] beyond 2³² vertices.
///
/// ```
/// use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3};
/// // A wall one metre ahead, seen by a fan of rays.
/// let points = (-20..=20).flat_map(|y| (-20..=20).map(move |z| Vec3::new(1.0, 0.02 * y as f32, 0.02 * z as f32)));
/// let mut map = VoxelMap::new(MapConfig::default())?;
/// Raycast::default().integrate(&mut map, &Scan { points: points.collect(), pose: Some(Pose::IDENTITY), ..Default::default() })?;
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
    let (level, min_sum) = (Level::new(), config.min_weight_sum());
    let signs = Signs::of_all(map, min_sum, level);
    extract_from(&Source { map, min_sum }, &signs, level)
}

/// As [`extract_with`], if the signs of all blocks are known already.
pub(super) fn extract_from(source: &Source<'_>, signs: &PerBlock<Signs>, level: Level) -> Result<Mesh, MeshError> {
    let map = source.map;
    let (mut patches, numbers) = patches(map, signs, level);

    // Where each block's vertices begin in the mesh.
    let mut total: u64 = 0;
    for patch in &mut patches {
        patch.first = total as u32;
        total += u64::from(patch.vertices);
    }
    if total > u64::from(u32::MAX) {
        return Err(MeshError::TooManyVertices(total));
    }
    let triangles: usize = patches.iter().map(|p| p.triangles as usize).sum();
    let mut mesh = Mesh {
        // All threads ask for the memory.
        vertices: (0..total as usize).into_par_iter().map(|_| DVec3::ZERO).collect(),
        normals: (0..total as usize).into_par_iter().map(|_| Vec3::ZERO).collect(),
        triangles: vec![[0; 3]; triangles],
    };

    let mut tasks = Vec::with_capacity(patches.len() / BLOCKS_PER_TASK + 1);
    let mut rest = Rest {
        vertices: &mut mesh.vertices,
        normals: &mut mesh.normals,
        triangles: &mut mesh.triangles,
    };
    for patches in patches.chunks(BLOCKS_PER_TASK) {
        let vertices = patches.iter().map(|p| p.vertices).sum();
        let triangles = patches.iter().map(|p| p.triangles).sum();
        tasks.push((patches, rest.split_off(vertices, triangles)));
    }
    tasks.into_par_iter().for_each(|(own, mut rest)| {
        let (mut finder, mut mesher) = (Finder::new(map), Mesher::new());
        dispatch!(level, simd => for patch in own {
            let places = finder.near(patch.index);
            mesher.load(simd, signs, &places, Cells::About);
            mesher.number_vertices(8, patch.first);
            for &n in &CORNERS[1..] {
                let number = places[n].and_then(|p| numbers.get(p));
                if let Some(patch) = number.and_then(|&n| patches.get(n as usize)) {
                    patch.lend(&mut mesher, offset_to(n).to_array());
                }
            }
            let out = rest.split_off(patch.vertices, patch.triangles);
            mesher.vertices(simd, source, &places, patch.index, (out.vertices, out.normals));
            let mut triangles = out.triangles.iter_mut();
            mesher.for_each_triangle(|corners| {
                if let Some(triangle) = triangles.next() {
                    *triangle = corners;
                }
            });
        });
    });
    Ok(mesh)
}

/// The part of a mesh that is still to be filled.
#[derive(Default)]
struct Rest<'a> {
    vertices: &'a mut [DVec3],
    normals: &'a mut [Vec3],
    triangles: &'a mut [[u32; 3]],
}

impl<'a> Rest<'a> {
    /// Splits off the first vertices and triangles.
    fn split_off(&mut self, vertices: u32, triangles: u32) -> Self {
        Self {
            vertices: self.vertices.split_off_mut(..vertices as usize).unwrap_or_default(),
            normals: self.normals.split_off_mut(..vertices as usize).unwrap_or_default(),
            triangles: self.triangles.split_off_mut(..triangles as usize).unwrap_or_default(),
        }
    }
}

/// The parts of the surface, in order, and for each block the number of its part.
fn patches(map: &VoxelMap, signs: &PerBlock<Signs>, level: Level) -> (Vec<Patch>, PerBlock<u32>) {
    let indices = map.block_indices();
    let chunks = indices.par_chunks(BLOCKS_PER_TASK).map(|indices| {
        let (mut finder, mut mesher) = (Finder::new(map), Mesher::new());
        let mut patches = Vec::new();
        dispatch!(level, simd => for &index in indices {
            let places = finder.near(index);
            if signs.may_have_surface(&places) {
                mesher.load(simd, signs, &places, Cells::About);
                patches.extend(places[OWN].and_then(|place| Patch::of(&mesher, index, place)));
            }
        });
        patches
    });
    let patches = chunks.collect::<Vec<_>>().into_iter().flatten().collect::<Vec<_>>();
    let mut numbers = signs.map(|_| u32::MAX);
    for (number, patch) in patches.iter().enumerate() {
        if let Some(n) = numbers.get_mut(patch.place) {
            *n = number as u32;
        }
    }
    (patches, numbers)
}

/// The part of the surface that one block owns.
struct Patch {
    index: BlockIndex,
    place: Place,
    /// Its grid edges with a vertex, along x, y and z, layer by layer: bit x + 8 y.
    edges: [[u64; 8]; 3],
    /// How many of its vertices come before each layer.
    before: [u16; 8],
    vertices: u32,
    triangles: u32,
    /// The number of its first vertex in the mesh.
    first: u32,
}

impl Patch {
    /// `None` if there is no surface.
    #[inline(always)]
    fn of(mesher: &Mesher, index: BlockIndex, place: Place) -> Option<Self> {
        let edges = mesher.near.own_edges();
        let (mut before, mut vertices) = ([0; 8], 0);
        for (z, before) in before.iter_mut().enumerate() {
            *before = vertices as u16;
            vertices += edges.iter().map(|layers| layers[z].count_ones()).sum::<u32>();
        }
        let triangles = mesher.triangle_count();
        (vertices + triangles > 0).then_some(Self {
            index,
            place,
            edges,
            before,
            vertices,
            triangles,
            first: 0,
        })
    }

    /// Passes to a neighbouring block the numbers of the vertices that its cells share with this one.
    #[inline(always)]
    fn lend(&self, mesher: &mut Mesher, offset: [i32; 3]) {
        let beside = offset.map(|o| o > 0);
        let row = if beside[0] { 0x0101_0101_0101_0101 } else { u64::MAX };
        let layer = if beside[1] { 0xff } else { u64::MAX };
        for z in 0..if beside[2] { 1 } else { 8 } {
            // Edges along the other axes lie farther out.
            for axis in (0..3).filter(|&axis| !beside[axis]) {
                let mut left = self.edges[axis][z] & row & layer;
                while left != 0 {
                    let bit = left.trailing_zeros();
                    left &= left - 1;
                    let voxel = [bit as i32 & 7, bit as i32 >> 3, z as i32];
                    let voxel = [0, 1, 2].map(|k| voxel[k] + 8 * offset[k]);
                    mesher.set_number(GridEdge::new(voxel, axis), self.first + self.rank(z, bit, axis));
                }
            }
        }
    }

    /// How many vertices come before the one on the edge along `axis` from the voxel with this bit in layer `z`.
    #[inline(always)]
    fn rank(&self, z: usize, bit: u32, axis: usize) -> u32 {
        let mut rank = u32::from(self.before[z]);
        for (other, layers) in self.edges.iter().enumerate() {
            let through = u64::from(other < axis);
            rank += (layers[z] & ((1 + through) << bit).wrapping_sub(1)).count_ones();
        }
        rank
    }
}
