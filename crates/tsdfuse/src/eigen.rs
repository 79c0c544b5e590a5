//! Eigenvalues and eigenvectors of symmetric 3×3 matrices, in closed form.
//!
//! The eigenvalues come from the trigonometric solution of the cubic (Smith 1961). Near a double root it loses half of the
//! digits, so the vectors are not found one by one: the one whose eigenvalue is best separated comes first, the other two
//! from the 2×2 matrix that is left in the plane across it (Eberly, "A Robust Eigensolver for 3×3 Symmetric Matrices").
//! Equal eigenvalues give some orthonormal vectors, always the same ones.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3};

use crate::sensor::approx::{atan2, sin_cos};

/// Eigenvalues in ascending order, and a unit eigenvector for each, at right angles to one another; their signs mean nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eigen {
    /// In ascending order.
    pub values: [f64; 3],
    /// One for each value, of length 1.
    pub vectors: [DVec3; 3],
}

/// A matrix as mean + spread·shape, where the shape has no trace and its largest eigenvalues are of size 1 to 2.
struct Parts {
    mean: f64,
    spread: f64,
    shape: DMat3,
    /// det(shape)/2, in [−1, 1]: 1 where the two smaller eigenvalues are equal, −1 where the two larger ones are.
    half_det: f64,
}

impl Parts {
    /// `None` for multiples of the identity.
    fn of(m: &DMat3) -> Option<Self> {
        let scale = m.to_cols_array().iter().fold(0.0_f64, |max, x| max.max(x.abs()));
        if !(scale > f64::MIN_POSITIVE) {
            return None;
        }
        let unit = *m * (1.0 / scale);
        let mean = (unit.x_axis.x + unit.y_axis.y + unit.z_axis.z) / 3.0;
        let rest = unit - DMat3::from_diagonal(DVec3::splat(mean));
        let squares = rest.x_axis.length_squared() + rest.y_axis.length_squared() + rest.z_axis.length_squared();
        let spread = (squares / 6.0).sqrt();
        // Less is rounding.
        if spread < f64::EPSILON {
            return None;
        }
        let shape = rest * (1.0 / spread);
        Some(Self {
            mean: mean * scale,
            spread: spread * scale,
            shape,
            half_det: (0.5 * shape.determinant()).clamp(-1.0, 1.0),
        })
    }

    /// The shape's eigenvalues, ascending.
    fn roots(&self) -> [f64; 3] {
        let h = self.half_det;
        let angle = atan2(((1.0 - h) * (1.0 + h)).sqrt(), h) / 3.0;
        let high = 2.0 * sin_cos(angle).1;
        let low = 2.0 * sin_cos(angle + TAU / 3.0).1;
        [low, -low - high, high]
    }

    fn value(&self, root: f64) -> f64 {
        self.mean + self.spread * root
    }
}

/// Eigenvalues and eigenvectors of a symmetric matrix of finite numbers.
pub fn eigen(m: &DMat3) -> Eigen {
    let Some(parts) = Parts::of(m) else {
        return Eigen {
            values: [m.x_axis.x; 3],
            vectors: [DVec3::X, DVec3::Y, DVec3::Z],
        };
    };
    let a = &parts.shape;
    let roots = parts.roots();
    // The gap to the other two is at least √3.
    let highest_is_lone = parts.half_det >= 0.0;
    let lone = null_vector(&(*a - DMat3::from_diagonal(DVec3::splat(roots[if highest_is_lone { 2 } else { 0 }]))));
    let (u, v) = lone.any_orthonormal_pair();
    let (au, av) = (*a * u, *a * v);
    let (low, high) = in_plane((u, v), (u.dot(au), u.dot(av), v.dot(av)));
    let lone = (lone.dot(*a * lone), lone);
    let all = if highest_is_lone {
        [low, high, lone]
    } else {
        [lone, low, high]
    };
    Eigen {
        values: all.map(|(root, _)| parts.value(root)),
        vectors: all.map(|(_, vector)| vector),
    }
}

/// The unit vector that a symmetric matrix of rank 2 maps to zero.
fn null_vector(m: &DMat3) -> DVec3 {
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    let mut best = x.cross(y);
    for other in [y.cross(z), z.cross(x)] {
        if other.length_squared() > best.length_squared() {
            best = other;
        }
    }
    best.normalize_or(DVec3::X)
}

/// Eigenvalues and eigenvectors of (uu, uv; uv, vv) in the plane of the unit vectors u and v, the smaller value first: one
/// Jacobi rotation.
fn in_plane((u, v): (DVec3, DVec3), (uu, uv, vv): (f64, f64, f64)) -> ((f64, DVec3), (f64, DVec3)) {
    let tan = if uv == 0.0 {
        0.0
    } else {
        let cot_double = (vv - uu) / (2.0 * uv);
        1.0_f64.copysign(cot_double) / (cot_double.abs() + (cot_double * cot_double + 1.0).sqrt())
    };
    let cos = 1.0 / (tan * tan + 1.0).sqrt();
    let sin = tan * cos;
    let a = (uu - tan * uv, u * cos - v * sin);
    let b = (vv + tan * uv, u * sin + v * cos);
    if a.0 <= b.0 { (a, b) } else { (b, a) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Cyclic Jacobi rotations until nothing is left off the diagonal: slow, and right.
    fn jacobi(m: &DMat3) -> Eigen {
        let mut a = m.to_cols_array_2d();
        let mut v = DMat3::IDENTITY.to_cols_array_2d();
        for (p, q) in [(0, 1), (0, 2), (1, 2)].into_iter().cycle().take(60) {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = 1.0_f64.copysign(theta) / (theta.abs() + theta.hypot(1.0));
            let (c, s) = (1.0 / t.hypot(1.0), t / t.hypot(1.0));
            for row in &mut a {
                let (x, y) = (row[p], row[q]);
                (row[p], row[q]) = (c * x - s * y, s * x + c * y);
            }
            for col in 0..3 {
                let (x, y) = (a[p][col], a[q][col]);
                (a[p][col], a[q][col]) = (c * x - s * y, s * x + c * y);
                let (x, y) = (v[p][col], v[q][col]);
                (v[p][col], v[q][col]) = (c * x - s * y, s * x + c * y);
            }
        }
        let mut pairs: Vec<_> = (0..3).map(|i| (a[i][i], DVec3::from(v[i]))).collect();
        pairs.sort_by(|x, y| x.0.total_cmp(&y.0));
        Eigen {
            values: [0, 1, 2].map(|i| pairs[i].0),
            vectors: [0, 1, 2].map(|i| pairs[i].1),
        }
    }

    fn norm(m: &DMat3) -> f64 {
        m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    /// How wrong a solution is, as a share of the matrix: A·v = λ·v, V·Vᵀ = 1, ascending.
    fn error(m: &DMat3, e: &Eigen) -> f64 {
        let norm = norm(m).max(f64::MIN_POSITIVE);
        let basis = DMat3::from_cols(e.vectors[0], e.vectors[1], e.vectors[2]);
        let crooked = (basis * basis.transpose() - DMat3::IDENTITY).to_cols_array();
        let residuals = (0..3).map(|i| (*m * e.vectors[i] - e.values[i] * e.vectors[i]).length() / norm);
        let descents = e.values.windows(2).map(|w| (w[0] - w[1]) / norm);
        residuals
            .chain(descents)
            .chain(crooked.map(f64::abs))
            .fold(0.0, f64::max)
    }

    fn symmetric([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> DMat3 {
        DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz))
    }

    /// Matrices of all kinds: full, of rank 1 and 2, nearly and exactly isotropic, of whole numbers, tiny and huge.
    fn any_symmetric() -> impl Strategy<Value = DMat3> {
        let entries = prop_oneof![
            prop::array::uniform6(-1.0..1.0f64),
            prop::array::uniform6((-2..=2i32).prop_map(f64::from)),
            prop::array::uniform3((-2..=2i32).prop_map(f64::from)).prop_map(|[a, b, c]| [a, b, c, 0.0, 0.0, 0.0]),
            prop::array::uniform3(-1.0..1.0f64).prop_map(|[x, y, z]| [x * x, y * y, z * z, x * y, x * z, y * z]),
            (prop::array::uniform3(-1.0..1.0f64), 0..18i32).prop_map(|([x, y, z], digits)| {
                let little = 10.0_f64.powi(-digits);
                [
                    1.0 + little * x,
                    1.0 + little * y,
                    1.0 + little * z,
                    little * x,
                    little * y,
                    little * z,
                ]
            }),
        ];
        (entries, -30..30i32).prop_map(|(entries, power)| symmetric(entries) * 10.0_f64.powi(power))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn closed_form_and_iteration_agree(m in any_symmetric()) {
            let (fast, slow) = (eigen(&m), jacobi(&m));
            prop_assert!(error(&m, &slow) < 1e-13, "the oracle is wrong: {}", error(&m, &slow));
            prop_assert!(error(&m, &fast) < 1e-13, "{} {fast:?}", error(&m, &fast));
            for i in 0..3 {
                prop_assert!((fast.values[i] - slow.values[i]).abs() <= 1e-13 * norm(&m));
            }
            // The roots alone lose half of the digits where two are nearly equal.
            if let Some(parts) = Parts::of(&m) {
                for (root, value) in parts.roots().into_iter().zip(slow.values) {
                    prop_assert!((parts.value(root) - value).abs() <= 1e-7 * norm(&m));
                }
            }
        }
    }

    #[test]
    fn a_wrong_solution_would_be_seen() {
        let m = symmetric([3.0, 2.0, 1.0, 0.1, 0.2, 0.3]);
        let right = eigen(&m);
        assert!(error(&m, &right) < 1e-14);
        let swapped = Eigen {
            vectors: [right.vectors[1], right.vectors[0], right.vectors[2]],
            ..right
        };
        let unsorted = Eigen {
            values: [right.values[1], right.values[0], right.values[2]],
            ..swapped
        };
        let long = Eigen {
            vectors: right.vectors.map(|v| v * 1.001),
            ..right
        };
        assert!([swapped, unsorted, long].iter().all(|wrong| error(&m, wrong) > 1e-4));
    }

    #[test]
    fn a_plane_has_the_normal_one_expects() {
        // Points on z = 2x: the normal is (-2, 0, 1)/√5.
        let e = eigen(&symmetric([1.0, 3.0, 4.0, 0.0, 2.0, 0.0]));
        assert!(e.values[0].abs() < 1e-15);
        assert!((e.vectors[0].dot(DVec3::new(-2.0, 0.0, 1.0)).abs() - 5.0_f64.sqrt()).abs() < 1e-14);
    }

    #[test]
    fn nothing_and_the_same_everywhere_have_axes_too() {
        for diagonal in [0.0, 7.0, -1e-300, 5e-324] {
            let m = DMat3::from_diagonal(DVec3::splat(diagonal));
            let e = eigen(&m);
            assert_eq!(e.values, [diagonal; 3]);
            assert!(e.vectors.iter().all(|v| v.is_normalized()));
        }
    }
}
