//! The signs of a block and of a rim around it, and what follows from them: the cells that the surface passes, and the grid
//! edges that it crosses.

use super::{
    near::Near,
    signs::{Bits, NO_BITS, Signs},
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
        self.valid = around(|n| near[n].map_or(&NO_BITS, |signs| &signs.valid));
        self.negative = around(|n| near[n].map_or(&NO_BITS, |signs| &signs.negative));
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
            self.surface[i] = (any | any >> 1) & !(all & all >> 1);
        }
        if cells == Cells::Own {
            for (z, layer) in observed.chunks_mut(LAYER).enumerate() {
                for (y, row) in layer.iter_mut().enumerate() {
                    *row &= if (1..9).contains(&y) && (1..9).contains(&z) { OWN } else { 0 };
                }
            }
        }
        self.surface.iter_mut().zip(observed).for_each(|(s, observed)| *s &= observed);
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

    /// The blocks whose voxels the surface in the block's cells depends on, with its normals: bits, as numbered in [`Near`].
    /// After loading with [`Cells::Own`].
    #[inline(always)]
    pub(super) fn sources(&self) -> u32 {
        let mut seen = needed(&self.edges);
        for i in LAYER + 1..LEN - LAYER {
            let corners = self.surface[i] | self.surface[i - 1] | self.surface[i - LAYER] | self.surface[i - LAYER - 1];
            seen[i] |= corners | corners << 1;
        }
        let mut sources = 0;
        for (z, layer) in seen.chunks(LAYER).enumerate() {
            let mut rows = [0; 3];
            for (y, row) in layer[..11].iter().enumerate() {
                rows[(y + 7) / 8] |= row;
            }
            for (k, row) in rows.into_iter().enumerate() {
                let (before, own, after) = (row & 1, u32::from(row & OWN != 0), u32::from(row >> 9 != 0));
                let before = u32::from(before);
                sources |= (before | own << 1 | after << 2) << (3 * k + 9 * ((z + 7) / 8 % 3));
            }
        }
        sources
    }

    /// Calls back with each of the block's cells that the surface passes, and the set of its negative corners as numbered in
    /// [`super::cube`].
    #[inline(always)]
    pub(super) fn for_each_cell(&self, mut found: impl FnMut([i32; 3], usize)) {
        for z in 0..8 {
            for y in 0..8 {
                let row = row_of(y, z);
                let mut cells = self.surface[row] & OWN;
                if cells == 0 {
                    continue;
                }
                let (a, b) = (usize::from(self.negative[row]), usize::from(self.negative[row + 1]));
                let (c, d) = (self.negative[row + LAYER], self.negative[row + LAYER + 1]);
                let (c, d) = (usize::from(c), usize::from(d));
                while cells != 0 {
                    let x = cells.trailing_zeros();
                    let negative = a >> x & 3 | (b >> x & 3) << 2 | (c >> x & 3) << 4 | (d >> x & 3) << 6;
                    found([x as i32 - 1, y, z], negative);
                    cells &= cells - 1;
                }
            }
        }
    }
}

/// The voxels that vertices on some edges need: the ends of these edges, and those beside the ends.
#[inline(always)]
pub(super) fn needed([along_x, along_y, along_z]: &[Rows; 3]) -> Rows {
    let (mut ends, mut needed): (Rows, Rows) = ([0; LEN], [0; LEN]);
    for i in LAYER + 1..LEN - LAYER {
        let x = along_x[i];
        ends[i] = x | x << 1 | along_y[i] | along_y[i - 1] | along_z[i] | along_z[i - LAYER];
    }
    // No edge ends in the outermost rows.
    for i in 0..LEN - LAYER {
        let (before, above) = (i.saturating_sub(1), i.saturating_sub(LAYER));
        let beside = ends[before] | ends[above] | ends[i + 1] | ends[i + LAYER];
        needed[i] = beside | ends[i] | ends[i] << 1 | ends[i] >> 1;
    }
    needed
}

/// Puts the bits of a block and its rim side by side, for x, y, z in −1..=8.
#[inline(always)]
pub(super) fn around<'a>(bits: impl Fn(usize) -> &'a Bits) -> Rows {
    let mut rows = [0; LEN];
    for z in -1..=8_i32 {
        let (layer, local) = (LAYER * (z + 1) as usize, (z & 7) as usize);
        let of = |n: usize| &bits(n + 9 * ((z >> 3) + 1) as usize)[local];
        for (y, y_of_block, count, first) in [(0, 7, 1, 0), (1, 0, 8, 3), (9, 0, 1, 6)] {
            let (left, own, right) = (of(first), of(first + 1), of(first + 2));
            for k in 0..count {
                let k_of_block = y_of_block + k;
                let (left, own, right) = (left[k_of_block], u16::from(own[k_of_block]), u16::from(right[k_of_block]));
                rows[layer + y + k] = u16::from(left >> 7) | own << 1 | (right & 1) << 9;
            }
        }
    }
    rows
}

/// The bits about each of the own bits' number x + 8y + 64z: as numbered in [`Near`].
#[inline(always)]
pub(super) fn bits_about(rows: &Rows, number: usize) -> u32 {
    let (x, row) = (number % 8, row_of(number as i32 / 8 % 8, number as i32 / 64 % 8));
    let mut all = 0;
    for (k, lane) in [0, LAYER, 2 * LAYER].into_iter().flat_map(|layer| [layer, layer + 1, layer + 2]).enumerate() {
        all |= u32::from(rows[row + lane - LAYER - 1] >> x & 7) << (3 * k);
    }
    all
}

/// The number of a row of voxels, y and z in −1..=9.
#[inline(always)]
pub(super) fn row_of(y: i32, z: i32) -> usize {
    (y + 1) as usize + LAYER * (z + 1) as usize
}
