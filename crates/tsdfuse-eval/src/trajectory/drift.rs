//! Relative errors: how much is gained or lost over a length of the drive.

use serde::Serialize;
use tsdfuse::Pose;
use tsdfuse::glam::DQuat;

/// The lengths of KITTI's odometry benchmark, metres.
pub const KITTI_LENGTHS_M: [f64; 8] = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0];

/// The drift over pieces of the drive, relative to their length.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// The lengths of the pieces, metres: those for which there is one.
    pub lengths_m: Vec<f64>,
    /// The number of pieces.
    pub pieces: usize,
    /// The mean error of the position at a piece's end, per cent of its length.
    pub translation_percent: f64,
    /// The mean error of the orientation there, degrees per metre of its length.
    pub rotation_deg_per_m: f64,
}

/// The mean drift over all pieces of these lengths along the reference that begin at each `step`-th pose, as KITTI's development
/// kit has it; `None` if there are none. `distances_m` are those along the reference.
pub(super) fn drift(
    estimate: &[Pose],
    reference: &[Pose],
    distances_m: &[f64],
    lengths_m: &[f64],
    step: usize,
) -> Option<Drift> {
    let (mut pieces, mut translation, mut rotation, mut used) = (0, 0.0, 0.0, vec![false; lengths_m.len()]);
    for first in (0..reference.len()).step_by(step) {
        for (&length_m, used) in lengths_m.iter().zip(&mut used) {
            // The first pose beyond the length.
            let last = distances_m.partition_point(|&d| d <= distances_m[first] + length_m);
            if last >= reference.len() {
                break;
            }
            let pair = |i: usize| [estimate[i], reference[i]];
            let [metres, degrees] = between(&pair(first), &pair(last));
            translation += metres / length_m;
            rotation += degrees / length_m;
            (pieces, *used) = (pieces + 1, true);
        }
    }
    let used = lengths_m.iter().zip(used).filter(|(_, used)| *used);
    (pieces > 0).then(|| Drift {
        lengths_m: used.map(|(&length_m, _)| length_m).collect(),
        pieces,
        translation_percent: 100.0 * translation / pieces as f64,
        rotation_deg_per_m: rotation / pieces as f64,
    })
}

/// How much two motions from a first to a last pose differ, metres and degrees; each pair is one of the trajectory and of the
/// reference.
pub(super) fn between(first: &[Pose; 2], last: &[Pose; 2]) -> [f64; 2] {
    let [estimate, reference] = [0, 1].map(|side| first[side].inverse() * last[side]);
    let off = estimate.inverse() * reference;
    [off.translation.length(), angle_deg(off.rotation)]
}

/// The angle of a rotation, 0 to 180°.
pub(super) fn angle_deg(rotation: DQuat) -> f64 {
    (2.0 * rotation.xyz().length().atan2(rotation.w.abs())).to_degrees()
}
