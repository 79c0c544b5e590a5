//! Where a sweep is along a direction about which most of its returns tell nothing, as in a tunnel.
//!
//! Thousands of walls' normals, each a little wrong, would hold the sensor where it is. So only the few returns are asked that do tell: each
//! says how far it lies, along the direction, from a plane that faces it. The shift that most of them agree on is taken, and a Kalman filter of
//! position and velocity along the direction bridges the scans that tell nothing.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::cells::{Cells, Plane};
use crate::motion::Motion;
use crate::returns::{GRAIN, KERNEL, Return, kernel};

/// A direction is weak if the returns tell this many times less about it than about the next one, information.
const WEAK: f64 = 0.05;

/// Planes whose normals have less than this share along a weak direction tell nothing about it but their own error.
const LEAST_SHARE: f64 = 0.3;

/// Returns of planes that agree on a shift, beyond those that agree by chance, at least.
const LEAST_VOTES: f64 = 2.5;

/// The same where a single scan is in the cells, which has few planes that face a direction, and some that only seem to.
const LEAST_FIRST_VOTES: f64 = 30.0;

/// Error of planes that were made of few returns while the motion was not known well, metres.
const OWN_ERROR_M: f64 = 0.03;

/// Steps of the shifts that are looked at, metres.
const STEP: f64 = 0.01;

/// The direction of shifts that returns tell little about, if there is one. Planes whose normals hardly have a share along it tell
/// nothing.
pub(crate) fn weak_direction(cells: &Cells, returns: &[Return], motion: &Motion) -> Option<DVec3> {
    let placer = motion.placer();
    let planes = returns
        .iter()
        .filter_map(|r| cells.plane_at(placer.place(r.point, r.share)));
    let planes: Vec<(&Plane, f64)> = planes
        .map(|(plane, r, variance)| (plane, kernel(r, KERNEL * KERNEL * variance) / variance))
        .collect();
    let mut all = DMat3::ZERO;
    for (plane, weight) in &planes {
        let n = plane.normal;
        all += DMat3::from_cols(n * n.x, n * n.y, n * n.z) * *weight;
    }
    let eigen = tsdfuse::eigen::eigen(&all);
    let direction = eigen.vectors[0];
    let facing = planes.iter().filter(|(plane, _)| plane.faces(direction, LEAST_SHARE));
    let told: f64 = facing
        .map(|(plane, weight)| weight * plane.normal.dot(direction).powi(2))
        .sum();
    (told < WEAK * eigen.values[1]).then_some(direction)
}

/// How sure position and velocity along a direction are at the begin of a sweep: covariances, metres and metres a sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drift {
    position: f64,
    mixed: f64,
    velocity: f64,
}

impl Drift {
    /// Of standard deviations, metres and metres a sweep.
    pub(crate) fn new(position: f64, velocity: f64) -> Self {
        Self {
            position: position * position,
            mixed: 0.0,
            velocity: velocity * velocity,
        }
    }

    /// After a number of sweeps at the same velocity.
    fn after(&self, sweeps: f64) -> Self {
        Self {
            position: self.position + sweeps * (2.0 * self.mixed + sweeps * self.velocity),
            mixed: self.mixed + sweeps * self.velocity,
            velocity: self.velocity,
        }
    }

    /// At the end of the sweep.
    pub(crate) fn at_end(&self) -> Self {
        self.after(1.0)
    }

    /// At the begin of the next sweep, a time later (in sweeps) during which the velocity may have changed by `change` (metres a
    /// sweep, standard deviation).
    pub(crate) fn next(&self, gap: f64, change: f64) -> Self {
        let later = self.after(gap);
        Self {
            // A velocity that changes steadily over a sweep shifts it by half of the change.
            position: later.position,
            mixed: later.mixed + 0.5 * change * change,
            velocity: later.velocity + change * change,
        }
    }

    /// Takes in that the position at a share of the sweep is off by `shift`, with a variance; gives by how much position and velocity are
    /// off (Kalman, 1960).
    fn update(&mut self, share: f64, shift: f64, variance: f64) -> [f64; 2] {
        let by = [self.position + share * self.mixed, self.mixed + share * self.velocity];
        let total = by[0] + share * by[1] + variance;
        let gain = [by[0] / total, by[1] / total];
        *self = Self {
            position: self.position - gain[0] * by[0],
            mixed: self.mixed - gain[0] * by[1],
            velocity: self.velocity - gain[1] * by[1],
        };
        [gain[0] * shift, gain[1] * shift]
    }
}

/// What was found out about where a sweep is along a direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sought {
    /// The shifts at the begin and at the end of the sweep that suit the returns best.
    pub(crate) shift: [f64; 2],
    /// What the returns told.
    pub(crate) information: f64,
    /// How sure the motion is then.
    pub(crate) drift: Drift,
}

/// How far the sweep is off along a direction at a share of it, metres.
#[derive(Clone, Copy, Debug)]
struct Vote {
    shift: f64,
    sigma: f64,
    share: f64,
}

/// Where along a direction most returns that tell something about it put a sweep; `is_followed` says whether more than one scan is in the
/// cells.
pub(crate) fn sought_along(
    cells: &Cells,
    returns: &[Return],
    motion: &Motion,
    direction: DVec3,
    mut drift: Drift,
    is_followed: bool,
) -> Sought {
    let sigma = drift.after(0.5).position.sqrt();
    match voted(cells, returns, motion, direction, sigma, is_followed) {
        Some(vote) => {
            let [position, velocity] = drift.update(vote.share, vote.shift, vote.sigma.powi(2) + OWN_ERROR_M.powi(2));
            Sought {
                shift: [position, position + velocity],
                information: vote.sigma.powi(-2),
                drift,
            }
        }
        None => Sought {
            shift: [0.0; 2],
            information: 0.0,
            drift,
        },
    }
}

/// The shift that most returns agree on. `sigma` is how far the motion may be off.
fn voted(
    cells: &Cells,
    returns: &[Return],
    motion: &Motion,
    direction: DVec3,
    sigma: f64,
    is_followed: bool,
) -> Option<Vote> {
    let steps = ((3.0 * sigma).clamp(0.3, 2.0) / STEP) as i32;
    let placer = motion.placer();
    let parts = returns.par_chunks(GRAIN).map(|part| {
        let mut votes = Vec::new();
        for r in part {
            votes_of(
                cells,
                placer.place(r.point, r.share),
                r.share,
                direction,
                steps,
                &mut votes,
            );
        }
        votes
    });
    let votes = parts.collect::<Vec<_>>().concat();
    let shifts = (-steps..=steps).map(|step| STEP * f64::from(step));
    let supports: Vec<(f64, f64)> = shifts.map(|shift| (shift, support(&votes, shift))).collect();
    let usual = median(supports.iter().map(|(_, support)| *support).collect());
    let likely = |(shift, support): &(f64, f64)| 0.5 * support - 0.5 * (shift / sigma).powi(2);
    let &(best, most) = supports.iter().max_by(|a, b| likely(a).total_cmp(&likely(b)))?;
    let least = if is_followed { LEAST_VOTES } else { LEAST_FIRST_VOTES };
    if most - usual < least || most < 2.0 * usual {
        return None;
    }
    let (mut weights, mut shift, mut share) = (0.0, 0.0, 0.0);
    for vote in votes.iter().filter(|vote| (vote.shift - best).abs() < 2.5 * vote.sigma) {
        let weight = vote.sigma.powi(-2);
        weights += weight;
        shift += weight * vote.shift;
        share += weight * vote.share;
    }
    Some(Vote {
        shift: shift / weights,
        sigma: weights.powf(-0.5),
        share: share / weights,
    })
}

/// What the planes say that face the direction and lie along it from a return.
fn votes_of(cells: &Cells, x: DVec3, share: f32, direction: DVec3, steps: i32, votes: &mut Vec<Vote>) {
    let reach = STEP * f64::from(steps);
    let first = votes.len();
    cells.planes_along(x, direction, reach, |plane| {
        let shift = plane.distance_along(x, direction);
        let there = x + direction * shift;
        let is_known = || votes[first..].iter().any(|vote| (vote.shift - shift).abs() < 1e-9);
        if shift.abs() <= reach && plane.faces(direction, LEAST_SHARE) && plane.reaches(there) && !is_known() {
            let (_, variance) = plane.residual(there);
            votes.push(Vote {
                shift,
                sigma: variance.sqrt() / plane.normal.dot(direction).abs(),
                share: f64::from(share),
            });
        }
    });
}

/// How many votes of planes agree on a shift.
fn support(votes: &[Vote], shift: f64) -> f64 {
    votes
        .iter()
        .map(|vote| (-0.5 * ((vote.shift - shift) / vote.sigma).powi(2)).exp())
        .sum()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
