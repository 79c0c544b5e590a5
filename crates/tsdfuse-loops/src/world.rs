//! Where a trajectory's world is: positions that were measured in it, as by a GNSS receiver, and the direction of gravity.
//!
//! Nothing is moved by what agrees already. Where fixes or gravity contradict the trajectory, they join the graph, and odometry is taken to be as good
//! as they allow: of several shares of its stated drift the smallest one with which all agrees (Morozov's discrepancy principle). So fixes that are good to
//! metres straighten a trajectory that is off by more, and do not bend one that is known to centimetres.

use glam::{DQuat, DVec3};
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};
use tsdfuse::pose::Interpolation;
use tsdfuse::trajectory::secs_between;
use tsdfuse::{ImuSample, Pose, STANDARD_GRAVITY as GRAVITY};

use crate::graph::{DOUBTFUL, PoseGraph, Position, Upright};

/// Between two scans that are farther apart than this, nothing is known of the motion, seconds.
const LONGEST_GAP: f64 = 1.0;

/// Shares of odometry's stated drift that are tried, the smallest first.
pub(crate) const DRIFTS: [f64; 5] = [0.0625, 0.125, 0.25, 0.5, 1.0];

/// What is measured agrees with the trajectory if its mean squared error, in standard deviations, is at most so many times the expected one.
pub(crate) const AGREES: f64 = 1.2;

/// A bias is not larger than so many standard deviations: the trajectory is tilted.
const MOST_BIAS: f64 = 3.0;

/// The heading in the fixes' world must be known this well, radians: on a shorter way they tell nothing.
const LEAST_HEADING: f64 = 0.05;

/// How far from the vertical the trajectory's z axis may be, radians (standard deviation).
const TILTED: f64 = 0.1;

/// Fixes and directions of gravity that are needed at least.
const LEAST: usize = 5;

/// Standard deviations of a velocity that two poses tell, m/s, of an accelerometer's noise, and of its bias, m/s².
const VELOCITY: f64 = 0.03;
const FORCE: f64 = 0.02;
const FORCE_BIAS: f64 = 0.1;

/// Seconds over which a velocity is taken.
const VELOCITY_SECS: f64 = 0.4;

/// Specific force of a sensor that moves little is gravity within this share; otherwise its unit is not m/s², or it is not to be believed.
const FORCE_OFF: f64 = 0.1;

/// A place that was measured, as by a GNSS receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// Nanoseconds on the scans' clock.
    pub time_ns: i64,
    /// Where the antenna was, metres, in a world of the fixes' own whose z is up (such as east, north, up).
    pub place: DVec3,
    /// Standard deviations along the axes of that world, metres. Infinite along z if the height is not known.
    pub sigma_m: DVec3,
    /// Where the antenna sits, in the sensor frame, metres.
    pub antenna: DVec3,
}

/// What fixes and gravity told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Anchoring {
    /// Fixes that were compared with the trajectory.
    pub fixes: usize,
    /// Of these, those that disagree with the rest so that they hardly count.
    pub doubted_fixes: usize,
    /// Median distance of the fixes from the trajectory, metres, when it was only aligned to them.
    pub fixes_before_m: f64,
    /// And in the end.
    pub fixes_after_m: f64,
    /// `fixes_from_world`, if the fixes tell it.
    pub fixes_from_world: Option<Pose>,
    /// Stretches whose direction of gravity was compared with the trajectory.
    pub levels: usize,
    /// Median angle between both, radians, as loops left it.
    pub tilt_before_rad: f64,
    /// And in the end.
    pub tilt_after_rad: f64,
    /// With which share of the drift that was expected of odometry all agrees; `None` if nothing had to be moved.
    pub drift_share: Option<f64>,
}

/// A scan on the way.
#[derive(Clone, Copy)]
pub(crate) struct ScanAt {
    /// As odometry has it.
    pub(crate) pose: Pose,
    pub(crate) time_ns: Option<i64>,
    /// Metres from the first one, along the way.
    pub(crate) along: f64,
}

/// A fix, seen from a node.
struct Anchor {
    node: usize,
    /// The antenna in the frame of the node.
    at: DVec3,
    place: DVec3,
    sigma: DVec3,
    /// Fixes at this node, which count together as one: their errors have much in common.
    count: f64,
}

impl Anchor {
    /// 1 along the axes along which the place is known, 0 along z if the height is not.
    fn known(&self) -> DVec3 {
        DVec3::ONE.with_z(if self.sigma.z.is_finite() { 1.0 } else { 0.0 })
    }
}

/// The direction of gravity at a node.
struct Level {
    node: usize,
    /// Specific force in units of gravity, in the frame of the node.
    up: DVec3,
    sigma: f64,
}

/// What is known of the world beside what the scans tell.
#[derive(Default)]
pub(crate) struct Anchors {
    anchors: Vec<Anchor>,
    levels: Vec<Level>,
}

/// The trajectory as odometry has it: scans with times that ascend, and those of them that are nodes.
pub(crate) struct Way<'a> {
    pub(crate) scans: &'a [ScanAt],
    pub(crate) nodes: &'a [usize],
}

impl Way<'_> {
    /// The pose at a moment, and how far along the way that is.
    fn at(&self, time_ns: i64) -> Option<(Pose, f64)> {
        let after = self
            .scans
            .partition_point(|scan| scan.time_ns.is_some_and(|t| t <= time_ns));
        let (a, b) = (self.scans.get(after.checked_sub(1)?)?, self.scans.get(after));
        let (from, to) = (a.time_ns?, b.and_then(|b| b.time_ns));
        let Some((b, to)) = b.zip(to) else {
            return (from == time_ns).then_some((a.pose, a.along));
        };
        let gap = secs_between(from, to);
        if gap > LONGEST_GAP {
            return None;
        }
        let share = secs_between(from, time_ns) / gap;
        let pose = Interpolation::new(a.pose, b.pose).at(share);
        Some((pose, a.along + share * (b.along - a.along)))
    }

    /// The node that is nearest along the way.
    fn node(&self, along: f64) -> Option<usize> {
        let of = |node: usize| self.scans[self.nodes[node]].along;
        let after = self.nodes.partition_point(|&scan| self.scans[scan].along <= along);
        match (after.checked_sub(1), after < self.nodes.len()) {
            (Some(before), true) if along - of(before) <= of(after) - along => Some(before),
            (_, true) => Some(after),
            (before, false) => before,
        }
    }

    /// The velocity at a moment, m/s.
    fn velocity(&self, time_ns: i64) -> Option<DVec3> {
        let half = (0.5e9 * VELOCITY_SECS) as i64;
        let (from, to) = (self.at(time_ns - half)?.0, self.at(time_ns + half)?.0);
        Some((to.translation - from.translation) / VELOCITY_SECS)
    }
}

impl Anchors {
    /// Of fixes in the order of their times, and samples of an inertial measurement unit in the sensor frame. A scan's drift over a metre is given in metres.
    pub(crate) fn of(way: &Way<'_>, fixes: &[Fix], samples: &[ImuSample], drift_m: f64) -> Self {
        let is_timed = way
            .scans
            .windows(2)
            .all(|pair| matches!((pair[0].time_ns, pair[1].time_ns), (Some(a), Some(b)) if a < b));
        if !is_timed {
            return Self::default();
        }
        let mut counts = vec![0.0; way.nodes.len()];
        let mut anchors: Vec<Anchor> = Vec::new();
        for fix in fixes {
            let Some((pose, along)) = way.at(fix.time_ns) else {
                continue;
            };
            let Some(node) = way.node(along) else { continue };
            let scan = &way.scans[way.nodes[node]];
            let drift = drift_m * (along - scan.along).abs().sqrt();
            let sigma = DVec3::from_array(fix.sigma_m.to_array().map(|sigma| sigma.hypot(drift)));
            let is_known = fix.place.is_finite() && sigma.truncate().is_finite() && !sigma.z.is_nan();
            if !(is_known && fix.sigma_m.min_element() > 0.0) {
                continue;
            }
            counts[node] += 1.0;
            anchors.push(Anchor {
                node,
                at: (scan.pose.inverse() * pose).transform_point(fix.antenna),
                place: fix.place,
                sigma,
                count: 1.0,
            });
        }
        for anchor in &mut anchors {
            anchor.count = counts[anchor.node];
        }
        let mut levels: Vec<Level> = (0..way.nodes.len())
            .filter_map(|node| level(way, node, samples))
            .collect();
        let mut lengths: Vec<f64> = levels.iter().map(|level| level.up.length()).collect();
        if (median(&mut lengths) - 1.0).abs() > FORCE_OFF || levels.len() < LEAST {
            levels.clear();
        }
        if anchors.len() < LEAST {
            anchors.clear();
        }
        Self { anchors, levels }
    }

    /// Moves the graph's nodes to where fixes and gravity are believed, too; the first node keeps its place and heading. `None` if there is nothing to
    /// compare.
    pub(crate) fn apply(&self, graph: &mut PoseGraph) -> Option<Anchoring> {
        let first = *graph.nodes.first()?;
        let untouched = graph.nodes.clone();
        let before = State::of(self, &untouched, self.aligned(&untouched));
        let (fixes_before_m, tilt_before_rad) = before.medians();
        let mut found = Anchoring {
            fixes: before.fixes.len(),
            fixes_before_m,
            levels: before.levels.len(),
            tilt_before_rad,
            ..Anchoring::default()
        };
        if found.fixes + found.levels == 0 {
            return None;
        }
        // If odometry drifts as much as it may, what still disagrees is wrong.
        let widest = self.optimized(graph, before.world_from_fixes, 1.0);
        let after = State::of(self, &graph.nodes, widest);
        let believed = after
            .fixes
            .iter()
            .map(|off| off.squared <= DOUBTFUL)
            .collect::<Vec<_>>();
        found.doubted_fixes = believed.iter().filter(|is_believed| !**is_believed).count();
        let mut state = before;
        // Most of them must not be wrong: then it is not known who is.
        if 2 * found.doubted_fixes <= found.fixes {
            for share in DRIFTS {
                if state.agrees(&believed) {
                    break;
                }
                graph.nodes.clone_from(&untouched);
                let world_from_fixes = self.optimized(graph, state.world_from_fixes, share);
                state = State::of(self, &graph.nodes, world_from_fixes);
                found.drift_share = Some(share);
            }
        }
        (found.fixes_after_m, found.tilt_after_rad) = state.medians();
        let back = if found.drift_share.is_some() {
            heading_back(&first, &graph.nodes[0])
        } else {
            graph.nodes = untouched;
            Pose::IDENTITY
        };
        for node in &mut graph.nodes {
            *node = back * *node;
        }
        found.fixes_from_world = state.world_from_fixes.map(|pose| (back * pose).inverse());
        Some(found)
    }

    /// Solves the graph with fixes and gravity, where odometry drifts by a share of what is expected; where the fixes' world then is.
    fn optimized(&self, graph: &mut PoseGraph, placed: Option<Pose>, share: f64) -> Option<Pose> {
        let stated: Vec<Matrix6<f64>> = graph.edges.iter().map(|edge| edge.information).collect();
        for edge in graph.edges.iter_mut().filter(|edge| !edge.is_closure) {
            edge.information *= share.powi(-2);
        }
        let mut placed = placed;
        // The bias follows from the poses, and the poses from it; tilted poses would be taken for one.
        for bias_sigma in [0.0, FORCE_BIAS, FORCE_BIAS] {
            let (up, bias) = self.levelled(&graph.nodes, bias_sigma);
            let level = Pose {
                rotation: DQuat::from_rotation_arc(up.normalize(), DVec3::Z),
                translation: DVec3::ZERO,
            };
            for node in &mut graph.nodes {
                *node = level * *node;
            }
            placed = placed.and_then(|_| self.aligned(&graph.nodes));
            graph.uprights = self
                .levels
                .iter()
                .map(|level| Upright {
                    node: level.node,
                    up: (level.up - bias).normalize(),
                    sigma_rad: level.sigma,
                })
                .collect();
            graph.positions = placed.map_or(Vec::new(), |world_from_fixes| {
                let measured = |anchor: &Anchor| Position {
                    node: anchor.node,
                    at: anchor.at,
                    measured: world_from_fixes.transform_point(anchor.place),
                    sigma_m: horizontal(anchor.sigma),
                    weight: anchor.count.recip(),
                };
                self.anchors.iter().map(measured).collect()
            });
            graph.optimize();
        }
        graph.positions.clear();
        graph.uprights.clear();
        for (edge, stated) in graph.edges.iter_mut().zip(stated) {
            edge.information = stated;
        }
        placed
    }

    /// Where the fixes' world lies: a turn about the vertical and a shift by least squares that forgets what disagrees, then also a tilt.
    fn aligned(&self, nodes: &[Pose]) -> Option<Pose> {
        let pairs: Vec<(DVec3, DVec3, f64)> = self
            .anchors
            .iter()
            .map(|a| {
                let here = nodes[a.node].transform_point(a.at);
                (a.place, here, horizontal(a.sigma).x.powi(-2))
            })
            .collect();
        let known: Vec<DVec3> = self.anchors.iter().map(Anchor::known).collect();
        if pairs.is_empty() {
            return None;
        }
        let fitted = |weights: &[f64]| {
            let total: f64 = weights.iter().sum();
            let mean = |of: fn(&(DVec3, DVec3, f64)) -> DVec3| {
                let sum: DVec3 = pairs.iter().zip(weights).map(|(pair, w)| of(pair) * *w).sum();
                sum / total
            };
            let (there, here) = (mean(|pair| pair.0), mean(|pair| pair.1));
            let (mut along, mut across, mut spread) = (0.0, 0.0, 0.0);
            for (((a, b, _), w), anchor) in pairs.iter().zip(weights).zip(&self.anchors) {
                let (a, b) = ((*a - there).truncate(), (*b - here).truncate());
                along += w * a.dot(b);
                across += w * a.perp_dot(b);
                spread += w * b.length_squared() / anchor.count;
            }
            let rotation = DQuat::from_rotation_z(across.atan2(along));
            let translation = here - rotation * there;
            (Pose { rotation, translation }, spread.sqrt().recip())
        };
        let stated: Vec<f64> = pairs.iter().map(|pair| pair.2).collect();
        let (mut pose, _) = fitted(&stated);
        let squares = |pose: &Pose| -> Vec<f64> {
            let off = |a: &DVec3, b: &DVec3, known: &DVec3| (pose.transform_point(*a) - *b) * *known;
            let pairs = pairs.iter().zip(&known);
            pairs
                .map(|((a, b, w), known)| w * off(a, b, known).length_squared())
                .collect()
        };
        let mut width = squares(&pose).into_iter().fold(DOUBTFUL, f64::max);
        loop {
            let off = squares(&pose);
            let weights: Vec<f64> = off
                .iter()
                .zip(&stated)
                .map(|(r, w)| w * (width / (width + r)).powi(2))
                .collect();
            let (next, heading_sigma) = fitted(&weights);
            pose = next;
            let least = (4.0 * median(&mut squares(&pose))).max(DOUBTFUL);
            if width <= least {
                return (heading_sigma <= LEAST_HEADING).then(|| tilted(pose, &pairs, &weights, &known));
            }
            width = (0.5 * width).max(least);
        }
    }

    /// Which direction is up in the world, and the unit's bias in units of gravity: least squares over all levels, with a bias of this standard deviation,
    /// m/s². A node's frame is that of the sensor at its scan, so the bias is the same in all of them.
    fn levelled(&self, nodes: &[Pose], bias_sigma: f64) -> (DVec3, DVec3) {
        let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
        for level in &self.levels {
            let weight = level.sigma.powi(-2);
            let back = glam::DMat3::from_quat(nodes[level.node].rotation.conjugate());
            let mut j = nalgebra::Matrix3x6::zeros();
            for c in 0..3 {
                for r in 0..3 {
                    j[(r, c)] = back.col(c)[r];
                }
                j[(c, 3 + c)] = 1.0;
            }
            let up = nalgebra::Vector3::new(level.up.x, level.up.y, level.up.z);
            h += j.tr_mul(&j) * weight;
            g += j.tr_mul(&up) * weight;
        }
        for c in 3..6 {
            h[(c, c)] += (bias_sigma.max(1e-6) / GRAVITY).powi(-2);
        }
        let none = (DVec3::Z, DVec3::ZERO);
        if self.levels.is_empty() {
            return none;
        }
        h.cholesky().map_or(none, |h| {
            let x = h.solve(&g);
            (DVec3::new(x[0], x[1], x[2]), DVec3::new(x[3], x[4], x[5]))
        })
    }
}

/// How far something that was measured is off.
struct Off {
    /// Metres, or radians.
    by: f64,
    /// Squared, in standard deviations.
    squared: f64,
    /// In how many directions.
    directions: f64,
}

/// How fixes and gravity lie to a trajectory.
struct State {
    world_from_fixes: Option<Pose>,
    /// Empty where the fixes' world is not known.
    fixes: Vec<Off>,
    levels: Vec<Off>,
    /// The accelerometer's bias, in standard deviations.
    bias: f64,
}

impl State {
    fn of(anchors: &Anchors, nodes: &[Pose], world_from_fixes: Option<Pose>) -> Self {
        let off = |a: &Anchor, world_from_fixes: &Pose| {
            let off = (nodes[a.node].transform_point(a.at) - world_from_fixes.transform_point(a.place)) * a.known();
            Off {
                by: off.length(),
                squared: (off / horizontal(a.sigma)).length_squared(),
                directions: a.known().element_sum(),
            }
        };
        let fixes = world_from_fixes.iter();
        let fixes = fixes.flat_map(|pose| anchors.anchors.iter().map(move |anchor| off(anchor, pose)));
        let (up, bias) = anchors.levelled(nodes, FORCE_BIAS);
        let tilt = |level: &Level| {
            let by = (level.up - bias).angle_between(nodes[level.node].rotation.conjugate() * up);
            let squared = (by / level.sigma).powi(2);
            Off {
                by,
                squared,
                directions: 2.0,
            }
        };
        Self {
            world_from_fixes,
            fixes: fixes.collect(),
            levels: anchors.levels.iter().map(tilt).collect(),
            bias: bias.length() * GRAVITY / FORCE_BIAS,
        }
    }

    /// Whether all that is believed is as near as it should be.
    fn agrees(&self, believed: &[bool]) -> bool {
        let fixes = self.fixes.iter().zip(believed).filter(|(_, is_believed)| **is_believed);
        let is_near = |off: &mut dyn Iterator<Item = &Off>| {
            let (sum, expected) = off.fold((0.0, 0.0), |(sum, n), off| (sum + off.squared, n + off.directions));
            sum <= AGREES * expected
        };
        let is_tilted = !is_near(&mut self.levels.iter()) || self.bias > MOST_BIAS;
        !is_tilted && is_near(&mut fixes.map(|(off, _)| off))
    }

    /// Medians of the distances of fixes, metres, and of the angles to gravity, radians.
    fn medians(&self) -> (f64, f64) {
        let of = |off: &[Off]| median(&mut off.iter().map(|off| off.by).collect::<Vec<_>>());
        (of(&self.fixes), of(&self.levels))
    }
}

/// The larger one for both horizontal axes, since the fixes' world is turned about the vertical, and hardly tilted.
fn horizontal(sigma: DVec3) -> DVec3 {
    let flat = sigma.x.max(sigma.y);
    DVec3::new(flat, flat, sigma.z)
}

/// The pose that brings places (first) best to others (second), from one that is turned about the vertical alone. On a straight way nothing tells the tilt about it.
fn tilted(pose: Pose, pairs: &[(DVec3, DVec3, f64)], weights: &[f64], known: &[DVec3]) -> Pose {
    const PASSES: usize = 4;
    let mut pose = pose;
    let middle = pairs.iter().map(|pair| pair.1).sum::<DVec3>() / pairs.len().max(1) as f64;
    for _ in 0..PASSES {
        let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
        for (((there, here, _), weight), known) in pairs.iter().zip(weights).zip(known) {
            let (at, off) = (
                pose.transform_point(*there) - middle,
                pose.transform_point(*there) - *here,
            );
            // A turn about the middle, then a shift.
            let columns = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| axis.cross(at));
            for (row, axis) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
                let turns = columns.map(|column| column[row]);
                let j = Vector6::new(axis.x, axis.y, axis.z, turns[0], turns[1], turns[2]);
                let weight = weight * known[row];
                h += j * j.transpose() * weight;
                g -= j * (off[row] * weight);
            }
        }
        for turn in 3..5 {
            h[(turn, turn)] += TILTED.powi(-2);
        }
        let Some(h) = h.cholesky() else { return pose };
        let x = h.solve(&g);
        let turn = DQuat::from_scaled_axis(DVec3::new(x[3], x[4], x[5]));
        pose = Pose {
            rotation: (turn * pose.rotation).normalize(),
            translation: middle + turn * (pose.translation - middle) + DVec3::new(x[0], x[1], x[2]),
        };
    }
    pose
}

/// The motion of the world, about the vertical, that brings a pose to the place and heading that it had.
fn heading_back(before: &Pose, after: &Pose) -> Pose {
    let turned = before.rotation * after.rotation.conjugate();
    let rotation = DQuat::from_rotation_z(2.0 * turned.z.atan2(turned.w));
    Pose {
        rotation,
        translation: before.translation - rotation * after.translation,
    }
}

/// The direction of gravity over the stretch around a node: the mean specific force, less the change of the velocity.
fn level(way: &Way<'_>, node: usize, samples: &[ImuSample]) -> Option<Level> {
    let scan = |node: usize| &way.scans[way.nodes[node]];
    let frame = scan(node);
    let time = |neighbour: Option<usize>| neighbour.filter(|n| *n < way.nodes.len()).and_then(|n| scan(n).time_ns);
    let (from, to) = (time(node.checked_sub(1))?, time(Some(node + 1))?);
    let secs = secs_between(from, to);
    let first = samples.partition_point(|sample| sample.time_ns < from);
    let last = samples.partition_point(|sample| sample.time_ns <= to);
    let within = samples.get(first..last)?;
    let mut sum = DVec3::ZERO;
    for pair in within.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        let step = secs_between(a.time_ns, b.time_ns);
        if step > 0.1 {
            return None;
        }
        let turned = |sample: &ImuSample| Some(way.at(sample.time_ns)?.0.rotation * sample.acceleration);
        sum += 0.5 * step * (turned(a)? + turned(b)?);
    }
    let (begun, ended) = (within.first()?, within.last()?);
    let covered = secs_between(begun.time_ns, ended.time_ns);
    if covered < 0.9 * secs || covered <= 0.0 {
        return None;
    }
    let sped_up = way.velocity(ended.time_ns)? - way.velocity(begun.time_ns)?;
    let force = (sum - sped_up) / covered;
    Some(Level {
        node,
        up: frame.pose.rotation.conjugate() * force / GRAVITY,
        sigma: (std::f64::consts::SQRT_2 * VELOCITY / covered).hypot(FORCE) / GRAVITY,
    })
}

/// The median; 0 of nothing.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
