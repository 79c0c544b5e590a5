//! The plane through the points of a neighbourhood, and whether it decides a vertex: (4.5)–(4.7).

use glam::{DVec3, Vec3, Vec4};

use super::cells::STEPS;

/// Vertices that are processed together.
pub(super) const LANES: usize = 4;

/// Σ 1, Σ x, Σ y, Σ z, Σ xx, Σ yy, Σ zz, Σ xy, Σ xz, Σ yz of positions in steps: whole numbers.
pub(super) type Moments = [f64; 10];

/// Stands in for a divisor of 0.
const TINY: Vec4 = Vec4::splat(1e-30);

/// What a neighbourhood must have to decide a vertex.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// τ (4.6), per voxel².
    pub(super) min_density: f32,
    /// A lower bound on the second largest standard deviation, voxels: points below it lie on a line and span no plane.
    pub(super) min_spread: f32,
}

/// A symmetric matrix of each lane: xx, yy, zz, xy, xz, yz.
type Symmetric = [Vec4; 6];

/// A neighbourhood in each of four lanes, and the vertex that it may decide.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Neighbourhoods {
    /// Covariance of the points, voxels².
    covariance: [[f32; LANES]; 6],
    /// From the points' mean to the vertex, voxels.
    from_mean: [[f32; LANES]; 3],
}

/// The plane in each lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planes {
    /// Whether the density at the vertex's projection is high enough (4.6), as bits.
    pub(super) accepted: u32,
    /// The adjugate of the covariance less its smallest eigenvalue: a multiple of e₃ e₃ᵀ.
    adjugate: Symmetric,
    from_mean: [Vec4; 3],
}

impl Neighbourhoods {
    /// Sets one lane: a neighbourhood's moments, and a vertex in voxels from the same origin.
    #[inline]
    pub(super) fn set(&mut self, lane: usize, m: &Moments, vertex: DVec3) {
        const STEP: f64 = 1.0 / STEPS as f64;
        let to_mean = STEP / m[0];
        let scale = to_mean * to_mean;
        // n·Σxy − Σx·Σy is exact as long as it fits into 53 bits, so that no digits are lost far from the origin.
        let covariance = [
            m[0] * m[4] - m[1] * m[1],
            m[0] * m[5] - m[2] * m[2],
            m[0] * m[6] - m[3] * m[3],
            m[0] * m[7] - m[1] * m[2],
            m[0] * m[8] - m[1] * m[3],
            m[0] * m[9] - m[2] * m[3],
        ];
        for (of, value) in self.covariance.iter_mut().zip(covariance) {
            of[lane] = (value * scale) as f32;
        }
        let from_mean = vertex - DVec3::new(m[1], m[2], m[3]) * to_mean;
        for (of, value) in self.from_mean.iter_mut().zip(from_mean.to_array()) {
            of[lane] = value as f32;
        }
    }

    /// Principal component analysis of each lane, and the test of the Gaussian in the plane.
    ///
    /// With C scaled to trace 1, only its smallest eigenvalue λ₃ is needed. The other two have the sum 1 − λ₃ and the product
    /// det₂ = c₁ − λ₃(1 − λ₃), where c₁ is the sum of the principal minors of C, and for w in the plane
    /// wᵀΣ⁻¹w = ((1 − λ₃)·w² − wᵀCw)/det₂.
    pub(super) fn planes(&self, limits: &Limits) -> Planes {
        let threshold = (std::f32::consts::TAU * limits.min_density).powi(2);
        let c = self.covariance.map(Vec4::from);
        let d = self.from_mean.map(Vec4::from);
        let trace = (c[0] + c[1] + c[2]).max(Vec4::splat(1e-12));
        let unit = Vec4::ONE / trace;
        let c = c.map(|c| c * unit);
        let [xx, yy, zz, xy, xz, yz] = c;
        let minors = [yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy];
        let c1 = minors[0] + minors[1] + minors[2];
        let det = xx * minors[0] + xy * (xz * yz - xy * zz) + xz * (xy * yz - yy * xz);

        let l3 = smallest_root(c1, det);
        let sum = Vec4::ONE - l3;
        let det2 = c1 - l3 * sum;
        let adjugate = [
            minors[0] - l3 * (yy + zz - l3),
            minors[1] - l3 * (xx + zz - l3),
            minors[2] - l3 * (xx + yy - l3),
            xz * yz - xy * (zz - l3),
            xy * yz - xz * (yy - l3),
            xy * xz - yz * (xx - l3),
        ];
        // λ₁ and λ₂ ≥ ε: (λ₁ − ε)(λ₂ − ε) ≥ 0 and λ₁ + λ₂ ≥ 2ε.
        let eps = unit * (limits.min_spread * limits.min_spread);
        let spans = det2.cmpge(eps * (sum - eps)) & sum.cmpge(2.0 * eps);

        let across2 = quadratic(&adjugate, &d) / (adjugate[0] + adjugate[1] + adjugate[2]).max(TINY);
        let within2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - across2;
        let spread2 = (sum * within2 - quadratic(&c, &d) + l3 * across2) * unit / det2.max(TINY);
        // exp(−q/2)/(2π√det Σ) ≥ τ (4.6), squared: exp(q)·(2πτ)²·det Σ ≤ 1.
        let inverse2 = exp(spread2.clamp(Vec4::ZERO, Vec4::splat(64.0))) * det2 * trace * trace * threshold;
        Planes {
            accepted: (spans & inverse2.cmple(Vec4::ONE)).bitmask(),
            adjugate,
            from_mean: d,
        }
    }
}

impl Planes {
    /// The unit normal e₃ of the plane in a lane, pointing either way, and the distance (4.7) of its vertex along it, in voxels.
    pub(super) fn plane(&self, lane: usize) -> (Vec3, f32) {
        let [xx, yy, zz, xy, xz, yz] = self.adjugate.map(|of| of[lane]);
        // The longest column of the adjugate.
        let column = if xx >= yy && xx >= zz {
            Vec3::new(xx, xy, xz)
        } else if yy >= zz {
            Vec3::new(xy, yy, yz)
        } else {
            Vec3::new(xz, yz, zz)
        };
        let normal = column.normalize_or_zero();
        (normal, normal.dot(self.from_mean.map(|of| of[lane]).into()))
    }
}

/// vᵀMv.
#[inline(always)]
fn quadratic(m: &Symmetric, v: &[Vec4; 3]) -> Vec4 {
    let squares = m[0] * v[0] * v[0] + m[1] * v[1] * v[1] + m[2] * v[2] * v[2];
    squares + 2.0 * (m[3] * v[0] * v[1] + m[4] * v[0] * v[2] + m[5] * v[1] * v[2])
}

/// The smallest root of x³ − x² + c₁x − det, which has three real ones ≥ 0: two steps of Laguerre's method, downwards from the
/// maximum between the two smaller roots. Where these are one, it is the maximum itself.
#[inline(always)]
fn smallest_root(c1: Vec4, det: Vec4) -> Vec4 {
    let highest = c1 / (1.0 + (1.0 - 3.0 * c1).max(Vec4::ZERO).sqrt());
    let mut x = highest;
    for _ in 0..2 {
        let p = ((x - 1.0) * x + c1) * x - det;
        let p1 = (3.0 * x - 2.0) * x + c1;
        let p2 = 6.0 * x - 2.0;
        let root = (4.0 * p1 * p1 - 6.0 * p * p2).max(Vec4::ZERO).sqrt();
        x = (x - 3.0 * p / (p1 + root).max(TINY)).clamp(Vec4::ZERO, highest);
    }
    x
}

/// e^x for 0 ≤ x ≤ 64, the same on every machine: a series for x/256, squared eight times.
#[inline(always)]
fn exp(x: Vec4) -> Vec4 {
    let x = x * (1.0 / 256.0);
    let mut y = 1.0 + x * (1.0 + x * (1.0 / 2.0) * (1.0 + x * (1.0 / 3.0) * (1.0 + x * (1.0 / 4.0))));
    for _ in 0..8 {
        y *= y;
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eigen::eigen;
    use glam::{DMat3, DQuat};
    use proptest::prelude::*;

    /// Eight points with this covariance about `mean`, in steps.
    fn moments(spread: DVec3, rotation: DQuat, mean: DVec3) -> Moments {
        let mut m = [0.0; 10];
        for corner in 0..8 {
            let sign = |bit: i32| f64::from(corner >> bit & 1) * 2.0 - 1.0;
            let p = (mean + rotation * (DVec3::new(sign(0), sign(1), sign(2)) * spread)) * f64::from(STEPS);
            let [x, y, z] = p.round().to_array();
            let of = [1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z];
            m.iter_mut().zip(of).for_each(|(sum, v)| *sum += v);
        }
        m
    }

    fn plane_of(m: &Moments, vertex: DVec3, limits: Limits) -> Option<(Vec3, f32)> {
        let mut neighbourhoods = Neighbourhoods::default();
        neighbourhoods.set(2, m, vertex);
        let planes = neighbourhoods.planes(&limits);
        assert_eq!(planes.accepted & !4, 0, "empty lanes");
        (planes.accepted != 0).then(|| planes.plane(2))
    }

    const ANY: Limits = Limits {
        min_density: 0.0,
        min_spread: 0.01,
    };

    proptest! {
        #[test]
        fn normal_distance_and_density_are_those_of_the_eigenvectors(
            spread in prop::array::uniform3(0.02..2.0f64), axis in prop::array::uniform3(-1.0..1.0f64), angle in 0.0..3.0f64,
            mean in prop::array::uniform3(-8.0..8.0f64), off in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let rotation = DQuat::from_axis_angle(DVec3::from(axis).normalize_or(DVec3::X), angle);
            let m = moments(spread.into(), rotation, mean.into());
            let (n, step) = (m[0], f64::from(STEPS));
            let center = DVec3::new(m[1], m[2], m[3]) / (n * step);
            let c = |sum: usize, a: usize, b: usize| (n * m[sum] - m[a] * m[b]) / (n * step).powi(2);
            let covariance = DMat3::from_cols(
                DVec3::new(c(4, 1, 1), c(7, 1, 2), c(8, 1, 3)),
                DVec3::new(c(7, 1, 2), c(5, 2, 2), c(9, 2, 3)),
                DVec3::new(c(8, 1, 3), c(9, 2, 3), c(6, 3, 3)),
            );
            let expected = eigen(&covariance);
            let [l3, l2, l1] = expected.values;
            prop_assume!(l2 > 1.1 * l3 && l2 > 1e-3 && l2 - l3 > 1e-2 * l1); // else f32 does not tell e₃ from e₂
            let vertex = center + DVec3::from(off);
            let (normal, distance) = plane_of(&m, vertex, ANY).unwrap();
            let e3 = expected.vectors[0];
            let side = normal.as_dvec3().dot(e3);
            prop_assert!(side.abs() > 1.0 - 1e-5, "{side}");
            prop_assert!((f64::from(distance) - side.signum() * e3.dot(vertex - center)).abs() < 3e-3);
            let (a, b) = (expected.vectors[2].dot(vertex - center), expected.vectors[1].dot(vertex - center));
            let density = (-0.5 * (a * a / l1 + b * b / l2)).exp() / (std::f64::consts::TAU * (l1 * l2).sqrt());
            prop_assume!(density > 1e-6);
            let with = |factor: f64| Limits { min_density: (density * factor) as f32, ..ANY };
            prop_assert!(plane_of(&m, vertex, with(0.9)).is_some());
            prop_assert!(plane_of(&m, vertex, with(1.1)).is_none());
        }
    }

    #[test]
    fn points_on_a_line_or_in_one_place_span_no_plane() {
        let of = |spread| {
            plane_of(
                &moments(spread, DQuat::from_rotation_z(0.3), DVec3::ONE),
                DVec3::ONE,
                ANY,
            )
        };
        assert!(of(DVec3::new(1.0, 0.0, 0.0)).is_none());
        assert!(of(DVec3::ZERO).is_none());
        assert!(of(DVec3::new(1.0, 0.05, 0.0)).is_some());
        // No direction is the least one: some plane, and no NaN.
        let (normal, distance) = of(DVec3::ONE).unwrap();
        assert!(normal.is_finite() && distance.is_finite());
    }

    #[test]
    fn the_exponential_is_one() {
        for i in 0..=640 {
            let x = 0.1 * i as f32;
            let off = f64::from(exp(Vec4::splat(x)).x) / f64::from(x).exp() - 1.0;
            assert!(off.abs() < 3e-3, "{x}: {off}");
        }
    }
}
