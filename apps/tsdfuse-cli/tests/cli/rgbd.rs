//! Depth images: they fuse with nothing but a path, and what is wrong with them is told.

use std::fs;
use std::path::Path;

use crate::ply;
use crate::run::{Folder, tsdfuse};

/// A grey PNG image of 16 bits.
fn depth_image(width: u32, height: u32, units: u16) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let data = units.to_be_bytes().repeat((width * height) as usize);
    encoder.write_header().unwrap().write_image_data(&data).unwrap();
    bytes
}

/// Three frames of a wall 2 m ahead, in the layout of 7-Scenes; in the third the wall is 6 m away.
fn wall(folder: &Folder) -> String {
    let set = folder.path("wall");
    fs::create_dir(&set).unwrap();
    for (frame, units) in [2000, 2000, 6000].into_iter().enumerate() {
        let put = |ending: &str, content: &[u8]| {
            fs::write(set.join(format!("frame-00000{frame}.{ending}")), content).unwrap();
        };
        put("depth.png", &depth_image(160, 120, units));
        put("pose.txt", b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    }
    fs::write(set.join("camera-intrinsics.txt"), "150 0 80\n0 150 60\n0 0 1\n").unwrap();
    folder.text("wall")
}

#[test]
fn depth_images_fuse_with_only_a_path() {
    let folder = Folder::new();
    let (set, mesh) = (wall(&folder), folder.text("wall.ply"));
    let report = tsdfuse(&["fuse", &set, "-o", &mesh, "--json"]).succeeded().json();
    assert_eq!(report["dataset"]["format"], "7-Scenes");
    assert_eq!(report["dataset"]["camera"]["fx"], 150.0);
    assert!(report["dataset"]["sensor"].is_null());
    assert_eq!(
        (
            &report["config"]["map"]["voxel_size_m"],
            &report["config"]["map"]["truncation_m"]
        ),
        (&0.02.into(), &0.08.into())
    );
    assert_eq!(report["config"]["method"], "depth");
    let range = &report["config"]["range"];
    assert_eq!(range["max_range_m"], 5.0);
    assert!((range["min_range_m"].as_f64().unwrap() - 0.1).abs() < 1e-6);
    assert_eq!(report["totals"]["dropped"]["too_far"], 160 * 120);
    let (vertices, triangles) = ply::read(mesh.as_ref());
    assert!(triangles > 5000, "{triangles}");
    // The world is that of the poses: the optical frame's, with z ahead.
    let off = vertices.iter().map(|v| (v.z - 2.0).abs()).fold(0.0, f64::max);
    assert!(off < 0.01, "{off}");

    let settings = [
        "--voxel-size",
        "0.05",
        "--max-range",
        "8",
        "--min-range",
        "0.3",
        "--method",
        "raycast",
    ];
    let report = tsdfuse(&[&["fuse", &set, "-o", &mesh, "--json"], &settings[..]].concat())
        .succeeded()
        .json();
    assert_eq!(
        (
            &report["config"]["map"]["voxel_size_m"],
            &report["config"]["map"]["truncation_m"]
        ),
        (&0.05.into(), &0.2.into())
    );
    assert_eq!(
        (&report["config"]["method"], &report["config"]["range"]["max_range_m"]),
        (&"raycast".into(), &8.0.into())
    );
    assert_eq!(report["totals"]["dropped"]["too_far"], 0);
}

#[test]
fn depth_images_are_described() {
    let folder = Folder::new();
    let set = wall(&folder);
    let table = String::from_utf8(tsdfuse(&["info", &set]).succeeded().stdout).unwrap();
    for line in [
        "(7-Scenes)",
        "camera      160 x 120 pixels, 56.1° x 43.6°, fx 150 fy 150 cx 80 cy 60",
        "scans       3, without times",
        "points      19,200 a scan",
        "ranges      2.00 to 7.2",
    ] {
        assert!(table.contains(line), "{line}: {table}");
    }
    assert!(!table.contains("sensor") && !table.contains("rings"), "{table}");
    let info = tsdfuse(&["info", &set, "--json"]).succeeded().json();
    assert_eq!(info["camera"]["width"], 160);
    assert_eq!(info["sample"]["range_m"][0], 2.0);
}

#[test]
fn what_is_wrong_with_depth_images_is_told_in_one_line() {
    let told = |spoil: &dyn Fn(&Path)| {
        let folder = Folder::new();
        let set = wall(&folder);
        spoil(set.as_ref());
        let mesh = folder.text("wall.ply");
        let line = tsdfuse(&["fuse", &set, "-o", &mesh]).failed(1);
        assert!(!Path::new(&mesh).exists());
        line.replace(&set, "SET")
    };
    let put = |name: &'static str, content: Vec<u8>| move |set: &Path| fs::write(set.join(name), &content).unwrap();
    let whole = depth_image(160, 120, 2000);
    for (line, expected) in [
        (
            told(&put("frame-000001.depth.png", whole[..whole.len() - 20].to_vec())),
            "SET/frame-000001.depth.png: is truncated",
        ),
        (
            told(&put("frame-000001.depth.png", depth_image(80, 60, 2000))),
            "SET/frame-000001.depth.png: is 80 x 60 pixels where frame-000000.depth.png has 160 x 120",
        ),
        (
            told(&put("frame-000001.pose.txt", b"1 0 0 0 0 1 0 0 0 0 1 0".to_vec())),
            "SET/frame-000001.pose.txt: line 1: a pose has 4 lines of 4 numbers",
        ),
        (
            told(&|set| fs::remove_file(set.join("frame-000002.pose.txt")).unwrap()),
            "SET/frame-000002.depth.png: has no pose: there is no frame-000002.pose.txt beside it",
        ),
        (
            told(&|set| fs::remove_file(set.join("camera-intrinsics.txt")).unwrap()),
            "no camera-intrinsics.txt or camera.toml, and frame-000000.depth.png is 160 x 120 pixels, not the usual 640 x 480",
        ),
        (
            told(&put("camera-intrinsics.txt", b"585 0 320\n0 585 240\n0 0 1".to_vec())),
            "SET/camera-intrinsics.txt: the principal point (320, 240) is far from the middle of an image of 160 x 120 pixels",
        ),
        (
            told(&put("mask.png", depth_image(160, 120, 0))),
            "SET/mask.png: is grey with 16 bits; a mask is grey with 1 or 8 bits",
        ),
    ] {
        assert!(line.contains(expected), "{line}");
    }
}

#[test]
fn a_bad_frame_can_be_skipped() {
    let folder = Folder::new();
    let (set, mesh) = (wall(&folder), folder.text("wall.ply"));
    fs::write(folder.path("wall/frame-000001.depth.png"), "no image").unwrap();
    let run = tsdfuse(&["fuse", &set, "-o", &mesh, "--skip-bad", "--json"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    assert_eq!(run.json()["skipped_scans"][0]["name"], "frame-000001.depth.png");
    assert!(
        run.stderr.contains("frame-000001.depth.png: is no PNG image"),
        "{}",
        run.stderr
    );
}

#[test]
fn colour_images_beside_depth_images_give_the_mesh_its_colours() {
    let folder = Folder::new();
    let set = wall(&folder);
    let green = tsdfuse::render::Image {
        width: 160,
        height: 120,
        pixels: tsdfuse::render::Pixels::Rgb(vec![[20, 200, 40]; 160 * 120]),
    };
    for number in 0..3 {
        let path = Path::new(&set).join(format!("frame-{number:06}.color.png"));
        tsdfuse_io::png::write(path, &green).unwrap();
    }
    let (mesh, map) = (folder.text("wall.ply"), folder.text("wall.tsdf"));
    let report = tsdfuse(&["fuse", &set, "-o", &mesh, "--color", "--save-map", &map, "--json"])
        .succeeded()
        .json();
    let color = &report["mesh"]["color"];
    assert_eq!(color["images"], 3);
    let (seen, all) = (
        color["vertices"].as_f64().unwrap(),
        report["mesh"]["vertices"].as_f64().unwrap(),
    );
    assert!(seen > 0.9 * all, "{seen} of {all}");
    // The same colours where the map is not all in memory.
    let (paged, again) = (folder.text("paged.ply"), folder.text("paged.tsdf"));
    tsdfuse(&[
        "fuse",
        &set,
        "-o",
        &paged,
        "--color",
        "--save-map",
        &again,
        "--memory",
        "1M",
    ])
    .succeeded();
    for layer in ["red", "green", "blue"] {
        let of = |map: &str| fs::read(folder.path(&format!("{map}.{layer}.tsdf"))).unwrap();
        assert!(of("wall") == of("paged"), "{layer}");
    }
    // They are saved beside the map.
    let picture = folder.text("view.png");
    tsdfuse(&[
        "render",
        &map,
        "-o",
        &picture,
        "--image",
        "color",
        "--pose",
        "0,0,0",
        "--optical",
        "--size",
        "80x60",
    ])
    .succeeded();
    let shown = tsdfuse_io::photo::decode(&picture, &fs::read(&picture).unwrap()).unwrap();
    let greens = shown
        .pixels
        .iter()
        .filter(|p| p[1] / 2 > p[0] && p[1] / 2 > p[2])
        .count();
    assert!(greens > 100, "{greens}");
}
