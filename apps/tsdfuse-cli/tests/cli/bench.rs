//! `tsdfuse bench`: its figures against what other commands tell.

use std::fs;

use serde_json::Value;
use tsdfuse::VoxelMap;
use tsdfuse::map::Voxel;

use crate::run::{Folder, tsdfuse};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Voxels, rows of eight voxels and blocks that differ, by looking each voxel up.
fn differences(old: &VoxelMap, new: &VoxelMap) -> [usize; 3] {
    let mut sums = [0; 3];
    for index in new.block_indices() {
        let of = |map: &VoxelMap, i: usize| map.block(index).map_or(Voxel::default(), |block| block.voxels[i]);
        let differ: Vec<usize> = (0..512).filter(|&i| of(old, i) != of(new, i)).collect();
        let mut rows: Vec<usize> = differ.iter().map(|i| i / 8).collect();
        rows.dedup();
        sums[0] += differ.len();
        sums[1] += rows.len();
        sums[2] += usize::from(!differ.is_empty());
    }
    sums
}

#[test]
fn what_changes_is_what_maps_differ_by_on_any_number_of_threads() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 3, &[]);
    let mut maps = vec![VoxelMap::new(tsdfuse::MapConfig::default()).unwrap()];
    for scans in ["0..1", "0..2", "0..3"] {
        let map = folder.text(scans);
        tsdfuse(&["fuse", &set, "--save-map", &map, "--scans", scans]).succeeded();
        maps.push(tsdfuse_io::map_file::read(&map).unwrap());
    }
    let mut wanted = [0; 3];
    for pair in maps.windows(2) {
        let differences = differences(&pair[0], &pair[1]);
        (0..3).for_each(|i| wanted[i] += differences[i]);
    }
    assert!(wanted[2] > 100);
    for threads in ["1", "2"] {
        let run = tsdfuse(&["bench", &set, "--runs", "1", "--threads", threads, "--json"]).succeeded();
        assert_eq!(run.stderr, "");
        let results = run.json();
        let changes = &results["methods"][0]["changes"];
        let counted = ["voxels", "lines", "blocks"].map(|key| (3.0 * number(&changes[key])).round() as usize);
        assert_eq!((counted, number(&changes["scans"])), (wanted, 3.0), "{threads} threads");
        assert_eq!(results["machine"]["threads"].to_string(), threads);
    }
}

#[test]
fn every_method_is_measured_and_its_stages_make_up_the_run() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 4, &[]);
    let run = tsdfuse(&["bench", &set, "--methods", "all", "--runs", "2", "--json"]).succeeded();
    let results = run.json();
    for limit in results["limits"].as_object().unwrap().values() {
        assert!(number(limit) > 1e6, "{limit}");
    }
    let failed = results["failed"].as_array().unwrap();
    assert_eq!(failed.len(), 1, "{failed:?}");
    assert_eq!(failed[0]["name"], "depth");
    assert!(
        failed[0]["reason"]
            .as_str()
            .unwrap()
            .contains("not the image of a depth camera")
    );
    let methods = results["methods"].as_array().unwrap();
    assert_eq!(methods.len(), 13);
    let mut best_share = 0.0_f64;
    for method in methods {
        let name = method["name"].as_str().unwrap();
        let (changes, runs) = (&method["changes"], method["runs"].as_array().unwrap());
        let [voxels, lines, blocks] = ["voxels", "lines", "blocks"].map(|key| number(&changes[key]));
        assert!(
            blocks > 1.0 && blocks <= lines && lines <= voxels && voxels <= 8.0 * lines,
            "{name}: {changes}"
        );
        assert!(lines <= 64.0 * blocks, "{name}: {changes}");
        assert_eq!(runs.len(), 2);
        for run in runs {
            let of = |key: &str| number(&run[key]);
            let stages = ["wait", "prepare", "find", "update", "finish", "mesh", "write"];
            let sum: f64 = stages.iter().map(|stage| of(stage)).sum();
            assert!(sum <= of("total"), "{name}: {run}");
            best_share = best_share.max(sum / of("total"));
            assert!(
                stages.iter().all(|stage| of(stage) >= 0.0) && of("scan") > 0.0,
                "{name}: {run}"
            );
            assert!(
                of("scans") == 4.0 && of("fused") > 0.0 && of("triangles") > 0.0,
                "{name}: {run}"
            );
        }
        // Only what collects scans does its work at the end.
        let least = |key: &str| runs.iter().map(|run| number(&run[key])).fold(f64::INFINITY, f64::min);
        assert_eq!(least("finish") > least("update"), name == "roldao", "{name}: {runs:?}");
    }
    // Of the least disturbed run, since a machine that turns to other work between two stages counts for neither.
    assert!(best_share > 0.5, "{best_share}");
}

#[test]
fn without_a_data_set_a_street_is_simulated_and_the_table_says_how_close_memory_is() {
    let arguments = [
        "bench",
        "--scans",
        "8..10",
        "--voxel-size",
        "0.2",
        "--truncation",
        "0.4",
        "--runs",
        "2",
    ];
    let run = tsdfuse(&[&arguments[..], &["--methods", "raycast,normals"]].concat()).succeeded();
    assert_eq!(run.stderr, "");
    let text = String::from_utf8(run.stdout).unwrap();
    for part in [
        "a simulated street, Pandar64: 2 scans",
        "GB/s, triad ",
        "s, median of 2 runs",
        "\nnormals  ",
        "scans/s from files to mesh",
        "memory alone would take",
        " 100.0 %",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn a_scan_that_is_broken_ends_the_run_unless_it_may_be_skipped() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 3, &[]);
    fs::write(folder.path("box/velodyne/000001.bin"), [1; 7]).unwrap();
    let bench = ["bench", &set, "--runs", "1", "--json"];
    let told = tsdfuse(&bench).failed(1);
    assert!(told.contains("000001.bin"), "{told}");
    let run = tsdfuse(&[&bench[..], &["--skip-bad"]].concat());
    assert_eq!(run.code, 3, "{}", run.stderr);
    let results = run.json();
    let scans = &results["methods"][0]["runs"][0];
    assert_eq!((number(&scans["scans"]), number(&scans["skipped_scans"])), (2.0, 1.0));
    assert_eq!(number(&results["methods"][0]["changes"]["scans"]), 2.0);
}

#[test]
fn a_long_drive_makes_new_blocks_in_each_pass() {
    let coarse = ["--voxel-size", "0.4", "--truncation", "1"];
    let drive = |scans| [&["bench", "--long-drive", scans][..], &coarse].concat();
    let results = tsdfuse(&[&drive("250")[..], &["--json"]].concat()).succeeded().json();
    let passes = results["passes"].as_array().unwrap();
    let of = |key: &str| passes.iter().map(|pass| number(&pass[key])).collect::<Vec<_>>();
    let (blocks, updated) = (of("blocks"), of("updated_blocks"));
    assert!(
        blocks[0] > 100.0 && blocks[1] == 2.0 * blocks[0] && blocks[2] > blocks[1],
        "{blocks:?}"
    );
    // Which scans tell about a voxel depends on where it is.
    let alike = (updated[0] - updated[1]).abs() <= 1e-3 * updated[0];
    assert!(blocks[2] < 3.0 * blocks[0] + 1.0 && alike, "{blocks:?} {updated:?}");
    let run = tsdfuse(&drive("208")).succeeded();
    let text = String::from_utf8(run.stdout).unwrap();
    assert!(
        text.contains("first ten ") && text.contains("Last row to first: "),
        "{text}"
    );
}

#[test]
fn a_long_drive_is_tracked_lap_after_lap() {
    let drive = ["bench", "--long-drive", "230", "--poses", "track"];
    let results = tsdfuse(&[&drive[..], &["--json"]].concat()).succeeded().json();
    assert_eq!(results["laps"].as_array().unwrap().len(), 2);
    assert!(number(&results["error_m"]) < 0.1, "{results}");
    assert!(number(&results["laps"][1]["closures"]) > 0.0, "{results}");
}

#[test]
fn what_cannot_be_measured_is_refused_before_the_work() {
    for (arguments, told) in [
        (
            &["bench", "--methods", "magic"][..],
            "no method magic; there are all, raycast",
        ),
        (&["bench", "--set", "map.voxel=1"], "unknown field `voxel`"),
        (
            &["bench", "--long-drive", "100", "log"],
            "--long-drive simulates its own scans",
        ),
        (
            &["bench", "--long-drive", "100", "--scans", "0..3"],
            "--long-drive simulates its own scans",
        ),
        (
            &["bench", "--long-drive", "100", "--poses", "refine"],
            "only --poses track goes with it",
        ),
        (
            &[
                "bench",
                "--long-drive",
                "100",
                "--poses",
                "track",
                "--methods",
                "raycast",
            ],
            "makes no map",
        ),
        (
            &["bench", "--long-drive", "100", "--methods", "raycast,normals"],
            "--long-drive is for one method",
        ),
    ] {
        let error = tsdfuse(arguments).failed(2);
        assert!(error.contains(told), "{error}");
    }
    assert!(tsdfuse(&["bench", "nowhere"]).failed(1).contains("nowhere"));
}
