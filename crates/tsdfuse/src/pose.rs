//! Rigid transforms in `f64`, named by the frames they connect: `world_from_sensor`.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// How far a given rotation matrix may be from a rigid one: the largest entry of `RᵀR − I`.
///
/// Pose files print six or more significant digits, which leaves at most about 1e-5.
pub const RIGIDITY_TOLERANCE: f64 = 1e-3;

/// A rigid transform `a_from_b`: maps a point given in frame `b` to frame `a`. Metres, right-handed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Origin of frame `b` in frame `a`, metres.
    pub translation: DVec3,
}

/// Why twelve numbers are not a pose.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// A number is NaN or infinite.
    #[error("the pose holds a number that is not finite")]
    NotFinite,
    /// The matrix scales, shears or mirrors; the number is the largest entry of `|RᵀR − I|`, or the determinant's sign is wrong.
    #[error("the pose is not rigid: its 3x3 part is {0:.2e} away from a rotation")]
    NotRigid(f64),
}

impl Pose {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        translation: DVec3::ZERO,
    };

    /// Builds a pose from a unit quaternion (normalised here) and a translation in metres.
    ///
    /// # Errors
    /// [`PoseError::NotFinite`] for NaN or infinity, [`PoseError::NotRigid`] for a quaternion whose length is not 1 within
    /// [`RIGIDITY_TOLERANCE`].
    pub fn new(rotation: DQuat, translation: DVec3) -> Result<Self, PoseError> {
        if !rotation.is_finite() || !translation.is_finite() {
            return Err(PoseError::NotFinite);
        }
        let off = (rotation.length_squared() - 1.0).abs();
        if off > RIGIDITY_TOLERANCE {
            return Err(PoseError::NotRigid(off));
        }
        Ok(Self {
            rotation: rotation.normalize(),
            translation,
        })
    }

    /// Builds a pose from the 12 numbers of a row-major 3×4 matrix `[R | t]`, taking the nearest rotation to `R`.
    ///
    /// # Errors
    /// [`PoseError::NotFinite`] and [`PoseError::NotRigid`] (also for mirrored frames).
    pub fn from_row_major_3x4(m: &[f64; 12]) -> Result<Self, PoseError> {
        if m.iter().any(|v| !v.is_finite()) {
            return Err(PoseError::NotFinite);
        }
        let r = DMat3::from_cols_array(&[m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]]);
        let gram = r.transpose() * r - DMat3::IDENTITY;
        let off = gram.to_cols_array().iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        // NaN cannot pass (finite input may still overflow): `!(off <= …)` catches it.
        if !(off <= RIGIDITY_TOLERANCE) || r.determinant() < 0.0 {
            return Err(PoseError::NotRigid(if r.determinant() < 0.0 { 2.0 } else { off }));
        }
        Ok(Self {
            rotation: DQuat::from_mat3(&nearest_rotation(r)).normalize(),
            translation: DVec3::new(m[3], m[7], m[11]),
        })
    }

    /// The 12 numbers of the row-major 3×4 matrix `[R | t]`.
    pub fn to_row_major_3x4(&self) -> [f64; 12] {
        let r = DMat3::from_quat(self.rotation);
        let t = self.translation;
        let (x, y, z) = (r.x_axis, r.y_axis, r.z_axis);
        [x.x, y.x, z.x, t.x, x.y, y.y, z.y, t.y, x.z, y.z, z.z, t.z]
    }

    /// `a_from_b`: maps a point in `b` to `a`.
    pub fn transform_point(&self, point_in_b: DVec3) -> DVec3 {
        self.rotation * point_in_b + self.translation
    }

    /// `b_from_a`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl std::ops::Mul for Pose {
    type Output = Self;

    /// `a_from_b * b_from_c = a_from_c`.
    fn mul(self, b_from_c: Self) -> Self {
        Self {
            rotation: (self.rotation * b_from_c.rotation).normalize(),
            translation: self.transform_point(b_from_c.translation),
        }
    }
}

/// The rotation nearest to `r` (polar decomposition by Newton's iteration; `r` is known to be nearly one).
fn nearest_rotation(mut r: DMat3) -> DMat3 {
    for _ in 0..8 {
        r = (r + r.inverse().transpose()) * 0.5;
    }
    r
}

/// The motion from one pose to another at constant velocity: straight line and constant turn rate.
///
/// Also extrapolates, `s < 0` or `s > 1`.
#[derive(Clone, Copy, Debug)]
pub struct Interpolation {
    from: Pose,
    shift: DVec3,
    axis: DVec3,
    angle: f64,
}

impl Interpolation {
    /// Prepares the motion that is `from` at `s = 0` and `to` at `s = 1`, turning the shorter way.
    pub fn new(from: Pose, to: Pose) -> Self {
        let turn = from.rotation.conjugate() * to.rotation;
        let turn = if turn.w < 0.0 { -turn } else { turn };
        let sin_half = turn.xyz().length();
        let axis = if sin_half > 0.0 {
            turn.xyz() / sin_half
        } else {
            DVec3::X
        };
        Self {
            from,
            shift: to.translation - from.translation,
            axis,
            angle: 2.0 * sin_half.atan2(turn.w),
        }
    }

    /// The pose at `s`.
    pub fn at(&self, s: f64) -> Pose {
        Pose {
            rotation: self.rotation_at(s),
            translation: self.from.translation + self.shift_at(s),
        }
    }

    /// The rotation at `s`.
    pub fn rotation_at(&self, s: f64) -> DQuat {
        self.from.rotation * DQuat::from_axis_angle(self.axis, self.angle * s)
    }

    /// The translation at `s`, relative to the one at `s = 0`: exact at any distance from the world's origin.
    pub fn shift_at(&self, s: f64) -> DVec3 {
        self.shift * s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_pose() -> impl Strategy<Value = Pose> {
        (prop::array::uniform4(-1.0..1.0f64), prop::array::uniform3(-1e6..1e6f64)).prop_filter_map("zero", |(q, t)| {
            let q = DQuat::from_array(q);
            (q.length() > 0.1).then(|| Pose {
                rotation: q.normalize(),
                translation: t.into(),
            })
        })
    }

    proptest! {
        #[test]
        fn inverse_undoes(pose in any_pose(), p in prop::array::uniform3(-100.0..100.0f64)) {
            let p = DVec3::from(p);
            prop_assert!(pose.inverse().transform_point(pose.transform_point(p)).distance(p) < 1e-8);
        }

        #[test]
        fn matrix_round_trip(pose in any_pose()) {
            let back = Pose::from_row_major_3x4(&pose.to_row_major_3x4()).unwrap();
            prop_assert!(back.rotation.dot(pose.rotation).abs() > 1.0 - 1e-12);
            prop_assert_eq!(back.translation, pose.translation);
        }

        #[test]
        fn interpolation_meets_both_ends(a in any_pose(), b in any_pose()) {
            let i = Interpolation::new(a, b);
            for (s, want) in [(0.0, a), (1.0, b)] {
                prop_assert!(i.at(s).rotation.dot(want.rotation).abs() > 1.0 - 1e-9);
                prop_assert!(i.at(s).translation.distance(want.translation) < 1e-6);
            }
        }
    }

    #[test]
    fn six_digit_matrices_become_rotations() {
        let m = [
            0.999991,
            -0.00316351,
            -0.00274942,
            1.0,
            0.00316045,
            0.999994,
            -0.00111659,
            2.0,
            0.00275294,
            0.00110789,
            0.999996,
            3.0,
        ];
        let r = DMat3::from_quat(Pose::from_row_major_3x4(&m).unwrap().rotation);
        let off = (r.transpose() * r - DMat3::IDENTITY)
            .to_cols_array()
            .iter()
            .fold(0.0_f64, |a, v| a.max(v.abs()));
        assert!(off < 1e-14, "{off}");
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let mut m = Pose::IDENTITY.to_row_major_3x4();
        m[3] = f64::NAN;
        assert_eq!(Pose::from_row_major_3x4(&m), Err(PoseError::NotFinite));
        let scaled = [2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0];
        assert!(matches!(Pose::from_row_major_3x4(&scaled), Err(PoseError::NotRigid(_))));
        let mirrored = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0];
        assert!(matches!(
            Pose::from_row_major_3x4(&mirrored),
            Err(PoseError::NotRigid(_))
        ));
        assert!(Pose::from_row_major_3x4(&[1e200; 12]).is_err());
        assert!(Pose::new(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.5), DVec3::ZERO).is_err());
    }
}
