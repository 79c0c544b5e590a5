//! One surfel from the points of a cell: principal component analysis (3.7)–(3.11).

use glam::{DMat3, DVec3, Vec3};

use super::config::SurfelConfig;
use crate::eigen::{Eigen, eigen};

/// A planar disc, in world axes relative to the sensor's position at the scan's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surfel {
    /// c, the mean of its points, metres.
    pub center: Vec3,
    /// n, a unit vector that faces the sensor.
    pub normal: Vec3,
    /// r, metres; 0 if all points are the same.
    pub radius_m: f32,
    /// ‖o − c‖, the distance from the sensor (from the mean of its positions as it measured the points), metres.
    pub distance_m: f32,
    /// The number of its points.
    pub points: u32,
}

/// The surfel of one or more points.
pub(super) fn surfel(
    points: &[Vec3],
    origins: Option<&[Vec3]>,
    members: impl Iterator<Item = usize> + Clone,
    up: Vec3,
    config: &SurfelConfig,
) -> Surfel {
    let (mut count, mut sum, mut sum_of_origins) = (0_u32, DVec3::ZERO, DVec3::ZERO);
    for i in members.clone() {
        count += 1;
        sum += points[i].as_dvec3();
        sum_of_origins += origins.map_or(DVec3::ZERO, |origins| origins[i].as_dvec3());
    }
    let share = 1.0 / f64::from(count);
    let (center, origin) = (sum * share, sum_of_origins * share); // (3.7)
    let mut covariance = DMat3::ZERO;
    for i in members {
        let z = points[i].as_dvec3() - center; // (3.8)
        covariance += DMat3::from_cols(z * z.x, z * z.y, z * z.z); // (3.10)
    }
    let Eigen { values, vectors } = eigen(&(covariance * share)); // (3.11)
    let from_sensor = center - origin;
    let mut normal = vectors[0];
    if normal.dot(from_sensor) > 0.0 {
        normal = -normal;
    }
    let up = up.as_dvec3();
    if config.ground_flip && from_sensor.dot(up) < 0.0 && normal.dot(up) < 0.0 {
        normal = -normal;
    }
    Surfel {
        center: center.as_vec3(),
        normal: normal.as_vec3(),
        radius_m: config.radius_sigmas * values[2].max(0.0).sqrt() as f32, // [E5]: the root of a variance is a length
        distance_m: from_sensor.length() as f32,
        points: count,
    }
}
