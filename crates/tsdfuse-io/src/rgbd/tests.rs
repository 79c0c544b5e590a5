use std::fs;
use std::path::{Path, PathBuf};

use png::{BitDepth, ColorType};
use proptest::prelude::*;
use tempfile::TempDir;
use tsdfuse::glam::{DQuat, DVec3, Vec3};
use tsdfuse::sensor::{DepthImage, Pinhole};
use tsdfuse::{Pose, Scan};

use super::OPTICAL_FROM_SENSOR;
use crate::{Log, OpenOptions, open, open_with};

mod hostile;

const IDENTITY: &str = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
const CAMERA: &str = "width = 4\nheight = 3\nfx = 4\nfy = 5\ncx = 1.5\ncy = 1\n";

/// A PNG image.
fn png((width, height): (u32, u32), color: ColorType, bits: BitDepth, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(bits);
    if color == ColorType::Indexed {
        encoder.set_palette(vec![0; 3]);
    }
    encoder.write_header().unwrap().write_image_data(data).unwrap();
    bytes
}

fn depths(size: (u32, u32), units: &[u16]) -> Vec<u8> {
    let data: Vec<u8> = units.iter().flat_map(|u| u.to_be_bytes()).collect();
    png(size, ColorType::Grayscale, BitDepth::Sixteen, &data)
}

/// A mask; with one bit a pixel, its rows must be whole bytes.
fn mask(size: (u32, u32), bits: BitDepth, data: &[u8]) -> Vec<u8> {
    png(size, ColorType::Grayscale, bits, data)
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn put(&self, name: &str, content: impl AsRef<[u8]>) -> &Self {
        let path = self.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
        self
    }

    fn remove(&self, name: &str) -> &Self {
        fs::remove_file(self.path().join(name)).unwrap();
        self
    }

    /// Two frames of 4 x 3 pixels in the layout of 7-Scenes; the second looks from (1, 2, 3) m.
    fn seven_scenes() -> Self {
        let folder = Self::new();
        let image = depths((4, 3), &[1000, 0, 65535, 2000, 1, 65534, 0, 0, 1500, 1500, 1500, 1500]);
        let moved = "1 0 0 1 \n0 1 0 2\t\n0 0 1 3\n0 0 0 1\n\n";
        for (stem, pose) in [("frame-000000", IDENTITY), ("frame-000005", moved)] {
            folder.put(&format!("{stem}.depth.png"), &image);
            folder.put(&format!("{stem}.pose.txt"), pose);
            folder.put(&format!("{stem}.color.png"), "not looked at");
        }
        folder.put("camera-intrinsics.txt", "4 0 1.5\n 0 5 1 \n0 0 1\n");
        folder
    }

    /// Three frames of 4 x 3 pixels in the layout of TUM, 0.1 s apart; the camera moves by 1 m/s along z.
    fn tum() -> Self {
        let folder = Self::new();
        let mut list = "# depth maps\n# timestamp filename\n".to_owned();
        for name in ["10.000000", "10.100000", "10.200000"] {
            folder.put(&format!("depth/{name}.png"), depths((4, 3), &[5000; 12]));
            list += &format!("{name} depth/{name}.png\n");
        }
        folder.put("depth.txt", list);
        let poses =
            "# secs tx ty tz qx qy qz qw\n9.95 0 0 9.95 0 0 0 1\n10.12 0 0 10.12 0 0 0 1\n10.3 0 0 10.3 0 0 0 1\n";
        folder.put("groundtruth.txt", poses);
        folder.put("rgb/10.05.png", "not looked at").put("camera.toml", CAMERA);
        folder
    }

    fn open(&self) -> Log {
        open(self.path()).unwrap()
    }

    fn read(&self, index: usize) -> Scan {
        self.open().read(index).unwrap()
    }

    /// The one line of error, met when the folder is opened or when all of it is read.
    fn refused(&self) -> String {
        let read = open(self.path()).and_then(|log| log.into_iter().collect::<crate::Result<Vec<_>>>());
        let message = read.unwrap_err().to_string();
        assert_eq!(message.lines().count(), 1, "{message}");
        message.replace(self.path().to_str().unwrap(), "DIR")
    }
}

/// What a pixel of the 4 x 3 camera sees at a depth, in the optical frame.
fn optical(u: f64, v: f64, depth: f64) -> DVec3 {
    DVec3::new((u - 1.5) / 4.0 * depth, (v - 1.0) / 5.0 * depth, depth)
}

#[test]
fn the_frames_of_camera_and_sensor_are_turned_rightly() {
    for (in_sensor, in_optical) in [
        (DVec3::X, DVec3::Z),
        (DVec3::Y, -DVec3::X),
        (DVec3::Z, -DVec3::Y),
        (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-2.0, -3.0, 1.0)),
    ] {
        assert_eq!(OPTICAL_FROM_SENSOR.transform_point(in_sensor), in_optical);
    }
}

#[test]
fn seven_scenes_are_read() {
    let folder = Folder::seven_scenes();
    let dataset = folder.open();
    assert_eq!((dataset.format(), dataset.len()), ("7-Scenes", Some(2)));
    assert_eq!(dataset.notes(), [""; 0]);
    assert_eq!(dataset.sensors()[0].min_range_m, Some(0.1));
    let camera = Pinhole {
        width: 4,
        height: 3,
        fx: 4.0,
        fy: 5.0,
        cx: 1.5,
        cy: 1.0,
    };
    assert_eq!(dataset.sensors()[0].camera, Some(camera));
    let scan = dataset.read(1).unwrap();
    assert_eq!((scan.name.as_str(), scan.time_ns), ("frame-000005.depth.png", None));
    assert_eq!(scan.camera, Some(camera));
    assert_eq!((scan.dropped.no_return, scan.dropped.total()), (4, 4));
    let seen = [
        (0.0, 0.0, 1.0),
        (3.0, 0.0, 2.0),
        (0.0, 1.0, 0.001),
        (1.0, 1.0, 65.534),
        (0.0, 2.0, 1.5),
        (1.0, 2.0, 1.5),
        (2.0, 2.0, 1.5),
        (3.0, 2.0, 1.5),
    ];
    assert_eq!(scan.points.len(), seen.len());
    for (point, (u, v, depth)) in scan.points.iter().zip(seen) {
        let in_world = scan.pose.unwrap().transform_point(point.as_dvec3());
        let expected = DVec3::new(1.0, 2.0, 3.0) + optical(u, v, depth);
        assert!(in_world.distance(expected) < 1e-5, "{in_world} {expected}");
    }
}

#[test]
fn the_camera_of_7_scenes_is_assumed_only_for_images_of_its_size() {
    let folder = Folder::seven_scenes();
    folder.remove("camera-intrinsics.txt");
    assert_eq!(
        folder.refused(),
        "DIR: no camera-intrinsics.txt or camera.toml, and frame-000000.depth.png is 4 x 3 pixels, not the usual 640 x 480"
    );
    let image = depths((640, 480), &vec![1000; 640 * 480]);
    folder
        .put("frame-000000.depth.png", &image)
        .put("frame-000005.depth.png", &image);
    let dataset = folder.open();
    let camera = dataset.sensors()[0].camera.unwrap();
    assert_eq!(
        (camera.fx, camera.fy, camera.cx, camera.cy),
        (585.0, 585.0, 320.0, 240.0)
    );
    assert_eq!(
        dataset.notes(),
        ["no camera-intrinsics.txt or camera.toml: the camera is taken to be that of 7-Scenes"]
    );
}

#[test]
fn the_camera_may_be_told_in_the_folder_above() {
    let folder = Folder::seven_scenes();
    let sequence = folder.path().join("seq-01");
    fs::create_dir(&sequence).unwrap();
    for name in ["frame-000000.depth.png", "frame-000000.pose.txt"] {
        fs::rename(folder.path().join(name), sequence.join(name)).unwrap();
    }
    assert_eq!(open(&sequence).unwrap().sensors()[0].camera.map(|c| c.fx), Some(4.0));
    folder.put("camera.toml", CAMERA.replace("fx = 4", "fx = 4.5"));
    assert_eq!(open(&sequence).unwrap().sensors()[0].camera.map(|c| c.fx), Some(4.5));
}

#[test]
fn tum_is_read_with_poses_at_the_times_of_the_images() {
    let folder = Folder::tum();
    let dataset = folder.open();
    assert_eq!((dataset.format(), dataset.len()), ("TUM RGB-D", Some(3)));
    assert_eq!(dataset.notes(), [""; 0]);
    for (scan, secs) in dataset.scans().iter().zip([10.0, 10.1, 10.2]) {
        assert_eq!(
            (scan.name.as_str(), scan.time_ns),
            (format!("{secs:.6}.png").as_str(), Some((secs * 1e9_f64).round() as i64))
        );
        assert!(
            scan.pose.unwrap().translation.distance(DVec3::Z * secs) < 1e-9,
            "{scan:?}"
        );
    }
    let scan = dataset.read(2).unwrap();
    assert_eq!((scan.points.len(), scan.dropped.total()), (12, 0));
    let in_world = scan.pose.unwrap().transform_point(scan.points[11].as_dvec3());
    assert!(
        in_world.distance(DVec3::Z * 10.2 + optical(3.0, 2.0, 1.0)) < 1e-6,
        "{in_world}"
    );

    // The names tell the times as well.
    folder.remove("depth.txt");
    let by_names: Vec<_> = folder.open().scans().iter().map(|s| s.time_ns).collect();
    assert_eq!(
        by_names,
        [Some(10_000_000_000), Some(10_100_000_000), Some(10_200_000_000)]
    );
}

#[test]
fn the_kinects_of_tum_are_known_by_the_folders_name() {
    let parent = Folder::new();
    for (name, fx, notes) in [
        ("rgbd_dataset_freiburg1_xyz", 517.3, 0),
        ("fr2_desk", 520.9, 0),
        ("rgbd_dataset_freiburg3_long_office_household", 535.4, 0),
        ("office", 525.0, 1),
    ] {
        let image = depths((640, 480), &vec![5000; 640 * 480]);
        parent.put(&format!("{name}/depth/10.0.png"), image);
        parent.put(&format!("{name}/groundtruth.txt"), "10.0 0 0 0 0 0 0 1");
        let dataset = open(parent.path().join(name)).unwrap();
        assert_eq!(dataset.sensors()[0].camera.map(|c| c.fx), Some(fx), "{name}");
        assert_eq!(dataset.notes().len(), notes, "{name}: {:?}", dataset.notes());
        assert!(
            dataset
                .notes()
                .iter()
                .all(|n| n.contains("a Kinect as ROS assumes it (fx 525,"))
        );
    }
}

#[test]
fn frames_without_pose_are_left_out_and_counted() {
    let folder = Folder::tum();
    folder.put("groundtruth.txt", "10.05 0 0 0 0 0 0 1\n10.15 0 0 0 0 0 0 1\n");
    let dataset = folder.open();
    assert_eq!(
        dataset.scans().iter().map(|s| s.time_ns).collect::<Vec<_>>(),
        [Some(10_100_000_000)]
    );
    assert_eq!(
        dataset.notes(),
        [
            "2 of 3 frames are left out: no pose for 10.000000.png at 10.000000 s: the poses run from 10.050000 to 10.150000 s"
        ]
    );
    assert_eq!(dataset.read(0).unwrap().name, "10.100000.png");

    let folder = Folder::seven_scenes();
    let lost = IDENTITY.replace("1 0 0 0\n0 1", "nan 0 0 0\n0 -inf");
    folder.put("frame-000000.pose.txt", &lost);
    let dataset = folder.open();
    assert_eq!(
        (dataset.len(), dataset.read(0).unwrap().name.as_str()),
        (Some(1), "frame-000005.depth.png")
    );
    assert_eq!(
        dataset.notes(),
        [
            "1 of 2 frames are left out: no pose for frame-000000.depth.png: its matrix holds numbers that are not finite, so \
          the camera's tracking was lost"
        ]
    );
    folder.put("frame-000005.pose.txt", lost);
    assert!(
        folder
            .refused()
            .starts_with("DIR: no pose for frame-000000.depth.png: its matrix")
    );
}

#[test]
fn frames_without_any_poses_are_read_all_the_same() {
    let (tum, scenes) = (Folder::tum(), Folder::seven_scenes());
    tum.remove("groundtruth.txt");
    scenes.remove("frame-000000.pose.txt").remove("frame-000005.pose.txt");
    for (folder, frames, timed) in [(&tum, 3, true), (&scenes, 2, false)] {
        let log = folder.open();
        assert_eq!(log.notes(), ["there are no poses: where the camera was is not known"]);
        assert_eq!(log.len(), Some(frames));
        assert!(
            log.scans()
                .iter()
                .all(|scan| scan.pose.is_none() && scan.time_ns.is_some() == timed)
        );
        assert!(log.read(0).unwrap().pose.is_none() && !log.read(0).unwrap().points.is_empty());
    }
}

#[test]
fn poses_can_be_given() {
    let folder = Folder::seven_scenes();
    let rows = "1 0 0 7 0 1 0 0 0 0 1 0\n1 0 0 8 0 1 0 0 0 0 1 0\n";
    folder.put("other.txt", rows).remove("frame-000000.pose.txt");
    let options = OpenOptions {
        poses: Some(folder.path().join("other.txt")),
        ..Default::default()
    };
    let dataset = open_with(folder.path(), &options).unwrap();
    let x: Vec<_> = dataset.scans().iter().map(|s| s.pose.unwrap().translation.x).collect();
    assert_eq!(x, [7.0, 8.0]);
    // They are the camera's: its z axis is ours.
    assert!((dataset.scans()[0].pose.unwrap().rotation * DVec3::X).distance(DVec3::Z) < 1e-12);
}

#[test]
fn masks_leave_pixels_out() {
    let folder = Folder::tum();
    let count = |index: usize| {
        let scan = folder.read(index);
        assert_eq!(scan.points.len() as u64 + scan.dropped.total(), 12);
        (scan.points.len(), scan.dropped.masked)
    };
    // One bit a pixel: 4 pixels are half a byte.
    folder.put(
        "mask.png",
        mask((4, 3), BitDepth::One, &[0b1110_0000, 0b1111_0000, 0b0001_0000]),
    );
    assert_eq!((count(0), count(2)), ((8, 4), (8, 4)));
    let in_last_row = folder.read(0).points[7];
    assert_eq!(folder.open().sensors()[0].camera.unwrap().pixel(in_last_row), Some(11));
    let column: Vec<u8> = (0..12).map(|i| if i % 4 == 0 { 0 } else { 1 + i }).collect();
    folder.put("mask/10.000000.png", mask((4, 3), BitDepth::Eight, &column));
    assert_eq!((count(0), count(2)), ((6, 6), (8, 4)));
    assert_eq!(folder.open().notes(), ["only 1 of 3 frames have a mask of their own"]);
    folder.put("depth/10.200000.mask.png", mask((4, 3), BitDepth::Eight, &column));
    folder.remove("mask.png");
    assert_eq!((count(1), count(2)), ((12, 0), (9, 3)));
    // Nor is a mask a depth image.
    folder.remove("depth.txt");
    assert_eq!(folder.open().len(), Some(3));
}

#[test]
fn a_masked_pixel_counts_once() {
    let folder = Folder::seven_scenes();
    folder.put(
        "frame-000000.mask.png",
        mask((4, 3), BitDepth::Eight, &[0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1]),
    );
    let scan = folder.read(0);
    assert_eq!(
        (scan.points.len(), scan.dropped.masked, scan.dropped.no_return),
        (6, 4, 2)
    );
    assert_eq!(folder.read(1).points.len(), 8);
}

#[test]
fn a_cameras_file_goes_before_what_the_layout_says() {
    let folder = Folder::seven_scenes();
    folder.put(
        "camera.toml",
        format!("{CAMERA}depth_scale = 0.01").replace("fx = 4", "fx = 8"),
    );
    let scan = folder.read(0);
    assert_eq!(scan.points[0], Vec3::new(10.0, 10.0 * 1.5 / 8.0, 2.0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn depth_images_become_scans_and_depth_images_again(
        (width, height) in (2..20u32, 2..20u32),
        f in 5.0..50f32,
        off in -0.15..0.15f32,
        seed in any::<u64>(),
        scale in prop::sample::select(vec![1e-3f32, 2e-4, 0.25]),
        with_mask in any::<bool>(),
        shift in prop::array::uniform3(-1e6..1e6f64),
        turn in prop::array::uniform3(-3.0..3.0f64),
    ) {
        let pixels = (width * height) as usize;
        // Splitmix: any values, and those that are none.
        let random = |i: usize| (seed ^ (i as u64)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40;
        let units: Vec<u16> = (0..pixels)
            .map(|i| match random(i) % 7 { 0 => 0, 1 => u16::MAX, _ => random(i + 1) as u16 })
            .collect();
        let shown: Vec<bool> = (0..pixels).map(|i| !with_mask || i == 0 || random(i + 7) % 3 > 0).collect();
        let (cx, cy) = ((0.5 + off) * width as f32, (0.5 - off) * height as f32);
        let folder = Folder::new();
        folder.put("camera.toml", format!(
            "width = {width}\nheight = {height}\nfx = {f}\nfy = {f}\ncx = {cx}\ncy = {cy}\ndepth_scale = {scale}\n"
        ));
        folder.put("depth/0.png", depths((width, height), &units));
        let rotation = DQuat::from_scaled_axis(turn.into());
        let world_from_optical = Pose { rotation, translation: shift.into() };
        let row: Vec<_> = world_from_optical.to_row_major_3x4().map(|v| v.to_string()).into();
        folder.put("poses.txt", row.join(" "));
        if with_mask {
            let bytes: Vec<u8> = shown.iter().map(|&s| 255 * u8::from(s)).collect();
            folder.put("mask.png", mask((width, height), BitDepth::Eight, &bytes));
        }

        let scan = folder.read(0);
        let expected: Vec<f32> = units.iter().zip(&shown)
            .map(|(&units, &shown)| if shown && units != u16::MAX { f32::from(units) * scale } else { 0.0 })
            .collect();
        let mut image = DepthImage::default();
        image.render(&scan.camera.unwrap(), &scan.points, |p| p);
        prop_assert_eq!(&image.depths_m, &expected);
        prop_assert_eq!((image.hidden, image.outside), (0, 0));
        let measured = expected.iter().filter(|&&d| d > 0.0).count();
        prop_assert_eq!(scan.points.len(), measured);
        prop_assert_eq!(scan.dropped.masked, shown.iter().filter(|&&s| !s).count() as u64);
        prop_assert_eq!(scan.dropped.total() as usize, pixels - measured);
        let forward = scan.pose.unwrap().rotation * DVec3::X;
        prop_assert!(forward.distance(rotation * DVec3::Z) < 1e-9);
        prop_assert!(scan.pose.unwrap().translation.distance(shift.into()) < 1e-9);
    }
}

/// The real frames, or a line that says they are not there.
fn real() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/7scenes");
    if !path.is_dir() {
        println!("skipped: the frames of 7-Scenes are not at {}", path.display());
        return None;
    }
    Some(path)
}

/// By how much the depths that one frame measured differ from those that another one measured of the same places: the
/// median, metres, after the first camera was moved by `shift`.
fn median_difference_m(a: &Scan, b: &Scan, shift: DVec3) -> f32 {
    let camera = b.camera.unwrap();
    let mut image = DepthImage::default();
    image.render(&camera, &b.points, |p| p);
    let b_from_a = b.pose.unwrap().inverse()
        * Pose {
            translation: a.pose.unwrap().translation + shift,
            ..a.pose.unwrap()
        };
    let seen = a.points.iter().step_by(7).filter_map(|point| {
        let point = b_from_a.transform_point(point.as_dvec3()).as_vec3();
        let depth = image.depths_m[camera.pixel(point)?];
        (depth > 0.0).then_some((depth - point.x).abs())
    });
    let mut differences: Vec<f32> = seen.collect();
    assert!(differences.len() > 10_000, "the frames see the same places");
    differences.sort_by(f32::total_cmp);
    differences[differences.len() / 2]
}

#[test]
fn the_real_frames_agree_with_each_other() {
    let Some(path) = real() else { return };
    let dataset = open(path).unwrap();
    assert_eq!((dataset.format(), dataset.len()), ("7-Scenes", Some(100)));
    assert_eq!(dataset.notes(), [""; 0]);
    assert!(dataset.scans().is_sorted_by(|a, b| a.name < b.name));
    for (i, j) in [(0, 10), (45, 50), (99, 90)] {
        let [a, b] = [i, j].map(|k| dataset.read(k).unwrap());
        assert_eq!(a.points.len() as u64 + a.dropped.no_return, 640 * 480);
        let median = median_difference_m(&a, &b, DVec3::ZERO);
        // The comparison fails where it should.
        let disturbed = median_difference_m(&a, &b, DVec3::new(0.0, 0.0, 0.1));
        println!(
            "frames {i} and {j}: median difference {median:.4} m, with one camera moved by 0.1 m {disturbed:.4} m"
        );
        assert!(median < 0.02 && disturbed > 0.05, "{i} {j}: {median} {disturbed}");
    }
}
