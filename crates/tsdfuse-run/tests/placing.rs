//! Runs whose poses are found or refined: broken off, continued, and begun in a map that is there.

#![allow(clippy::unwrap_used)] // test helpers

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::{Pose, Scan};
use tsdfuse_io::map_file;
use tsdfuse_io::plain::Writer;
use tsdfuse_run::{Event, Input, Job, Outputs, PosesFrom, Report, RunError, Settings, Silent, Stop};
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
