//! Planes through the returns of windows, sixteen windows side by side.

use glam::Vec3;

use super::sums::Sums;
use crate::lanes::{Floats, LANES, Mask, Vectors, lanes};

/// Planes of least squares: of the sums over points, the mean, the normal (the eigenvector of the covariance's least eigenvalue)
/// and the eigenvalues.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planes {
    /// Of unit length; NaN if there is no plane.
    pub(super) normal: Vectors,
    /// Mean, from a point that is near.
    pub(super) mean: Vectors,
    /// Mean square of the distances to the plane, with three degrees of freedom less.
    pub(super) residual2: Floats,
    /// The middle eigenvalue: the mean square of how far points lie from the line through them.
    pub(super) spread2: Floats,
    pub(super) count: Floats,
}

/// What is known of points, for sixteen planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moments {
    sums: [[f64; LANES]; 10],
    /// A point that is near, for each.
    near: Vectors,
}

impl Moments {
    pub(super) const NONE: Self = Self {
        sums: [[0.0; LANES]; 10],
        near: Vectors::ZERO,
    };

    /// How many points there are.
    pub(super) fn count(&self, lane: usize) -> f32 {
        self.sums[0][lane] as f32
    }

    /// Puts in the sums of points, and one that is near.
    #[inline(always)]
    pub(super) fn set(&mut self, lane: usize, sums: &Sums, near: Vec3) {
        for (all, sum) in self.sums.iter_mut().zip(sums) {
            all[lane % LANES] = *sum;
        }
        self.near.set(lane, near);
    }

    /// The planes.
    ///
    /// The least eigenvalue's vector is the greatest one's of the matrix of cofactors, which becomes a product n·nᵀ as it is
    /// squared again and again; three times make 8th powers of eigenvalues, of which there is hardly another one left where
    /// points lie in a plane.
    #[inline(always)]
    pub(super) fn planes(&self) -> Planes {
        let [count, x, y, z, xx, xy, xz, yy, yz, zz] = &self.sums;
        let inverse = lanes(|l| 1.0 / count[l].max(1.0));
        let (x, y, z) = (
            lanes(|l| x[l] * inverse[l]),
            lanes(|l| y[l] * inverse[l]),
            lanes(|l| z[l] * inverse[l]),
        );
        let mean = vectors(
            lanes(|l| (x[l] - f64::from(self.near.x[l])) as f32),
            lanes(|l| (y[l] - f64::from(self.near.y[l])) as f32),
            lanes(|l| (z[l] - f64::from(self.near.z[l])) as f32),
        );
        let xx = lanes(|l| (xx[l] * inverse[l] - x[l] * x[l]) as f32);
        let xy = lanes(|l| (xy[l] * inverse[l] - x[l] * y[l]) as f32);
        let xz = lanes(|l| (xz[l] * inverse[l] - x[l] * z[l]) as f32);
        let yy = lanes(|l| (yy[l] * inverse[l] - y[l] * y[l]) as f32);
        let yz = lanes(|l| (yz[l] * inverse[l] - y[l] * z[l]) as f32);
        let zz = lanes(|l| (zz[l] * inverse[l] - z[l] * z[l]) as f32);
        let count = lanes(|l| count[l] as f32);
        let cofactors = [
            minor(yy, zz, yz, yz),
            minor(xz, yz, xy, zz),
            minor(xy, yz, xz, yy),
            minor(xx, zz, xz, xz),
            minor(xy, xz, xx, yz),
            minor(xx, yy, xy, xy),
        ];
        let power = squared(squared(squared(cofactors)));
        // The longest column: that of the greatest element on the diagonal.
        let [pxx, pxy, pxz, pyy, pyz, pzz] = power;
        let x = lanes(|l| pxx[l] >= pyy[l] && pxx[l] >= pzz[l]);
        let y = lanes(|l| pyy[l] >= pzz[l]);
        let normal = Vectors {
            x: choose(x, pxx, choose(y, pxy, pxz)),
            y: choose(x, pxy, choose(y, pyy, pyz)),
            z: choose(x, pxz, choose(y, pyz, pzz)),
        };
        let normal = normal.scale(normal.inverse_length());
        let across = vectors(
            normal.dot(vectors(xx, xy, xz)),
            normal.dot(vectors(xy, yy, yz)),
            normal.dot(vectors(xz, yz, zz)),
        );
        let least = across.dot(normal);
        let least = lanes(|l| least[l].max(0.0));
        // The two others have this sum and this product.
        let sum = lanes(|l| xx[l] + yy[l] + zz[l] - least[l]);
        let product = lanes(|l| cofactors[0][l] + cofactors[3][l] + cofactors[5][l] - least[l] * sum[l]);
        let greater = lanes(|l| 0.5 * (sum[l] + (sum[l] * sum[l] - 4.0 * product[l]).max(0.0).sqrt()));
        Planes {
            normal,
            mean,
            residual2: lanes(|l| least[l] * count[l] / (count[l] - 3.0)),
            spread2: lanes(|l| product[l] / greater[l]),
            count,
        }
    }
}

/// a·b − c·d.
#[inline(always)]
fn minor(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats {
    lanes(|l| a[l] * b[l] - c[l] * d[l])
}

/// a where the mask is set, else b.
#[inline(always)]
fn choose(mask: Mask, a: Floats, b: Floats) -> Floats {
    lanes(|l| if mask[l] { a[l] } else { b[l] })
}

/// The square of a symmetric matrix, scaled to a trace of 1 before.
#[inline(always)]
fn squared(matrix: [Floats; 6]) -> [Floats; 6] {
    let [xx, xy, xz, yy, yz, zz] = matrix;
    let scale = lanes(|l| 1.0 / (xx[l] + yy[l] + zz[l]));
    let x = vectors(xx, xy, xz).scale(scale);
    let y = vectors(xy, yy, yz).scale(scale);
    let z = vectors(xz, yz, zz).scale(scale);
    [x.dot(x), x.dot(y), x.dot(z), y.dot(y), y.dot(z), z.dot(z)]
}

#[inline(always)]
fn vectors(x: Floats, y: Floats, z: Floats) -> Vectors {
    Vectors { x, y, z }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eigen::eigen;
    use glam::{DMat3, DQuat, DVec3};
    use proptest::prelude::*;

    fn sums_of(points: &[DVec3]) -> Sums {
        let mut sums = [0.0; 10];
        for p in points {
            let [x, y, z] = p.to_array();
            let all = [1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
            sums.iter_mut().zip(all).for_each(|(sum, add)| *sum += add);
        }
        sums
    }

    /// Mean, normal, mean squared residual and spread, by a solver of eigenvalues.
    fn literal(points: &[DVec3]) -> (DVec3, DVec3, f64, f64) {
        let n = points.len() as f64;
        let mean = points.iter().sum::<DVec3>() / n;
        let outer = |d: DVec3| DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        let covariance = points.iter().fold(DMat3::ZERO, |sum, p| sum + outer(p - mean)) * (1.0 / n);
        let e = eigen(&covariance);
        (mean, e.vectors[0], e.values[0].max(0.0) * n / (n - 3.0), e.values[1])
    }

    /// Points about a plane of some size, thickness and place.
    fn any_points() -> impl Strategy<Value = Vec<DVec3>> {
        let unit = || -1.0..1.0f64;
        let points = prop::collection::vec((unit(), unit(), unit()), 6..60);
        let turn = (unit(), unit(), unit(), unit()).prop_filter("a turn", |q| q.0.abs() + q.1.abs() > 0.1);
        (
            points,
            turn,
            prop::array::uniform3(-80.0..80.0f64),
            0.05..0.5f64,
            0.3..1.0f64,
            0.0..0.03f64,
        )
            .prop_map(|(points, (x, y, z, w), place, long, wide, thick)| {
                let turn = DQuat::from_xyzw(x, y, z, w).normalize();
                let at = |(a, b, c): (f64, f64, f64)| {
                    DVec3::from(place) + turn * DVec3::new(long * a, long * wide * b, thick * c)
                };
                points.into_iter().map(at).collect()
            })
    }

    proptest! {
        #[test]
        fn planes_are_those_of_a_solver_of_eigenvalues(clouds in prop::collection::vec(any_points(), 1..=LANES)) {
            let mut moments = Moments::NONE;
            for (lane, points) in clouds.iter().enumerate() {
                moments.set(lane, &sums_of(points), points[0].as_vec3());
            }
            let planes = moments.planes();
            for (lane, points) in clouds.iter().enumerate() {
                let (mean, normal, residual2, spread2) = literal(points);
                // Other eigenvectors are left over where eigenvalues are alike.
                let tolerance = if spread2 > 4.0 * residual2 { 2e-3 } else { 0.1 };
                let near = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-6 + tolerance * b;
                prop_assert!(near(planes.residual2[lane], residual2), "{} {residual2}", planes.residual2[lane]);
                prop_assert!(near(planes.spread2[lane], spread2), "{} {spread2}", planes.spread2[lane]);
                prop_assert!((planes.mean.get(lane).as_dvec3() - (mean - points[0])).length() < 1e-4);
                prop_assert_eq!(planes.count[lane], points.len() as f32);
                // Where it is a plane at all.
                if spread2 > 4.0 * residual2 {
                    let off = planes.normal.get(lane).as_dvec3().dot(normal).abs();
                    prop_assert!((off - 1.0).abs() < 1e-5, "{off}");
                }
            }
        }
    }

    #[test]
    fn points_on_a_line_or_too_few_are_no_plane() {
        let mut moments = Moments::NONE;
        let line: Vec<DVec3> = (0..20).map(|i| DVec3::new(1.0, 2.0, 3.0) * f64::from(i)).collect();
        moments.set(0, &sums_of(&line), Vec3::ZERO);
        moments.set(1, &sums_of(&line[..1]), Vec3::ZERO);
        let planes = moments.planes();
        assert!(!(planes.spread2[0] > 1e-3), "{}", planes.spread2[0]);
        assert!(!(planes.spread2[1] > 1e-3) && planes.count[1] == 1.0);
    }
}
