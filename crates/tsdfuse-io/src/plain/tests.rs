use std::fs;
use std::path::Path;

use proptest::prelude::*;
use tsdfuse::glam::{DQuat, DVec3, Vec3};
use tsdfuse::scan::PoseAt;
use tsdfuse::sensor::SensorCorrection;
use tsdfuse::{Pose, Scan};

use super::Writer;
use crate::{Log, OpenOptions};

const IDENTITY: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n";

fn any_pose() -> impl Strategy<Value = Pose> {
    (prop::array::uniform4(-1.0..1.0f64), prop::array::uniform3(-1e6..1e6f64)).prop_filter_map("zero", |(q, t)| {
        let q = DQuat::from_array(q);
        (q.length() > 0.1).then(|| Pose::new(q.normalize(), DVec3::from(t)).unwrap())
    })
}

fn any_scan() -> impl Strategy<Value = Scan> {
    let point = (
        prop::array::uniform3(any::<f32>()),
        any::<f32>(),
        any::<u16>(),
        -1.0..1.0f32,
    );
    let motion = prop::collection::vec((any_pose(), 0.01..1.0f64), 0..4);
    (
        prop::collection::vec(point, 0..20),
        any::<[bool; 2]>(),
        any_pose(),
        motion,
    )
        .prop_map(|(points, [rings, times], pose, motion)| Scan {
            points: points.iter().map(|p| Vec3::from(p.0)).collect(),
            intensities: Some(points.iter().map(|p| p.1).collect()),
            rings: rings.then(|| points.iter().map(|p| p.2).collect()),
            times: times.then(|| points.iter().map(|p| p.3).collect()),
            motion: poses_in_order(if times { motion } else { Vec::new() }),
            pose: Some(pose),
            ..Default::default()
        })
}

/// Some before the scan's own pose, some after it.
fn poses_in_order(steps: Vec<(Pose, f64)>) -> Vec<PoseAt> {
    let mut secs = -1.01;
    let mut next = |(pose, step): (Pose, f64)| {
        secs += step;
        PoseAt { secs, pose }
    };
    steps.into_iter().map(&mut next).collect()
}

fn close(a: &Pose, b: &Pose) -> bool {
    a.translation == b.translation && a.rotation.dot(b.rotation).abs() > 1.0 - 1e-14
}

fn bits(points: &[Vec3]) -> Vec<[u32; 3]> {
    points.iter().map(|p| p.to_array().map(f32::to_bits)).collect()
}

fn write(folder: &Path, scans: &[Scan]) -> crate::Result<()> {
    let mut writer = Writer::create(folder)?;
    scans.iter().try_for_each(|scan| writer.write_scan(scan))?;
    writer.finish()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn what_is_written_is_read(scans in prop::collection::vec(any_scan(), 1..4), start in prop::option::of(0..2_000_000_000_000_000_000_i64)) {
        let dir = tempfile::tempdir().unwrap();
        let mut scans = scans;
        for (i, scan) in scans.iter_mut().enumerate() {
            scan.time_ns = start.map(|ns| ns + 7_000_000_000 * i as i64);
        }
        write(dir.path(), &scans).unwrap();
        let log = crate::open(dir.path()).unwrap();
        let read: Vec<_> = (0..scans.len()).map(|i| log.read(i).unwrap()).collect();
        prop_assert_eq!(log.len(), Some(scans.len()));
        prop_assert_eq!(read.len(), scans.len());
        for (a, b) in read.iter().zip(&scans) {
            prop_assert_eq!(bits(&a.points), bits(&b.points));
            prop_assert_eq!(&a.rings, &b.rings);
            prop_assert_eq!(&a.times, &b.times);
            let values = |s: &Scan| s.intensities.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(values(a), values(b));
            prop_assert_eq!(a.time_ns, b.time_ns);
            prop_assert!(close(&a.pose.unwrap(), &b.pose.unwrap()));
            prop_assert_eq!(a.motion.len(), b.motion.len());
            let mut motion = a.motion.iter().zip(&b.motion);
            prop_assert!(motion.all(|(a, b)| close(&a.pose, &b.pose) && a.secs == b.secs));
        }
    }
}

/// Three scans of one point, 0.1 s and 1 m apart, that take 0.1 s.
fn moving(folder: &Path) {
    let scan = |i: u8| Scan {
        points: vec![Vec3::X],
        times: Some(vec![0.05]),
        time_ns: Some(100_000_000 * i64::from(i)),
        pose: Some(Pose {
            translation: DVec3::X * f64::from(i),
            ..Pose::IDENTITY
        }),
        ..Default::default()
    };
    write(folder, &[0, 1, 2].map(scan)).unwrap();
}

#[test]
fn points_with_times_move_towards_the_next_pose() {
    let dir = tempfile::tempdir().unwrap();
    moving(dir.path());
    let dataset = crate::open(dir.path()).unwrap();
    assert_eq!(dataset.notes(), [""; 0]);
    for (i, x) in [0.5, 1.5, 2.5].into_iter().enumerate() {
        let at = dataset.read(i).unwrap().sweep().unwrap().at(0.05);
        assert!((at.translation.x - x).abs() < 1e-12, "scan {i}: {at:?}");
    }
    fs::remove_file(dir.path().join("times.txt")).unwrap();
    let dataset = crate::open(dir.path()).unwrap();
    assert!(dataset.read(0).unwrap().motion.is_empty());
    assert!(dataset.notes()[0].starts_with("3 scans have times of their points but no motion"));
}

#[test]
fn poses_with_times_move_the_points_along_the_trajectory() {
    let dir = tempfile::tempdir().unwrap();
    moving(dir.path());
    // The sensor stands still at first, then leaps ahead: only the trajectory tells.
    let tum = "0 0 0 0 0 0 0 1\n0.05 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n0.2 2 0 0 0 0 0 1\n";
    fs::write(dir.path().join("poses.txt"), tum).unwrap();
    let dataset = crate::open(dir.path()).unwrap();
    let x = |i: usize| dataset.read(i).unwrap().sweep().unwrap().at(0.05).translation.x;
    assert!(x(0).abs() < 1e-6 && (x(1) - 1.5).abs() < 1e-6 && (x(2) - 2.5).abs() < 1e-6);
}

/// A sensor that swings to and fro: ten times as fast as scans are taken.
#[test]
fn a_sweep_follows_all_poses_of_a_fast_trajectory() {
    let swing = |secs: f64| Pose {
        rotation: DQuat::from_rotation_z(0.5 * (40.0 * secs).sin()),
        translation: DVec3::new(2.0 * (secs - 1500.0), 0.1 * (60.0 * secs).cos(), 1.0),
    };
    // A pole that the sensor looks at all the time.
    let (pole, times) = (DVec3::new(9.0, 1.0, 0.5), [-0.04_f32, -0.02, 0.0, 0.02, 0.03, 0.04]);
    let dir = tempfile::tempdir().unwrap();
    let seen = |t: &f32| swing(1.5e3 + f64::from(*t)).inverse().transform_point(pole).as_vec3();
    let scan = Scan {
        points: times.iter().map(seen).collect(),
        times: Some(times.to_vec()),
        time_ns: Some(1_500_000_000_000),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    write(dir.path(), &[scan]).unwrap();
    let line = |secs: f64| {
        let (p, q) = (swing(secs).translation, swing(secs).rotation);
        format!("{secs:.3} {} {} {} {} {} {} {}\n", p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    };
    let off = |step: f64| {
        let poses: String = (0..=(0.08 / step).round() as u32)
            .map(|k| line(1499.96 + step * f64::from(k)))
            .collect();
        fs::write(dir.path().join("poses.txt"), poses).unwrap();
        let scan = crate::open(dir.path()).unwrap().read(0).unwrap();
        let off = scan.points_in_world().unwrap().map(|p| p.distance(pole));
        (scan.motion.len(), off.fold(0.0, f64::max))
    };
    // A pose for each of the times, so that they are met exactly.
    let (poses, off_m) = off(0.01);
    assert!(poses == 8 && off_m < 1e-5, "{poses} poses: {off_m} m");
    let (poses, off_m) = off(0.02);
    assert!(poses == 8 && off_m < 0.05, "{poses} poses: {off_m} m");
    let (poses, off_m) = off(0.08);
    assert!(poses == 8 && off_m > 1.0, "{poses} poses: {off_m} m");
}

#[test]
fn poses_of_a_body_place_a_sensor_by_its_extrinsics() {
    let dir = tempfile::tempdir().unwrap();
    moving(dir.path());
    // On a mast, looking to the left; and a model of its own.
    let extrinsics = "body_from_sensor = [0, -1, 0, 0.5, 1, 0, 0, 0, 0, 0, 1, 2]\n";
    let body_from_sensor = Pose {
        rotation: DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2),
        translation: DVec3::new(0.5, 0.0, 2.0),
    };
    let vlp16 = tsdfuse::sensor::model("vlp16").unwrap();
    for (text, model) in [
        (extrinsics.to_owned(), None),
        (extrinsics.to_owned() + &toml::to_string(&vlp16).unwrap(), Some(vlp16)),
    ] {
        fs::write(dir.path().join("sensor.toml"), text).unwrap();
        let log = crate::open(dir.path()).unwrap();
        assert_eq!(log.sensors()[0].model, model);
        assert!(close(&log.sensors()[0].body_from_sensor, &body_from_sensor));
        assert_eq!(log.scans()[2].pose.unwrap().translation, DVec3::new(2.5, 0.0, 2.0));
        let seen: Vec<_> = log.read(1).unwrap().points_in_world().unwrap().collect();
        // Where a time of 0.05 s has its place as f32.
        assert!(seen[0].distance(DVec3::new(2.0, 1.0, 2.0)) < 1e-7, "{seen:?}");
    }
    let options = OpenOptions {
        extrinsics: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let log = crate::open_with(dir.path(), &options).unwrap();
    assert_eq!(log.scans()[2].pose.unwrap().translation, DVec3::X * 2.0);
    fs::write(
        dir.path().join("sensor.toml"),
        "body_from_sensor = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0]",
    )
    .unwrap();
    let told = crate::open(dir.path()).unwrap_err().to_string();
    assert!(
        told.contains("sensor.toml: body_from_sensor: the pose is not rigid"),
        "{told}"
    );
}

#[test]
fn a_log_without_poses_opens_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    moving(dir.path());
    fs::remove_file(dir.path().join("poses.txt")).unwrap();
    let log = crate::open(dir.path()).unwrap();
    let note = "there is no poses.txt or other pose file: the scans' poses are not known";
    assert_eq!(log.notes(), [note]);
    assert!(
        log.scans()
            .iter()
            .all(|scan| scan.pose.is_none() && scan.time_ns.is_some())
    );
    let scan = log.read(2).unwrap();
    assert_eq!((scan.points.len(), scan.pose, scan.motion.len()), (1, None, 0));
    assert!(log.trajectory().is_none());
}

#[cfg(unix)]
#[test]
fn side_files_that_cannot_be_read_are_named() {
    let unreadable = [
        "rings",
        "times",
        "poses.txt",
        "times.txt",
        "motion.txt",
        "sensor.toml",
        "calib.txt",
    ];
    for name in unreadable {
        let dir = tempfile::tempdir().unwrap();
        moving(dir.path());
        let path = dir.path().join(name);
        let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        // A link to itself cannot be followed by anybody, whatever rights they have.
        std::os::unix::fs::symlink(name, &path).unwrap();
        let told = crate::open(dir.path()).unwrap_err().to_string();
        assert!(
            told.contains(&format!("/{name}: ")) && told.lines().count() == 1,
            "{name}: {told}"
        );
    }
}

#[test]
fn each_fault_is_one_line_with_its_place() {
    let message = |spoil: &dyn Fn(&Path), read: usize| {
        let dir = tempfile::tempdir().unwrap();
        moving(dir.path());
        spoil(dir.path());
        let error = crate::open(dir.path())
            .and_then(|d| d.read(read))
            .unwrap_err()
            .to_string();
        assert_eq!(error.lines().count(), 1);
        error.replace(dir.path().to_str().unwrap(), "DIR")
    };
    let put =
        |name: &'static str, content: &'static [u8]| move |dir: &Path| fs::write(dir.join(name), content).unwrap();
    assert_eq!(
        message(&put("velodyne/000001.bin", &[0; 17]), 1),
        "DIR/velodyne/000001.bin: is truncated: 17 bytes are not a multiple of 16 (x y z intensity)"
    );
    assert_eq!(
        message(&put("times/000002.f32", &[0; 8]), 2),
        "DIR/times/000002.f32: 8 bytes where 1 points of 4 bytes were expected"
    );
    assert_eq!(
        message(&put("times.txt", b"0\n1\n1\n"), 0),
        "DIR: 000002.bin at 1.000000 s is not later than the scan before, 000001.bin"
    );
    assert_eq!(
        message(&put("motion.txt", b"-\n-\n0 1 0 0 0 0 1 0 0 0 0 1 0"), 0),
        "DIR/motion.txt: line 3: the seconds to a pose are zero or not finite"
    );
    assert_eq!(
        message(&put("sensor.toml", b"name = \"x\"\nbeams = 3\n"), 0),
        "DIR/sensor.toml: line 2: unknown field `beams`, expected one of `name`, `elevations_deg`, `columns`, \
         `min_range_m`, `max_range_m`, `body_from_sensor`, `elevation_correction_deg`, `range_correction_m`, \
         `beam_corrections`, `time_offset_s`"
    );
    assert_eq!(
        message(&|dir| fs::write(dir.join("poses.txt"), IDENTITY.repeat(2)).unwrap(), 0),
        "DIR/poses.txt: 2 poses for 3 scans, and the scans' names do not number them"
    );
    assert!(message(&|dir| fs::remove_dir_all(dir.join("velodyne")).unwrap(), 0).starts_with("DIR: holds no scans"));
    assert_eq!(message(&|_| {}, 3), "plain folder: no scan 3: there are 3 scans");
    assert!(
        crate::open("no/such")
            .unwrap_err()
            .to_string()
            .starts_with("no/such: No such file")
    );
}

#[test]
fn a_writer_overwrites_nothing_and_wants_times_for_all_or_none() {
    let dir = tempfile::tempdir().unwrap();
    moving(dir.path());
    let refused = Writer::create(dir.path()).unwrap_err().to_string();
    assert!(
        refused.ends_with("velodyne: exists already; scans are written into a new folder"),
        "{refused}"
    );
    let scan = |secs| Scan {
        name: "b".to_owned(),
        time_ns: secs,
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    let mixed = write(&dir.path().join("new"), &[scan(None), scan(Some(1))])
        .unwrap_err()
        .to_string();
    assert!(
        mixed.ends_with("new: either all scans have a time or none, but not b"),
        "{mixed}"
    );
}

#[test]
fn the_sensor_is_written_and_read_and_can_be_chosen() {
    let dir = tempfile::tempdir().unwrap();
    let model = tsdfuse::sensor::model("vlp16").unwrap();
    let mut writer = Writer::create(dir.path()).unwrap();
    writer.write_sensor(&model).unwrap();
    let scan = Scan {
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    };
    writer.write_scan(&scan).unwrap();
    writer.finish().unwrap();
    assert_eq!(crate::open(dir.path()).unwrap().sensors()[0].model, Some(model));
    let chosen = |name: &str| {
        let options = OpenOptions {
            sensors: vec![name.to_owned()],
            ..Default::default()
        };
        crate::open_with(dir.path(), &options)
    };
    let log = chosen("hdl64e").unwrap();
    assert_eq!(log.sensors()[0].model, tsdfuse::sensor::model("hdl64e"));
    assert_eq!(log.sensors()[0].name, "hdl64e");
    assert!(
        chosen("x")
            .unwrap_err()
            .to_string()
            .contains("there is no sensor model \"x\"; known are ")
    );
}

/// The real scans, or a line that says they are not there.
pub(crate) fn kitti00() -> Option<std::path::PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/kitti00");
    if !path.is_dir() {
        println!("skipped: the KITTI scans are not at {}", path.display());
        return None;
    }
    Some(path)
}

#[test]
fn both_layouts_of_the_real_scans_agree() {
    let Some(path) = kitti00() else { return };
    let plain = crate::open(&path).unwrap();
    assert_eq!((plain.format(), plain.len()), ("plain folder", Some(20)));
    let layout = path.join("odometry_layout");
    let odometry = crate::open(&layout).unwrap();
    assert_eq!((odometry.format(), odometry.len()), ("KITTI odometry", Some(20)));
    let options = OpenOptions {
        poses: Some(layout.join("00.poses_cam0.txt")),
        ..Default::default()
    };
    let with_camera_poses = crate::open_with(&path, &options).unwrap();
    assert!(with_camera_poses.notes()[0].ends_with("00.poses_cam0.txt are taken as the camera's, by calib.txt"));
    let largest = |a: &Log, b: &Log| {
        let pairs = a.scans().iter().zip(b.scans());
        let differences = pairs.map(|(a, b)| {
            let between = a.pose.unwrap().inverse() * b.pose.unwrap();
            (between.translation.length(), between.rotation.xyz().length() * 2.0)
        });
        differences.fold((0.0, 0.0), |a: (f64, f64), b| (a.0.max(b.0), a.1.max(b.1)))
    };
    let (metres, radians) = largest(&plain, &odometry);
    println!("largest difference between the layouts: {metres:.2e} m, {radians:.2e} rad");
    assert!(metres < 1e-5 && radians < 1e-5);
    let (metres, radians) = largest(&odometry, &with_camera_poses);
    assert!(metres < 1e-12 && radians < 1e-12);
    // The plain folder does not say which sensor it was; KITTI's is known to look too low.
    let as_measured = plain.read(19).unwrap().points;
    let corrected = |path: &Path, degrees| {
        let log = crate::open(path).unwrap();
        let log = log.with_correction(&SensorCorrection::of_elevation(degrees)).unwrap();
        log.read(19).unwrap().points
    };
    let scan = odometry.read(19).unwrap();
    assert_eq!(
        (
            odometry.sensors()[0].correction.elevation_deg,
            plain.sensors()[0].correction.elevation_deg
        ),
        (0.205, 0.0)
    );
    assert!(scan.points != as_measured && corrected(&layout, 0.0) == as_measured);
    assert!(corrected(&path, 0.205) == scan.points);
    assert!((100_000..130_000).contains(&scan.points.len()) && scan.points.iter().all(|p| p.length() < 130.0));
}
