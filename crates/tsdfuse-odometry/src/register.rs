//! Registration: the motion of a sweep that brings its returns onto the planes of the cells.
//!
//! Gauss-Newton over the sensor's twists at `KNOTS` moments of the sweep, between which corrections are linear in time. Each
//! return gives its distance from a plane, `r = nᵀ(x − q)`, weighted by the variance of that and by a robust kernel (Geman &
//! McClure), whose width shrinks from what the prediction may be off to what noise explains. What the returns do not determine is held by
//! the prediction: where the last sweep ended, and the motion as it was or as gyroscopes measured it.

use glam::{DMat3, DVec3, Vec3};
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};
use rayon::prelude::*;
use tsdfuse::Pose;

use crate::cells::Cells;
use crate::motion::{Motion, Twist, turn_of};

/// Moments of a sweep whose poses are sought.
pub(crate) const KNOTS: usize = 3;

/// Returns that one thread sums up at a time. The sums are added in order, so threads change no bit.
const GRAIN: usize = 512;

/// The kernel's width where the motion has converged, in standard deviations.
const KERNEL: f64 = 2.5;

/// A direction is weak if the returns tell this many times less about it than about the next one, information.
const WEAK: f64 = 0.05;

/// Planes whose normals have less than this share along a weak direction tell nothing about it but their own error.
const LEAST_SHARE: f64 = 0.3;

/// Passes at most.
const MOST_PASSES: usize = 14;

/// A return to register: in the sensor frame, at a share of the sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Return {
    pub(crate) point: Vec3,
    pub(crate) share: f32,
}

/// What is known of a sweep's motion before its returns are looked at.
#[derive(Clone, Debug)]
pub(crate) struct Prediction {
    pub(crate) motion: Motion,
    /// Information about the first pose (shift, turn), about its own position.
    pub(crate) begin: Matrix6<f64>,
    /// How far the motion from knot to knot may be off: metres, radians.
    pub(crate) step_sigma: (f64, f64),
    /// The same, at most: where returns tell little, the motion lately says nothing about what it may be.
    pub(crate) most: (f64, f64),
    /// How far points may be off at first, metres.
    pub(crate) reach: f64,
}

/// A registered sweep.
#[derive(Clone, Debug)]
pub(crate) struct Registered {
    pub(crate) motion: Motion,
    /// Information about the last pose (shift, turn), about its own position, of returns and prediction.
    pub(crate) end: Matrix6<f64>,
    /// Information of the returns alone about a rigid motion of the sweep, about `centre`.
    pub(crate) rigid: Matrix6<f64>,
    /// Share of returns that lie in cells with a plane.
    pub(crate) covered: f64,
    /// Share of returns that lie on their plane as well as noise allows.
    pub(crate) matched: f64,
    /// Root mean square of the distances of those, metres.
    pub(crate) rms: f64,
    pub(crate) passes: usize,
}

/// Sums over returns: for each piece between knots the blocks of the normal matrix.
#[derive(Clone)]
struct Normal {
    /// For each piece: JᵀJ weighted by (1−α)², α(1−α), α².
    blocks: Vec<[Matrix6<f64>; 3]>,
    /// For each piece: Jᵀr weighted by 1−α, α.
    sides: Vec<[Vector6<f64>; 2]>,
    covered: usize,
    matched: usize,
    squares: f64,
}

impl Normal {
    fn new(pieces: usize) -> Self {
        Self {
            blocks: vec![[Matrix6::zeros(); 3]; pieces],
            sides: vec![[Vector6::zeros(); 2]; pieces],
            covered: 0,
            matched: 0,
            squares: 0.0,
        }
    }

    fn add(&mut self, other: &Self) {
        for (a, b) in self.blocks.iter_mut().zip(&other.blocks) {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        }
        for (a, b) in self.sides.iter_mut().zip(&other.sides) {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        }
        self.covered += other.covered;
        self.matched += other.matched;
        self.squares += other.squares;
    }
}

fn six(shift: DVec3, turn: DVec3) -> Vector6<f64> {
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

/// The direction of shifts that returns tell little about, if there is one.
fn weak_direction(rigid: &Matrix6<f64>) -> Option<DVec3> {
    let column = |c: usize| DVec3::new(rigid[(0, c)], rigid[(1, c)], rigid[(2, c)]);
    let eigen = tsdfuse::eigen::eigen(&DMat3::from_cols(column(0), column(1), column(2)));
    (eigen.values[0] < WEAK * eigen.values[1]).then_some(eigen.vectors[0])
}

/// Returns of planes that do tell about a direction.
fn telling(cells: &Cells, returns: &[Return], motion: &Motion, direction: DVec3) -> Vec<Return> {
    let placer = motion.placer();
    let tells = |r: &&Return| {
        let plane = cells.plane_at(placer.place(r.point, r.share));
        plane.is_some_and(|(plane, ..)| plane.normal.dot(direction).abs() > LEAST_SHARE)
    };
    let parts = returns
        .par_chunks(GRAIN)
        .map(|part| part.iter().filter(tells).copied().collect::<Vec<_>>());
    parts.collect::<Vec<_>>().concat()
}

/// The sums over all returns for a motion; `width` adds to the kernel's, metres.
fn sum(
    cells: &Cells,
    returns: &[Return],
    motion: &Motion,
    knots: usize,
    centre: DVec3,
    width: f64,
    weak: Option<DVec3>,
) -> Normal {
    let (pieces, placer) = (knots.saturating_sub(1).max(1), motion.placer());
    let part = |returns: &[Return]| {
        let mut normal = Normal::new(pieces);
        for Return { point, share } in returns {
            let x = placer.place(*point, *share);
            let Some((plane, r, variance)) = cells.plane_at(x) else {
                continue;
            };
            normal.covered += 1;
            if r * r < 9.0 * variance {
                normal.matched += 1;
                normal.squares += r * r;
            }
            let scale = KERNEL * KERNEL * variance + width * width;
            let kernel = scale / (scale + r * r);
            let weight = kernel * kernel / (variance + 0.04 * width * width);
            let mut j = derivative(plane.normal, x - centre);
            if let Some(d) = weak.filter(|d| plane.normal.dot(*d).abs() < LEAST_SHARE) {
                // Errors of many planes' normals would hold the sensor where it was.
                j -= six(d * plane.normal.dot(d), DVec3::ZERO);
            }
            let at = if knots > 1 {
                f64::from(*share) * pieces as f64
            } else {
                0.0
            };
            let piece = (at as usize).min(pieces - 1);
            let (a, b) = (1.0 - (at - piece as f64), at - piece as f64);
            let jj = j * j.transpose() * weight;
            let [aa, ab, bb] = &mut normal.blocks[piece];
            *aa += jj * (a * a);
            *ab += jj * (a * b);
            *bb += jj * (b * b);
            let jr = j * (weight * r);
            let [side_a, side_b] = &mut normal.sides[piece];
            *side_a += jr * a;
            *side_b += jr * b;
        }
        normal
    };
    let parts: Vec<Normal> = returns.par_chunks(GRAIN).map(part).collect();
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
/// Where the returns tell little about a direction, those of `all` join that do.
pub(crate) fn register(cells: &Cells, returns: &[Return], all: &[Return], prediction: &Prediction) -> Registered {
    let mut returns = std::borrow::Cow::Borrowed(returns);
    let mut weak: Option<DVec3> = None;
    let mut motion = prediction.motion.clone();
    let knots = if motion.poses.len() > 1 { KNOTS } else { 1 };
    let begin = prediction.motion.first();
    let centre = begin.translation;
    let size = 6 * knots;
    let mut width = prediction.reach;
    let mut passes = 0;
    loop {
        let normal = sum(cells, &returns, &motion, knots, centre, width, weak);
        let mut h = DMatrix::<f64>::zeros(size, size);
        let mut g = DVector::<f64>::zeros(size);
        let add = |h: &mut DMatrix<f64>, row: usize, col: usize, m: &Matrix6<f64>| {
            let mut view = h.fixed_view_mut::<6, 6>(6 * row, 6 * col);
            view += m;
        };
        let mut rigid = Matrix6::zeros();
        for (piece, ([aa, ab, bb], [a, b])) in normal.blocks.iter().zip(&normal.sides).enumerate() {
            rigid += aa + ab * 2.0 + bb;
            add(&mut h, piece, piece, aa);
            let mut side = g.fixed_rows_mut::<6>(6 * piece);
            side += a;
            if knots > 1 {
                add(&mut h, piece, piece + 1, ab);
                add(&mut h, piece + 1, piece, ab);
                add(&mut h, piece + 1, piece + 1, bb);
                let mut side = g.fixed_rows_mut::<6>(6 * (piece + 1));
                side += b;
            }
        }
        // Where the last sweep ended.
        let first = motion.first();
        let off = six(
            first.translation - begin.translation,
            turn_of(first.rotation * begin.rotation.conjugate()),
        );
        add(&mut h, 0, 0, &prediction.begin);
        let mut side = g.fixed_rows_mut::<6>(0);
        side += prediction.begin * off;
        // The motion as predicted.
        let (shift_sigma, turn_sigma) = match weak {
            Some(_) => prediction.most,
            None => prediction.step_sigma,
        };
        let (per_shift, per_turn) = (shift_sigma.powi(-2), turn_sigma.powi(-2));
        let information = Matrix6::from_diagonal(&Vector6::new(
            per_shift, per_shift, per_shift, per_turn, per_turn, per_turn,
        ));
        for k in 0..knots - 1 {
            let (from, to) = (motion.knot(k, knots), motion.knot(k + 1, knots));
            let predicted = prediction.motion.knot(k, knots).inverse() * prediction.motion.knot(k + 1, knots);
            let (e, by_from, by_to) = step_error(&from, &to, &predicted, centre);
            let (wf, wt) = (by_from.transpose() * information, by_to.transpose() * information);
            add(&mut h, k, k, &(wf * by_from));
            add(&mut h, k, k + 1, &(wf * by_to));
            add(&mut h, k + 1, k, &(wt * by_from));
            add(&mut h, k + 1, k + 1, &(wt * by_to));
            let mut side = g.fixed_rows_mut::<6>(6 * k);
            side += wf * e;
            let mut side = g.fixed_rows_mut::<6>(6 * (k + 1));
            side += wt * e;
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
            let n = returns.len().max(1) as f64;
            return Registered {
                motion,
                end: to_last.transpose() * end * to_last,
                rigid,
                covered: normal.covered as f64 / n,
                matched: normal.matched as f64 / n,
                rms: (normal.squares / normal.matched.max(1) as f64).sqrt(),
                passes,
            };
        }
        if passes == 2 {
            weak = weak_direction(&rigid);
            if let Some(direction) = weak {
                returns.to_mut().extend(telling(cells, all, &motion, direction));
                // What errors of normals have moved so far does not count.
                motion = prediction.motion.clone();
                width = 2.0 * prediction.reach;
            }
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
