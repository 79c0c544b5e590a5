//! Closing the loops of one trajectory.

use std::collections::BTreeSet;

use glam::{DMat3, DVec3};
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};
use tsdfuse::pose::Interpolation;
use tsdfuse::{ImuSample, Pose, Scan};
use tsdfuse_odometry::Quality;

use crate::graph::{DOUBTFUL, Edge, PoseGraph, between, compounded};
use crate::local_map::Gathered;
use crate::places::{Found, Places};
use crate::world::{AGREES, Anchoring, Anchors, DRIFTS, Fix, ScanAt, Way};

/// Options of loop closure. The defaults suit all rotating LiDARs, indoors and outdoors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LoopConfig {
    /// What odometry is off after a metre, metres (standard deviation); grows with the root of the way.
    pub drift_m: f64,
    /// The same of its rotation, radians.
    pub drift_rad: f64,
    /// A place counts as seen before if the sensor moved by this much since, metres.
    pub gap_m: f64,
    /// Whether positions of a GNSS receiver are used, where the log has some.
    pub gnss: bool,
    /// Whether the direction of gravity is used, where the log has an inertial measurement unit.
    pub gravity: bool,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self {
            drift_m: 0.01,
            drift_rad: 1e-3,
            gap_m: 30.0,
            gnss: true,
            gravity: true,
        }
    }
}

/// A stretch of the way makes a local map: so many times as long as the sensor sees, at least and at most so many metres.
const STRETCH: (f64, f64, f64) = (1.5, 3.0, 20.0);

/// A scan goes into a local map if the sensor moved by this share of how far it sees, or turned by so many radians, since the last one.
const NEWS: (f64, f64) = (0.02, 0.1);

/// Scans in a local map at most.
const MOST_SCANS: usize = 150;

/// Where a scan's returns do not tell, its motion along that direction may be off by this share of it.
const BLIND: f64 = 0.3;

/// Up to this standard deviation of the expected position a place is looked for where it is expected, metres.
const NEAR_M: f64 = 0.6;

/// Where a place is known better than this before a closure, metres (standard deviation), the newest local map alone is moved at first.
const SETTLED_M: f64 = 0.1;

/// All local maps are moved again at the latest when there are so many times as many.
const GROWN: f64 = 1.05;

/// Places that are verified for each local map.
const TRIED: usize = 3;

/// A place that was seen before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Closure {
    /// The earlier scan, by its number among those that were pushed: the one in whose frame the earlier local map is.
    pub earlier: usize,
    /// The same of the later local map.
    pub later: usize,
    /// `earlier_from_later`.
    pub pose: Pose,
    /// How far the later scan was from there before, metres.
    pub off_m: f64,
    /// The same, in standard deviations of what odometry and registration may be off.
    pub off_sigma: f64,
    /// Root mean square of the distances between both surfaces where it was expected, metres, as far as they are nearer than 1.5 m.
    pub rms_before_m: f64,
    /// And as registered.
    pub rms_m: f64,
    /// Share of points near the surfaces of the other local map.
    pub common: f64,
    /// Share of these that lie on them.
    pub matched: f64,
    /// Whether it disagrees with the rest so that it hardly counts.
    pub is_doubted: bool,
}

/// A stretch of the way with its local map.
#[derive(Clone, Copy)]
struct Stretch {
    /// The scan whose pose is the frame.
    scan: usize,
    /// Length, metres.
    length: f64,
}

/// Closes the loops of a trajectory: placed scans go in one after the other, and their poses come out corrected.
///
/// Each stretch of the way becomes a local map. When it is complete, it is looked for among the earlier ones that lie within reach of odometry's
/// uncertainty, and what is verified by registration becomes an edge of a pose graph ([`PoseGraph`]).
///
/// ```no_run
/// use tsdfuse_loops::{Closer, LoopConfig};
/// use tsdfuse_odometry::{OdometryConfig, Tracker};
///
/// let mut tracker = Tracker::new(OdometryConfig::default());
/// let mut closer = Closer::new(LoopConfig::default());
/// for scan in &tsdfuse_io::open("drive")? {
///     tracker.push(scan?);
///     while let Some(tracked) = tracker.pop() {
///         closer.push(&tracked.scan, &tracked.quality);
///     }
/// }
/// closer.finish();
/// let poses: Vec<_> = (0..closer.len()).map(|scan| closer.pose(scan)).collect();
/// # Ok::<(), tsdfuse_io::Error>(())
/// ```
pub struct Closer {
    config: LoopConfig,
    scans: Vec<ScanAt>,
    /// What the stretch that is under way saw.
    gathered: Gathered,
    gathered_scans: usize,
    /// Of the last scan that was gathered.
    last_news: Option<Pose>,
    /// The first scan of the stretch that is under way.
    begin: usize,
    stretches: Vec<Stretch>,
    places: Places,
    graph: PoseGraph,
    closures: Vec<Closure>,
    /// The edge of each closure.
    edges: Vec<usize>,
    /// Blind motion since the frame of the last stretch, in the world.
    blind: Vec<(usize, DVec3)>,
    distrusted: usize,
    /// Local maps when all of them were moved last.
    optimized_nodes: usize,
    fixes: Vec<Fix>,
    samples: Vec<ImuSample>,
    anchoring: Option<Anchoring>,
}

impl Closer {
    /// Nothing is known yet.
    pub fn new(config: LoopConfig) -> Self {
        Self {
            config,
            scans: Vec::new(),
            gathered: Gathered::default(),
            gathered_scans: 0,
            last_news: None,
            begin: 0,
            stretches: Vec::new(),
            places: Places::default(),
            graph: PoseGraph::default(),
            closures: Vec::new(),
            edges: Vec::new(),
            blind: Vec::new(),
            distrusted: 0,
            optimized_nodes: 0,
            fixes: Vec::new(),
            samples: Vec::new(),
            anchoring: None,
        }
    }

    /// Takes positions that were measured, in the order of their times. They correct the trajectory when all scans came ([`Self::finish`]).
    pub fn push_fixes(&mut self, fixes: impl IntoIterator<Item = Fix>) {
        if self.config.gnss {
            self.fixes.extend(fixes);
        }
    }

    /// Takes samples of an inertial measurement unit, in the frame of the sensor and in the order of their times. They tell the direction of gravity when
    /// all scans came ([`Self::finish`]).
    pub fn push_imu(&mut self, samples: impl IntoIterator<Item = ImuSample>) {
        if self.config.gravity {
            self.samples.extend(samples);
        }
    }

    /// Takes the next scan, placed by odometry; how many closures it led to. Poses are the best ones after [`Self::finish`]: a closure that moves
    /// little moves the latest scans alone until then.
    pub fn push(&mut self, scan: &Scan, quality: &Quality) -> usize {
        let pose = scan
            .pose
            .unwrap_or_else(|| self.scans.last().map_or(Pose::IDENTITY, |last| last.pose));
        let step = self
            .scans
            .last()
            .map_or(DVec3::ZERO, |last| pose.translation - last.pose.translation);
        let along = self.scans.last().map_or(0.0, |last| last.along) + step.length();
        let number = self.scans.len();
        let time_ns = scan.time_ns;
        self.scans.push(ScanAt { pose, time_ns, along });
        if number > 0 && quality.is_unmatched() {
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                self.blind.push((number, axis * (BLIND * step.length())));
            }
        } else if number > 0 && quality.is_undetermined() {
            let direction = DVec3::from_array(quality.worst_direction);
            self.blind.push((number, direction * (BLIND * step.length())));
        }
        let range = self.gathered.range_m();
        let is_news = self.last_news.is_none_or(|last| {
            last.translation.distance(pose.translation) > NEWS.0 * range
                || last.rotation.angle_between(pose.rotation) > NEWS.1
        });
        if is_news && self.gathered_scans < MOST_SCANS {
            self.gathered.add(scan);
            self.gathered_scans += 1;
            self.last_news = Some(pose);
        }
        let (times, least, most) = STRETCH;
        let length = (times * self.gathered.range_m()).clamp(least, most);
        if along - self.scans[self.begin].along >= length {
            return self.complete();
        }
        0
    }

    /// No more scans will come; how many closures the last stretch led to. What fixes and gravity tell moves the trajectory now.
    pub fn finish(&mut self) -> usize {
        let closed = if self.begin < self.scans.len() {
            self.complete()
        } else {
            0
        };
        self.weigh();
        let nodes: Vec<usize> = self.graph_scans().collect();
        let way = Way {
            scans: &self.scans,
            nodes: &nodes,
        };
        let anchors = Anchors::of(&way, &self.fixes, &self.samples, self.config.drift_m);
        self.anchoring = anchors.apply(&mut self.graph);
        closed
    }

    /// The stretch under way is complete: it becomes a local map, which is looked for among the earlier ones.
    fn complete(&mut self) -> usize {
        let last = self.scans.len() - 1;
        let (from, to) = (self.scans[self.begin].along, self.scans[last].along);
        let middle = 0.5 * (from + to);
        let scan = (self.begin..=last)
            .find(|&scan| self.scans[scan].along >= middle)
            .unwrap_or(last);
        let frame = self.scans[scan].pose;
        let map = self.gathered.take(&frame);
        self.gathered_scans = 0;
        self.begin = last + 1;
        let node = match self.stretches.last() {
            Some(&before) => {
                let measured = self.scans[before.scan].pose.inverse() * frame;
                let node = self.graph.nodes.len();
                let information = self.drift(before.scan, scan).try_inverse();
                self.graph.edges.push(Edge {
                    from: node - 1,
                    to: node,
                    measured,
                    information: information.unwrap_or_else(Matrix6::identity),
                    is_closure: false,
                });
                self.graph.nodes[node - 1] * measured
            }
            None => frame,
        };
        self.graph.nodes.push(node);
        self.stretches.push(Stretch {
            scan,
            length: to - from,
        });
        self.places.add(map);
        self.close()
    }

    /// What odometry may be off from one scan to a later one, in the frame of that.
    fn drift(&mut self, from: usize, to: usize) -> Matrix6<f64> {
        let way = (self.scans[to].along - self.scans[from].along).max(0.1);
        let (shift, turn) = (self.config.drift_m.powi(2) * way, self.config.drift_rad.powi(2) * way);
        let mut covariance = Matrix6::from_diagonal(&[shift, shift, shift, turn, turn, turn].into());
        let back = DMat3::from_quat(self.scans[to].pose.rotation).transpose();
        self.blind.retain(|&(number, step)| {
            if number > to {
                return true;
            }
            let s = back * step;
            for row in 0..3 {
                for col in 0..3 {
                    covariance[(row, col)] += s[row] * s[col];
                }
            }
            false
        });
        covariance
    }

    /// Looks for the newest local map among the earlier ones.
    fn close(&mut self) -> usize {
        let newest = self.stretches.len() - 1;
        let own = self.stretches[newest];
        let here = self.graph.nodes[newest];
        let mut candidates = Vec::new();
        let uncertainty = self.graph.uncertainty_from(newest);
        for (place, stretch) in self.stretches.iter().enumerate() {
            if self.scans[own.scan].along - self.scans[stretch.scan].along < self.config.gap_m {
                break;
            }
            let Some(covariance) = uncertainty[place] else { continue };
            let expected = self.graph.nodes[place].inverse() * here;
            // Of this local map, seen from that one.
            let covariance = compounded(&covariance, &expected, &Matrix6::zeros());
            let sigma = covariance
                .fixed_view::<3, 3>(0, 0)
                .symmetric_eigenvalues()
                .max()
                .max(0.0)
                .sqrt();
            let distance = expected.translation.length();
            if distance < stretch.length.max(own.length) + 3.0 * sigma {
                candidates.push((distance, place, expected, covariance, sigma));
            }
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some(&(.., sigma)) = candidates.first() else {
            return 0;
        };
        let Some(view) = self.places.map(newest).cloned() else {
            return 0;
        };
        let mut found: Vec<Found> = Vec::new();
        if sigma <= NEAR_M {
            let tried = candidates.iter().take(TRIED);
            found.extend(tried.filter_map(|(_, place, expected, ..)| self.places.verify(&view, *place, expected)));
        } else {
            found = self.places.find(&view, candidates.iter().map(|candidate| candidate.1));
        }
        // A place that was found twice, from two guesses, says it once.
        let mut places = BTreeSet::new();
        found.retain(|found| !found.is_weak && places.insert(found.place));
        let mut closed = 0;
        for found in found {
            let Some((_, place, expected, covariance, _)) = candidates.iter().find(|c| c.1 == found.place) else {
                continue;
            };
            let off = between(expected, &found.pose);
            let Some(information) = (covariance + found.covariance).try_inverse() else {
                continue;
            };
            let squared = off.dot(&(information * off));
            let Some(information) = found.covariance.try_inverse() else {
                continue;
            };
            // What disagrees with odometry by more than that may be off is another place that looks alike.
            if !(squared <= DOUBTFUL) {
                self.distrusted += 1;
                continue;
            }
            self.edges.push(self.graph.edges.len());
            self.graph.edges.push(Edge {
                from: *place,
                to: newest,
                measured: found.pose,
                information,
                is_closure: true,
            });
            self.closures.push(Closure {
                earlier: self.stretches[*place].scan,
                later: own.scan,
                pose: found.pose,
                off_m: expected.translation.distance(found.pose.translation),
                off_sigma: squared.sqrt(),
                rms_before_m: found.rms_before_m,
                rms_m: found.rms_m,
                common: found.common,
                matched: found.matched,
                is_doubted: false,
            });
            closed += 1;
        }
        if closed > 0 {
            // All of it would cost more and more, on a way that leads through the same places again and again.
            let has_grown = self.graph.nodes.len() as f64 > GROWN * self.optimized_nodes as f64;
            if sigma > SETTLED_M || has_grown {
                self.optimize();
            } else {
                self.graph.settle_last();
            }
        }
        closed
    }

    /// Moves all local maps; the sum of squared errors that is left, in standard deviations.
    fn optimize(&mut self) -> f64 {
        let cost = self.graph.optimize().cost;
        self.optimized_nodes = self.graph.nodes.len();
        for (closure, &edge) in self.closures.iter_mut().zip(&self.edges) {
            closure.is_doubted = self.graph.edges[edge].squared_error(&self.graph.nodes) > DOUBTFUL;
        }
        cost
    }

    /// Moves all local maps with the smallest share of odometry's stated drift with which the closures agree: they must not bend a trajectory that is
    /// known better than they are.
    fn weigh(&mut self) {
        if self.edges.is_empty() {
            return;
        }
        let stated: Vec<Edge> = self.graph.edges.clone();
        let freedoms = 6.0 * self.edges.len() as f64;
        for share in DRIFTS {
            for (edge, stated) in self.graph.edges.iter_mut().zip(&stated) {
                if !edge.is_closure {
                    edge.information = stated.information * share.powi(-2);
                }
            }
            if self.optimize() <= AGREES * freedoms {
                break;
            }
        }
        self.graph.edges = stated;
    }

    /// How many scans were pushed.
    pub fn len(&self) -> usize {
        self.scans.len()
    }

    /// Whether none was.
    pub fn is_empty(&self) -> bool {
        self.scans.is_empty()
    }

    /// The places that were recognised.
    pub fn closures(&self) -> &[Closure] {
        &self.closures
    }

    /// Places that registration took for the same, which odometry says they cannot be.
    pub fn distrusted(&self) -> usize {
        self.distrusted
    }

    /// What fixes and gravity told, after [`Self::finish`].
    pub fn anchoring(&self) -> Option<&Anchoring> {
        self.anchoring.as_ref()
    }

    /// The graph of the stretches.
    pub fn graph(&self) -> &PoseGraph {
        &self.graph
    }

    /// The scans whose poses are the graph's nodes.
    pub fn graph_scans(&self) -> impl Iterator<Item = usize> {
        self.stretches.iter().map(|stretch| stretch.scan)
    }

    /// The corrected pose of a scan, by its number among those that were pushed: between the stretches' frames, corrections go over evenly
    /// along the way.
    ///
    /// # Panics
    /// If there is no such scan.
    pub fn pose(&self, scan: usize) -> Pose {
        let ScanAt { pose, along, .. } = self.scans[scan];
        let after = self.stretches.partition_point(|stretch| stretch.scan <= scan);
        let corrected = |stretch: usize| {
            let frame = self.scans[self.stretches[stretch].scan].pose;
            self.graph.nodes[stretch] * (frame.inverse() * pose)
        };
        match (after.checked_sub(1), after < self.stretches.len()) {
            (Some(before), true) => {
                let at = |stretch: usize| self.scans[self.stretches[stretch].scan].along;
                let share = (along - at(before)) / (at(after) - at(before)).max(1e-9);
                Interpolation::new(corrected(before), corrected(after)).at(share.clamp(0.0, 1.0))
            }
            (Some(before), false) => corrected(before),
            (None, true) => corrected(after),
            (None, false) => pose,
        }
    }

    /// The motion of the world that moves a scan from where odometry had it to its corrected pose.
    ///
    /// # Panics
    /// If there is no such scan.
    pub fn correction(&self, scan: usize) -> Pose {
        self.pose(scan) * self.scans[scan].pose.inverse()
    }
}
