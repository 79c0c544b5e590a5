use std::fs;
use std::path::Path;

use proptest::prelude::*;
use tsdfuse::glam::{DQuat, DVec3, Vec3};
use tsdfuse::scan::Motion;
use tsdfuse::{Pose, Scan};

use super::Writer;
use crate::dataset::{Dataset, OpenOptions};

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
    let motion = prop::option::of((any_pose(), 0.01..1.0f64));
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
            motion: motion.filter(|_| times).map(|(pose, secs)| Motion { pose, secs }),
            pose,
            ..Default::default()
        })
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
    fn what_is_written_is_read(scans in prop::collection::vec(any_scan(), 1..4), start in prop::option::of(0.0..2e9f64)) {
        let dir = tempfile::tempdir().unwrap();
        let mut scans = scans;
        for (i, scan) in scans.iter_mut().enumerate() {
            scan.timestamp_secs = start.map(|s| s + 7.0 * i as f64);
        }
        write(dir.path(), &scans).unwrap();
        let read: Vec<_> = crate::open(dir.path()).unwrap().into_iter().collect::<Result<_, _>>().unwrap();
        prop_assert_eq!(read.len(), scans.len());
        for (a, b) in read.iter().zip(&scans) {
            prop_assert_eq!(bits(&a.points), bits(&b.points));
            prop_assert_eq!(&a.rings, &b.rings);
            prop_assert_eq!(&a.times, &b.times);
            let values = |s: &Scan| s.intensities.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(values(a), values(b));
            prop_assert_eq!(a.timestamp_secs, b.timestamp_secs);
            prop_assert!(close(&a.pose, &b.pose));
            match (a.motion, b.motion) {
                (Some(a), Some(b)) => prop_assert!(close(&a.pose, &b.pose) && a.secs == b.secs),
                (a, b) => prop_assert_eq!(a.is_some(), b.is_some()),
            }
        }
    }
}

/// Three scans of one point, 0.1 s and 1 m apart, that take 0.1 s.
fn moving(folder: &Path) {
    let scan = |i: u8| Scan {
        points: vec![Vec3::X],
        times: Some(vec![0.05]),
        timestamp_secs: Some(0.1 * f64::from(i)),
        pose: Pose {
            translation: DVec3::X * f64::from(i),
            ..Pose::IDENTITY
        },
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
        let at = dataset.read(i).unwrap().trajectory().unwrap().at(0.05);
        assert!((at.translation.x - x).abs() < 1e-12, "scan {i}: {at:?}");
    }
    fs::remove_file(dir.path().join("times.txt")).unwrap();
    let dataset = crate::open(dir.path()).unwrap();
    assert!(dataset.read(0).unwrap().motion.is_none());
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
    let x = |i: usize| dataset.read(i).unwrap().trajectory().unwrap().at(0.05).translation.x;
    assert!(x(0).abs() < 1e-6 && (x(1) - 1.5).abs() < 1e-6 && (x(2) - 2.5).abs() < 1e-6);
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
        "DIR/motion.txt: line 3: the seconds to the second pose are zero or not finite"
    );
    assert_eq!(
        message(&put("sensor.toml", b"name = \"x\"\nbeams = 3\n"), 0),
        "DIR/sensor.toml: line 2: unknown field `beams`, expected one of `name`, `elevations_deg`, `columns`, \
         `min_range_m`, `max_range_m`"
    );
    assert_eq!(
        message(&|dir| fs::write(dir.join("poses.txt"), IDENTITY.repeat(2)).unwrap(), 0),
        "DIR/poses.txt: 2 poses for 3 scans, and the scans' names do not number them"
    );
    assert_eq!(
        message(&|dir| fs::remove_file(dir.join("poses.txt")).unwrap(), 0),
        "DIR: holds scans but no poses.txt or other pose file"
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
        timestamp_secs: secs,
        ..Default::default()
    };
    let mixed = write(&dir.path().join("new"), &[scan(None), scan(Some(1.0))])
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
    writer.write_scan(&Scan::default()).unwrap();
    writer.finish().unwrap();
    assert_eq!(crate::open(dir.path()).unwrap().sensor(), Some(model));
    let chosen = |name: &str| {
        let options = OpenOptions {
            sensor: Some(name.to_owned()),
            ..Default::default()
        };
        crate::open_with(dir.path(), &options)
    };
    assert_eq!(chosen("hdl64e").unwrap().sensor(), tsdfuse::sensor::model("hdl64e"));
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
    assert_eq!((plain.format(), plain.len()), ("plain folder", 20));
    let layout = path.join("odometry_layout");
    let odometry = crate::open(&layout).unwrap();
    assert_eq!((odometry.format(), odometry.len()), ("KITTI odometry", 20));
    let options = OpenOptions {
        poses: Some(layout.join("00.poses_cam0.txt")),
        ..Default::default()
    };
    let with_camera_poses = crate::open_with(&path, &options).unwrap();
    assert!(with_camera_poses.notes()[0].ends_with("00.poses_cam0.txt are taken as the camera's, by calib.txt"));
    let largest = |a: &Dataset, b: &Dataset| {
        let pairs = a.scans().iter().zip(b.scans());
        let differences = pairs.map(|(a, b)| {
            let between = a.pose.inverse() * b.pose;
            (between.translation.length(), between.rotation.xyz().length() * 2.0)
        });
        differences.fold((0.0, 0.0), |a: (f64, f64), b| (a.0.max(b.0), a.1.max(b.1)))
    };
    let (metres, radians) = largest(&plain, &odometry);
    println!("largest difference between the layouts: {metres:.2e} m, {radians:.2e} rad");
    assert!(metres < 1e-5 && radians < 1e-5);
    let (metres, radians) = largest(&odometry, &with_camera_poses);
    assert!(metres < 1e-12 && radians < 1e-12);
    let scan = odometry.read(19).unwrap();
    assert_eq!(scan.points, plain.read(19).unwrap().points);
    assert!((100_000..130_000).contains(&scan.points.len()) && scan.points.iter().all(|p| p.length() < 130.0));
}
