//! Refinement: scans whose poses are roughly known are registered to what the others saw.

use std::collections::VecDeque;

use glam::DVec3;
use nalgebra::{Matrix6, Vector6};
use tsdfuse::scan::PoseAt;
use tsdfuse::{Pose, Scan};

use crate::cells::Cells;
use crate::motion::{Motion, Twist, turn_of};
use crate::register::{Prior, register, six};
use crate::sample::{Sampled, Sampling};
use crate::systematic::{Calibrate, ErrorSums};
use crate::tracker::{LEAST_RETURNS, OdometryConfig, Quality};

/// Scans that wait at most until those after them were seen, too.
const MOST_AHEAD: usize = 100;

/// A scan whose pose was refined.
#[derive(Clone, Debug)]
pub struct Refined {
    /// `world_from_sensor` at the scan's own time.
    pub pose: Pose,
    /// The sensor's motion (see [`Scan::motion`]).
    pub motion: Vec<PoseAt>,
    /// How well it fits to the others.
    pub quality: Quality,
}

impl Refined {
    /// The same after a motion of the world.
    pub fn moved(&self, by: &Pose) -> Self {
        let motion = self.motion.iter().map(|at| PoseAt {
            pose: *by * at.pose,
            ..*at
        });
        Self {
            pose: *by * self.pose,
            motion: motion.collect(),
            quality: self.quality,
        }
    }

    /// Places the scan.
    pub fn place(&self, scan: &mut Scan) {
        scan.pose = Some(self.pose);
        scan.motion.clone_from(&self.motion);
    }
}

/// What given poses may be off, metres and radians.
const GIVEN: (f64, f64) = (0.1, 0.02);

/// The same for the motion of half a sweep.
const GIVEN_STEP: (f64, f64) = (0.03, 0.005);

/// A scan that was seen but is not registered.
#[derive(Clone, Debug)]
struct Waiting {
    sampled: Sampled,
    /// `None` for a scan without a pose.
    motion: Option<Motion>,
    /// How far the sensor had moved, metres.
    driven: f64,
}

/// The motion of the world that brings refined poses as near as possible to the given ones, by least squares of positions and rotations:
/// registration says nothing about where all scans together are.
///
/// `pairs` are (given, refined).
pub fn common_shift(pairs: &[(Pose, Pose)]) -> Pose {
    let mut shift = Pose::IDENTITY;
    let Some(&(origin, _)) = pairs.first() else {
        return shift;
    };
    let centre = origin.translation;
    for _ in 0..3 {
        let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
        for &(given, refined) in pairs {
            let refined = shift * refined;
            // The point moves by shift + turn × arm, the rotation by the turn.
            let arm = refined.translation - centre;
            let off = given.translation - refined.translation;
            let turned = turn_of(given.rotation * refined.rotation.conjugate());
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let by_point = six(axis, arm.cross(axis)) / GIVEN.0;
                h += by_point * by_point.transpose();
                g += by_point * (axis.dot(off) / GIVEN.0);
                let by_turn = six(DVec3::ZERO, axis) / GIVEN.1;
                h += by_turn * by_turn.transpose();
                g += by_turn * (axis.dot(turned) / GIVEN.1);
            }
        }
        let Some(x) = h.cholesky().map(|cholesky| cholesky.solve(&g)) else {
            break;
        };
        let twist = Twist {
            shift: DVec3::new(x[0], x[1], x[2]),
            turn: DVec3::new(x[3], x[4], x[5]),
        };
        shift = twist.apply(&shift, centre);
    }
    shift
}

/// Refines poses, one round: each scan is registered to what the scans before and after it saw. The result can be refined again.
///
/// Scans come out in order, each when the sensor has moved on by half of [`OdometryConfig::remember_m`], or 100 scans later.
///
/// ```no_run
/// use tsdfuse_odometry::{OdometryConfig, Refiner};
///
/// let mut refiner = Refiner::new(OdometryConfig::default(), 0.3);
/// let mut poses = Vec::new();
/// for scan in &tsdfuse_io::open("drive")? {
///     poses.extend(refiner.push(&scan?));
/// }
/// poses.extend(refiner.finish());
/// # Ok::<(), tsdfuse_io::Error>(())
/// ```
pub struct Refiner {
    config: OdometryConfig,
    reach_m: f64,
    sampling: Sampling,
    cells: Cells,
    errors: ErrorSums,
    waiting: VecDeque<Waiting>,
    here: Option<DVec3>,
    driven: f64,
    forgotten_at: f64,
}

impl Refiner {
    /// A refiner that has seen nothing. Surfaces are looked for as far as `reach_m` from where the poses put them.
    pub fn new(config: OdometryConfig, reach_m: f64) -> Self {
        Self {
            reach_m,
            config,
            sampling: Sampling::new(config.returns),
            // What was added must be taken away again, so cells take any number of points.
            cells: Cells::new(config.cell_m, config.noise_m, f64::INFINITY),
            errors: ErrorSums::default(),
            waiting: VecDeque::new(),
            here: None,
            driven: 0.0,
            forgotten_at: 0.0,
        }
    }

    /// Takes the next scan, without invalid returns, with its rough pose and motion; the scans that are registered come out. `None` comes out for
    /// a scan without a pose.
    pub fn push(&mut self, scan: &Scan) -> Vec<Option<Refined>> {
        let sampled = self.sampling.sample(scan);
        let motion = Motion::of_scan(scan, sampled.span);
        if let Some(motion) = &motion {
            let here = motion.last().translation;
            self.driven += self.here.map_or(0.0, |last| last.distance(here));
            self.here = Some(here);
            self.cells.add(&sampled.seen(motion), self.driven);
        }
        self.waiting.push_back(Waiting {
            sampled,
            motion,
            driven: self.driven,
        });
        let ahead = 0.5 * self.config.remember_m;
        let mut refined = Vec::new();
        while let Some(first) = self.waiting.front()
            && (self.driven - first.driven > ahead || self.waiting.len() > MOST_AHEAD)
        {
            refined.extend(self.next());
        }
        refined
    }

    /// What the scans so far say about systematic errors of the sensor.
    pub fn errors(&self) -> &ErrorSums {
        &self.errors
    }

    /// No more scans will come: the others come out.
    pub fn finish(&mut self) -> Vec<Option<Refined>> {
        std::iter::from_fn(|| self.next()).collect()
    }

    /// Registers the scan that waits longest to what the others saw.
    fn next(&mut self) -> Option<Option<Refined>> {
        let Waiting {
            sampled,
            motion,
            driven,
        } = self.waiting.pop_front()?;
        let Some(given) = motion else {
            self.errors.skip();
            return Some(None);
        };
        let (mut motion, mut quality, mut is_registered) = (given.clone(), Quality::default(), false);
        if sampled.sparse.len() >= LEAST_RETURNS {
            self.cells.remove(&sampled.seen(&given), driven);
            let (shift, turn) = GIVEN;
            let sigmas = [shift, shift, shift, turn, turn, turn];
            let prior = Prior {
                motion: given.clone(),
                begin: Matrix6::from_diagonal(&sigmas.map(|sigma: f64| sigma.powi(-2)).into()),
                step_sigma: GIVEN_STEP,
                most: GIVEN_STEP,
                remembered: None,
                along: None,
                reach: self.reach_m,
            };
            let registered = register(&self.cells, &sampled.sparse, &sampled.dense, &prior);
            quality = Quality::of(&registered);
            if !quality.is_unmatched() {
                motion = registered.motion;
                let of_beams = self.config.calibrate == Calibrate::Beams;
                self.errors.add(&self.cells, &sampled.sparse, &motion, of_beams);
                is_registered = true;
            }
            self.cells.add(&sampled.seen(&motion), driven);
        }
        if !is_registered {
            self.errors.skip();
        }
        if driven - self.forgotten_at > 0.05 * self.config.remember_m {
            let here = motion.last().translation;
            self.cells
                .forget(here, self.config.keep_m, driven - 0.5 * self.config.remember_m);
            self.forgotten_at = driven;
        }
        let (pose, motion) = motion.around_scan(sampled.span);
        Some(Some(Refined { pose, motion, quality }))
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    #[test]
    fn the_common_shift_is_found_at_any_distance_from_the_origin() {
        let by = Pose {
            rotation: DQuat::from_scaled_axis(DVec3::new(0.01, -0.02, 0.03)),
            translation: DVec3::new(0.2, -0.1, 0.05),
        };
        for far in [0.0, 500_000.0] {
            let refined = |i: usize| Pose {
                rotation: DQuat::from_rotation_z(0.05 * i as f64),
                translation: DVec3::new(far + i as f64, 0.1 * (i * i) as f64, 0.0),
            };
            let centre = Pose {
                translation: DVec3::X * far,
                ..Pose::IDENTITY
            };
            let by = centre * by * centre.inverse();
            let pairs: Vec<(Pose, Pose)> = (0..20).map(|i| (by * refined(i), refined(i))).collect();
            let found = common_shift(&pairs);
            for (given, refined) in pairs {
                assert!(
                    (found * refined).translation.distance(given.translation) < 1e-6,
                    "{far}"
                );
            }
        }
        assert_eq!(common_shift(&[]), Pose::IDENTITY);
    }
}
