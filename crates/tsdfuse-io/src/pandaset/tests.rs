use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3, Vec3};
use tsdfuse::scan::RangeLimits;

use super::*;

fn sample() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../sample/pandaset-002")
}

fn options(sensor: &str) -> OpenOptions {
    OpenOptions {
        sensors: vec![sensor.into()],
        ..OpenOptions::default()
    }
}

/// The part of a scan's returns that lie within `limit_deg` of a nominal beam.
fn share_on_beams(scan: &Scan, limit_deg: f64) -> f64 {
    let beams = tsdfuse::sensor::model("pandar64").unwrap().elevations_deg;
    let off = |p: &Vec3| {
        let p = p.as_dvec3();
        let elevation_deg = p.z.atan2(p.x.hypot(p.y)).to_degrees();
        beams
            .iter()
            .map(|&b| (elevation_deg - f64::from(b)).abs())
            .fold(f64::MAX, f64::min)
    };
    scan.points.iter().filter(|p| off(p) <= limit_deg).count() as f64 / scan.points.len() as f64
}

#[test]
fn returns_lie_on_the_beams_of_the_sensor() {
    let pandaset = PandaSet::open(&sample(), &OpenOptions::default()).unwrap();
    let names: Vec<_> = pandaset.scans().iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["44.pkl.gz", "45.pkl.gz", "46.pkl.gz"]);
    assert_eq!(pandaset.notes(), ["frames 0-43 and 47-79 have a pose but no scan"]);
    assert_eq!(pandaset.sensors()[0].name, "pandar64");
    for index in 0..3 {
        let scan = pandaset.read(index).unwrap();
        scan.check().unwrap();
        let share = share_on_beams(&scan, 0.04);
        assert!(share > 0.97, "{}: {share}", scan.name);
        // The comparator can fail: without the sensor's own motion the returns leave the beams.
        let mut rigid = scan.clone();
        let (trajectory, sensor_from_world) = (scan.sweep().unwrap(), scan.pose.unwrap().inverse());
        for (point, time) in rigid.points.iter_mut().zip(scan.times.as_ref().unwrap()) {
            let point_in_world = trajectory.at((*time).into()).transform_point(point.as_dvec3());
            *point = sensor_from_world.transform_point(point_in_world).as_vec3();
        }
        assert!(share_on_beams(&rigid, 0.04) < 0.9);
    }
}

#[test]
fn the_beams_tell_the_motion_where_poses_do_not() {
    let pandaset = PandaSet::open(&sample(), &OpenOptions::default()).unwrap();
    let scan = pandaset.read(1).unwrap();
    let (truth, trajectory) = (scan.motion[0], scan.sweep().unwrap());
    let sensor_from_world = scan.pose.unwrap().inverse();
    let returns: Vec<motion::Return> = scan
        .points
        .iter()
        .zip(scan.times.as_ref().unwrap())
        .map(|(point, &time)| motion::Return {
            point: sensor_from_world.transform_point(trajectory.at(time.into()).transform_point(point.as_dvec3())),
            secs: time.into(),
        })
        .collect();
    let model = pandaset.sensors()[0].model.clone().unwrap();
    let off = |motion: &PoseAt| {
        let off = truth.pose.inverse() * motion.pose;
        (
            off.rotation.to_scaled_axis().length().to_degrees(),
            off.translation.length(),
        )
    };
    // Half a degree of pitch and roll, 0.05 m ahead and down.
    let turned = DQuat::from_scaled_axis(DVec3::new(0.0087, -0.0087, 0.0));
    let wrong = PoseAt {
        pose: truth.pose * Pose::new(turned, DVec3::new(0.05, 0.0, -0.05)).unwrap(),
        ..truth
    };
    assert!(off(&wrong).0 > 0.7 && off(&wrong).1 > 0.07);
    let (off_deg, off_m) = off(&motion::refine(wrong, scan.pose.unwrap(), &model, &returns));
    assert!(off_deg < 0.005 && off_m < 0.005, "{off_deg} degrees, {off_m} m");
    // Too few returns tell nothing.
    let kept = motion::refine(wrong, scan.pose.unwrap(), &model, &returns[..900]);
    assert_eq!(kept.pose, wrong.pose);
}

#[test]
fn every_return_comes_back_to_where_the_file_has_it() {
    let files = sample().join("lidar");
    let pickle = pickle::load(&files.join("45.pkl.gz")).unwrap();
    let table = DataFrame::new(&pickle).unwrap();
    let [x, y, z, d] = ["x", "y", "z", "d"].map(|c| table.column(c).unwrap());
    for (device, sensor) in ["pandar64", "Pandar GT"].into_iter().enumerate() {
        let pandaset = PandaSet::open(&files, &options(sensor)).unwrap();
        let mut scan = pandaset.read(1).unwrap();
        let mine: Vec<usize> = (0..d.len()).filter(|&k| d[k] == device as f64).collect();
        assert_eq!(scan.points.len(), mine.len());
        assert_eq!(scan.dropped.other_sensor as usize, d.len() - mine.len());
        assert_eq!(scan.time_ns, pandaset.scans()[1].time_ns);
        let trajectory = scan.sweep().unwrap();
        for ((&k, point), &time) in mine.iter().zip(&scan.points).zip(scan.times.as_ref().unwrap()) {
            let point_in_world = trajectory.at(time.into()).transform_point(point.as_dvec3());
            let off = point_in_world.distance(DVec3::new(x[k], y[k], z[k]));
            // Half a unit of an f32 at 200 m, in each of three coordinates.
            assert!(off < 1.4e-5, "{sensor}: return {k} is {off} m off");
        }
        scan.drop_invalid(&RangeLimits::default());
        assert_eq!(scan.dropped.not_finite, 0);
    }
}

/// How far returns lie off the line between their neighbours on a scan line of the PandarGT, degrees: median and 95 %.
fn roughness_deg(points: &[Vec3], origin: DVec3) -> (f64, f64) {
    let seen: Vec<(f64, f64)> = points
        .iter()
        .map(|p| {
            let ray = p.as_dvec3() - origin;
            (
                ray.y.atan2(ray.x).to_degrees(),
                ray.z.atan2(ray.x.hypot(ray.y)).to_degrees(),
            )
        })
        .collect();
    let mut off: Vec<f64> = (16..seen.len())
        .filter_map(|k| {
            let ((a0, e0), (a1, e1), (a2, e2)) = (seen[k - 16], seen[k - 8], seen[k]);
            let s = (a1 - a0) / (a2 - a0);
            ((a2 - a0).abs() < 3.0 && (0.2..0.8).contains(&s)).then(|| (e0 + (e2 - e0) * s - e1).abs())
        })
        .collect();
    off.sort_by(f64::total_cmp);
    (off[off.len() / 2], off[off.len() * 95 / 100])
}

#[test]
fn the_pandargt_sees_its_scan_lines_from_its_published_origin() {
    let pandaset = PandaSet::open(&sample(), &options("pandargt")).unwrap();
    assert!(pandaset.sensors()[0].model.is_none());
    for index in 0..3 {
        let scan = pandaset.read(index).unwrap();
        let (median, most) = roughness_deg(&scan.points, DVec3::ZERO);
        assert!(median < 0.01 && most < 0.03, "{}: {median}, {most}", scan.name);
        // Not from the Pandar64, nor from where the calibration would lie if it were meant the other way round.
        let (gt, pandar64) = (Lidar::PandarGt.ego_from_sensor(), Lidar::Pandar64.ego_from_sensor());
        let gt_from_pandar64 = (gt.inverse() * pandar64).translation;
        for origin in [gt_from_pandar64, 2.0 * gt_from_pandar64] {
            let (_, most_elsewhere) = roughness_deg(&scan.points, origin);
            assert!(
                most_elsewhere > 3.0 * most,
                "{}: {most_elsewhere} against {most}",
                scan.name
            );
        }
        let azimuths = || scan.points.iter().map(|p| p.y.atan2(p.x).to_degrees());
        let (right, left) = (azimuths().fold(0.0, f32::min), azimuths().fold(0.0, f32::max));
        assert!((left + right).abs() < 2.0 && left - right > 60.0, "{right} to {left}");
    }
}

#[test]
fn all_scans_of_the_full_excerpt_lie_on_the_beams() {
    let full = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/pandaset/002");
    if !full.is_dir() {
        println!("skipped: {} is not there", full.display());
        return;
    }
    let pandaset = PandaSet::open(&full, &OpenOptions::default()).unwrap();
    assert_eq!(pandaset.scans().len(), 20);
    assert_eq!(pandaset.notes(), ["frames 0-35 and 56-79 have a pose but no scan"]);
    for index in 0..20 {
        let scan = pandaset.read(index).unwrap();
        let share = share_on_beams(&scan, 0.04);
        println!(
            "{}: {} returns, {:.2} % on a beam",
            scan.name,
            scan.points.len(),
            100.0 * share
        );
        assert!(share >= 0.97, "{}: {share}", scan.name);
    }
}

/// A sequence of three frames with the scan `01.pkl`: seven points, four of them of the Pandar64.
struct Small(tempfile::TempDir);

const POSES: &str = r#"[
{"position": {"x": 0, "y": 0, "z": 0}, "heading": {"w": 1, "x": 0, "y": 0, "z": 0}},
{"position": {"x": 0, "y": 1, "z": 0}, "heading": {"w": 1, "x": 0, "y": 0, "z": 0}},
{"position": {"x": 0, "y": 2, "z": 0}, "heading": {"w": 1, "x": 0, "y": 0, "z": 0}}]"#;

impl Small {
    fn new() -> Self {
        let small = Self(tempfile::tempdir().unwrap());
        std::fs::create_dir(small.0.path().join("lidar")).unwrap();
        small.write("poses.json", POSES);
        small.write("timestamps.json", "[1557539959.9, 1557539960.0, 1557539960.1]");
        small.write("01.pkl", Self::pickle());
        small
    }

    fn pickle() -> Vec<u8> {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("testdata/pickle");
        std::fs::read(folder.join("pandas2.3_p5.pkl")).unwrap()
    }

    /// The pickle with one number changed in it.
    fn pickle_with(from: f64, to: f64) -> Vec<u8> {
        let mut pickle = Self::pickle();
        let at = pickle.windows(8).position(|w| w == from.to_le_bytes()).unwrap();
        pickle[at..at + 8].copy_from_slice(&to.to_le_bytes());
        pickle
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.0.path().join("lidar").join(name), content).unwrap();
    }

    fn remove(&self, name: &str) {
        std::fs::remove_file(self.0.path().join("lidar").join(name)).unwrap();
    }

    fn open(&self) -> Result<PandaSet> {
        PandaSet::open(self.0.path(), &OpenOptions::default())
    }

    /// The reason for which the sequence, or its only scan, cannot be read.
    fn reason(&self) -> String {
        let message = self.open().and_then(|p| p.read(0)).unwrap_err().to_string();
        assert!(!message.contains('\n'), "{message}");
        message.replace(&self.0.path().display().to_string(), "DIR")
    }
}

#[test]
fn a_sequence_or_its_lidar_folder_is_recognised() {
    let small = Small::new();
    let lidar = small.0.path().join("lidar");
    assert!(PandaSet::recognises(small.0.path()) && PandaSet::recognises(&lidar));
    assert!(!PandaSet::recognises(&lidar.join("01.pkl")) && !PandaSet::recognises(Path::new("/nowhere")));
    small.remove("01.pkl");
    assert!(PandaSet::recognises(small.0.path()) && !PandaSet::recognises(&lidar));
    assert_eq!(small.reason(), "DIR/lidar: has no scan NN.pkl.gz with a pose");
}

#[test]
fn the_sensor_is_chosen_by_name() {
    let small = Small::new();
    let error = PandaSet::open(small.0.path(), &options("vlp16"))
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with(": has no sensor 'vlp16': it is pandar64 or pandargt"),
        "{error}"
    );
    for (name, returns) in [("Pandar-64", 4), ("PandarGT", 3)] {
        let scan = PandaSet::open(small.0.path(), &options(name)).unwrap().read(0).unwrap();
        assert_eq!(
            (scan.points.len(), scan.dropped.other_sensor),
            (returns, 7 - returns as u64)
        );
    }
}

/// Each sensor sees what it sees alone; the trajectory is the vehicle's.
#[test]
fn both_sensors_are_read_with_their_own_extrinsics() {
    let both = OpenOptions {
        sensors: vec!["pandar64".into(), "pandargt".into()],
        ..OpenOptions::default()
    };
    let pandaset = PandaSet::open(&sample(), &both).unwrap();
    let names: Vec<_> = pandaset.sensors().iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["pandar64", "pandargt"]);
    let scans: Vec<_> = pandaset.scans().iter().map(|s| (s.name.as_str(), s.sensor)).collect();
    assert_eq!(scans.len(), 6);
    assert_eq!(
        (scans[0], scans[3]),
        (("44.pkl.gz (pandar64)", 0), ("45.pkl.gz (pandargt)", 1))
    );
    for (sensor, name) in names.into_iter().enumerate() {
        let alone = PandaSet::open(&sample(), &options(name)).unwrap();
        let (one, of_both) = (alone.read(1).unwrap(), pandaset.read(2 + sensor).unwrap());
        assert_eq!(
            (&one.points, one.pose, &one.motion),
            (&of_both.points, of_both.pose, &of_both.motion)
        );
        assert!(one.dropped.other_sensor > 0 && of_both.dropped.other_sensor == 0);
        let trajectory = pandaset.trajectory().unwrap();
        let vehicle = trajectory.at(of_both.time_ns.unwrap()).unwrap();
        let pose = vehicle * pandaset.sensors()[sensor].body_from_sensor;
        assert!(pose.translation.distance(of_both.pose.unwrap().translation) < 1e-9);
    }
    // Other poses are the first sensor's; the second goes with it.
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("poses.txt");
    std::fs::write(&poses, "1 0 0 5 0 1 0 6 0 0 1 7\n".repeat(80)).unwrap();
    let moved = OpenOptions {
        poses: Some(poses),
        ..both
    };
    let moved = PandaSet::open(&sample(), &moved).unwrap();
    assert_eq!(moved.scans()[2].pose.unwrap().translation, DVec3::new(5.0, 6.0, 7.0));
    let between = |log: &PandaSet| (log.scans()[2].pose.unwrap().inverse() * log.scans()[3].pose.unwrap()).translation;
    assert!(between(&moved).distance(between(&pandaset)) < 1e-9 && between(&moved).length() > 0.5);
    assert!(moved.trajectory().is_none());
}

#[test]
fn images_of_cameras_are_found_and_a_broken_camera_is_noted() {
    let small = Small::new();
    let camera = small.0.path().join("camera");
    for name in ["front_camera", "left_camera"] {
        std::fs::create_dir_all(camera.join(name)).unwrap();
        for (file, content) in [
            (
                "intrinsics.json",
                "{\"fx\": 1970.0, \"fy\": 1971.0, \"cx\": 970.0, \"cy\": 483.3}",
            ),
            ("poses.json", POSES),
            ("timestamps.json", "[1557539959.9, 1557539960.0, 1557539960.1]"),
            ("02.jpg", "two"),
            ("00.jpg", "nought"),
        ] {
            std::fs::write(camera.join(name).join(file), content).unwrap();
        }
    }
    let pandaset = small.open().unwrap();
    let names: Vec<_> = pandaset.images().iter().map(|image| image.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "front_camera/00.jpg",
            "front_camera/02.jpg",
            "left_camera/00.jpg",
            "left_camera/02.jpg"
        ]
    );
    let image = &pandaset.images()[1];
    assert_eq!((image.camera.width, image.camera.fy), (1920, 1971.0));
    assert_eq!(image.pose.unwrap().translation, DVec3::Y * 2.0);
    assert!((image.time_ns.unwrap() - 1_557_539_960_100_000_000).abs() < 1000);
    assert_eq!(pandaset.read_image(1).unwrap(), b"two");
    assert!(pandaset.read_image(4).unwrap_err().to_string().contains("no image 4"));

    std::fs::write(camera.join("left_camera/intrinsics.json"), "{\"fx\": 1}").unwrap();
    let pandaset = small.open().unwrap();
    assert_eq!(pandaset.images().len(), 2);
    let note = pandaset.notes().last().unwrap();
    assert!(
        note.starts_with("the images of left_camera are left out: ")
            && note.contains("intrinsics.json: missing field `fy`"),
        "{note}"
    );
}

#[test]
fn the_real_cameras_look_where_the_lidar_measures() {
    let full = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/pandaset/002");
    if !full.join("camera").is_dir() {
        println!("skipped: {} has no cameras", full.display());
        return;
    }
    let pandaset = PandaSet::open(&full, &OpenOptions::default()).unwrap();
    assert_eq!(pandaset.images().len(), 60);
    // What a scan measured 5 to 40 m ahead, the front camera sees in its image.
    let scan = pandaset.read(0).unwrap();
    let image = pandaset
        .images()
        .iter()
        .find(|image| image.name == "front_camera/36.jpg")
        .unwrap();
    let ahead = scan.points.iter().zip(scan.points_in_world().unwrap());
    let ahead = ahead.filter(|(p, _)| p.y.abs() < 0.3 * p.x && p.z.abs() < 0.1 * p.x && (5.0..40.0).contains(&p.x));
    let (mut seen, mut all) = (0, 0);
    for (_, in_world) in ahead {
        let p = image.pose.unwrap().inverse().transform_point(in_world);
        let (u, v) = (
            f64::from(image.camera.fx) * p.x / p.z + f64::from(image.camera.cx),
            f64::from(image.camera.fy) * p.y / p.z + f64::from(image.camera.cy),
        );
        all += 1;
        seen += usize::from(p.z > 0.0 && (0.0..1920.0).contains(&u) && (0.0..1080.0).contains(&v));
    }
    assert!(all > 1000 && seen as f64 > 0.95 * all as f64, "{seen} of {all}");
}

#[test]
fn without_times_all_returns_are_placed_from_one_pose() {
    let small = Small::new();
    small.remove("timestamps.json");
    let still = "all returns of a scan are placed from one pose (no deskewing)";
    let pandaset = small.open().unwrap();
    assert_eq!(pandaset.notes()[1], format!("timestamps.json is missing: {still}"));
    let scan = pandaset.read(0).unwrap();
    assert!(scan.times.is_none() && scan.motion.is_empty() && scan.time_ns.is_none());
    let point_in_world = scan.pose.unwrap().transform_point(scan.points[3].as_dvec3());
    assert!(point_in_world.distance(DVec3::new(1.5, 6.75, -1.5)) < 1e-6);

    let small = Small::new();
    small.remove("01.pkl");
    small.write("00.pkl", Small::pickle());
    small.write("poses.json", format!("{}]", POSES.split(",\n").next().unwrap()));
    small.write("timestamps.json", "[1557539960]");
    let pandaset = small.open().unwrap();
    assert_eq!(pandaset.notes(), [format!("there is only one pose: {still}")]);
    assert!(pandaset.read(0).unwrap().motion.is_empty());
}

#[test]
fn the_first_frame_moves_towards_the_second() {
    let small = Small::new();
    small.write("00.pkl", Small::pickle());
    let pandaset = small.open().unwrap();
    let motion = |index| pandaset.read(index).unwrap().motion[0];
    assert!((motion(0).secs - 0.1).abs() < 1e-6 && (motion(1).secs + 0.1).abs() < 1e-6);
    for (from, to) in [(0, 1), (1, 0)] {
        let off = motion(from).pose.inverse() * pandaset.scans()[to].pose.unwrap();
        assert!(off.translation.length() < 1e-9 && off.rotation.to_scaled_axis().length() < 1e-9);
    }
}

#[test]
fn other_poses_move_whole_sweeps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses.txt");
    std::fs::write(&path, "1 0 0 5 0 1 0 6 0 0 1 7\n".repeat(80)).unwrap();
    let options = OpenOptions {
        poses: Some(path.clone()),
        ..OpenOptions::default()
    };
    let (ours, theirs) = (
        PandaSet::open(&sample(), &OpenOptions::default()),
        PandaSet::open(&sample(), &options),
    );
    let (ours, theirs) = (ours.unwrap().read(0).unwrap(), theirs.unwrap().read(0).unwrap());
    assert_eq!(theirs.pose.unwrap().translation, DVec3::new(5.0, 6.0, 7.0));
    assert_eq!((&ours.points, &ours.times), (&theirs.points, &theirs.times));
    let step = |scan: &Scan| (scan.pose.unwrap().inverse() * scan.motion[0].pose).translation;
    assert!(step(&ours).distance(step(&theirs)) < 1e-9 && step(&ours).length() > 0.3);

    std::fs::write(&path, "1 0 0 5 0 1 0 6 0 0 1 7\n".repeat(2)).unwrap();
    assert!(PandaSet::open(&sample(), &options).is_err());
}

#[test]
fn what_has_no_partner_is_noted() {
    let small = Small::new();
    for name in [
        "002.pkl",
        "03.pkl.gz",
        "05.pkl",
        "overview.pkl",
        "7a.pkl.gz",
        "+1.pkl",
        "._00.pkl",
        "notes.txt",
    ] {
        small.write(name, "");
    }
    let pandaset = small.open().unwrap();
    assert_eq!(
        pandaset.scans().iter().map(|s| &s.name).collect::<Vec<_>>(),
        ["01.pkl", "002.pkl"]
    );
    let notes = [
        "frame 0 has a pose but no scan",
        "frames 3 and 5 have a scan but no pose: skipped",
        "no frame's number is the name of +1.pkl, 7a.pkl.gz, overview.pkl: skipped",
    ];
    assert_eq!(pandaset.notes(), notes);
    small.write("1.pkl.gz", "");
    assert_eq!(
        small.reason(),
        "DIR/lidar: has two scans of frame 1: 01.pkl and 1.pkl.gz"
    );
}

#[test]
fn wrong_poses_and_times_are_named_with_their_frame() {
    let no_number = POSES.replace("\"y\": 1", "\"y\": NaN");
    let infinite = POSES.replace("\"y\": 1", "\"y\": 1e999");
    let no_key = POSES.replace("\"y\": 1,", "");
    let turned = POSES.replace(
        "2, \"z\": 0}, \"heading\": {\"w\": 1",
        "2, \"z\": 0}, \"heading\": {\"w\": 0.5",
    );
    for (name, content, expected) in [
        (
            "poses.json",
            no_number.as_str(),
            "frame 1: expected value at line 3 column 28",
        ),
        (
            "poses.json",
            &infinite,
            "frame 1: number out of range at line 3 column 32",
        ),
        ("poses.json", &no_key, "frame 1: missing field `y` at line 3 column 30"),
        ("poses.json", &turned, "frame 2: its heading has length 0.5, not 1"),
        (
            "poses.json",
            "{}",
            "frame 0: invalid type: map, expected a list with one entry a frame at line 1 column 0",
        ),
        (
            "poses.json",
            "",
            "frame 0: EOF while parsing a value at line 1 column 0",
        ),
        ("timestamps.json", "[1, 2]", "2 times, but poses.json has 3 poses"),
        (
            "timestamps.json",
            "[1, 2, NaN]",
            "frame 2: expected value at line 1 column 8",
        ),
        (
            "timestamps.json",
            "[1, 2, 2]",
            "frame 2: its time is not after that of frame 1",
        ),
        (
            "timestamps.json",
            "[1, 2, 3",
            "frame 3: EOF while parsing a list at line 1 column 8",
        ),
        (
            "timestamps.json",
            "[1, 2, 3] 4",
            "trailing characters at line 1 column 11",
        ),
    ] {
        let small = Small::new();
        small.write(name, content);
        assert_eq!(small.reason(), format!("DIR/lidar/{name}: {expected}"));
    }
}

#[test]
fn returns_without_a_usable_time_or_place_are_counted() {
    let third = 1557539960.0 + 2.0 * 0.0078125;
    for wrong in [f64::NAN, f64::INFINITY, 0.0, third + 0.31, third - 0.35] {
        let small = Small::new();
        small.write("01.pkl", Small::pickle_with(third, wrong));
        let mut scan = small.open().unwrap().read(0).unwrap();
        assert!(scan.points[2].is_nan() && scan.points.iter().filter(|p| p.is_finite()).count() == 3);
        scan.drop_invalid(&RangeLimits::default());
        assert_eq!((scan.dropped.untimed, scan.dropped.not_finite), (1, 0), "{wrong}");
        assert_eq!(scan.times.unwrap().len(), 3, "{wrong}");
    }
    let small = Small::new();
    small.write("01.pkl", Small::pickle_with(6.75, f64::NAN));
    let mut scan = small.open().unwrap().read(0).unwrap();
    scan.drop_invalid(&RangeLimits::default());
    assert_eq!(scan.dropped.not_finite, 1);
}

#[test]
fn scans_that_cannot_be_read_are_named() {
    let small = Small::new();
    small.write("timestamps.json", "[1557539960, 1557539961, 1557539962]");
    assert_eq!(
        small.reason(),
        "DIR/lidar/01.pkl: column 't': 4 of 4 times are not within 0.3 s of the frame's, 1557539961.000000"
    );
    let small = Small::new();
    for (pickle, expected) in [
        (&b""[..], "is no pickle of protocol 2 or later"),
        (&Small::pickle()[..400], "byte 192 of the pickle: the file ends here"),
        (
            b"\x80\x02cos\nsystem\n.",
            "foreign class os.system: only DataFrames of numbers are read",
        ),
        (
            b"\x1f\x8b\x08\x00",
            "cannot be read after 0 bytes: unexpected end of file",
        ),
    ] {
        small.write("01.pkl", pickle);
        assert_eq!(small.reason(), format!("DIR/lidar/01.pkl: {expected}"));
    }
    let mut renamed = Small::pickle();
    let at = renamed.windows(3).position(|w| w == b"\x8c\x01t").unwrap();
    renamed[at + 2] = b'T';
    small.write("01.pkl", &renamed);
    assert_eq!(small.reason(), "DIR/lidar/01.pkl: no column 't'");
    let error = small.open().unwrap().read(5).unwrap_err().to_string();
    assert!(error.ends_with("has no scan 5, only 1"), "{error}");
}
