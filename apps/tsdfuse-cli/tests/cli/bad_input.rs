//! What is wrong is said in one line that names the place, and nothing is left behind.

use std::fs;

use crate::run::{Folder, names, tsdfuse};

/// Fuses a simulated set that `damage` has changed; returns the one line of error. There must be no output.
fn fuse_damaged(damage: impl Fn(&Folder)) -> String {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 8, &[]);
    damage(&folder);
    fs::create_dir(folder.path("out")).unwrap();
    let (mesh, report) = (folder.text("out/mesh.ply"), folder.text("out/report.json"));
    let line = tsdfuse(&["fuse", &set, "-o", &mesh, "--report", &report]).failed(1);
    assert_eq!(names(&folder.path("out")), [""; 0]);
    line
}

/// Replaces line `number` (from 1) of the set's poses.
fn with_pose(folder: &Folder, number: usize, edit: impl Fn(&str) -> String) {
    let path = folder.path("box/poses.txt");
    let text = fs::read_to_string(&path).unwrap();
    let lines = (1..).zip(text.lines());
    let edited: Vec<_> = lines
        .map(|(n, line)| if n == number { edit(line) } else { line.to_owned() })
        .collect();
    fs::write(path, edited.join("\n")).unwrap();
}

#[test]
fn damaged_files_are_named() {
    let line = fuse_damaged(|f| fs::write(f.path("box/velodyne/000003.bin"), [0; 33]).unwrap());
    assert!(
        line.contains("box/velodyne/000003.bin: ") && line.contains("33"),
        "{line}"
    );
    let line = fuse_damaged(|f| with_pose(f, 7, |pose| pose.rsplit_once(' ').unwrap().0.to_owned()));
    assert!(line.contains("box/poses.txt: line 7: 11 numbers"), "{line}");
    let line = fuse_damaged(|f| with_pose(f, 2, |pose| format!("nan {}", pose.split_once(' ').unwrap().1)));
    assert!(
        line.contains("box/poses.txt: line 2: ") && line.contains("not finite"),
        "{line}"
    );
    let line = fuse_damaged(|f| fs::write(f.path("box/rings/000001.u16"), [0; 2]).unwrap());
    assert!(line.contains("box/rings/000001.u16: "), "{line}");
    let line = fuse_damaged(|f| fs::write(f.path("box/sensor.toml"), "name = 3").unwrap());
    assert!(line.contains("box/sensor.toml: line 1: "), "{line}");
}

#[test]
fn a_log_without_poses_is_tracked_unless_its_own_are_asked_for() {
    let folder = Folder::new();
    folder.simulate("box", "box", "vlp16", 8, &[]);
    fs::remove_file(folder.path("box/poses.txt")).unwrap();
    let (log, mesh, poses) = (folder.text("box"), folder.text("mesh.ply"), folder.text("poses.tum"));
    let line = tsdfuse(&["fuse", &log, "-o", &mesh, "--poses", "log"]).failed(1);
    assert!(line.contains("poses.txt"), "{line}");
    let run = tsdfuse(&["fuse", &log, "-o", &mesh, "--save-poses", &poses]).succeeded();
    assert!(run.stderr.contains("by odometry"), "{}", run.stderr);
    let of_fuse = fs::read_to_string(folder.path("poses.tum")).unwrap();
    assert!(of_fuse.starts_with("# world_from_sensor"));
    assert_eq!(of_fuse.lines().count(), 1 + 8);
    tsdfuse(&["odometry", &log, "-o", &folder.text("alone.tum")]).succeeded();
    assert_eq!(fs::read_to_string(folder.path("alone.tum")).unwrap(), of_fuse);
    let line = tsdfuse(&[
        "fuse",
        &log,
        "-o",
        &mesh,
        "--load-map",
        &mesh,
        "--poses",
        "log",
        "--initial-pose",
        "1,2,x",
    ]);
    assert!(
        line.code == 2 && line.stderr.contains("--initial-pose"),
        "{}",
        line.stderr
    );
    let line = tsdfuse(&["evaluate", &log, "--tune", "--poses", "track"]).failed(2);
    assert!(line.contains("tsdfuse odometry"), "{line}");
    let line = tsdfuse(&["evaluate", &log, "--poses", "given,given"]).failed(2);
    assert!(line.contains("each once"), "{line}");
}

#[test]
fn a_path_without_scans_is_refused() {
    let folder = Folder::new();
    let (here, mesh) = (folder.text(""), folder.text("mesh.ply"));
    let line = tsdfuse(&["fuse", &here, "-o", &mesh]).failed(1);
    assert!(line.contains("holds no scans"), "{line}");
    let line = tsdfuse(&["info", &here]).failed(1);
    assert!(line.contains("holds no scans"), "{line}");
    let line = tsdfuse(&["fuse", &folder.text("nowhere"), "-o", &mesh]).failed(1);
    assert!(
        line.contains("nowhere: ") && line.matches("No such file").count() == 1,
        "{line}"
    );
    assert_eq!(names(&folder.path("")), [""; 0]);
}

#[test]
fn scans_without_anything_to_fuse_are_no_result() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let mesh = folder.text("mesh.ply");
    let line = tsdfuse(&["fuse", &set, "-o", &mesh, "--min-range", "50"]).failed(1);
    assert!(
        line.contains("points could be fused; ") && line.contains("too near"),
        "{line}"
    );
    let line = tsdfuse(&["fuse", &set, "-o", &mesh, "--min-weight", "1000"]).failed(1);
    assert!(line.contains("no triangle with a weight of 1000 or more"), "{line}");
    assert_eq!(names(&folder.path("")), ["box"]);
}

#[test]
fn results_that_cannot_be_written_are_refused_before_the_work() {
    let folder = Folder::new();
    fs::create_dir(folder.path("folder.ply")).unwrap();
    // The data set does not exist: the outputs are looked at first.
    let set = folder.text("nowhere");
    let line = tsdfuse(&["fuse", &set, "-o", &folder.text("no/mesh.ply")]).failed(1);
    assert!(line.contains("no/mesh.ply: no such folder"), "{line}");
    let line = tsdfuse(&["fuse", &set, "-o", "-", "--report", &folder.text("no/report.json")]).failed(1);
    assert!(line.contains("no/report.json: no such folder"), "{line}");
    let line = tsdfuse(&["fuse", &set, "-o", &folder.text("folder.ply")]).failed(1);
    assert!(line.contains("folder.ply: is a folder"), "{line}");
    let line = tsdfuse(&["fuse", &set, "-o", &folder.text("mesh.stl")]).failed(2);
    assert!(
        line.contains("mesh.stl: a mesh is written as .ply, .glb or .obj"),
        "{line}"
    );
    assert_eq!(names(&folder.path("")), ["folder.ply"]);
}

#[test]
fn two_results_cannot_be_one_file() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let result = folder.text("result.ply");
    for other in ["--save-map", "--report"] {
        let line = tsdfuse(&["fuse", &set, "-o", &result, other, &result]).failed(2);
        assert!(line.contains("result.ply: two outputs"), "{line}");
    }
}

#[test]
fn wrong_arguments_and_settings_are_named_with_what_is_possible() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    fs::write(folder.path("run.toml"), "method = \"raycast\"\n[map]\nvoxels = 3\n").unwrap();
    let (mesh, config) = (folder.text("mesh.ply"), folder.text("run.toml"));
    let wrong = |more: &[&str]| {
        let mut arguments = vec!["fuse", &set, "-o", &mesh];
        arguments.extend(more);
        let line = tsdfuse(&arguments).failed(2);
        assert!(!folder.path("mesh.ply").exists());
        line
    };
    let line = wrong(&["--method", "magic"]);
    assert!(
        line.contains("'magic' for '--method <METHOD>' [possible values: raycast"),
        "{line}"
    );
    let line = wrong(&["--config", &config]);
    assert!(
        line.contains("run.toml: line 3, voxels = 3: unknown field `voxels`, expected one of `voxel_size_m`"),
        "{line}"
    );
    let line = wrong(&["--set", "map.voxels=3"]);
    assert!(
        line.contains("--set map.voxels=3: unknown field `voxels`, expected one of"),
        "{line}"
    );
    let line = wrong(&["--set", "raycast.distance=manhattan"]);
    assert!(line.contains("expected `euclidean` or `projective`"), "{line}");
    let line = wrong(&["--voxel-size", "0"]);
    assert!(line.contains("voxel_size_m must be a positive length"), "{line}");
    let line = wrong(&["--truncation", "0.01"]);
    assert!(line.contains("between 1 and 64 voxels"), "{line}");
    let line = wrong(&["--scans", "2..4"]);
    assert!(
        line.contains("--scans begins at 2, but there are only 2 scans"),
        "{line}"
    );
    let line = wrong(&["--scans", "3..1"]);
    assert!(line.contains("selects no scan"), "{line}");
    let line = wrong(&["--threads", "0"]);
    assert!(line.contains("--threads"), "{line}");
    let line = wrong(&["--colour", "red"]);
    assert!(line.contains("unexpected argument '--colour'"), "{line}");
    let line = tsdfuse(&["fuse", &set, "-o", "-", "--json"]).failed(2);
    assert!(line.contains("standard output"), "{line}");
    let line = tsdfuse(&["fuse", &set]).failed(2);
    assert!(
        line.contains("<--output <FILE>|--save-map <FILE>|--preview <FILE>|--store <FILE>"),
        "{line}"
    );
}
