//! The sensor's motion during a sweep as kernels see it: `shaders/frame.wgsl` has the same layout.

use bytemuck::{Pod, Zeroable};
use glam::{DQuat, Vec3};
use tsdfuse::{Scan, scan::PoseAt};

/// The motion between two neighbouring poses. It starts at the one nearer to time 0, as in [`tsdfuse::scan::Sweep`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Segment {
    /// The time up to which it is used; the last segment is used beyond it, too.
    pub(crate) until_secs: f32,
    /// The time of the pose that it starts at.
    pub(crate) from_secs: f32,
    /// Radians a second.
    pub(crate) turn_rate: f32,
    /// From the scan's position to that pose's, metres.
    pub(crate) shift: [f32; 3],
    /// Metres a second, world axes.
    pub(crate) velocity: [f32; 3],
    pub(crate) turn_axis: [f32; 3],
    /// That pose's rotation relative to the scan's: a quaternion, x, y, z, w.
    pub(crate) rotation: [f32; 4],
}

/// The segments of a scan's motion, in order of time; none if all returns are placed from the scan's pose.
pub(crate) fn segments(scan: &Scan) -> Vec<Segment> {
    let (Some(sweep), Some(pose)) = (scan.sweep(), scan.pose) else {
        return Vec::new();
    };
    let own = PoseAt { secs: 0.0, pose };
    let (before, after) = scan.motion.split_at(scan.motion.partition_point(|m| m.secs < 0.0));
    let poses: Vec<PoseAt> = before.iter().chain([&own]).chain(after).copied().collect();
    let segment = |ends: &[PoseAt]| {
        let (&[earlier, later] | &[earlier, .., later]) = ends else {
            return Segment::default();
        };
        let (from, to) = if later.secs <= 0.0 {
            (later, earlier)
        } else {
            (earlier, later)
        };
        let secs = to.secs - from.secs;
        let (rotation, shift) = sweep.relative_at(to.secs);
        let from_shift = from.pose.translation - pose.translation;
        let (axis, angle) = rotation_vector(from.pose.rotation.conjugate() * rotation);
        Segment {
            until_secs: later.secs as f32,
            from_secs: from.secs as f32,
            turn_rate: (angle / secs) as f32,
            shift: from_shift.as_vec3().into(),
            velocity: ((shift - from_shift) / secs).as_vec3().into(),
            turn_axis: axis.into(),
            rotation: if from.secs == 0.0 {
                DQuat::IDENTITY.as_quat().into()
            } else {
                (pose.rotation.conjugate() * from.pose.rotation).as_quat().into()
            },
        }
    };
    poses.windows(2).map(segment).collect()
}

/// Axis and angle of a rotation, the shorter way.
fn rotation_vector(turn: DQuat) -> (Vec3, f64) {
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let sin_half = turn.xyz().length();
    let axis = (turn.xyz() / sin_half.max(f64::MIN_POSITIVE)).as_vec3();
    (axis, 2.0 * sin_half.atan2(turn.w))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::{Pose, glam::DVec3};

    fn pose(x: f64, yaw: f64) -> Pose {
        Pose {
            rotation: DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(0.3 * yaw),
            translation: DVec3::new(1e6 + x, x * x, -2.0),
        }
    }

    fn scan(motion: &[(f64, f64, f64)]) -> Scan {
        let at = |&(secs, x, yaw): &(f64, f64, f64)| PoseAt {
            secs,
            pose: pose(x, yaw),
        };
        Scan {
            pose: Some(pose(0.0, 0.1)),
            motion: motion.iter().map(at).collect(),
            times: Some(Vec::new()),
            ..Default::default()
        }
    }

    /// What the kernels compute from a segment, in f64.
    fn moved(segment: &Segment, secs: f64) -> (DQuat, DVec3) {
        let vector = |v: [f32; 3]| Vec3::from(v).as_dvec3();
        let since = secs - f64::from(segment.from_secs);
        let base = glam::Quat::from_array(segment.rotation).as_dquat();
        let turn = DQuat::from_axis_angle(vector(segment.turn_axis), f64::from(segment.turn_rate) * since);
        (base * turn, vector(segment.shift) + vector(segment.velocity) * since)
    }

    #[test]
    fn segments_are_the_cpus_motion() {
        let five = [(-0.05, -0.7, -0.1), (0.02, 0.1, 0.1), (0.05, 0.9, 0.4), (0.1, 1.0, 0.2)];
        for motion in [&five[..], &five[3..], &five[..1], &five[..2]] {
            let scan = scan(motion);
            let (sweep, segments) = (scan.sweep().unwrap(), segments(&scan));
            assert_eq!(segments.len(), motion.len());
            let first = scan.pose.unwrap().rotation;
            let worst = |segments: &[Segment]| {
                let off = (-80..=130).map(|ms| {
                    let secs = 0.001 * f64::from(ms) + 1e-5;
                    let last = segments.len() - 1;
                    let at = segments[..last].partition_point(|s| f64::from(s.until_secs) < secs);
                    let (rotation, shift) = moved(&segments[at], secs);
                    let (want_rotation, want_shift) = sweep.relative_at(secs);
                    (first * rotation).angle_between(want_rotation) + shift.distance(want_shift)
                });
                off.fold(0.0, f64::max)
            };
            assert!(worst(&segments) < 1e-5, "{}", worst(&segments));
            // A single segment that is wrong is seen.
            for k in 0..segments.len() {
                let mut wrong = segments.clone();
                wrong[k].velocity[0] += 0.1;
                assert!(worst(&wrong) > 1e-4, "{k}");
            }
        }
    }

    #[test]
    fn one_further_pose_moves_from_the_scans_own() {
        let scan = scan(&[(-0.1, 1.0, 0.3)]);
        let segment = segments(&scan)[0];
        assert_eq!((segment.shift, segment.rotation), ([0.0; 3], [0.0, 0.0, 0.0, 1.0]));
        assert_eq!((segment.from_secs, segment.until_secs), (0.0, 0.0));
        let mut still = scan;
        still.motion.clear();
        assert!(segments(&still).is_empty());
    }
}
