//! Recordings that `rosbags` and `mcap` wrote (`testdata/ros/make.py`), and what hostile ones do.

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Scan};

use crate::source::{OpenOptions, Source};
use crate::{Log, open, open_with};

const T0: i64 = 1_600_000_000_000_000_000;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/ros").join(name)
}

fn names() -> Vec<&'static str> {
    let mut names = vec!["ros1_lz4.bag", "ros1_bz2.bag", "ros2_message", "zstd.mcap", "lz4.mcap"];
    if cfg!(feature = "db3") {
        names.push("ros2_file");
    }
    names
}

fn only(path: &Path, sensor: &str) -> Log {
    let options = OpenOptions {
        sensors: vec![sensor.to_owned()],
        ..OpenOptions::default()
    };
    open_with(path, &options).unwrap()
}

fn has_note(log: &Log, part: &str) -> bool {
    log.notes().iter().any(|note| note.contains(part))
}

#[test]
fn all_containers_hold_the_same_scans() {
    for name in names() {
        let log = only(&data(name), "/points");
        assert_eq!(log.len(), Some(10), "{name}");
        for k in [0, 4, 9] {
            let scan = log.read(k).unwrap();
            assert_eq!(scan.time_ns, Some(T0 + k as i64 * 100_000_000), "{name}");
            assert_eq!(scan.points.len(), 80);
            assert_eq!((scan.points[0].x, scan.points[0].y), (5.0 + k as f32, 1.0));
            // Ring 0 is the highest in the message.
            assert_eq!(scan.rings.as_ref().unwrap()[..9], [7, 6, 5, 4, 3, 2, 1, 0, 7]);
            let times = scan.times.as_ref().unwrap();
            assert!(times[0] == 0.0 && (times[79] - 0.09875).abs() < 1e-7);
            let pose = scan.pose.unwrap();
            assert!(
                pose.translation.distance(DVec3::new(0.1 * k as f64 + 0.5, 0.0, 2.0)) < 1e-9,
                "{name}"
            );
            // Each point from where the sensor was then: 1 m/s.
            let last = scan.points_in_world().unwrap().last().unwrap();
            let want = pose.translation.x + 0.09875 + f64::from(scan.points[79].x);
            assert!((last.x - want).abs() < 1e-6, "{name}: {last}");
        }
        assert_eq!(log.trajectory().unwrap().poses().len(), 24);
        let imu = log.imu().unwrap();
        // 1 at rest: in g.
        assert!((imu[0].acceleration.z - 9.80665).abs() < 1e-9 && imu.len() == 24 && imu[0].orientation.is_none());
        assert_eq!(log.gnss().unwrap()[2].latitude_deg, 50.5);
        assert_eq!(log.images().len(), 3, "{name}: {:?}", log.notes());
        let image = &log.images()[1];
        assert!((image.pose.unwrap().translation.x - 0.4).abs() < 1e-9 && image.camera.fx == 100.0);
        assert!(log.read_image(1).unwrap().starts_with(b"\x89PNG"));
    }
}

#[test]
fn livox_and_another_sensor_are_read_together_or_chosen() {
    let log = open(data("zstd.mcap")).unwrap();
    assert_eq!((log.len(), log.sensors().len()), (Some(20), 2));
    assert!(has_note(&log, "are read together"));
    let livox = only(&data("zstd.mcap"), "livox");
    let scan = livox.read(3).unwrap();
    assert_eq!(scan.points[..2], [Vec3::new(3.0, 0.0, 0.5), Vec3::new(3.0, 1.0, 0.5)]);
    assert_eq!((scan.rings, scan.intensities.unwrap()[95]), (None, 95.0));
    assert!((scan.times.unwrap()[95] - 0.095).abs() < 1e-7);
    assert_eq!(
        livox.sensors()[0].body_from_sensor.translation,
        DVec3::new(1.0, 0.0, 1.0)
    );
    let wrong = OpenOptions {
        sensors: vec!["/other".into()],
        ..OpenOptions::default()
    };
    let told = open_with(data("zstd.mcap"), &wrong).unwrap_err().to_string();
    assert!(
        told.ends_with("there is no sensor \"/other\"; the topics with points are /livox/lidar, /points"),
        "{told}"
    );
}

#[test]
fn poses_are_chosen_by_topic_frame_and_file() {
    let with = |poses: &str| {
        let options = OpenOptions {
            poses: Some(poses.into()),
            sensors: vec!["/points".into()],
            ..OpenOptions::default()
        };
        open_with(data("zstd.mcap"), &options).map_err(|e| e.to_string())
    };
    let x = |log: &Log| log.scans()[5].pose.unwrap().translation.x;
    assert!((x(&with("odom").unwrap()) - 1.0).abs() < 1e-9);
    // Odometry says twice as far.
    assert!((x(&with("/odom").unwrap()) - 1.5).abs() < 1e-9);
    let told = with("map").unwrap_err();
    assert!(
        told.contains("map is neither a file nor a topic or frame with poses of the sensor: there are odom, /odom"),
        "{told}"
    );
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("poses.tum");
    let lines: Vec<_> = (2..8)
        .map(|k| format!("{}.{}00000000 {k} 0 0 0 0 0 1", T0 / 1_000_000_000, k))
        .collect();
    std::fs::write(&file, lines.join("\n")).unwrap();
    let log = with(file.to_str().unwrap()).unwrap();
    assert_eq!((log.len(), log.scans()[0].pose.unwrap().translation.x), (Some(6), 2.0));
    assert!(has_note(&log, "4 of 10 scans are left out"));
    std::fs::write(&file, "1.0 0 0 0 0 0 0 1").unwrap();
    let told = with(file.to_str().unwrap()).unwrap_err();
    assert!(told.contains("cover no scan"), "{told}");
}

#[test]
fn what_is_written_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.mcap");
    let log = open(data("lz4.mcap")).unwrap();
    let mut writer = super::Writer::create(&path, log.sensors()).unwrap();
    let write = |writer: &mut super::Writer, k: usize| writer.write_scan(log.scans()[k].sensor, &log.read(k).unwrap());
    (0..20).for_each(|k| write(&mut writer, k).unwrap());
    assert!(!path.exists());
    writer.finish().unwrap();
    for topic in ["/points", "/livox/lidar"] {
        let (before, after) = (only(&data("lz4.mcap"), topic), only(&path, topic));
        assert_eq!(after.len(), Some(10), "{:?}", after.notes());
        for k in 0..10 {
            let (a, b) = (before.read(k).unwrap(), after.read(k).unwrap());
            assert_eq!(
                (&a.points, &a.rings, &a.intensities),
                (&b.points, &b.rings, &b.intensities)
            );
            assert_eq!(a.times, b.times);
            for (p, q) in a.points_in_world().unwrap().zip(b.points_in_world().unwrap()) {
                assert!(p.distance(q) < 1e-6, "{topic} {k}: {p} {q}");
            }
        }
    }
}

#[test]
fn a_recording_that_was_cut_off_is_read_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["lz4.mcap", "ros1_lz4.bag"] {
        let bytes = std::fs::read(data(name)).unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
        // A bag that was not closed has no place of its index.
        let mut cut = bytes[..bytes.len() * 2 / 3].to_vec();
        if name.ends_with(".bag") {
            let at = cut.windows(10).position(|w| w == b"index_pos=").unwrap() + 10;
            cut[at..at + 8].fill(0);
        }
        std::fs::write(&path, &cut).unwrap();
        let log = only(&path, "/points");
        let scans = log.len().unwrap();
        assert!((1..10).contains(&scans), "{name}: {scans}");
        assert!(has_note(&log, "was not closed"), "{:?}", log.notes());
        log.read(scans - 1).unwrap();
    }
}

/// Opens and reads whatever is there; must neither panic nor take long.
fn bear(path: &Path) -> Option<String> {
    match open(path) {
        Ok(log) => {
            let read = |k| log.read(k).err().map(|e| e.to_string());
            let told = (0..log.len().unwrap_or_default()).find_map(read);
            let _ = (log.imu(), log.gnss(), log.read_image(0));
            told
        }
        Err(error) => Some(error.to_string()),
    }
}

#[test]
fn damaged_recordings_are_told_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["zstd.mcap", "lz4.mcap", "ros1_lz4.bag", "ros1_bz2.bag"] {
        let bytes = std::fs::read(data(name)).unwrap();
        let path = folder.path().join(name);
        let mut told = 0;
        for k in 0..60 {
            let mut bad = bytes.clone();
            if k % 3 == 0 {
                bad.truncate(bytes.len() * k / 60);
            } else {
                let at = (k * 7919 + 13) * 104_729 % bytes.len();
                let end = (at + 1 + k % 8).min(bytes.len());
                bad[at..end].fill([0, 0xff, 0x7f][k % 3]);
            }
            std::fs::write(&path, &bad).unwrap();
            if let Some(message) = bear(&path) {
                told += 1;
                assert!(!message.contains('\n') && !message.is_empty(), "{message}");
            }
        }
        assert!(told > 5, "{name}: {told}");
    }
}

#[cfg(feature = "db3")]
#[test]
fn a_file_that_unpacks_without_end_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.db3.zstd");
    // A frame whose blocks repeat one byte 128 kB each.
    let mut bomb = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 0x58];
    for _ in 0..2000 {
        bomb.extend([0x02, 0x00, 0x10, 0x41]);
    }
    std::fs::write(&path, &bomb).unwrap();
    let told = open(&path).unwrap_err().to_string();
    assert!(told.ends_with("bytes, which is not believed"), "{told}");
    std::fs::write(&path, b"SQLite format 3\0 and then nothing").unwrap();
    let told = open(&path).unwrap_err().to_string();
    assert!(told.contains("is no SQLite bag of ROS 2, or damaged"), "{told}");
}

/// Poses at the begin of each sweep, and none after the last one.
#[test]
fn the_last_sweep_goes_on_as_the_sensor_did() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let at = |x: f64| Pose {
        translation: DVec3::new(x, 0.0, 0.0),
        ..Pose::IDENTITY
    };
    let mut writer = super::Writer::create(&path, &[crate::Sensor::new("lidar")]).unwrap();
    for sweep in 0..4_i32 {
        let scan = Scan {
            time_ns: Some(T0 + i64::from(sweep) * 100_000_000),
            points: vec![Vec3::new(5.0, 1.0, 1.0); 100],
            times: Some((0..100u8).map(|i| f32::from(i) * 1e-3).collect()),
            pose: Some(at(f64::from(sweep))),
            ..Scan::default()
        };
        writer.write_scan(0, &scan).unwrap();
    }
    writer.finish().unwrap();
    let log = open(&path).unwrap();
    for index in 0..4 {
        let mut scan = log.read(index).unwrap();
        scan.undistort();
        // The last point is measured 0.99 m farther on.
        assert!((scan.points[99].x - 5.99).abs() < 1e-4, "{index}: {}", scan.points[99]);
    }
}

#[test]
fn samples_of_an_imu_are_written_and_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let log = only(&data("lz4.mcap"), "/points");
    let scan = log.read(0).unwrap();
    let sensor_from_body = log.sensors()[0].body_from_sensor.rotation.inverse();
    let mut samples = log.imu().unwrap();
    for sample in &mut samples {
        sample.angular_velocity = sensor_from_body * sample.angular_velocity;
        sample.acceleration = sensor_from_body * sample.acceleration;
    }
    let (recording, plain) = (folder.path().join("out.mcap"), folder.path().join("plain"));
    let mut writer = super::Writer::create(&recording, log.sensors()).unwrap();
    writer.write_scan(0, &scan).unwrap();
    writer.write_imu(&samples).unwrap();
    writer.finish().unwrap();
    let mut writer = crate::plain::Writer::create(&plain).unwrap();
    writer.write_scan(&scan).unwrap();
    // Of two at one time, one is left.
    writer
        .write_imu(&[&samples[..], &samples[samples.len() - 1..]].concat())
        .unwrap();
    writer.finish().unwrap();
    for path in [recording, plain] {
        let back = open(&path).unwrap().imu().unwrap();
        assert_eq!(back.len(), samples.len());
        for (a, b) in back.iter().zip(&samples) {
            assert_eq!(
                (a.time_ns, a.angular_velocity),
                (b.time_ns, b.angular_velocity),
                "{}",
                path.display()
            );
            assert_eq!(a.acceleration, b.acceleration);
        }
    }
}

#[test]
fn what_is_no_scan_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.mcap");
    super::Writer::create(&path, &[]).unwrap().finish().unwrap();
    let log = open(&path).unwrap();
    assert!(log.is_empty() && has_note(&log, "holds no scans"), "{:?}", log.notes());
}

/// Time that goes back is put in order.
#[test]
fn scans_are_in_order_of_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("back.mcap");
    let mut writer = super::Writer::create(&path, &[crate::Sensor::new("lidar")]).unwrap();
    for k in [0, 1, 4, 3, 2, 5, 6, 7] {
        let scan = Scan {
            time_ns: Some(T0 + k * 100_000_000),
            points: vec![Vec3::new(k as f32 + 1.0, 0.0, 0.0); 3],
            pose: Some(Pose {
                translation: DVec3::X * k as f64,
                ..Pose::IDENTITY
            }),
            ..Scan::default()
        };
        writer.write_scan(0, &scan).unwrap();
    }
    writer.finish().unwrap();
    let log = open(&path).unwrap();
    let secs = log
        .scans()
        .windows(2)
        .map(|pair| secs_between(pair[0].time_ns.unwrap(), pair[1].time_ns.unwrap()));
    assert!(secs.into_iter().all(|secs| secs > 0.0) && log.len() == Some(8));
    assert_eq!(log.read(2).unwrap().points[0].x, 3.0);
    assert_eq!(log.read(2).unwrap().pose.unwrap().translation.x, 2.0);
}

/// Real packets, where they are, against the makers' own points of one sweep.
#[test]
fn packets_become_the_drivers_points() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs");
    if !folder.is_dir() || !cfg!(feature = "db3") {
        eprintln!("skipped: no {}, or no db3", folder.display());
        return;
    }
    for (name, calibration) in [
        ("vlp16", "VLP16.yaml"),
        ("40p", "Pandar40P.csv"),
        ("xt32", "PandarXT32.csv"),
    ] {
        let folder = folder.join("nebula");
        let options = OpenOptions {
            calibration: Some(folder.join("calibration").join(calibration)),
            ..OpenOptions::default()
        };
        let path = folder.join(name);
        let log = open_with(&path, &options).unwrap();
        let truth = crate::files::list(&path, "pcd").unwrap();
        let truth = crate::pcd::parse(&truth[0].path, &std::fs::read(&truth[0].path).unwrap()).unwrap();
        let near = |scan: &Scan| {
            let grid = |p: &Vec3| (*p * 50.0).round().as_ivec3();
            let seen: std::collections::HashSet<_> = scan.points.iter().map(grid).collect();
            let valid = || truth.points.iter().filter(|p| p.is_finite() && **p != Vec3::ZERO);
            let is_near = |p: &&Vec3| {
                let around = (-1..2).flat_map(|x| (-1..2).flat_map(move |y| (-1..2).map(move |z| (x, y, z))));
                around
                    .into_iter()
                    .any(|d| seen.contains(&(grid(p) + tsdfuse::glam::IVec3::from(d))))
            };
            valid().filter(is_near).count() as f64 / valid().count() as f64
        };
        let best = (0..log.len().unwrap())
            .map(|k| near(&log.read(k).unwrap()))
            .fold(0.0, f64::max);
        assert!(best > 0.95, "{name}: {best}, {:?}", log.notes());
    }
    let log = open(folder.join("ouster/512x10_raw.bag")).unwrap();
    assert!(log.len().unwrap() >= 1, "{:?}", log.notes());
    assert!(log.read(0).unwrap().points.len() > 1000);
    // Its IMU's packets lie in a topic beside: at rest, they show gravity upwards.
    let imu = log.imu().unwrap();
    assert_eq!(imu.len(), 10);
    let steps = imu.windows(2).map(|pair| pair[1].time_ns - pair[0].time_ns);
    assert!(
        steps.clone().all(|step| (9_000_000..11_000_000).contains(&step)),
        "{:?}",
        steps.collect::<Vec<_>>()
    );
    assert!(
        imu.iter()
            .all(|sample| (9.0..11.0).contains(&sample.acceleration.length())),
        "{imu:?}"
    );
    let begin = log.scans()[0].time_ns.unwrap();
    assert!(
        (imu[0].time_ns - begin).abs() < 1_000_000_000,
        "{begin} {}",
        imu[0].time_ns
    );
}

/// Real recordings of others, where they are: tf and odometry in all three containers.
#[test]
fn real_recordings_without_clouds_are_described() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs/bags");
    if !folder.is_dir() {
        eprintln!("skipped: no {}", folder.display());
        return;
    }
    for name in ["tf_example.bag", "nav2_turtlebot.mcap", "tf_example"] {
        if name == "tf_example" && !cfg!(feature = "db3") {
            continue;
        }
        let recording = super::open(&folder.join(name), &OpenOptions::default()).unwrap();
        let recorded = recording.recorded().unwrap();
        assert!(recorded.topics.iter().any(|topic| topic.messages > 10), "{name}");
        assert!(recording.scans().is_empty() && recording.notes().iter().any(|note| note.contains("holds no scans")));
    }
}

/// What `testdata/ros/odd.py` wrote.
fn odd(name: &str) -> Log {
    open(data(&format!("odd_{name}.mcap"))).unwrap()
}

fn conclusions(log: &Log) -> String {
    let told = log.recorded().unwrap().conclusions.iter();
    told.map(|(subject, text)| format!("{subject}: {text}\n")).collect()
}

#[test]
fn clouds_of_any_order_of_bytes_with_rows_and_gaps_are_the_same() {
    let (big, little) = (odd("big"), odd("little"));
    assert_eq!((big.len(), little.len()), (Some(5), Some(5)));
    for k in 0..5 {
        let [a, b] = [&big, &little].map(|log| log.read(k).unwrap());
        assert_eq!(a.points.len(), 160);
        let bits = |scan: &Scan| {
            scan.points
                .iter()
                .map(|p| p.to_array().map(f32::to_bits))
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(&a), bits(&b));
        assert!(
            a.points[0].distance(Vec3::new(
                5.0 + k as f32,
                0.0,
                (5.0 + k as f32) * 14f32.to_radians().tan()
            )) < 1e-5
        );
        // What measured nothing is still there.
        assert!(a.points[3].is_nan() && a.points[17] == Vec3::ZERO);
        assert_eq!(a.intensities.unwrap()[159], 159.0);
        // Rows are beams, the highest first.
        let rings = a.rings.unwrap();
        assert_eq!((rings[0], rings[19], rings[20], rings[159]), (7, 7, 6, 0));
    }
    assert!(
        conclusions(&big).contains("rows of the organized cloud"),
        "{}",
        conclusions(&big)
    );
}

#[test]
fn partial_clouds_are_put_together() {
    let log = odd("partial");
    assert_eq!(log.len(), Some(6), "{}", conclusions(&log));
    assert!(
        conclusions(&log).contains("4 messages make a sweep, as each turns on by 90.0°"),
        "{}",
        conclusions(&log)
    );
    let scan = log.read(2).unwrap();
    assert_eq!((scan.points.len(), scan.time_ns), (800, Some(T0 + 200_000_000)));
    assert!(scan.points.iter().all(|p| (p.x.hypot(p.y) - 12.0).abs() < 1e-4));
}

#[test]
fn stamps_count_unless_they_stand_still() {
    let log = odd("unstamped");
    let times: Vec<_> = log.scans().iter().map(|scan| scan.time_ns.unwrap() - T0).collect();
    assert_eq!(times, [0, 1, 2, 3, 4].map(|k| k * 100_000_000));
    let log = odd("clock");
    let times: Vec<_> = log.scans().iter().map(|scan| scan.time_ns.unwrap() - T0).collect();
    assert_eq!(times, [0, 1, 2, 3, 4].map(|k| k * 100_000_000));
    let delay = log.recorded().unwrap().topics[0].delay_secs.unwrap();
    assert!((delay - 5.0).abs() < 1e-6, "{delay}");
}

#[test]
fn frames_that_go_round_are_an_error_in_one_line() {
    let told = open(data("odd_cyclic.mcap")).unwrap_err().to_string();
    assert!(
        told.contains("the frames of tf go round in a circle: ") && !told.contains('\n'),
        "{told}"
    );
}

/// All sweeps are there once, in order of time.
#[test]
fn a_clock_that_was_set_back_loses_nothing() {
    let log = odd("back");
    let times: Vec<_> = log.scans().iter().map(|scan| scan.time_ns.unwrap()).collect();
    assert!(times.is_sorted() && times.len() == 7, "{times:?} {:?}", log.notes());
    let mut seen: Vec<_> = (0..7).map(|k| log.read(k).unwrap().points[0].x).collect();
    seen.sort_by(f32::total_cmp);
    assert_eq!(seen, [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]);
}

#[test]
fn a_line_in_a_plane_is_refused_in_words() {
    let log = odd("laser");
    assert!(
        log.is_empty()
            && has_note(
                &log,
                "a LaserScan is one line in a plane, from which no surface follows"
            ),
        "{:?}",
        log.notes()
    );
}

/// Hands out a file piece by piece.
struct Slow(std::io::Cursor<Vec<u8>>, usize);

impl std::io::Read for Slow {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        std::thread::sleep(std::time::Duration::from_millis(2));
        let length = buffer.len().min(self.1);
        self.0.read(&mut buffer[..length])
    }
}

fn same_scans(name: &str, log: &Log) {
    let whole = only(&data(name), "/points");
    assert!(log.len().is_none() && log.is_unplaced() == whole.is_unplaced());
    let streamed: Vec<_> = log.into_iter().map(Result::unwrap).collect();
    let wanted: Vec<_> = whole.into_iter().map(Result::unwrap).collect();
    // When it is over, it can be read again.
    let recording = log.recording().unwrap();
    let again: Vec<_> = recording.into_iter().map(Result::unwrap).collect();
    assert_eq!((streamed.len(), again.len()), (wanted.len(), wanted.len()), "{name}");
    for ((a, b), c) in streamed.iter().zip(&wanted).zip(&again) {
        for scan in [a, c] {
            assert_eq!(
                (scan.time_ns, scan.pose, &scan.points, &scan.times),
                (b.time_ns, b.pose, &b.points, &b.times),
                "{name}"
            );
        }
    }
}

fn points_only() -> OpenOptions {
    OpenOptions {
        sensors: vec!["/points".to_owned()],
        follow: true,
        ..OpenOptions::default()
    }
}

#[test]
fn a_recording_through_a_pipe_gives_the_same_scans() {
    for name in ["zstd.mcap", "ros1_lz4.bag"] {
        let bytes = std::fs::read(data(name)).unwrap();
        let step = bytes.len() / 40;
        let slow = Slow(std::io::Cursor::new(bytes), step);
        let follow = super::Follow::read(slow, &points_only()).unwrap();
        same_scans(name, &Log::of_stream(follow));
    }
    let follow = super::Follow::read(std::io::empty(), &points_only());
    assert!(follow.is_err());
}

#[test]
fn a_recording_that_grows_gives_the_same_scans() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["lz4.mcap", "ros1_bz2.bag"] {
        let bytes = std::fs::read(data(name)).unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes[..bytes.len() / 10]).unwrap();
        let growing = path.clone();
        let writer = std::thread::spawn(move || {
            use std::io::Write;
            let mut file = std::fs::OpenOptions::new().append(true).open(growing).unwrap();
            for part in bytes[bytes.len() / 10..].chunks(bytes.len() / 10) {
                std::thread::sleep(std::time::Duration::from_millis(100));
                file.write_all(part).unwrap();
            }
        });
        same_scans(name, &open_with(&path, &points_only()).unwrap());
        writer.join().unwrap();
    }
}

/// With the journals that recorders use; a bag in write-ahead mode grows in a file beside it.
#[cfg(feature = "db3")]
#[test]
fn a_sqlite_bag_that_grows_gives_the_same_scans() {
    use std::io::Read;
    let folder = tempfile::tempdir().unwrap();
    let packed = std::fs::read(data("ros2_file").join("ros2_file.db3.zstd")).unwrap();
    let mut bytes = Vec::new();
    ruzstd::decoding::StreamingDecoder::new(&packed[..])
        .unwrap()
        .read_to_end(&mut bytes)
        .unwrap();
    let whole = folder.path().join("whole.db3");
    std::fs::write(&whole, &bytes).unwrap();
    for journal in ["WAL", "MEMORY"] {
        let path = folder.path().join(format!("{journal}.db3"));
        let bag = rusqlite::Connection::open(&path).unwrap();
        bag.execute_batch(&format!(
            "PRAGMA journal_mode={journal}; ATTACH '{}' AS whole;
             CREATE TABLE topics AS SELECT * FROM whole.topics;
             CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);",
            whole.display()
        ))
        .unwrap();
        let writer = std::thread::spawn(move || {
            let last: i64 = bag
                .query_row("SELECT max(id) FROM whole.messages", [], |row| row.get(0))
                .unwrap();
            for k in 0..10 {
                std::thread::sleep(std::time::Duration::from_millis(50));
                let (from, to) = (k * last / 10, (k + 1) * last / 10);
                let insert = "INSERT INTO messages SELECT id, topic_id, timestamp, data FROM whole.messages WHERE id > ?1 AND id <= ?2";
                bag.execute(insert, [from, to]).unwrap();
            }
            bag
        });
        same_scans("ros2_file", &open_with(&path, &points_only()).unwrap());
        drop(writer.join().unwrap());
    }
}

/// The writer is killed: what is whole is read, and the stream ends by itself.
#[test]
fn a_recording_that_stands_still_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    let bytes = std::fs::read(data("lz4.mcap")).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let log = open_with(&path, &points_only()).unwrap();
    let scans: Vec<_> = log.into_iter().map(Result::unwrap).collect();
    assert!((2..10).contains(&scans.len()), "{}", scans.len());
}

#[test]
fn a_file_tells_the_beams_of_a_sensor_in_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("sensor.toml");
    let model = tsdfuse::sensor::model("hdl32e").unwrap();
    let sensor = crate::Sensor {
        model: Some(model.clone()),
        ..crate::Sensor::new("lidar")
    };
    crate::sensor_file::write(&file, &sensor).unwrap();
    let options = |names: &[&str]| OpenOptions {
        sensor_file: Some(file.clone()),
        sensors: names.iter().map(ToString::to_string).collect(),
        ..OpenOptions::default()
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/ros/zstd.mcap");
    let log = crate::open_with(&path, &options(&["/points"])).unwrap();
    assert_eq!(log.sensors()[0].model.as_ref(), Some(&model));
    assert!(log.read(0).is_ok());
}
