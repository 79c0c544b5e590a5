//! The organized image of a scan: which return was measured by which laser at which firing.
//!
//! ```text
//!  ring (row)                                   column j: firing at azimuth −2π(j + phase)/columns, clockwise
//!   n−1  ┌───┬───┬───┬───┐
//!        │   │ 4 │ 7 │   │  ← each cell holds the index of its return, or NONE
//!    0   └───┴───┴───┴───┘
//!          0   1   2   3     the last column and column 0 are neighbours
//! ```
//!
//! Real lasers do not fire in step: each ring has its own phase within the column width. It is the circular mean of its
//! returns' azimuths modulo the column width, so that they fall into the middle of the columns and none on a border.

use std::f32::consts::TAU;

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;

use super::SensorModel;
use super::approx::{atan2_f32, sin_cos};

/// Marks a cell without return, and a return without cell.
pub const NONE: u32 = u32::MAX;

/// Returns that one thread takes at a time.
pub(crate) const PART: usize = 8192;

/// Returns of one ring that are at most this far apart, in columns, are of one firing.
pub const SAME_FIRING: f32 = 0.25;

/// Bins of a ring's azimuths within a column.
pub const PHASE_BINS: usize = 32;

/// Returns of one scan by ring and column. Reuse it from scan to scan: it keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct ScanImage {
    columns: usize,
    /// Row by row: the index of the return, or [`NONE`].
    cells: Vec<u32>,
    /// Per return: its cell, or [`NONE`].
    cell_of: Vec<u32>,
    /// Returns that lost their cell.
    losers: Vec<u32>,
    collisions: usize,
    outside: usize,
    /// Tangent of the angle between each ring and the next.
    ring_gap_tangents: Vec<f32>,
    column_width_tangent: f32,
    /// Azimuth of each return in columns, NaN for invalid ones.
    places: Vec<f32>,
    /// Returns per ring and part of a column.
    phase_bins: Vec<[u32; PHASE_BINS]>,
}

impl ScanImage {
    /// An image without cells.
    pub fn new() -> Self {
        Self::default()
    }

    /// Builds the image of returns in the sensor frame at their own time (metres), one ring number each.
    ///
    /// `model` has passed [`SensorModel::check`]. Where two returns fall into one cell, the one nearer to the cell's
    /// middle stays. The other takes the free neighbouring cell on its side if it came from another firing (sensors that round
    /// azimuths, such as the HDL-64E, have many firings that close; of several, the first one moves). Otherwise it counts as a
    /// collision ([`ScanImage::collisions`]).
    pub fn update(&mut self, points: &[Vec3], rings: &[u16], model: &SensorModel) {
        self.columns = model.columns as usize;
        self.cells.clear();
        self.cells.resize(model.rings() * self.columns, NONE);
        self.cell_of.clear();
        self.cell_of.resize(points.len(), NONE);
        (self.collisions, self.outside) = (0, 0);
        self.measure_angles(model);
        self.find_places(points);
        self.count_phases(rings, model.rings());
        self.fill(rings);
    }

    /// Rows of the image.
    pub fn rings(&self) -> usize {
        self.cells.len() / self.columns.max(1)
    }

    /// Columns of the image.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The return in a cell.
    #[inline]
    pub fn get(&self, ring: usize, column: usize) -> Option<usize> {
        let cell = (column < self.columns)
            .then(|| self.cells.get(ring * self.columns + column))
            .flatten();
        cell.filter(|&&i| i != NONE).map(|&i| i as usize)
    }

    /// The indices of a ring's returns by column, [`NONE`] where there is none; empty for a ring that does not exist.
    pub fn row(&self, ring: usize) -> &[u32] {
        self.cells
            .get(ring * self.columns..(ring + 1) * self.columns)
            .unwrap_or(&[])
    }

    /// Ring and column of a return; `None` if it lost its cell to another one or fits none.
    #[inline]
    pub fn place_of(&self, point: usize) -> Option<(usize, usize)> {
        let cell = self.cell_of.get(point).filter(|&&c| c != NONE)?;
        // In 32 bits, where division is twice as fast.
        let columns = self.columns as u32;
        Some(((cell / columns) as usize, (cell % columns) as usize))
    }

    /// Returns that lost their cell to another return of the same ring and column.
    pub fn collisions(&self) -> usize {
        self.collisions
    }

    /// Returns that are invalid or of no ring of the sensor.
    pub fn outside(&self) -> usize {
        self.outside
    }

    /// tan Δθ between a ring and the next one above.
    pub(crate) fn ring_gap_tangent(&self, ring: usize) -> f32 {
        self.ring_gap_tangents.get(ring).copied().unwrap_or(0.0)
    }

    /// As [`Self::ring_gap_tangent`]; of the uppermost ring, that to the one below.
    pub(crate) fn ring_gap_beside(&self, ring: usize) -> f32 {
        self.ring_gap_tangent(ring.min(self.rings().saturating_sub(2)))
    }

    /// tan Δφ between two columns.
    pub(crate) fn column_width_tangent(&self) -> f32 {
        self.column_width_tangent
    }

    fn measure_angles(&mut self, model: &SensorModel) {
        self.ring_gap_tangents = ring_gap_tangents(model);
        self.column_width_tangent = tangent(model.column_width_rad());
    }

    fn find_places(&mut self, points: &[Vec3]) {
        let columns = self.columns as f32;
        let per_rad = columns / TAU;
        self.places.resize(points.len(), 0.0);
        let parts = points.par_chunks(PART).zip(self.places.par_chunks_mut(PART));
        let level = Level::new(); // the vector instructions of this CPU
        parts.for_each(|(points, places)| {
            // A plain loop over slices, so that the compiler vectorises it.
            dispatch!(level, _ => for (p, place) in points.iter().zip(places) {
                let column = -atan2_f32(p.y, p.x) * per_rad;
                let column = if column < 0.0 { column + columns } else { column };
                let size = p.x.abs() + p.y.abs() + p.z.abs();
                // Adds 0, or NaN for what is not finite and for the zero vector.
                *place = column + 0.0 * size / size;
            });
        });
    }

    fn count_phases(&mut self, rings: &[u16], count: usize) {
        self.phase_bins.clear();
        self.phase_bins.resize(count, [0; PHASE_BINS]);
        for (&place, &ring) in self.places.iter().zip(rings) {
            if let Some(bins) = self.phase_bins.get_mut(usize::from(ring)).filter(|_| !place.is_nan()) {
                // Not negative, so truncation is the floor (a slow call on old instruction sets).
                bins[(place * PHASE_BINS as f32) as u32 as usize % PHASE_BINS] += 1;
            }
        }
    }

    fn fill(&mut self, rings: &[u16]) {
        let phases: Vec<f32> = self.phase_bins.iter().map(mean_phase).collect();
        self.losers.clear();
        for (point, &place) in self.places.iter().enumerate() {
            let ring = rings.get(point).map_or(usize::MAX, |&r| usize::from(r));
            let Some(&phase) = phases.get(ring).filter(|_| !place.is_nan()) else {
                self.outside += 1;
                continue;
            };
            let (column, off) = settle(place, phase);
            let cell = ring * self.columns + if column < self.columns { column } else { 0 };
            let holder = self.cells[cell];
            if holder == NONE || off.abs() < settle(self.places[holder as usize], phase).1.abs() {
                self.cells[cell] = point as u32;
                self.cell_of[point] = cell as u32;
            }
            if holder != NONE {
                let keeps = self.cells[cell] == holder;
                self.losers.push(if keeps { point as u32 } else { holder });
            }
        }
        let mut losers = std::mem::take(&mut self.losers);
        losers.sort_unstable();
        for &loser in &losers {
            let ring = usize::from(rings[loser as usize]);
            self.move_aside(loser, ring, phases[ring]);
        }
        self.losers = losers;
    }

    /// Gives a return that lost its cell the one on its side.
    fn move_aside(&mut self, loser: u32, ring: usize, phase: f32) {
        let place = self.places[loser as usize];
        let (column, off) = settle(place, phase);
        let side = if off > 0.0 {
            column + 1
        } else {
            column + self.columns - 1
        };
        let cell_at = |column: usize| ring * self.columns + column % self.columns;
        let (lost, free) = (cell_at(column), cell_at(side));
        let apart = (self.places[self.cells[lost] as usize] - place).abs();
        let apart = apart.min(self.columns as f32 - apart);
        let gets_it = self.cells[free] == NONE && apart > SAME_FIRING;
        if gets_it {
            self.cells[free] = loser;
        } else {
            self.collisions += 1;
        }
        self.cell_of[loser as usize] = if gets_it { free as u32 } else { NONE };
    }
}

/// tan Δθ between each ring and the next one above.
pub fn ring_gap_tangents(model: &SensorModel) -> Vec<f32> {
    let gaps = model.elevations_deg.windows(2);
    gaps.map(|e| tangent(f64::from(e[1] - e[0]).to_radians())).collect()
}

fn tangent(angle: f64) -> f32 {
    let (sin, cos) = sin_cos(angle);
    (sin / cos) as f32
}

/// The column of an azimuth (one too many at the end of a turn), and how far beyond its middle it is; in columns.
#[inline]
fn settle(place: f32, phase: f32) -> (usize, f32) {
    let shifted = place - phase;
    // Phases are at most ½, so this is not negative and truncation is the floor.
    let column = (shifted + 0.5) as u32;
    (column as usize, shifted - column as f32)
}

/// Circular mean of a ring's azimuths within a column, in columns: in [−½, ½].
pub(super) fn mean_phase(bins: &[u32; PHASE_BINS]) -> f32 {
    let (mut x, mut y) = (0.0, 0.0);
    for (bin, &count) in bins.iter().enumerate() {
        let (sin, cos) = sin_cos((bin as f64 + 0.5) / PHASE_BINS as f64 * std::f64::consts::TAU);
        (x, y) = (x + f64::from(count) * cos, y + f64::from(count) * sin);
    }
    (super::approx::atan2(y, x) / std::f64::consts::TAU) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::testing::{random, scan_room};
    use crate::sensor::{NO_RING, SensorModel, model, names};

    fn image(points: &[Vec3], rings: &[u16], model: &SensorModel) -> ScanImage {
        let mut image = ScanImage::new();
        image.update(points, rings, model);
        image
    }

    #[test]
    fn ideal_scans_fill_the_image_in_order() {
        for name in names() {
            let model = model(name).unwrap();
            let (points, rings) = scan_room(&model, |_| 0.0);
            let image = image(&points, &rings, &model);
            assert_eq!((image.collisions(), image.outside()), (0, 0), "{name}");
            for (i, &ring) in rings.iter().enumerate() {
                let place = (usize::from(ring), i / model.rings());
                assert_eq!(
                    (image.place_of(i), image.get(place.0, place.1)),
                    (Some(place), Some(i)),
                    "{name}"
                );
            }
        }
    }

    #[test]
    fn any_phase_of_the_lasers_gives_no_collision() {
        let model = model("pandar64").unwrap();
        let (points, rings) = scan_room(&model, |ring| 12.0 * f64::from(random(ring)));
        let image = image(&points, &rings, &model);
        assert_eq!(image.collisions(), 0);
        assert!((0..image.rings()).all(|ring| image.row(ring).iter().all(|&i| i != NONE)));
    }

    #[test]
    fn the_return_nearer_to_the_middle_wins_whichever_comes_first() {
        let model = SensorModel::from_beams("flat", vec![0.0], 8, (0.1, 9.0)).unwrap();
        let at = |column: f32| Vec3::new((-column * TAU / 8.0).cos(), (-column * TAU / 8.0).sin(), 0.0);
        for (columns, winner) in [([1.0, 2.1, 1.9, 2.0], 3), ([2.0, 2.1, 1.9, 1.0], 0)] {
            let image = image(&columns.map(at), &[0; 4], &model);
            assert_eq!((image.get(0, 2), image.collisions()), (Some(winner), 2));
            assert_eq!((0..4).filter(|&i| image.place_of(i).is_some()).count(), 2);
        }
    }

    #[test]
    fn rounded_azimuths_find_a_cell_each_but_second_returns_do_not() {
        let model = SensorModel::from_beams("coded", vec![0.0], 2161, (0.1, 9.0)).unwrap();
        // A turn of 2161 firings, azimuths rounded down to the 4000 steps of a coder.
        let coded = |i: usize| ((i * 4000 / 2161) as f32 * TAU / 4000.0).sin_cos();
        let mut points: Vec<Vec3> = (0..2161).map(coded).map(|(s, c)| Vec3::new(c, -s, 0.0)).collect();
        assert_eq!(image(&points, &[0; 2161], &model).collisions(), 0);
        // A second return behind the first, beside an empty cell.
        points.swap_remove(1000);
        points.push(points[999] * 2.0);
        assert_eq!(image(&points, &[0; 2161], &model).collisions(), 1);
    }

    #[test]
    fn invalid_returns_stay_outside() {
        let model = model("vlp16").unwrap();
        let points = [
            Vec3::ZERO,
            Vec3::NAN,
            Vec3::X,
            Vec3::X,
            Vec3::new(1.0, 0.0, f32::INFINITY),
            Vec3::X,
            -Vec3::X,
        ];
        let image = image(&points, &[0, 0, NO_RING, 16, 0, 3], &model);
        assert_eq!(
            (image.outside(), image.collisions(), image.place_of(5)),
            (6, 0, Some((3, 0)))
        );
    }
}
