//! The signs of a block and of a rim around it, and what follows from them: the cells that the surface passes, and the grid
//! edges that it crosses.

use super::{
    near::Near,
    signs::{Bits, Signs},
};

/// Rows of a layer: y = −1 … 9, and some that are always empty.
pub(super) const LAYER: usize = 16;

/// Layers: z = −1 … 9, and an empty one.
const LEN: usize = 12 * LAYER;

/// Something of each row of voxels along x; that of row (y, z) has number [`row_of`]. In a row of bits, voxel x is bit x + 1.
///
/// Numbers of rows beside each other differ by 1 or [`LAYER`], so that all are judged in one loop, which the compiler turns into
/// vector instructions.
pub(super) type Rows = [u16; LEN];

/// The bits of the block's own voxels in a row.
const OWN: u16 = 0b1_1111_1110;

/// The signs of one block and of the rim that its cells and edges see, x, y, z in −1..=8.
#[derive(Clone, Debug)]
pub(crate) struct Neighbourhood {
    /// Was the voxel observed?
    valid: Rows,
    /// Does the voxel lie behind the surface?
    negative: Rows,
    /// Does the surface pass the cell above the voxel: observed at all corners, on both sides of the surface?
    surface: Rows,
    /// Does the surface cross the grid edge from the voxel along x, y and z?
    pub(super) edges: [Rows; 3],
}

/// Which cells an edge may belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cells {
    /// Those of the block.
    Own,
    /// These, and those of its neighbours about its edges.
    About,
}

impl Neighbourhood {
    pub(crate) const EMPTY: Self = Self {
        valid: [0; LEN],
        negative: [0; LEN],
        surface: [0; LEN],
        edges: [[0; LEN]; 3],
    };

    /// Judges a block by its signs and those of its neighbours.
    #[inline(always)]
    pub(crate) fn load(&mut self, near: &Near<&Signs>, cells: Cells) {
        let near = near.map(|signs| signs.unwrap_or(&Signs::NONE));
        gather(&mut self.valid, |n| &near[n].valid);
        gather(&mut self.negative, |n| &near[n].negative);
        self.find_surface(cells);
    }

    #[inline(always)]
    fn find_surface(&mut self, cells: Cells) {
        let (valid, negative) = (&self.valid, &self.negative);
        // Cells that are observed at all eight corners, for y, z in −1..=7.
        let mut observed = [0; LEN];
        for i in 0..LEN - LAYER - 1 {
            let (any, all) = (negative[i] | negative[i + 1], negative[i] & negative[i + 1]);
            let (above, behind) = (i + LAYER, i + LAYER + 1);
            let any = any | negative[above] | negative[behind];
            let all = all & negative[above] & negative[behind];
            let corners = valid[i] & valid[i + 1] & valid[above] & valid[behind];
            observed[i] = corners & corners >> 1;
            self.surface[i] = (any | any >> 1) & !(all & all >> 1) & observed[i];
        }
        if cells == Cells::Own {
            for (z, layer) in observed.chunks_mut(LAYER).enumerate() {
                for (y, row) in layer.iter_mut().enumerate() {
                    *row &= if (1..9).contains(&y) && (1..9).contains(&z) { OWN } else { 0 };
                }
            }
        }
        // Edges with an observed cell beside them are observed at both ends. A cell's bit shifted up by one stands for the
        // cell at x − 1.
        let [along_x, along_y, along_z] = &mut self.edges;
        for i in LAYER + 1..LEN - LAYER {
            let n = negative[i];
            let about_y = observed[i] | observed[i - LAYER];
            let about_z = observed[i] | observed[i - 1];
            along_x[i] = (n ^ n >> 1) & (about_y | observed[i - 1] | observed[i - LAYER - 1]);
            along_y[i] = (n ^ negative[i + 1]) & (about_y | about_y << 1);
            along_z[i] = (n ^ negative[i + LAYER]) & (about_z | about_z << 1);
        }
    }

    /// Which of the block's cells in row (y, z) the surface passes: bit x.
    #[inline(always)]
    pub(crate) fn surface_cells_in_row(&self, y: i32, z: i32) -> u16 {
        (self.surface[row_of(y, z)] & OWN) >> 1
    }

    /// The grid edges from the block's own voxels that the surface crosses, layer by layer: bit x + 8 y.
    #[inline(always)]
    pub(super) fn own_edges(&self) -> [[u64; 8]; 3] {
        let mut own = [[0; 8]; 3];
        for (own, rows) in own.iter_mut().zip(&self.edges) {
            for (z, own) in own.iter_mut().enumerate() {
                let mut layer = [0; 8];
                for (y, row) in layer.iter_mut().enumerate() {
                    *row = (rows[LAYER * (z + 1) + y + 1] >> 1) as u8;
                }
                *own = u64::from_le_bytes(layer);
            }
        }
        own
    }

    /// How many cells of the block have each of the 256 sets of negative corners is told one by one: calls back with the
    /// cell and the set, as numbered in [`super::cube`], for each cell that the surface passes.
    #[inline(always)]
    pub(super) fn for_each_cell(&self, mut found: impl FnMut([i32; 3], usize)) {
        for z in 0..8 {
            for y in 0..8 {
                let row = row_of(y, z);
                let mut cells = self.surface[row] & OWN;
                if cells == 0 {
                    continue;
                }
                let rows = [row, row + 1, row + LAYER, row + LAYER + 1].map(|i| usize::from(self.negative[i]));
                while cells != 0 {
                    let bit = cells.trailing_zeros();
                    let [a, b, c, d] = rows.map(|row| row >> bit & 3);
                    found([bit as i32 - 1, y, z], a | b << 2 | c << 4 | d << 6);
                    cells &= cells - 1;
                }
            }
        }
    }
}

/// Puts the bits of a block and its rim side by side.
#[inline(always)]
fn gather<'a>(rows: &mut Rows, bits: impl Fn(usize) -> &'a Bits) {
    for z in -1..=8_i32 {
        let (layer, local) = (LAYER * (z + 1) as usize, (z & 7) as usize);
        let of = |n: usize| &bits(n + 9 * ((z >> 3) + 1) as usize)[local];
        for (y, y_of_block, count, first) in [(0, 7, 1, 0), (1, 0, 8, 3), (9, 0, 1, 6)] {
            let (left, own, right) = (of(first), of(first + 1), of(first + 2));
            for k in 0..count {
                let [l, o, r] = [left, own, right].map(|part| u16::from(part[y_of_block + k]));
                rows[layer + y + k] = l >> 7 | o << 1 | (r & 1) << 9;
            }
        }
    }
}

/// The number of a row of voxels, y and z in −1..=9.
#[inline(always)]
pub(super) fn row_of(y: i32, z: i32) -> usize {
    (y + 1) as usize + LAYER * (z + 1) as usize
}
