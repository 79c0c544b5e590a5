//! Intensities and colours beside maps, labels of what moves, and recordings.

use std::fs;
use std::path::Path;

use crate::run::{Folder, command, names, tsdfuse};

/// The project's sample of PandaSet, which has intensities.
fn sample() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sample/pandaset-002");
    path.to_str().unwrap().to_owned()
}

const COARSE: [&str; 4] = ["--voxel-size", "0.2", "--truncation", "0.6"];

fn fuse(more: &[&str]) {
    tsdfuse(&[&["fuse", &sample()], &COARSE[..], more].concat()).succeeded();
}

#[test]
fn intensities_are_the_same_wherever_the_map_is_and_are_shown_everywhere() {
    let folder = Folder::new();
    let [map, paged, store] = ["map.tsdf", "paged.tsdf", "run.store"].map(|name| folder.text(name));
    fuse(&["--intensity", "--save-map", &map]);
    fuse(&["--intensity", "--save-map", &paged, "--memory", "1M"]);
    fuse(&["--intensity", "--store", &store, "--commit-every", "1"]);
    let layer = |name: &str| fs::read(folder.path(name)).unwrap();
    assert!(layer("map.intensity.tsdf") == layer("paged.intensity.tsdf"));
    assert!(folder.path("run.intensity.tsdf").is_file() && !folder.path("run.intensity-next.tsdf").exists());

    // A mesh of the saved map has them, and one of the store.
    for input in [&map, &store] {
        let glb = folder.text("mesh.glb");
        let output = if input == &store { folder.text("mesh.ply") } else { glb };
        tsdfuse(&["mesh", input, "-o", &output]).succeeded();
        let bytes = fs::read(&output).unwrap();
        let has = |text: &[u8]| bytes.windows(text.len()).take(4000).any(|window| window == text);
        assert!(has(b"COLOR_0") || has(b"property uchar red"), "{output}");
    }
    // And a picture.
    let png = folder.text("view.png");
    tsdfuse(&[
        "render",
        &map,
        "-o",
        &png,
        "--image",
        "intensity,height",
        "--size",
        "160x90",
    ])
    .succeeded();
    let written = names(&folder.path(""));
    for name in ["view-height.png", "view-intensity.png"] {
        assert!(written.iter().any(|file| file == name), "{written:?}");
    }
    let told = tsdfuse(&["render", &map, "-o", &png, "--image", "color"]).failed(2);
    assert!(told.contains("fuse --color --save-map saves it"), "{told}");

    // Merged and cropped maps take them along.
    let both = folder.text("both.tsdf");
    tsdfuse(&["map", "merge", &map, &paged, "-o", &both]).succeeded();
    tsdfuse(&[
        "map",
        "crop",
        &both,
        "--from",
        "-5,-5,-5",
        "--to",
        "5,5,5",
        "-o",
        &folder.text("part.tsdf"),
    ])
    .succeeded();
    assert!(layer("both.intensity.tsdf").len() > layer("part.intensity.tsdf").len());
}

#[cfg(feature = "tiles")]
#[test]
fn tiles_have_colours() {
    let folder = Folder::new();
    for more in [&[][..], &["--memory", "1M"]] {
        let tiles = folder.text(&format!("tiles{}/tileset.json", more.len()));
        fuse(&[&["--intensity", "-o", &tiles], more].concat());
        let path = Path::new(&tiles).parent().unwrap();
        let glbs: Vec<_> = names(path)
            .iter()
            .filter(|name| name.ends_with(".glb"))
            .map(|name| path.join(name))
            .collect();
        assert!(!glbs.is_empty());
        for glb in glbs {
            let bytes = fs::read(&glb).unwrap();
            assert!(
                bytes.windows(7).take(4000).any(|window| window == b"COLOR_0"),
                "{}",
                glb.display()
            );
        }
    }
}

#[test]
fn what_moves_is_labelled() {
    let folder = Folder::new();
    let [labels, report, map] = ["labels", "report.json", "map.tsdf"].map(|name| folder.text(name));
    let asked = ["--moving", "fuse", "--labels", &labels, "--report", &report];
    fuse(&[&asked[..], &["--save-map", &map]].concat());
    assert_eq!(
        names(Path::new(&labels)),
        ["000000.label", "000001.label", "000002.label"]
    );
    let report: serde_json::Value = serde_json::from_slice(&fs::read(report).unwrap()).unwrap();
    assert_eq!(report["config"]["moving"]["leave_out"], false);
    for (i, scan) in report["scans"].as_array().unwrap().iter().enumerate() {
        let labels = fs::read(folder.path(&format!("labels/{i:06}.label"))).unwrap();
        let of = |value: &serde_json::Value| value.as_u64().unwrap();
        let own = of(&scan["points"]) - of(&scan["dropped"]["other_sensor"]);
        assert_eq!(4 * own, labels.len() as u64);
    }
}

#[test]
fn a_recording_is_a_log_again() {
    let folder = Folder::new();
    let (mcap, ply, again) = (folder.text("run.mcap"), folder.text("a.ply"), folder.text("b.ply"));
    fuse(&["--record", &mcap, "-o", &ply]);
    let info = tsdfuse(&["info", &mcap, "--json"]).succeeded().json();
    let topics = info.to_string();
    for topic in ["/odometry", "/surface", "/map", "/tf"] {
        assert!(topics.contains(topic), "{topics}");
    }
    tsdfuse(&[&["fuse", &mcap, "-o", &again], &COARSE[..]].concat()).succeeded();
    let triangles = |path: &str| tsdfuse_io::mesh::read(path).unwrap().triangles.len() as f64;
    assert!(
        (triangles(&ply) / triangles(&again) - 1.0).abs() < 0.02,
        "{} {}",
        triangles(&ply),
        triangles(&again)
    );
}

#[test]
fn distances_and_ground_of_a_store_are_those_of_the_map() {
    let folder = Folder::new();
    let [map, store] = ["map.tsdf", "run.store"].map(|name| folder.text(name));
    fuse(&["--save-map", &map, "--store", &store, "--memory", "1M"]);
    let written = |input: &str, command: &str, name: &str| {
        let output = folder.text(name);
        tsdfuse(&["map", command, input, "-o", &output]).succeeded();
        fs::read(output).unwrap()
    };
    assert!(written(&map, "esdf", "a.npz") == written(&store, "esdf", "b.npz"));
    assert!(written(&map, "ground", "a.npz") == written(&store, "ground", "b.npz"));
    for name in ["ground.tif", "ground.yaml"] {
        assert!(!written(&map, "ground", name).is_empty());
    }
}

#[test]
fn a_picture_is_left_beside_meshes_if_the_users_settings_say_so() {
    let folder = Folder::new();
    fs::create_dir_all(folder.path("config/tsdfuse")).unwrap();
    let settings = folder.path("config/tsdfuse/settings.toml");
    let (mesh, log) = (folder.text("street.ply"), sample());
    let run = || {
        let arguments = [&["fuse", log.as_str(), "-o", mesh.as_str()], &COARSE[..]].concat();
        let output = command(&arguments)
            .env("XDG_CONFIG_HOME", folder.path("config"))
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    fs::write(&settings, "picture = true\n").unwrap();
    let (code, told) = run();
    assert_eq!(code, Some(0), "{told}");
    assert!(folder.path("street.png").is_file());
    fs::write(&settings, "pictures = true\n").unwrap();
    let (code, told) = run();
    assert!(
        code == Some(2) && told.contains("settings.toml") && told.contains("pictures"),
        "{told}"
    );
}
