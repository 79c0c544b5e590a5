//! Poses made worse on purpose, to see what methods bear.

use serde::Serialize;
use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};

use crate::error::{Error, Result};

/// Errors of their own for all poses of a log, normally distributed: the same ones in each run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseNoise {
    /// Standard deviation along each axis of the world, metres.
    pub position_m: f64,
    /// Standard deviation about each axis of the sensor, degrees.
    pub turn_deg: f64,
}

impl PoseNoise {
    /// Of `M,DEG`.
    ///
    /// # Errors
    /// [`Error::Config`] if these are not two numbers from 0 on.
    pub fn parse(text: &str) -> Result<Self> {
        let wrong = || {
            Error::config(format_args!(
                "--pose-noise {text}: expected metres and degrees, as in 0.03,0.15"
            ))
        };
        let number = |text: &str| text.trim().parse().ok().filter(|n: &f64| n.is_finite() && *n >= 0.0);
        let (m, deg) = text.split_once(',').ok_or_else(wrong)?;
        Ok(Self {
            position_m: number(m).ok_or_else(wrong)?,
            turn_deg: number(deg).ok_or_else(wrong)?,
        })
    }

    /// The pose of scan `index` with its error.
    pub fn add(&self, index: usize, pose: Pose) -> Pose {
        let at = |k: u64| normal(8 * index as u64 + k);
        let moved = DVec3::new(at(0), at(1), at(2)) * self.position_m;
        let turned = DVec3::new(at(3), at(4), at(5)) * self.turn_deg.to_radians();
        Pose {
            rotation: (pose.rotation * DQuat::from_scaled_axis(turned)).normalize(),
            translation: pose.translation + moved,
        }
    }
}

/// A number of the normal distribution, by Box and Muller.
fn normal(n: u64) -> f64 {
    let (a, b) = (uniform(2 * n), uniform(2 * n + 1));
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// A number in [0, 1), by SplitMix64 (Steele, Lea and Flood 2014).
fn uniform(n: u64) -> f64 {
    let mut z = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_numbers_are_read() {
        let noise = PoseNoise::parse("0.03, 0.15").unwrap();
        assert_eq!((noise.position_m, noise.turn_deg), (0.03, 0.15));
        for bad in ["", "0.03", "0.03,", "a,b", "-1,0", "0,nan", "1,2,3"] {
            assert!(PoseNoise::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn errors_have_the_spread_that_is_asked_for() {
        let noise = PoseNoise::parse("0.03,0.15").unwrap();
        let from = Pose {
            translation: DVec3::new(5e5, -20.0, 3.0),
            rotation: DQuat::from_rotation_z(1.0),
        };
        let all = (0..3000).map(|index| noise.add(index, from));
        let [mut moved, mut turned] = [0.0; 2];
        for pose in all {
            moved += pose.translation.distance_squared(from.translation) / 9000.0;
            turned += (from.rotation.inverse() * pose.rotation)
                .to_scaled_axis()
                .length_squared()
                / 9000.0;
        }
        assert!((moved.sqrt() / 0.03 - 1.0).abs() < 0.05, "{moved}");
        assert!((turned.sqrt().to_degrees() / 0.15 - 1.0).abs() < 0.05, "{turned}");
        assert_eq!(noise.add(7, from), noise.add(7, from));
        assert_eq!(
            PoseNoise::parse("0,0").unwrap().add(7, from).translation,
            from.translation
        );
    }
}
