//! Short simulated drives against their truth.
#![allow(clippy::unwrap_used)]

use glam::DVec3;
use tsdfuse::{Pose, Scan};
use tsdfuse_odometry::{OdometryConfig, Refiner, Tracked, Tracker, common_shift};
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

fn drive(name: &str, way: &str, sensor: &str, scans: usize, motion: bool) -> Vec<Scan> {
    let scene = scene::by_name(name, 3).unwrap();
    let path = path::by_name(way, &scene, scans).unwrap();
    let sensor = tsdfuse::sensor::model(sensor).unwrap();
    let config = SimulatorConfig {
        motion,
        ..SimulatorConfig::default()
    };
    Simulator::new(scene, sensor, path, config).unwrap().scans().collect()
}

/// The scans as a sensor without poses gives them.
fn tracked(scans: &[Scan]) -> Vec<Tracked> {
    let mut tracker = Tracker::new(OdometryConfig::default());
    let mut all = Vec::new();
    for scan in scans {
        let mut scan = scan.clone();
        scan.pose = None;
        scan.motion.clear();
        tracker.push(scan);
        while let Some(tracked) = tracker.pop() {
            all.push(tracked);
        }
    }
    tracker.finish();
    while let Some(tracked) = tracker.pop() {
        all.push(tracked);
    }
    all
}

/// The largest distance between a pose and the truth, metres, and angle, radians, relative to the scan `from`.
fn errors(scans: &[Scan], all: &[Tracked], from: usize) -> (f64, f64) {
    let relative = |first: Option<Pose>, pose: Option<Pose>| first.unwrap().inverse() * pose.unwrap();
    let of = |(scan, tracked): (&Scan, &Tracked)| {
        let want = relative(scans[from].pose, scan.pose);
        let got = relative(all[from].scan.pose, tracked.scan.pose);
        let turn = (want.rotation.conjugate() * got.rotation).to_scaled_axis().length();
        (want.translation.distance(got.translation), turn)
    };
    let all = scans.iter().zip(all).map(of);
    all.fold((0.0, 0.0), |(d, a), (e, b)| (d.max(e), f64::max(a, b)))
}

#[test]
fn a_street_is_tracked_to_centimetres() {
    let scans = drive("street", "vehicle", "vlp16", 30, false);
    let all = tracked(&scans);
    assert_eq!(all.len(), 30);
    let (metres, radians) = errors(&scans, &all, 0);
    assert!(metres < 0.05 && radians < 0.005, "{metres} m {radians} rad");
    assert!(
        all[1..]
            .iter()
            .all(|t| !t.quality.is_unmatched() && !t.quality.is_undetermined())
    );
}

#[test]
fn a_sensor_that_moves_within_its_sweeps_is_tracked() {
    let scans = drive("street", "vehicle", "vlp16", 30, true);
    let all = tracked(&scans);
    let (metres, radians) = errors(&scans, &all, 0);
    assert!(metres < 0.08 && radians < 0.008, "{metres} m {radians} rad");
    // The motion within the sweep, too: single returns lie where they truly were.
    let (scan, got) = (&scans[20], &all[20].scan);
    let to_world = scans[20].pose.unwrap() * got.pose.unwrap().inverse();
    let there = got.points_in_world().unwrap().map(|p| to_world.transform_point(p));
    let worst = scan
        .points_in_world()
        .unwrap()
        .zip(there)
        .map(|(a, b)| DVec3::distance(a, b) / (1.0 + a.length() * 0.02));
    let worst = worst.fold(0.0, f64::max);
    assert!(worst < 0.1, "{worst} m");
}

#[test]
fn a_hall_is_tracked_to_millimetres() {
    let scans = drive("hall", "drone", "os0-128", 12, false);
    let (metres, radians) = errors(&scans, &tracked(&scans), 0);
    assert!(metres < 0.01 && radians < 0.002, "{metres} m {radians} rad");
}

#[test]
fn any_number_of_threads_finds_the_same_poses() {
    let scans = drive("street", "vehicle", "vlp16", 8, true);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let all = pool.install(|| tracked(&scans));
        all.iter()
            .map(|t| (t.scan.pose, t.scan.motion.clone(), t.quality))
            .collect::<Vec<_>>()
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}

#[test]
fn scans_with_hardly_any_returns_lose_nothing() {
    let mut scans = drive("street", "vehicle", "vlp16", 12, false);
    let few = |scan: &mut Scan| {
        let keep: Vec<bool> = (0..scan.points.len()).map(|i| i < 10).collect();
        scan.keep_only(&keep);
    };
    few(&mut scans[0]);
    few(&mut scans[6]);
    let all = tracked(&scans);
    let names = |scans: &[Scan]| scans.iter().map(|s| s.name.clone()).collect::<Vec<_>>();
    assert_eq!(
        names(&scans),
        all.iter().map(|t| t.scan.name.clone()).collect::<Vec<_>>()
    );
    assert!(all[6].quality.is_unmatched(), "{:?}", all[6].quality);
    let (metres, _) = errors(&scans[1..6], &all[1..6], 0);
    assert!(metres < 0.05, "{metres} m");
    let (metres, _) = errors(&scans[1..], &all[1..], 0);
    assert!(metres < 0.3, "{metres} m");
    for scans in [&scans[..1], &scans[1..2], &[]] {
        assert_eq!(tracked(scans).len(), scans.len());
    }
}

#[test]
fn an_endless_plain_is_not_pretended_to_be_known() {
    let plain = |k: usize| {
        let points = (0..40_000).map(|i| {
            let (a, b) = (0.37 * i as f32, 3.0 + 0.0005 * i as f32);
            glam::Vec3::new(
                b * a.cos(),
                b * a.sin(),
                -1.8 + 0.01 * ((i * 7919 + k * 104_729) as f32).sin(),
            )
        });
        Scan {
            name: k.to_string(),
            points: points.collect(),
            ..Scan::default()
        }
    };
    let all = tracked(&(0..4).map(plain).collect::<Vec<_>>());
    assert!(
        all[1..].iter().all(|t| t.quality.is_undetermined()),
        "{:?}",
        all[2].quality
    );
}

/// A pose that is off by some 3 cm along each axis and 0.15° about each.
fn rough(pose: Pose, seed: usize) -> Pose {
    let noise = |k: usize| 2.0 * (((seed * 6 + k) * 7919 + 13) as f64 * 0.754_877_666).fract() - 1.0;
    let three = |k: usize| DVec3::new(noise(k), noise(k + 1), noise(k + 2)) * 3.0_f64.sqrt();
    Pose {
        rotation: pose.rotation * glam::DQuat::from_scaled_axis(three(3) * 0.15_f64.to_radians()),
        translation: pose.translation + three(0) * 0.03,
    }
}

#[test]
fn rough_poses_are_refined_to_millimetres() {
    let scans = drive("street", "vehicle", "pandar64", 30, false);
    let mut poses: Vec<Pose> = (0..)
        .zip(&scans)
        .map(|(i, scan)| rough(scan.pose.unwrap(), i))
        .collect();
    let off = |poses: &[Pose]| {
        let truth = scans.iter().map(|scan| scan.pose.unwrap());
        let shift = common_shift(&truth.clone().zip(poses.iter().copied()).collect::<Vec<_>>());
        let errors = truth.zip(poses).map(|(want, got)| {
            let got = shift * *got;
            let turn = (want.rotation.conjugate() * got.rotation).to_scaled_axis().length();
            [want.translation.distance(got.translation), turn.to_degrees()]
        });
        errors.reduce(|a, b| [a[0].max(b[0]), a[1].max(b[1])]).unwrap()
    };
    let [before, _] = off(&poses);
    assert!(before > 0.04, "{before}");
    for reach_m in [0.5, 0.2, 0.1, 0.1] {
        let mut refiner = Refiner::new(OdometryConfig::default(), reach_m);
        let placed = scans.iter().zip(&poses).map(|(scan, &pose)| Scan {
            pose: Some(pose),
            ..scan.clone()
        });
        let mut refined: Vec<_> = placed.flat_map(|scan| refiner.push(&scan)).collect();
        refined.extend(refiner.finish());
        poses = refined.into_iter().map(|refined| refined.unwrap().pose).collect();
        assert_eq!(poses.len(), scans.len());
    }
    let [metres, degrees] = off(&poses);
    assert!(metres < 0.012 && degrees < 0.03, "{metres} m {degrees} deg");
}

#[test]
fn scans_without_poses_or_returns_pass_through_refinement() {
    let mut scans = drive("street", "vehicle", "vlp16", 4, false);
    scans[1].pose = None;
    scans[2].keep_only(&[]);
    let mut refiner = Refiner::new(OdometryConfig::default(), 0.3);
    let mut refined: Vec<_> = scans.iter().flat_map(|scan| refiner.push(scan)).collect();
    refined.extend(refiner.finish());
    assert_eq!(refined.len(), 4);
    assert!(refined[1].is_none());
    assert_eq!(refined[2].as_ref().unwrap().pose, scans[2].pose.unwrap());
}

#[test]
fn a_gap_a_doubled_scan_and_scans_out_of_order_break_nothing() {
    let all = drive("street", "vehicle", "vlp16", 24, true);
    // Scan 10 twice, 14 before 13, and half a second without scans.
    let order = [
        0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 10, 11, 12, 14, 13, 15, 16, 17, 21, 22, 23,
    ];
    let scans: Vec<Scan> = order.iter().map(|&i| all[i].clone()).collect();
    let tracked = tracked(&scans);
    assert_eq!(tracked.len(), scans.len());
    let (metres, radians) = errors(&scans, &tracked, 0);
    let doubts = tracked[1..]
        .iter()
        .any(|t| t.quality.is_unmatched() || t.quality.is_undetermined());
    assert!(
        (metres < 0.2 && radians < 0.02) || doubts,
        "{metres} m {radians} rad, and no doubt is told"
    );
}
