use std::f64::consts::TAU;

use proptest::prelude::*;
use tsdfuse::Trajectory;
use tsdfuse::glam::{DQuat, DVec3};

use super::*;

/// Three laps of a circle of radius 100 m, a pose each metre, 10 Hz; it climbs 1 cm a metre.
fn circle() -> Vec<Pose> {
    let pose = |i: i32| {
        let angle = f64::from(i) / 100.0;
        Pose {
            rotation: DQuat::from_rotation_z(angle),
            translation: DVec3::new(100.0 * angle.sin(), -100.0 * angle.cos(), 0.01 * f64::from(i)),
        }
    };
    (0..(300.0 * TAU) as i32).map(pose).collect()
}

fn timed(poses: &[Pose], from_ns: i64) -> Poses {
    let times = (0..).map(|i| from_ns + 100_000_000 * i);
    Poses::Timed(Trajectory::new(times.zip(poses.iter().copied()).collect()).unwrap())
}

fn elsewhere() -> Pose {
    Pose {
        rotation: DQuat::from_euler(tsdfuse::glam::EulerRot::ZYX, 2.0, -0.4, 0.9),
        translation: DVec3::new(-3e5, 4e6, 77.0),
    }
}

fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance
}

#[test]
fn another_world_is_no_error() {
    let truth = circle();
    let moved: Vec<Pose> = truth.iter().map(|&pose| elsewhere() * pose).collect();
    let found = compare(&Poses::Listed(moved.clone()), &Poses::Listed(truth.clone()), true).unwrap();
    let back = found.alignment.unwrap() * elsewhere();
    assert!(
        back.translation.length() < 1e-5 && angle(back.rotation) < 1e-9,
        "{back:?}"
    );
    assert!(
        found.absolute_m.max < 1e-6 && found.absolute_deg.max < 1e-6,
        "{found:?}"
    );
    assert!(found.last_m < 1e-6 && found.last_deg < 1e-6);
    assert!(found.kitti.unwrap().translation_percent < 1e-6);
    // Unless they are said to be of one world.
    let found = compare(&Poses::Listed(moved), &Poses::Listed(truth), false).unwrap();
    assert!(found.alignment.is_none() && found.absolute_m.max > 4e6, "{found:?}");
}

fn angle(rotation: DQuat) -> f64 {
    drift::angle_deg(rotation)
}

/// Every other pose is 3 cm too high, the others 3 cm too low, and all look 0.5° too far up or down.
#[test]
fn errors_are_those_that_were_made() {
    let truth = circle();
    let off = |(i, pose): (usize, &Pose)| {
        let sign: f64 = if i % 2 == 0 { 1.0 } else { -1.0 };
        Pose {
            rotation: pose.rotation * DQuat::from_rotation_y((0.5 * sign).to_radians()),
            translation: pose.translation + DVec3::Z * 0.03 * sign,
        }
    };
    let track: Vec<Pose> = truth.iter().enumerate().map(off).collect();
    let found = compare(&Poses::Listed(track), &Poses::Listed(truth), true).unwrap();
    for (figure, want) in [
        (found.absolute_m.rmse, 0.03),
        (found.absolute_m.median, 0.03),
        (found.absolute_deg.mean, 0.5),
        (found.absolute_deg.max, 0.5),
    ] {
        assert!(close(figure, want, 1e-4), "{found:?}");
    }
    assert_eq!((found.poses, found.left_out, found.seconds), (1884, 0, None));
    // Chords of a metre's arc, a metre less of them than poses, climbing.
    let chord = (200.0 * 0.005f64.sin()).hypot(0.01);
    assert!(close(found.distance_m, 1883.0 * chord, 1e-6), "{}", found.distance_m);
}

/// All of it is one per cent too long: so is every piece. The orientation gains 0.01° a metre.
#[test]
fn drift_is_relative_to_the_length() {
    let pose = |scale: f64, turn: f64| {
        move |i: i32| Pose {
            rotation: DQuat::from_rotation_x((turn * f64::from(i)).to_radians()),
            translation: DVec3::new(scale * f64::from(i), 0.0, 0.0),
        }
    };
    let truth: Vec<Pose> = (0..=300).map(pose(1.0, 0.0)).collect();
    let track: Vec<Pose> = (0..=300).map(pose(1.01, 0.01)).collect();
    let found = compare(&Poses::Listed(track), &Poses::Listed(truth), true).unwrap();
    // A piece is one pose longer than its length, as in KITTI's development kit.
    let expected = |lengths: &[f64], starts: &dyn Fn(f64) -> usize| {
        let counts: Vec<usize> = lengths.iter().map(|&l| starts(l)).collect();
        let sum: f64 = lengths
            .iter()
            .zip(&counts)
            .map(|(l, &n)| n as f64 * (l + 1.0) / l)
            .sum();
        let pieces = counts.iter().sum::<usize>();
        (pieces, sum / pieces as f64)
    };
    let kitti = found.kitti.unwrap();
    let (pieces, share) = expected(&[100.0, 200.0], &|length| ((299.0 - length) / 10.0) as usize + 1);
    assert_eq!(
        (kitti.lengths_m.as_slice(), kitti.pieces),
        (&[100.0, 200.0][..], pieces)
    );
    assert!(close(kitti.translation_percent, share, 1e-9), "{kitti:?}");
    assert!(close(kitti.rotation_deg_per_m, 0.01 * share, 1e-9), "{kitti:?}");
    let [ten, fifty] = found.drift.try_into().unwrap();
    for (drift, length) in [(ten, 10.0), (fifty, 50.0)] {
        assert_eq!((drift.lengths_m, drift.pieces), (vec![length], 300 - length as usize));
        assert!(close(drift.translation_percent, (length + 1.0) / length, 1e-9));
    }
    assert!(close(found.last_m, 3.0, 1e-9) && close(found.last_deg, 3.0, 1e-9));
}

/// Positions alone do not say how a straight drive is turned about itself, nor a place at all.
#[test]
fn orientations_decide_what_positions_leave_open() {
    for length in [1.0, 0.0] {
        let pose = |i: i32| Pose {
            rotation: DQuat::from_rotation_z(0.01 * f64::from(i)),
            translation: DVec3::X * (length * f64::from(i)),
        };
        let truth: Vec<Pose> = (0..50).map(pose).collect();
        let moved: Vec<Pose> = truth.iter().map(|&pose| elsewhere() * pose).collect();
        let found = compare(&Poses::Listed(moved), &Poses::Listed(truth), true).unwrap();
        assert!(
            found.absolute_m.max < 1e-4 && found.absolute_deg.max < 1e-3,
            "{length}: {found:?}"
        );
    }
}

#[test]
fn poses_are_matched_by_time_or_else_by_order() {
    let truth = circle();
    let reference = timed(&truth, 0);
    // Half a step later, and longer than the reference.
    let timeline = Trajectory::new(
        truth
            .iter()
            .enumerate()
            .map(|(i, &pose)| (100_000_000 * i as i64, pose))
            .collect(),
    );
    let between: Vec<Pose> = (1..truth.len() as i64)
        .map(|i| timeline.as_ref().unwrap().at(100_000_000 * i - 50_000_000).unwrap())
        .chain([Pose::IDENTITY; 3])
        .collect();
    let found = compare(&timed(&between, 50_000_000), &reference, false).unwrap();
    assert_eq!((found.poses, found.left_out), (truth.len() - 1, 3));
    assert!(close(found.seconds.unwrap(), 188.2, 1e-9), "{:?}", found.seconds);
    assert!(found.absolute_m.max < 1e-9, "{:?}", found.absolute_m);

    let told = |a: &Poses, b: &Poses| compare(a, b, true).unwrap_err().to_string();
    assert_eq!(
        told(&Poses::Listed(truth[..7].to_vec()), &reference),
        "7 poses and 1884 of the reference, and not both have times: they cannot be matched"
    );
    assert_eq!(
        told(&timed(&truth[..3], 1_000_000_000_000), &reference),
        "no pose has a time within the reference: the poses run from 1000.000 to 1000.200 s, the reference from 0.000 to 188.300 s"
    );
    assert_eq!(
        told(&Poses::Listed(vec![]), &Poses::Listed(vec![])),
        "there are no poses"
    );
    let mut bad = truth.clone();
    bad[5].translation.x = f64::NAN;
    assert_eq!(
        told(&Poses::Listed(bad), &reference),
        "pose 5 holds a number that is not finite"
    );
    assert!(compare(&Poses::Listed(truth), &reference, true).is_ok());
}

#[test]
fn short_drives_have_no_drift() {
    let found = compare(
        &Poses::Listed(circle()[..5].to_vec()),
        &Poses::Listed(circle()[..5].to_vec()),
        true,
    )
    .unwrap();
    assert!(found.drift.is_empty() && found.kitti.is_none());
    let one = Poses::Listed(vec![elsewhere()]);
    let found = compare(&one, &Poses::Listed(vec![Pose::IDENTITY]), true).unwrap();
    assert!(found.absolute_m.max < 1e-6 && found.absolute_deg.max < 1e-6 && found.last_m == 0.0);
}

proptest! {
    /// No small motion after the alignment makes the sum of squares less.
    #[test]
    fn the_alignment_is_the_best(
        errors in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 30),
        turn in prop::array::uniform3(-0.01..0.01f64),
        shift in prop::array::uniform3(-0.1..0.1f64),
    ) {
        let truth: Vec<Pose> = circle().into_iter().step_by(60).take(30).collect();
        let off = |(pose, error): (&Pose, &[f64; 3])| elsewhere() * Pose {
            translation: pose.translation + DVec3::from(*error),
            ..*pose
        };
        let track: Vec<Pose> = truth.iter().zip(&errors).map(off).collect();
        let found = compare(&Poses::Listed(track.clone()), &Poses::Listed(truth.clone()), true).unwrap();
        let other = Pose {
            rotation: DQuat::from_scaled_axis(DVec3::from(turn)),
            translation: DVec3::from(shift),
        };
        let moved = found.pairs.iter().map(|pair| (other * pair.aligned).translation.distance_squared(pair.reference.translation));
        let least: f64 = found.pairs.iter().map(|pair| pair.error_m.powi(2)).sum();
        prop_assert!(moved.sum::<f64>() >= least - 1e-9);
    }
}
