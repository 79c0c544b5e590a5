//! The tracker: scans go in as they were measured, and come out placed.

use std::collections::VecDeque;

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, Matrix6};
use serde::{Deserialize, Serialize};
use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Scan};

use crate::along::Drift;
use crate::cells::Cells;
use crate::motion::{Motion, STEPS, repeated, turn_of};
use crate::register::{Prediction, Registered, register};
use crate::sample::{Sampled, Sampling};

/// A scan with fewer returns, evenly spread, is not placed by them.
pub(crate) const LEAST_RETURNS: usize = 50;

/// A cell takes no more points than this: what was seen first, with the least drift, stays.
const MOST_POINTS: f64 = 4000.0;

/// How far a sensor may move in its first sweep along a direction that its returns do not tell, metres.
const FIRST_VELOCITY: f64 = 1.0;

/// Options of the odometry. The defaults suit all rotating LiDARs, indoors and outdoors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OdometryConfig {
    /// Edge of the smallest cells, metres.
    pub cell_m: f64,
    /// Standard deviation of a range, metres: what is assumed where a cell has few points.
    pub noise_m: f64,
    /// Returns of each scan that are registered.
    pub returns: usize,
    /// What was seen is forgotten farther away than this, metres.
    pub keep_m: f64,
    /// What was seen is forgotten when the sensor has moved on by this since, metres: later, drift would show it twice.
    pub remember_m: f64,
    /// Most acceleration that is expected, m/s²: how far a sweep may differ from the prediction.
    pub acceleration: f64,
    /// Most change of the rate of turn that is expected, rad/s².
    pub turn_acceleration: f64,
}

impl Default for OdometryConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.25,
            noise_m: 0.02,
            returns: 6000,
            keep_m: 150.0,
            remember_m: 60.0,
            acceleration: 6.0,
            turn_acceleration: 6.0,
        }
    }
}

/// How well a scan was placed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Share of the registered returns that lie where the scans before had seen a surface.
    pub covered: f64,
    /// Share of the registered returns that lie on it as well as noise allows.
    pub matched: f64,
    /// Root mean square of their distances, metres.
    pub rms_m: f64,
    /// Standard deviation of the position along its worst direction, from the returns alone, metres; 1e6 if they do not
    /// tell.
    pub position_sigma_m: f64,
    /// That direction, of length 1, in the world.
    pub worst_direction: [f64; 3],
    /// Passes of the solver.
    pub passes: usize,
}

/// A scan whose returns tell the position less well than this along some direction, metres, is undetermined.
const UNDETERMINED_M: f64 = 0.1;

/// A scan of which a smaller share of the returns lies on what was seen before is unmatched.
const UNMATCHED: f64 = 0.5;

impl Quality {
    pub(crate) fn of(registered: &Registered) -> Self {
        let rigid = &registered.rigid;
        let shifts = rigid.fixed_view::<3, 3>(0, 0).into_owned();
        let turns = rigid.fixed_view::<3, 3>(3, 3).into_owned();
        let mixed: Matrix3<f64> = rigid.fixed_view::<3, 3>(0, 3).into_owned();
        let left = match turns.try_inverse() {
            Some(inverse) => shifts - mixed * inverse * mixed.transpose(),
            None => Matrix3::zeros(),
        };
        let column = |c: usize| DVec3::new(left[(0, c)], left[(1, c)], left[(2, c)]);
        let eigen = tsdfuse::eigen::eigen(&DMat3::from_cols(column(0), column(1), column(2)));
        Self {
            covered: registered.covered,
            matched: registered.matched,
            rms_m: registered.rms,
            position_sigma_m: eigen.values[0].max(1e-12).sqrt().recip(),
            worst_direction: eigen.vectors[0].to_array(),
            passes: registered.passes,
        }
    }

    /// Whether the returns do not tell the position along [`Self::worst_direction`]: there, the motion before went on.
    pub fn is_undetermined(&self) -> bool {
        !(self.position_sigma_m <= UNDETERMINED_M)
    }

    /// Whether most returns do not lie on what was seen before: the trajectory may be broken here.
    pub fn is_unmatched(&self) -> bool {
        !(self.matched >= UNMATCHED)
    }
}

/// A scan that was placed: its `pose` and `motion` are set.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// The scan.
    pub scan: Scan,
    /// How well it was placed.
    pub quality: Quality,
}

/// The end of the last sweep.
#[derive(Clone, Debug)]
struct Last {
    /// Seconds on the scans' clock.
    end: f64,
    motion: Motion,
    information: Matrix6<f64>,
    /// Sensor at the end of a second from sensor at its begin.
    velocity: Pose,
    /// How sure the motion is along a direction about which the returns of this sweep told nothing or little.
    along: Option<Drift>,
    /// How far the prediction was off lately: metres, radians, for a sweep.
    innovation: (f64, f64),
}

/// Tracks one sensor.
///
/// The world is the frame of the sensor at the begin of its first scan. The first scan comes out after the second went in, which tells how
/// fast the sensor moved.
pub struct Tracker {
    config: OdometryConfig,
    sampling: Sampling,
    cells: Cells,
    first: Option<(Scan, Sampled)>,
    last: Option<Last>,
    ready: VecDeque<Tracked>,
    forgotten_at: f64,
    here: DVec3,
    driven: f64,
}

impl Tracker {
    /// A tracker that has seen nothing.
    pub fn new(config: OdometryConfig) -> Self {
        Self {
            config,
            sampling: Sampling::new(config.returns),
            cells: Cells::new(config.cell_m, config.noise_m, MOST_POINTS),
            first: None,
            last: None,
            ready: VecDeque::new(),
            forgotten_at: 0.0,
            here: DVec3::ZERO,
            driven: 0.0,
        }
    }

    /// Takes the next scan, without invalid returns; its own pose is not looked at.
    pub fn push(&mut self, scan: Scan) {
        let sampled = self.sampling.sample(&scan);
        if sampled.sparse.len() < LEAST_RETURNS {
            return self.place_blind(scan, &sampled);
        }
        match (self.first.take(), self.last.is_some()) {
            (None, false) => self.first = Some((scan, sampled)),
            (Some(first), _) => self.begin(first, (scan, sampled)),
            (None, true) => self.track(scan, &sampled),
        }
    }

    /// A scan with too few returns to be placed by them: the motion before goes on.
    fn place_blind(&mut self, scan: Scan, sampled: &Sampled) {
        if let Some((first, _)) = self.first.take() {
            // Nothing is known of its motion, and it must not come out later than this one.
            self.place(first, &Motion::still(Pose::IDENTITY), (0.0, 0.0), Quality::default());
        }
        let motion = match &self.last {
            Some(last) => {
                let secs = sampled.span.1 - sampled.span.0;
                let begin = last.motion.last() * repeated(&last.velocity, self.gap(last, &scan, sampled));
                moving(begin, &last.velocity, secs)
            }
            None => Motion::still(Pose::IDENTITY),
        };
        self.place(scan, &motion, sampled.span, Quality::default());
    }

    /// Seconds from the end of the last sweep to the begin of this one.
    fn gap(&self, last: &Last, scan: &Scan, sampled: &Sampled) -> f64 {
        let begin = scan.time_ns.map(|t| secs_between(0, t) + sampled.span.0);
        // Without times scans are taken to come ten a second.
        let usual = 0.1 - (sampled.span.1 - sampled.span.0).min(0.1);
        begin.map_or(usual, |begin| begin - last.end).clamp(0.0, 10.0)
    }

    /// The next scan that is placed.
    pub fn pop(&mut self) -> Option<Tracked> {
        self.ready.pop_front()
    }

    /// No more scans will come: a single one comes out where it was measured.
    pub fn finish(&mut self) {
        if let Some((scan, _)) = self.first.take() {
            self.place(scan, &Motion::still(Pose::IDENTITY), (0.0, 0.0), Quality::default());
        }
    }

    /// The first two scans: the motion between them is that within them. Found in turns.
    fn begin(&mut self, first: (Scan, Sampled), second: (Scan, Sampled)) {
        let mut velocity = Pose::IDENTITY;
        let gap = step_secs(&first, &second);
        let span = |sampled: &Sampled| sampled.span.1 - sampled.span.0;
        let mut motions = (Motion::still(Pose::IDENTITY), Motion::still(Pose::IDENTITY));
        let mut quality = Quality::default();
        let mut end = Matrix6::identity();
        let mut is_weak = false;
        const TURNS: usize = 4;
        for turn in 0..TURNS {
            let secs = span(&first.1);
            motions.0 = moving(Pose::IDENTITY, &velocity, secs);
            self.cells = Cells::new(self.config.cell_m, self.config.noise_m, MOST_POINTS);
            (self.here, self.driven) = (DVec3::ZERO, 0.0);
            self.see(&first.1, &motions.0);
            let begin = repeated(&velocity, gap);
            let reach = if turn == 0 { 2.0 } else { 0.3 };
            // A car's speed, and a fast turn.
            let loose = Matrix6::from_diagonal(&[1.0, 1.0, 1.0, 10.0, 10.0, 10.0].into());
            let registered = register(
                &self.cells,
                &second.1.sparse,
                &second.1.dense,
                &Prediction {
                    motion: moving(begin, &velocity, span(&second.1)),
                    begin: loose,
                    step_sigma: (
                        0.01 + 0.1 * 0.5_f64.powi(turn as i32),
                        0.002 + 0.02 * 0.5_f64.powi(turn as i32),
                    ),
                    most: (0.05, 0.02),
                    is_followed: false,
                    along: None,
                    reach,
                },
            );
            velocity = repeated(&registered.motion.first(), 1.0 / gap);
            quality = Quality::of(&registered);
            (motions.1, end, is_weak) = (registered.motion, registered.end, registered.along.is_some());
        }
        self.place(first.0, &motions.0, first.1.span, Quality::default());
        self.see(&second.1, &motions.1);
        self.last = Some(Last {
            end: end_secs(&second.0, &second.1),
            motion: motions.1.clone(),
            information: end,
            velocity,
            along: is_weak.then(|| Drift::new(0.01, FIRST_VELOCITY)),
            innovation: (0.05, 0.01),
        });
        self.place(second.0, &motions.1, second.1.span, quality);
    }

    fn track(&mut self, scan: Scan, sampled: &Sampled) {
        let Some(last) = self.last.take() else { return };
        let secs = sampled.span.1 - sampled.span.0;
        let begin_at = scan.time_ns.map(|t| secs_between(0, t) + sampled.span.0);
        let gap = self.gap(&last, &scan, sampled);
        let begin = last.motion.last() * repeated(&last.velocity, gap);
        // From rest to rest of the sweeps' begins.
        let step = (gap + secs).max(1e-3);
        let usual = 0.5 * step * step;
        // Without times any distance may lie between two scans.
        let usual = if begin_at.is_some() { usual } else { 10.0 * usual };
        let own = (self.config.acceleration * usual, self.config.turn_acceleration * usual);
        let expected = (
            (2.0 * last.innovation.0).clamp(0.1 * own.0, own.0.max(0.02)),
            (2.0 * last.innovation.1).clamp(0.1 * own.1, own.1.max(0.004)),
        );
        let spread = |information: Matrix6<f64>, (shift, turn): (f64, f64)| {
            let added = Matrix6::from_diagonal(&[shift, shift, shift, turn, turn, turn].map(|s| s * s).into());
            let covariance = information
                .cholesky()
                .map(|c| c.inverse())
                .unwrap_or_else(Matrix6::identity);
            (covariance + added)
                .cholesky()
                .map_or_else(Matrix6::identity, |c| c.inverse())
        };
        let slack = if gap > 0.02 * step { (gap / step).min(1.0) } else { 0.02 };
        let information = spread(last.information, (0.002 + slack * own.0, 0.0005 + slack * own.1));
        let prediction = Prediction {
            motion: moving(begin, &last.velocity, secs),
            begin: information,
            step_sigma: expected,
            most: (own.0.max(0.02), own.1.max(0.004)),
            is_followed: true,
            along: last.along.map(|drift| drift.next(gap / secs.max(0.01), 2.0 * own.0)),
            reach: (4.0 * last.innovation.0 + 20.0 * last.innovation.1).clamp(0.05, 1.0),
        };
        let mut registered = register(&self.cells, &sampled.sparse, &sampled.dense, &prediction);
        if registered.matched < 0.5 * registered.covered {
            let wide = Prediction {
                reach: 2.0,
                ..prediction.clone()
            };
            let again = register(&self.cells, &sampled.sparse, &sampled.dense, &wide);
            if again.matched > registered.matched {
                registered = again;
            }
        }
        let motion = registered.motion.clone();
        let off = prediction.motion.last().inverse() * motion.last();
        let innovation = (off.translation.length(), turn_of(off.rotation).length());
        let calm = |old: f64, new: f64| {
            if new > old {
                0.5 * old + 0.5 * new
            } else {
                0.9 * old + 0.1 * new
            }
        };
        let moved = last.motion.last().inverse() * motion.last();
        let velocity = if secs > 0.0 {
            repeated(&(motion.knot(1, 3).inverse() * motion.last()), 2.0 / secs)
        } else {
            repeated(&moved, 1.0 / gap.max(1e-3))
        };
        self.see(sampled, &motion);
        self.last = Some(Last {
            end: begin_at.unwrap_or(last.end + gap) + secs,
            information: registered.end,
            along: registered.along,
            velocity,
            innovation: (
                calm(last.innovation.0, innovation.0),
                calm(last.innovation.1, innovation.1),
            ),
            motion: motion.clone(),
        });
        let quality = Quality::of(&registered);
        self.place(scan, &motion, sampled.span, quality);
    }

    /// Adds what a scan saw to the cells.
    fn see(&mut self, sampled: &Sampled, motion: &Motion) {
        self.driven += motion.last().translation.distance(self.here);
        self.here = motion.last().translation;
        self.cells.add(&sampled.seen(motion), self.driven);
        let here = motion.last().translation;
        if self.driven - self.forgotten_at > 0.05 * self.config.remember_m {
            self.cells
                .forget(here, self.config.keep_m, self.driven - self.config.remember_m);
            self.forgotten_at = self.driven;
        }
    }

    /// Sets pose and motion of a scan whose returns span the motion.
    fn place(&mut self, mut scan: Scan, motion: &Motion, span: (f64, f64), quality: Quality) {
        let (pose, motion) = motion.around_scan(span);
        (scan.pose, scan.motion) = (Some(pose), motion);
        self.ready.push_back(Tracked { scan, quality });
    }

    /// Cells that are remembered, of all sizes.
    pub fn cells(&self) -> usize {
        self.cells.len()
    }
}

/// The motion of a sweep at a velocity (sensor at the end of a second from sensor at its begin).
fn moving(begin: Pose, velocity: &Pose, secs: f64) -> Motion {
    if secs > 0.0 {
        Motion::steady(begin, &repeated(velocity, secs))
    } else {
        Motion::still(begin)
    }
}

fn step_secs(first: &(Scan, Sampled), second: &(Scan, Sampled)) -> f64 {
    let begin = |(scan, sampled): &(Scan, Sampled)| Some(secs_between(0, scan.time_ns?) + sampled.span.0);
    match (begin(first), begin(second)) {
        (Some(a), Some(b)) if b - a > 1e-3 && b - a < 10.0 => b - a,
        _ => 0.1,
    }
}

fn end_secs(scan: &Scan, sampled: &Sampled) -> f64 {
    scan.time_ns.map_or(0.0, |t| secs_between(0, t)) + sampled.span.1
}

const _: () = assert!(STEPS.is_multiple_of(2));
