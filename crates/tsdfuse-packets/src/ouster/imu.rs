//! Packets of the inertial measurement unit, in the two profiles that there are.

use tsdfuse::glam::{DMat3, DVec3};
use tsdfuse::{ImuSample, STANDARD_GRAVITY};

use crate::bytes::{f32_at, u8_at, u64_at};

/// Of the second profile: the header, then the time and text of a GNSS receiver.
const BEFORE: usize = 32 + 100;
const SAMPLE: usize = 36;
const FOOTER: usize = 32;

/// Which packets the sensor sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ImuProfile {
    /// `LEGACY`: one sample, in g and degrees a second.
    One,
    /// `ACCEL32_GYRO32_NMEA`: so many samples, in m/s² and rad/s, each with a time of its own.
    Many(usize),
    /// None, or one that is not known.
    None,
}

impl ImuProfile {
    /// More samples than a packet of any sensor has.
    const MOST: usize = 1024;

    /// That of the metadata; `samples` is how many a packet has, where they tell.
    pub(super) fn named(name: &str, samples: usize) -> Self {
        match name {
            "LEGACY" => Self::One,
            "ACCEL32_GYRO32_NMEA" if (1..=Self::MOST).contains(&samples) => Self::Many(samples),
            _ => Self::None,
        }
    }

    /// Whether a packet is of the unit.
    pub(super) fn fits(self, payload: &[u8]) -> bool {
        match self {
            Self::One => payload.len() == 48,
            Self::Many(samples) => payload.len() == BEFORE + samples * SAMPLE + FOOTER && u8_at(payload, 0) == 2,
            Self::None => false,
        }
    }

    /// The samples of a packet; none, if it is not of the unit.
    pub(super) fn samples(self, payload: &[u8], sensor_from_imu: &DMat3) -> Vec<ImuSample> {
        if !self.fits(payload) {
            return Vec::new();
        }
        let vector = |at: usize| DVec3::from_array([at, at + 4, at + 8].map(|at| f64::from(f32_at(payload, at))));
        let sample = |time: usize, acceleration: DVec3, rates: DVec3| ImuSample {
            time_ns: i64::try_from(u64_at(payload, time)).unwrap_or(i64::MAX),
            angular_velocity: *sensor_from_imu * rates,
            acceleration: *sensor_from_imu * acceleration,
            orientation: None,
        };
        let all: Vec<ImuSample> = match self {
            // The time of the gyroscope; accelerations are measured within half a millisecond.
            Self::One => vec![sample(
                16,
                vector(24) * STANDARD_GRAVITY,
                vector(36).map(f64::to_radians),
            )],
            Self::Many(samples) => (0..samples)
                .map(|i| BEFORE + i * SAMPLE)
                .filter(|at| u8_at(payload, at + 10) & 1 != 0)
                .map(|at| sample(at, vector(at + 12), vector(at + 24)))
                .collect(),
            Self::None => Vec::new(),
        };
        let is_real =
            |s: &ImuSample| s.time_ns < i64::MAX && s.angular_velocity.is_finite() && s.acceleration.is_finite();
        all.into_iter().filter(is_real).collect()
    }
}
