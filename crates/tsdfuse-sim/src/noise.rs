//! The errors of a real sensor: what it adds to the true range, and what it does not see.

use serde::{Deserialize, Serialize};

/// Measurement errors. The default is a good sensor on a dry day; [`NoiseModel::none`] measures exactly.
///
/// Each effect draws its own random numbers: switching one off leaves the others as they were.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseModel {
    /// Standard deviation of each range, metres.
    pub range_sigma_m: f64,
    /// Standard deviation of the constant range error of each laser, metres.
    pub laser_bias_sigma_m: f64,
    /// Ranges are rounded to multiples of this, metres; 0: not rounded.
    pub range_step_m: f64,
    /// Standard deviation of a beam's true direction about the nominal one, in each of the two angles, radians.
    pub angle_sigma_rad: f64,
    /// Full opening angle of the beam, radians. Where it meets surfaces at several ranges, their echoes are averaged if they
    /// overlap in time, which leaves points in mid-air behind edges, and the strongest is reported if not. 0: a line.
    pub divergence_rad: f64,
    /// Probability that a return is lost for no reason.
    pub dropout: f64,
    /// Strength of the echo at which half of the returns are lost, as reflectivity × cos(incidence) × (longest range / range)².
    /// With 0.02 a sensor of 200 m, 1.9 m above a road, loses half of the asphalt about 90 m away. 0: none are lost.
    pub weak_echo: f64,
    /// Probability that dust or rain returns the beam somewhere before the surface.
    pub airborne: f64,
}

impl Default for NoiseModel {
    fn default() -> Self {
        Self {
            range_sigma_m: 0.02,
            dropout: 0.005,
            weak_echo: 0.02,
            ..Self::none()
        }
    }
}

impl NoiseModel {
    /// The perfect sensor.
    pub const fn none() -> Self {
        Self {
            range_sigma_m: 0.0,
            laser_bias_sigma_m: 0.0,
            range_step_m: 0.0,
            angle_sigma_rad: 0.0,
            divergence_rad: 0.0,
            dropout: 0.0,
            weak_echo: 0.0,
            airborne: 0.0,
        }
    }

    /// The range as a multiple of [`NoiseModel::range_step_m`].
    pub(crate) fn rounded(&self, range_m: f64) -> f64 {
        if self.range_step_m > 0.0 {
            (range_m / self.range_step_m).round() * self.range_step_m
        } else {
            range_m
        }
    }

    /// The name and value of the first number that is negative, not finite, or a probability above 1.
    pub(crate) fn first_invalid(&self) -> Option<(&'static str, f64)> {
        let lengths = [
            ("range_sigma_m", self.range_sigma_m),
            ("laser_bias_sigma_m", self.laser_bias_sigma_m),
            ("range_step_m", self.range_step_m),
            ("angle_sigma_rad", self.angle_sigma_rad),
            ("divergence_rad", self.divergence_rad),
            ("weak_echo", self.weak_echo),
        ];
        let probabilities = [("dropout", self.dropout), ("airborne", self.airborne)];
        let bad_length = lengths.into_iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0));
        bad_length.or_else(|| probabilities.into_iter().find(|(_, p)| !(0.0..=1.0).contains(p)))
    }
}
