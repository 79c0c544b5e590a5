//! The rigid motion that brings a trajectory closest to another one.

use nalgebra::Matrix4;
use tsdfuse::Pose;
use tsdfuse::glam::{DMat3, DQuat, DVec3};

/// Weight of orientations against positions, per m² of the positions' spread. Where the positions alone say how a trajectory is
/// turned, this is too little to matter; about a straight line, or a place, it decides.
const ORIENTATIONS: f64 = 1e-10;

/// `second_from_first`: the motion of the first poses of all pairs that leaves the least sum of squared distances between positions
/// (Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987).
pub(super) fn aligned(pairs: &[[Pose; 2]]) -> Pose {
    let count = pairs.len().max(1) as f64;
    let mean = |side: usize| pairs.iter().map(|pair| pair[side].translation).sum::<DVec3>() / count;
    let centres = [mean(0), mean(1)];
    // Σ b aᵀ: positions first.
    let (mut sum, mut spread) = (DMat3::ZERO, 0.0);
    for pair in pairs {
        let [a, b] = [0, 1].map(|side| pair[side].translation - centres[side]);
        sum += DMat3::from_cols(b * a.x, b * a.y, b * a.z);
        spread += b.length_squared();
    }
    let weight = ORIENTATIONS * (1.0 + spread / count);
    for [a, b] in pairs {
        sum += (DMat3::from_quat(b.rotation) * DMat3::from_quat(a.rotation).transpose()) * weight;
    }
    let rotation = turn(&sum);
    Pose {
        rotation,
        translation: centres[1] - rotation * centres[0],
    }
}

/// The rotation R that maximises tr(Rᵀ M): the eigenvector of Horn's matrix N with the largest eigenvalue.
fn turn(m: &DMat3) -> DQuat {
    // S of Horn's paper is Mᵀ: its first index is that of the first points.
    let s = m.transpose().to_cols_array_2d();
    let s = |a: usize, b: usize| s[b][a];
    let [x, y, z] = [s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0)];
    let [xy, yz, zx] = [s(0, 1) + s(1, 0), s(1, 2) + s(2, 1), s(2, 0) + s(0, 2)];
    let [xx, yy, zz] = [s(0, 0), s(1, 1), s(2, 2)];
    #[rustfmt::skip]
    let n = Matrix4::new(
        xx + yy + zz, x,            y,            z,
        x,            xx - yy - zz, xy,           zx,
        y,            xy,           yy - xx - zz, yz,
        z,            zx,           yz,           zz - xx - yy,
    );
    let eigen = n.symmetric_eigen();
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize()
}
