//! Sensor models: beam tables, projections with exact inverses, and ring recovery.

use serde::{Deserialize, Serialize};

pub mod approx;
mod cylindrical;
mod depth_image;
mod guess;
mod image;
mod order;
mod pinhole;
mod projection;
mod recovery;
mod rings;
mod tables;
#[cfg(test)]
pub(crate) mod testing;
mod unorganized;

pub use cylindrical::{Cylindrical, CylindricalPoint};
pub use depth_image::DepthImage;
pub use guess::guess;
pub(crate) use image::PART;
pub use image::{NONE, ScanImage};
#[doc(hidden)]
pub use image::{PHASE_BINS, SAME_FIRING, ring_gap_tangents};
pub use order::{OrderedRings, rings_by_order};
pub use pinhole::{MAX_IMAGE_EDGE, Pinhole, PinholeError};
pub use projection::{Pixel, Projection};
pub use recovery::recover_rings;
pub use rings::{NO_RING, RingRecovery, RingSource, sort_rings};
pub use tables::{model, names};
pub(crate) use unorganized::grid_of;

/// A rotating LiDAR: its beams, how finely it samples a turn, and which ranges it measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Lower-case name as on the command line, for instance `pandar64`.
    pub name: String,
    /// Elevation of each beam above the sensor's horizontal plane, degrees, ascending: ring 0 is the lowest.
    pub elevations_deg: Vec<f32>,
    /// Firings in one turn.
    pub columns: u32,
    /// Shortest measurable range.
    pub min_range_m: f32,
    /// Longest measurable range (χ in the weights of the methods).
    pub max_range_m: f32,
}

/// Why numbers are not a sensor model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SensorError {
    /// The beam list is empty or longer than ring numbers can count.
    #[error("sensor {name}: {beams} beams; 1 to {} are possible", MAX_BEAMS)]
    Beams {
        /// The sensor's name.
        name: String,
        /// How many there are.
        beams: usize,
    },
    /// Elevations ascend strictly and lie between −90° and 90°.
    #[error("sensor {name}: elevation {ring} is {elevation_deg} degrees, not above the one before and within ±90")]
    Elevation {
        /// The sensor's name.
        name: String,
        /// Its place in the list.
        ring: usize,
        /// What it says.
        elevation_deg: f32,
    },
    /// A turn has 1 to [`MAX_COLUMNS`] columns.
    #[error("sensor {name}: {columns} columns in a turn; 1 to {} are possible", MAX_COLUMNS)]
    Columns {
        /// The sensor's name.
        name: String,
        /// What it says.
        columns: u32,
    },
    /// Ranges are finite, not negative, and the shortest is below the longest.
    #[error("sensor {name}: it cannot measure from {min_range_m} m to {max_range_m} m")]
    Ranges {
        /// The sensor's name.
        name: String,
        /// The shortest range.
        min_range_m: f32,
        /// The longest range.
        max_range_m: f32,
    },
}

/// More beams than any sensor has; also bounds the memory of an organized image.
pub const MAX_BEAMS: usize = 1024;

/// More firings in a turn than any sensor makes; also bounds the memory of an organized image.
pub const MAX_COLUMNS: u32 = 16_384;

impl SensorModel {
    /// A model from a list of beam elevations in degrees, in any order.
    ///
    /// # Errors
    /// See [`SensorModel::check`].
    pub fn from_beams(
        name: impl Into<String>,
        mut elevations_deg: Vec<f32>,
        columns: u32,
        (min_range_m, max_range_m): (f32, f32),
    ) -> Result<Self, SensorError> {
        elevations_deg.sort_by(f32::total_cmp);
        let model = Self {
            name: name.into(),
            elevations_deg,
            columns,
            min_range_m,
            max_range_m,
        };
        model.check().map(|()| model)
    }

    /// How many lasers there are.
    pub fn rings(&self) -> usize {
        self.elevations_deg.len()
    }

    /// Angle between two firings, radians.
    pub fn column_width_rad(&self) -> f64 {
        std::f64::consts::TAU / f64::from(self.columns)
    }

    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// [`SensorError`] names the sensor and the number.
    pub fn check(&self) -> Result<(), SensorError> {
        let name = || self.name.clone();
        if !(1..=MAX_BEAMS).contains(&self.rings()) {
            return Err(SensorError::Beams {
                name: name(),
                beams: self.rings(),
            });
        }
        let mut below = -90.0;
        for (ring, &elevation_deg) in self.elevations_deg.iter().enumerate() {
            if !(elevation_deg > below && elevation_deg < 90.0) {
                return Err(SensorError::Elevation {
                    name: name(),
                    ring,
                    elevation_deg,
                });
            }
            below = elevation_deg;
        }
        if !(1..=MAX_COLUMNS).contains(&self.columns) {
            return Err(SensorError::Columns {
                name: name(),
                columns: self.columns,
            });
        }
        let (min_range_m, max_range_m) = (self.min_range_m, self.max_range_m);
        if !(min_range_m >= 0.0 && min_range_m < max_range_m && max_range_m.is_finite()) {
            return Err(SensorError::Ranges {
                name: name(),
                min_range_m,
                max_range_m,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_may_come_in_any_order() {
        let model = SensorModel::from_beams("two", vec![3.0, -3.0], 360, (0.5, 50.0)).unwrap();
        assert_eq!(model.elevations_deg, [-3.0, 3.0]);
    }

    #[test]
    fn impossible_sensors_are_refused_with_the_number() {
        let build = |beams: &[f32], columns, ranges| {
            let built = SensorModel::from_beams("x", beams.to_vec(), columns, ranges);
            built.unwrap_err().to_string()
        };
        let ranges = (0.5, 50.0);
        assert_eq!(build(&[], 10, ranges), "sensor x: 0 beams; 1 to 1024 are possible");
        assert!(build(&[1.0, 1.0], 10, ranges).contains("elevation 1 is 1 degrees"));
        for bad in [90.0, -90.0, f32::NAN, f32::INFINITY] {
            assert!(build(&[bad], 10, ranges).contains("elevation 0"), "{bad}");
        }
        assert!(build(&[0.0], 0, ranges).contains("0 columns"));
        assert!(build(&[0.0], u32::MAX, ranges).contains("columns"));
        for bad in [
            (50.0, 0.5),
            (-1.0, 5.0),
            (f32::NAN, 5.0),
            (0.0, f32::NAN),
            (0.0, f32::INFINITY),
        ] {
            assert!(build(&[0.0], 10, bad).contains("cannot measure"), "{bad:?}");
        }
    }
}
