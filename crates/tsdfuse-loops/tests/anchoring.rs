//! Trajectories that drift, and what positions and gravity make of them.
#![allow(clippy::unwrap_used)]

use glam::{DQuat, DVec3};
use tsdfuse::{ImuSample, Pose, STANDARD_GRAVITY, Scan};
use tsdfuse_loops::{Closer, Fix, LoopConfig};
use tsdfuse_odometry::Quality;

mod random;
use random::Random;

const SPEED: f64 = 5.0;
const SCANS: usize = 1200;

/// Three numbers of variance 1.
fn vector(random: &mut Random) -> DVec3 {
    let mut normal = || (0..12).map(|_| random.next() - 0.5).sum();
    DVec3::new(normal(), normal(), normal())
}

/// Once along a large circle that goes up and down, 600 m.
fn truth(secs: f64) -> Pose {
    let angle = SPEED * secs / 100.0;
    let place = DVec3::new(100.0 * angle.cos(), 100.0 * angle.sin(), 2.0 * (3.0 * angle).sin());
    let climb = 0.06 * (3.0 * angle).cos();
    Pose {
        rotation: DQuat::from_rotation_z(angle + std::f64::consts::FRAC_PI_2) * DQuat::from_rotation_y(-climb),
        translation: place,
    }
}

fn secs(scan: usize) -> f64 {
    0.1 * scan as f64
}

/// The truth as odometry might have it, which turns too much from scan to scan: radians about the axes of the sensor.
fn odometry(drift: impl Fn(&Pose) -> DVec3) -> Vec<Pose> {
    let mut poses = vec![truth(0.0)];
    for scan in 1..SCANS {
        let step = truth(secs(scan - 1)).inverse() * truth(secs(scan));
        let wrong = Pose {
            rotation: DQuat::from_scaled_axis(drift(&truth(secs(scan)))),
            translation: step.translation * 1e-3,
        };
        poses.push(poses[scan - 1] * step * wrong);
    }
    poses
}

/// The fixes' world lies elsewhere.
fn elsewhere() -> Pose {
    Pose {
        rotation: DQuat::from_rotation_z(2.0),
        translation: DVec3::new(4e5, -3e5, 300.0),
    }
}

fn fixes(sigma: f64, outliers: usize) -> Vec<Fix> {
    let mut random = Random(5);
    let antenna = DVec3::new(-0.5, 0.3, 1.2);
    (0..600)
        .map(|n| {
            let at = 0.2 * n as f64 + 0.03;
            let mut place =
                elsewhere().transform_point(truth(at).transform_point(antenna)) + sigma * vector(&mut random);
            // Some in a row, as reflections have it.
            if n % 50 < outliers {
                place += DVec3::new(18.0, 7.0, -12.0) + 3.0 * vector(&mut random);
            }
            Fix {
                time_ns: (at * 1e9) as i64,
                place,
                sigma_m: DVec3::splat(sigma),
                antenna,
            }
        })
        .collect()
}

/// What an accelerometer with noise and bias measures.
fn samples() -> Vec<ImuSample> {
    let mut random = Random(7);
    let h = 1e-3;
    (0..SCANS * 10)
        .map(|n| {
            let at = 0.01 * n as f64;
            let place = |secs: f64| truth(secs).translation;
            let acceleration = (place(at - h) - 2.0 * place(at) + place(at + h)) / (h * h);
            let force = truth(at).rotation.conjugate() * (acceleration + DVec3::Z * STANDARD_GRAVITY);
            ImuSample {
                time_ns: (at * 1e9) as i64,
                acceleration: force + DVec3::new(0.04, -0.03, 0.05) + 0.03 * vector(&mut random),
                angular_velocity: DVec3::ZERO,
                orientation: None,
            }
        })
        .collect()
}

fn closed(odometry: &[Pose], fixes: Vec<Fix>, samples: Vec<ImuSample>) -> Closer {
    let mut closer = Closer::new(LoopConfig::default());
    closer.push_fixes(fixes);
    closer.push_imu(samples);
    for (scan, pose) in odometry.iter().enumerate() {
        let scan = Scan {
            time_ns: Some((secs(scan) * 1e9) as i64),
            pose: Some(*pose),
            ..Scan::default()
        };
        closer.push(&scan, &Quality::GIVEN);
    }
    closer.finish();
    closer
}

/// The farthest that scans are from the truth, both as the fixes' world has them.
fn worst(closer: &Closer) -> f64 {
    let fixes_from_world = closer.anchoring().unwrap().fixes_from_world.unwrap();
    let off = |scan: usize| {
        let there = fixes_from_world * closer.pose(scan);
        let true_there = elsewhere() * truth(secs(scan));
        there.translation.distance(true_there.translation)
    };
    (0..SCANS).map(off).fold(0.0, f64::max)
}

#[test]
fn fixes_straighten_a_drifted_trajectory_as_well_as_they_are_known() {
    let drifted = odometry(|_| DVec3::new(2e-5, 1e-5, 6e-5));
    let open = drifted[SCANS - 1]
        .translation
        .distance(truth(secs(SCANS - 1)).translation);
    assert!(open > 3.0, "{open}");
    for (sigma, outliers, most) in [(0.02, 0, 0.06), (0.02, 10, 0.12), (1.0, 0, 2.0), (1.0, 10, 2.0)] {
        let closer = closed(&drifted, fixes(sigma, outliers), Vec::new());
        let found = closer.anchoring().unwrap();
        assert_eq!(found.fixes, 600);
        assert_eq!(found.doubted_fixes, 12 * outliers);
        assert!(
            worst(&closer) < most,
            "{sigma} {outliers}: {} {found:?}",
            worst(&closer)
        );
        // The world stays where it was.
        let first = closer.pose(0);
        assert!(first.translation.distance(drifted[0].translation) < 0.1, "{first:?}");
    }
}

#[test]
fn fixes_without_heights_tell_the_rest() {
    let drifted = odometry(|_| DVec3::new(0.0, 0.0, 6e-5));
    let mut flat = fixes(0.02, 10);
    for fix in &mut flat {
        (fix.place.z, fix.sigma_m.z) = (0.0, f64::INFINITY);
    }
    let closer = closed(&drifted, flat, Vec::new());
    let found = closer.anchoring().unwrap();
    assert_eq!((found.fixes, found.doubted_fixes), (600, 120));
    let fixes_from_world = found.fixes_from_world.unwrap();
    for (scan, drifted) in drifted.iter().enumerate() {
        let there = fixes_from_world * closer.pose(scan);
        let off = there.translation - (elsewhere() * truth(secs(scan))).translation;
        assert!(off.truncate().length() < 0.15, "{scan}: {off}");
        // Heights stay as odometry has them, within what it may drift; the world is not tilted.
        let risen = closer.pose(scan).translation.z - drifted.translation.z;
        assert!(risen.abs() < 1.0, "{scan}: {risen}");
    }
}

#[test]
fn fixes_that_are_less_sure_than_the_trajectory_do_not_bend_it() {
    let good = odometry(|_| DVec3::ZERO);
    let closer = closed(&good, fixes(3.0, 10), Vec::new());
    let found = closer.anchoring().unwrap();
    assert_eq!((found.drift_share, found.fixes), (None, 600));
    assert!((0..SCANS).all(|scan| closer.pose(scan).translation.distance(good[scan].translation) < 1e-9));
    // But they tell where it is.
    assert!(worst(&closer) < 1.5, "{}", worst(&closer));
}

#[test]
fn fixes_that_agree_with_nothing_and_none_at_all_change_nothing() {
    let drifted = odometry(|_| DVec3::new(0.0, 0.0, 6e-5));
    let mut random = Random(3);
    let mut wrong = fixes(0.02, 0);
    for fix in &mut wrong {
        fix.place += 40.0 * vector(&mut random);
    }
    let closer = closed(&drifted, wrong, Vec::new());
    assert!((0..SCANS).all(|scan| closer.pose(scan).translation.distance(drifted[scan].translation) < 1e-9));
    let none = closed(&drifted, Vec::new(), Vec::new());
    assert!(none.anchoring().is_none());
    // Nor do those of another time.
    let mut late = fixes(0.02, 0);
    for fix in &mut late {
        fix.time_ns += 1_000_000_000_000;
    }
    assert!(closed(&drifted, late, Vec::new()).anchoring().is_none());
}

#[test]
fn gravity_takes_back_what_odometry_tilted() {
    // Tilts by 0.03° each metre, always to the same side of the world.
    let tilting = odometry(|truth| truth.rotation.conjugate() * DVec3::new(2.5e-4, 0.0, 0.0));
    let closer = closed(&tilting, Vec::new(), samples());
    let tilt = |pose: &Pose, scan: usize| {
        let (up, true_up) = (
            pose.rotation.conjugate() * DVec3::Z,
            truth(secs(scan)).rotation.conjugate() * DVec3::Z,
        );
        up.angle_between(true_up).to_degrees()
    };
    let worst = |pose: &dyn Fn(usize) -> Pose| (0..SCANS).map(|scan| tilt(&pose(scan), scan)).fold(0.0, f64::max);
    let (before, after) = (worst(&|scan| tilting[scan]), worst(&|scan| closer.pose(scan)));
    assert!(
        before > 10.0 && after < 1.5,
        "{before} {after} {:?}",
        closer.anchoring()
    );
    // Level trajectories stay as they are.
    let level = odometry(|_| DVec3::ZERO);
    let closer = closed(&level, Vec::new(), samples());
    let found = closer.anchoring().unwrap();
    assert!(found.levels > 100 && found.drift_share.is_none(), "{found:?}");
    assert!((0..SCANS).all(|scan| closer.pose(scan).translation.distance(level[scan].translation) < 1e-9));
    // Forces that are no forces tell nothing.
    let mut halves = samples();
    for sample in &mut halves {
        sample.acceleration *= 0.5;
    }
    assert!(closed(&level, Vec::new(), halves).anchoring().is_none());
}
