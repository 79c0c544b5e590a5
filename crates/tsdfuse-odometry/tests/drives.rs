//! Short simulated drives against their truth.
#![allow(clippy::unwrap_used)]

use glam::DVec3;
use tsdfuse::sensor::SensorCorrection;
use tsdfuse::{ImuSample, Pose, Scan};
use tsdfuse_odometry::{OdometryConfig, Refiner, Search, Tracked, Tracker, common_shift, shared_errors};
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
    tracked_by(Tracker::new(OdometryConfig::default()), scans)
}

fn tracked_by(mut tracker: Tracker, scans: &[Scan]) -> Vec<Tracked> {
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

/// Where a sensor is in a tunnel along x, metres: after half a second it drives off.
fn driven(secs: f64) -> f64 {
    1.6 * (secs - 0.5).max(0.0).powi(2)
}

/// Sweeps of 64 beams in a tunnel, a round vault over a flat floor, in which boxes stand at its side.
fn tunnel(sweeps: usize, boxes: &[f64]) -> Vec<Scan> {
    let mut state = 1_u32;
    let mut noise = || {
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        0.02 * (0..12).map(|_| uniform()).sum::<f64>()
    };
    let range = |from: DVec3, ray: DVec3| {
        let (across, centre) = (DVec3::new(0.0, ray.y, ray.z), DVec3::new(0.0, from.y, from.z - 1.2));
        let (a, b, c) = (across.dot(across), across.dot(centre), centre.dot(centre) - 5.2 * 5.2);
        let vault = (-b + (b * b - a * c).sqrt()) / a;
        let floor = if ray.z < 0.0 { -from.z / ray.z } else { f64::INFINITY };
        let of_box = |x: &f64| {
            let (low, high) = (DVec3::new(x - 0.4, 4.5, 0.0), DVec3::new(x + 0.4, 5.5, 1.8));
            let (s, t) = ((low - from) / ray, (high - from) / ray);
            let (near, far) = (s.min(t).max_element(), s.max(t).min_element());
            if near < far && near > 0.0 { near } else { f64::INFINITY }
        };
        boxes.iter().map(of_box).fold(vault.min(floor), f64::min)
    };
    let mut sweep = |k: usize| {
        let (mut points, mut times) = (Vec::new(), Vec::new());
        for column in 0..1024 {
            let secs = 0.1 * f64::from(column) / 1024.0;
            let azimuth = -std::f64::consts::TAU * f64::from(column) / 1024.0;
            let from = DVec3::new(driven(0.1 * k as f64 + secs), 0.0, 1.9);
            for beam in 0..64 {
                let elevation = (f64::from(beam) - 31.5) * 0.0125;
                let ray = DVec3::new(
                    azimuth.cos() * elevation.cos(),
                    azimuth.sin() * elevation.cos(),
                    elevation.sin(),
                );
                let metres = range(from, ray);
                if metres < 120.0 {
                    points.push((ray * (metres + noise())).as_vec3());
                    times.push(secs as f32);
                }
            }
        }
        Scan {
            name: k.to_string(),
            time_ns: Some(k as i64 * 100_000_000),
            points,
            times: Some(times),
            ..Scan::default()
        }
    };
    (0..sweeps).map(&mut sweep).collect()
}

#[test]
fn a_tunnel_is_driven_as_far_as_what_sticks_out_of_it_tells() {
    let all = tracked(&tunnel(34, &[26.0, 47.0]));
    let at = |k: usize| all[k].scan.pose.unwrap().translation.x;
    let is_told = |k: &usize| !all[*k].quality.is_undetermined();
    let told = (1..all.len()).filter(is_told).count();
    assert!(told > 24, "{told}");
    let off = |k: usize| at(k) - driven(0.1 * k as f64);
    for k in (2..all.len()).filter(|k| is_told(k) && is_told(&(k - 1))) {
        assert!((off(k) - off(k - 1)).abs() < 0.1, "{k}: {} {}", off(k - 1), off(k));
    }
    assert!(off(33).abs() < 0.2, "{}", off(33));
}

#[test]
fn a_tunnel_without_anything_in_it_is_not_pretended_to_be_known() {
    let all = tracked(&tunnel(14, &[]));
    let told = all[1..].iter().filter(|t| !t.quality.is_undetermined()).count();
    assert_eq!(told, 0);
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
fn an_error_of_elevations_is_found_and_none_where_there_is_none() {
    let config = OdometryConfig::default();
    let mut scans = drive("street", "vehicle", "hdl32e", 20, false);
    assert_eq!(shared_errors(&scans, config), None);
    let error = SensorCorrection::of_elevation(0.4);
    scans.iter_mut().for_each(|scan| error.apply(scan));
    let found = shared_errors(&scans, config).unwrap();
    assert!((found.elevation_deg + 0.4).abs() < 0.12, "{found:?}");
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

/// What a unit in the sensor's frame measures each 5 ms of a drive: between the sweeps' poses, the sensor moves steadily.
fn imu(scans: &[Scan]) -> Vec<ImuSample> {
    let pose = |t: f64| {
        let (i, share) = ((10.0 * t) as usize, 10.0 * t % 1.0);
        let at = |i: usize| scans[i.min(scans.len() - 1)].pose.unwrap();
        (at(i), at(i + 1), share)
    };
    let position = |t: f64| {
        let (a, b, share) = pose(t);
        a.translation.lerp(b.translation, share)
    };
    let begin = scans[0].time_ns.unwrap();
    (2..20 * (scans.len() - 1) - 2)
        .map(|i| {
            let (t, h) = (0.005 * i as f64, 0.005);
            let (a, b, share) = pose(t);
            let acceleration = (position(t - h) - 2.0 * position(t) + position(t + h)) / (h * h);
            let rotation = a.rotation.slerp(b.rotation, share);
            ImuSample {
                time_ns: begin + 5_000_000 * i as i64,
                angular_velocity: (a.rotation.conjugate() * b.rotation).to_scaled_axis() * 10.0,
                acceleration: rotation.conjugate() * (acceleration + DVec3::Z * 9.806_65),
                orientation: None,
            }
        })
        .collect()
}

#[test]
fn gravity_levels_the_world_of_a_tilted_sensor() {
    let mut scans = drive("street", "vehicle", "vlp16", 25, true);
    let mut samples = imu(&scans);
    let tilt = glam::DQuat::from_euler(glam::EulerRot::ZYX, 0.4, 0.3, -0.2);
    for scan in &mut scans {
        for p in &mut scan.points {
            *p = (tilt * p.as_dvec3()).as_vec3();
        }
        let tilted = Pose {
            rotation: tilt.conjugate(),
            ..Pose::IDENTITY
        };
        scan.pose = scan.pose.map(|pose| pose * tilted);
    }
    for sample in &mut samples {
        sample.angular_velocity = tilt * sample.angular_velocity;
        sample.acceleration = tilt * sample.acceleration;
    }
    let mut tracker = Tracker::new(OdometryConfig::default());
    tracker.push_imu(samples);
    let all = tracked_by(tracker, &scans);
    assert_eq!(all.len(), scans.len());
    let (metres, radians) = errors(&scans, &all, 0);
    assert!(metres < 0.12 && radians < 0.01, "{metres} m {radians} rad");
    for (scan, tracked) in scans.iter().zip(&all) {
        // Upwards in the sensor's frame, put into the world.
        let up = scan.pose.unwrap().rotation.conjugate() * DVec3::Z;
        let up = tracked.scan.pose.unwrap().rotation * up;
        assert!(up.angle_between(DVec3::Z).to_degrees() < 2.5, "{up}");
    }
}

#[test]
fn a_sensor_that_was_carried_away_begins_a_new_piece_and_finds_back() {
    let street = drive("street", "vehicle", "vlp16", 30, true);
    let hall = drive("hall", "drone", "vlp16", 12, true);
    let mut scans: Vec<Scan> = street[..14].to_vec();
    scans.extend_from_slice(&hall[..8]);
    scans.extend_from_slice(&street[8..24]);
    let begin = scans[0].time_ns.unwrap();
    for (i, scan) in scans.iter_mut().enumerate() {
        scan.time_ns = Some(begin + 100_000_000 * i as i64);
    }
    let all = tracked(&scans);
    assert_eq!(all.len(), scans.len());
    let pieces: Vec<usize> = all.iter().map(|tracked| tracked.piece).collect();
    assert!(pieces[..14].iter().all(|piece| *piece == 0), "{pieces:?}");
    assert!(pieces[14..20].iter().all(|piece| *piece != 0), "{pieces:?}");
    assert!(pieces[26..].iter().all(|piece| *piece == 0), "{pieces:?}");
    let (metres, radians) = errors(&scans[26..], &all[26..], 0);
    assert!(metres < 0.08 && radians < 0.008, "{metres} m {radians} rad");
    let from_first = |scans: &[Scan], i: usize| scans[0].pose.unwrap().inverse() * scans[i].pose.unwrap();
    let got: Vec<Scan> = all.iter().map(|tracked| tracked.scan.clone()).collect();
    let off = from_first(&scans, 37).translation - from_first(&got, 37).translation;
    assert!(off.length() < 0.1, "{off}");
}

#[test]
fn a_place_in_a_map_is_found_near_a_pose_along_a_trajectory_and_nowhere_else() {
    let scans = drive("street", "vehicle", "vlp16", 30, false);
    let surface: Vec<DVec3> = scans[..24]
        .iter()
        .flat_map(|scan| scan.points_in_world().unwrap())
        .collect();
    let poses: Vec<Pose> = scans[..24].iter().map(|scan| scan.pose.unwrap()).collect();
    let rough = Pose {
        rotation: poses[12].rotation * glam::DQuat::from_rotation_z(0.35),
        translation: poses[12].translation + DVec3::new(1.5, -1.2, 0.3),
    };
    let near = Search {
        near: vec![rough],
        ..Search::default()
    };
    let along = Search {
        along: poses,
        ..Search::default()
    };
    for search in [near, along.clone()] {
        let tracker = Tracker::in_map(OdometryConfig::default(), surface.iter().copied(), search);
        let all = tracked_by(tracker, &scans[12..]);
        for (scan, tracked) in scans[12..].iter().zip(&all) {
            let (want, got) = (scan.pose.unwrap(), tracked.scan.pose.unwrap());
            let metres = want.translation.distance(got.translation);
            assert!(metres < 0.06, "{}: {metres} m", scan.name);
        }
    }
    let elsewhere = drive("hall", "drone", "vlp16", 4, false);
    let tracker = Tracker::in_map(OdometryConfig::default(), surface, along);
    let all = tracked_by(tracker, &elsewhere);
    assert_eq!(all.len(), 4);
    assert!(all.iter().all(|tracked| tracked.scan.pose.is_none()));
}
