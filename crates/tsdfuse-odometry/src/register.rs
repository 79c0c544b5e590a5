//! Registration: the motion of a sweep that brings its returns onto the planes of the cells.
//!
//! Gauss-Newton over the sensor's twists at `KNOTS` moments of the sweep, between which corrections are linear in time. Each
//! return gives its distance from a plane, `r = nᵀ(x − q)`, weighted by the variance of that and by a robust kernel (Geman &
//! McClure), whose width shrinks from what the prediction may be off to what noise explains. What the returns do not determine is held by
//! the prediction: where the last sweep ended, and the motion as it was or as gyroscopes measured it.

use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};
use rayon::prelude::*;
use tsdfuse::Pose;

use crate::along::{Drift, Sought, sought_along, weak_direction};
use crate::cells::{Cells, Found};
use crate::motion::{Motion, Twist, turn_of};
use crate::returns::{GRAIN, KERNEL, Return, kernel};
use crate::sticking::{Remembered, sticking_out};

/// Moments of a sweep whose poses are sought.
pub(crate) const KNOTS: usize = 3;

/// The share of returns that count: neighbours share the errors of their plane.
const INDEPENDENT: f64 = 0.05;

/// Of so many returns one is used until the kernel has its last width; returns are ordered for that.
pub(crate) const COARSE: usize = 3;

/// Information by which the motion is held along a direction that was looked at by itself.
const HELD: f64 = 1e6;

/// Passes at most.
const MOST_PASSES: usize = 14;

/// What is known of a sweep's motion before its returns are looked at.
#[derive(Clone, Debug)]
pub(crate) struct Prior {
    pub(crate) motion: Motion,
    /// Information about the first pose (shift, turn), about its own position.
    pub(crate) begin: Matrix6<f64>,
    /// How far the motion from knot to knot may be off: metres, radians.
    pub(crate) step_sigma: (f64, f64),
    /// The same, at most: where returns tell little, the motion lately says nothing about what it may be.
    pub(crate) most: (f64, f64),
    /// What stuck out along a weak direction in the last sweeps; `None` where the cells are not made by sweeps one after the other: then all returns
    /// are asked there.
    pub(crate) remembered: Option<Remembered>,
    /// How sure the motion is along a direction about which the returns of the last sweeps told nothing or little.
    pub(crate) along: Option<Drift>,
    /// How far points may be off at first, metres.
    pub(crate) reach: f64,
}

impl Prior {
    /// How sure the motion is along a direction.
    fn drift(&self, direction: DVec3) -> Drift {
        self.along.unwrap_or_else(|| {
            let d = six(direction, DVec3::ZERO);
            let begin = self
                .begin
                .try_inverse()
                .map_or(1.0, |covariance| (d.transpose() * covariance * d)[0]);
            Drift::new(begin.sqrt(), 2.0 * self.most.0)
        })
    }
}

/// A registered sweep.
#[derive(Clone, Debug)]
pub(crate) struct Registered {
    pub(crate) motion: Motion,
    /// Information about the last pose (shift, turn), about its own position, of returns and prior.
    pub(crate) end: Matrix6<f64>,
    /// Information of the returns alone about a rigid motion of the sweep, about `centre`.
    pub(crate) rigid: Matrix6<f64>,
    /// What was found out along a direction about which most returns tell nothing, if there is one.
    pub(crate) along: Option<Sought>,
    /// Share of returns that lie in cells with a plane.
    pub(crate) covered: f64,
    /// Share of returns that lie on their plane as well as noise allows.
    pub(crate) matched: f64,
    /// Root mean square of the distances of those, metres.
    pub(crate) rms: f64,
    pub(crate) passes: usize,
}

/// Sums over returns of one piece of the motion between two knots; α is the share of the way from the first to the second.
#[derive(Clone, Default)]
struct Piece {
    /// The upper triangles of JᵀJ, row by row, weighted by (1−α)², α(1−α), α².
    squares: [[f64; 21]; 3],
    /// Jᵀr, weighted by 1−α, α.
    sides: [[f64; 6]; 2],
}

impl Piece {
    fn add(&mut self, j: &Vector6<f64>, r: f64, weight: f64, alpha: f64) {
        let (a, b) = (1.0 - alpha, alpha);
        let shares = [a * a, a * b, b * b];
        let mut at = 0;
        for row in 0..6 {
            let weighted = weight * j[row];
            for col in row..6 {
                let product = weighted * j[col];
                for (sum, share) in self.squares.iter_mut().zip(shares) {
                    sum[at] += share * product;
                }
                at += 1;
            }
            for (side, share) in self.sides.iter_mut().zip([a, b]) {
                side[row] += share * weighted * r;
            }
        }
    }

    fn add_all(&mut self, other: &Self) {
        let sums = self.squares.as_flattened_mut().iter_mut();
        sums.zip(other.squares.as_flattened()).for_each(|(a, b)| *a += b);
        let sums = self.sides.as_flattened_mut().iter_mut();
        sums.zip(other.sides.as_flattened()).for_each(|(a, b)| *a += b);
    }

    /// JᵀJ by the first knot, by both, and by the second.
    fn blocks(&self) -> [Matrix6<f64>; 3] {
        self.squares.map(|triangle| {
            let mut block = Matrix6::zeros();
            let mut values = triangle.into_iter();
            for row in 0..6 {
                for (col, value) in (row..6).zip(&mut values) {
                    (block[(row, col)], block[(col, row)]) = (value, value);
                }
            }
            block
        })
    }

    fn sides(&self) -> [Vector6<f64>; 2] {
        self.sides.map(Vector6::from)
    }
}

/// Sums over returns.
#[derive(Clone)]
struct Normal {
    pieces: Vec<Piece>,
    covered: usize,
    matched: usize,
    squares: f64,
}

impl Normal {
    fn new(pieces: usize) -> Self {
        Self {
            pieces: vec![Piece::default(); pieces],
            covered: 0,
            matched: 0,
            squares: 0.0,
        }
    }

    fn add(&mut self, other: &Self) {
        self.pieces
            .iter_mut()
            .zip(&other.pieces)
            .for_each(|(a, b)| a.add_all(b));
        self.covered += other.covered;
        self.matched += other.matched;
        self.squares += other.squares;
    }
}

pub(crate) fn six(shift: DVec3, turn: DVec3) -> Vector6<f64> {
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// The derivative of `a × b` by `b`, as a matrix.
fn cross(a: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, a.z, -a.y),
        DVec3::new(-a.z, 0.0, a.x),
        DVec3::new(a.y, -a.x, 0.0),
    )
}

fn put(m: &mut Matrix6<f64>, row: usize, col: usize, b: DMat3) {
    for c in 0..3 {
        for r in 0..3 {
            m[(row + r, col + c)] = b.col(c)[r];
        }
    }
}

/// The distance from a plane changes by this with (shift, turn) about a centre.
fn derivative(normal: DVec3, from_centre: DVec3) -> Vector6<f64> {
    six(normal, from_centre.cross(normal))
}

/// The 6×6 matrix that turns a twist about `to` into the same motion's twist about `from`.
pub(crate) fn recentred(from: DVec3, to: DVec3) -> Matrix6<f64> {
    let mut m = Matrix6::identity();
    // shift at `from` = shift at `to` + turn × (from − to)
    put(&mut m, 0, 3, -cross(from - to));
    m
}

/// The sums over all returns for a motion; `width` adds to the kernel's, metres.
#[allow(clippy::too_many_arguments)]
fn sum(
    cells: &Cells,
    returns: &[Return],
    found: &mut [Found],
    motion: &Motion,
    knots: usize,
    centre: DVec3,
    width: f64,
    weak: Option<DVec3>,
) -> Normal {
    let (pieces, placer) = (knots.saturating_sub(1).max(1), motion.placer());
    let part = |(returns, found): (&[Return], &mut [Found])| {
        let mut normal = Normal::new(pieces);
        for (Return { point, share, .. }, found) in returns.iter().zip(found) {
            let x = placer.place(*point, *share);
            let Some((plane, r, variance)) = cells.plane_near(x, found) else {
                continue;
            };
            normal.covered += 1;
            if r * r < 9.0 * variance {
                normal.matched += 1;
                normal.squares += r * r;
            }
            let scale = KERNEL * KERNEL * variance + width * width;
            let weight = INDEPENDENT * kernel(r, scale) / (variance + 0.04 * width * width);
            let mut j = derivative(plane.normal, x - centre);
            if let Some(d) = weak {
                // Errors of many planes' normals would hold the sensor where it was.
                j -= six(d * plane.normal.dot(d), DVec3::ZERO);
            }
            let at = if knots > 1 {
                f64::from(*share) * pieces as f64
            } else {
                0.0
            };
            let piece = (at as usize).min(pieces - 1);
            normal.pieces[piece].add(&j, r, weight, at - piece as f64);
        }
        normal
    };
    let parts = returns.par_chunks(GRAIN).zip(found.par_chunks_mut(GRAIN));
    let parts: Vec<Normal> = parts.map(part).collect();
    let mut total = Normal::new(pieces);
    parts.iter().for_each(|part| total.add(part));
    total
}

/// The error of a motion between two poses, as against another motion between such, in the frame of the first (shift, turn),
/// and its derivatives by the twists of both poses about a centre.
fn step_error(from: &Pose, to: &Pose, predicted: &Pose, centre: DVec3) -> (Vector6<f64>, Matrix6<f64>, Matrix6<f64>) {
    let moved = from.inverse() * *to;
    let shift = moved.translation - predicted.translation;
    let turn = turn_of(predicted.rotation.conjugate() * moved.rotation);
    let back = DMat3::from_quat(from.rotation).transpose();
    let there = DMat3::from_quat(to.rotation).transpose();
    let (mut by_from, mut by_to) = (Matrix6::zeros(), Matrix6::zeros());
    put(&mut by_to, 0, 0, back);
    put(&mut by_to, 0, 3, -(back * cross(to.translation - centre)));
    put(&mut by_to, 3, 3, there);
    put(&mut by_from, 0, 0, -back);
    put(&mut by_from, 0, 3, back * cross(to.translation - centre));
    put(&mut by_from, 3, 3, -there);
    (six(shift, turn), by_from, by_to)
}

/// The motion that brings the returns onto the cells' planes.
///
/// Where `returns` tell little about a direction, all of `dense` are asked where they lie along it.
pub(crate) fn register(cells: &Cells, returns: &[Return], dense: &[Return], prior: &Prior) -> Registered {
    let mut found = vec![Found::default(); returns.len()];
    let mut weak: Option<(DVec3, Sought)> = None;
    // Where the last sweeps let the sensor be expected.
    let mut expected = prior.motion.clone();
    let mut motion = expected.clone();
    let knots = if motion.poses.len() > 1 { KNOTS } else { 1 };
    let centre = expected.first().translation;
    let size = 6 * knots;
    let mut width = prior.reach;
    let mut passes = 0;
    loop {
        // A part of the returns leads near to where all of them lead.
        let used = if width > 0.0 {
            returns.len().div_ceil(COARSE)
        } else {
            returns.len()
        };
        let direction = weak.as_ref().map(|(direction, _)| *direction);
        let normal = sum(
            cells,
            &returns[..used],
            &mut found[..used],
            &motion,
            knots,
            centre,
            width,
            direction,
        );
        let mut h = DMatrix::<f64>::zeros(size, size);
        let mut g = DVector::<f64>::zeros(size);
        let add = |h: &mut DMatrix<f64>, row: usize, col: usize, m: &Matrix6<f64>| {
            let mut view = h.fixed_view_mut::<6, 6>(6 * row, 6 * col);
            view += m;
        };
        let add_side = |g: &mut DVector<f64>, row: usize, v: &Vector6<f64>| {
            let mut side = g.fixed_rows_mut::<6>(6 * row);
            side += v;
        };
        let mut rigid = Matrix6::zeros();
        for (piece, sums) in normal.pieces.iter().enumerate() {
            let ([aa, ab, bb], [a, b]) = (&sums.blocks(), &sums.sides());
            rigid += aa + ab * 2.0 + bb;
            add(&mut h, piece, piece, aa);
            add_side(&mut g, piece, a);
            if knots > 1 {
                add(&mut h, piece, piece + 1, ab);
                add(&mut h, piece + 1, piece, ab);
                add(&mut h, piece + 1, piece + 1, bb);
                add_side(&mut g, piece + 1, b);
            }
        }
        if let Some((direction, Sought { information, .. })) = &weak {
            let d = six(*direction, DVec3::ZERO);
            let dd = d * d.transpose();
            rigid += dd * *information;
            // Along it the motion is what was found; what is left of the normals' errors moves nothing.
            for k in 0..knots {
                let e = direction.dot(motion.knot(k, knots).translation - expected.knot(k, knots).translation);
                add(&mut h, k, k, &(dd * HELD));
                add_side(&mut g, k, &(d * (HELD * e)));
            }
        }
        // Where the last sweep ended.
        let (first, begin) = (motion.first(), expected.first());
        let off = six(
            first.translation - begin.translation,
            turn_of(first.rotation * begin.rotation.conjugate()),
        );
        add(&mut h, 0, 0, &prior.begin);
        add_side(&mut g, 0, &(prior.begin * off));
        // The motion as predicted.
        let (shift_sigma, turn_sigma) = match weak {
            Some(_) => prior.most,
            None => prior.step_sigma,
        };
        let (per_shift, per_turn) = (shift_sigma.powi(-2), turn_sigma.powi(-2));
        let information = Matrix6::from_diagonal(&Vector6::new(
            per_shift, per_shift, per_shift, per_turn, per_turn, per_turn,
        ));
        for k in 0..knots - 1 {
            let (from, to) = (motion.knot(k, knots), motion.knot(k + 1, knots));
            let predicted = expected.knot(k, knots).inverse() * expected.knot(k + 1, knots);
            let (e, by_from, by_to) = step_error(&from, &to, &predicted, centre);
            let (wf, wt) = (by_from.transpose() * information, by_to.transpose() * information);
            add(&mut h, k, k, &(wf * by_from));
            add(&mut h, k, k + 1, &(wf * by_to));
            add(&mut h, k + 1, k, &(wt * by_from));
            add(&mut h, k + 1, k + 1, &(wt * by_to));
            add_side(&mut g, k, &(wf * e));
            add_side(&mut g, k + 1, &(wt * e));
        }
        passes += 1;
        let solved = h.clone().cholesky().map(|c| c.solve(&(-&g)));
        let twists: Vec<Twist> = match &solved {
            Some(x) => (0..knots)
                .map(|k| Twist {
                    shift: DVec3::new(x[6 * k], x[6 * k + 1], x[6 * k + 2]),
                    turn: DVec3::new(x[6 * k + 3], x[6 * k + 4], x[6 * k + 5]),
                })
                .collect(),
            None => vec![Twist::default(); knots],
        };
        motion = motion.corrected(&twists, centre);
        let moved = twists
            .iter()
            .map(|t| t.shift.length() + 10.0 * t.turn.length())
            .fold(0.0, f64::max);
        if passes >= MOST_PASSES || (passes > 2 && width == 0.0 && moved < 5e-4) {
            let last = motion.last().translation;
            let end = marginal_of_last(&h, knots);
            let to_last = recentred(centre, last);
            let n = used.max(1) as f64;
            return Registered {
                motion,
                end: to_last.transpose() * end * to_last,
                rigid,
                along: weak.map(|(_, sought)| sought),
                covered: normal.covered as f64 / n,
                matched: normal.matched as f64 / n,
                rms: (normal.squares / normal.matched.max(1) as f64).sqrt(),
                passes,
            };
        }
        if passes == 2
            && let Some(direction) = weak_direction(cells, returns, &motion)
        {
            let drift = prior.drift(direction);
            // What errors of normals have moved along it so far does not count.
            motion = motion.as_along(&expected, direction);
            let remembered = prior.remembered.as_ref();
            let sticking = match remembered {
                Some(_) => sticking_out(cells, dense, &motion, direction),
                None => dense.to_vec(),
            };
            let sought = sought_along(cells, remembered, sticking, &motion, direction, drift);
            expected = expected.shifted(direction, sought.shift);
            motion = motion.shifted(direction, sought.shift);
            weak = Some((direction, sought));
        }
        width = if width < 0.02 || (moved < 0.01 && width < 0.1) {
            0.0
        } else {
            0.5 * width
        };
    }
}

/// The information about the last knot, the others unknown.
fn marginal_of_last(h: &DMatrix<f64>, knots: usize) -> Matrix6<f64> {
    let n = 6 * (knots - 1);
    let last = h.fixed_view::<6, 6>(n, n).into_owned();
    if n == 0 {
        return last;
    }
    let (others, mixed) = (h.view((0, 0), (n, n)).into_owned(), h.view((0, n), (n, 6)).into_owned());
    let Some(cholesky) = others.cholesky() else {
        return last;
    };
    let gone = mixed.transpose() * cholesky.solve(&mixed);
    last - gone.fixed_view::<6, 6>(0, 0)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use glam::Vec3;

    use super::*;

    fn pose(seed: f64) -> Pose {
        Pose {
            rotation: DQuat::from_scaled_axis(DVec3::new(seed.sin(), (2.0 * seed).cos(), 0.4)),
            translation: DVec3::new(3.0 * seed, -2.0, seed * seed),
        }
    }

    /// The twist that is `amount` in one of six components.
    fn unit(component: usize, amount: f64) -> Twist {
        let mut all = [0.0; 6];
        all[component] = amount;
        Twist {
            shift: DVec3::from_slice(&all[..3]),
            turn: DVec3::from_slice(&all[3..]),
        }
    }

    const H: f64 = 1e-6;

    #[test]
    fn distances_from_planes_change_as_their_derivatives_say() {
        let (begin, sweep) = (
            pose(0.3),
            Pose {
                rotation: DQuat::from_rotation_z(0.08),
                translation: DVec3::new(0.9, 0.1, 0.0),
            },
        );
        let motion = Motion::steady(begin, &sweep);
        let (centre, normal) = (begin.translation, DVec3::new(0.3, -0.5, 0.8).normalize());
        let point = Vec3::new(12.0, -7.0, 1.5);
        for share in [0.0, 0.2, 0.5, 0.77, 1.0_f32] {
            let x = motion.placer().place(point, share);
            let j = derivative(normal, x - centre);
            let at = f64::from(share) * (KNOTS - 1) as f64;
            for knot in 0..KNOTS {
                let weight = (1.0 - (at - knot as f64).abs()).max(0.0);
                for component in 0..6 {
                    let mut twists = [Twist::default(); KNOTS];
                    twists[knot] = unit(component, H);
                    let moved = motion.corrected(&twists, centre).placer().place(point, share);
                    let measured = normal.dot(moved - x) / H;
                    assert!(
                        (measured - weight * j[component]).abs() < 1e-2,
                        "{share} {knot} {component}: {measured} {}",
                        weight * j[component]
                    );
                }
            }
        }
    }

    #[test]
    fn errors_of_steps_change_as_their_derivatives_say() {
        let (from, to) = (
            pose(0.3),
            pose(0.3)
                * Pose {
                    rotation: DQuat::from_rotation_y(0.05),
                    translation: DVec3::X,
                },
        );
        let (predicted, centre) = (from.inverse() * to, DVec3::new(0.5, 0.2, -1.0));
        let (e, by_from, by_to) = step_error(&from, &to, &predicted, centre);
        assert!(e.norm() < 1e-12);
        let moved = |pose: &Pose, twist: Twist| Motion::still(*pose).corrected(&[twist], centre).first();
        for component in 0..6 {
            let twist = unit(component, H);
            let (a, ..) = step_error(&moved(&from, twist), &to, &predicted, centre);
            let (b, ..) = step_error(&from, &moved(&to, twist), &predicted, centre);
            for row in 0..6 {
                assert!(
                    (a[row] / H - by_from[(row, component)]).abs() < 1e-4,
                    "{row} {component}"
                );
                assert!((b[row] / H - by_to[(row, component)]).abs() < 1e-4, "{row} {component}");
            }
        }
    }

    #[test]
    fn a_motion_is_the_same_about_any_centre() {
        let (a, b, x) = (
            DVec3::new(1.0, 2.0, 3.0),
            DVec3::new(-4.0, 0.5, 2.0),
            DVec3::new(7.0, 7.0, -1.0),
        );
        let about_b = Vector6::new(0.1, -0.2, 0.3, 0.01, 0.02, -0.03);
        let about_a = recentred(a, b) * about_b;
        let moved =
            |t: &Vector6<f64>, c: DVec3| DVec3::new(t[0], t[1], t[2]) + DVec3::new(t[3], t[4], t[5]).cross(x - c);
        assert!(moved(&about_a, a).distance(moved(&about_b, b)) < 1e-12);
    }
}
