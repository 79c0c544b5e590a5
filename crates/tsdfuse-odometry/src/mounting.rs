//! Where the sensor sits on the body whose poses are given, and how far the clocks of both are apart, found from odometry.
//!
//! Poses P of odometry tell the sensor's own motion from one time to a later one. (Refined poses do not: errors that change slowly along the
//! drive stay in them.) Given poses G tell the same motion if the sensor sits at X on
//! their body and their clock is ahead by δ:
//!
//! ```text
//! P(s)⁻¹ P(t) = X⁻¹ G(s + δ)⁻¹ G(t + δ) X
//! ```
//!
//! This is hand-eye calibration (Tsai and Lenz 1989) with a time offset, solved by weighted least squares over motions of some metres. What the
//! motions do not determine (a vehicle on flat ground says nothing of the sensor's height) stays 0.

use glam::{DQuat, DVec3};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};
use tsdfuse::Pose;
use tsdfuse::trajectory::secs_between;

use crate::motion::turn_of;

/// Where a sensor is, seen from where its given poses put it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mounting {
    /// Along the axes of the sensor, metres.
    pub shift_m: DVec3,
    /// Rotation vector about the axes of the sensor, degrees.
    pub turn_deg: DVec3,
    /// Given poses belong to scans that were taken this much earlier, seconds: a scan at `t` has the given pose of `t + time_offset_s`.
    pub time_offset_s: f64,
}

impl Mounting {
    /// `given_from_sensor`.
    pub fn pose(&self) -> Pose {
        let turn = self.turn_deg * std::f64::consts::PI / 180.0;
        Pose {
            rotation: DQuat::from_scaled_axis(turn),
            translation: self.shift_m,
        }
    }

    /// The poses of the sensor, from those that were given for its scans, in order of time.
    pub fn mended(&self, given: &[(i64, Pose)]) -> Vec<Pose> {
        let mounted = self.pose();
        let mended = given.iter().enumerate().map(|(i, &(_, pose))| {
            let (from_ns, from) = given[i.saturating_sub(1)];
            let (to_ns, to) = given[(i + 1).min(given.len() - 1)];
            let secs = secs_between(from_ns, to_ns);
            let share = if secs > 0.0 { self.time_offset_s / secs } else { 0.0 };
            let later = Pose {
                rotation: pose.rotation
                    * DQuat::from_scaled_axis(turn_of(from.rotation.conjugate() * to.rotation) * share),
                translation: pose.translation + (to.translation - from.translation) * share,
            };
            later * mounted
        });
        mended.collect()
    }
}

/// Shift, turn (radians) and time offset.
type Unknowns = SVector<f64, 7>;

/// What is known of them before: standard deviations.
const PRIOR: [f64; 7] = [0.5, 0.5, 0.5, 0.1, 0.1, 0.1, 0.2];

/// What matters: 1 cm, 0.1°, 3 ms.
const LEAST: [f64; 7] = [0.01, 0.01, 0.01, 0.0017, 0.0017, 0.0017, 0.003];

/// Standard errors beyond which something is there beyond doubt.
const SURE: f64 = 5.0;

/// A motion ends when the sensor went this far, metres, or turned by this much, radians.
const MOTION: (f64, f64) = (5.0, 0.3);

/// The least standard deviation of the motions' differences, metres and radians.
const LEAST_SIGMA: (f64, f64) = (0.001, 0.0002);

/// Motions that tell something.
const LEAST_MOTIONS: usize = 20;

/// Differences of a motion beyond this many standard deviations count little (Cauchy).
const KERNEL: f64 = 2.5;

/// The steps by which derivatives are taken.
const STEP: [f64; 7] = [1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5, 1e-3];

/// Velocities are taken between scans at least this long before and after, seconds. (Poses between two noisy ones have less noise than these,
/// so that interpolating them would favour a time offset.)
const AROUND_SECS: f64 = 0.5;

/// A given pose, with its velocities.
struct Given {
    pose: Pose,
    /// In the world, metres a second.
    velocity: DVec3,
    /// About the axes of the body, radians a second.
    turning: DVec3,
}

impl Given {
    /// That of a scan; `None` near the ends.
    fn of(poses: &[(i64, Pose, Pose)], i: usize) -> Option<Self> {
        let (time_ns, pose, _) = poses[i];
        let is_apart = |&&(other, ..): &&(i64, Pose, Pose)| secs_between(time_ns, other).abs() >= AROUND_SECS;
        let &(from_ns, from, _) = poses[..i].iter().rev().find(is_apart)?;
        let &(to_ns, to, _) = poses[i..].iter().find(is_apart)?;
        let secs = secs_between(from_ns, to_ns);
        (secs <= 4.0 * AROUND_SECS).then(|| Self {
            pose,
            velocity: (to.translation - from.translation) / secs,
            turning: turn_of(from.rotation.conjugate() * to.rotation) / secs,
        })
    }

    /// The pose that much later.
    fn after(&self, secs: f64) -> Pose {
        Pose {
            rotation: self.pose.rotation * DQuat::from_scaled_axis(self.turning * secs),
            translation: self.pose.translation + self.velocity * secs,
        }
    }
}

/// From one scan to a later one.
struct Moved {
    given: [Given; 2],
    /// The tracked pose at the end seen from that at the begin.
    tracked: Pose,
}

/// Compares poses of a sensor by odometry with those that were given for the same scans: (time, given, tracked), in order of time. `None` if
/// nothing about them is wrong beyond doubt, and for drives that are too short to tell.
pub fn mounting(poses: &[(i64, Pose, Pose)]) -> Option<Mounting> {
    let (moved, overlap) = motions(poses);
    if moved.len() < LEAST_MOTIONS {
        return None;
    }
    // What is least certain is left out first, until all that is left is beyond doubt.
    let mut is_sought = [true; 7];
    loop {
        let (found, sigma) = solve(&moved, overlap, &is_sought)?;
        let doubt = |k: &usize| found[*k].abs() / (SURE * sigma[*k]).max(LEAST[*k]);
        let least = (0..7)
            .filter(|k| is_sought[*k])
            .min_by(|a, b| doubt(a).total_cmp(&doubt(b)))?;
        if doubt(&least) > 1.0 {
            return Some(Mounting {
                shift_m: DVec3::new(found[0], found[1], found[2]),
                turn_deg: DVec3::new(found[3], found[4], found[5]) * 180.0 / std::f64::consts::PI,
                time_offset_s: found[6],
            });
        }
        is_sought[least] = false;
    }
}

/// The motion from each scan on, and how many of them pass the same moment.
fn motions(poses: &[(i64, Pose, Pose)]) -> (Vec<Moved>, f64) {
    let (mut moved, mut scans) = (Vec::new(), 0);
    for (i, &(.., from)) in poses.iter().enumerate() {
        let ends = |(.., to): &(i64, Pose, Pose)| {
            from.translation.distance(to.translation) > MOTION.0 || from.rotation.angle_between(to.rotation) > MOTION.1
        };
        let Some(steps) = poses[i..].iter().position(ends) else {
            break;
        };
        if let (Some(begin), Some(end)) = (Given::of(poses, i), Given::of(poses, i + steps)) {
            scans += steps;
            let tracked = from.inverse() * poses[i + steps].2;
            moved.push(Moved {
                given: [begin, end],
                tracked,
            });
        }
    }
    let overlap = scans as f64 / moved.len().max(1) as f64;
    (moved, overlap)
}

/// By how much a motion differs from the given one: metres and radians, in the sensor frame at its end.
fn difference(moved: &Moved, unknowns: &Unknowns) -> [DVec3; 2] {
    let x = unknowns.as_slice();
    let mounted = Pose {
        translation: DVec3::from_slice(&x[..3]),
        rotation: DQuat::from_scaled_axis(DVec3::from_slice(&x[3..6])),
    };
    let [from, to] = moved.given.each_ref().map(|given| given.after(x[6]));
    let predicted = mounted.inverse() * from.inverse() * to * mounted;
    let off = moved.tracked.inverse() * predicted;
    [off.translation, turn_of(off.rotation)]
}

/// The unknowns that are sought, and the standard errors of all.
fn solve(moved: &[Moved], overlap: f64, is_sought: &[bool; 7]) -> Option<(Unknowns, Unknowns)> {
    let mut found = Unknowns::zeros();
    let mut sigma = Unknowns::zeros();
    for _ in 0..10 {
        let differences: Vec<_> = moved.iter().map(|moved| difference(moved, &found)).collect();
        let spread = |k: usize, least: f64| {
            let mut off: Vec<f64> = differences.iter().map(|d| d[k].length()).collect();
            off.sort_unstable_by(f64::total_cmp);
            // The median of the length of three normal numbers is 1.54 of their standard deviation.
            (off.get(off.len() / 2).copied().unwrap_or_default() / 1.54).max(least)
        };
        let sigmas = [spread(0, LEAST_SIGMA.0), spread(1, LEAST_SIGMA.1)];
        let mut h = SMatrix::<f64, 7, 7>::from_diagonal(&PRIOR.map(|sigma| sigma.powi(-2)).into());
        let mut g = -h * found;
        for (moved, r) in moved.iter().zip(&differences) {
            let derivative = |k: usize| {
                let at = |step: f64| {
                    let mut unknowns = found;
                    unknowns[k] += step;
                    difference(moved, &unknowns)
                };
                let (after, before) = (at(STEP[k]), at(-STEP[k]));
                [0, 1].map(|part| (after[part] - before[part]) / (2.0 * STEP[k]))
            };
            let j: [_; 7] = std::array::from_fn(derivative);
            for part in [0, 1] {
                let off = r[part].length() / sigmas[part];
                // Motions that overlap tell the same again.
                let weight = 1.0 / (1.0 + (off / KERNEL).powi(2)) / sigmas[part].powi(2) / overlap.max(1.0);
                for axis in 0..3 {
                    let j = Unknowns::from_fn(|k, _| j[k][part][axis]);
                    h += weight * j * j.transpose();
                    g -= weight * r[part][axis] * j;
                }
            }
        }
        for k in (0..7).filter(|k| !is_sought[*k]) {
            h.row_mut(k).fill(0.0);
            h.column_mut(k).fill(0.0);
            (h[(k, k)], g[k]) = (1.0, 0.0);
        }
        let solver = h.cholesky()?;
        let step = solver.solve(&g);
        found += step;
        sigma = solver.inverse().diagonal().map(f64::sqrt);
        if step.component_div(&Unknowns::from(LEAST)).amax() < 1e-3 {
            break;
        }
    }
    Some((found, sigma))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body that winds through hills at 10 scans a second.
    fn body(secs: f64) -> Pose {
        let heading = 0.8 * (0.4 * secs).sin();
        Pose {
            rotation: DQuat::from_rotation_z(heading)
                * DQuat::from_rotation_y(0.2 * (0.7 * secs).sin())
                * DQuat::from_rotation_x(0.2 * (0.9 * secs).cos()),
            translation: DVec3::new(
                6.0 * secs + (0.8 * secs).cos(),
                8.0 * (0.3 * secs).sin(),
                0.5 * secs.sin(),
            ),
        }
    }

    /// (time, given, tracked) of a sensor that sits otherwise than it is said.
    fn drive(truth: &Mounting, noise: f64) -> Vec<(i64, Pose, Pose)> {
        let at = |i: i64| {
            let secs = i as f64 * 0.1;
            let [a, b, c] = [1.7, 2.9, 3.1].map(|by| (by * (i * i) as f64).sin() * noise);
            let noise = Pose {
                rotation: DQuat::from_scaled_axis(DVec3::new(b, c, a) * 0.1),
                translation: DVec3::new(a, b, c),
            };
            (
                i * 100_000_000,
                body(secs) * noise,
                body(secs + truth.time_offset_s) * truth.pose(),
            )
        };
        (0..400).map(at).collect()
    }

    const TRUTH: Mounting = Mounting {
        shift_m: DVec3::new(0.12, -0.08, 0.05),
        turn_deg: DVec3::new(0.5, -0.8, 1.2),
        time_offset_s: 0.043,
    };

    #[test]
    fn a_sensor_that_sits_elsewhere_is_found() {
        let found = mounting(&drive(&TRUTH, 0.005)).unwrap();
        assert!(found.shift_m.distance(TRUTH.shift_m) < 0.015, "{found:?}");
        assert!(found.turn_deg.distance(TRUTH.turn_deg) < 0.05, "{found:?}");
        assert!((found.time_offset_s - TRUTH.time_offset_s).abs() < 0.002, "{found:?}");
        let drive = drive(&TRUTH, 0.0);
        let given: Vec<_> = drive.iter().map(|&(time_ns, given, _)| (time_ns, given)).collect();
        for (i, mended) in TRUTH.mended(&given).iter().enumerate().skip(1).take(drive.len() - 2) {
            assert!(mended.translation.distance(drive[i].2.translation) < 0.02, "{i}");
            assert!(mended.rotation.angle_between(drive[i].2.rotation) < 0.005, "{i}");
        }
    }

    #[test]
    fn a_clock_that_is_late_says_nothing_of_the_mounting() {
        let late = Mounting {
            time_offset_s: -0.03,
            ..Mounting::default()
        };
        let found = mounting(&drive(&late, 0.005)).unwrap();
        assert_eq!((found.shift_m, found.turn_deg), (DVec3::ZERO, DVec3::ZERO));
        assert!((found.time_offset_s + 0.03).abs() < 0.002, "{found:?}");
    }

    #[test]
    fn nothing_is_found_where_nothing_is_wrong_or_nothing_moves() {
        for noise in [0.0, 0.02, 0.1] {
            assert_eq!(mounting(&drive(&Mounting::default(), noise)), None, "{noise}");
        }
        let parked: Vec<_> = drive(&TRUTH, 0.02)
            .iter()
            .map(|&(t, ..)| (t, Pose::IDENTITY, TRUTH.pose()))
            .collect();
        assert_eq!(mounting(&parked), None);
        assert_eq!(mounting(&[]), None);
    }
}
