//! The simulated sensor against the exact surface.

#![allow(clippy::unwrap_used)] // test helpers

mod noise;

use glam::{DVec3, Vec3};
use tsdfuse::sensor::model;
use tsdfuse::{Scan, SensorModel};
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};

const EXACT: SimulatorConfig = SimulatorConfig {
    noise: NoiseModel::none(),
    rate_hz: 10.0,
    motion: false,
    seed: 1,
};

fn noisy(noise: NoiseModel) -> SimulatorConfig {
    SimulatorConfig { noise, ..EXACT }
}

fn simulator(name: &str, sensor: &str, scans: usize, config: SimulatorConfig) -> Simulator {
    let scene = scene::by_name(name, 2).unwrap();
    let path = path::default_for(&scene, scans);
    Simulator::new(scene, model(sensor).unwrap(), path, config).unwrap()
}

/// All scans as one list of points.
fn points(simulator: &Simulator) -> Vec<Vec3> {
    simulator.scans().flat_map(|s| s.points).collect()
}

/// Signed distances of a scan's points, placed by its trajectory, or all from its pose.
fn distances(simulator: &Simulator, scan: &Scan, moving: bool) -> Vec<f64> {
    let trajectory = scan.sweep().filter(|_| moving);
    let place = |(i, p): (usize, &Vec3)| {
        let pose = match (&trajectory, &scan.times) {
            (Some(t), Some(times)) => t.at(f64::from(times[i])),
            _ => scan.pose.unwrap(),
        };
        simulator.scene().signed_distance(pose.transform_point(p.as_dvec3()))
    };
    scan.points.iter().enumerate().map(place).collect()
}

fn worst(distances: &[f64]) -> f64 {
    distances.iter().fold(0.0, |a, d| a.max(d.abs()))
}

#[test]
fn exact_points_lie_on_the_surface() {
    for (name, sensor) in [
        ("street", "pandar64"),
        ("hall", "os0-128"),
        ("sphere", "vlp16"),
        ("plane", "hdl32e"),
    ] {
        let simulator = simulator(name, sensor, 3, EXACT);
        for scan in simulator.scans() {
            assert!(scan.points.len() > 300, "{name}: {}", scan.points.len());
            assert!(scan.times.is_none() && scan.motion.is_empty());
            let worst = worst(&distances(&simulator, &scan, false));
            assert!(worst < 1e-4, "{name}: {worst}");
        }
    }
}

#[test]
fn a_moving_sensor_is_placed_by_its_trajectory() {
    for (name, sensor) in [("street", "pandar64"), ("hall", "os1-64")] {
        let config = SimulatorConfig { motion: true, ..EXACT };
        let simulator = simulator(name, sensor, 4, config);
        let scans: Vec<_> = simulator.scans().collect();
        for scan in &scans {
            scan.check().unwrap();
            let placed = worst(&distances(&simulator, scan, true));
            assert!(placed < 1e-4, "{name}: {placed}");
            // From one pose, a good part of the scan is off by centimetres.
            let frozen = distances(&simulator, scan, false);
            let off = frozen.iter().filter(|d| d.abs() > 0.02).count();
            assert!(off > scan.points.len() / 4, "{name}: {off} of {}", scan.points.len());
        }
        for pair in scans.windows(2) {
            let motion = pair[0].motion[0];
            assert_eq!((motion.pose, motion.secs), (pair[1].pose.unwrap(), 0.1));
        }
        // After the last pose it goes on as it came.
        let step = |s: &Scan| s.motion[0].pose.translation - s.pose.unwrap().translation;
        assert!(step(&scans[3]).distance(step(&scans[2])) < 1e-9);
    }
}

#[test]
fn beams_are_fired_column_by_column() {
    let config = SimulatorConfig { motion: true, ..EXACT };
    let simulator = simulator("hall", "vlp16", 1, config);
    let scan = simulator.nth_scan(0).unwrap();
    let sensor = simulator.sensor();
    let mut last = (0, None);
    let (rings, times) = (scan.rings.as_ref().unwrap(), scan.times.as_ref().unwrap());
    for (i, p) in scan.points.iter().enumerate() {
        let turn = -f64::from(p.y).atan2(f64::from(p.x)) / std::f64::consts::TAU;
        let column = (turn.rem_euclid(1.0) * f64::from(sensor.columns)).round() as u32 % sensor.columns;
        let ring = rings[i];
        let elevation = p.z.atan2(p.x.hypot(p.y)).to_degrees();
        assert!((elevation - sensor.elevations_deg[usize::from(ring)]).abs() < 1e-3);
        let time = f64::from(column) / f64::from(sensor.columns) / 10.0;
        assert!((f64::from(times[i]) - time).abs() < 1e-8);
        assert!((column, Some(ring)) > last, "{column} {ring} after {last:?}");
        last = (column, Some(ring));
    }
    let beams = sensor.rings() as u64 * u64::from(sensor.columns);
    assert_eq!(scan.points.len() as u64 + scan.dropped.total(), beams);
    assert!(scan.dropped.no_return > 0, "the hall has windows");
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let noise = NoiseModel {
        divergence_rad: 2e-3,
        airborne: 0.01,
        ..NoiseModel::default()
    };
    let config = SimulatorConfig {
        motion: true,
        ..noisy(noise)
    };
    let simulator = simulator("street", "vlp16", 3, config);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            simulator
                .scans()
                .map(|s| (s.points, s.intensities, s.dropped))
                .collect::<Vec<_>>()
        })
    };
    let one = on(1);
    assert_eq!(one, on(4));
    // In any order, too.
    assert_eq!(one[2].0, simulator.nth_scan(2).unwrap().points);
    assert!(simulator.nth_scan(3).is_none());
    // Scans, columns and seeds differ.
    let other = SimulatorConfig { seed: 9, ..config };
    let other = Simulator::new(
        simulator.scene().clone(),
        simulator.sensor().clone(),
        simulator.path().to_vec(),
        other,
    );
    assert_ne!(one[0].0, other.unwrap().nth_scan(0).unwrap().points);
}

#[test]
fn a_world_far_from_its_origin_scans_the_same() {
    let offset = DVec3::new(365_412.75, 5_621_874.5, 61.25);
    for motion in [false, true] {
        let config = SimulatorConfig {
            motion,
            ..SimulatorConfig::default()
        };
        let scan_at = |offset: DVec3| {
            let scene = scene::by_name("street", 2).unwrap().translated(offset);
            let path = path::vehicle(&scene, 3);
            let simulator = Simulator::new(scene, model("vlp16").unwrap(), path, config).unwrap();
            simulator.nth_scan(1).unwrap()
        };
        let (near, far) = (scan_at(DVec3::ZERO), scan_at(offset));
        assert_eq!(near.points, far.points);
        assert_eq!(near.intensities, far.intensities);
        assert_eq!(near.pose.unwrap().rotation, far.pose.unwrap().rotation);
        assert_eq!(near.pose.unwrap().translation, far.pose.unwrap().translation - offset);
    }
}

#[test]
fn what_is_out_of_range_is_refused_or_counted() {
    let new = |sensor: SensorModel, config| {
        let scene = scene::by_name("box", 0).unwrap();
        Simulator::new(scene, sensor, Vec::new(), config)
            .map(|s| s.scans().len())
            .map_err(|e| e.to_string())
    };
    let sensor = model("vlp16").unwrap();
    assert_eq!(new(sensor.clone(), EXACT), Ok(0));
    let negative = noisy(NoiseModel {
        range_sigma_m: -0.1,
        ..NoiseModel::none()
    });
    assert_eq!(
        new(sensor.clone(), negative).unwrap_err(),
        "noise model: range_sigma_m cannot be -0.1"
    );
    let certain = noisy(NoiseModel {
        dropout: 1.5,
        ..NoiseModel::none()
    });
    assert_eq!(
        new(sensor.clone(), certain).unwrap_err(),
        "noise model: dropout cannot be 1.5"
    );
    let still = SimulatorConfig { rate_hz: 0.0, ..EXACT };
    assert_eq!(
        new(sensor.clone(), still).unwrap_err(),
        "0 scans per second cannot be simulated"
    );
    let blind = SensorModel { columns: 0, ..sensor };
    assert!(new(blind, EXACT).unwrap_err().contains("0 columns"));

    let mut short = model("vlp16").unwrap();
    (short.min_range_m, short.max_range_m) = (4.0, 6.0);
    let scene = scene::by_name("plane", 0).unwrap();
    let path = path::orbit(&scene, 1);
    let scan = Simulator::new(scene, short, path, EXACT).unwrap().nth_scan(0).unwrap();
    assert!(scan.points.iter().all(|p| (4.0..=6.0).contains(&p.length())));
    assert!(scan.dropped.too_far > 0 && scan.dropped.no_return > 0 && scan.dropped.too_near == 0);
}
