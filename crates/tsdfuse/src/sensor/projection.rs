//! Spherical projection over a beam table, and its exact inverse.
//!
//! ```text
//!   seen from above: columns go clockwise            seen from the side: rows go up
//!
//!              x  column 0                             row n−1 ─────  highest beam
//!              ▲                                            ⋮
//!   y          │                                       row 1   ─────
//!   ◀──────────┼──────────▶ column ¼·n                 row 0   ─────  lowest beam
//!   column ¾·n │
//!              ▼ column ½·n                            between two beams: linear in elevation
//! ```
//!
//! Column `j` of `n` lies at azimuth `−2πj/n`, azimuth being `atan2(y, x)`; this is also the convention of the plain
//! folder format. Rows beyond the first and last beam continue with the spacing of the last two.

use std::f64::consts::TAU;

use glam::DVec3;

use super::SensorModel;
use super::approx::{atan2, sin_cos};

/// A place in the image of a sensor; whole numbers are beams and firings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// 0 = the lowest beam; negative below it.
    pub row: f64,
    /// In [0, columns), clockwise from the x axis; rounding may give `columns`, which is column 0.
    pub column: f64,
}

/// Maps directions to pixels and back.
#[derive(Clone, Debug)]
pub struct Projection {
    /// Ascending, at least two.
    elevations_rad: Vec<f64>,
    columns: f64,
}

impl Projection {
    /// The projection of a sensor whose [`SensorModel::check`] passes.
    pub fn new(model: &SensorModel) -> Self {
        let columns = f64::from(model.columns);
        let mut elevations_rad: Vec<f64> = model
            .elevations_deg
            .iter()
            .map(|&e| f64::from(e).to_radians())
            .collect();
        if elevations_rad.len() < 2 {
            // One beam has no row spacing: take that of the columns.
            let only = elevations_rad.first().copied().unwrap_or(0.0);
            elevations_rad = vec![only, only + TAU / columns];
        }
        Self {
            elevations_rad,
            columns,
        }
    }

    /// The pixel in which a point is seen (sensor frame; any length but zero).
    pub fn project(&self, point: DVec3) -> Pixel {
        let elevation = atan2(point.z, (point.x * point.x + point.y * point.y).sqrt());
        let turns = -atan2(point.y, point.x) / TAU;
        let column = (turns - turns.floor()) * self.columns;
        Pixel {
            row: self.row_of(elevation),
            // −1e-17 turns round to a full one
            column: if column < self.columns { column } else { 0.0 },
        }
    }

    /// The unit vector (sensor frame) towards a pixel: the inverse of [`Projection::project`].
    pub fn direction(&self, pixel: Pixel) -> DVec3 {
        let (sin_e, cos_e) = sin_cos(self.elevation_of(pixel.row));
        let (sin_a, cos_a) = sin_cos(-TAU * pixel.column / self.columns);
        DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e)
    }

    /// Row at an elevation in radians.
    pub fn row_of(&self, elevation_rad: f64) -> f64 {
        let above = self.elevations_rad.partition_point(|&e| e <= elevation_rad);
        let (lower, low, high) = self.segment(above as f64 - 1.0);
        lower + (elevation_rad - low) / (high - low)
    }

    /// Elevation of a row, radians.
    pub fn elevation_of(&self, row: f64) -> f64 {
        let (lower, low, high) = self.segment(row.floor());
        low + (row - lower) * (high - low)
    }

    /// The pair of neighbouring beams that rules at row `lower`: the lower one's row, and both elevations.
    fn segment(&self, lower: f64) -> (f64, f64, f64) {
        let lower = (lower.max(0.0) as usize).min(self.elevations_rad.len() - 2);
        (lower as f64, self.elevations_rad[lower], self.elevations_rad[lower + 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{model, names};
    use proptest::prelude::*;

    fn any_sensor() -> impl Strategy<Value = SensorModel> {
        let random = (prop::collection::btree_set(-89_000..89_000i32, 1..80), 1u32..5000);
        let random = random.prop_map(|(beams, columns)| {
            let beams = beams.into_iter().map(|b| b as f32 * 1e-3).collect();
            SensorModel::from_beams("random", beams, columns, (0.1, 100.0)).unwrap()
        });
        prop_oneof![prop::sample::select(names()).prop_map(|n| model(n).unwrap()), random]
    }

    proptest! {
        #[test]
        fn directions_survive_the_round_trip(sensor in any_sensor(), d in prop::array::uniform3(-1.0..1.0f64), r in 0.1..1e3f64) {
            let d = DVec3::from(d);
            prop_assume!(d.length() > 1e-3);
            let projection = Projection::new(&sensor);
            let back = projection.direction(projection.project(d.normalize() * r));
            prop_assert!(back.distance(d.normalize()) < 1e-11, "{back} {d}");
        }

        #[test]
        fn pixels_survive_the_round_trip(sensor in any_sensor(), row in -0.4..1.4f64, column in 0.0..1.0f64) {
            let projection = Projection::new(&sensor);
            let pixel = Pixel { row: row * sensor.rings() as f64, column: column * f64::from(sensor.columns) };
            prop_assume!(projection.elevation_of(pixel.row).abs() < 1.57); // at the poles columns meet
            let back = projection.project(projection.direction(pixel) * 7.0);
            let slip = (back.column - pixel.column).abs();
            prop_assert!((back.row - pixel.row).abs() < 1e-6, "{back:?} {pixel:?}");
            prop_assert!(slip.min(f64::from(sensor.columns) - slip) < 1e-6, "{back:?} {pixel:?}");
        }
    }

    #[test]
    fn beams_and_firings_are_whole_numbers() {
        let sensor = model("pandar64").unwrap();
        let projection = Projection::new(&sensor);
        for (ring, elevation) in sensor.elevations_deg.iter().enumerate() {
            let row = projection.row_of(f64::from(*elevation).to_radians());
            assert!((row - ring as f64).abs() < 1e-12, "{ring} {row}");
        }
        for (point, column) in [
            (DVec3::X, 0.0),
            (-DVec3::Y, 450.0),
            (-DVec3::X, 900.0),
            (DVec3::Y, 1350.0),
        ] {
            assert!((projection.project(point).column - column).abs() < 1e-9, "{point}");
        }
        // just left of the x axis is the last column, not column 1800
        assert!(projection.project(DVec3::new(1.0, 1e-300, 0.0)).column < 1800.0);
    }
}
