//! The signs of a block and of a rim around it, and the cells and grid edges through which the surface therefore passes.

use fearless_simd::{Simd, prelude::*, u16x16};

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
/// The numbers of neighbouring rows differ by 1 or [`LAYER`], so that a whole layer can be processed at once.
pub(super) type Rows = [u16; LEN];

/// The bits of the block's own voxels in a row.
pub(super) const OWN: u16 = 0b1_1111_1110;

/// The bits of the block's own voxels in a layer.
const OWN_ROWS: [u16; LAYER] = [0, OWN, OWN, OWN, OWN, OWN, OWN, OWN, OWN, 0, 0, 0, 0, 0, 0, 0];

/// The signs of one block and of the rim that its cells and edges see, x, y, z in −1..=8.
#[derive(Clone, Debug)]
pub(crate) struct Neighbourhood {
    /// Whether the voxel was observed.
    valid: Rows,
    /// Whether the voxel lies behind the surface.
    negative: Rows,
    /// Whether the surface passes the cell above the voxel: all corners are observed, and they lie on both sides of the surface.
    surface: Rows,
    /// Whether there is a vertex on the grid edge from the voxel along x, y and z.
    pub(super) edges: [Rows; 3],
}

/// Which edges are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cells {
    /// The edges of its cells, x, y, z in 0..=8, that these cells make vertices of.
    Own,
    /// The edges from its voxels that any cells make vertices of, its own or those of its neighbours.
    About,
}

impl Neighbourhood {
    pub(crate) const EMPTY: Self = Self {
        valid: [0; LEN],
        negative: [0; LEN],
        surface: [0; LEN],
        edges: [[0; LEN]; 3],
    };

    /// Loads the signs of a block and of its neighbours.
    #[inline(always)]
    pub(crate) fn load<S: Simd>(&mut self, simd: S, near: &Near<&Signs>, cells: Cells) {
        self.valid = around(|n| near[n].map_or(&NO_BITS, |signs| &signs.valid));
        self.negative = around(|n| near[n].map_or(&NO_BITS, |signs| &signs.negative));
        let (valid, negative) = (&self.valid, &self.negative);
        // Cells that are observed at all eight corners, one layer on.
        let mut observed = [0; LEN + LAYER];
        for z in 0..10 {
            let i = LAYER * z;
            let (n, behind) = (rows(simd, negative, i), rows(simd, negative, i + 1));
            let (above, both) = (rows(simd, negative, i + LAYER), rows(simd, negative, i + LAYER + 1));
            let (any, all) = (n | behind | above | both, n & behind & above & both);
            let corners = rows(simd, valid, i) & rows(simd, valid, i + 1);
            let corners = corners & rows(simd, valid, i + LAYER) & rows(simd, valid, i + LAYER + 1);
            let mut cell = corners & corners >> 1;
            if cells == Cells::Own {
                cell &= own_rows(simd, z);
            }
            cell.store_slice(&mut observed[i + LAYER..i + 2 * LAYER]);
            let surface = (any | any >> 1) & !(all & all >> 1) & cell;
            surface.store_slice(&mut self.surface[i..i + LAYER]);
        }
        // Edges with an observed cell beside them are observed at both ends. A cell's bit shifted up by one stands for the
        // cell at x − 1.
        for z in 1..10 {
            let i = LAYER * z;
            let (n, behind) = (rows(simd, negative, i), rows(simd, negative, i + 1));
            let above = rows(simd, negative, i + LAYER);
            let (here, before) = (rows(simd, &observed, i + LAYER), rows(simd, &observed, i + LAYER - 1));
            let (below, both) = (rows(simd, &observed, i), rows(simd, &observed, i - 1));
            let (about_y, about_z) = (here | below, here | before);
            let along_x = (n ^ n >> 1) & (about_y | before | both);
            let along_y = (n ^ behind) & (about_y | about_y << 1);
            let along_z = (n ^ above) & (about_z | about_z << 1);
            for (to, mut edges) in self.edges.iter_mut().zip([along_x, along_y, along_z]) {
                if cells == Cells::About {
                    edges &= own_rows(simd, z);
                }
                edges.store_slice(&mut to[i..i + LAYER]);
            }
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
    pub(super) fn sources<S: Simd>(&self, simd: S) -> u32 {
        let mut seen = needed(simd, &self.edges);
        for z in 1..10 {
            let i = LAYER * z;
            let cells = rows(simd, &self.surface, i) | rows(simd, &self.surface, i - 1);
            let cells = cells | rows(simd, &self.surface, i - LAYER);
            let cells = cells | rows(simd, &self.surface, (i - LAYER).saturating_sub(1));
            (cells | cells << 1 | rows(simd, &seen, i)).store_slice(&mut seen[i..i + LAYER]);
        }
        let mut sources = 0;
        for (z, layer) in seen.chunks(LAYER).take(11).enumerate() {
            let mut rows = [0; 3];
            for (y, row) in layer[..11].iter().enumerate() {
                rows[y.div_ceil(8)] |= row;
            }
            for (k, row) in rows.into_iter().enumerate() {
                let (before, own, after) = (row & 1, u32::from(row & OWN != 0), u32::from(row >> 9 != 0));
                let before = u32::from(before);
                sources |= (before | own << 1 | after << 2) << (3 * k + 9 * z.div_ceil(8));
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

/// Sixteen rows.
#[inline(always)]
fn rows<S: Simd>(simd: S, all: &[u16], first: usize) -> u16x16<S> {
    u16x16::from_slice(simd, &all[first..first + LAYER])
}

/// The bits of the block's own voxels in layer z − 1.
#[inline(always)]
fn own_rows<S: Simd>(simd: S, z: usize) -> u16x16<S> {
    u16x16::simd_from(simd, if (1..9).contains(&z) { OWN_ROWS } else { [0; LAYER] })
}

/// The voxels that vertices on some edges need: the ends of these edges, and those beside the ends.
#[inline(always)]
pub(super) fn needed<S: Simd>(simd: S, [along_x, along_y, along_z]: &[Rows; 3]) -> Rows {
    // One layer on.
    let mut ends = [0; LEN + 2 * LAYER];
    for z in 1..11 {
        let i = LAYER * z;
        let x = rows(simd, along_x, i);
        let y = rows(simd, along_y, i) | rows(simd, along_y, i - 1);
        let z = rows(simd, along_z, i) | rows(simd, along_z, i - LAYER);
        (x | x << 1 | y | z).store_slice(&mut ends[i + LAYER..i + 2 * LAYER]);
    }
    let mut needed = [0; LEN];
    for z in 0..11 {
        let i = LAYER * z;
        let here = rows(simd, &ends, i + LAYER);
        let beside_y = rows(simd, &ends, i + LAYER - 1) | rows(simd, &ends, i + LAYER + 1);
        let beside_z = rows(simd, &ends, i) | rows(simd, &ends, i + 2 * LAYER);
        (here | here << 1 | here >> 1 | beside_y | beside_z).store_slice(&mut needed[i..i + LAYER]);
    }
    needed
}

/// Puts the bits of a block and its rim side by side, for x, y, z in −1..=8.
#[inline(always)]
pub(super) fn around<'a>(bits: impl Fn(usize) -> &'a Bits) -> Rows {
    let mut rows = [0; LEN];
    for z in 0..10_usize {
        // z − 1 is a layer of the block below, of this one, or of that above.
        let (part, local) = (z.div_ceil(8), (z + 7) % 8);
        let layer = &mut rows[LAYER * z..LAYER * (z + 1)];
        let of = |n: usize| &bits(n + 9 * part)[local];
        layer[0] = row(of(0)[7], of(1)[7], of(2)[7]);
        let (left, own, right) = (of(3), of(4), of(5));
        for y in 0..8 {
            layer[y + 1] = row(left[y], own[y], right[y]);
        }
        layer[9] = row(of(6)[0], of(7)[0], of(8)[0]);
    }
    rows
}

/// A row of a block between those of its neighbours.
#[inline(always)]
fn row(left: u8, own: u8, right: u8) -> u16 {
    u16::from(left >> 7) | u16::from(own) << 1 | u16::from(right & 1) << 9
}

/// The bits about each of the own bits' number x + 8y + 64z: as numbered in [`Near`].
#[inline(always)]
pub(super) fn bits_about(rows: &Rows, number: usize) -> u32 {
    let (x, row) = (number % 8, row_of(number as i32 / 8 % 8, number as i32 / 64 % 8));
    let mut all = 0;
    for (k, lane) in [0, LAYER, 2 * LAYER]
        .into_iter()
        .flat_map(|layer| [layer, layer + 1, layer + 2])
        .enumerate()
    {
        all |= u32::from(rows[row + lane - LAYER - 1] >> x & 7) << (3 * k);
    }
    all
}

/// The number of a row of voxels, y and z in −1..=9.
#[inline(always)]
pub(super) fn row_of(y: i32, z: i32) -> usize {
    (y + 1) as usize + LAYER * (z + 1) as usize
}
