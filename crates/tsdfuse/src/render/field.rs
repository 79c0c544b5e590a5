//! The map, prepared for rays: the blocks with surface, their neighbours, and the tree that finds them.

use fearless_simd::{Level, dispatch};
use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::cell::crossing;
use super::tree::{Beam, Leaf, MAX_SPAN, Tree};
use super::walk::{Ray, Visit};
use super::{Hit, RenderError};
use crate::index::{BLOCK_EDGE, BLOCK_VOXELS, BlockIndex, local_number};
use crate::map::{Block, Voxel, VoxelMap};
use crate::mesh::near::Finder;
use crate::mesh::neighbourhood::{Cells, Neighbourhood};
use crate::mesh::{MeshConfig, signs::Signs};
use crate::trilinear::{Corners, trilinear};

/// The surface of a map.
#[derive(Debug)]
pub(super) struct Field<'a> {
    blocks: Vec<Near<'a>>,
    tree: Tree,
    /// Voxels with less count as unobserved.
    min_sum: i32,
    voxel_size_m: f64,
}

/// A block with surface among its neighbours; the block at (x, y, z) − 1 from it has number x + 3y + 9z.
#[derive(Debug)]
struct Near<'a> {
    index: BlockIndex,
    /// How many of its cells the surface passes.
    cells: u32,
    blocks: [Option<&'a Block>; 27],
}

impl<'a> Field<'a> {
    pub(super) fn new(map: &'a VoxelMap, min_weight: f32) -> Result<Self, RenderError> {
        let min_sum = MeshConfig { min_weight }.min_weight_sum();
        let level = Level::new();
        let signs = Signs::of_all(map, min_sum, level);
        let surface: Vec<(Near<'a>, [u64; 8])> = map
            .block_indices()
            .into_par_iter()
            .map_init(
                || (Finder::new(map), Neighbourhood::EMPTY),
                |(finder, near), index| {
                    let places = finder.near(index);
                    let signs = places.map(|place| place.and_then(|p| signs.get(p)));
                    dispatch!(level, simd => near.load(simd, &signs, Cells::Own));
                    let octants = octants(near);
                    let blocks = || places.map(|place| place.map(|p| p.block(map)));
                    (octants != [0; 8]).then(|| {
                        (
                            Near {
                                index,
                                cells: octants.iter().map(|cells| cells.count_ones()).sum(),
                                blocks: blocks(),
                            },
                            octants,
                        )
                    })
                },
            )
            .flatten()
            .collect();
        let mut leaves = Vec::new();
        for (number, (near, octants)) in surface.iter().enumerate() {
            for (o, &cells) in (0..8).zip(octants).filter(|(_, cells)| **cells != 0) {
                leaves.push(Leaf {
                    cell: near.index.first_voxel() + 4 * IVec3::new(o & 1, o >> 1 & 1, o >> 2),
                    cells,
                    block: number as u32,
                });
            }
        }
        let corner = |of: fn(IVec3, IVec3) -> IVec3| leaves.iter().map(|leaf| leaf.cell).reduce(of).unwrap_or_default();
        let span = corner(IVec3::max).as_i64vec3() - corner(IVec3::min).as_i64vec3();
        if span.max_element() + 4 > MAX_SPAN {
            return Err(RenderError::TooWide);
        }
        Ok(Self {
            tree: Tree::new(&leaves),
            blocks: surface.into_iter().map(|(near, _)| near).collect(),
            min_sum,
            voxel_size_m: map.config().voxel_size_m,
        })
    }

    /// The blocks with surface, sorted.
    pub(super) fn blocks(&self) -> impl ExactSizeIterator<Item = BlockIndex> {
        self.blocks.iter().map(|near| near.index)
    }

    /// The same blocks, each with the number of its cells that the surface passes.
    pub(super) fn cells(&self) -> impl Iterator<Item = (BlockIndex, u32)> {
        self.blocks.iter().map(|near| (near.index, near.cells))
    }

    /// Whether rays from this cell stay within what the tree can number.
    pub(super) fn reaches(&self, base: IVec3) -> bool {
        self.tree.reaches(base)
    }

    /// How far the rays of a beam can go before any of them can hit surface.
    pub(super) fn clear_length(&self, beam: &Beam) -> f64 {
        self.tree.clear_length(beam)
    }

    /// The first surface that a ray hits.
    pub(super) fn meet(&self, ray: &Ray) -> Option<Hit> {
        self.tree.walk(ray, |visit| {
            let near = &self.blocks[visit.block as usize];
            let voxels = near.corners(visit.cell - near.index.first_voxel());
            let within = |t: f64| {
                let at = ray.origin + ray.direction * t - (visit.cell - ray.base).as_dvec3();
                at.as_vec3().clamp(Vec3::ZERO, Vec3::ONE)
            };
            let (enter, leave) = (within(visit.enter), within(visit.leave));
            let mut distances = [0.0; 8];
            for (f, voxel) in distances.iter_mut().zip(voxels) {
                *f = distance(voxel);
            }
            let s = crossing(&distances, enter, leave)?;
            let range_vox = visit.enter + (visit.leave - visit.enter) * f64::from(s);
            (range_vox <= ray.length).then(|| self.hit(ray, &visit, range_vox, enter.lerp(leave, s)))
        })
    }

    /// The surface on a ray, `at` being its place in the cell.
    fn hit(&self, ray: &Ray, visit: &Visit, range_vox: f64, at: Vec3) -> Hit {
        let near = &self.blocks[visit.block as usize];
        let cell = visit.cell - near.index.first_voxel();
        let range_m = (range_vox * self.voxel_size_m) as f32;
        let towards = ray.direction.as_vec3();
        // Where the field is flat, only the ray tells a direction.
        let normal = near.gradient(cell, at, self.min_sum).normalize_or(-towards);
        Hit {
            range_m,
            depth_m: range_m * ray.depth_per_range,
            normal,
            incidence_cos: -normal.dot(towards),
            weight: trilinear(&near.corners(cell).map(Voxel::weight), at),
        }
    }
}

impl<'a> Near<'a> {
    /// A voxel by its coordinates relative to the block's first, −8..16.
    #[inline]
    fn voxel(&self, local: IVec3) -> Voxel {
        let block = BlockIndex::of(local).0 + 1;
        match self.blocks[(block.x + 3 * block.y + 9 * block.z) as usize] {
            Some(block) => block.voxels[local_number(local)],
            None => Voxel::default(),
        }
    }

    /// The voxels at the corners of a cell.
    #[inline]
    fn corners(&self, cell: IVec3) -> Corners<Voxel> {
        let mut corners = [Voxel::default(); 8];
        match self.blocks[13].filter(|_| cell.max_element() < BLOCK_EDGE - 1) {
            Some(own) => {
                let first = local_number(cell);
                for (corner, offset) in corners.iter_mut().zip([0, 1, 8, 9, 64, 65, 72, 73]) {
                    *corner = own.voxels[(first + offset) & (BLOCK_VOXELS - 1)];
                }
            }
            None => {
                for (c, voxel) in corners.iter_mut().enumerate() {
                    *voxel = self.voxel(cell + corner(c));
                }
            }
        }
        corners
    }

    /// The gradient of F per voxel at a place in a cell: trilinear between those at the corners, which are central differences
    /// where both sides are observed, as the normals of meshes are.
    fn gradient(&self, cell: IVec3, at: Vec3, min_sum: i32) -> Vec3 {
        // F at the 4×4×4 voxels about the cell; NaN where unobserved, and on the edges, which no difference needs.
        let mut f = [f32::NAN; 64];
        for z in -1..3 {
            for y in -1..3 {
                let row = (5 + 4 * y + 16 * z + 16) as usize;
                let across = match [y, z].map(|c| c & 3 > 1) {
                    [false, false] => -1..3,
                    [true, true] => continue,
                    _ => 0..2,
                };
                for x in across {
                    let voxel = self.voxel(cell + IVec3::new(x, y, z));
                    if voxel.weight_sum as i32 >= min_sum {
                        f[(row as i32 + x) as usize] = distance(voxel);
                    }
                }
            }
        }
        let mut gradients = [Vec3::ZERO; 8];
        for (c, gradient) in gradients.iter_mut().enumerate() {
            let here = 21 + (c & 1) + 4 * (c >> 1 & 1) + 16 * (c >> 2);
            let along = |stride: usize| match (f[here] - f[here - stride], f[here + stride] - f[here]) {
                (low, high) if low.is_nan() && high.is_nan() => 0.0,
                (low, high) if low.is_nan() => high,
                (low, high) if high.is_nan() => low,
                (low, high) => 0.5 * (low + high),
            };
            *gradient = Vec3::new(along(1), along(4), along(16));
        }
        trilinear(&gradients, at)
    }
}

/// F of an observed voxel.
#[inline]
fn distance(voxel: Voxel) -> f32 {
    voxel.distance_sum as f32 / voxel.weight_sum.max(1) as f32
}

/// A corner of a cell relative to its first voxel, as numbered in [`Corners`].
#[inline]
fn corner(c: usize) -> IVec3 {
    IVec3::new(c as i32 & 1, c as i32 >> 1 & 1, c as i32 >> 2)
}

/// The surface cells of a block in the bits of its eight leaves.
fn octants(near: &Neighbourhood) -> [u64; 8] {
    let mut octants = [0; 8];
    for z in 0..BLOCK_EDGE {
        for y in 0..BLOCK_EDGE {
            let row = u64::from(near.surface_cells_in_row(y, z));
            let octant = (y >> 2 << 1 | z >> 2 << 2) as usize;
            let bit = 4 * (y & 3) + 16 * (z & 3);
            octants[octant] |= (row & 15) << bit;
            octants[octant + 1] |= (row >> 4) << bit;
        }
    }
    octants
}
