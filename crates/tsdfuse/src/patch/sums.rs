//! Sums over windows of the organized image, by summed-area tables (Crow 1984).
//!
//! A table holds, for each cell, the sums over all returns below and left of it, so that a window's are those of its corners:
//! D − C − B + A, whatever its size. Columns wrap around: a table continues some columns beyond both ends. Rings are
//! cut into bands with a table each, so that threads can fill them side by side.

use glam::Vec3;
use rayon::prelude::*;

use crate::sensor::{NONE, ScanImage};

/// Count of returns, Σx, Σy, Σz, Σxx, Σxy, Σxz, Σyy, Σyz, Σzz.
pub(super) type Sums = [f64; 10];

/// Windows may reach this many columns to each side.
pub(super) const MAX_COLUMNS: usize = 16;

/// Rings of a band.
const BAND: usize = 16;

/// The tables of one scan.
#[derive(Debug, Default)]
pub(super) struct WindowSums {
    columns: usize,
    rings: usize,
    /// Row by row, one column more than cells: [`Self::width`] of them.
    table: Vec<Sums>,
}

/// Cells of the image: rings and columns, both ends included. Columns count from [`MAX_COLUMNS`] before the first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) rings: [usize; 2],
    pub(super) columns: [usize; 2],
}

impl WindowSums {
    /// Sums up the returns of an image.
    pub(super) fn update(&mut self, image: &ScanImage, points: &[Vec3]) {
        (self.columns, self.rings) = (image.columns(), image.rings());
        let (columns, width) = (self.columns, self.width());
        self.table.resize(width * self.rings, [0.0; 10]);
        let bands = self.table.par_chunks_mut(BAND * width).enumerate();
        bands.for_each(|(band, rows)| {
            for k in 0..rows.len() / width {
                let (below, row) = rows.split_at_mut(k * width);
                let below = below.get(below.len().wrapping_sub(width)..);
                let cells = image.row(BAND * band + k);
                let mut sums = [0.0; 10];
                row[0] = below.map_or(sums, |below| below[0]);
                for c in 0..width - 1 {
                    let cell = cells[(c + columns * MAX_COLUMNS - MAX_COLUMNS) % columns];
                    if cell != NONE {
                        add(&mut sums, points[cell as usize]);
                    }
                    row[c + 1] = sums;
                    if let Some(below) = below {
                        for (sum, below) in row[c + 1].iter_mut().zip(below[c + 1]) {
                            *sum += below;
                        }
                    }
                }
            }
        });
    }

    fn width(&self) -> usize {
        self.columns + 2 * MAX_COLUMNS + 1
    }

    /// The sums over a window.
    #[inline(always)]
    pub(super) fn of(&self, window: Window) -> Sums {
        let mut all = [0.0; 10];
        let [mut ring, last] = window.rings;
        while ring <= last {
            let end = (ring | (BAND - 1)).min(last);
            self.add_row(&mut all, end, window.columns, 1.0);
            if ring % BAND != 0 {
                self.add_row(&mut all, ring - 1, window.columns, -1.0);
            }
            ring = end + 1;
        }
        all
    }

    #[inline(always)]
    fn add_row(&self, all: &mut Sums, ring: usize, [first, last]: [usize; 2], sign: f64) {
        let row = &self.table[ring * self.width()..][..self.width()];
        let (left, right) = (&row[first], &row[last + 1]);
        for k in 0..10 {
            all[k] += sign * (right[k] - left[k]);
        }
    }
}

/// Adds a return.
#[inline(always)]
fn add(sums: &mut Sums, point: Vec3) {
    let [x, y, z] = point.as_dvec3().to_array();
    let of_point = [1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
    for k in 0..10 {
        sums[k] += of_point[k];
    }
}
