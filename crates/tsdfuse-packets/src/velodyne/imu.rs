//! The gyroscopes and accelerometers of an HDL-32E, in its packets of positions.
//!
//! On each of three sides of the base sits a gyroscope with two accelerometers across its axis (manual, appendix B). In the sensor frame (x where the
//! azimuth is 0, y to the left, z up), with A₂ᵧ the second accelerometer of the second side:
//!
//! | | x | y | z |
//! |---|---|---|---|
//! | rate of turn | G₁ | G₂ | G₃ |
//! | specific force | −(A₂ᵧ + A₃ᵧ) / 2 | (A₁ᵧ − A₃ₓ) / 2 | (A₁ₓ + A₂ₓ) / 2 |
//!
//! The manual draws the sides without words. These axes are those of two drivers that do not know of each other (ETH's `velodyne_ros` and Kaarta's), each
//! turned into this frame; all three sides are then alike, with gyroscopes that count clockwise.

use tsdfuse::glam::DVec3;
use tsdfuse::{ImuSample, STANDARD_GRAVITY};

use crate::bytes::u16_at;

/// Where the first side begins, and how long each is: rate, temperature, two accelerations.
const SIDES: usize = 14;
const SIDE: usize = 8;
/// What a count is: degrees per second, standard gravities.
const RATE: f64 = 0.097_66;
const FORCE: f64 = 0.001_221;

/// The sample in a packet of a position; `None` if there are zeros in its place, as in those of other sensors.
pub(super) fn sample(time_ns: i64, payload: &[u8]) -> Option<ImuSample> {
    let all = payload.get(SIDES..SIDES + 3 * SIDE)?;
    if all.iter().all(|&byte| byte == 0) {
        return None;
    }
    // The lower twelve bits, with a sign.
    let count = |at: usize| f64::from((u16_at(all, at) << 4) as i16 >> 4);
    let [g, x, y] = [0, 4, 6].map(|field| [0, 1, 2].map(|side| count(side * SIDE + field)));
    let force = DVec3::new(-(y[1] + y[2]), y[0] - x[2], x[0] + x[1]) / 2.0;
    Some(ImuSample {
        time_ns,
        angular_velocity: DVec3::from_array(g).map(f64::to_radians) * RATE,
        acceleration: force * FORCE * STANDARD_GRAVITY,
        orientation: None,
    })
}
