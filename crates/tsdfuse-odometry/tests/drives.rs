//! Short simulated drives against their truth.
#![allow(clippy::unwrap_used)]

use glam::DVec3;
use tsdfuse::{Pose, Scan};
use tsdfuse_odometry::{OdometryConfig, Tracked, Tracker};
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
