//! Runs from a log to a map: all backends give one result, and what ends a run is told from what a scan ends.

#![allow(clippy::unwrap_used)] // test helpers

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};

use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::mesh::extract;
use tsdfuse::{Pose, Scan, VoxelMap};
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::{Log, ScanRef, Sensor, Source, Stream, StreamedScan};
use tsdfuse_run::report::SkippedScan;
use tsdfuse_run::{Event, Job, RunError, Session, Settings, Setup, Silent, Stop};

/// Scans of a wall from places one metre apart; some cannot be read, and some cannot be fused.
#[derive(Clone)]
struct Wall {
    scans: Vec<ScanRef>,
    sensors: Vec<Sensor>,
    unreadable: BTreeSet<usize>,
    too_far: BTreeSet<usize>,
}

impl Wall {
    fn new(scans: usize) -> Self {
        let scan = |number: usize| ScanRef {
            name: format!("{number:06}.bin"),
            sensor: 0,
            time_ns: None,
            pose: Some(Pose {
                translation: DVec3::Y * number as f64,
                ..Pose::IDENTITY
            }),
        };
        Self {
            scans: (0..scans).map(scan).collect(),
            sensors: vec![Sensor::new("wall")],
            unreadable: BTreeSet::new(),
            too_far: BTreeSet::new(),
        }
    }

    fn log(self) -> Log {
        Log::new(self)
    }
}

impl Source for Wall {
    fn format(&self) -> &str {
        "a wall"
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> tsdfuse_io::Result<Scan> {
        let reference = &self.scans[index];
        if self.unreadable.contains(&index) {
            return Err(tsdfuse_io::Error::dataset(&reference.name, "broken"));
        }
        let grid = (-40..40).flat_map(|y| (-20..20).map(move |z| Vec3::new(4.0, 0.05 * y as f32, 0.05 * z as f32)));
        let mut pose = reference.pose;
        if self.too_far.contains(&index) {
            pose = pose.map(|pose| Pose {
                translation: DVec3::X * 1e30,
                ..pose
            });
        }
        let points: Vec<Vec3> = grid.collect();
        Ok(Scan {
            name: reference.name.clone(),
            time_ns: reference.time_ns,
            intensities: Some(points.iter().map(|point| 40.0 / point.length() + point.z).collect()),
            points,
            pose,
            ..Scan::default()
        })
    }
}

struct WallStream(Wall, usize);

impl Stream for WallStream {
    fn format(&self) -> &str {
        "a wall, scan by scan"
    }

    fn sensors(&self) -> &[Sensor] {
        &self.0.sensors
    }

    fn next(&mut self) -> Option<StreamedScan> {
        let index = self.1;
        self.1 += 1;
        (index < self.0.scans.len()).then(|| StreamedScan {
            sensor: 0,
            scan: self.0.read(index),
        })
    }
}

fn setup(log: &Log) -> Setup {
    let mut setup = Setup::for_log(log);
    setup.config.method = tsdfuse::fuse::Method::Raycast;
    setup
}

fn fused(log: &Log, setup: Setup) -> VoxelMap {
    let mut session = Session::begin(log, setup, &mut Silent).unwrap();
    session.run(&mut Silent).unwrap();
    session.map().unwrap().clone()
}

/// The map of a session that has it in a file.
fn saved(mut session: Session, dir: &Path) -> VoxelMap {
    let path = dir.join("saved.tsdf");
    session.save_map(&path).unwrap();
    tsdfuse_io::map_file::read(&path).unwrap()
}

#[test]
fn memory_pages_stores_and_streams_give_one_map() {
    let dir = tempfile::tempdir().unwrap();
    let wall = Wall::new(30);
    let log = wall.clone().log();
    let whole = fused(&log, setup(&log));
    assert!(whole.block_count() > 300);

    let stream = Log::of_stream(WallStream(wall, 0));
    assert_eq!(stream.len(), None);
    assert_eq!(fused(&stream, setup(&stream)), whole);

    let paged = Setup {
        memory_bytes: Some(1 << 20),
        temporary: dir.path().to_owned(),
        ..setup(&log)
    };
    let mut session = Session::begin(&log, paged, &mut Silent).unwrap();
    session.run(&mut Silent).unwrap();
    assert!(session.map().is_none() && session.mesh().is_err());
    assert_eq!(saved(session, dir.path()), whole);
    let left: Vec<_> = std::fs::read_dir(dir.path())
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    assert_eq!(left, ["saved.tsdf"], "the temporary store is gone");
}

#[test]
fn pieces_add_up_to_the_surface_in_memory_and_paged_and_in_turns() {
    let dir = tempfile::tempdir().unwrap();
    let log = Wall::new(12).log();
    let pieces = |memory_bytes, follow_near_m| {
        let setup = Setup {
            memory_bytes,
            follow_near_m,
            temporary: dir.path().to_owned(),
            follow_every: Some(1),
            ..setup(&log)
        };
        let (mut pieces, mut told) = (std::collections::BTreeMap::new(), 0);
        let mut session = Session::begin(&log, setup, &mut Silent).unwrap();
        let mut watch = |event: Event<'_>| {
            if let Event::SurfaceChanged(changes) = event {
                pieces.extend(changes.iter().map(|piece| (piece.block, piece.triangles.len())));
                told += changes.len();
            }
        };
        session.run(&mut watch).unwrap();
        pieces.retain(|_, triangles| *triangles > 0);
        (pieces, told)
    };
    let whole = extract(&fused(&log, setup(&log))).unwrap();
    let (in_memory, told) = pieces(None, None);
    assert_eq!(in_memory.values().sum::<usize>(), whole.triangles.len());
    assert_eq!(pieces(Some(1 << 20), None).0, in_memory);
    let (in_turns, told_in_turns) = pieces(None, Some(0.5));
    assert_eq!(in_turns, in_memory);
    assert!(told_in_turns < told * 3 / 4, "{told_in_turns} {told}");
}

#[test]
fn a_run_that_is_stopped_leaves_what_a_commit_leaves_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("log");
    write_log(&path, 9);
    let job = Job {
        input: tsdfuse_run::Input {
            path: path.clone(),
            ..Default::default()
        },
        settings: raycast(),
        store: Some(dir.path().join("run.store")),
        commit_every: 2,
        ..Job::default()
    };
    let stop = Stop::default();
    let from_elsewhere = Arc::new(Mutex::new(stop.clone()));
    let mut stored = Vec::new();
    let report = job.run(&stop, &mut |event: Event<'_>| match event {
        Event::ScanFused { index: 4, .. } => {
            let stop = from_elsewhere.clone();
            std::thread::spawn(move || stop.lock().unwrap().stop()).join().unwrap();
        }
        Event::MapStored { done, asked, .. } => stored.push((done, asked)),
        _ => {}
    });
    let report = report.unwrap();
    assert!(report.stopped);
    assert_eq!(
        (report.totals.scans, stored),
        (5, vec![(2, Some(9)), (4, Some(9)), (5, Some(9))])
    );

    let (again, resumed) = Job::of_store(job.store.as_ref().unwrap()).unwrap();
    assert_eq!((resumed.checkpoint().done, &again.input.path), (5, &path));
    let mut begun = None;
    let again = Job {
        outputs: tsdfuse_run::Outputs {
            map: Some(dir.path().join("map.tsdf")),
            ..Default::default()
        },
        ..again
    };
    let report = again.resume(resumed, &Stop::default(), &mut |event: Event<'_>| {
        if let Event::Begun { scans, done, .. } = event {
            begun = Some((scans, done));
        }
    });
    let report = report.unwrap();
    assert_eq!(
        (report.scans.len(), report.totals.scans, begun),
        (4, 9, Some((Some(9), 5)))
    );
    let log = tsdfuse_io::open(&path).unwrap();
    let (map, poses) = tsdfuse_io::map_file::read_with_poses(dir.path().join("map.tsdf")).unwrap();
    assert_eq!(map, fused(&log, setup(&log)));
    assert_eq!(places(&poses), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    let store = tsdfuse_store::PagedMap::open_read_only(job.store.as_ref().unwrap(), None).unwrap();
    assert_eq!(store.0.poses(), poses);
}

#[test]
fn what_moves_is_left_out_also_by_a_run_that_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("log");
    let mut writer = tsdfuse_io::plain::Writer::create(&path).unwrap();
    for number in 0..16_u8 {
        let square = |x: f32, y: f32, reach: i32| {
            let side = (-reach..=reach).map(|i| 0.05 * i as f32);
            side.clone()
                .flat_map(|across| side.clone().map(move |up| Vec3::new(x, y + across, up)))
                .collect::<Vec<_>>()
        };
        // From the ninth scan on, something passes before a wall.
        let mut points = square(6.0, 0.0, 60);
        if number >= 8 {
            points.extend(square(3.5, 0.1 * f32::from(number) - 1.2, 6));
        }
        let scan = Scan {
            name: format!("{number:06}"),
            points,
            pose: Some(Pose::IDENTITY),
            ..Scan::default()
        };
        writer.write_scan(&scan).unwrap();
    }
    writer.finish().unwrap();
    let job = |name: &str, settings: &[(&str, bool)]| {
        let mut job = Job {
            input: tsdfuse_run::Input {
                path: path.clone(),
                ..Default::default()
            },
            store: Some(dir.path().join(format!("{name}.store"))),
            outputs: tsdfuse_run::Outputs {
                map: Some(dir.path().join(format!("{name}.tsdf"))),
                ..Default::default()
            },
            commit_every: 4,
            ..Job::default()
        };
        for (key, value) in settings {
            job.settings.set("here", key, *value).unwrap();
        }
        job
    };
    let moving = |report: &tsdfuse_run::Report| report.totals.sums.dropped.moving;
    let map = |name: &str| std::fs::read(dir.path().join(format!("{name}.tsdf"))).unwrap();
    let whole = job("whole", &[]).run(&Stop::default(), &mut Silent).unwrap();
    assert_eq!(moving(&whole), 8 * 13 * 13);
    let with = job("with", &[("moving.leave_out", false)])
        .run(&Stop::default(), &mut Silent)
        .unwrap();
    assert_eq!(moving(&with), 0);

    let stop = Stop::default();
    let stopping = stop.clone();
    let stopped = job("parts", &[]).run(&stop, &mut |event: Event<'_>| {
        if let Event::ScanFused { index: 9, .. } = event {
            stopping.stop();
        }
    });
    assert!(stopped.unwrap().stopped);
    let (again, resumed) = Job::of_store(&dir.path().join("parts.store")).unwrap();
    let resumed = again.resume(resumed, &Stop::default(), &mut Silent).unwrap();
    assert_eq!(moving(&resumed), moving(&whole));
    assert!(map("parts") == map("whole"));
    assert!(map("with") != map("whole"));
}

#[test]
fn intensities_beside_a_store_go_on_as_if_nothing_had_been() {
    let dir = tempfile::tempdir().unwrap();
    write_log(&dir.path().join("log"), 9);
    let job = |store: &str, map: Option<&str>| Job {
        input: tsdfuse_run::Input {
            path: dir.path().join("log"),
            ..Default::default()
        },
        settings: raycast(),
        store: Some(dir.path().join(store)),
        outputs: tsdfuse_run::Outputs {
            intensity: true,
            map: map.map(|map| dir.path().join(map)),
            ..Default::default()
        },
        commit_every: 2,
        ..Job::default()
    };
    job("whole.store", Some("whole.tsdf"))
        .run(&Stop::default(), &mut Silent)
        .unwrap();
    let stop = Stop::default();
    let stopping = stop.clone();
    let report = job("parts.store", None).run(&stop, &mut |event: Event<'_>| {
        if let Event::ScanFused { index: 4, .. } = event {
            stopping.stop();
        }
    });
    assert!(report.unwrap().stopped);
    let (mut again, resumed) = Job::of_store(&dir.path().join("parts.store")).unwrap();
    again.outputs.map = Some(dir.path().join("parts.tsdf"));
    again.resume(resumed, &Stop::default(), &mut Silent).unwrap();
    let layer = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    for ending in ["intensity.tsdf", "tsdf"] {
        assert!(
            layer(&format!("whole.{ending}")) == layer(&format!("parts.{ending}")),
            "{ending}"
        );
    }
    // What was learnt lies in the store.
    let (_, resumed) = Job::of_store(&dir.path().join("parts.store")).unwrap();
    assert!(resumed.checkpoint().response.is_some());
}

#[test]
fn only_bad_scans_are_skipped() {
    let mut wall = Wall::new(6);
    wall.unreadable.insert(1);
    wall.too_far.insert(3);
    let log = wall.clone().log();
    let mut session = Session::begin(&log, setup(&log), &mut Silent).unwrap();
    let error = session.run(&mut Silent).unwrap_err();
    assert!(
        matches!(&error, RunError::BadScan(bad) if bad.scan == "000001.bin"),
        "{error:?}"
    );

    let skipping = Setup {
        skip_bad: true,
        ..setup(&log)
    };
    let mut told = Vec::new();
    let mut session = Session::begin(&log, skipping, &mut Silent).unwrap();
    let mut watch = |event: Event<'_>| {
        if let Event::ScanSkipped { index, skipped } = event {
            told.push((index, skipped.clone()));
        }
    };
    session.run(&mut watch).unwrap();
    let names: Vec<&str> = session
        .skipped()
        .iter()
        .map(|s: &SkippedScan| s.name.as_str())
        .collect();
    assert_eq!(names, ["000001.bin", "000003.bin"]);
    assert_eq!(told.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [1, 3]);
    assert!(told[1].1.reason.contains("outside the map's grid"), "{told:?}");
    // The map is that of the other scans.
    let mut others = wall;
    others.scans = [0, 2, 4, 5].map(|i| others.scans[i].clone()).to_vec();
    (others.unreadable, others.too_far) = Default::default();
    let others = others.log();
    assert_eq!(session.map().unwrap(), &fused(&others, setup(&others)));
    assert_eq!(places(session.poses()), [0, 2, 4, 5]);
}

#[test]
fn a_map_that_is_continued_keeps_its_trajectory() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("first.tsdf");
    let mut wall = Wall::new(7);
    for (scan, time_ns) in wall.scans.iter_mut().zip(100..) {
        scan.time_ns = Some(time_ns);
    }
    let mut parts = [wall.clone(), wall];
    parts[0].scans.truncate(4);
    parts[1].scans.drain(..4);
    let [first, second] = parts.map(Wall::log);
    let mut session = Session::begin(&first, setup(&first), &mut Silent).unwrap();
    session.run(&mut Silent).unwrap();
    session.save_map(&path).unwrap();
    for (memory_bytes, store) in [
        (None, None),
        (Some(1 << 20), None),
        (None, Some(dir.path().join("a.store"))),
    ] {
        let continued = Setup {
            load_map: Some(path.clone()),
            temporary: dir.path().to_owned(),
            memory_bytes,
            store,
            ..setup(&second)
        };
        let mut session = Session::begin(&second, continued, &mut Silent).unwrap();
        session.run(&mut Silent).unwrap();
        assert_eq!(places(session.poses()), [0, 1, 2, 3, 4, 5, 6]);
        let times: Vec<_> = session.poses().iter().filter_map(|pose| pose.time_ns).collect();
        assert_eq!(times, (100..107).collect::<Vec<i64>>());
        let all = dir.path().join("all.tsdf");
        session.save_map(&all).unwrap();
        let saved = tsdfuse_io::map_file::read_with_poses(&all).unwrap().1;
        assert_eq!(saved, session.poses());
    }
}

/// The numbers of the scans at the wall with these poses.
fn places(poses: &[FusedPose]) -> Vec<usize> {
    poses.iter().map(|pose| pose.pose.translation.y as usize).collect()
}

/// With a store that can no longer be written, the run ends: no scan is to blame.
#[cfg(target_os = "linux")]
#[test]
fn a_broken_store_is_no_bad_scan() {
    let dir = tempfile::tempdir().unwrap();
    let log = Wall::new(40).log();
    let setup = Setup {
        skip_bad: true,
        store: Some(std::path::PathBuf::from("/dev/full/no.store")),
        temporary: dir.path().to_owned(),
        ..setup(&log)
    };
    let error = Session::begin(&log, setup, &mut Silent).err().unwrap();
    assert!(matches!(error, RunError::Store(_)), "{error:?}");
}

#[test]
fn nothing_fused_is_an_error_that_says_why() {
    let mut wall = Wall::new(3);
    wall.unreadable.extend(0..3);
    let log = wall.log();
    let setup = Setup {
        skip_bad: true,
        ..setup(&log)
    };
    let mut session = Session::begin(&log, setup, &mut Silent).unwrap();
    let error = session.run(&mut Silent).unwrap_err().to_string();
    assert!(error.contains("none of its scans could be fused"), "{error}");
}

#[test]
fn scans_can_be_pushed_as_they_come() {
    let wall = Wall::new(5);
    let log = wall.clone().log();
    let whole = fused(&log, setup(&log));
    let mut empty = wall.clone();
    empty.scans.clear();
    let empty = empty.log();
    let mut session = Session::begin(&empty, setup(&log), &mut Silent).unwrap();
    for index in 0..5 {
        session.fuse(0, wall.read(index).unwrap(), &mut Silent).unwrap();
    }
    session.finish(&mut Silent).unwrap();
    assert_eq!(session.map(), Some(&whole));
}

/// Ten lines of Rust give the map of a session, bit for bit.
#[test]
fn the_core_alone_gives_the_same_map() {
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sample/pandaset-002");
    let log = tsdfuse_io::open(sample).unwrap();
    let suggested = log.suggested();
    let mut map = VoxelMap::new(suggested.map).unwrap();
    let mut fuser = suggested
        .method
        .build(&Default::default(), log.sensors()[0].model.as_ref());
    for scan in &log {
        fuser.integrate(&mut map, &scan.unwrap()).unwrap();
    }
    assert_eq!(map, fused(&log, Setup::for_log(&log)));
}

fn raycast() -> Settings {
    let mut settings = Settings::default();
    settings.set_text("method=raycast").unwrap();
    settings
}

/// A plain folder with scans of the wall.
fn write_log(path: &Path, scans: usize) {
    let wall = Wall::new(scans);
    let mut writer = tsdfuse_io::plain::Writer::create(path).unwrap();
    (0..scans).for_each(|index| writer.write_scan(&wall.read(index).unwrap()).unwrap());
    writer.finish().unwrap();
}
