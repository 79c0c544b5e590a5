//! Sums over windows of the organized image, by summed-area tables (Crow 1984).
//!
//! A table holds, for each cell, the sums over all returns below and left of it, so that a window's are those of its corners:
//! D − C − B + A, whatever its size. Columns wrap around: a table continues some columns beyond both ends. Columns are
//! cut into bands with a table each, so that threads can fill them side by side; and it lies column by column in memory, as
//! sensors fire, so that windows of returns that follow each other have their corners in the nearest caches.

use glam::Vec3;
use rayon::prelude::*;

use crate::sensor::ScanImage;

/// Count of returns, Σx, Σy, Σz, Σxx, Σxy, Σxz, Σyy, Σyz, Σzz.
pub(super) type Sums = [f64; 10];

/// Windows may reach this many columns to each side.
pub const MAX_COLUMNS: usize = 16;

/// Returns farther away than this, metres, are left out, and those that are nowhere: they would be felt in all sums of their band.
const FARTHEST_M: f32 = 1000.0;

/// Columns of a band.
const BAND: usize = 64;

/// The tables of one scan.
#[derive(Debug, Default)]
pub(super) struct WindowSums {
    columns: usize,
    rings: usize,
    /// Column by column, with zeros below the first ring.
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
        let (columns, height) = (self.columns, self.height());
        self.table.resize(height * (columns + 2 * MAX_COLUMNS), [0.0; 10]);
        let bands = self.table.par_chunks_mut(BAND * height).enumerate();
        bands.for_each(|(band, table)| {
            let mut left: &[Sums] = &[];
            for (k, out) in table.chunks_exact_mut(height).enumerate() {
                let column = (BAND * band + k + columns * MAX_COLUMNS - MAX_COLUMNS) % columns;
                let mut sums = [0.0; 10];
                out[0] = sums;
                for (ring, out) in out[1..].iter_mut().enumerate() {
                    let point = image.get(ring, column).map(|i| points[i]);
                    // Also false for NaN.
                    if let Some(point) = point.filter(|p| p.length_squared() < FARTHEST_M * FARTHEST_M) {
                        add(&mut sums, point);
                    }
                    *out = sums;
                    if let Some(left) = left.get(ring + 1) {
                        out.iter_mut().zip(left).for_each(|(sum, left)| *sum += left);
                    }
                }
                left = out;
            }
        });
    }

    /// Entries of a column.
    fn height(&self) -> usize {
        self.rings + 1
    }

    /// The sums over a window.
    #[inline(always)]
    pub(super) fn of(&self, window: Window) -> Sums {
        let [first, last] = window.columns;
        let mut all = self.within_band(first, (first | (BAND - 1)).min(last), window.rings);
        let mut column = (first | (BAND - 1)) + 1;
        while column <= last {
            let end = (column | (BAND - 1)).min(last);
            let more = self.within_band(column, end, window.rings);
            (0..10).for_each(|k| all[k] += more[k]);
            column = end + 1;
        }
        all
    }

    /// The sums over columns of one band.
    #[inline(always)]
    fn within_band(&self, first: usize, last: usize, rings: [usize; 2]) -> Sums {
        let mut all = self.column(last, rings);
        if !first.is_multiple_of(BAND) {
            let before = self.column(first - 1, rings);
            (0..10).for_each(|k| all[k] -= before[k]);
        }
        all
    }

    /// The sums up to a column of its band.
    #[inline(always)]
    fn column(&self, column: usize, [first, last]: [usize; 2]) -> Sums {
        let column = &self.table[column * self.height()..][..self.height()];
        let (mut all, below) = (column[last + 1], &column[first]);
        (0..10).for_each(|k| all[k] -= below[k]);
        all
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::SensorModel;
    use proptest::prelude::*;

    const RINGS: usize = 37;
    const COLUMNS: usize = 40;

    /// A return in most cells.
    fn image() -> (ScanImage, Vec<Vec3>) {
        let elevations = (0..RINGS).map(|r| r as f32 - 20.0).collect();
        let model = SensorModel::from_beams("test", elevations, COLUMNS as u32, (0.1, 100.0)).unwrap();
        let cells = (0..RINGS * COLUMNS).filter(|i| i % 7 != 3);
        let (mut points, mut rings) = (Vec::new(), Vec::new());
        for i in cells {
            let (ring, column) = (i / COLUMNS, i % COLUMNS);
            let azimuth = -std::f32::consts::TAU * (column as f32 + 0.5) / COLUMNS as f32;
            let elevation = model.elevations_deg[ring].to_radians();
            let range = 3.0 + (i * 7919 % 1000) as f32 * 0.03;
            let [sin, cos] = [azimuth.sin(), azimuth.cos()];
            points.push(range * Vec3::new(elevation.cos() * cos, elevation.cos() * sin, elevation.sin()));
            rings.push(ring as u16);
        }
        let mut image = ScanImage::new();
        image.update(&points, &rings, &model);
        assert_eq!((image.collisions(), image.outside()), (0, 0));
        (image, points)
    }

    fn literal(image: &ScanImage, points: &[Vec3], window: Window) -> Sums {
        let mut sums = [0.0; 10];
        for ring in window.rings[0]..=window.rings[1] {
            for column in window.columns[0]..=window.columns[1] {
                if let Some(i) = image.get(ring, (column + 3 * COLUMNS - MAX_COLUMNS) % COLUMNS) {
                    add(&mut sums, points[i]);
                }
            }
        }
        sums
    }

    fn differ(a: Sums, b: Sums) -> bool {
        a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-6)
    }

    #[test]
    fn returns_that_are_nowhere_or_very_far_away_are_left_out() {
        let (image, mut points) = image();
        (points[100], points[200]) = (Vec3::NAN, 1e6 * points[200]);
        let mut sums = WindowSums::default();
        sums.update(&image, &points);
        let all = sums.of(Window {
            rings: [0, RINGS - 1],
            columns: [MAX_COLUMNS, MAX_COLUMNS + COLUMNS - 1],
        });
        assert_eq!(all[0] as usize, points.len() - 2);
        assert!(all.iter().all(|sum| sum.abs() < 1e7), "{all:?}");
    }

    proptest! {
        #[test]
        fn sums_are_those_over_the_windows_returns(
            ring in 0..RINGS, rings in 0..20_usize, column in 0..COLUMNS, left in 0..=MAX_COLUMNS, right in 0..=MAX_COLUMNS,
        ) {
            let (image, points) = image();
            let mut sums = WindowSums::default();
            sums.update(&image, &vec![Vec3::ONE; points.len()]); // overwritten
            sums.update(&image, &points);
            let window = Window {
                rings: [ring, (ring + rings).min(RINGS - 1)],
                columns: [column + MAX_COLUMNS - left, column + MAX_COLUMNS + right],
            };
            let slow = literal(&image, &points, window);
            prop_assert!(!differ(sums.of(window), slow));
            // And the comparison would see one return that is missing.
            let mut less = slow;
            add(&mut less, Vec3::splat(1e-3));
            prop_assert!(differ(sums.of(window), less));
        }
    }
}
