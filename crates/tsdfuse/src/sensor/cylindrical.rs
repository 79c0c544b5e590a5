//! Projection of a rotating LiDAR's returns onto a cylinder about its axis, and its exact inverse.
//!
//! ```text
//!                       columns go clockwise, column 0 looks along x
//!   row 0       ┌───┬───┬───┬───┐  tan θ_1, the highest beam        row:    (tan θ_1 − t)/pitch,  t = (z − c_z)/ρ
//!               │   │   │   │   │                                    column: −φ/pitch − phase,    φ = atan2(y, x)
//!   row h − 1   └───┴───┴───┴───┘  tan θ_2, the lowest beam         depth:  ρ = √(x² + y²)
//!                 0   1   …  w−1   pitch = 2π/w: pixels are square
//! ```
//!
//! Whole numbers are the centres of pixels. The printed inverse of thesis 5.6 is none ((5.28)–(5.31): its δ are upside down,
//! its two atan2 differ, its tangent misses the row's offset); this is what they mean, with c_z = 0 there and of (4.1) in
//! Kühner's form.

use std::f32::consts::TAU;

use fearless_simd::{Level, Simd, dispatch, f32x8, i32x8, mask32x8, prelude::*};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::SensorModel;
use super::approx::{atan2_f32, sin_cos};
use super::image::{PART, PHASE_BINS, mean_phase};
use super::pinhole::whole;

/// A cylindrical image of w columns and h rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CylindricalProjection {
    rows: usize,
    /// Tangent of the elevation of row 0.
    top: f32,
    /// Height of a row and width of a column, as a tangent and in radians.
    pitch: f32,
    /// The height of the centre of projection above the sensor's origin, metres.
    center_z_m: f32,
    /// By how much columns are turned, in columns.
    phase: f32,
    /// Unit vector in the horizontal plane towards each column.
    towards: Vec<Vec2>,
}

/// Where a point is seen in a [`CylindricalProjection`] image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CylindricalPoint {
    /// In [−½, columns − ½).
    pub column: f32,
    /// 0 is the top row; also outside the image.
    pub row: f32,
    /// ρ, the distance from the axis, metres.
    pub depth_m: f32,
}

impl CylindricalProjection {
    /// The image of a sensor whose [`SensorModel::check`] passes, with rows up to `margin` beyond its outermost beams (as a
    /// tangent).
    pub fn new(model: &SensorModel, center_z_m: f32, phase: f32, margin: f32) -> Self {
        let tangent = |beam: Option<&f32>| {
            beam.copied()
                .unwrap_or(0.0)
                .clamp(-STEEPEST_DEG, STEEPEST_DEG)
                .to_radians()
                .tan()
        };
        let (bottom, top) = (
            tangent(model.elevations_deg.first()),
            tangent(model.elevations_deg.last()),
        );
        let pitch = TAU / model.columns as f32;
        let beyond = (margin / pitch).ceil();
        let column = |j: u32| {
            let (sin, cos) = sin_cos(-f64::from(pitch) * (f64::from(j) + f64::from(phase)));
            Vec2::new(cos as f32, sin as f32)
        };
        let rows = 1 + ((top - bottom) / pitch).round() as usize + 2 * beyond as usize;
        Self {
            rows: rows.min(MAX_PIXELS / model.columns.max(1) as usize),
            top: top + beyond * pitch,
            pitch,
            center_z_m,
            phase,
            towards: (0..model.columns).map(column).collect(),
        }
    }

    /// How far a turn's firings are beyond the azimuths −2πj/columns on average, in columns: the phase with which returns fall
    /// into the middle of the columns.
    pub fn phase_of(points: &[Vec3], columns: u32) -> f32 {
        let per_rad = columns as f32 / TAU;
        let level = Level::new(); // the vector instructions of this CPU
        let of_part = |points: &[Vec3]| {
            let mut bins = [0; PHASE_BINS];
            dispatch!(level, _ => for p in points {
                let place = -atan2_f32(p.y, p.x) * per_rad;
                if place.is_finite() {
                    bins[((place - place.floor()) * PHASE_BINS as f32) as usize % PHASE_BINS] += 1;
                }
            });
            bins
        };
        let add = |a: [u32; PHASE_BINS], b: [u32; PHASE_BINS]| std::array::from_fn(|k| a[k] + b[k]);
        mean_phase(&points.par_chunks(PART).map(of_part).reduce(|| [0; PHASE_BINS], add))
    }

    /// Columns of the image.
    pub fn columns(&self) -> usize {
        self.towards.len()
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Height of a row (as a tangent) and width of a column (radians).
    pub fn pitch(&self) -> f32 {
        self.pitch
    }

    /// Where a point (sensor frame, metres) is seen. Not finite for points that are not, and for points on the axis.
    #[inline(always)]
    pub fn project(&self, point: Vec3) -> CylindricalPoint {
        let depth_m = (point.x * point.x + point.y * point.y).sqrt();
        let columns = self.columns() as f32;
        let per_pitch = 1.0 / self.pitch;
        let column = -atan2_f32(point.y, point.x) * per_pitch - self.phase;
        let column = if column < -0.5 { column + columns } else { column };
        let column = if column >= columns - 0.5 {
            column - columns
        } else {
            column
        };
        CylindricalPoint {
            column,
            row: (self.top - (point.z - self.center_z_m) / depth_m) * per_pitch,
            depth_m,
        }
    }

    /// Where each of some points is seen, once `to_sensor` has brought them into the sensor's frame.
    pub(crate) fn project_all(
        &self,
        points: &[Vec3],
        to_sensor: impl Fn(Vec3) -> Vec3 + Sync,
        seen: &mut Vec<CylindricalPoint>,
    ) {
        seen.resize(points.len(), CylindricalPoint::default());
        let level = Level::new();
        let parts = points.par_chunks(PART).zip(seen.par_chunks_mut(PART));
        parts.for_each(|(points, seen)| {
            dispatch!(level, _ => for (&point, seen) in points.iter().zip(seen) {
                *seen = self.project(to_sensor(point));
            });
        });
    }

    /// The point (sensor frame, metres) at a depth that is seen at the centre of a pixel.
    #[inline(always)]
    pub fn unproject(&self, row: usize, column: usize, depth_m: f32) -> Vec3 {
        self.direction(row as f32, self.towards[column]) * depth_m + Vec3::Z * self.center_z_m
    }

    /// From the centre of projection to depth 1 at a row.
    #[inline(always)]
    fn direction(&self, row: f32, towards: Vec2) -> Vec3 {
        towards.extend(self.top - row * self.pitch)
    }

    /// The four corners of a column's pixels from row `first` to row `last`, as vectors from the centre of projection to depth 1.
    #[inline(always)]
    pub(crate) fn corners(&self, first: usize, last: usize, column: usize) -> [Vec3; 4] {
        let half = 0.5 * self.pitch;
        let towards = self.towards[column];
        let left = (towards + towards.perp() * half).normalize();
        let right = (towards - towards.perp() * half).normalize();
        let (above, below) = (first as f32 - 0.5, last as f32 + 0.5);
        [
            self.direction(above, left),
            self.direction(above, right),
            self.direction(below, left),
            self.direction(below, right),
        ]
    }

    /// The height of the centre of projection above the sensor's origin, metres.
    pub fn center_z_m(&self) -> f32 {
        self.center_z_m
    }

    /// Row and column of the pixel that holds a point; `None` outside the image.
    #[inline(always)]
    pub fn pixel(&self, point: CylindricalPoint) -> Option<(usize, usize)> {
        let (row, column) = (point.row + 0.5, point.column + 0.5);
        // Also false for NaN.
        let inside = row >= 0.0 && row < self.rows as f32 && column >= 0.0 && point.depth_m < f32::MAX;
        inside.then(|| (row as usize, (column as usize).min(self.columns() - 1)))
    }
}

impl CylindricalProjection {
    /// [`Self::pixel`] for eight points: whether they are inside, and the numbers of their pixels, column by column (0 outside).
    #[inline(always)]
    pub(crate) fn pixels<S: Simd>(
        &self,
        column: f32x8<S>,
        row: f32x8<S>,
        depth_m: f32x8<S>,
    ) -> (mask32x8<S>, [i32; 8]) {
        let (row, column) = (row + 0.5, column + 0.5);
        let inside = row.simd_ge(0.0) & row.simd_lt(self.rows as f32) & column.simd_ge(0.0) & depth_m.simd_lt(f32::MAX);
        let column = whole(column.min(self.columns() as f32 - 1.0));
        let pixel = column * self.rows as i32 + whole(row);
        let none = i32x8::splat(pixel.token(), 0);
        (inside, inside.select(pixel, none).into())
    }
}

/// Bounds the memory of an image, whatever the sensor's model says.
const MAX_PIXELS: usize = 1 << 26;

/// Beams steeper than this do not meet a cylinder of reasonable height.
const STEEPEST_DEG: f32 = 75.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{model, names};
    use proptest::prelude::*;

    fn any_image() -> impl Strategy<Value = CylindricalProjection> {
        (prop::sample::select(names()), -0.3..0.3f32, -0.5..0.5f32, 0.0..0.1f32)
            .prop_map(|(name, z, phase, margin)| CylindricalProjection::new(&model(name).unwrap(), z, phase, margin))
    }

    proptest! {
        #[test]
        fn pixels_survive_the_round_trip(image in any_image(), u in 0.0..1.0f32, v in 0.0..1.0f32, depth in 0.5..150f32) {
            let (row, column) = ((v * image.rows() as f32) as usize, (u * image.columns() as f32) as usize);
            let seen = image.project(image.unproject(row, column, depth));
            prop_assert_eq!(image.pixel(seen), Some((row, column)));
            prop_assert!((seen.row - row as f32).abs() < 0.01 && (seen.column - column as f32).abs() < 0.01, "{seen:?}");
            prop_assert!((seen.depth_m / depth - 1.0).abs() < 1e-6);
        }

        #[test]
        fn a_point_is_within_half_a_pixel_of_the_centre_of_its_pixel(
            image in any_image(), p in prop::array::uniform3(-50.0..50.0f32),
        ) {
            let p = Vec3::from(p);
            let seen = image.project(p);
            if let Some((row, column)) = image.pixel(seen) {
                let off = image.unproject(row, column, seen.depth_m) - p;
                prop_assert!(off.length() <= seen.depth_m * image.pitch() * 0.7072 + 1e-4, "{off}");
            }
        }

        #[test]
        fn a_point_lies_between_the_corners_of_its_pixel(image in any_image(), p in prop::array::uniform3(-50.0..50.0f32)) {
            let p = Vec3::from(p);
            let seen = image.project(p);
            if let Some((row, column)) = image.pixel(seen) {
                let corners = image.corners(row, row, column).map(|c| c * seen.depth_m + Vec3::Z * image.center_z_m());
                let (low, high) = (corners.into_iter().reduce(Vec3::min).unwrap(), corners.into_iter().reduce(Vec3::max).unwrap());
                let slack = Vec3::splat(seen.depth_m * image.pitch() * 0.01 + 1e-4);
                prop_assert!(p.cmpge(low - slack).all() && p.cmple(high + slack).all(), "{p} {low} {high}");
            }
        }
    }

    #[test]
    fn pixels_are_square_and_rows_go_from_the_highest_to_the_lowest_beam() {
        let pandar = model("pandar64").unwrap();
        let image = CylindricalProjection::new(&pandar, 0.0, 0.0, 0.0);
        let tan = |ring: usize| pandar.elevations_deg[ring].to_radians().tan();
        let rows = 1 + ((tan(63) - tan(0)) * 1800.0 / TAU).round() as usize;
        assert_eq!((image.columns(), image.rows()), (1800, rows));
        let along = |elevation: f32| Vec3::new(1.0, 0.0, elevation.to_radians().tan()) * 7.0;
        let row = |elevation: f32| image.pixel(image.project(along(elevation))).map(|(row, _)| row);
        assert_eq!(row(*pandar.elevations_deg.last().unwrap()), Some(0));
        assert_eq!(row(pandar.elevations_deg[0]), Some(image.rows() - 1));
        assert_eq!((row(30.0), row(-40.0)), (None, None));
    }

    #[test]
    fn points_without_a_place_have_no_pixel() {
        let image = CylindricalProjection::new(&model("vlp16").unwrap(), 0.0, 0.0, 0.0);
        for p in [
            Vec3::ZERO,
            Vec3::Z,
            Vec3::NAN,
            Vec3::splat(f32::INFINITY),
            Vec3::new(f32::MAX, f32::MAX, 0.0),
        ] {
            assert_eq!(image.pixel(image.project(p)), None, "{p}");
        }
    }
}
