//! `tsdfuse convert`, and what becomes of logs in other formats.

use std::fs::{self, File};

use crate::run::{Folder, command, tsdfuse};

#[test]
fn a_recording_gives_the_same_mesh_as_a_file_as_it_grows_and_through_standard_input() {
    let folder = Folder::new();
    let set = folder.simulate("hall", "hall", "vlp16", 12, &["--path", "vehicle", "--motion"]);
    let [mcap, a, b, c] = ["hall.mcap", "a.ply", "b.ply", "c.ply"].map(|name| folder.text(name));
    tsdfuse(&["convert", &set, "-o", &mcap]).succeeded();
    let fuse = |log: &str, mesh: &str, more: &[&str]| {
        let arguments = [
            &["fuse", log, "-o", mesh, "--method", "raycast", "--voxel-size", "0.2"],
            more,
        ]
        .concat();
        let run = command(&arguments).stdin(File::open(&mcap).unwrap()).output().unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    };
    fuse(&mcap, &a, &[]);
    fuse(&mcap, &b, &["--follow"]);
    fuse("-", &c, &[]);
    let [a, b, c] = [a, b, c].map(|mesh| fs::read(mesh).unwrap());
    assert!(a.len() > 10_000 && a == b && a == c);
}

#[test]
fn the_elevations_of_kitti_are_corrected_unless_that_is_set() {
    let folder = Folder::new();
    let set = folder.simulate("street", "street", "hdl64e", 2, &[]);
    let kitti = folder.text("kitti");
    tsdfuse(&["convert", &set, "--format", "kitti", "-o", &kitti]).succeeded();
    let degrees = || {
        let info = tsdfuse(&["info", &kitti, "--json"]).succeeded().json();
        info["elevation_correction_deg"].as_f64().unwrap()
    };
    // What was converted is right as it is, and says so.
    assert_eq!(degrees(), 0.0);
    fs::remove_file(folder.path("kitti/sensor.toml")).unwrap();
    assert_eq!(degrees(), 0.205);
    let table = String::from_utf8(tsdfuse(&["info", &kitti]).succeeded().stdout).unwrap();
    assert!(
        table.contains("elevations  each point is turned up by 0.205°"),
        "{table}"
    );
    let mesh = |log: &str, name: &str, more: &[&str]| {
        let [mesh, report] = [name, "report.json"].map(|name| folder.text(name));
        let fuse = [
            "fuse",
            log,
            "-o",
            &mesh,
            "--method",
            "raycast",
            "--voxel-size",
            "0.2",
            "--report",
            &report,
        ];
        tsdfuse(&[&fuse, more].concat()).succeeded();
        let report: serde_json::Value = serde_json::from_slice(&fs::read(report).unwrap()).unwrap();
        let degrees = report["config"]["sensor"]["elevation_correction_deg"].as_f64().unwrap();
        (fs::read(mesh).unwrap(), degrees)
    };
    let off = ["--set", "sensor.elevation_correction_deg=0"];
    let (as_measured, zero) = mesh(&kitti, "a.ply", &off);
    let (corrected, told) = mesh(&kitti, "b.ply", &[]);
    assert_eq!((zero, told), (0.0, 0.205));
    assert!(as_measured != corrected && as_measured == mesh(&set, "c.ply", &[]).0);
    // Any log can be corrected, by what an error of a sensor may be.
    assert!(corrected == mesh(&set, "d.ply", &["--set", "sensor.elevation_correction_deg=0.205"]).0);
    let d = folder.text("e.ply");
    let told = tsdfuse(&["fuse", &set, "-o", &d, "--set", "sensor.elevation_correction_deg=7"]).failed(1);
    assert!(
        told.contains("7° is no error of a sensor: at most 5° are possible"),
        "{told}"
    );
}
