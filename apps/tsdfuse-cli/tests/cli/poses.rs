//! `tsdfuse poses`, and the trajectories of saved maps.

use std::fs;

use crate::run::{Folder, tsdfuse};

/// A curve of so many metres, a pose each, as a KITTI file; `scale` makes it longer, `high` lifts it.
fn curve(metres: u32, scale: f64, high: f64) -> String {
    let line = |i: u32| {
        let (x, y) = (f64::from(i), 30.0 * (0.03 * f64::from(i)).sin());
        format!("1 0 0 {} 0 1 0 {} 0 0 1 {high}\n", scale * x, scale * y)
    };
    (0..metres).map(line).collect()
}

#[test]
fn trajectories_are_compared() {
    let folder = Folder::new();
    let put = |name: &str, text: String| {
        fs::write(folder.path(name), text).unwrap();
        folder.text(name)
    };
    let truth = put("truth.txt", curve(250, 1.0, 0.0));
    let track = put("track.txt", curve(250, 1.02, 5.0));
    let plot = folder.text("both.svg");
    let picture = folder.text("both.png");
    let found = tsdfuse(&["poses", "compare", &track, &truth, "--json", "--plot", &plot]);
    let found = found.succeeded().json();
    assert_eq!((&found["poses"], &found["left_out"]), (&250.into(), &0.into()));
    let figure = |value: &serde_json::Value| value.as_f64().unwrap();
    // The way there is longer than the motion of a piece.
    let drift = figure(&found["kitti"]["translation_percent"]);
    assert!((1.7..2.0).contains(&drift), "{found}");
    assert!((figure(&found["alignment"]["translation"][2]) + 5.0).abs() < 1e-6);
    assert!(figure(&found["absolute_m"]["rmse"]) > 0.5);
    assert!(fs::read_to_string(plot).unwrap().contains("<svg"));
    tsdfuse(&["poses", "compare", &track, &truth, "--plot", &picture]).succeeded();
    assert!(fs::read(picture).unwrap().starts_with(b"\x89PNG"));
    let as_they_are = tsdfuse(&["poses", "compare", &track, &truth, "--json", "--no-align"]);
    let as_they_are = as_they_are.succeeded().json();
    assert!(as_they_are["alignment"].is_null() && figure(&as_they_are["absolute_m"]["median"]) > 5.0);
    let text = String::from_utf8(tsdfuse(&["poses", "compare", &track, &truth]).succeeded().stdout).unwrap();
    assert!(
        text.contains("against") && text.contains("100 to 200 m (KITTI)"),
        "{text}"
    );

    let short = put("short.txt", curve(7, 1.0, 0.0));
    let told = tsdfuse(&["poses", "compare", &short, &truth]).failed(1);
    assert!(
        told.contains("7 poses and 250 of the reference, and not both have times: they cannot be matched"),
        "{told}"
    );
    let told = tsdfuse(&["poses", "compare", &track, &truth, "--plot", "both.bmp"]).failed(2);
    assert!(told.contains("both.bmp: a plot is drawn as .png or .svg"), "{told}");
}

#[test]
fn poses_are_converted_and_back() {
    let folder = Folder::new();
    let [kitti, times, tum, again] = ["kitti.txt", "times.txt", "poses.tum", "again.txt"].map(|name| folder.text(name));
    fs::write(&kitti, curve(20, 1.0, 0.5)).unwrap();
    let secs = (0..20).map(|i| format!("1583836591.{i:09}\n")).collect::<String>();
    fs::write(&times, secs).unwrap();
    let told = tsdfuse(&["poses", "convert", &kitti, "-o", &tum, "--format", "tum"]).failed(2);
    assert!(told.contains("its poses have no times, which TUM needs"), "{told}");
    tsdfuse(&["poses", "convert", &kitti, "--times", &times, "-o", &tum]).succeeded();
    let text = fs::read_to_string(&tum).unwrap();
    assert!(
        text.starts_with("1583836591.000000000 0 0 0.5 0 0 0 1\n1583836591.000000001 1 "),
        "{text}"
    );
    tsdfuse(&["poses", "convert", &tum, "-o", &again, "--format", "kitti"]).succeeded();
    assert_eq!(fs::read_to_string(&again).unwrap(), fs::read_to_string(&kitti).unwrap());
    let told = tsdfuse(&["poses", "convert", &tum, "-o", &tum]).failed(2);
    assert!(!told.is_empty());
}

#[test]
fn maps_and_stores_know_where_their_scans_were() {
    let folder = Folder::new();
    let set = folder.simulate("plane", "plane", "vlp16", 5, &["--path", "vehicle"]);
    let [map, store, first, second, joined, moved] = [
        "a.tsdf",
        "a.store",
        "first.tsdf",
        "second.tsdf",
        "joined.tsdf",
        "moved.tsdf",
    ]
    .map(|name| folder.text(name));
    let fuse = |more: &[&str]| tsdfuse(&[&["fuse", &set, "--method", "raycast"], more].concat()).succeeded();
    fuse(&["--save-map", &map, "--store", &store]);
    for path in [&map, &store] {
        let info = tsdfuse(&["info", path, "--json"]).succeeded().json();
        let trajectory = &info["trajectory"];
        assert_eq!(trajectory["poses"], 5);
        assert!(
            (trajectory["distance_m"].as_f64().unwrap() - 4.0).abs() < 0.2,
            "{trajectory}"
        );
        assert!(
            (trajectory["seconds"].as_f64().unwrap() - 0.4).abs() < 1e-6,
            "{trajectory}"
        );
        let table = String::from_utf8(tsdfuse(&["info", path]).succeeded().stdout).unwrap();
        assert!(
            table.contains("trajectory  5 poses, ") && table.contains(" m in 0.4 s"),
            "{table}"
        );
        let found = tsdfuse(&["poses", "compare", path, &set, "--no-align", "--json"])
            .succeeded()
            .json();
        assert_eq!((&found["poses"], &found["absolute_m"]["max"]), (&5.into(), &0.0.into()));
    }
    fuse(&["--save-map", &first, "--scans", "0..2"]);
    fuse(&["--save-map", &second, "--scans", "2..5"]);
    tsdfuse(&["map", "merge", &first, &second, "-o", &joined]).succeeded();
    assert!(fs::read(&joined).unwrap() == fs::read(&map).unwrap());
    // A map that is moved takes its trajectory with it.
    tsdfuse(&["map", "transform", &map, "--translation", "0,0,10", "-o", &moved]).succeeded();
    let found = tsdfuse(&["poses", "compare", &moved, &set, "--no-align", "--json"])
        .succeeded()
        .json();
    let off = found["absolute_m"]["median"].as_f64().unwrap();
    assert!((off - 10.0).abs() < 1e-9, "{off}");
}

#[test]
fn rough_poses_and_a_sensor_that_is_off_are_mended_and_predict_more() {
    let folder = Folder::new();
    let set = folder.simulate("street", "street", "vlp16", 24, &["--path", "vehicle"]);
    let rough = |(i, line): (usize, &str)| {
        let shift = |k: usize| 0.06 * (((3 * i + k) as f64 * 0.754_877_666).fract() - 0.5);
        let numbers = line.split_whitespace().map(|n| n.parse::<f64>().unwrap());
        let moved = numbers
            .enumerate()
            .map(|(k, n)| if k % 4 == 3 { n + shift(k / 4) } else { n }.to_string());
        moved.collect::<Vec<_>>().join(" ") + "\n"
    };
    let poses = folder.path("street/poses.txt");
    let text = fs::read_to_string(&poses).unwrap();
    fs::write(&poses, text.lines().enumerate().map(rough).collect::<String>()).unwrap();
    let sensor = folder.path("street/sensor.toml");
    let text = fs::read_to_string(&sensor).unwrap();
    fs::write(&sensor, text + "elevation_correction_deg = 0.4\n").unwrap();

    let out = folder.text("out");
    let arguments = [
        "evaluate",
        &set,
        "--methods",
        "raycast",
        "--poses",
        "given,refine,track",
        "-o",
        &out,
    ];
    let more = ["--json", "--samples", "5000", "--hold-out", "6"];
    let results = tsdfuse(&[&arguments[..], &more].concat()).succeeded().json();
    let rows = results["methods"].as_array().unwrap();
    let names: Vec<_> = rows.iter().map(|row| row["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["raycast", "raycast (refine)", "raycast (track)"]);
    let error_m = |row: usize| rows[row]["held_out"]["error"]["mean_m"].as_f64().unwrap();
    assert!(error_m(1) < 0.9 * error_m(0), "{} {}", error_m(1), error_m(0));

    let [mesh, file] = ["street.ply", "found.toml"].map(|name| folder.text(name));
    let arguments = [
        "fuse",
        &set,
        "--method",
        "raycast",
        "--poses",
        "refine",
        "-o",
        &mesh,
        "--save-sensor",
        &file,
    ];
    let run = tsdfuse(&arguments).succeeded();
    let told = run.stderr;
    assert!(
        told.contains("the sensor is off: elevations are corrected by -0."),
        "{told}"
    );
    let info = tsdfuse(&["info", &set, "--sensor", &file, "--json"]).succeeded().json();
    let left = info["elevation_correction_deg"].as_f64().unwrap();
    assert!(left.abs() < 0.15, "{left}");
    assert_eq!(info["sensor"]["name"], "vlp16");
}
