use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use tsdfuse::glam::DVec3;

use super::{Packet, packet};

/// KITTI's first packet of drive 2011_09_26_drive_0001, and one 0.1 s later as if the car had driven on.
const FIRST: &str = "49.015003823272 8.4342971002335 116.43032836914 0.035752 0.00903 -2.6087069803847 -6.811441479104 -11.275641809511 13.172716663769";

/// A drive with three scans and packets 0.1 s apart; the scans are 5 ms late, and scan 1 is missing.
fn drive(folder: &Path) -> PathBuf {
    let drive = folder.join("drive_0001_sync");
    for sub in ["velodyne_points/data", "oxts/data"] {
        fs::create_dir_all(drive.join(sub)).unwrap();
    }
    let (mut scan_times, mut packet_times) = (String::new(), String::new());
    for i in 0..4_u32 {
        // East at one metre a packet, at the equator: a degree is 111 319.49 m.
        let packet = format!("0 {:.12} 100 0 0 0 1 2 3\n", f64::from(i) / 111_319.490_793_273_57);
        fs::write(drive.join(format!("oxts/data/{i:010}.txt")), packet).unwrap();
        writeln!(packet_times, "2011-09-26 13:02:25.{i}00000000").unwrap();
        writeln!(scan_times, "2011-09-26 13:02:25.{i}05000000").unwrap();
        if i != 1 {
            fs::write(drive.join(format!("velodyne_points/data/{i:010}.bin")), [0; 32]).unwrap();
        }
    }
    fs::write(drive.join("oxts/timestamps.txt"), packet_times).unwrap();
    fs::write(drive.join("velodyne_points/timestamps.txt"), scan_times).unwrap();
    drive
}

fn refused(drive: &Path) -> String {
    crate::open(drive)
        .unwrap_err()
        .to_string()
        .replace(drive.to_str().unwrap(), "DRIVE")
}

#[test]
fn scans_stand_where_the_packets_say_at_their_own_time() {
    let dir = tempfile::tempdir().unwrap();
    let drive = drive(dir.path());
    let dataset = crate::open(&drive).unwrap();
    assert_eq!((dataset.format(), dataset.len()), ("KITTI raw", Some(3)));
    assert_eq!(
        dataset.notes(),
        ["no calib_imu_to_velo.txt: the scanner is taken to be where the IMU is"]
    );
    assert_eq!(
        dataset.sensors()[0].model.as_ref().map(|s| s.name.as_str()),
        Some("hdl64e")
    );
    for (scan, x) in dataset.scans().iter().zip([0.05, 2.05, 3.05]) {
        assert!(
            scan.pose.unwrap().translation.distance(DVec3::new(x, 0.0, 0.0)) < 1e-5,
            "{scan:?}"
        );
    }
    assert_eq!(dataset.read(2).unwrap().points.len(), 2);

    // Points of the IMU, half a metre to the left of the scanner and turned by 90°, are moved to the scanner's frame.
    fs::write(
        dir.path().join("calib_imu_to_velo.txt"),
        "calib_time: x\nR: 0 -1 0 1 0 0 0 0 1\nT: 0 0.5 0\n",
    )
    .unwrap();
    let dataset = crate::open(&drive).unwrap();
    assert!(dataset.notes().is_empty());
    let imu_in_world = dataset.scans()[0]
        .pose
        .unwrap()
        .transform_point(DVec3::new(0.0, 0.5, 0.0));
    assert!(imu_in_world.distance(DVec3::new(0.05, 0.0, 0.0)) < 1e-5);
    let forward = dataset.scans()[0].pose.unwrap().rotation * DVec3::Y;
    assert!(forward.distance(DVec3::X) < 1e-12, "the car's x is the scanner's y");
}

#[test]
fn packets_are_the_trajectory_and_the_imu_of_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let drive = drive(dir.path());
    let calibration = "calib_time: x\nR: 0 -1 0 1 0 0 0 0 1\nT: 0 0.5 0\n";
    fs::write(dir.path().join("calib_imu_to_velo.txt"), calibration).unwrap();
    // The last packet has rates and accelerations, too: 11 to 13 and 17 to 19.
    let numbers: Vec<String> = (6..30).map(|i| i.to_string()).collect();
    let last = format!(
        "0 {:.12} 100 0 0 1.5 {}\n",
        3.0 / 111_319.490_793_273_57,
        numbers.join(" ")
    );
    fs::write(drive.join("oxts/data/0000000003.txt"), last).unwrap();
    let log = crate::open(&drive).unwrap();
    let trajectory = log.trajectory().unwrap();
    let (first, end) = trajectory.span_ns();
    assert_eq!((first % 1_000_000_000, end - first), (0, 300_000_000));
    // The body is the IMU; the scanner's pose follows from it.
    let scan = &log.scans()[1];
    let body = trajectory.at(scan.time_ns.unwrap()).unwrap();
    let pose = body * log.sensors()[0].body_from_sensor;
    assert!(body.translation.distance(DVec3::new(2.05, 0.0, 0.0)) < 1e-5, "{body:?}");
    assert!(pose.translation.distance(scan.pose.unwrap().translation) < 1e-9);
    let samples = log.imu().unwrap();
    let [sample] = samples.as_slice() else {
        panic!("{samples:?}")
    };
    assert_eq!(sample.time_ns, end);
    assert_eq!(sample.acceleration, DVec3::new(11.0, 12.0, 13.0));
    assert_eq!(sample.angular_velocity, DVec3::new(17.0, 18.0, 19.0));
    assert!((sample.orientation.unwrap() * DVec3::X).distance(DVec3::new(1.5f64.cos(), 1.5f64.sin(), 0.0)) < 1e-12);
}

#[test]
fn packets_that_do_not_fit_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let drive = drive(dir.path());
    let late = fs::read_to_string(drive.join("oxts/timestamps.txt"))
        .unwrap()
        .replace("25.2", "25.8");
    fs::write(drive.join("oxts/timestamps.txt"), late).unwrap();
    assert_eq!(
        refused(&drive),
        "DRIVE/oxts/data: the packet of scan 0000000002.bin is -0.595 s away from it"
    );
    fs::remove_file(drive.join("oxts/data/0000000003.txt")).unwrap();
    fs::remove_file(drive.join("oxts/timestamps.txt")).unwrap();
    assert_eq!(
        refused(&drive),
        "DRIVE/oxts/data: has no packet for scan 0000000003.bin"
    );
    fs::write(drive.join("oxts/data/0000000003.txt"), "49 8").unwrap();
    assert_eq!(
        refused(&drive),
        "DRIVE/oxts/data/0000000003.txt: line 1: 2 numbers where lat lon alt roll pitch yaw were expected"
    );
    fs::remove_dir_all(drive.join("oxts")).unwrap();
    let log = crate::open(&drive).unwrap();
    assert!(log.scans().iter().all(|scan| scan.pose.is_none()) && log.trajectory().is_none());
    assert!(log.imu().unwrap().is_empty());
}

#[test]
fn the_packet_of_kitti_is_understood() {
    let of = |text: &str| packet(Path::new("0.txt"), text.as_bytes()).map_err(|e| e.to_string());
    let first = of(FIRST).unwrap();
    // er · cos(lat) · lon and er · cos(lat) · ln tan(45° + lat / 2), as in KITTI's development kit.
    let position = first.position(first.latitude_deg.to_radians().cos());
    assert!(
        position.distance(DVec3::new(615_789.331_4, 4_117_109.179_6, 116.430_3)) < 1e-3,
        "{position}"
    );
    let up = first.rotation() * DVec3::Z;
    assert!((up.z - first.roll_rad.cos() * first.pitch_rad.cos()).abs() < 1e-12);
    let forward = first.rotation() * DVec3::X;
    assert!(
        (forward.y.atan2(forward.x) - first.yaw_rad).abs() < 1e-12 && (forward.z + first.pitch_rad.sin()).abs() < 1e-12
    );
    for bad in ["", "91 0 0 0 0 0", "nan 0 0 0 0 0"] {
        assert!(of(bad).unwrap_err().starts_with("0.txt: "));
    }
    let Packet { altitude_m, .. } = first;
    assert_eq!(altitude_m, 116.430_328_369_14);
}
