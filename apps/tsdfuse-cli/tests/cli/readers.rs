//! What other programs read, read by them: OctoMap, Pillow, GDAL, MCAP's library, rosbags, a WebSocket client (`readers.py`).
//!
//! `TSDFUSE_PYTHON` names a Python that has them, as in CI. Without the variable `python3` is tried, and the tests say so and pass if that
//! lacks one.

use std::path::Path;
use std::process::Command;

use crate::run::{Folder, python, tsdfuse};
#[cfg(feature = "serve")]
use crate::serving::Serving;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/readers.py");
const COARSE: [&str; 4] = ["--voxel-size", "0.2", "--truncation", "0.6"];

/// Lets other programs read; what they say.
fn read(python: &str, arguments: &[&str]) -> serde_json::Value {
    let run = Command::new(python).arg(SCRIPT).args(arguments).output().unwrap();
    let told = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{arguments:?}: {told}");
    serde_json::from_slice(&run.stdout).unwrap()
}

fn sample() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sample/pandaset-002");
    path.to_str().unwrap().to_owned()
}

fn triangles(ply: &str) -> usize {
    tsdfuse_io::mesh::read(ply).unwrap().triangles.len()
}

#[test]
fn free_space_is_read_by_octomap_and_as_a_map_of_nav2() {
    let Some(python) = python("numpy, pyoctomap, yaml, PIL") else {
        return;
    };
    let folder = Folder::new();
    let log = folder.simulate("log", "hall", "vlp16", 3, &[]);
    let [bt, voxels, map] = ["free.bt", "free.npz", "free.yaml"].map(|name| folder.text(name));
    for output in [&bt, &voxels] {
        tsdfuse(&["map", "free", &log, "-o", output]).succeeded();
    }
    let told = read(&python, &["octomap", &bt, &voxels]);
    assert!(told["voxels"].as_u64().unwrap() > 10_000, "{told}");
    tsdfuse(&["map", "free", &log, "-o", &map, "--heights", "0.3..1.8"]).succeeded();
    let told = read(&python, &["nav2", &map, &voxels, "0.3", "1.8"]);
    for value in ["0", "100", "255"] {
        assert!(told[value].as_u64().unwrap() > 100, "{told}");
    }
}

#[test]
fn ground_is_read_by_gdal() {
    let Some(python) = python("numpy, rasterio") else {
        return;
    };
    let folder = Folder::new();
    let [map, tif, layers] = ["a.tsdf", "ground.tif", "ground.npz"].map(|name| folder.text(name));
    tsdfuse(&[&["fuse", &sample(), "--save-map", &map], &COARSE[..]].concat()).succeeded();
    tsdfuse(&["map", "ground", &map, "-o", &tif, "--epsg", "32632"]).succeeded();
    tsdfuse(&["map", "ground", &map, "-o", &layers]).succeeded();
    let told = read(&python, &["geotiff", &tif, &layers, "32632"]);
    assert_eq!(told["bands"].as_array().unwrap().len(), 5, "{told}");
    assert!(told["known"].as_u64().unwrap() > 1000, "{told}");
}

#[test]
fn a_recording_is_read_by_mcap_and_rosbags() {
    let Some(python) = python("numpy, mcap_ros2, rosbags") else {
        return;
    };
    let folder = Folder::new();
    let (mcap, ply) = (folder.text("run.mcap"), folder.text("a.ply"));
    tsdfuse(&[&["fuse", &sample(), "-o", &ply, "--record", &mcap], &COARSE[..]].concat()).succeeded();
    let told = read(&python, &["mcap", &mcap]);
    assert_eq!(told["messages"]["/odometry"], 3, "{told}");
    assert_eq!(told["messages"]["/map"], 1, "{told}");
    // The last word on each part of the surface is the mesh.
    assert_eq!(told["triangles"], triangles(&ply), "{told}");
}

#[cfg(all(unix, feature = "serve"))]
#[test]
fn a_run_and_its_map_are_served_to_who_comes_late() {
    let Some(python) = python("numpy, rosbags, websockets") else {
        return;
    };
    let folder = Folder::new();
    let (map, ply) = (folder.text("a.tsdf"), folder.text("a.ply"));
    tsdfuse(&[&["fuse", &sample(), "-o", &ply, "--save-map", &map], &COARSE[..]].concat()).succeeded();
    let expected = triangles(&ply).to_string();
    let port = ["--address", "127.0.0.1:0"];
    for (path, topics) in [
        (sample(), &["/lidar", "/map", "/odometry", "/surface", "/tf"][..]),
        (map, &["/path", "/surface"]),
    ] {
        let serving = Serving::start(&[&["serve", &path], &port[..], &COARSE].concat(), "foxglove ");
        assert!(serving.url.starts_with("ws://127.0.0.1:"), "{}", serving.url);
        // One after the other: the last one comes when all is done.
        for _ in 0..2 {
            read(&python, &[&["foxglove", &serving.url, &expected], topics].concat());
        }
        let (code, told) = serving.interrupt();
        assert_eq!(code, 0, "{told:?}");
    }
}
