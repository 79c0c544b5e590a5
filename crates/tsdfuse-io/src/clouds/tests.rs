use std::fs;
use std::path::Path;

use tsdfuse::glam::{DVec3, Vec3};

use crate::{Log, OpenOptions};

/// A PCD of one point at x = 1, with a time in nanoseconds.
fn pcd(folder: &Path, name: &str, viewpoint: &str, nanos: u32) {
    fs::create_dir_all(folder).unwrap();
    let text = format!(
        "FIELDS x y z t\nSIZE 4 4 4 4\nTYPE F F F U\nWIDTH 1\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS 1\nDATA ascii\n1 0 0 {nanos}\n"
    );
    fs::write(folder.join(name), text).unwrap();
}

fn ply(folder: &Path, name: &str) {
    fs::create_dir_all(folder).unwrap();
    let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\nend_header\n1 0 0\n";
    fs::write(folder.join(name), text).unwrap();
}

/// A trajectory at 10 m/s along x, a pose each 0.1 s from `start` on.
fn tum(path: &Path, start: f64) {
    let line = |i: u32| format!("{} {i} 0 0 0 0 0 1\n", start + 0.1 * f64::from(i));
    fs::write(path, (0..20).map(line).collect::<String>()).unwrap();
}

const STILL: &str = "0 0 0 1 0 0 0";

fn xs(dataset: &Log) -> Vec<f64> {
    dataset
        .scans()
        .iter()
        .map(|s| (s.pose.unwrap().translation.x * 1e6).round() / 1e6)
        .collect()
}

fn refused(path: &Path) -> String {
    crate::open(path)
        .unwrap_err()
        .to_string()
        .replace(path.to_str().unwrap(), "DIR")
}

#[test]
fn clouds_named_by_time_are_placed_and_moved_along_a_trajectory() {
    let dir = tempfile::tempdir().unwrap();
    tum(&dir.path().join("traj_estimate.txt"), 1_500_000_000.0);
    for name in [
        "1500000000_150000000.pcd",
        "1500000000_50000000.pcd",
        "1500000001_0.pcd",
    ] {
        pcd(&dir.path().join("clouds"), name, STILL, 40_000_000);
    }
    let dataset = crate::open(dir.path()).unwrap();
    assert_eq!((dataset.format(), dataset.notes().len()), ("PCD folder", 0));
    assert!(
        xs(&dataset)
            .iter()
            .zip([0.5, 1.5, 10.0])
            .all(|(x, want)| (x - want).abs() < 1e-5)
    );
    let scan = dataset.read(1).unwrap();
    assert_eq!((scan.points[0], scan.times.as_deref()), (Vec3::X, Some(&[0.04][..])));
    let at = scan.sweep().unwrap().at(0.04).translation.x;
    assert!((at - 1.9).abs() < 1e-5, "{at}");
}

#[test]
fn a_scan_outside_the_trajectory_is_named_with_its_time() {
    let dir = tempfile::tempdir().unwrap();
    tum(&dir.path().join("groundtruth.txt"), 5.0);
    pcd(dir.path(), "4.5.pcd", STILL, 0);
    assert_eq!(
        refused(dir.path()),
        "DIR/groundtruth.txt: no pose for 4.5.pcd at 4.500000 s: the poses run from 5.000000 to 6.900000 s"
    );
    pcd(dir.path(), "04.50.pcd", STILL, 0);
    let options = OpenOptions {
        poses: Some(dir.path().join("poses.txt")),
        ..Default::default()
    };
    fs::write(dir.path().join("poses.txt"), "1 0 0 0 0 1 0 0 0 0 1 0\n".repeat(2)).unwrap();
    let twice = crate::open_with(dir.path(), &options).unwrap_err().to_string();
    assert!(
        twice.ends_with("04.50.pcd at 4.500000 s is not later than the scan before, 4.5.pcd"),
        "{twice}"
    );
}

#[test]
fn viewpoints_are_poses_where_there_is_no_pose_file() {
    let dir = tempfile::tempdir().unwrap();
    // Poses may lie beside the folder, too, and there may be others' beside a temporary one.
    let clouds = dir.path().join("clouds");
    fs::create_dir(&clouds).unwrap();
    pcd(&clouds, "2.pcd", "7 0 0 1 0 0 0", 0);
    pcd(&clouds, "10.pcd", "8 0 0 0 0 0 1", 0);
    let dataset = crate::open(&clouds).unwrap();
    assert_eq!(xs(&dataset), [7.0, 8.0]);
    let in_world = dataset.scans()[1].pose.unwrap().transform_point(DVec3::X);
    assert!(in_world.distance(DVec3::new(7.0, 0.0, 0.0)) < 1e-12);

    fs::write(clouds.join("poses.txt"), "1 0 0 1 0 1 0 0 0 0 1 0\n".repeat(2)).unwrap();
    let dataset = crate::open(&clouds).unwrap();
    assert_eq!(xs(&dataset), [1.0, 1.0]);
    assert_eq!(
        dataset.notes(),
        ["the VIEWPOINT of 2.pcd (and of the other scans) is not used: the pose file is"]
    );
}

#[test]
fn clouds_without_any_pose_open_and_those_in_two_folders_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    pcd(&dir.path().join("a"), "1.pcd", STILL, 0);
    let log = crate::open(dir.path()).unwrap();
    assert!(log.scans()[0].pose.is_none() && log.notes()[0].contains("the scans' poses are not known"));
    pcd(&dir.path().join("b"), "1.pcd", STILL, 0);
    assert_eq!(
        refused(dir.path()),
        "DIR: holds scans in DIR/a and in DIR/b: open one of them"
    );
}

#[test]
fn ply_clouds_and_point_files_are_opened_where_they_lie() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("poses.txt"), "1 0 0 1 0 1 0 0 0 0 1 0\n".repeat(2)).unwrap();
    let clouds = dir.path().join("clouds");
    ply(&clouds, "a1.ply");
    ply(&clouds, "a2.ply");
    for path in [dir.path(), &clouds] {
        let dataset = crate::open(path).unwrap();
        assert_eq!((dataset.format(), dataset.len()), ("PLY folder", Some(2)));
        assert_eq!(dataset.read(1).unwrap().points, [Vec3::X]);
    }
    let bins = dir.path().join("points");
    fs::create_dir(&bins).unwrap();
    (0..2).for_each(|i| fs::write(bins.join(format!("{i}.bin")), [0; 16]).unwrap());
    assert_eq!(crate::open(&bins).unwrap().format(), "KITTI point files");
}

#[test]
fn a_mesh_beside_the_scans_is_no_scan() {
    let dir = tempfile::tempdir().unwrap();
    ply(&dir.path().join("result"), "mesh.ply");
    assert!(refused(dir.path()).starts_with("DIR: holds no scans that are read here"));
}
