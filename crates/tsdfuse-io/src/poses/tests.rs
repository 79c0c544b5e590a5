use super::*;
use proptest::prelude::*;

const IDENTITY: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n";

fn poses(text: &str) -> Result<Poses, String> {
    parse(Path::new("poses.txt"), text.as_bytes()).map_err(|e| e.to_string())
}

fn scans(names: &[&str]) -> Vec<ScanFile> {
    let file = |name: &&str| ScanFile {
        path: name.into(),
        name: (*name).to_owned(),
    };
    names.iter().map(file).collect()
}

fn shift(x: f64) -> Pose {
    Pose {
        translation: DVec3::new(x, 0.0, 0.0),
        ..Pose::IDENTITY
    }
}

/// Poses at these seconds and places.
fn timed(poses: &[(f64, f64)]) -> Trajectory {
    let poses = poses.iter().map(|&(secs, x)| (ns(secs), shift(x)));
    Trajectory::new(poses.collect()).unwrap()
}

fn ns(secs: f64) -> i64 {
    (secs * 1e9).round() as i64
}

fn placed(poses: &Poses, names: &[&str], secs: Option<Vec<f64>>) -> Result<Vec<(f64, Option<f64>)>, String> {
    let times_ns = secs.map(|secs| secs.into_iter().map(ns).collect());
    let placed = place(Path::new("poses.txt"), poses, &scans(names), times_ns).map_err(|e| e.to_string())?;
    Ok(placed
        .into_iter()
        .map(|(pose, time_ns)| (pose.translation.x, time_ns.map(|ns| secs_between(0, ns))))
        .collect())
}

#[test]
fn both_notations_are_told_apart() {
    assert_eq!(poses(&IDENTITY.repeat(2)), Ok(Poses::Listed(vec![Pose::IDENTITY; 2])));
    let timed = Poses::Timed(timed(&[(0.5, 7.0), (1.5, 8.0)]));
    let text = "\u{feff}# secs x y z qx qy qz qw\r\n\r\n0.5 7 0 0 0 0 0 1\r\n1.5, 8, 0, 0, 0, 0, 0, 1";
    assert_eq!(poses(text), Ok(timed));
}

#[test]
fn every_error_names_the_line() {
    let seven = |bad: &str| poses(&(IDENTITY.repeat(6) + bad)).unwrap_err();
    for (bad, message) in [
        (
            "1 0 0 0 0 1 0 0 0 0 1",
            "line 7: 11 numbers where a pose has 12, as in the lines before",
        ),
        (
            "0 0 0 0 0 0 0 1",
            "line 7: 8 numbers where a pose has 12, as in the lines before",
        ),
        (
            "1 0 0 NaN 0 1 0 0 0 0 1 0",
            "line 7: the pose holds a number that is not finite",
        ),
        ("1 0 0 x 0 1 0 0 0 0 1 0", "line 7: \"x\" is not a number"),
        (
            "2 0 0 0 0 2 0 0 0 0 2 0",
            "line 7: the pose is not rigid: its 3x3 part is 3.00e0 away from a rotation",
        ),
    ] {
        assert_eq!(seven(bad), format!("poses.txt: {message}"));
    }
    let tum = "1 0 0 0 0 0 0 1\n";
    assert_eq!(
        poses(&tum.repeat(2)).unwrap_err(),
        "poses.txt: line 2: the time 1 is not later than that of the pose before"
    );
    assert!(
        poses("1 0 0 0 0 0 0 0")
            .unwrap_err()
            .contains("line 1: the pose is not rigid")
    );
    assert!(
        poses("inf 0 0 0 0 0 0 1")
            .unwrap_err()
            .contains("line 1: the time is not finite")
    );
    assert_eq!(poses("# nothing\n").unwrap_err(), "poses.txt: holds no poses");
    assert_eq!(
        parse(Path::new("p"), b"1 \xff").unwrap_err().to_string(),
        "p: is not text: byte 2 is not UTF-8"
    );
}

#[test]
fn listed_poses_go_by_order_or_by_number() {
    let listed = Poses::Listed((0..4).map(|i| shift(f64::from(i))).collect());
    let x = |names: &[&str]| {
        Ok(placed(&listed, names, None)?
            .into_iter()
            .map(|p| p.0)
            .collect::<Vec<_>>())
    };
    assert_eq!(x(&["a", "b", "c", "d"]), Ok(vec![0.0, 1.0, 2.0, 3.0]));
    assert_eq!(x(&["7.bin", "8.bin", "9.bin", "10.bin"]), Ok(vec![0.0, 1.0, 2.0, 3.0]));
    assert_eq!(x(&["001.bin", "003.bin"]), Ok(vec![1.0, 3.0]));
    let refused: Result<Vec<f64>, String> = x(&["001.bin", "004.bin"]);
    assert_eq!(
        refused.unwrap_err(),
        "poses.txt: 4 poses for 2 scans, and the scans' names do not number them"
    );
    assert!(x(&["a", "1"]).is_err());
    assert!(
        x(&["0", "1", "2", "3", "4"])
            .unwrap_err()
            .contains("4 poses for 5 scans")
    );
}

#[test]
fn timed_poses_are_interpolated_within_the_gap() {
    let timed = Poses::Timed(timed(&[(0.0, 0.0), (0.2, 2.0), (0.3, 3.0), (2.0, 4.0)]));
    let at = |secs: f64| placed(&timed, &["a.pcd"], Some(vec![secs])).map(|p| p[0].0);
    let near = |secs, x: f64| at(secs).is_ok_and(|got| (got - x).abs() < 1e-9);
    assert!(near(0.1, 1.0) && near(0.25, 2.5) && near(0.3, 3.0) && near(2.0, 4.0) && near(0.300_01, 3.0));
    assert_eq!(
        at(1.0).unwrap_err(),
        "poses.txt: no pose for a.pcd at 1.000000 s: its neighbours, at 0.300000 and 2.000000, are more than 0.2 s apart"
    );
    assert_eq!(
        at(2.5).unwrap_err(),
        "poses.txt: no pose for a.pcd at 2.500000 s: the poses run from 0.000000 to 2.000000 s"
    );
    // Scans that tell no time take them by order.
    let by_order = placed(&timed, &["0", "1", "2", "3"], None).unwrap();
    assert_eq!(by_order[2], (3.0, Some(0.3)));
    assert!(
        placed(&timed, &["0", "1"], None)
            .unwrap_err()
            .contains("4 poses with times for 2 scans without")
    );
}

#[test]
fn the_pose_file_is_found_or_the_choice_is_left_to_the_user() {
    let dir = tempfile::tempdir().unwrap();
    let add = |name: &str| std::fs::write(dir.path().join(name), "").unwrap();
    let found = || find(dir.path()).map(|p| p.map(|p| p.file_name().unwrap().to_str().unwrap().to_owned()));
    assert_eq!(found().unwrap(), None);
    add("readme.txt");
    add("07.txt");
    assert_eq!(found().unwrap().as_deref(), Some("07.txt"));
    add("08.txt");
    assert!(
        found()
            .unwrap_err()
            .to_string()
            .ends_with("has several pose files, 07.txt and 08.txt: name the one to use")
    );
    add("00.poses_cam0.txt");
    assert_eq!(found().unwrap().as_deref(), Some("00.poses_cam0.txt"));
    add("poses.txt");
    assert_eq!(found().unwrap().as_deref(), Some("poses.txt"));
}

#[test]
fn all_poses_of_a_file_are_read_whatever_its_kind() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("poses.txt");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        read_all(&path).map_err(|e| e.to_string())
    };
    let three = "1 0 0 5\n0 1 0 0\n\n0 0 1 0\n";
    assert_eq!(read(three), Ok(vec![shift(5.0)]));
    assert_eq!(
        read(&format!("# world_from_camera\n{three}0 0 0 1")),
        Ok(vec![shift(5.0)])
    );
    assert_eq!(read(&IDENTITY.repeat(3)), Ok(vec![Pose::IDENTITY; 3]));
    assert_eq!(read("3.5 7 0 0 0 0 0 1"), Ok(vec![shift(7.0)]));
    for bad in [
        "1 0 0 5\n0 1 0 0",
        &format!("{three}0 0 0 2"),
        &format!("{three}0 0 0 1\n0 0 0 1"),
        "1 0 0 5\n0 1 0\n0 0 1 0",
    ] {
        let told = read(bad).unwrap_err();
        assert!(
            told.contains("poses.txt: a matrix has 3 lines of 4 numbers, or 4"),
            "{told}"
        );
    }
    assert!(read("").unwrap_err().contains("holds no poses"));
    assert!(read("2 0 0 5\n0 1 0 0\n0 0 1 0").unwrap_err().contains("not rigid"));
    assert!(read("1 0 0 x").unwrap_err().contains("line 1: \"x\" is not a number"));
}

proptest! {
    #[test]
    fn any_bytes_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = parse(Path::new("p"), &bytes);
    }

    #[test]
    fn any_numbers_are_bearable(rows in prop::collection::vec(prop::collection::vec(any::<f64>(), 7..14), 0..5)) {
        let line = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let text = rows.iter().map(line).collect::<Vec<_>>().join("\n");
        let _ = parse(Path::new("p"), text.as_bytes());
    }
}
