//! A log written as recordings by programs that are not ours (PyPI's `rosbags` and `mcap`, `bags.py`) gives the mesh of the log.
//!
//! `TSDFUSE_PYTHON` names a Python that has them, as in CI.

use std::path::Path;
use std::process::Command;

use crate::run::{Folder, python, tsdfuse};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/bags.py");
/// Kinds of recordings that `bags.py` writes, and the ends of their names.
const KINDS: &[(&str, &str)] = &[
    ("ros1", ".bag"),
    ("ros1-lz4", ".bag"),
    ("ros1-bz2", ".bag"),
    ("mcap", ""),
    ("mcap-zstd", ""),
    ("plain-mcap-lz4", ".mcap"),
    ("plain-mcap-zstd", ".mcap"),
    #[cfg(feature = "db3")]
    ("db3", ""),
    #[cfg(feature = "db3")]
    ("db3-zstd", ""),
];
/// Vertices of one mesh are at most this far from those of the other, metres.
const MAX_M: f64 = 1e-4;

#[test]
fn recordings_of_other_programs_give_the_mesh_of_the_log() {
    let Some(python) = python("numpy, scipy, mcap_ros2, rosbags") else {
        return;
    };
    let run = |arguments: &[&str]| {
        let run = Command::new(&python).arg(SCRIPT).args(arguments).output().unwrap();
        let told = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{arguments:?}: {told}");
        run.stdout
    };
    let folder = Folder::new();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sample/pandaset-002");
    let [plain, a, b] = ["plain", "a.ply", "b.ply"].map(|name| folder.text(name));
    let sample = sample.to_str().unwrap();
    tsdfuse(&["fuse", sample, "-o", &a, "--voxel-size", "0.1"]).succeeded();
    tsdfuse(&["convert", sample, "-o", &plain]).succeeded();
    // What a recording does not tell: the beams, and what of the car the sensor sees.
    let sensor = format!("{plain}/sensor.toml");
    for (kind, end) in KINDS {
        let bag = folder.text(&format!("{kind}{end}"));
        run(&["write", &plain, kind, &bag]);
        let told = ["--sensor", &sensor, "--min-range", "2.5"];
        tsdfuse(&[&["fuse", &bag, "-o", &b, "--voxel-size", "0.1"], &told[..]].concat()).succeeded();
        let told: serde_json::Value = serde_json::from_slice(&run(&["compare", &a, &b])).unwrap();
        let vertices = told["vertices"].as_array().unwrap();
        assert!(
            vertices[0].as_u64().unwrap() > 100_000 && vertices[0] == vertices[1],
            "{kind}: {told}"
        );
        assert!(told["in_order_m"].as_f64().unwrap() <= MAX_M, "{kind}: {told}");
    }
}
