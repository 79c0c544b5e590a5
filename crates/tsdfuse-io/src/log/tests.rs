use std::path::Path;

use tsdfuse::fuse::FuseConfig;
use tsdfuse::glam::{DQuat, DVec3, Vec3};
use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, SensorModel, VoxelMap};

use super::*;
use crate::plain::Writer;
use crate::source::StreamedScan;

/// A vehicle that drives along a wall and turns while it does so.
fn vehicle(secs: f64) -> Pose {
    Pose {
        rotation: DQuat::from_rotation_z(0.3 * (8.0 * secs).sin()),
        translation: DVec3::new(4.0 * secs, 0.0, 0.0),
    }
}

/// What a sensor on it sees of the wall y = 3: sweeps of 0.1 s from `start` on, in a plain folder.
fn drive(folder: &Path, body_from_sensor: &Pose, start: f64) {
    let mut writer = Writer::create(folder).unwrap();
    for scan in 0..4 {
        let time = start + 0.1 * f64::from(scan);
        let times: Vec<f32> = (0..4000).map(|i| 0.1 * i as f32 / 4000.0).collect();
        let point = |(i, &t): (usize, &f32)| {
            let world_from_sensor = vehicle(time + f64::from(t)) * *body_from_sensor;
            let on_wall = DVec3::new(4.0 * time + (i % 50) as f64 * 0.02, 3.0, (i / 50) as f64 * 0.02);
            world_from_sensor.inverse().transform_point(on_wall).as_vec3()
        };
        let scan = Scan {
            points: times.iter().enumerate().map(point).collect(),
            times: Some(times),
            time_ns: Some((time * 1e9).round() as i64),
            pose: Some(Pose::IDENTITY),
            ..Default::default()
        };
        writer.write_scan(&scan).unwrap();
    }
    writer.finish().unwrap();
    let numbers = body_from_sensor.to_row_major_3x4().map(|v| format!("{v:?}")).join(", ");
    std::fs::write(folder.join("sensor.toml"), format!("body_from_sensor = [{numbers}]\n")).unwrap();
    // The vehicle's own poses, at 200 Hz.
    let line = |k: i32| {
        let secs = 0.005 * f64::from(k);
        let Pose {
            translation: p,
            rotation: q,
        } = vehicle(secs);
        format!("{secs:.3} {} {} {} {} {} {} {}\n", p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    };
    std::fs::write(folder.join("poses.txt"), (0..200).map(line).collect::<String>()).unwrap();
}

/// How far the surface that a log gives is from the wall, metres: the mean, and how much of it there is.
fn off_wall(log: &Log) -> (f64, usize) {
    let suggested = log.suggested();
    let mut map = VoxelMap::new(suggested.map).unwrap();
    let mut method = tsdfuse::fuse::Method::Raycast.build(&FuseConfig::default(), None);
    for scan in log {
        method.integrate(&mut map, &scan.unwrap()).unwrap();
    }
    let mesh = tsdfuse::mesh::extract(&map).unwrap();
    let off: f64 = mesh.vertices.iter().map(|v| (v.y - 3.0).abs()).sum();
    (off / mesh.vertices.len() as f64, mesh.vertices.len())
}

#[test]
fn sensors_with_their_own_extrinsics_are_fused_together() {
    let (front, rear) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let ahead = Pose {
        rotation: DQuat::from_rotation_y(0.1),
        translation: DVec3::new(1.5, 0.0, 0.5),
    };
    let behind = Pose {
        rotation: DQuat::from_rotation_z(2.0),
        translation: DVec3::new(-2.0, 0.4, 0.8),
    };
    drive(front.path(), &ahead, 0.1);
    drive(rear.path(), &behind, 0.15);
    let open = || [&front, &rear].map(|folder| crate::open(folder.path()).unwrap());
    let both = Log::together(open().to_vec()).unwrap();
    assert_eq!((both.format(), both.len()), ("plain folder", Some(8)));
    let order: Vec<_> = both.scans().iter().map(|scan| scan.sensor).collect();
    assert_eq!(order, [0, 1, 0, 1, 0, 1, 0, 1]);
    let names: Vec<_> = both.sensors().iter().map(|sensor| sensor.name.as_str()).collect();
    assert_eq!(names, ["lidar", "lidar-2"]);
    let read: Vec<_> = both
        .read_ahead(&"1..".parse().unwrap())
        .map(|read| (read.index, read.sensor))
        .collect();
    assert_eq!(read[..3], [(1, 1), (2, 0), (3, 1)]);
    let [a, b] = open().map(|log| off_wall(&log));
    let (off_m, vertices) = off_wall(&both);
    assert!(
        off_m < 0.002 && a.0 < 0.002 && b.0 < 0.002,
        "{off_m} m, alone {a:?} and {b:?}"
    );
    assert!(vertices > a.1.max(b.1));
    // With the other's extrinsics it is another wall.
    let options = OpenOptions {
        extrinsics: Some(ahead),
        ..Default::default()
    };
    let wrong = crate::open_with(rear.path(), &options).unwrap();
    assert!(off_wall(&Log::together(vec![open()[0].clone(), wrong]).unwrap()).0 > 0.05);
}

#[test]
fn written_poses_of_the_sensor_are_not_moved_again() {
    let folder = tempfile::tempdir().unwrap();
    let ahead = Pose {
        rotation: DQuat::from_rotation_y(0.1),
        translation: DVec3::new(1.5, 0.0, 0.5),
    };
    drive(folder.path(), &ahead, 0.1);
    let told = folder.path().join("sensor.toml");
    let text = std::fs::read_to_string(&told).unwrap() + "time_offset_s = 0.02\n";
    std::fs::write(told, text).unwrap();
    let log = crate::open(folder.path()).unwrap();
    let poses = || log.scans().iter().map(|scan| (scan.time_ns, scan.pose.unwrap()));
    std::fs::write(folder.path().join("calib.txt"), "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n").unwrap();
    assert!(poses().all(|(time_ns, pose)| pose != vehicle(secs_between(0, time_ns.unwrap())) * ahead));
    for has_times in [true, false] {
        let poses_only = poses::Poses::Listed(poses().map(|(_, pose)| pose).collect());
        let written = if has_times {
            poses::Poses::of(poses())
        } else {
            poses_only
        };
        let [own, body] = ["own.txt", "body.txt"].map(|name| folder.path().join(name));
        poses::write_of_sensor(&own, &written).unwrap();
        poses::write(&body, &written).unwrap();
        assert!(poses::is_of_sensor(&own) && !poses::is_of_sensor(&body));
        assert!(!poses::is_of_sensor(folder.path()) && !poses::is_of_sensor("nowhere"));
        let off = |file: &Path, extrinsics: Option<Pose>| {
            let options = OpenOptions {
                poses: Some(file.to_owned()),
                extrinsics,
                ..Default::default()
            };
            let again = crate::open_with(folder.path(), &options).unwrap();
            let off = again.scans().iter().zip(poses()).map(|(scan, (_, pose))| {
                let off = scan.pose.unwrap().inverse() * pose;
                off.translation.length() + off.rotation.to_scaled_axis().length()
            });
            off.fold(0.0, f64::max)
        };
        assert!(
            off(&own, None) < 1e-9 && off(&own, Some(ahead)) < 1e-9,
            "{}",
            off(&own, None)
        );
        assert!(off(&body, None) > 1.0);
    }
}

#[test]
fn what_cannot_be_put_in_order_is_not_put_together() {
    let folder = tempfile::tempdir().unwrap();
    drive(folder.path(), &Pose::IDENTITY, 0.1);
    std::fs::remove_file(folder.path().join("times.txt")).unwrap();
    std::fs::remove_file(folder.path().join("poses.txt")).unwrap();
    let log = crate::open(folder.path()).unwrap();
    let told = Log::together(vec![log]).unwrap_err().to_string();
    let wanted = "000000.bin: has no time, so it cannot be put in order with the scans of other sensors";
    assert_eq!(told, wanted);
    let told = Log::together(vec![Log::of_stream(Endless::new())])
        .unwrap_err()
        .to_string();
    assert_eq!(told, "endless: is a stream: it cannot be put together with others");
}

/// A wall that comes nearer, for ever.
struct Endless {
    sensors: [Sensor; 1],
    next: u16,
}

impl Endless {
    fn new() -> Self {
        let model = SensorModel::from_beams("one", vec![0.0], 360, (0.1, 30.0)).unwrap();
        let sensor = Sensor {
            model: Some(model),
            min_range_m: Some(0.9),
            ..Sensor::new("/points")
        };
        Self {
            sensors: [sensor],
            next: 0,
        }
    }
}

impl Stream for Endless {
    fn format(&self) -> &str {
        "endless"
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn next(&mut self) -> Option<StreamedScan> {
        self.next += 1;
        let scan = match self.next {
            3 => Err(Error::format("third", "is broken")),
            number => Ok(Scan {
                name: number.to_string(),
                points: vec![Vec3::X * 0.5, Vec3::X / f32::from(number) * 3.0, Vec3::X * 31.0],
                rings: (number == 4).then(Vec::new),
                ..Default::default()
            }),
        };
        Some(StreamedScan { sensor: 0, scan })
    }

    fn notes(&self) -> &[String] {
        &[]
    }
}

#[test]
fn a_stream_is_a_log_without_length() {
    let log = Log::of_stream(Endless::new());
    assert_eq!((log.format(), log.len(), log.is_empty()), ("endless", None, false));
    assert!(log.scans().is_empty() && log.images().is_empty() && log.trajectory().is_none());
    assert_eq!(log.sensors()[0].name, "/points");
    assert_eq!(log.suggested().range.max_range_m, 30.0);
    assert!(log.imu().unwrap().is_empty());
    for told in [log.read(0).unwrap_err(), log.read_image(0).unwrap_err()] {
        assert_eq!(
            told.to_string(),
            "endless: is a stream: it is read once, from its begin"
        );
    }
    let indices: Vec<_> = log
        .read_indices(vec![4, 7])
        .map(|read| (read.index, read.scan.is_err()))
        .collect();
    assert_eq!(indices, [(4, true), (7, true)]);
    // Returns that are not valid by the suggested limits are out; what contradicts itself is an error, and no end.
    let read: Vec<_> = log
        .into_iter()
        .take(5)
        .map(|scan| scan.map(|scan| (scan.points.len(), scan.dropped.total())))
        .collect();
    let told = |i: usize| read[i].as_ref().map_err(ToString::to_string).copied();
    assert_eq!((told(0), told(1), told(4)), (Ok((1, 2)), Ok((1, 2)), Ok((0, 3))));
    assert_eq!(told(2), Err("third: is broken".to_owned()));
    assert_eq!(told(3), Err("4: 4: 3 points but 0 rings".to_owned()));
}

#[test]
fn a_file_and_an_empty_folder_are_no_logs() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.bag");
    std::fs::write(&file, "?").unwrap();
    let told = crate::open(&file).unwrap_err().to_string();
    assert!(told.ends_with("other data sets are folders"), "{told}");
    let told = crate::open(folder.path()).unwrap_err().to_string();
    assert!(told.contains("holds no scans that are read here: "), "{told}");
}

/// What ten lines of Rust fuse is what a run with the suggested settings fuses, bit for bit.
#[test]
fn iterating_gives_valid_returns_only() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sample/pandaset-002");
    let log = crate::open(&sample).unwrap();
    let range = log.suggested().range;
    assert_eq!(
        (range.min_range_m, range.max_range_m),
        (2.0, log.sensors()[0].model.as_ref().unwrap().max_range_m)
    );
    let mut number = 0;
    for scan in &log {
        let (scan, mut raw) = (scan.unwrap(), log.read(number).unwrap());
        let all = raw.points.len();
        raw.drop_invalid(&range);
        assert!(raw.points.len() < all);
        assert_eq!(
            (&scan.points, &scan.times, scan.dropped),
            (&raw.points, &raw.times, raw.dropped)
        );
        number += 1;
    }
    assert_eq!(Some(number), log.len());
}

#[test]
fn poses_of_a_clock_that_is_ahead_are_looked_up_later() {
    let folder = tempfile::tempdir().unwrap();
    let sitting = Pose {
        rotation: DQuat::from_rotation_z(0.4),
        translation: DVec3::new(1.0, 0.0, 0.5),
    };
    drive(folder.path(), &sitting, 0.2);
    let (exact, there) = off_wall(&crate::open(folder.path()).unwrap());
    // Scans as of a clock that is 50 ms late: they lie beside the wall until the offset is known.
    let times = folder.path().join("times.txt");
    let late: String = (0..4)
        .map(|scan| format!("{:.3}\n", 0.15 + 0.1 * f64::from(scan)))
        .collect();
    std::fs::write(&times, late).unwrap();
    let (off, _) = off_wall(&crate::open(folder.path()).unwrap());
    assert!(off > exact + 0.01, "{off} {exact}");
    let sensor = folder.path().join("sensor.toml");
    let told = std::fs::read_to_string(&sensor).unwrap();
    std::fs::write(&sensor, format!("{told}time_offset_s = 0.05\n")).unwrap();
    let log = crate::open(folder.path()).unwrap();
    assert_eq!(log.sensors()[0].time_offset_s, Some(0.05));
    let (mended, here) = off_wall(&log);
    assert!(
        mended < exact + 0.001 && here > there * 9 / 10,
        "{mended} {exact}, {here} of {there}"
    );
    std::fs::write(&sensor, format!("{told}time_offset_s = 11.0\n")).unwrap();
    let error = crate::open(folder.path()).map(|_| ()).unwrap_err().to_string();
    assert!(
        error.contains("sensor.toml") && error.contains("time_offset_s"),
        "{error}"
    );
}
