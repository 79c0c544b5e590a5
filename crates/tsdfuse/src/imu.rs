//! What an inertial measurement unit measures.

use glam::{DQuat, DVec3};

/// Standard gravity, m/s².
pub const STANDARD_GRAVITY: f64 = 9.806_65;

/// One sample of an inertial measurement unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Nanoseconds since the log's epoch.
    pub time_ns: i64,
    /// Rates of turn about x, y, z, rad/s.
    pub angular_velocity: DVec3,
    /// Specific force along x, y, z, m/s²: at rest, gravity's 9.8 m/s² upwards.
    pub acceleration: DVec3,
    /// `world_from_imu`, where the unit estimates it.
    pub orientation: Option<DQuat>,
}
