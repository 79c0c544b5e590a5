//! Points that stand for a piece of the surface.

use fearless_simd::{Level, dispatch};
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::mesh::Piece;

use super::lattice::{CELLS, Lattice};

/// A point of the surface: the mean height of all samples in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Site {
    /// Cells.
    pub(super) x: i32,
    /// Cells.
    pub(super) y: i32,
    /// Steps.
    pub(super) z: i32,
}

/// Longer edges than this are sampled along, voxels.
const SPACING: f64 = 0.5;
/// Samples along an edge, at most. A triangle is no longer than √3 voxels of the map.
const MAX_SAMPLES: i32 = 16;

/// Samples pieces; keeps memory between them.
#[derive(Debug, Default)]
pub(super) struct Sampler {
    /// In steps.
    samples: Vec<IVec3>,
    /// Sum of heights and number of samples of each cell.
    cells: Vec<(i64, i64)>,
}

impl Sampler {
    /// The sites of a piece, in order; none for what lies outside of the grid.
    pub(super) fn sites(&mut self, lattice: &Lattice, piece: &Piece<'_>) -> Vec<Site> {
        dispatch!(Level::new(), _ => self.sample(lattice, piece));
        // A power of two.
        let shift = lattice.cell_steps().trailing_zeros();
        let cell_of = |sample: &IVec3| *sample >> shift;
        let bounds = self.samples.iter().map(cell_of).fold(None, |bounds, cell| {
            let (low, high) = bounds.unwrap_or((cell, cell));
            Some((cell.min(low), cell.max(high)))
        });
        let Some((low, high)) = bounds else {
            return Vec::new();
        };
        let size = high - low + 1;
        self.cells.clear();
        self.cells.resize((size.x * size.y * size.z) as usize, (0, 0));
        for sample in &self.samples {
            let at = cell_of(sample) - low;
            let (sum, count) = &mut self.cells[((at.x * size.y + at.y) * size.z + at.z) as usize];
            (*sum, *count) = (*sum + i64::from(sample.z), *count + 1);
        }
        let site = |(at, &(sum, count)): (i32, &(i64, i64))| Site {
            x: low.x + at / (size.y * size.z),
            y: low.y + at / size.z % size.y,
            // To the nearest, halves up: so a move by whole voxels changes nothing.
            z: (2 * sum + count).div_euclid(2 * count) as i32,
        };
        (0..)
            .zip(&self.cells)
            .filter(|(_, (_, count))| *count > 0)
            .map(site)
            .collect()
    }

    /// All vertices, and points in between where they are far apart.
    #[inline(always)]
    fn sample(&mut self, lattice: &Lattice, piece: &Piece<'_>) {
        /// Farther from the origin, steps do not fit an `i32`.
        const FAR: f64 = (1 << 30) as f64;
        self.samples.clear();
        let samples = &mut self.samples;
        let mut put = |point: DVec3| {
            let steps = lattice.steps_of(point);
            if steps.abs().max_element() < FAR {
                // To the nearest step: voxel centres may lie on borders of cells.
                samples.push((steps + 0.5).floor().as_ivec3());
            }
        };
        piece.vertices.iter().copied().for_each(&mut put);
        let spacing_m = SPACING * lattice.voxel_size_m;
        for triangle in piece.triangles {
            let [a, b, c] = triangle.map(|corner| piece.vertices.get(corner as usize).copied().unwrap_or_default());
            let longest_m = a.distance(b).max(b.distance(c)).max(c.distance(a));
            if longest_m <= spacing_m {
                continue;
            }
            let n = ((longest_m / spacing_m).ceil() as i32).min(MAX_SAMPLES);
            for i in 0..=n {
                for j in 0..=n - i {
                    let [s, t] = [i, j].map(|k| f64::from(k) / f64::from(n));
                    put(a + (b - a) * s + (c - a) * t);
                }
            }
        }
    }
}

const _: () = assert!(CELLS == 2, "the docs say half a voxel");
