//! What is wrong is told in one line that names the file.

use super::super::image::{self, ImageSize};
use super::*;

const DEPTH: &str = "frame-000005.depth.png";

/// What is said of a folder of 7-Scenes with another file of that name.
fn with(name: &str, content: impl AsRef<[u8]>) -> String {
    let folder = Folder::seven_scenes();
    folder.put(name, content);
    folder.refused()
}

#[test]
fn images_that_are_no_depth_images() {
    let told = |color, bits, data: &[u8]| with(DEPTH, png((4, 3), color, bits, data));
    for (told, is) in [
        (
            told(ColorType::Grayscale, BitDepth::Eight, &[9; 12]),
            "grey with 8 bits",
        ),
        (told(ColorType::Rgb, BitDepth::Eight, &[9; 36]), "RGB with 8 bits"),
        (told(ColorType::Rgb, BitDepth::Sixteen, &[9; 72]), "RGB with 16 bits"),
        (
            told(ColorType::Rgba, BitDepth::Eight, &[9; 48]),
            "RGB with transparency with 8 bits",
        ),
        (
            told(ColorType::GrayscaleAlpha, BitDepth::Sixteen, &[9; 48]),
            "grey with transparency with 16 bits",
        ),
        (
            told(ColorType::Indexed, BitDepth::Eight, &[0; 12]),
            "coloured by a palette with 8 bits",
        ),
    ] {
        assert_eq!(
            told,
            format!("DIR/{DEPTH}: is {is}; a depth image is grey with 16 bits")
        );
    }
    assert_eq!(with(DEPTH, ""), format!("DIR/{DEPTH}: is empty"));
    assert_eq!(
        with(DEPTH, [0xff, 0xd8, 0xff, 0xe0, 0, 16]),
        format!("DIR/{DEPTH}: is a JPEG image, not PNG")
    );
    assert_eq!(with(DEPTH, "P5 4 3 65535"), format!("DIR/{DEPTH}: is no PNG image"));
}

#[test]
fn images_of_another_size() {
    let small = depths((2, 3), &[1; 6]);
    assert_eq!(
        with(DEPTH, &small),
        format!("DIR/{DEPTH}: is 2 x 3 pixels where frame-000000.depth.png has 4 x 3")
    );
    let large = CAMERA.replace("width = 4", "width = 5");
    assert_eq!(
        with("camera.toml", large),
        "DIR/frame-000000.depth.png: is 4 x 3 pixels where camera.toml has 5 x 3"
    );
}

#[test]
fn truncated_and_damaged_images() {
    let units: Vec<u16> = (0..12).map(|i| 1000 + 77 * i).collect();
    let whole = depths((4, 3), &units);
    for length in 1..whole.len() {
        for name in [DEPTH, "frame-000000.depth.png"] {
            let told = with(name, &whole[..length]);
            let no_png = length < 4;
            let reason = if no_png { "is no PNG image" } else { "is truncated" };
            assert_eq!(
                told,
                format!("DIR/{name}: {reason}"),
                "{length} of {} bytes",
                whole.len()
            );
        }
    }
    let mut damaged = whole.clone();
    let middle = whole.len() / 2;
    damaged[middle] ^= 0x40;
    assert!(with(DEPTH, &damaged).starts_with(&format!("DIR/{DEPTH}: is a damaged PNG: ")));
}

/// A whole header with its checksum, and no pixels.
fn header_of(edge: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    bytes.extend([edge.to_be_bytes(), edge.to_be_bytes()].concat());
    bytes.extend([16, 0, 0, 0, 0]);
    bytes.extend(crc32fast::hash(&bytes[12..]).to_be_bytes());
    bytes
}

#[test]
fn an_image_of_more_pixels_than_a_depth_camera_has() {
    let told = with("frame-000000.depth.png", header_of(16_384));
    assert_eq!(
        told,
        "DIR/frame-000000.depth.png: is 16384 x 16384 pixels; a depth image has at most 16777216"
    );
    // Nor if camera.toml says so, too.
    let size = ImageSize {
        width: 4097,
        height: 4097,
        by: "camera.toml".to_owned(),
    };
    let told = image::depths(Path::new("a.png"), &header_of(4097), &size).unwrap_err();
    assert_eq!(
        told.to_string(),
        "a.png: is 4097 x 4097 pixels; a depth image has at most 16777216"
    );
}

#[test]
fn a_header_that_claims_a_huge_image() {
    for edge in [20_000_u32, 0x7fff_ffff, u32::MAX] {
        let bytes = header_of(edge);
        let told = with("frame-000000.depth.png", &bytes);
        assert!(told.starts_with("DIR/frame-000000.depth.png: "), "{told}");
        assert!(
            told.contains("1 x 1 to 16384 x 16384 are possible") || told.contains("damaged"),
            "{told}"
        );
        let told = with(DEPTH, &bytes);
        assert!(
            told.contains("where frame-000000.depth.png has 4 x 3") || told.contains("damaged"),
            "{told}"
        );
    }
}

#[test]
fn cameras_that_cannot_be() {
    let with_line = |from: &str, to: &str| with("camera.toml", CAMERA.replace(from, to));
    assert_eq!(
        with_line("fx = 4", "fx = -4"),
        "DIR/camera.toml: focal lengths of -4 and 5 pixels; they must be positive"
    );
    for bad in ["nan", "inf", "0"] {
        assert!(
            with_line("fy = 5", &format!("fy = {bad}")).contains("camera.toml: focal lengths of 4 and "),
            "{bad}"
        );
    }
    assert!(
        with_line("cx = 1.5", "cx = 320").contains("camera.toml: the principal point (320, 1) is far from the middle")
    );
    assert!(with_line("height = 3", "height = 100000").contains("camera.toml: an image of 4 x 100000 pixels;"));
    assert_eq!(
        with_line("fx = 4", "fx = \"four\""),
        "DIR/camera.toml: line 3: invalid type: string \"four\", expected f32"
    );
    assert!(with_line("cy = 1", "").contains("camera.toml: line 1: missing field `cy`"));
    assert!(
        with_line("cy = 1", "cy = 1\nk1 = 0.1").contains("camera.toml: line 7: unknown field `k1`, expected one of")
    );
    for bad in ["1000", "0", "-0.001", "nan"] {
        let told = with_line("cy = 1", &format!("cy = 1\ndepth_scale = {bad}"));
        assert!(
            told.contains("it is metres per unit, between 0 and 1: 0.001 for millimetres"),
            "{told}"
        );
    }

    let matrix = |text: &str| with("camera-intrinsics.txt", text);
    assert!(
        matrix("585 0 320\n0 585 240\n0 0 1").contains(
            "intrinsics.txt: the principal point (320, 240) is far from the middle of an image of 4 x 3 pixels"
        )
    );
    assert!(matrix("nan 0 1.5\n0 5 1\n0 0 1").contains("intrinsics.txt: focal lengths of NaN and 5 pixels"));
    for bad in [
        "",
        "4 0 1.5\n0 5 1",
        "4 1 1.5\n0 5 1\n0 0 1",
        "4 5 1.5 1",
        "4 0 1.5 0 5 1 0 0 1",
    ] {
        assert_eq!(
            matrix(bad),
            "DIR/camera-intrinsics.txt: is not the 3x3 matrix fx 0 cx, 0 fy cy, 0 0 1",
            "{bad}"
        );
    }
    assert!(matrix("4 0 1.5\n0 five 1\n0 0 1").contains("intrinsics.txt: line 2: \"five\" is not a number"));
}

#[test]
fn poses_that_are_none() {
    let name = "frame-000005.pose.txt";
    let folder = Folder::seven_scenes();
    folder.remove(name);
    assert_eq!(
        folder.refused(),
        format!("DIR/{DEPTH}: has no pose: there is no {name} beside it")
    );
    for (text, reason) in [
        (
            IDENTITY.replacen('1', "2", 1),
            "the pose is not rigid: its 3x3 part is 3.00e0 away from a rotation",
        ),
        (
            IDENTITY.replacen('1', "-1", 1),
            "the pose is not rigid: its 3x3 part is 2.00e0 away from a rotation",
        ),
        (
            IDENTITY.replacen("1 0 0 0", "1 0 0", 1),
            "line 1: a pose has 4 lines of 4 numbers",
        ),
        (IDENTITY.repeat(2), "line 5: a pose has 4 lines of 4 numbers"),
        (
            IDENTITY.replace("0 0 0 1", "0 0 0 2"),
            "is not a 4x4 matrix that ends in 0 0 0 1",
        ),
        (
            IDENTITY.replace("\n0 0 0 1", ""),
            "is not a 4x4 matrix that ends in 0 0 0 1",
        ),
        (IDENTITY.replace("0 1 0 0", "0 x 0 0"), "line 2: \"x\" is not a number"),
        (String::new(), "is not a 4x4 matrix that ends in 0 0 0 1"),
    ] {
        assert_eq!(with(name, &text), format!("DIR/{name}: {reason}"), "{text}");
    }
}

#[test]
fn masks_that_do_not_fit() {
    let told = |bytes: Vec<u8>| with("mask.png", bytes);
    assert_eq!(
        told(mask((4, 2), BitDepth::Eight, &[1; 8])),
        "DIR/mask.png: is 4 x 2 pixels where frame-000000.depth.png has 4 x 3"
    );
    // The bits after the end of a row are no pixels.
    for zeros in [
        mask((4, 3), BitDepth::Eight, &[0; 12]),
        mask((4, 3), BitDepth::One, &[0x0f; 3]),
    ] {
        assert_eq!(
            told(zeros),
            "DIR/mask.png: masks every pixel: it holds nothing but zeros"
        );
    }
    assert_eq!(
        told(png((4, 3), ColorType::Rgb, BitDepth::Eight, &[1; 36])),
        "DIR/mask.png: is RGB with 8 bits; a mask is grey with 1 or 8 bits"
    );
    assert_eq!(
        with("mask/frame-000005.png", mask((3, 4), BitDepth::Eight, &[1; 12])),
        "DIR/mask/frame-000005.png: is 3 x 4 pixels where frame-000000.depth.png has 4 x 3"
    );
    assert!(with("frame-000005.mask.png", "x").starts_with("DIR/frame-000005.mask.png: is no PNG image"));
}

#[test]
fn lists_and_trajectories_that_do_not_fit() {
    let tum = |name: &str, content: &str| {
        let folder = Folder::tum();
        folder.put(name, content);
        folder.refused()
    };
    for (list, reason) in [
        (
            "10 depth/10.000000.png\n10.1",
            "line 2: a time and the name of a file are wanted",
        ),
        ("ten depth/10.000000.png", "line 1: \"ten\" is not a time in seconds"),
        ("nan depth/10.000000.png", "line 1: \"nan\" is not a time in seconds"),
        (
            "10 depth/10.000000.png\n10 depth/10.100000.png",
            "line 2: the time 10 is not later than that of the image before",
        ),
        (
            "10 ../10.png",
            "line 1: ../10.png is not the name of a PNG file in this folder",
        ),
        (
            "10 /10.png",
            "line 1: /10.png is not the name of a PNG file in this folder",
        ),
        (
            "10 depth/10.jpg",
            "line 1: depth/10.jpg is not the name of a PNG file in this folder",
        ),
        ("# nothing", "lists no images"),
    ] {
        assert_eq!(tum("depth.txt", list), format!("DIR/depth.txt: {reason}"));
    }
    assert!(tum("depth.txt", "10 depth/11.png").starts_with("DIR/depth/11.png: No such file"));
    assert_eq!(
        tum("groundtruth.txt", "20 0 0 0 0 0 0 1\n20.1 0 0 0 0 0 0 1"),
        "DIR/groundtruth.txt: no pose for 10.000000.png at 10.000000 s: the poses run from 20.000000 to 20.100000 s"
    );
    assert_eq!(
        tum("groundtruth.txt", "10 0 0 0 0 0 nan 1"),
        "DIR/groundtruth.txt: line 1: the pose holds a number that is not finite"
    );
    let folder = Folder::tum();
    folder.remove("camera.toml").put("groundtruth.txt", "10 0 0 0 0 0 0 1");
    assert_eq!(
        folder.refused(),
        "DIR: no camera.toml, and 10.000000.png is 4 x 3 pixels, not the usual 640 x 480"
    );
}

#[test]
fn no_lidar_is_asked_for() {
    let folder = Folder::seven_scenes();
    let options = OpenOptions {
        sensors: vec!["vlp16".to_owned()],
        ..Default::default()
    };
    let told = open_with(folder.path(), &options).unwrap_err().to_string();
    assert!(
        told.ends_with("holds depth images: their camera is told by a camera.toml, not by the sensor \"vlp16\""),
        "{told}"
    );
}
