//! `tsdfuse evaluate` on small simulated sets.

use std::fs;
use std::io::Write;
use std::process::Stdio;

use serde_json::Value;

use crate::ply;
use crate::run::{Folder, command, names, tsdfuse};

/// A sphere of 2 m, seen from 12 places around it, with noise of 1 cm.
fn sphere(folder: &Folder) -> String {
    folder.simulate("sphere", "sphere", "pandar64", 12, &["--noise", "0.01"])
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn methods_are_measured_against_the_truth_and_held_out_scans() {
    let folder = Folder::new();
    let (set, out) = (sphere(&folder), folder.text("out"));
    let run = tsdfuse(&[
        "evaluate",
        &set,
        "--methods",
        "raycast,raycast-projective,depth",
        "-o",
        &out,
        "--json",
        "--samples",
        "20000",
        "--hold-out",
        "4",
        "--runs",
        "2",
        "--keep-meshes",
    ])
    .succeeded();
    let results = run.json();
    assert!(
        results["reference"]["words"]
            .as_str()
            .unwrap()
            .contains("true surface of the simulation")
    );
    let rows = results["methods"].as_array().unwrap();
    assert_eq!(
        rows.iter().map(|r| r["name"].as_str().unwrap()).collect::<Vec<_>>(),
        ["raycast", "raycast-projective"]
    );
    for row in rows {
        let all = &row["surface"]["all"];
        let mean_m = number(&all["mesh_to_reference"]["mean_m"]);
        assert!(mean_m > 1e-4 && mean_m < 0.012, "{mean_m}");
        assert!(number(&all["mesh_to_reference"]["max_m"]) < 0.15);
        let at_5_cm = &all["thresholds"][0];
        assert!(number(&at_5_cm["f_score"]) > 0.97, "{at_5_cm}");
        // 12 scans, of which 2, 6 and 10 are held out.
        let held_out = &row["held_out"];
        assert!(
            number(&held_out["returns"]) > 3000.0 && number(&held_out["hit_rate"]) > 0.8,
            "{held_out}"
        );
        let error_m = number(&held_out["error"]["mean_m"]);
        assert!(error_m > 0.005 && error_m < 0.02, "{error_m}");
        assert!(number(&row["speed"]["scans_per_sec"]) > 0.0 && number(&row["peak_memory_bytes"]) > 1e6);
        assert_eq!(row["scan_secs"].as_array().unwrap().len(), 12);
        assert_eq!(row["scans_per_sec"].as_array().unwrap().len(), 2);
        let (_, triangles) = ply::read(&folder.path(&format!("out/{}.ply", row["name"].as_str().unwrap())));
        assert_eq!(row["triangles"], triangles);
        // The command of a row makes its mesh again.
        let command = row["command"].as_str().unwrap().replace("mesh.ply", "-");
        let words: Vec<&str> = command.split(' ').skip(1).collect();
        let again = tsdfuse(&words).succeeded().stdout;
        let name = format!("out/{}.ply", row["name"].as_str().unwrap());
        assert!(again == fs::read(folder.path(&name)).unwrap(), "{command}");
    }
    // A method that wants depth images is named with its reason.
    assert_eq!(results["failed"][0]["name"], "depth");
    assert!(run.stderr.contains("tsdfuse: note: depth: "), "{}", run.stderr);

    let files = [
        "3d-raycast-projective.html",
        "3d-raycast.html",
        "methods.png",
        "raycast-projective.ply",
        "raycast.ply",
        "report.html",
        "results.json",
        "table.md",
    ];
    assert_eq!(names(&folder.path("out")), files);
    let page = fs::read_to_string(folder.path("out/report.html")).unwrap();
    // Three views, of the reference and twice of each mesh; four curves, the times, the memory.
    assert_eq!((page.matches("<img ").count(), page.matches("<svg ").count()), (15, 6));
    assert!(!page.contains("http://") || page.matches("http").count() == page.matches("http://www.w3.org").count());
    let table = fs::read_to_string(folder.path("out/table.md")).unwrap();
    assert!(
        table.contains("| `raycast-projective` |") && table.contains("**Held-out scans.**"),
        "{table}"
    );
}

/// The canary: what disturbs the reference shows in the figures.
#[test]
fn a_disturbed_reference_worsens_every_figure() {
    let folder = Folder::new();
    let set = sphere(&folder);
    let evaluated = |reference: &str| {
        let run = tsdfuse(&[
            "evaluate",
            &set,
            "--methods",
            "raycast-projective",
            "--json",
            "--samples",
            "5000",
            "--hold-out",
            "0",
            "--reference",
            reference,
        ])
        .succeeded();
        let all = &run.json()["methods"][0]["surface"]["all"];
        [
            number(&all["mesh_to_reference"]["mean_m"]),
            number(&all["reference_to_mesh"]["mean_m"]),
            1.0 - number(&all["thresholds"][0]["f_score"]),
        ]
    };
    let truth = folder.path("sphere/scene.ply");
    // The sphere once more, 4 cm beside itself.
    let bytes = fs::read(&truth).unwrap();
    let body = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..body]).unwrap();
    let stride = 4 * header.matches("property float").count();
    let vertices = ply::read(&truth).0.len();
    let mut moved = bytes.clone();
    for vertex in moved[body..body + vertices * stride].chunks_mut(stride) {
        let x = f32::from_le_bytes(vertex[..4].try_into().unwrap());
        vertex[..4].copy_from_slice(&(x + 0.04).to_le_bytes());
    }
    fs::write(folder.path("moved.ply"), moved).unwrap();
    let (right, wrong) = (evaluated(truth.to_str().unwrap()), evaluated(&folder.text("moved.ply")));
    for (right, wrong) in right.into_iter().zip(wrong) {
        assert!(wrong > right, "{wrong} {right}");
    }
    assert!(wrong[0] > right[0] + 0.01, "{} {}", wrong[0], right[0]);
}

#[test]
fn without_truth_the_points_of_the_scans_are_the_reference() {
    let folder = Folder::new();
    let set = sphere(&folder);
    fs::remove_file(folder.path("sphere/scene.ply")).unwrap();
    let run = tsdfuse(&[
        "evaluate",
        &set,
        "--methods",
        "normals",
        "--samples",
        "2000",
        "--every",
        "2",
        "--scans",
        "0..8",
    ])
    .succeeded();
    let text = String::from_utf8(run.stdout).unwrap();
    assert!(
        text.contains("Distance to the reference") && text.contains("\n  normals "),
        "{text}"
    );
    assert!(
        text.contains("Held-out scans") && text.contains("Speed and memory"),
        "{text}"
    );
    let run = tsdfuse(&[
        "evaluate",
        &set,
        "--methods",
        "normals",
        "--samples",
        "2000",
        "--json",
        "--every",
        "2",
    ])
    .succeeded();
    assert_eq!(run.json()["reference"]["words"], "the points of one of 2 of 12 scans");
    assert_eq!(run.json()["reference"]["protocol"]["name"], "thesis");
}

#[test]
fn tuning_prefers_what_predicts_held_out_scans() {
    let folder = Folder::new();
    let set = sphere(&folder);
    // Hardly a sphere any more.
    let bad = "raycast:map.voxel_size_m=0.5,map.truncation_m=0.5";
    let arguments = [
        "evaluate",
        &set,
        "--tune",
        "--method-set",
        bad,
        "--methods",
        "raycast-projective",
        "--json",
        "--voxel-size",
        "0.05",
    ];
    let found = tsdfuse(&arguments).succeeded().json();
    assert_eq!(
        (&found["scans"], &found["all_scans"], &found["out_of_time"]),
        (&12.into(), &12.into(), &false.into())
    );
    assert_eq!(found["tried"], found["candidates"]);
    let best = &found["ranking"][0];
    assert_eq!(best["name"], "raycast-projective");
    let command = best["command"].as_str().unwrap();
    assert!(
        command.starts_with("tsdfuse fuse ") && command.contains(" --voxel-size 0.05 "),
        "{command}"
    );
    // What it says is what one runs.
    let words: Vec<&str> = command
        .split(' ')
        .skip(1)
        .map(|w| if w == "mesh.ply" { "-" } else { w })
        .collect();
    assert!(tsdfuse(&words).succeeded().stdout.len() > 100_000);
}

#[test]
fn a_search_skips_what_cannot_be_used_only_if_it_may() {
    let folder = Folder::new();
    let set = sphere(&folder);
    fs::write(folder.path("sphere/velodyne/000006.bin"), [1; 7]).unwrap();
    let tune = [
        "evaluate",
        &set,
        "--tune",
        "--methods",
        "raycast-projective",
        "--json",
        "--voxel-size",
        "0.05",
    ];
    let told = tsdfuse(&tune);
    assert_eq!(told.code, 1, "{}", told.stderr);
    assert!(
        told.stderr.contains("000006") && told.stderr.contains("no method could be run"),
        "{}",
        told.stderr
    );
    let run = tsdfuse(&[&tune[..], &["--skip-bad"]].concat());
    assert_eq!(run.code, 3, "{}", run.stderr);
    assert!(run.stderr.contains("skipped 000006"), "{}", run.stderr);
    let found = run.json();
    assert_eq!(
        (&found["scans"], found["skipped_scans"].as_array().unwrap().len()),
        (&12.into(), 1)
    );
    assert!(
        found["ranking"][0]["command"]
            .as_str()
            .unwrap()
            .contains(" --skip-bad ")
    );
}

#[test]
fn results_go_neither_into_the_log_nor_over_what_is_read_and_leave_nothing_on_failure() {
    let folder = Folder::new();
    let set = sphere(&folder);
    let before = names(&folder.path("sphere"));
    let methods = ["--methods", "raycast", "--samples", "1000", "--runs", "1"];
    let evaluate = |more: &[&str]| tsdfuse(&[&["evaluate", set.as_str()], &methods[..], more].concat());
    for inside in ["sphere", "sphere/results"] {
        let told = evaluate(&["-o", &folder.text(inside)]).failed(2);
        assert!(told.contains("results do not go into the log"), "{told}");
    }
    assert_eq!(names(&folder.path("sphere")), before);
    fs::create_dir(folder.path("out")).unwrap();
    let config = folder.text("out/table.md");
    fs::write(&config, "method = \"raycast\"\n").unwrap();
    let told = evaluate(&["-o", &folder.text("out"), "--config", &config]).failed(2);
    assert!(told.contains("would overwrite"), "{told}");
    for (wrong, code) in [
        (&["--margin", "0"][..], 2),
        (&["--set", "map.voxel_size_m=-1"], 2),
        (&["--reference", "nowhere.ply"], 1),
        (&["--set", "mesh.min_weight=1e9"], 1),
    ] {
        let told = evaluate(&[&["-o", &folder.text("new")], wrong].concat());
        assert_eq!(told.code, code, "{wrong:?}: {}", told.stderr);
        assert!(!folder.path("new").exists(), "{wrong:?}");
    }
}

/// What `evaluate` runs in a process of its own.
#[test]
fn a_job_comes_as_json_and_its_report_goes_as_json() {
    let folder = Folder::new();
    let set = sphere(&folder);
    let run_job = |job: &str| {
        let mut process = command(&["run-job"]).stdin(Stdio::piped()).spawn().unwrap();
        process.stdin.take().unwrap().write_all(job.as_bytes()).unwrap();
        process.wait_with_output().unwrap()
    };
    let mesh = folder.text("mesh.ply");
    let job = serde_json::json!({
        "input": { "path": set, "selection": { "from": 0, "to": 3, "step": 1, "hold_out": null } },
        "settings": { "method": "raycast" },
        "outputs": { "mesh": mesh },
    });
    let done = run_job(&job.to_string());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(report["Ok"]["totals"]["scans"], 3);
    assert_eq!(report["Ok"]["mesh"]["triangles"], ply::read(&folder.path("mesh.ply")).1);
    let nowhere = run_job(&serde_json::json!({ "input": { "path": "nowhere" } }).to_string());
    let told: Value = serde_json::from_slice(&nowhere.stdout).unwrap();
    assert!(told["Err"].as_str().unwrap().contains("nowhere"), "{told}");
    let broken = run_job("{");
    let told = String::from_utf8(broken.stderr).unwrap();
    assert!(broken.status.code() == Some(1) && told.contains("not a job"), "{told}");
}

#[test]
fn what_cannot_be_evaluated_is_said_in_a_line() {
    let folder = Folder::new();
    let set = sphere(&folder);
    let failed = |arguments: &[&str], code| tsdfuse(&[&["evaluate", set.as_str()], arguments].concat()).failed(code);
    let line = failed(&["--methods", "magic"], 2);
    assert!(
        line.contains("no method magic; there are all, raycast, raycast-projective"),
        "{line}"
    );
    let line = failed(&["--hold-out", "40"], 2);
    assert!(
        line.contains("12 scans are too few to hold out the middle one of each 40"),
        "{line}"
    );
    let line = failed(&["--hold-out", "1"], 2);
    assert!(line.contains("would hold out every scan"), "{line}");
    let line = failed(&["--scans", "3..4"], 2);
    assert!(line.contains("one scan is too few to hold one out"), "{line}");
    let line = failed(&["--method-set", "raycast:raycast.distance=far"], 2);
    assert!(line.contains("unknown variant `far`"), "{line}");
    let line = failed(&["--reference", &folder.text("none.ply")], 1);
    assert!(line.contains("none.ply: "), "{line}");
    let line = failed(&["--margin", "0"], 2);
    assert!(line.contains("--margin must be a positive length"), "{line}");
    let line = failed(&["--samples", "1"], 2);
    assert!(line.contains("samples must be"), "{line}");
    let line = failed(&["--methods", "depth"], 1);
    assert!(line.contains("depth: "), "{line}");
    let line = failed(&["--tune", "--budget", "0", "--methods", "raycast"], 1);
    assert!(line.contains("time ran out before anything was measured"), "{line}");

    // A reference of another place is a warning: the figures stand.
    let away = folder.simulate("away", "sphere", "vlp16", 2, &["--offset", "500,0,0"]);
    let reference = format!("{away}/scene.ply");
    let arguments = [
        "evaluate",
        &set,
        "--methods",
        "raycast",
        "--samples",
        "1000",
        "--hold-out",
        "0",
        "--reference",
        &reference,
    ];
    let run = tsdfuse(&arguments).succeeded();
    assert!(run.stderr.contains("do not overlap"), "{}", run.stderr);
}
