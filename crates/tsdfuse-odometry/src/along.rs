//! Where a sweep is along a direction about which most of its returns tell nothing, as in a tunnel.
//!
//! Thousands of walls' normals, each a little wrong, would hold the sensor where it is. So only the few returns are asked that stick out of the walls:
//! each says how far it lies, along the direction, from planes that face it, and from what stuck out in the last sweeps. The shift is taken that
//! explains them best, if it does so clearly better than any other one, and a Kalman filter of position and velocity along the direction bridges the
//! sweeps that tell nothing.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::cells::{Cells, Plane, elevation_bit};
use crate::motion::Motion;
use crate::returns::{KERNEL, Return, kernel};
use crate::sticking::{LEAST_SHARE, Remembered};

/// A direction is weak if the returns tell this many times less about it than about the next one, information.
const WEAK: f64 = 0.05;

/// Error of the shift that a return tells, metres: of its range, and of what it is compared with.
const VOTE_M: f64 = 0.03;

/// Error that all of a sweep's returns share, metres: what they are compared with was placed with the same error.
const SHARED_M: f64 = 0.03;

/// Votes for any shift by chance, of a return.
const CHANCE: f64 = 0.2;

/// The share of returns that count: neighbours see the same thing.
const INDEPENDENT: f64 = 0.5;

/// Each remembered sweep counts as one of so many: what sticks out is seen for some sweeps only.
const SEEN_SWEEPS: usize = 5;

/// Shifts that are farther from each other exclude each other, metres.
const RIVAL_M: f64 = 0.15;

/// How much likelier than all others a shift must be, natural logarithm.
const LEAST_MARGIN: f64 = 3.0;

/// How far shifts are looked for: at least and at most, metres.
const REACH_M: (f64, f64) = (0.3, 3.0);

/// The motion before is not trusted more than this, metres: standard deviation.
const LEAST_SIGMA_M: f64 = 0.1;

/// How far a sensor may move in a sweep when nothing is known of its velocity, metres: standard deviation.
pub(crate) const MOST_VELOCITY: f64 = 1.0;

/// If its velocity is known worse, metres a sweep, sweeps whose place is not told lie too far from each other to be compared with together.
const LEAST_KNOWN: f64 = 0.3;

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

    /// Positions count from the middle of this sweep on.
    pub(crate) fn anew(&self) -> Self {
        let velocity = self.velocity.min(MOST_VELOCITY * MOST_VELOCITY);
        Self {
            position: 0.25 * velocity,
            mixed: -0.5 * velocity,
            velocity,
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
#[derive(Clone, Debug)]
pub(crate) struct Sought {
    /// The shifts at the begin and at the end of the sweep that suit the returns best.
    pub(crate) shift: [f64; 2],
    /// What the returns told; 0 if they do not tell.
    pub(crate) information: f64,
    /// How sure the motion is then.
    pub(crate) drift: Drift,
    /// The returns that were asked.
    pub(crate) sticking: Vec<Return>,
}

impl Sought {
    /// Remembers a sweep that was placed.
    pub(crate) fn remember(&self, remembered: &mut Remembered, motion: &Motion) {
        if self.information == 0.0 && self.drift.velocity > LEAST_KNOWN * LEAST_KNOWN {
            remembered.forget();
        }
        remembered.add(&self.sticking, motion);
    }
}

/// How far the sweep is off along a direction at a share of it, metres.
#[derive(Clone, Copy, Debug)]
struct Vote {
    shift: f64,
    sigma: f64,
    share: f64,
}

/// Where along a direction the returns put a sweep that stick out; where nothing is `remembered`, the beams of returns mean nothing.
pub(crate) fn sought_along(
    cells: &Cells,
    remembered: Option<&Remembered>,
    sticking: Vec<Return>,
    motion: &Motion,
    direction: DVec3,
    mut drift: Drift,
) -> Sought {
    let sigma = drift.after(0.5).position.sqrt();
    match voted(cells, remembered, &sticking, motion, direction, sigma) {
        Some(vote) => {
            let variance = vote.sigma.powi(2) + SHARED_M.powi(2);
            let [position, velocity] = drift.update(vote.share, vote.shift, variance);
            Sought {
                shift: [position, position + velocity],
                information: variance.recip(),
                drift,
                sticking,
            }
        }
        None => Sought {
            shift: [0.0; 2],
            information: 0.0,
            drift: drift.anew(),
            sticking,
        },
    }
}

/// What a return that sticks out says.
struct Told {
    /// How far planes lie from it that face the direction, metres, and the standard deviation of that.
    planes: Vec<(f64, f64)>,
    /// How far remembered marks lie from it, by their number, metres.
    marks: Vec<(usize, f64)>,
}

/// How likely each shift up to a reach is, as a natural logarithm.
struct Likely {
    steps: i32,
    sums: Vec<f64>,
    votes: Vec<f64>,
}

impl Likely {
    fn new(reach: f64) -> Self {
        let steps = (reach / STEP) as i32;
        let size = 2 * steps as usize + 1;
        Self {
            steps,
            sums: vec![0.0; size],
            votes: vec![0.0; size],
        }
    }

    fn shift(&self, at: usize) -> f64 {
        STEP * (at as f64 - f64::from(self.steps))
    }

    /// Takes in a return for which some shifts (with standard deviation and weight) speak; `share` is how much it counts.
    fn add(&mut self, shifts: impl Iterator<Item = (f64, f64, f64)>, share: f64) {
        self.votes.fill(CHANCE);
        for (shift, sigma, weight) in shifts {
            let [from, to] = [-3.0, 3.0].map(|k| ((shift + k * sigma) / STEP).round() as i32 + self.steps);
            for at in from.max(0)..=to.min(2 * self.steps) {
                let off = STEP * f64::from(at - self.steps) - shift;
                self.votes[at as usize] += weight * (-0.5 * (off / sigma).powi(2)).exp();
            }
        }
        let mean = self.votes.iter().sum::<f64>() / self.votes.len() as f64;
        let sums = self.sums.iter_mut().zip(&self.votes);
        sums.for_each(|(sum, votes)| *sum += share * INDEPENDENT * (votes / mean).ln());
    }

    /// The shift that is clearly likelier than all others, `sigma` being how far the motion may be off.
    fn best(&self, sigma: f64) -> Option<f64> {
        let of = |at: usize| self.sums[at] - 0.5 * (self.shift(at) / sigma.max(LEAST_SIGMA_M)).powi(2);
        let best = (0..self.sums.len()).max_by(|&a, &b| of(a).total_cmp(&of(b)))?;
        let others = (0..self.sums.len()).filter(|&at| (self.shift(at) - self.shift(best)).abs() > RIVAL_M);
        let rival = others.map(of).fold(f64::NEG_INFINITY, f64::max);
        (of(best) - rival > LEAST_MARGIN).then(|| self.shift(best))
    }
}

/// The shift that explains what sticks out. `sigma` is how far the motion may be off.
fn voted(
    cells: &Cells,
    remembered: Option<&Remembered>,
    sticking: &[Return],
    motion: &Motion,
    direction: DVec3,
    sigma: f64,
) -> Option<Vote> {
    let (least, most) = REACH_M;
    let reach = (3.0 * sigma).clamp(least, most);
    let placer = motion.placer();
    let nothing = Remembered::default();
    let is_tracked = remembered.is_some();
    let remembered = remembered.unwrap_or(&nothing);
    let marks = remembered.along(direction);
    let told = sticking.par_iter().with_min_len(8).map(|r| {
        let x = placer.place(r.point, r.share);
        Told {
            planes: facing(cells, x, is_tracked.then(|| elevation_bit(r.point)), direction, reach),
            marks: marks.beside(x, r, reach),
        }
    });
    let told: Vec<Told> = told.collect();
    // What this sweep sees must have been there before, and what was there before must be seen: each counts a half.
    let weight = 1.0 / remembered.sweeps().clamp(1, SEEN_SWEEPS) as f64;
    let mut likely = Likely::new(reach);
    let mut seen: Vec<Vec<f64>> = vec![Vec::new(); marks.len()];
    for Told { planes, marks } in &told {
        let planes = planes.iter().map(|&(shift, sigma)| (shift, sigma, VOTE_M / sigma));
        likely.add(
            planes.chain(marks.iter().map(|&(_, shift)| (shift, VOTE_M, weight))),
            0.5,
        );
        marks.iter().for_each(|&(mark, shift)| seen[mark].push(shift));
    }
    for shifts in seen.iter().filter(|shifts| !shifts.is_empty()) {
        likely.add(shifts.iter().map(|&shift| (shift, VOTE_M, 1.0)), 0.5 * weight);
    }
    let best = likely.best(sigma)?;
    let (mut weights, mut shift, mut share, mut returns) = (0.0, 0.0, 0.0, 0.0);
    for (r, Told { planes, marks }) in sticking.iter().zip(&told) {
        let votes = planes
            .iter()
            .copied()
            .chain(marks.iter().map(|&(_, shift)| (shift, VOTE_M)));
        let near = votes.filter(|(shift, sigma)| (shift - best).abs() < 2.5 * sigma);
        let own: Vec<(f64, f64)> = near.map(|(shift, sigma)| (shift, sigma.powi(-2))).collect();
        let weight: f64 = own.iter().map(|(_, weight)| weight).sum();
        weights += weight;
        shift += own.iter().map(|(shift, weight)| shift * weight).sum::<f64>();
        share += weight * f64::from(r.share);
        returns += f64::from(u8::from(!own.is_empty()));
    }
    (returns > 0.0).then(|| Vote {
        shift: shift / weights,
        sigma: VOTE_M / returns.sqrt(),
        share: share / weights,
    })
}

/// How far planes lie from a point that face the direction, along it, and the standard deviation of that, metres. If the point's elevation is known (as
/// a bit), they must be wide, and planes without what was seen at it: a beam meets any surface at the same distance again and again.
fn facing(cells: &Cells, x: DVec3, elevation: Option<u64>, direction: DVec3, reach: f64) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    cells.planes_along(x, direction, reach, elevation.unwrap_or(0), |plane| {
        let shift = plane.distance_along(x, direction);
        let there = x + direction * shift;
        let tells =
            || plane.faces(direction, LEAST_SHARE) && (elevation.is_none() || plane.is_wide()) && plane.reaches(there);
        let is_known = || found.iter().any(|(known, _)| (known - shift).abs() < 1e-9);
        if shift.abs() <= reach && tells() && !is_known() {
            let (_, variance) = plane.residual(there);
            found.push((shift, variance.sqrt().max(VOTE_M) / plane.normal.dot(direction).abs()));
        }
    });
    found
}
