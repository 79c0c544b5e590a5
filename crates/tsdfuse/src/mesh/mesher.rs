//! Meshing one block: the list of its edges with a vertex, these vertices, and the triangles between them.

use fearless_simd::Simd;
use glam::{DVec3, Vec3};

use super::{
    cube::{CASES, MAX_TRIANGLES},
    distances::{Distances, GridEdge},
    near::{Near, PerBlock, Place},
    neighbourhood::{Cells, Neighbourhood, row_of},
    signs::Signs,
};
use crate::{
    index::{BLOCK_EDGE, BlockIndex},
    map::{Block, VoxelMap},
};

/// Working memory for meshing a block, reused from block to block.
pub(super) struct Mesher {
    pub(super) near: Neighbourhood,
    distances: Distances,
    /// The edges of the block's vertices, in order.
    edges: Vec<GridEdge>,
    /// The number in the mesh of the vertex on each edge.
    numbers: [u32; GridEdge::NUMBERS],
}

impl Mesher {
    pub(super) fn new() -> Self {
        Self {
            near: Neighbourhood::EMPTY,
            distances: Distances::new(),
            edges: Vec::new(),
            numbers: [0; GridEdge::NUMBERS],
        }
    }

    /// Finds the cells and edges of a block that the surface passes.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&mut self, simd: S, signs: &PerBlock<Signs>, places: &Near<Place>, cells: Cells) {
        let mut near: Near<&Signs> = [None; 27];
        for (near, place) in near.iter_mut().zip(places) {
            *near = place.and_then(|p| signs.get(p));
        }
        self.near.load(simd, &near, cells);
    }

    /// Numbers the vertices on the edges from voxels with coordinates below `end`, 8 or 9, from `first` on.
    #[inline(always)]
    pub(super) fn number_vertices(&mut self, end: i32, first: u32) {
        self.edges.clear();
        for z in 0..end {
            for y in 0..end {
                let row = row_of(y, z);
                let [along_x, along_y, along_z] = &self.near.edges;
                let (along_x, along_y, along_z) = (spread(along_x[row]), spread(along_y[row]), spread(along_z[row]));
                let mut left = (along_x | along_y << 1 | along_z << 2) & ((1 << (3 * end)) - 1);
                while left != 0 {
                    let bit = left.trailing_zeros() as i32;
                    left &= left - 1;
                    let edge = GridEdge::new([bit / 3, y, z], bit as usize % 3);
                    self.numbers[edge.number()] = first + self.edges.len() as u32;
                    self.edges.push(edge);
                }
            }
        }
    }

    /// Records the number of a vertex that belongs to another block.
    #[inline(always)]
    pub(super) fn set_number(&mut self, edge: GridEdge, number: u32) {
        self.numbers[edge.number()] = number;
    }

    /// How many vertices were numbered.
    pub(super) fn vertex_count(&self) -> usize {
        self.edges.len()
    }

    /// Computes the numbered vertices of the block.
    #[inline(always)]
    pub(super) fn vertices<S: Simd>(
        &mut self,
        simd: S,
        source: &Source<'_>,
        places: &Near<Place>,
        index: BlockIndex,
        (positions, normals): (&mut [DVec3], &mut [Vec3]),
    ) {
        let mut blocks: Near<&Block> = [None; 27];
        for (block, place) in blocks.iter_mut().zip(places) {
            *block = place.map(|p| p.block(source.map));
        }
        self.distances.load(simd, &blocks, &self.near.edges, source.min_sum);
        let (grid, first) = (source.map.grid(), index.first_voxel());
        let origins = [grid.center(first), grid.center(first + BLOCK_EDGE)];
        let voxel_size_m = source.map.config().voxel_size_m;
        (self.distances).vertices(simd, &self.edges, origins, voxel_size_m, positions, normals);
    }

    /// Calls back with the triangles of each of the block's cells.
    #[inline(always)]
    pub(super) fn for_each_triangle(&self, mut found: impl FnMut([u32; 3])) {
        let cases = &*CASES;
        self.near.for_each_cell(|cell, negative| {
            let first = GridEdge::new(cell, 0).number();
            let case = &cases[negative % 256];
            let number = |edge: u16| self.numbers[(first + edge as usize) % GridEdge::NUMBERS];
            for &[a, b, c] in &case.edges[..MAX_TRIANGLES.min(case.count as usize)] {
                found([number(a), number(b), number(c)]);
            }
        });
    }

    /// How many triangles the block's cells have.
    #[inline(always)]
    pub(super) fn triangle_count(&self) -> u32 {
        let cases = &*CASES;
        let mut count = 0;
        self.near
            .for_each_cell(|_, negative| count += u32::from(cases[negative % 256].count));
        count
    }
}

/// What is meshed.
pub(super) struct Source<'a> {
    pub(super) map: &'a VoxelMap,
    pub(super) min_sum: i32,
}

/// The bits of voxels 0 … 8 of a row, three apart.
#[inline(always)]
fn spread(row: u16) -> u32 {
    SPREAD[usize::from(row) / 2 % SPREAD.len()]
}

static SPREAD: [u32; 512] = {
    let mut spread = [0; 512];
    let mut bits = 0;
    while bits < 512 {
        let mut x = 0;
        while x < 9 {
            spread[bits] |= (bits as u32 >> x & 1) << (3 * x);
            x += 1;
        }
        bits += 1;
    }
    spread
};
