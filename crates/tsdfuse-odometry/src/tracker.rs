//! The tracker: scans go in as they were measured, and come out placed.

use std::collections::VecDeque;

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, Matrix6};
use serde::{Deserialize, Serialize};
use tsdfuse::trajectory::secs_between;
use tsdfuse::{ImuSample, Pose, Scan};

use crate::along::{Drift, MOST_VELOCITY, weak_direction};
use crate::cells::{Cells, Seen};
use crate::imu::{End, ImuReport, Inertial, PredictedBy, Prediction, Velocity};
use crate::locate::{Search, locate};
use crate::motion::{Motion, STEPS, ahead, repeated, turn_of};
use crate::register::{Prior, Registered, register};
use crate::sample::{Sampled, Sampling};
use crate::sticking::{Remembered, sticking_out};
use crate::systematic::Calibrate;

/// A scan with fewer returns, evenly spread, is not placed by them.
pub(crate) const LEAST_RETURNS: usize = 50;

/// A cell takes no more points than this: what was seen first, with the least drift, stays.
const MOST_POINTS: f64 = 4000.0;

/// Errors of accelerations and of changes of the rate of turn that are predicted from an inertial measurement unit, m/s² and rad/s².
const IMU_SIGMAS: (f64, f64) = (1.0, 0.3);

/// The gyroscope is believed from the beginning if it turns as registration says from the first scan to the second: up to so many radians, and a share
/// of the turn.
const TURNED: (f64, f64) = (0.005, 0.1);

/// With an inertial measurement unit the first scans wait so long, seconds: meanwhile gravity becomes known.
const LEVELLED_AFTER: f64 = 3.0;

/// A sensor is lost where less than this share of the returns that lie where something was seen lies on it, or where fewer returns lie there at all.
const LOST: (f64, f64) = (0.4, 0.15);

/// Scans after a loss that look for the way back, and that wait for it.
const LOOKED: usize = 20;

/// From one of them to the next.
const LOOK_EVERY: usize = 3;

/// A sweep begins where the last one ended, up to this, metres and radians, and up to a share of how far a sweep may differ from the prediction, since
/// motion is not quite linear between knots. A sweep that is bent wrongly ends elsewhere than the next one begins, so the less is allowed here, the
/// sooner sweeps bend as the sensor moved.
const JUMP: (f64, f64) = (0.0005, 0.0001);
const UNSTEADY: f64 = 0.005;

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
    /// Whether an inertial measurement unit is used, where the log has one.
    pub imu: bool,
    /// What refinement does about systematic errors of the sensor.
    pub calibrate: Calibrate,
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
            imu: true,
            calibrate: Calibrate::Auto,
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

/// The standard deviation of what is not known at all, metres.
const UNKNOWN_M: f64 = 1e6;

/// A scan of which a smaller share of the returns lies on what was seen before is unmatched.
const UNMATCHED: f64 = 0.5;

impl Quality {
    /// Of a scan whose pose is given.
    pub const GIVEN: Self = Self {
        covered: 1.0,
        matched: 1.0,
        rms_m: 0.0,
        position_sigma_m: 0.0,
        worst_direction: [0.0; 3],
        passes: 0,
    };

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
            position_sigma_m: eigen.values[0].max(UNKNOWN_M.powi(-2)).sqrt().recip(),
            worst_direction: eigen.vectors[0].to_array(),
            passes: registered.passes,
        }
    }

    /// The returns do not tell the position along [`Self::worst_direction`] after all.
    pub(crate) fn forget_position(&mut self) {
        self.position_sigma_m = self.position_sigma_m.max(UNKNOWN_M);
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
    /// The scan. Without a pose only if its place in a saved map was not found.
    pub scan: Scan,
    /// How well it was placed.
    pub quality: Quality,
    /// The piece of the trajectory that it belongs to: 0 until the sensor is lost and does not find back. Between pieces nothing was registered:
    /// a new one begins where the motion before leads.
    pub piece: usize,
}

impl Tracked {
    /// Moves the world.
    fn moved(&mut self, by: &Pose) {
        self.scan.pose = self.scan.pose.map(|pose| *by * pose);
        for at in &mut self.scan.motion {
            at.pose = *by * at.pose;
        }
        let worst = DVec3::from_array(self.quality.worst_direction);
        self.quality.worst_direction = (by.rotation * worst).to_array();
    }
}

/// A world that was seen before, in which the sensor looks for its place.
struct Elsewhere {
    cells: Cells,
    search: Search,
    /// Whether scans are placed nowhere else.
    is_needed: bool,
    /// Scans since the sensor was lost.
    scans: usize,
    /// The piece of the trajectory in it.
    piece: usize,
}

/// The first two scans.
struct Begun {
    /// Of the first one.
    motion: Motion,
    /// What it saw.
    cells: Cells,
    remembered: Remembered,
    second: Registered,
    /// Sensor at the end of a second from sensor at its begin.
    velocity: Pose,
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
    /// Of the sensor in the world, m/s.
    world_velocity: DVec3,
    /// How sure the motion is along a direction about which the returns of this sweep told nothing or little.
    along: Option<Drift>,
    /// How far the prediction was off lately: metres, radians, for a sweep.
    innovation: (f64, f64),
}

impl Last {
    fn end(&self) -> End {
        End {
            secs: self.end,
            pose: self.motion.last(),
            velocity: self.world_velocity,
        }
    }
}

/// Tracks one sensor.
///
/// The world is the frame of the sensor at the begin of its first scan; with an inertial measurement unit it is levelled: its z axis points
/// upwards. The first scan comes out after the second went in, which tells how fast the sensor moved; with a unit, those of the first three seconds
/// come out after it.
pub struct Tracker {
    config: OdometryConfig,
    sampling: Sampling,
    cells: Cells,
    remembered: Remembered,
    imu: Inertial,
    /// The world that scans come out in, from the one that they are tracked in; `None` until gravity is known.
    levelled: Option<DQuat>,
    elsewhere: Option<Elsewhere>,
    piece: usize,
    pieces: usize,
    /// Where the first scan is put: the sensor's pose at its begin.
    start: Pose,
    /// Poses a metre apart, as far as the cells go back.
    path: VecDeque<Pose>,
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
            remembered: Remembered::default(),
            imu: Inertial::new(),
            levelled: None,
            elsewhere: None,
            piece: 0,
            pieces: 1,
            start: Pose::IDENTITY,
            path: VecDeque::new(),
            first: None,
            last: None,
            ready: VecDeque::new(),
            forgotten_at: 0.0,
            here: DVec3::ZERO,
            driven: 0.0,
        }
    }

    /// A tracker in the world of a saved map, of whose surface points are given. It looks for the first scan's place in it; scans come out without
    /// a pose until one is found. The map is never forgotten.
    pub fn in_map(config: OdometryConfig, surface: impl IntoIterator<Item = DVec3>, search: Search) -> Self {
        let mut this = Self::new(config);
        let mut cells = Cells::new(config.cell_m, config.noise_m, MOST_POINTS);
        // A surface was seen by many beams.
        let seen = |at: DVec3| Seen {
            at,
            elevation: u64::MAX,
        };
        cells.add(&surface.into_iter().map(seen).collect::<Vec<_>>(), f64::INFINITY);
        this.elsewhere = Some(Elsewhere {
            cells,
            search,
            is_needed: true,
            scans: 0,
            piece: 0,
        });
        this.levelled = Some(DQuat::IDENTITY);
        this
    }

    /// Pieces of the trajectory so far that have nothing to do with each other: one if the sensor was never lost.
    pub fn pieces(&self) -> usize {
        self.pieces
    }

    /// Takes samples of an inertial measurement unit, in the frame of the sensor and in the order of their times. Those that were measured
    /// during a scan must come before it; all may come at once.
    pub fn push_imu(&mut self, samples: impl IntoIterator<Item = ImuSample>) {
        if self.config.imu {
            self.imu.push(samples);
        }
    }

    /// What was found out about the inertial measurement unit, if samples came.
    pub fn imu(&self) -> Option<ImuReport> {
        (!self.imu.is_empty()).then(|| self.imu.report())
    }

    /// Takes the next scan, without invalid returns; its own pose is not looked at.
    pub fn push(&mut self, scan: Scan) {
        let sampled = self.sampling.sample(&scan);
        if let (None, Some(time_ns)) = (&self.first, scan.time_ns) {
            let begin = secs_between(0, time_ns) + sampled.span.0;
            self.imu.forget(self.last.as_ref().map_or(begin, |last| last.end));
        }
        if sampled.sparse.len() < LEAST_RETURNS {
            return self.place_blind(scan, &sampled);
        }
        match (self.first.take(), self.last.is_some()) {
            (None, false) => self.first = Some((scan, sampled)),
            (Some(first), _) => self.begin(first, (scan, sampled)),
            (None, true) => self.track(scan, sampled),
        }
    }

    /// A scan with too few returns to be placed by them: the motion before goes on.
    fn place_blind(&mut self, scan: Scan, sampled: &Sampled) {
        if let Some((first, _)) = self.first.take() {
            // Nothing is known of its motion, and it must not come out later than this one.
            match &self.elsewhere {
                Some(Elsewhere { is_needed: true, .. }) => self.leave(first),
                _ => self.place(first, &Motion::still(self.start), (0.0, 0.0), Quality::default()),
            }
        }
        let motion = match &self.last {
            Some(last) => {
                let secs = sampled.span.1 - sampled.span.0;
                let gap = self.gap(last, &scan, sampled);
                let predictions = self.predict(last, gap, secs, scan.time_ns.is_some());
                let used = self.imu.choose(predictions.each_ref().map(Option::as_ref));
                let [steady, turned, forced] = predictions;
                let used = match used {
                    PredictedBy::Motion => steady,
                    PredictedBy::Gyroscope => turned,
                    PredictedBy::Imu => forced,
                };
                used.map_or_else(|| Motion::still(last.motion.last()), |predicted| predicted.motion)
            }
            None if self.elsewhere.as_ref().is_some_and(|elsewhere| elsewhere.is_needed) => return self.leave(scan),
            None => Motion::still(self.start),
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

    /// How the next sweep is predicted: by the motion before, by turns of the gyroscope, by all that the unit measures.
    fn predict(&self, last: &Last, gap: f64, secs: f64, is_timed: bool) -> [Option<Prediction>; 3] {
        let begin = last.motion.last() * repeated(&last.velocity, gap);
        let motion = moving(begin, &last.velocity, secs);
        let velocity = motion.last().rotation * ahead(&last.velocity);
        let by_imu = |course| {
            is_timed
                .then(|| self.imu.predict(&last.end(), gap, secs, course))
                .flatten()
        };
        [
            Some(Prediction { motion, velocity }),
            by_imu(Velocity::Kept),
            by_imu(Velocity::Forced),
        ]
    }

    /// The next scan that is placed.
    pub fn pop(&mut self) -> Option<Tracked> {
        let level = self
            .levelled
            .or_else(|| self.imu.is_empty().then_some(DQuat::IDENTITY))?;
        let is_open = self.elsewhere.as_ref().is_some_and(|elsewhere| !elsewhere.is_needed);
        if is_open && self.ready.front()?.piece == self.piece {
            return None;
        }
        let mut tracked = self.ready.pop_front()?;
        // Samples that come later do not turn the world any more.
        self.levelled = Some(level);
        if level != DQuat::IDENTITY {
            tracked.moved(&Pose {
                rotation: level,
                translation: DVec3::ZERO,
            });
        }
        Some(tracked)
    }

    /// Levels the world, if gravity is known.
    fn level(&mut self) {
        if self.levelled.is_none() {
            let turn = self.imu.up().map(|up| DQuat::from_rotation_arc(up, DVec3::Z));
            self.levelled = Some(turn.unwrap_or(DQuat::IDENTITY));
        }
    }

    /// No more scans will come: a single one comes out where it was measured.
    pub fn finish(&mut self) {
        if let Some((scan, _)) = self.first.take() {
            match &self.elsewhere {
                Some(Elsewhere { is_needed: true, .. }) => self.leave(scan),
                _ => self.place(scan, &Motion::still(self.start), (0.0, 0.0), Quality::default()),
            }
        }
        self.elsewhere = None;
        self.level();
    }

    /// Gives a scan back without a pose.
    fn leave(&mut self, scan: Scan) {
        self.ready.push_back(Tracked {
            scan: Scan {
                pose: None,
                motion: Vec::new(),
                ..scan
            },
            quality: Quality::default(),
            piece: self.piece,
        });
    }

    /// Looks for the sweep in the world that was seen before; what brings this one there.
    fn look(&mut self, sampled: &Sampled, motion: &Motion) -> Option<Pose> {
        let elsewhere = self.elsewhere.as_ref()?;
        let found = locate(
            &elsewhere.cells,
            &sampled.sparse,
            &sampled.dense,
            motion,
            &elsewhere.search,
        )?;
        Some(found.motion.first() * motion.first().inverse())
    }

    /// Goes on in the world that was seen before; the scans that wait come along.
    fn go_back(&mut self, by: &Pose) {
        let Some(elsewhere) = self.elsewhere.take() else { return };
        for tracked in self.ready.iter_mut().filter(|tracked| tracked.piece == self.piece) {
            tracked.moved(by);
            tracked.piece = elsewhere.piece;
        }
        if !elsewhere.is_needed {
            self.pieces -= 1;
        }
        (self.cells, self.piece) = (elsewhere.cells, elsewhere.piece);
        self.remembered.forget();
        self.imu.turn_world(by.rotation);
    }

    /// The sensor is lost: a new piece begins at a scan, where the motion before leads to.
    fn lose(&mut self, scan: Scan, sampled: Sampled, begin: Pose) {
        // Lost again before it found back: the world before the first loss is the one to look for.
        if self.elsewhere.is_none() {
            let cells = std::mem::replace(
                &mut self.cells,
                Cells::new(self.config.cell_m, self.config.noise_m, MOST_POINTS),
            );
            self.elsewhere = Some(Elsewhere {
                cells,
                search: Search {
                    near: vec![begin],
                    along: self.path.iter().copied().collect(),
                },
                is_needed: false,
                scans: 0,
                piece: self.piece,
            });
        }
        self.piece = self.pieces;
        self.pieces += 1;
        self.start = begin;
        self.first = Some((scan, sampled));
    }

    /// The first two scans: the motion between them is that within them, or what the gyroscope says, if that turns as much from one to the other. How the
    /// first sweep is bent matters long: later ones are bent to fit it, as long as they see the same surfaces at the same time of the sweep.
    fn begin(&mut self, first: (Scan, Sampled), second: (Scan, Sampled)) {
        let steady = self.begun(&first, &second, None);
        let Begun {
            motion,
            cells,
            remembered,
            second: registered,
            velocity,
        } = match self.turning(&first, &second, &steady) {
            Some(begin_secs) => self.begun(&first, &second, Some(begin_secs)),
            None => steady,
        };
        let quality = Quality::of(&registered);
        let (end, along) = (registered.end, registered.along);
        let mut motions = (motion, registered.motion);
        (self.cells, self.remembered) = (cells, remembered);
        if self.elsewhere.is_some() {
            match self.look(&second.1, &motions.1) {
                Some(by) => {
                    motions = (motions.0.moved(&by), motions.1.moved(&by));
                    self.go_back(&by);
                    self.cells.add(&first.1.seen(&motions.0), self.driven);
                }
                None if self.elsewhere.as_ref().is_some_and(|elsewhere| elsewhere.is_needed) => {
                    self.leave(first.0);
                    self.first = Some(second);
                    return;
                }
                None => {}
            }
        }
        self.here = motions.0.last().translation;
        self.place(first.0, &motions.0, first.1.span, Quality::default());
        self.see(&second.1, &motions.1);
        let along = along.map(|along| {
            along.remember(&mut self.remembered, &motions.1);
            along.drift.at_end()
        });
        self.last = Some(Last {
            end: end_secs(&second.0, &second.1),
            motion: motions.1.clone(),
            information: end,
            velocity,
            world_velocity: motions.1.last().rotation * ahead(&velocity),
            along,
            innovation: (0.05, 0.01),
        });
        self.place(second.0, &motions.1, second.1.span, quality);
    }

    /// When the first sweep begins, on the clock of the samples, if the gyroscope turns as registration says from one scan to the other.
    fn turning(&self, first: &(Scan, Sampled), second: &(Scan, Sampled), steady: &Begun) -> Option<f64> {
        let begin_secs = secs_between(0, first.0.time_ns?) + first.1.span.0;
        let from = End {
            secs: begin_secs,
            pose: Pose::IDENTITY,
            velocity: DVec3::ZERO,
        };
        let measured = self
            .imu
            .predict(&from, step_secs(first, second), 0.0, Velocity::Ahead)?
            .motion
            .first();
        let registered = turn_of(self.start.rotation.conjugate() * steady.second.motion.first().rotation);
        let is_right = (turn_of(measured.rotation) - registered).length() < TURNED.0 + TURNED.1 * registered.length();
        is_right.then_some(begin_secs)
    }

    /// How the first two scans lie to each other, if the sensor moves steadily, or, where its begin on the clock of the samples is given, turns as the
    /// gyroscope says.
    fn begun(&self, first: &(Scan, Sampled), second: &(Scan, Sampled), begin_secs: Option<f64>) -> Begun {
        const TURNS: i32 = 4;
        let gap = step_secs(first, second);
        let [first_secs, second_secs] = [first, second].map(|(_, sampled)| sampled.span.1 - sampled.span.0);
        let attempt = |velocity: Pose, turn: i32| {
            let turning = |gap, secs| {
                let from = End {
                    secs: begin_secs?,
                    pose: self.start,
                    velocity: self.start.rotation * ahead(&velocity),
                };
                Some(self.imu.predict(&from, gap, secs, Velocity::Ahead)?.motion)
            };
            let steady = |gap, secs| moving(self.start * repeated(&velocity, gap), &velocity, secs);
            let sweep = |gap, secs| turning(gap, secs).unwrap_or_else(|| steady(gap, secs));
            let motion = sweep(0.0, first_secs);
            let mut cells = Cells::new(self.config.cell_m, self.config.noise_m, MOST_POINTS);
            cells.add(&first.1.seen(&motion), self.driven);
            // A car's speed, and a fast turn.
            let loose = Matrix6::from_diagonal(&[1.0, 1.0, 1.0, 10.0, 10.0, 10.0].into());
            let mut remembered = Remembered::default();
            if let Some(direction) = weak_direction(&cells, &first.1.sparse, &motion) {
                remembered.add(&sticking_out(&cells, &first.1.dense, &motion, direction), &motion);
            }
            let narrower = 0.5_f64.powi(turn);
            let registered = register(
                &cells,
                &second.1.sparse,
                &second.1.dense,
                &Prior {
                    motion: sweep(gap, second_secs),
                    begin: loose,
                    step_sigma: (0.01 + 0.1 * narrower, 0.002 + 0.02 * narrower),
                    most: (0.05, 0.02),
                    remembered: Some(remembered.clone()),
                    along: Some(Drift::new(0.0, MOST_VELOCITY).anew().at_end()),
                    reach: if turn == 0 { 2.0 } else { 0.3 },
                },
            );
            Begun {
                motion,
                cells,
                remembered,
                velocity: repeated(&(self.start.inverse() * registered.motion.first()), 1.0 / gap),
                second: registered,
            }
        };
        (1..TURNS).fold(attempt(Pose::IDENTITY, 0), |begun, turn| attempt(begun.velocity, turn))
    }

    fn track(&mut self, scan: Scan, sampled: Sampled) {
        let Some(last) = self.last.take() else { return };
        let secs = sampled.span.1 - sampled.span.0;
        let begin_at = scan.time_ns.map(|t| secs_between(0, t) + sampled.span.0);
        let gap = self.gap(&last, &scan, &sampled);
        let predictions = self.predict(&last, gap, secs, begin_at.is_some());
        let ways = predictions.each_ref().map(Option::as_ref);
        let used = self.imu.choose(ways);
        let [Some(steady), ..] = ways else { return };
        // From rest to rest of the sweeps' begins.
        let step = (gap + secs).max(1e-3);
        // Without times any distance may lie between two scans.
        let usual = 0.5 * step * step * if begin_at.is_some() { 1.0 } else { 10.0 };
        let slack = if gap > 0.02 * step {
            (gap / step).min(1.0)
        } else {
            UNSTEADY
        };
        let prior_of = |predicted: &Prediction, used: PredictedBy| {
            let unforeseen = (self.config.acceleration, self.config.turn_acceleration);
            // Changes of the velocity and of the rate of turn, and how far a sweep is off at most at least.
            let (by_shift, by_turn, least) = match used {
                PredictedBy::Motion => (unforeseen.0, unforeseen.1, (0.02, 0.004)),
                PredictedBy::Gyroscope => (unforeseen.0, IMU_SIGMAS.1, (0.02, 0.001)),
                PredictedBy::Imu => (IMU_SIGMAS.0, IMU_SIGMAS.1, (0.003, 0.001)),
            };
            let own = (by_shift * usual, by_turn * usual);
            let most = (own.0.max(least.0), own.1.max(least.1));
            Prior {
                motion: predicted.motion.clone(),
                begin: spread(last.information, (JUMP.0 + slack * own.0, JUMP.1 + slack * own.1)),
                step_sigma: (
                    (2.0 * last.innovation.0).clamp(0.1 * own.0, most.0),
                    (2.0 * last.innovation.1).clamp(0.1 * own.1, most.1),
                ),
                most,
                remembered: Some(self.remembered.clone()),
                along: last.along.map(|drift| drift.next(gap / secs.max(0.01), 2.0 * own.0)),
                reach: (4.0 * last.innovation.0 + 20.0 * last.innovation.1).clamp(0.05, 1.0),
            }
        };
        let mut predicted = ways[used as usize].unwrap_or(steady);
        let mut prior = prior_of(predicted, used);
        let mut registered = register(&self.cells, &sampled.sparse, &sampled.dense, &prior);
        if registered.matched < 0.5 * registered.covered {
            // The unit may be wrong, too.
            let wide = Prior {
                reach: 2.0,
                ..prior_of(steady, PredictedBy::Motion)
            };
            let again = register(&self.cells, &sampled.sparse, &sampled.dense, &wide);
            if again.matched > registered.matched {
                (registered, prior, predicted) = (again, wide, steady);
            }
        }
        let (least, covered) = LOST;
        if registered.matched < least * registered.covered || registered.covered < covered {
            let begin = prior.motion.first();
            return self.lose(scan, sampled, begin);
        }
        let sampled = &sampled;
        let motion = registered.motion.clone();
        let off = prior.motion.last().inverse() * motion.last();
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
        // What registration moved, it moved faster than was predicted.
        let half = if secs > 0.0 { 0.5 * secs } else { gap.max(1e-3) };
        let moved_by = |motion: &Motion| {
            if secs > 0.0 {
                motion.last().translation - motion.knot(1, 3).translation
            } else {
                motion.last().translation
            }
        };
        let world_velocity = predicted.velocity + (moved_by(&motion) - moved_by(&predicted.motion)) / half;
        let end = End {
            secs: begin_at.unwrap_or(last.end + gap) + secs,
            pose: motion.last(),
            velocity: world_velocity,
        };
        if begin_at.is_some() {
            self.imu
                .learn(&last.end(), &end, secs, ways, used, registered.along.is_none());
        }
        let is_looking = self.elsewhere.as_mut().is_some_and(|elsewhere| {
            elsewhere.scans += 1;
            elsewhere.scans.is_multiple_of(LOOK_EVERY)
        });
        let back = is_looking.then(|| self.look(sampled, &motion)).flatten();
        let (motion, world_velocity) = match back {
            Some(by) => {
                self.go_back(&by);
                (motion.moved(&by), by.rotation * world_velocity)
            }
            None => (motion, world_velocity),
        };
        if self
            .elsewhere
            .as_ref()
            .is_some_and(|elsewhere| elsewhere.scans >= LOOKED)
        {
            self.elsewhere = None;
        }
        let quality = Quality::of(&registered);
        self.see(sampled, &motion);
        let along = registered.along.map(|along| {
            along.remember(&mut self.remembered, &motion);
            along.drift.at_end()
        });
        self.last = Some(Last {
            end: end.secs,
            world_velocity,
            information: registered.end,
            along,
            velocity,
            innovation: (
                calm(last.innovation.0, innovation.0),
                calm(last.innovation.1, innovation.1),
            ),
            motion: motion.clone(),
        });
        self.place(scan, &motion, sampled.span, quality);
    }

    /// Adds what a scan saw to the cells.
    fn see(&mut self, sampled: &Sampled, motion: &Motion) {
        self.driven += motion.last().translation.distance(self.here);
        self.here = motion.last().translation;
        let is_far = |last: &Pose| last.translation.distance(self.here) > 1.0;
        if self.path.back().is_none_or(is_far) {
            self.path.push_back(motion.last());
        }
        while self.path.len() as f64 > self.config.remember_m {
            self.path.pop_front();
        }
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
        let time_ns = scan.time_ns;
        self.ready.push_back(Tracked {
            scan,
            quality,
            piece: self.piece,
        });
        let first = self.ready.front().and_then(|tracked| tracked.scan.time_ns);
        let waited = first.zip(time_ns).map(|(first, last)| secs_between(first, last));
        if waited.is_none_or(|secs| secs >= LEVELLED_AFTER) {
            self.level();
        }
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

/// Information of which some standard deviations, metres and radians, were lost.
fn spread(information: Matrix6<f64>, (shift, turn): (f64, f64)) -> Matrix6<f64> {
    let added = Matrix6::from_diagonal(&[shift, shift, shift, turn, turn, turn].map(|s| s * s).into());
    let covariance = information.cholesky().map_or_else(Matrix6::identity, |c| c.inverse());
    (covariance + added)
        .cholesky()
        .map_or_else(Matrix6::identity, |c| c.inverse())
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
