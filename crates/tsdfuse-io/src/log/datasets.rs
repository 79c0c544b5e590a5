//! Data sets in their makers' layouts, written by `testdata/datasets/make.py`: all see the same points of the world.

use std::path::{Path, PathBuf};

use tsdfuse::glam::DVec3;
use tsdfuse::sensor::SensorCorrection;

use super::*;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("testdata/datasets")
        .join(name)
}

fn world() -> Vec<DVec3> {
    let text = std::fs::read_to_string(folder("world.txt")).unwrap();
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        DVec3::from_slice(&numbers)
    };
    text.lines().map(row).collect()
}

fn opened(name: &str, options: &OpenOptions) -> Log {
    open_with(folder(name), options).unwrap()
}

/// Opens it, and checks that each scan has so many points where they are.
fn checked(name: &str, format: &str, scans: usize, metres: f64) -> Log {
    let log = opened(name, &OpenOptions::default());
    let log = log.with_correction(&SensorCorrection::default()).unwrap();
    assert_eq!(
        (log.format(), log.len()),
        (format, Some(scans)),
        "{name}: {:?}",
        log.notes()
    );
    let world = world();
    for index in 0..scans {
        let scan = log.read(index).unwrap();
        let found: Vec<_> = scan.points_in_world().unwrap().collect();
        assert_eq!(found.len(), world.len(), "{name}");
        for (found, wanted) in found.iter().zip(&world) {
            assert!(
                found.distance(*wanted) < metres,
                "{name} scan {index}: {found} where {wanted} is"
            );
        }
    }
    log
}

fn message(name: &str, options: &OpenOptions) -> String {
    open_with(folder(name), options).unwrap_err().to_string()
}

fn sensors(names: &[&str]) -> OpenOptions {
    OpenOptions {
        sensors: names.iter().map(ToString::to_string).collect(),
        ..OpenOptions::default()
    }
}

#[test]
fn a_scene_of_nuscenes_is_a_log() {
    let log = checked("nuscenes/scene-0061", "nuScenes", 3, 1e-4);
    assert_eq!((log.sensors()[0].name.as_str(), log.images().len()), ("LIDAR_TOP", 3));
    let scan = log.read(1).unwrap();
    let rings = scan.rings.as_ref().unwrap();
    assert!((rings.iter().min(), rings.iter().max()) == (Some(&0), Some(&31)) && scan.intensities.is_some());
    assert_eq!(log.scans()[1].time_ns, Some(1_600_000_000_100_000_000));
    assert_eq!(log.images()[0].camera.fx, 1266.0);
    let told = message("nuscenes", &OpenOptions::default());
    assert!(
        told.contains("holds 2 scenes: open one of them") && told.ends_with("there are scene-0061, scene-0103"),
        "{told}"
    );
    assert!(
        message("nuscenes/scene-7", &OpenOptions::default())
            .ends_with("there is no scene scene-7; there are scene-0061, scene-0103")
    );
    // Its files are not here.
    let empty = opened("nuscenes/scene-0103", &OpenOptions::default());
    assert_eq!(
        (empty.len(), empty.notes()),
        (Some(0), &["3 sweeps of the scene have no file here".to_owned()][..])
    );
}

#[test]
fn both_scanners_of_argoverse_see_from_where_they_are() {
    let log = opened("argoverse", &OpenOptions::default());
    assert_eq!(
        (log.format(), log.len(), log.sensors().len()),
        ("Argoverse 2", Some(6), 2)
    );
    let truth = std::fs::read_to_string(folder("argoverse/truth.txt")).unwrap();
    let truth: Vec<Vec<f64>> = truth
        .lines()
        .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect())
        .collect();
    for (index, reference) in log.scans().iter().enumerate() {
        let scan = log.read(index).unwrap();
        let is_up = log.sensors()[reference.sensor].name == "up_lidar";
        let wanted: Vec<_> = truth
            .iter()
            .filter(|row| row[0] == (index / 2) as f64 && (row[1] == 1.0) == is_up)
            .collect();
        let found: Vec<_> = scan.points_in_world().unwrap().collect();
        assert_eq!((found.len(), wanted.len()), (80, 80));
        for ((found, point), wanted) in found.iter().zip(&scan.points).zip(&wanted) {
            assert!(
                found.distance(DVec3::from_slice(&wanted[2..5])) < 1e-4,
                "{found} {wanted:?}"
            );
            // The range is that from the scanner at the time of the return, although the file has another.
            assert!(
                (f64::from(point.length()) - wanted[5]).abs() < 1e-4,
                "{point} {wanted:?}"
            );
        }
        // Beams in order of their elevation, at the times of their firing.
        let rings = scan.rings.unwrap();
        assert_eq!((rings[0], rings[79]), (0, 19));
        assert!((scan.times.unwrap()[79] - 0.079).abs() < 1e-6);
    }
    let one = opened("argoverse", &sensors(&["down_lidar"]));
    assert_eq!((one.len(), one.sensors().len()), (Some(3), 1));
    assert!(
        message("argoverse", &sensors(&["roof"]))
            .ends_with("there is no scanner \"roof\"; there are up_lidar, down_lidar")
    );
}

#[test]
fn kitti_360_has_poses_for_some_frames() {
    let name = "kitti360/data_3d_raw/2013_05_28_drive_0000_sync";
    let log = checked(name, "KITTI-360", 3, 1e-4);
    assert_eq!(log.notes(), ["1 of 4 scans have no pose and are left out"]);
    let names: Vec<_> = log.scans().iter().map(|scan| scan.name.as_str()).collect();
    assert_eq!(names, ["0000000000.bin", "0000000002.bin", "0000000003.bin"]);
    assert_eq!(
        opened(name, &OpenOptions::default()).sensors()[0]
            .correction
            .elevation_deg,
        0.205
    );
}

/// A sequence of SemanticKITTI: poses of the camera beside the scans, and labels, which are passed over. KITTI's elevations are corrected.
#[test]
fn semantic_kitti_has_its_own_poses() {
    let name = "semantic_kitti/dataset/sequences/08";
    let log = checked(name, "KITTI odometry", 3, 1e-4);
    assert_eq!(log.scans()[2].time_ns, Some(200_000_000));
    let corrected = opened(name, &OpenOptions::default());
    assert_eq!(corrected.sensors()[0].correction.elevation_deg, 0.205);
    let (a, b) = (log.read(0).unwrap(), corrected.read(0).unwrap());
    let elevation = |p: &tsdfuse::glam::Vec3| p.z.atan2(p.x.hypot(p.y)).to_degrees();
    let turned = a.points.iter().zip(&b.points).map(|(a, b)| elevation(b) - elevation(a));
    assert!(
        turned.clone().all(|deg| (deg - 0.205).abs() < 1e-3),
        "{:?}",
        turned.collect::<Vec<_>>()
    );
}

#[test]
fn mulran_is_placed_by_its_vehicle() {
    let log = checked("mulran", "MulRan", 3, 1e-3);
    assert_eq!(log.notes(), ["1 scans at times without a pose are left out"]);
    assert_eq!(log.sensors()[0].name, "os1-64-gen1");
}

#[test]
fn a_whole_scan_of_mulran_has_times_and_rings() {
    let dir = tempfile::tempdir().unwrap();
    let scans = dir.path().join("Ouster");
    std::fs::create_dir(&scans).unwrap();
    std::fs::write(dir.path().join("data_stamp.csv"), "").unwrap();
    let point = |i: usize| {
        let (row, column) = (i % 64, i / 64);
        let (azimuth, elevation) = (column as f32 / 163.0, 0.29 - 0.009 * row as f32);
        [
            elevation.cos() * azimuth.cos(),
            elevation.cos() * azimuth.sin(),
            elevation.sin(),
        ]
        .map(|v| 10.0 * v)
    };
    let bytes: Vec<u8> = (0..65536)
        .flat_map(|i| point(i).into_iter().chain([1.0]))
        .flat_map(f32::to_le_bytes)
        .collect();
    std::fs::write(scans.join("1600000000000000000.bin"), bytes).unwrap();
    let log = open(dir.path()).unwrap();
    assert!(log.is_unplaced());
    let scan = log.read(0).unwrap();
    let (rings, times) = (scan.rings.unwrap(), scan.times.unwrap());
    assert_eq!((rings[0], rings[63], rings[64]), (63, 0, 63));
    assert!(times[63] == 0.0 && (times[65535] - 0.1 * 1023.0 / 1024.0).abs() < 1e-6);
}

#[test]
fn each_scanner_of_helipr_has_its_layout() {
    for name in ["Ouster", "Velodyne", "Avia", "Aeva"] {
        let log = checked(&format!("helipr/LiDAR/{name}"), "HeLiPR", 3, 1e-3);
        assert_eq!(log.sensors()[0].name, name);
        let scan = log.read(0).unwrap();
        assert_eq!(scan.rings.is_some(), ["Ouster", "Velodyne"].contains(&name));
        assert!((scan.times.unwrap()[39] - 0.09).abs() < 1e-6);
    }
    assert_eq!(opened("helipr", &OpenOptions::default()).sensors()[0].name, "Ouster");
    let both = opened("helipr", &sensors(&["Ouster", "Avia"]));
    assert_eq!((both.len(), both.sensors().len()), (Some(6), 2));
    assert!(
        message("helipr", &sensors(&["Livox"])).contains("there is no scanner \"Livox\"; there are Ouster, Velodyne")
    );
}

#[test]
fn nclt_stands_upright() {
    let log = checked("nclt/2012-01-08", "NCLT", 3, 0.01);
    assert_eq!(log.notes(), ["1 scans at times without a pose are left out"]);
    // The scanner is above the body, whose height is 0.2 m.
    assert!((log.scans()[0].pose.unwrap().translation.z - 1.157).abs() < 1e-3);
    assert!(log.read(0).unwrap().rings.is_some());
}

#[test]
fn newer_college_is_placed_by_its_camera() {
    let log = checked("newer_college", "Newer College", 3, 1e-3);
    let scan = log.read(2).unwrap();
    assert!(scan.rings.is_some() && (scan.times.unwrap()[39] - 0.09).abs() < 1e-6);
}

#[cfg(feature = "las")]
#[test]
fn las_with_a_trajectory_is_seen_from_where_the_scanner_was() {
    let east = DVec3::new(690_000.0, 5_334_000.0, 500.0);
    let mut wanted = world();
    wanted.sort_by(|a, b| a.x.total_cmp(&b.x));
    for name in ["drive.las", "drive.laz", "mixed.laz"] {
        let log = opened(&format!("surveys/{name}"), &OpenOptions::default());
        assert_eq!((log.format(), log.len()), ("LAS", Some(3)), "{name}: {:?}", log.notes());
        for index in (0..3).rev() {
            let scan = log.read(index).unwrap();
            let mut found: Vec<_> = scan.points_in_world().unwrap().map(|p| p - east).collect();
            found.sort_by(|a, b| a.x.total_cmp(&b.x));
            assert_eq!(found.len(), wanted.len());
            for (found, wanted) in found.iter().zip(&wanted) {
                assert!(found.distance(*wanted) < 1e-3, "{name}: {found} where {wanted} is");
            }
            // 0.2 m up, and 0.5 m on from scan to scan.
            let from = scan.pose.unwrap().translation - east;
            assert!(from.distance(DVec3::new(0.5 * index as f64, 1.0, 0.2)) < 1e-6, "{from}");
            assert!(scan.times.unwrap().iter().all(|t| (0.0049..0.0951).contains(t)));
        }
    }
    // All files of a folder together.
    assert_eq!(
        message("surveys/untimed.las", &OpenOptions::default())
            .rsplit_once(": ")
            .unwrap()
            .1,
        "has points without GPS times, so where each was seen from is not known"
    );
    let listed = OpenOptions {
        poses: Some(folder("surveys/scans/poses.txt")),
        ..OpenOptions::default()
    };
    assert!(message("surveys/drive.las", &listed).contains("does not tell where the scanner was"));
    checked("surveys/scans", "LAZ folder", 2, 1e-3);
    // Around the first latitude and longitude, where the points are in UTM.
    let dir = tempfile::tempdir().unwrap();
    let geographic = dir.path().join("ins.csv");
    std::fs::write(
        &geographic,
        "t,lat,lon,alt,roll,pitch,heading\n0,48,11,500,0,0,0\n9,48,11,500,0,0,0\n",
    )
    .unwrap();
    let elsewhere = OpenOptions {
        poses: Some(geographic),
        ..OpenOptions::default()
    };
    let told = message("surveys/drive.las", &elsewhere);
    assert!(
        told.contains("km from the points: both must lie in one world"),
        "{told}"
    );
}

#[cfg(feature = "e57")]
#[test]
fn scans_of_e57_have_poses() {
    let east = DVec3::new(690_000.0, 5_334_000.0, 500.0);
    let log = opened("surveys/two.e57", &OpenOptions::default());
    assert_eq!((log.format(), log.len()), ("E57", Some(2)), "{:?}", log.notes());
    assert_eq!(log.scans()[1].name, "station 1");
    for index in [1, 0] {
        let scan = log.read(index).unwrap();
        for (found, wanted) in scan.points_in_world().unwrap().zip(world()) {
            assert!((found - east).distance(wanted) < 1e-3, "{found} where {wanted} is");
        }
        assert_eq!(scan.intensities.unwrap()[39], 39.0);
    }
    let listed = OpenOptions {
        poses: Some(folder("surveys/scans/poses.txt")),
        ..OpenOptions::default()
    };
    assert!(
        opened("surveys/two.e57", &listed).scans()[1]
            .pose
            .unwrap()
            .translation
            .x
            < 1.0
    );
}

#[cfg(not(feature = "e57"))]
#[test]
fn what_is_not_built_in_is_named_with_its_feature() {
    assert!(
        message("surveys/two.e57", &OpenOptions::default())
            .ends_with("is E57, which is read if tsdfuse is built with --features e57")
    );
}

/// One clear line for what the makers of readers test with, too: wrong checksums, odd formats.
#[cfg(all(feature = "las", feature = "e57"))]
#[test]
fn real_surveys_are_bearable() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs");
    if !root.is_dir() {
        println!("skipped: there are no real logs at {}", root.display());
        return;
    }
    let mut read = 0;
    for kind in ["e57", "las"] {
        for name in crate::files::names(&root.join(kind)).unwrap() {
            let path = root.join(kind).join(&name);
            let told = match open(&path) {
                Ok(log) => {
                    let scans: Vec<_> = (0..log.len().unwrap()).map(|index| log.read(index)).collect();
                    read += scans.iter().filter(|scan| scan.is_ok()).count();
                    scans.into_iter().find_map(Result::err).map(|e| e.to_string())
                }
                Err(error) => Some(error.to_string()),
            };
            println!("{kind}/{name}: {told:?}");
            assert!(told.is_none_or(|told| !told.contains('\n')), "{name}");
        }
    }
    assert!(read > 0);
}

/// Damage anywhere is one line or nothing.
#[cfg(all(feature = "las", feature = "e57"))]
#[test]
fn damaged_surveys_are_bearable() {
    for name in ["drive.las", "mixed.laz", "two.e57"] {
        let whole = std::fs::read(folder("surveys").join(name)).unwrap();
        for k in 0..400 {
            let mut bytes = whole.clone();
            if k % 4 == 0 {
                bytes.truncate(whole.len() * k / 400);
            } else {
                let at = (k * 7919 + 13) * 104_729 % bytes.len();
                let end = (at + 1 + k % 5).min(bytes.len());
                bytes[at..end].fill([0, 0xff, 0x7f, 0x80][k % 4]);
            }
            crate::fuzzing::surveys(&bytes);
        }
    }
}
