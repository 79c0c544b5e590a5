//! Drives that come back: poses are corrected before anything is fused, wherever the map is meanwhile.

#![allow(clippy::unwrap_used)] // test helpers

use std::collections::HashMap;
use std::path::Path;

use tsdfuse::{Pose, VoxelMap, mesh};
use tsdfuse_io::{Log, map_file};
use tsdfuse_run::{Event, Input, Job, Observer, Outputs, PosesFrom, Report, Session, Settings, Setup, Silent, Stop};
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

/// A drone flies through a hall and back, in about so many scans; its poses are not known.
fn write_log(folder: &Path, scans: usize) -> Vec<Pose> {
    let scene = scene::by_name("hall", 3).unwrap();
    let way: Vec<Pose> = path::by_name("drone", &scene, scans).unwrap();
    let there = way.iter().take(scans / 2).copied();
    // Back along the same way, so that no scan lies far from the one before.
    let way: Vec<Pose> = there.clone().chain(there.rev().skip(1)).collect();
    let mut sensor = tsdfuse::sensor::model("vlp16").unwrap();
    sensor.columns = 600; // quicker, and enough for odometry
    let config = SimulatorConfig {
        motion: false,
        ..SimulatorConfig::default()
    };
    let simulator = Simulator::new(scene, sensor, way.clone(), config).unwrap();
    let mut writer = tsdfuse_io::plain::Writer::create(folder).unwrap();
    for mut scan in simulator.scans() {
        scan.pose = None;
        writer.write_scan(&scan).unwrap();
    }
    writer.finish().unwrap();
    way
}

fn job(log: &Path, map: &Path) -> Job {
    let mut settings = Settings::default();
    for setting in [
        "method=raycast",
        "map.voxel_size_m=0.2",
        "map.truncation_m=0.6",
        "loops.gap_m=6",
    ] {
        settings.set_text(setting).unwrap();
    }
    Job {
        input: Input {
            path: log.to_owned(),
            ..Input::default()
        },
        poses: PosesFrom::Track,
        settings,
        outputs: Outputs {
            map: Some(map.to_owned()),
            ..Outputs::default()
        },
        ..Job::default()
    }
}

fn run(job: &Job) -> (Report, VoxelMap) {
    let report = job.run(&Stop::default(), &mut Silent).unwrap();
    (report, map_file::read(job.outputs.map.as_ref().unwrap()).unwrap())
}

#[test]
fn a_map_is_that_of_the_final_poses_in_memory_paged_stored_and_resumed() {
    let dir = tempfile::tempdir().unwrap();
    let (path, map) = (dir.path().join("drive"), dir.path().join("map.tsdf"));
    let truth = write_log(&path, 80);
    let closing = job(&path, &map);
    let (report, whole) = run(&closing);
    let odometry = report.odometry.unwrap();
    let loops = odometry.loops.clone().unwrap();
    assert!(!loops.closures.is_empty(), "{} m", odometry.distance_m);
    assert!(
        loops
            .closures
            .iter()
            .all(|closure| closure.later < truth.len() && !closure.is_doubted)
    );

    // One fusion of scans that are placed so from the beginning.
    let log: Log = tsdfuse_io::open(&path).unwrap();
    let setup = Setup {
        config: report.config.clone(),
        ..Setup::for_log(&log)
    };
    let (_, poses) = map_file::read_with_poses(&map).unwrap();
    let mut session = Session::begin(&log, setup, &mut Silent).unwrap();
    for (index, fused) in poses.iter().enumerate() {
        let mut scan = log.read(index).unwrap();
        scan.pose = Some(fused.pose);
        session.fuse(0, scan, &mut Silent).unwrap();
    }
    session.finish(&mut Silent).unwrap();
    assert_eq!(session.map().unwrap(), &whole);

    // Poses without closures are others.
    let open = Job {
        open_loops: true,
        ..closing.clone()
    };
    let (open, map_of_open) = run(&open);
    assert!(open.odometry.unwrap().loops.is_none());
    assert!(map_of_open != whole);

    let paged = Job {
        memory_bytes: Some(1 << 20),
        ..closing.clone()
    };
    assert!(run(&paged).1 == whole);

    let stored = Job {
        store: Some(dir.path().join("run.store")),
        commit_every: 5,
        outputs: Outputs::default(),
        ..closing.clone()
    };
    let stop = Stop::default();
    let stopper = stop.clone();
    let report = stored.run(&stop, &mut |event: Event<'_>| {
        if let Event::ScanFused { index: 30, .. } = event {
            stopper.stop();
        }
    });
    assert!(report.unwrap().stopped);
    let (again, resumed) = Job::of_store(stored.store.as_ref().unwrap()).unwrap();
    let again = Job {
        outputs: closing.outputs.clone(),
        ..again
    };
    let report = again.resume(resumed, &Stop::default(), &mut Silent).unwrap();
    assert_eq!(report.totals.scans, truth.len());
    let (resumed, poses_again) = map_file::read_with_poses(&map).unwrap();
    assert!(resumed == whole);
    assert!(poses == poses_again);
}

/// The same drive as a recording.
fn write_recording(folder: &Path, recording: &Path) {
    let log: Log = tsdfuse_io::open(folder).unwrap();
    let mut writer = tsdfuse_io::ros::Writer::create(recording, log.sensors()).unwrap();
    for index in 0..log.len().unwrap() {
        writer.write_scan(0, &log.read(index).unwrap()).unwrap();
    }
    writer.finish().unwrap();
}

/// Shows the surface of a run as a viewer does, and stops it where that is asked for.
#[derive(Default)]
struct Viewer {
    /// Triangles of each block.
    surface: HashMap<[i32; 3], usize>,
    begun: usize,
    loops: usize,
    /// When fused for which time, and after which scan.
    stops: Option<(usize, usize)>,
    stop: Stop,
}

impl Observer for Viewer {
    fn on(&mut self, event: Event<'_>) {
        match event {
            Event::Begun { .. } => self.begun += 1,
            Event::LoopsClosed(ends) => self.loops = ends.len(),
            Event::SurfaceChanged(changes) => {
                let pieces = changes.iter();
                self.surface
                    .extend(pieces.map(|piece| (piece.block.0.to_array(), piece.triangles.len())));
            }
            Event::ScanFused { index, .. } if self.stops == Some((self.begun, index)) => self.stop.stop(),
            _ => {}
        }
    }

    fn surface_share(&self) -> Option<f64> {
        Some(0.5)
    }
}

#[test]
fn a_stream_that_is_over_or_stopped_gives_the_map_of_its_recording() {
    let dir = tempfile::tempdir().unwrap();
    let [folder, path, map] = ["drive", "drive.mcap", "map.tsdf"].map(|name| dir.path().join(name));
    let scans = write_log(&folder, 40).len();
    write_recording(&folder, &path);
    let of_file = job(&path, &map);
    let (_, whole) = run(&of_file);
    let (_, poses) = map_file::read_with_poses(&map).unwrap();
    let mut streamed = of_file.clone();
    streamed.input.options.follow = true;
    let stored = Job {
        store: Some(dir.path().join("run.store")),
        commit_every: 5,
        ..streamed.clone()
    };
    let watched = |job: &Job, stops: Option<(usize, usize)>| {
        let mut viewer = Viewer {
            stops,
            ..Viewer::default()
        };
        let report = job.run(&viewer.stop.clone(), &mut viewer).unwrap();
        let (map, poses) = map_file::read_with_poses(&map).unwrap();
        (viewer, report, map, poses)
    };

    let mut recorded = streamed.clone();
    recorded.outputs.recording = Some(dir.path().join("run.mcap"));
    let (viewer, report, of_stream, poses_of_stream) = watched(&recorded, None);
    assert_eq!((viewer.begun, report.totals.scans), (2, scans));
    assert_eq!(
        tsdfuse_io::open(dir.path().join("run.mcap")).unwrap().len(),
        Some(scans)
    );
    assert!(of_stream == whole && poses_of_stream == poses);
    assert!(!report.odometry.unwrap().loops.unwrap().closures.is_empty() && viewer.loops > 0);
    // Viewers have the surface of this map, and nothing is left of the one before.
    let triangles = mesh::extract(&whole).unwrap().triangles.len();
    assert_eq!(viewer.surface.values().sum::<usize>(), triangles);

    // Stopped on the way back: what came by then is fused again, all of it.
    let (viewer, report, part, _) = watched(&streamed, Some((1, 35)));
    let fused = report.totals.scans;
    assert!(
        viewer.begun == 2 && report.stopped && (36..scans).contains(&fused),
        "{fused}"
    );
    let mut as_file = of_file.clone();
    as_file.input.selection.to = Some(fused);
    assert!(run(&as_file).1 == part);

    // Broken off while it is fused again.
    let (viewer, report, ..) = watched(&stored, Some((2, 12)));
    assert!(viewer.begun == 2 && report.stopped && report.totals.scans == 13);
    let (again, resumed) = Job::of_store(stored.store.as_ref().unwrap()).unwrap();
    assert_eq!(resumed.checkpoint().asked, Some(scans));
    again.resume(resumed, &Stop::default(), &mut Silent).unwrap();
    assert!(map_file::read(&map).unwrap() == whole);
}
