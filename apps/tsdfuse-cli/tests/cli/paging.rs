//! `--memory`, `--store` and `tsdfuse resume`: maps that are not all in memory, runs that are killed.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::time::Duration;

use crate::run::{Folder, command, names, tsdfuse};

/// A street, seen by the light of a lamp: the map is much larger than what a scan can touch.
const STREET: [&str; 8] = [
    "--voxel-size",
    "0.05",
    "--truncation",
    "0.15",
    "--max-range",
    "7",
    "--method",
    "patch",
];

fn street(folder: &Folder, scans: u32) -> String {
    folder.simulate("street", "street", "vlp16", scans, &["--motion"])
}

#[test]
fn little_memory_gives_the_same_map_and_the_same_mesh() {
    let folder = Folder::new();
    let set = street(&folder, 40);
    let [whole, little, part] = ["whole", "little", "part"].map(|name| folder.text(&format!("{name}.tsdf")));
    let [mesh, parts] = ["mesh.ply", "parts.ply"].map(|name| folder.text(name));
    let fuse = |more: &[&str]| tsdfuse(&[&["fuse", &set, "--json"], &STREET[..], more].concat()).succeeded();
    let report = fuse(&["--save-map", &whole, "-o", &mesh]).json();
    let paged = fuse(&["--save-map", &little, "-o", &parts, "--memory", "1M"]).json();
    assert!(fs::read(&whole).unwrap() == fs::read(&little).unwrap());
    for key in ["blocks", "observed_voxels"] {
        assert_eq!(report["map"][key], paged["map"][key]);
    }
    for key in ["vertices", "triangles"] {
        assert_eq!(report["mesh"][key], paged["mesh"][key]);
    }
    assert_eq!(fs::metadata(&mesh).unwrap().len(), fs::metadata(&parts).unwrap().len());
    let most = paged["paging"]["most_bytes"].as_u64().unwrap();
    let whole_bytes = report["map"]["bytes"].as_u64().unwrap();
    assert!(3 * most < 2 * whole_bytes, "{most} of {whole_bytes}");
    // A saved map goes on with little memory, too.
    fuse(&["--save-map", &part, "--scans", "0..25"]);
    let rest = [
        "--load-map",
        &part,
        "--scans",
        "25..40",
        "--save-map",
        &little,
        "--memory",
        "1M",
    ];
    fuse(&rest);
    assert!(fs::read(&whole).unwrap() == fs::read(&little).unwrap());
    // The store is gone.
    assert_eq!(
        names(&folder.path("")),
        [
            "little.tsdf",
            "mesh.ply",
            "part.tsdf",
            "parts.ply",
            "street",
            "whole.tsdf"
        ]
    );
}

#[test]
fn what_cannot_be_paged_is_refused() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let [store, map, mesh] = ["box.store", "box.tsdf", "mesh.ply"].map(|name| folder.text(name));
    let refused = |code: i32, more: &[&str]| tsdfuse(&[&["fuse", &set], more].concat()).failed(code);
    let batch = [
        "--method",
        "roldao",
        "--set",
        "roldao.form=batch",
        "--memory",
        "9M",
        "-o",
        &mesh,
    ];
    assert!(refused(2, &batch).contains("batch keeps the points of all scans in memory"));
    let preview = ["--memory", "9M", "--preview", &folder.text("a.png")];
    assert!(refused(2, &preview).contains("--preview needs the whole map"));
    assert!(refused(2, &["--memory", "9M", "-o", &folder.text("a.glb")]).contains("is written as a .ply file"));
    assert!(refused(1, &["--store", &folder.text("no/a.store")]).contains("no such folder"));
    tsdfuse(&["fuse", &set, "--store", &store]).succeeded();
    assert!(refused(1, &["--store", &store]).contains("box.store: is there already"));
    let line = tsdfuse(&["resume", &folder.text("none")]).failed(1);
    assert!(line.contains("none: No such file"), "{line}");
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let line = tsdfuse(&["resume", &map]).failed(1);
    assert!(line.contains("box.tsdf: "), "{line}");
    // The mesh can be followed, too.
    let followed = [
        "fuse",
        &set,
        "--memory",
        "9M",
        "-o",
        &mesh,
        "--mesh-every",
        "1",
        "--json",
    ];
    assert_eq!(tsdfuse(&followed).succeeded().json()["growth"]["meshes"], 2);
    std::fs::remove_file(&mesh).unwrap();
    // A run that is over can be resumed: nothing is left to do.
    let done = tsdfuse(&["resume", &store]).succeeded();
    assert!(done.stderr.contains("continuing after 2 of 2 scans"), "{}", done.stderr);
    assert_eq!(names(&folder.path("")), ["box", "box.store", "box.tsdf"]);
}

/// How far a run says its store is.
fn stored(stderr: &str) -> usize {
    let line = stderr.lines().rev().find_map(|line| line.trim().strip_prefix("stored"));
    line.map_or(0, |line| line.split_whitespace().next().unwrap().parse().unwrap())
}

#[test]
fn runs_that_are_killed_lose_nothing_that_was_stored() {
    let kills: u64 = std::env::var("TSDFUSE_KILLS").map_or(6, |n| n.parse().unwrap());
    let folder = Folder::new();
    let set = street(&folder, 60);
    let [whole, map, store] = ["whole.tsdf", "map.tsdf", "street.store"].map(|name| folder.text(name));
    let fuse = [&["fuse", &set, "--save-map"][..], &[&whole], &STREET].concat();
    tsdfuse(&fuse).succeeded();
    let paged = ["--memory", "1M", "--store", &store, "--commit-every", "3"];
    let fuse = [&["fuse", &set, "--save-map"][..], &[&map], &STREET, &paged].concat();
    let (mut known, mut in_the_middle) = (0, 0);
    for kill in 0..kills {
        let arguments = if fs::exists(&store).unwrap() {
            vec!["resume", &store]
        } else {
            fuse.clone()
        };
        let child = command(&arguments).stdout(Stdio::null()).spawn().unwrap();
        // Any moment, but the same ones each time.
        std::thread::sleep(Duration::from_millis(20 + kill * 7919 % 380));
        let mut child = child;
        child.kill().unwrap();
        let stderr = String::from_utf8(child.wait_with_output().unwrap().stderr).unwrap();
        assert!(!stderr.contains("panicked") && !stderr.contains("error"), "{stderr}");
        let went_on = stderr.lines().find_map(|line| line.split_once("continuing after "));
        let from = went_on.map(|(_, rest)| rest.split_whitespace().next().unwrap().parse::<usize>().unwrap());
        assert!(from.is_none_or(|from| from >= known), "{from:?} {known}");
        known = known.max(stored(&stderr));
        in_the_middle += usize::from((1..60).contains(&known));
        if fs::exists(&map).unwrap() {
            // That was the end; once more, from the beginning.
            assert!(fs::read(&map).unwrap() == fs::read(&whole).unwrap());
            fs::remove_file(&map).unwrap();
            fs::remove_file(&store).unwrap();
            known = 0;
        }
    }
    let arguments = if fs::exists(&store).unwrap() {
        vec!["resume", &store]
    } else {
        fuse.clone()
    };
    let last = tsdfuse(&arguments).succeeded();
    assert!(fs::read(&map).unwrap() == fs::read(&whole).unwrap(), "{}", last.stderr);
    eprintln!("{kills} kills, {in_the_middle} of them after a commit and before the last one");
    // One that is surely killed in the middle goes on there.
    fs::remove_file(&map).unwrap();
    fs::remove_file(&store).unwrap();
    let fuse = [&["fuse", &set, "--save-map"][..], &[&map], &STREET, &paged].concat();
    kill_when_stored(&fuse);
    assert_resumes_to(&store, 3..60, &map, &whole);
}

/// Through a hall and back, without poses: each scan comes once more on the way back.
fn there_and_back(folder: &Folder) -> String {
    let there = folder.simulate("there", "hall", "vlp16", 80, &[]);
    for (kind, extension) in [("velodyne", "bin"), ("rings", "u16")] {
        fs::create_dir_all(folder.path("drive").join(kind)).unwrap();
        for scan in 0..79 {
            let from = if scan < 40 { scan } else { 78 - scan };
            let path = |of: &str, scan: u32| folder.path(of).join(kind).join(format!("{scan:06}.{extension}"));
            fs::copy(path(&there, from), path("drive", scan)).unwrap();
        }
    }
    folder.text("drive")
}

/// Runs the command, and kills it when scans were stored for the first time.
fn kill_when_stored(arguments: &[&str]) {
    let mut child = command(arguments).stdout(Stdio::null()).spawn().unwrap();
    let mut told = BufReader::new(child.stderr.take().unwrap())
        .lines()
        .map_while(Result::ok);
    assert!(told.any(|line| line.contains("stored ")));
    child.kill().unwrap();
    child.wait().unwrap();
}

/// A killed run goes on after one of these scans, to the map of a run that was not killed.
fn assert_resumes_to(store: &str, scans: std::ops::Range<usize>, map: &str, whole: &str) {
    let last = tsdfuse(&["resume", store]).succeeded();
    let from = last.stderr.split_once("continuing after ").unwrap().1;
    let from: usize = from.split_whitespace().next().unwrap().parse().unwrap();
    assert!(scans.contains(&from), "{from}");
    assert!(fs::read(map).unwrap() == fs::read(whole).unwrap(), "{}", last.stderr);
}

#[test]
fn a_run_that_closes_loops_and_is_killed_ends_with_the_same_map() {
    let folder = Folder::new();
    let drive = there_and_back(&folder);
    let [whole, map, store] = ["whole.tsdf", "map.tsdf", "drive.store"].map(|name| folder.text(name));
    let fuse = [
        "fuse",
        &drive,
        "--voxel-size",
        "0.1",
        "--method",
        "raycast",
        "--set",
        "loops.gap_m=6",
    ];
    let report = tsdfuse(&[&fuse[..], &["--save-map", &whole, "--json"]].concat());
    let report = report.succeeded().json();
    let closures = report["odometry"]["loops"]["closures"].as_array().unwrap();
    assert!(!closures.is_empty(), "{report}");
    let begin = [
        &fuse[..],
        &["--save-map", &map, "--store", &store, "--commit-every", "4"],
    ]
    .concat();
    // Once when the first scans are stored, and twice more later: each time, all scans are tracked again.
    for _ in 0..3 {
        let arguments = if fs::exists(&store).unwrap() {
            vec!["resume", &store]
        } else {
            begin.clone()
        };
        kill_when_stored(&arguments);
    }
    assert_resumes_to(&store, 4..79, &map, &whole);
}

#[cfg(unix)]
#[test]
fn a_full_disk_is_told_and_the_store_stays_what_it_was() {
    let folder = Folder::new();
    let set = street(&folder, 60);
    let [whole, map, store] = ["whole.tsdf", "map.tsdf", "street.store"].map(|name| folder.text(name));
    tsdfuse(&[&["fuse", &set, "--save-map"][..], &[&whole], &STREET].concat()).succeeded();
    let paged = ["--store", &store, "--commit-every", "2", "--memory", "1M"];
    let fuse = [&["fuse", &set, "--save-map"][..], &[&map], &STREET, &paged].concat();
    // No file may be larger than so many blocks of 512 bytes; who writes on gets an error.
    let mut told = 0;
    for blocks in [3200, 5000, 8000] {
        let arguments = if fs::exists(&store).unwrap() {
            vec!["resume", &store]
        } else {
            fuse.clone()
        };
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
        let mut shell = std::process::Command::new("sh");
        let run = shell
            .args(["-c", &script, env!("CARGO_BIN_EXE_tsdfuse")])
            .args(&arguments)
            .output()
            .unwrap();
        let stderr = String::from_utf8(run.stderr).unwrap();
        assert!(!stderr.contains("panicked"), "{stderr}");
        if run.status.code() != Some(0) {
            let error = stderr.lines().last().unwrap();
            assert!(
                error.starts_with("tsdfuse: error: ") && error.contains("File too large"),
                "{stderr}"
            );
            told += 1;
        }
    }
    assert!(told > 0);
    let last = tsdfuse(&if fs::exists(&store).unwrap() {
        vec!["resume", &store]
    } else {
        fuse
    });
    last.succeeded();
    assert!(fs::read(&map).unwrap() == fs::read(&whole).unwrap());
}
