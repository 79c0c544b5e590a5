//! From where a map is looked at: poses of a camera, x forward, y left, z up.

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::render::{Renderer, flight, overview, turntable};
use tsdfuse::sensor::Pinhole;

use crate::movie::FRAMES_PER_SEC;

/// Speed of a flight, and how long it may take.
const SPEED_M_PER_SEC: f64 = 6.0;
const SHORTEST_SECS: f64 = 4.0;
const LONGEST_SECS: f64 = 120.0;

/// From where a map is looked at.
#[derive(Clone, Debug, PartialEq)]
pub enum Eye {
    /// From each of these poses, `world_from_camera`.
    At(Vec<Pose>),
    /// From as many places around all of it.
    Around(usize),
    /// From places along the sensor's path, as many as a movie of a flight has frames.
    Along,
    /// From where all of it is seen.
    Overview,
}

impl Eye {
    /// The poses, `world_from_camera`; `camera` is what must have the whole map in its image, `path` where the sensor was (world). None for
    /// a flight along a path that goes nowhere, and for a map without surface.
    pub fn poses(self, renderer: &Renderer, camera: &Pinhole, path: &[DVec3]) -> Vec<Pose> {
        match self {
            Self::At(poses) => poses,
            Self::Around(views) => turntable(renderer, camera, path, views),
            Self::Along => {
                let length_m: f64 = path.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
                let seconds = (length_m / SPEED_M_PER_SEC).clamp(SHORTEST_SECS, LONGEST_SECS);
                flight(path, (seconds * f64::from(FRAMES_PER_SEC)) as usize)
            }
            Self::Overview => overview(renderer, camera, path).into_iter().collect(),
        }
    }
}

/// The pose at `from` that looks at `to`, upright; `None` if both are the same place.
pub fn towards(from: DVec3, to: DVec3) -> Option<Pose> {
    let direction = (to - from).try_normalize()?;
    let (yaw, pitch) = (direction.y.atan2(direction.x), direction.z.clamp(-1.0, 1.0).asin());
    Some(Pose {
        rotation: rotation(yaw, pitch, 0.0),
        translation: from,
    })
}

/// Turned to the left by `yaw`, then up by `pitch`, then with the right side down by `roll`.
pub fn rotation(yaw_rad: f64, pitch_rad: f64, roll_rad: f64) -> DQuat {
    DQuat::from_rotation_z(yaw_rad) * DQuat::from_rotation_y(-pitch_rad) * DQuat::from_rotation_x(roll_rad)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_somewhere_is_upright() {
        for to in [
            DVec3::new(4.0, 5.0, -1.0),
            DVec3::new(1.0, 2.0, -10.0),
            DVec3::new(-7.0, 0.0, 3.0),
        ] {
            let from = DVec3::new(1.0, 2.0, 3.0);
            let pose = towards(from, to).unwrap();
            let ahead = pose.inverse().transform_point(to);
            assert!((ahead / from.distance(to)).distance(DVec3::X) < 1e-9, "{ahead}");
            assert!((pose.rotation * DVec3::Y).z.abs() < 1e-9);
        }
        assert_eq!(towards(DVec3::ONE, DVec3::ONE), None);
    }
}
