//! Pose graphs on SE(3): poses, what was measured between them, and the poses that agree best with it.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3x6, Matrix6, Vector3, Vector6};
use tsdfuse::Pose;

use crate::blocks::Plan;

/// What says where one node is, seen from another one.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// The node from which it was measured.
    pub from: usize,
    /// The node that was measured.
    pub to: usize,
    /// `from_from_to`.
    pub measured: Pose,
    /// Information (inverse covariance) of shift (metres) and turn (radians), along and about the axes of `to`.
    pub information: Matrix6<f64>,
    /// Whether it may be wrong: then it counts the less the more it disagrees with the rest.
    pub is_closure: bool,
}

/// What says where a node is in the world, such as a GNSS receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// The node.
    pub node: usize,
    /// The point of the node's frame that was measured (the antenna), metres.
    pub at: DVec3,
    /// Where it is in the world, metres.
    pub measured: DVec3,
    /// Standard deviations along the world's axes, metres.
    pub sigma_m: DVec3,
    /// How much it counts: 1, or less where others say the same with the same errors.
    pub weight: f64,
}

/// What says which direction is up, in the frame of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Upright {
    /// The node.
    pub node: usize,
    /// The world's z axis in the frame of the node, of length 1.
    pub up: DVec3,
    /// Standard deviation of its direction, radians.
    pub sigma_rad: f64,
}

/// Poses and what was measured between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    /// `world_from_node`.
    pub nodes: Vec<Pose>,
    /// Between nodes. Edges to nodes that are not there count as none.
    pub edges: Vec<Edge>,
    /// In the world; may be wrong like closures.
    pub positions: Vec<Position>,
    /// Directions of gravity.
    pub uprights: Vec<Upright>,
}

/// How it went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optimized {
    /// The sum of squared errors in standard deviations, of all that was measured, before.
    pub cost_before: f64,
    /// And after.
    pub cost: f64,
    /// Linear systems that were solved.
    pub iterations: usize,
}

/// The squared error, in standard deviations, of six numbers, beyond which a closure is doubted (99.9 %).
pub(crate) const DOUBTFUL: f64 = 22.5;

/// The same at the beginning. What is off by more than ten times as much hardly pulls, unless the rest yields easily.
const WIDEST: f64 = 100.0 * DOUBTFUL;

/// Passes at most, for each width of the kernel.
const MOST_PASSES: usize = 200;

/// The cost has converged when it falls by a smaller share.
const CONVERGED: f64 = 1e-9;

/// Information by which the first node is held where nothing tells where the world is, and where positions or gravity do.
const HELD: (f64, f64) = (1e8, 1e-4);

/// Log of a rotation: axis times angle, the shorter way.
fn log(q: DQuat) -> DVec3 {
    (if q.w < 0.0 { -q } else { q }).to_scaled_axis()
}

fn cross(a: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, a.z, -a.y),
        DVec3::new(-a.z, 0.0, a.x),
        DVec3::new(a.y, -a.x, 0.0),
    )
}

/// The inverse of the right Jacobian of SO(3): log(exp(φ) exp(δ)) = φ + J⁻¹ δ (Forster et al., TRO 2017, eq. 9).
fn right_jacobian_inverse(phi: DVec3) -> DMat3 {
    let angle = phi.length();
    let square = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        angle.powi(-2) - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    let x = cross(phi);
    DMat3::IDENTITY + x * 0.5 + x * x * square
}

fn put(m: &mut Matrix6<f64>, row: usize, col: usize, b: DMat3) {
    for c in 0..3 {
        for r in 0..3 {
            m[(row + r, col + c)] = b.col(c)[r];
        }
    }
}

fn six(a: DVec3, b: DVec3) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}

/// A pose after a small motion in its own frame: shift, turn.
pub(crate) fn moved(pose: &Pose, by: &Vector6<f64>) -> Pose {
    let (shift, turn) = (DVec3::new(by[0], by[1], by[2]), DVec3::new(by[3], by[4], by[5]));
    Pose {
        rotation: (pose.rotation * DQuat::from_scaled_axis(turn)).normalize(),
        translation: pose.translation + pose.rotation * shift,
    }
}

/// The motion from one pose to another in the frame of the first: shift, turn.
pub(crate) fn between(a: &Pose, b: &Pose) -> Vector6<f64> {
    let motion = a.inverse() * *b;
    six(motion.translation, log(motion.rotation))
}

/// The information about a motion along and about the axes of the fixed frame, along and about those of the frame that was measured.
pub(crate) fn right(information: &Matrix6<f64>, rotation: DQuat) -> Matrix6<f64> {
    let (mut turned, r) = (Matrix6::zeros(), DMat3::from_quat(rotation));
    put(&mut turned, 0, 0, r);
    put(&mut turned, 3, 3, r);
    turned.tr_mul(information) * turned
}

/// The covariance (shift, turn) of `b_from_c` from that of `a_from_b` with that of `a_from_c`, each in the frame of what is measured.
pub(crate) fn compounded(ab: &Matrix6<f64>, b_from_c: &Pose, bc: &Matrix6<f64>) -> Matrix6<f64> {
    // A motion of b in its own frame, as a motion of c in that of c.
    let back = DMat3::from_quat(b_from_c.rotation).transpose();
    let mut j = Matrix6::zeros();
    put(&mut j, 0, 0, back);
    put(&mut j, 0, 3, -(back * cross(b_from_c.translation)));
    put(&mut j, 3, 3, back);
    j * ab * j.transpose() + bc
}

impl Edge {
    /// The error and its derivatives by small motions of both nodes, each in its own frame.
    fn error(&self, from: &Pose, to: &Pose) -> (Vector6<f64>, Matrix6<f64>, Matrix6<f64>) {
        let seen = from.inverse() * *to;
        let back = self.measured.rotation.conjugate();
        let shift = back * (seen.translation - self.measured.translation);
        let rotation = back * seen.rotation;
        let turn = log(rotation);
        let (back, inverse) = (DMat3::from_quat(back), right_jacobian_inverse(turn));
        let (mut by_from, mut by_to) = (Matrix6::zeros(), Matrix6::zeros());
        put(&mut by_to, 0, 0, DMat3::from_quat(rotation));
        put(&mut by_to, 3, 3, inverse);
        put(&mut by_from, 0, 0, -back);
        put(&mut by_from, 0, 3, back * cross(seen.translation));
        put(
            &mut by_from,
            3,
            3,
            -(inverse * DMat3::from_quat(seen.rotation).transpose()),
        );
        (six(shift, turn), by_from, by_to)
    }

    /// Its information as g2o has it: the upper triangle, row by row.
    pub fn upper_triangle(&self) -> [f64; 21] {
        let mut pairs = (0..6).flat_map(|row| (row..6).map(move |col| (row, col)));
        std::array::from_fn(|_| pairs.next().map_or(0.0, |at| self.information[at]))
    }

    /// An information matrix of the upper triangle, row by row.
    pub fn information_of(triangle: &[f64; 21]) -> Matrix6<f64> {
        let mut information = Matrix6::zeros();
        let pairs = (0..6).flat_map(|row| (row..6).map(move |col| (row, col)));
        for ((row, col), &value) in pairs.zip(triangle) {
            (information[(row, col)], information[(col, row)]) = (value, value);
        }
        information
    }

    /// Its squared error in standard deviations.
    pub fn squared_error(&self, nodes: &[Pose]) -> f64 {
        match (nodes.get(self.from), nodes.get(self.to)) {
            (Some(from), Some(to)) => {
                let (e, ..) = self.error(from, to);
                e.dot(&(self.information * e))
            }
            _ => 0.0,
        }
    }
}

/// The error of a vector that a node's pose predicts, in standard deviations, with its derivative by a small motion of the node.
type Three = (Vector3<f64>, Matrix3x6<f64>);

fn three(e: DVec3, by_shift: DMat3, by_turn: DMat3, sigma: DVec3) -> Three {
    let mut j = Matrix3x6::zeros();
    for c in 0..3 {
        for r in 0..3 {
            j[(r, c)] = by_shift.col(c)[r] / sigma[r];
            j[(r, 3 + c)] = by_turn.col(c)[r] / sigma[r];
        }
    }
    (Vector3::new(e.x / sigma.x, e.y / sigma.y, e.z / sigma.z), j)
}

impl Position {
    fn error(&self, node: &Pose) -> Three {
        let turned = DMat3::from_quat(node.rotation);
        three(
            node.transform_point(self.at) - self.measured,
            turned,
            -(turned * cross(self.at)),
            self.sigma_m,
        )
    }
}

impl Upright {
    fn error(&self, node: &Pose) -> Three {
        // What the node should see as up, less what it sees.
        let up = node.rotation.conjugate() * DVec3::Z;
        three(up - self.up, DMat3::ZERO, cross(up), DVec3::splat(self.sigma_rad))
    }
}

/// The weight of what may be wrong, and its share of the cost, after Agarwal et al. (ICRA 2013, eq. 15): dynamic covariance scaling.
fn scaled(squared: f64, width: f64) -> (f64, f64) {
    if squared <= width {
        return (1.0, squared);
    }
    let s = 2.0 * width / (width + squared);
    (s * s, s * s * squared + width * (1.0 - s).powi(2))
}

/// Widths of the kernels: squared errors, in standard deviations, up to which all counts.
#[derive(Clone, Copy, PartialEq)]
struct Width {
    closures: f64,
    positions: f64,
}

impl Width {
    const LAST: Self = Self {
        closures: DOUBTFUL,
        positions: DOUBTFUL,
    };

    const NONE: Self = Self {
        closures: f64::INFINITY,
        positions: f64::INFINITY,
    };

    fn next(self) -> Self {
        Self {
            closures: (0.25 * self.closures).max(DOUBTFUL),
            positions: (0.25 * self.positions).max(DOUBTFUL),
        }
    }
}

impl PoseGraph {
    /// Moves the nodes to where they agree best with all that was measured: Levenberg-Marquardt, with closures and positions weighted by dynamic
    /// covariance scaling whose width shrinks (graduated non-convexity: Yang et al., RA-L 2020). The first node stays, but where positions tell
    /// where it is; directions of gravity may tilt it.
    ///
    /// One thread, one order: the same input gives the same bits.
    pub fn optimize(&mut self) -> Optimized {
        let n = self.nodes.len();
        self.edges
            .retain(|edge| edge.from < n && edge.to < n && edge.from != edge.to);
        self.positions.retain(|position| position.node < n);
        self.uprights.retain(|upright| upright.node < n);
        let plan = Plan::new(n, self.edges.iter().map(|edge| (edge.from, edge.to)));
        let first = self.nodes.first().copied().unwrap_or_default();
        let cost_before = self.cost(Width::NONE);
        let mut width = self.widest();
        let mut iterations = 0;
        loop {
            iterations += self.descend(&plan, &first, width);
            if width == Width::LAST {
                break;
            }
            width = width.next();
        }
        Optimized {
            cost_before,
            cost: self.cost(Width::NONE),
            iterations,
        }
    }

    /// Moves the newest node alone to where it agrees best with the edges that lead to it, which are the last ones: what costs the same in a graph of any
    /// size. Nothing moves if they do not tell where it is.
    pub fn settle_last(&mut self) {
        const PASSES: usize = 5;
        let Some(last) = self.nodes.len().checked_sub(1) else {
            return;
        };
        for _ in 0..PASSES {
            let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
            for edge in self.edges.iter().rev().take_while(|edge| edge.to == last) {
                let Some(from) = self.nodes.get(edge.from) else {
                    continue;
                };
                let (e, _, j) = edge.error(from, &self.nodes[last]);
                let weight = if edge.is_closure {
                    scaled(e.dot(&(edge.information * e)), DOUBTFUL).0
                } else {
                    1.0
                };
                let weighted = j.tr_mul(&edge.information) * weight;
                h += weighted * j;
                g -= weighted * e;
            }
            let Some(h) = h.cholesky() else { return };
            self.nodes[last] = moved(&self.nodes[last], &h.solve(&g));
        }
    }

    /// The kernels' widths at the beginning. Where the world is may be unknown by far.
    fn widest(&self) -> Width {
        let closures = self.edges.iter().filter(|edge| edge.is_closure);
        let closures = closures.map(|edge| edge.squared_error(&self.nodes));
        let positions = self
            .positions
            .iter()
            .map(|p| p.error(&self.nodes[p.node]).0.norm_squared());
        Width {
            closures: closures.fold(0.0, f64::max).clamp(DOUBTFUL, WIDEST),
            positions: positions.fold(DOUBTFUL, f64::max),
        }
    }

    /// The cost with a kernel of this width; without one it is the sum of squared errors in standard deviations.
    fn cost(&self, width: Width) -> f64 {
        let edges = self.edges.iter().map(|edge| {
            let squared = edge.squared_error(&self.nodes);
            if edge.is_closure {
                scaled(squared, width.closures).1
            } else {
                squared
            }
        });
        let positions = self.positions.iter();
        let positions = positions.map(|p| {
            let squared = p.error(&self.nodes[p.node]).0.norm_squared();
            p.weight * scaled(squared, width.positions).1
        });
        let uprights = self.uprights.iter();
        let uprights = uprights.map(|u| u.error(&self.nodes[u.node]).0.norm_squared());
        edges.chain(positions).chain(uprights).sum()
    }

    /// What holds the first node where nothing tells where the world is: positions tell it, but without heights neither height nor tilt; gravity tells
    /// the tilt.
    fn held(&self, first: &Pose) -> Matrix6<f64> {
        let (tightly, loosely) = HELD;
        let up = first.rotation.conjugate() * DVec3::Z;
        let vertical = DMat3::from_cols(up * up.x, up * up.y, up * up.z);
        let are_placed = !self.positions.is_empty();
        let are_heights_known = self.positions.iter().any(|position| position.sigma_m.z.is_finite());
        let free = DMat3::IDENTITY * loosely;
        let shift = match (are_placed, are_heights_known) {
            (false, _) => DMat3::IDENTITY * tightly,
            (true, false) => vertical * tightly + free,
            (true, true) => free,
        };
        let heading = if are_placed { DMat3::ZERO } else { vertical * tightly };
        let tilt = if are_heights_known || !self.uprights.is_empty() {
            DMat3::ZERO
        } else {
            (DMat3::IDENTITY - vertical) * tightly
        };
        let mut held = Matrix6::zeros();
        put(&mut held, 0, 0, shift);
        put(&mut held, 3, 3, heading + tilt + free);
        held
    }

    /// Levenberg-Marquardt with one width of the kernel; how many systems were solved.
    fn descend(&mut self, plan: &Plan, first: &Pose, width: Width) -> usize {
        let held = self.held(first);
        let mut cost = self.cost(width);
        let mut damping = 1e-6;
        for pass in 1..=MOST_PASSES {
            let mut h = plan.system();
            let mut g = vec![Vector6::zeros(); self.nodes.len()];
            for edge in &self.edges {
                let (a, b) = (edge.from, edge.to);
                let (e, ja, jb) = edge.error(&self.nodes[a], &self.nodes[b]);
                let information = if edge.is_closure {
                    edge.information * scaled(e.dot(&(edge.information * e)), width.closures).0
                } else {
                    edge.information
                };
                let (wa, wb) = (ja.tr_mul(&information), jb.tr_mul(&information));
                h.add(a, a, &(wa * ja));
                h.add(b, b, &(wb * jb));
                h.add(b, a, &(wb * ja));
                g[a] -= wa * e;
                g[b] -= wb * e;
            }
            let mut add = |node: usize, (e, j): Three, weight: f64| {
                h.add(node, node, &(j.tr_mul(&j) * weight));
                g[node] -= j.tr_mul(&e) * weight;
            };
            for position in &self.positions {
                let three = position.error(&self.nodes[position.node]);
                let (scale, _) = scaled(three.0.norm_squared(), width.positions);
                add(position.node, three, position.weight * scale);
            }
            for upright in &self.uprights {
                add(upright.node, upright.error(&self.nodes[upright.node]), 1.0);
            }
            if let Some(node) = self.nodes.first() {
                h.add(0, 0, &held);
                g[0] -= held * between(first, node);
            }
            h.damp(damping);
            let Some(steps) = h.solve(&g) else {
                damping = (10.0 * damping).max(1e-6);
                continue;
            };
            let old = self.nodes.clone();
            for (node, step) in self.nodes.iter_mut().zip(&steps) {
                *node = moved(node, step);
            }
            let new = self.cost(width);
            // (A NaN is no improvement.)
            if !(new <= cost * (1.0 + 1e-12) + 1e-15) {
                self.nodes = old;
                damping *= 10.0;
                if damping > 1e6 {
                    return pass;
                }
                continue;
            }
            damping = (0.1 * damping).max(1e-12);
            let gained = cost - new;
            cost = new;
            if gained <= CONVERGED * cost + 1e-12 {
                return pass;
            }
        }
        MOST_PASSES
    }

    /// How uncertain each node is, seen from one of them: the covariance (shift, turn, in the frame of the node), added up along the way over the
    /// edges that makes its position most certain. `None` for nodes to which no way leads.
    ///
    /// An upper bound: of several ways only the best one counts.
    pub fn uncertainty_from(&self, from: usize) -> Vec<Option<Matrix6<f64>>> {
        let n = self.nodes.len();
        let mut ways: Vec<Vec<(usize, usize)>> = vec![Vec::new(); n];
        for (at, edge) in self.edges.iter().enumerate() {
            if edge.from < n && edge.to < n {
                ways[edge.from].push((at, edge.to));
                ways[edge.to].push((at, edge.from));
            }
        }
        let mut known: Vec<Option<Matrix6<f64>>> = vec![None; n];
        let mut queue = BinaryHeap::new();
        if from < n {
            queue.push(Reached {
                variance: 0.0,
                node: from,
                covariance: Matrix6::zeros(),
            });
        }
        while let Some(Reached { node, covariance, .. }) = queue.pop() {
            if known[node].is_some() {
                continue;
            }
            known[node] = Some(covariance);
            for &(at, next) in ways[node].iter().filter(|(_, next)| known[*next].is_none()) {
                let edge = &self.edges[at];
                let Some(own) = edge.information.try_inverse() else {
                    continue;
                };
                let step = self.nodes[node].inverse() * self.nodes[next];
                let own = if edge.to == next {
                    own
                } else {
                    // Measured the other way round.
                    compounded(&own, &step, &Matrix6::zeros())
                };
                let covariance = compounded(&covariance, &step, &own);
                queue.push(Reached {
                    variance: covariance.fixed_view::<3, 3>(0, 0).trace(),
                    node: next,
                    covariance,
                });
            }
        }
        known
    }
}

/// A node on the way over the edges; the most certain comes first.
struct Reached {
    variance: f64,
    node: usize,
    covariance: Matrix6<f64>,
}

impl Ord for Reached {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_variance = other.variance.total_cmp(&self.variance);
        by_variance.then(other.node.cmp(&self.node))
    }
}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Reached {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Reached {}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(state: &mut u64) -> f64 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }

    fn some_pose(state: &mut u64, metres: f64, radians: f64) -> Pose {
        let mut v = |size: f64| DVec3::new(random(state), random(state), random(state)) * 2.0 * size;
        Pose {
            rotation: DQuat::from_scaled_axis(v(radians)),
            translation: v(metres),
        }
    }

    fn unit(component: usize, amount: f64) -> Vector6<f64> {
        let mut v = Vector6::zeros();
        v[component] = amount;
        v
    }

    #[test]
    fn errors_change_as_their_derivatives_say() {
        const H: f64 = 1e-6;
        let mut state = 5;
        for _ in 0..20 {
            let (a, b) = (some_pose(&mut state, 3.0, 1.0), some_pose(&mut state, 3.0, 1.0));
            let edge = Edge {
                from: 0,
                to: 1,
                measured: a.inverse() * b * some_pose(&mut state, 0.5, 0.4),
                information: Matrix6::identity(),
                is_closure: false,
            };
            let (e, ja, jb) = edge.error(&a, &b);
            let position = Position {
                node: 0,
                at: DVec3::new(0.3, -0.2, 1.0),
                measured: DVec3::X,
                sigma_m: DVec3::new(1.0, 2.0, 0.5),
                weight: 1.0,
            };
            let upright = Upright {
                node: 0,
                up: DVec3::Z,
                sigma_rad: 0.3,
            };
            let (p, u) = (position.error(&a), upright.error(&a));
            for c in 0..6 {
                let by_a = (edge.error(&moved(&a, &unit(c, H)), &b).0 - e) / H;
                let by_b = (edge.error(&a, &moved(&b, &unit(c, H))).0 - e) / H;
                assert!((by_a - ja.column(c)).norm() < 1e-4, "{c}");
                assert!((by_b - jb.column(c)).norm() < 1e-4, "{c}");
                let by = (position.error(&moved(&a, &unit(c, H))).0 - p.0) / H;
                assert!((by - p.1.column(c)).norm() < 1e-4, "{c}");
                let by = (upright.error(&moved(&a, &unit(c, H))).0 - u.0) / H;
                assert!((by - u.1.column(c)).norm() < 1e-4, "{c}");
            }
        }
    }

    /// Two rounds of a circle, with noisy steps and exact closures from round to round.
    fn rounds(n: usize, noise: f64) -> (Vec<Pose>, PoseGraph) {
        let truth: Vec<Pose> = (0..2 * n)
            .map(|i| {
                let angle = i as f64 / n as f64 * std::f64::consts::TAU;
                Pose {
                    rotation: DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(0.1 * angle.sin()),
                    translation: DVec3::new(20.0 * angle.cos(), 20.0 * angle.sin(), angle.sin()),
                }
            })
            .collect();
        let mut state = 7;
        let mut graph = PoseGraph {
            nodes: vec![truth[0]],
            ..PoseGraph::default()
        };
        let information = |sigma: f64| Matrix6::identity() * sigma.powi(-2);
        for i in 1..2 * n {
            let measured = truth[i - 1].inverse() * truth[i] * some_pose(&mut state, noise, 0.1 * noise);
            graph.nodes.push(graph.nodes[i - 1] * measured);
            graph.edges.push(Edge {
                from: i - 1,
                to: i,
                measured,
                information: information(0.02),
                is_closure: false,
            });
        }
        for i in (0..n).step_by(5) {
            graph.edges.push(Edge {
                from: i,
                to: i + n,
                measured: truth[i].inverse() * truth[i + n],
                information: information(0.01),
                is_closure: true,
            });
        }
        (truth, graph)
    }

    fn worst(truth: &[Pose], graph: &PoseGraph) -> f64 {
        let pairs = truth.iter().zip(&graph.nodes);
        pairs
            .map(|(a, b)| a.translation.distance(b.translation))
            .fold(0.0, f64::max)
    }

    #[test]
    fn a_graph_without_noise_is_found_from_anywhere_near() {
        let (truth, mut graph) = rounds(30, 0.0);
        let mut state = 3;
        for node in &mut graph.nodes[1..] {
            *node = *node * some_pose(&mut state, 1.0, 0.3);
        }
        let done = graph.optimize();
        assert!(done.cost < 1e-12 && done.cost_before > 1e3, "{done:?}");
        assert!(worst(&truth, &graph) < 1e-5);
    }

    #[test]
    fn closures_bring_a_drifted_trajectory_together_and_a_false_one_changes_little() {
        let (truth, mut graph) = rounds(60, 0.05);
        let drifted = worst(&truth, &graph);
        let mut with_false = graph.clone();
        graph.optimize();
        let closed = worst(&truth, &graph);
        // Halfway around, twenty metres off.
        with_false.edges.push(Edge {
            from: 10,
            to: 40,
            measured: Pose::IDENTITY,
            information: Matrix6::identity() * 1e4,
            is_closure: true,
        });
        with_false.optimize();
        let fooled = worst(&truth, &with_false);
        assert!(
            closed < 0.6 * drifted && fooled < 1.1 * closed + 0.01,
            "{drifted} {closed} {fooled}"
        );
        // What cannot be doubted would have done harm.
        if let Some(last) = with_false.edges.last_mut() {
            last.is_closure = false;
        }
        with_false.optimize();
        assert!(worst(&truth, &with_false) > 2.0);
    }

    #[test]
    fn the_newest_node_settles_where_all_would_put_it() {
        let (_, mut graph) = rounds(60, 0.05);
        let newest = graph.nodes.len() - 1;
        // Edges come with their nodes.
        graph.edges.sort_by_key(|edge| edge.to);
        graph.edges.push(Edge {
            from: newest - 60,
            to: newest,
            measured: graph.nodes[newest - 60].inverse() * graph.nodes[newest],
            information: Matrix6::identity() * 1e4,
            is_closure: true,
        });
        graph.optimize();
        let all = graph.nodes.clone();
        graph.nodes[newest] = all[newest] * some_pose(&mut 11, 0.05, 0.01);
        graph.settle_last();
        assert!(between(&all[newest], &graph.nodes[newest]).norm() < 1e-3);
        assert!(graph.nodes[..newest] == all[..newest]);
    }

    #[test]
    fn positions_and_gravity_say_where_the_world_is() {
        let (truth, mut graph) = rounds(30, 0.02);
        let away = Pose {
            rotation: DQuat::from_scaled_axis(DVec3::new(0.1, 0.05, 1.2)),
            translation: DVec3::new(500.0, -100.0, 20.0),
        };
        for node in &mut graph.nodes {
            *node = away * *node;
        }
        for (node, pose) in truth.iter().enumerate().step_by(4) {
            let at = DVec3::new(0.5, 0.0, 1.0);
            graph.positions.push(Position {
                node,
                at,
                measured: pose.transform_point(at),
                sigma_m: DVec3::splat(0.02),
                weight: 1.0,
            });
        }
        graph.uprights = truth
            .iter()
            .enumerate()
            .map(|(node, pose)| Upright {
                node,
                up: pose.rotation.conjugate() * DVec3::Z,
                sigma_rad: 0.01,
            })
            .collect();
        graph.optimize();
        assert!(worst(&truth, &graph) < 0.1, "{}", worst(&truth, &graph));
    }

    #[test]
    fn uncertainty_grows_along_the_way_and_closures_cut_it_short() {
        let (_, mut graph) = rounds(60, 0.0);
        let sigma = |graph: &PoseGraph, node: usize| {
            graph.uncertainty_from(0)[node]
                .unwrap()
                .fixed_view::<3, 3>(0, 0)
                .trace()
                .sqrt()
        };
        let closed = sigma(&graph, 62);
        graph.edges.retain(|edge| !edge.is_closure);
        assert!(sigma(&graph, 3) < sigma(&graph, 30) && closed < 0.3 * sigma(&graph, 62));
        // Of one step it is what the edge says, from either end.
        let one = graph.uncertainty_from(0)[1].unwrap();
        assert!((one - Matrix6::identity() * 0.0004).norm() < 1e-12);
        let other = graph.uncertainty_from(1)[0].unwrap();
        let step = graph.nodes[1].inverse() * graph.nodes[0];
        assert!((other - compounded(&one, &step, &Matrix6::zeros())).norm() < 1e-12);
        graph.edges.clear();
        assert!(graph.uncertainty_from(0)[1].is_none());
    }
}
