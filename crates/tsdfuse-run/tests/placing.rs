//! Runs whose poses are found or refined: broken off, continued, and begun in a map that is there.

#![allow(clippy::unwrap_used)] // test helpers

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::scan::RangeLimits;
use tsdfuse::{ImuSample, Pose, Scan};
use tsdfuse_io::plain::Writer;
use tsdfuse_io::{Log, Selection, Sensor, Stream, StreamedScan, map_file};
use tsdfuse_run::{
    Event, Input, Job, OdometryConfig, Outputs, PosesFrom, Report, RunError, Settings, Silent, Stop, Track,
};
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

/// The true scans of a drive along a street.
fn street(scans: usize) -> Vec<Scan> {
    let scene = scene::by_name("street", 3).unwrap();
    let way = path::by_name("vehicle", &scene, scans).unwrap();
    let sensor = tsdfuse::sensor::model("vlp16").unwrap();
    Simulator::new(scene, sensor, way, SimulatorConfig::default())
        .unwrap()
        .scans()
        .collect()
}

/// A log of scans with their poses, slightly wrong.
fn write(path: &Path, scans: &[Scan]) {
    let mut writer = Writer::create(path).unwrap();
    for (i, scan) in scans.iter().enumerate() {
        let off = 0.03 * (1.7 * i as f64).sin();
        let mut scan = scan.clone();
        scan.pose = scan.pose.map(|pose| Pose {
            rotation: pose.rotation * DQuat::from_rotation_z(0.1 * off),
            translation: pose.translation + DVec3::new(off, -off, 0.5 * off),
        });
        writer.write_scan(&scan).unwrap();
    }
    writer.finish().unwrap();
}

fn job(log: &Path, poses: PosesFrom, map: PathBuf) -> Job {
    let mut settings = Settings::default();
    for text in ["method=raycast", "map.voxel_size_m=0.2", "map.truncation_m=0.6"] {
        settings.set_text(text).unwrap();
    }
    Job {
        input: Input {
            path: log.to_owned(),
            ..Input::default()
        },
        poses,
        settings,
        outputs: Outputs {
            map: Some(map),
            ..Outputs::default()
        },
        ..Job::default()
    }
}

fn run(job: &Job) -> Result<Report, RunError> {
    job.run(&Stop::default(), &mut Silent)
}

#[test]
fn tracked_and_refined_runs_that_are_broken_off_end_as_if_they_had_not_been() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("log");
    write(&log, &street(14));
    for poses in [PosesFrom::Track, PosesFrom::Refine] {
        let [whole, parts, store] =
            ["whole", "parts", "store"].map(|name| dir.path().join(format!("{poses:?}.{name}")));
        let found = run(&job(&log, poses, whole.clone())).unwrap().odometry.unwrap();
        assert!(
            found.distance_m > 5.0 && found.unmatched == 0 && found.pieces == 1,
            "{found:?}"
        );
        let broken = Job {
            store: Some(store.clone()),
            commit_every: 2,
            ..job(&log, poses, parts.clone())
        };
        let stop = Stop::default();
        let report = broken.run(&stop, &mut |event: Event<'_>| {
            if let Event::ScanFused { index: 6, .. } = event {
                stop.stop();
            }
        });
        assert!(report.unwrap().stopped);
        let (again, resumed) = Job::of_store(&store).unwrap();
        assert_eq!(again.poses, poses);
        let report = again.resume(resumed, &Stop::default(), &mut Silent).unwrap();
        assert_eq!(report.totals.scans, 14);
        let of = |path: &Path| map_file::read_with_poses(path).unwrap();
        assert!(of(&whole) == of(&parts), "{poses:?}");
    }
}

#[test]
fn a_log_without_poses_goes_on_in_a_map_where_it_belongs() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let scans = street(24);
    write(&at("first"), &scans[..16]);
    write(&at("second"), &scans[10..]);
    let settings = |job: Job| Job {
        settings: {
            let mut settings = job.settings.clone();
            settings.set_text("map.voxel_size_m=0.1").unwrap();
            settings.set_text("map.truncation_m=0.3").unwrap();
            settings
        },
        ..job
    };
    run(&settings(job(&at("first"), PosesFrom::Log, at("first.tsdf")))).unwrap();
    let near = scans[10].pose.unwrap();
    let near = Pose {
        rotation: near.rotation * DQuat::from_rotation_z(-0.3),
        translation: near.translation + DVec3::new(1.0, 1.5, 0.2),
    };
    for (name, initial_pose) in [("along", None), ("near", Some(near))] {
        let second = Job {
            load_map: Some(at("first.tsdf")),
            initial_pose,
            ..settings(job(&at("second"), PosesFrom::Track, at(name)))
        };
        run(&second).unwrap();
        let (_, poses) = map_file::read_with_poses(at(name)).unwrap();
        assert_eq!(poses.len(), 16 + 14);
        for (fused, scan) in poses[16..].iter().zip(&scans[10..]) {
            let off = fused.pose.translation.distance(scan.pose.unwrap().translation);
            assert!(off < 0.1, "{name}: {off} m");
        }
    }
    let far = Job {
        load_map: Some(at("first.tsdf")),
        initial_pose: Some(Pose {
            translation: DVec3::Z * 300.0,
            ..Pose::IDENTITY
        }),
        ..settings(job(&at("second"), PosesFrom::Track, at("far")))
    };
    let told = run(&far).unwrap_err().to_string();
    assert!(told.contains("its place in the saved map was not found"), "{told}");
    let given = Job {
        poses: PosesFrom::Log,
        ..far
    };
    let told = run(&given).unwrap_err().to_string();
    assert!(told.contains("--initial-pose"), "{told}");
}

/// Each 5 ms of a drive, how fast a sensor turns that turns steadily from scan to scan, and gravity.
fn imu(scans: &[Scan]) -> Vec<ImuSample> {
    let sample = |pair: &[Scan], step: i64| {
        let [a, b] = [&pair[0], &pair[1]].map(|scan| (scan.pose.unwrap().rotation, scan.time_ns.unwrap()));
        ImuSample {
            time_ns: a.1 + step * 5_000_000,
            angular_velocity: (a.0.conjugate() * b.0).to_scaled_axis() / (1e-9 * (b.1 - a.1) as f64),
            acceleration: a.0.conjugate() * (DVec3::Z * 9.806_65),
            orientation: None,
        }
    };
    let pairs = scans.windows(2);
    pairs
        .flat_map(|pair| (0..20).map(move |step| sample(pair, step)))
        .collect()
}

/// A log that comes scan by scan, each with the samples until it is complete.
struct Replayed {
    log: Log,
    next: usize,
    imu: Vec<ImuSample>,
}

impl Stream for Replayed {
    fn format(&self) -> &str {
        "replayed"
    }

    fn sensors(&self) -> &[Sensor] {
        self.log.sensors()
    }

    fn next(&mut self) -> Option<StreamedScan> {
        let index = self.next;
        self.next += 1;
        (index < self.log.scans().len()).then(|| StreamedScan {
            sensor: 0,
            scan: self.log.read(index),
        })
    }

    fn imu(&mut self) -> Vec<ImuSample> {
        let until_ns = self.log.scans()[self.next - 1].time_ns.unwrap() + 105_000_000;
        let come = self.imu.partition_point(|sample| sample.time_ns <= until_ns);
        self.imu.drain(..come).collect()
    }

    fn is_placed(&self) -> bool {
        false
    }
}

#[test]
fn samples_that_come_with_a_stream_place_its_scans_as_those_of_a_log() {
    let dir = tempfile::tempdir().unwrap();
    let scans = street(30);
    let mut writer = Writer::create(dir.path()).unwrap();
    writer.write_imu(&imu(&scans)).unwrap();
    for scan in &scans {
        writer
            .write_scan(&Scan {
                pose: None,
                ..scan.clone()
            })
            .unwrap();
    }
    writer.finish().unwrap();
    let log = tsdfuse_io::open(dir.path()).unwrap();
    let tracked = |log: &Log| -> Track {
        let (config, limits) = (OdometryConfig::default(), RangeLimits::default());
        tsdfuse_run::track(log, &Selection::default(), config, None, limits, &Stop::default()).unwrap()
    };
    let streamed = |imu: Vec<ImuSample>| {
        let (log, next) = (log.clone(), 0);
        tracked(&Log::of_stream(Replayed { log, next, imu }))
    };
    let poses = |track: &Track| track.scans.iter().map(|scan| scan.pose).collect::<Vec<_>>();
    let (whole, stream) = (tracked(&log), streamed(log.imu().unwrap()));
    let [told, again] = [&whole, &stream].map(|track| track.imu.clone().unwrap().predicted);
    assert_eq!(told, again);
    assert!(told[0] + told[1] > 10, "{told:?}");
    assert_eq!(poses(&whole), poses(&stream));
    // Those of no IMU are others.
    let without = streamed(Vec::new());
    assert!(without.imu.is_none() && poses(&without) != poses(&whole));
}
