//! `tsdfuse render` and `tsdfuse fuse --preview`: pictures of maps.

use std::fs;

use crate::run::{Folder, names, tsdfuse};

/// Width, height, bits and colour type of a PNG.
fn header(bytes: &[u8]) -> (u32, u32, u8, u8) {
    assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"));
    let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (number(16), number(20), bytes[24], bytes[25])
}

fn map(folder: &Folder, scene: &str, more: &[&str]) -> String {
    let set = folder.simulate(scene, scene, "vlp16", 4, more);
    let map = folder.text(&format!("{scene}.tsdf"));
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    map
}

#[test]
fn a_map_and_a_name_are_enough() {
    let folder = Folder::new();
    let map = map(&folder, "box", &["--offset", "691000,5335000,520"]);
    let [view, again] = ["view.png", "again.png"].map(|name| folder.text(name));
    let done = tsdfuse(&["render", &map, "-o", &view, "--json"]).succeeded().json();
    assert_eq!(header(&fs::read(&view).unwrap()), (1280, 720, 8, 2));
    let share = done["views"][0]["surface_pixels"].as_u64().unwrap() as f64 / (1280.0 * 720.0);
    assert!(share > 0.02, "{share}");
    assert_eq!(done["views"][0]["files"][0], view.as_str());
    tsdfuse(&["render", &map, "-o", &again, "--overview"]).succeeded();
    assert!(fs::read(view).unwrap() == fs::read(again).unwrap());
}

#[test]
fn a_preview_is_the_overview_of_what_was_fused() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let [map, preview, view] = ["box.tsdf", "preview.png", "view.png"].map(|name| folder.text(name));
    let report = tsdfuse(&["fuse", &set, "--save-map", &map, "--preview", &preview, "--json"])
        .succeeded()
        .json();
    tsdfuse(&["render", &map, "-o", &view]).succeeded();
    assert!(fs::read(&view).unwrap() == fs::read(&preview).unwrap());
    assert_eq!(report["preview"]["files"][0], preview.as_str());
    // It is a result by itself.
    tsdfuse(&["fuse", &set, "--preview", &view]).succeeded();
    let line = tsdfuse(&["fuse", &set, "--preview", &folder.text("view.jpg")]).failed(2);
    assert!(line.contains("view.jpg: a picture is written as .png"), "{line}");
    let line = tsdfuse(&["fuse", &set, "--preview", &map, "--save-map", &map]).failed(2);
    assert!(line.contains("box.tsdf: a picture is written as .png"), "{line}");
}

#[test]
fn kinds_and_views_have_names_and_formats_of_their_own() {
    let folder = Folder::new();
    let map = map(&folder, "sphere", &[]);
    let out = folder.text("v.png");
    let render = ["render", &map, "-o", &out, "--size", "64x48", "--json"];
    let all = [
        &render[..],
        &["--image", "weight,depth", "--image", "normal,shaded", "--views", "2"],
    ]
    .concat();
    let done = tsdfuse(&all).succeeded().json();
    assert_eq!(done["views"].as_array().unwrap().len(), 2);
    for (kind, bits, color) in [("depth", 16, 0), ("normal", 8, 2), ("shaded", 8, 2), ("weight", 8, 2)] {
        for view in ["00", "01"] {
            let bytes = fs::read(folder.path(&format!("v-{view}-{kind}.png"))).unwrap();
            assert_eq!(header(&bytes), (64, 48, bits, color), "{kind}");
        }
    }
    let pictures = names(&folder.path(""))
        .into_iter()
        .filter(|name| name.ends_with(".png"));
    assert_eq!(pictures.count(), 8);
}

#[test]
fn poses_come_as_numbers_as_places_and_as_files() {
    let folder = Folder::new();
    let map = map(&folder, "box", &[]);
    let [out, file] = ["v.png", "poses.txt"].map(|name| folder.text(name));
    let render = |more: &[&str]| {
        let all = [
            &[
                "render", &map, "-o", &out, "--size", "80x60", "--image", "depth", "--json",
            ],
            more,
        ]
        .concat();
        let done = tsdfuse(&all).succeeded().json();
        assert!(done["views"][0]["surface_pixels"].as_u64().unwrap() > 100, "{done}");
        fs::read(&out).unwrap()
    };
    let there = render(&["--pose", "-6,0,0.3"]);
    assert!(there == render(&["--from", "-6,0,0.3", "--to", "0,0,0.3"]));
    assert!(there == render(&["--pose", "-6,0,0.3,0,0,0", "--max-range", "100"]));
    assert!(there != render(&["--pose", "-6,0,0.3,2"]));
    for (text, more) in [
        ("1 0 0 -6\n0 1 0 0\n0 0 1 0.3\n0 0 0 1\n", &[][..]),
        ("1 0 0 -6 0 1 0 0 0 0 1 0.3\n", &[]),
        ("7.5 -6 0 0.3 0 0 0 1\n", &[]),
        ("0 0 1 -6\n-1 0 0 0\n0 -1 0 0.3\n", &["--optical"]),
    ] {
        fs::write(&file, text).unwrap();
        assert!(there == render(&[&["--pose", &file], more].concat()), "{text}");
        assert!(there == render(&[&["--poses", &file], more].concat()), "{text}");
    }
    fs::write(&file, "1 0 0 -6 0 1 0 0 0 0 1 0.3\n".repeat(3)).unwrap();
    let three = [
        "render", &map, "-o", &out, "--size", "80x60", "--poses", &file, "--image", "depth",
    ];
    tsdfuse(&three).succeeded();
    assert!(there == fs::read(folder.path("v-02.png")).unwrap());
    let line = tsdfuse(&["render", &map, "-o", &out, "--pose", &file]).failed(2);
    assert!(line.contains("holds 3 poses; --poses renders them all"), "{line}");
    // A LiDAR has its own size; from inside the box, whose surface was seen from outside, there is nothing.
    let lidar = [
        "render", &map, "-o", &out, "--sensor", "vlp16", "--pose", "-6,0,0.3", "--json",
    ];
    let done = tsdfuse(&lidar).succeeded().json();
    assert!(done["views"][0]["surface_pixels"].as_u64().unwrap() > 100);
    assert_eq!(header(&fs::read(&out).unwrap()), (1800, 16, 8, 2));
    let run = tsdfuse(&["render", &map, "-o", &out, "--pose", "50,0,0"]).succeeded();
    assert!(
        run.stderr.contains("tsdfuse: note: no surface is visible from there"),
        "{}",
        run.stderr
    );
}

#[test]
fn what_cannot_be_rendered_is_said_in_one_line() {
    let folder = Folder::new();
    let map = map(&folder, "box", &[]);
    let out = folder.text("v.png");
    let told = |more: &[&str], code: i32| {
        let run = tsdfuse(&[&["render", &map, "-o", &out], more].concat());
        assert_eq!(
            (run.code, run.stderr.lines().count()),
            (code, 1),
            "{more:?}: {}",
            run.stderr
        );
        run.stderr
    };
    for (more, code, words) in [
        (
            &["--pose", "1,2"][..],
            2,
            "--pose 1,2: neither X,Y,Z[,YAW[,PITCH[,ROLL]]] in metres and degrees nor a file",
        ),
        (&["--pose", "1,2,nan"], 2, "--pose 1,2,nan: neither"),
        (&["--pose", "no.txt"], 2, "--pose no.txt: neither"),
        (&["--poses", "no.txt"], 1, "no.txt: No such file"),
        (&["--from", "1,2,3"], 2, "--to <X,Y,Z>"),
        (
            &["--from", "1,2,3", "--to", "1,2,3"],
            2,
            "--from and --to are the same place",
        ),
        (&["--pose", "0,0,1e12"], 1, "outside of the map's grid"),
        (&["--views", "4", "--overview"], 2, "cannot be used with"),
        (&["--sensor", "vlp16"], 2, "--pose"),
        (&["--fov", "180"], 2, "--fov must be from 1 to 170 degrees, not 180"),
        (&["--size", "640"], 2, "as in 640x480"),
        (&["--image", "colour"], 2, "shaded, normal, depth, weight"),
        (&["--min-weight=-1"], 2, "min_weight must be 0 or more, not -1"),
        (&["--max-range", "0"], 2, "max_range_m must be a positive"),
        (&["--min-weight", "1000"], 1, "the map has no surface: "),
    ] {
        let line = told(more, code);
        assert!(line.contains(words), "{more:?}: {line}");
    }
    let line = tsdfuse(&["render", &map, "-o", &folder.text("v.jpg")]).failed(2);
    assert!(line.contains("v.jpg: a picture is written as .png"), "{line}");
    let line = tsdfuse(&["render", &map, "-o", &folder.text("no/v.png")]).failed(1);
    assert!(line.contains("no/v.png: no such folder"), "{line}");
    assert_eq!(names(&folder.path("")), ["box", "box.tsdf"]);
}

#[test]
fn a_flight_goes_along_the_path() {
    let folder = Folder::new();
    let map = map(&folder, "street", &[]);
    let out = folder.text("flight.png");
    let small = ["--size", "64x36", "--along-path"];
    tsdfuse(&[&["render", &map, "-o", &out][..], &small].concat()).succeeded();
    let frames = names(&folder.path(""))
        .into_iter()
        .filter(|name| name.starts_with("flight-"));
    assert_eq!(frames.count(), 100); // four seconds
    let movie = folder.text("flight.mp4");
    let line = tsdfuse(&["render", &map, "-o", &movie]).failed(2);
    assert!(line.contains("a movie needs several views"), "{line}");
    let run = tsdfuse(&[&["render", &map, "-o", &movie][..], &small].concat());
    match run.code {
        0 => assert!(fs::read(&movie).unwrap()[4..].starts_with(b"ftyp")),
        code => assert!(run.failed(code).contains("ffmpeg, which is not installed")),
    }
}
