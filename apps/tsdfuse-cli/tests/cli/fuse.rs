//! `tsdfuse fuse` on simulated and real scans.

use std::fs;
use std::io::Read;

use glam::DVec3;
use serde_json::Value;

use crate::ply;
use crate::run::{Folder, command, names, tsdfuse};

/// Mean and largest distance of points from the sphere of 2 m about `center`.
fn off_sphere(vertices: &[DVec3], center: DVec3) -> (f64, f64) {
    let off = || vertices.iter().map(|v| (v.distance(center) - 2.0).abs());
    (off().sum::<f64>() / vertices.len() as f64, off().fold(0.0, f64::max))
}

#[test]
fn a_sphere_becomes_a_sphere_by_each_method_also_from_a_moving_sensor_far_from_the_origin() {
    let folder = Folder::new();
    let utm = DVec3::new(691_000.0, 5_335_000.0, 520.0);
    let motion_at_utm = ["--motion", "--offset", "691000,5335000,520"];
    for (name, more, center) in [("still", &[][..], DVec3::ZERO), ("moving", &motion_at_utm, utm)] {
        let set = folder.simulate(name, "sphere", "pandar64", 12, more);
        for setting in ["raycast.distance=projective", "method=normals"] {
            let mesh = folder.text(&format!("{name}.ply"));
            tsdfuse(&["fuse", &set, "-o", &mesh, "--set", setting]).succeeded();
            let (vertices, triangles) = ply::read(mesh.as_ref());
            let (mean, worst) = off_sphere(&vertices, center);
            assert!(triangles > 10_000, "{name} {setting}: {triangles}");
            assert!(mean < 0.01 && worst < 0.12, "{name} {setting}: {mean} {worst}");
        }
    }
}

#[test]
fn a_method_that_collects_scans_fuses_them_at_the_end_and_the_report_says_so() {
    let folder = Folder::new();
    let set = folder.simulate("sphere", "sphere", "pandar64", 12, &["--motion"]);
    let run = |form: &str| {
        let mesh = folder.text(&format!("{form}.ply"));
        let setting = format!("roldao.form={form}");
        let fuse = [
            "fuse", &set, "-o", &mesh, "--method", "roldao", "--set", &setting, "--json",
        ];
        let run = tsdfuse(&fuse).succeeded();
        let (vertices, triangles) = ply::read(mesh.as_ref());
        assert!(triangles > 10_000, "{form}: {triangles}");
        (run.json(), run.stderr, off_sphere(&vertices, DVec3::ZERO).0)
    };
    let updated = |scan: &Value| scan["updated_blocks"].as_u64().unwrap();
    for (form, at_the_end) in [("scan", false), ("batch", true)] {
        let (report, told, off) = run(form);
        assert!(off < 0.03, "{form}: {off}");
        let finish = &report["totals"]["finish"];
        let blocks = if at_the_end {
            report["map"]["blocks"].as_u64().unwrap()
        } else {
            0
        };
        assert_eq!(
            (updated(finish), told.contains(", finish ")),
            (blocks, at_the_end),
            "{form}: {told}"
        );
        let scans = report["scans"].as_array().unwrap();
        assert!(scans.iter().all(|scan| (updated(scan) == 0) == at_the_end), "{form}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 8, &["--motion"]);
    let [one, two] = ["1", "2"].map(|threads| {
        let mesh = folder.text(threads);
        tsdfuse(&["fuse", &set, "-o", &format!("{mesh}.ply"), "--threads", threads]).succeeded();
        fs::read(format!("{mesh}.ply")).unwrap()
    });
    assert!(one.len() > 100_000);
    assert!(one == two, "the meshes of one and two threads differ");
}

#[test]
fn the_report_accounts_for_every_point_and_setting() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 5, &[]);
    fs::write(
        folder.path("run.toml"),
        "[map]\nvoxel_size_m = 0.1\ntruncation_m = 0.3\nmax_weight = 9",
    )
    .unwrap();
    let (config, report, mesh) = (
        folder.text("run.toml"),
        folder.text("report.json"),
        folder.text("mesh.ply"),
    );
    let run = tsdfuse(&[
        "fuse",
        &set,
        "-o",
        &mesh,
        "--report",
        &report,
        "--json",
        "--threads",
        "2",
        "--scans",
        "1..9:2",
        "--config",
        &config,
        "--set",
        "map.truncation_m=0.2",
        "--set",
        "map.voxel_size_m=7",
        "--voxel-size",
        "0.08",
        "--max-range",
        "5.5",
    ])
    .succeeded();
    let report: Value = serde_json::from_slice(&fs::read(report).unwrap()).unwrap();
    assert_eq!(report, run.json());
    assert_eq!(
        report["config"]["map"],
        serde_json::json!({"voxel_size_m": 0.08, "truncation_m": 0.2, "max_weight": 9.0})
    );
    assert_eq!(
        report["config"]["range"],
        serde_json::json!({"min_range_m": 0.5, "max_range_m": 5.5})
    );
    assert_eq!(
        (&report["threads"], &report["dataset"]["scans"]),
        (&2.into(), &5.into())
    );
    assert_eq!(report["dataset"]["sensor"]["name"], "vlp16");

    let scans = report["scans"].as_array().unwrap();
    assert_eq!(
        scans.iter().map(|s| s["name"].as_str().unwrap()).collect::<Vec<_>>(),
        ["000001.bin", "000003.bin"]
    );
    let sum = |counters: &Value| {
        counters
            .as_object()
            .unwrap()
            .values()
            .map(|n| n.as_u64().unwrap())
            .sum::<u64>()
    };
    for part in scans.iter().chain([&report["totals"]]) {
        let used = part["fused"].as_u64().unwrap();
        assert!(used > 0 && part["dropped"]["too_far"].as_u64().unwrap() > 0);
        assert_eq!(
            part["points"].as_u64().unwrap(),
            used + sum(&part["dropped"]) + sum(&part["skipped"])
        );
        for seconds in ["read", "prepare", "fuse"] {
            assert!((0.0..60.0).contains(&part[seconds].as_f64().unwrap()), "{seconds}");
        }
    }
    let points = fs::metadata(folder.path("box/velodyne/000001.bin")).unwrap().len() / 16;
    assert_eq!(scans[0]["points"], points);
    let (vertices, triangles) = ply::read(mesh.as_ref());
    assert_eq!(
        (&report["mesh"]["vertices"], &report["mesh"]["triangles"]),
        (&vertices.len().into(), &triangles.into())
    );
    assert!(
        run.stderr
            .contains("tsdfuse: note: --scans ends at 9, but there are only 5 scans"),
        "{}",
        run.stderr
    );
    assert!(
        run.stderr.contains("2 scans fused in") && run.stderr.contains("too far"),
        "{}",
        run.stderr
    );
}

#[test]
fn a_mesh_can_go_to_standard_output() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 3, &[]);
    let mesh = folder.path("mesh.ply");
    tsdfuse(&["fuse", &set, "-o", mesh.to_str().unwrap()]).succeeded();
    let piped = tsdfuse(&["fuse", &set, "-o", "-"]).succeeded();
    assert!(piped.stdout == fs::read(mesh).unwrap());
}

#[test]
fn the_extension_says_how_the_mesh_is_written() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 3, &[]);
    for (name, begins) in [("mesh.ply", "ply\n"), ("mesh.glb", "glTF"), ("mesh.OBJ", "")] {
        tsdfuse(&["fuse", &set, "-o", &folder.text(name)]).succeeded();
        let bytes = fs::read(folder.path(name)).unwrap();
        assert!(bytes.starts_with(begins.as_bytes()) && bytes.len() > 10_000, "{name}");
    }
}

#[test]
fn a_closed_pipe_ends_the_run_quietly() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 3, &[]);
    for arguments in [&["fuse", &set, "-o", "-"][..], &["info", &set, "--json"], &["--help"]] {
        let mut child = command(arguments).spawn().unwrap();
        drop(child.stdout.take());
        let mut told = String::new();
        child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
        let code = child.wait().unwrap().code();
        assert_eq!(
            (told.as_str(), code),
            ("", Some(if arguments == ["--help"] { 0 } else { 1 })),
            "{arguments:?}"
        );
    }
}

#[test]
fn bad_scans_are_skipped_and_named_where_that_is_asked_for() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 4, &[]);
    fs::write(folder.path("box/velodyne/000002.bin"), [0; 33]).unwrap();
    let mesh = folder.text("mesh.ply");
    let run = tsdfuse(&["fuse", &set, "-o", &mesh, "--skip-bad", "--json"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    assert!(
        run.stderr.contains("tsdfuse: warning: skipped 000002.bin: "),
        "{}",
        run.stderr
    );
    let report = run.json();
    assert_eq!(report["scans"].as_array().unwrap().len(), 3);
    assert_eq!(report["skipped_scans"].as_array().unwrap().len(), 1);
    assert_eq!(report["skipped_scans"][0]["name"], "000002.bin");
    assert!(ply::read(mesh.as_ref()).1 > 0);

    fs::remove_file(mesh).unwrap();
    let none = tsdfuse(&[
        "fuse",
        &set,
        "-o",
        &folder.text("mesh.ply"),
        "--skip-bad",
        "--scans",
        "2..3",
    ]);
    assert_eq!(none.code, 1);
    assert!(
        none.stderr.ends_with("none of its scans could be fused\n"),
        "{}",
        none.stderr
    );
    assert_eq!(names(&folder.path("")), ["box"]);
}

#[test]
fn the_sample_of_pandaset_fuses() {
    let folder = Folder::new();
    let (sample, mesh) = (
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../sample/pandaset-002"),
        folder.text("mesh.ply"),
    );
    let run = tsdfuse(&[
        "fuse",
        sample,
        "-o",
        &mesh,
        "--voxel-size",
        "0.1",
        "--truncation",
        "0.3",
        "--json",
    ])
    .succeeded();
    let report = run.json();
    assert_eq!(
        (&report["dataset"]["format"], &report["dataset"]["sensor"]["name"]),
        (&"PandaSet".into(), &"pandar64".into())
    );
    assert_eq!(report["totals"]["scans"], 3);
    // The vehicle itself, about 640 returns a scan.
    assert_eq!(report["config"]["range"]["min_range_m"], 2.0);
    let too_near = report["totals"]["dropped"]["too_near"].as_u64().unwrap();
    assert!((1500..2400).contains(&too_near), "{too_near}");
    assert!(report["totals"]["fused"].as_u64().unwrap() > 300_000);
    assert!(ply::read(mesh.as_ref()).1 > 100_000);
}

#[test]
fn the_mesh_file_grows_while_scans_are_fused_and_ends_the_same() {
    let folder = Folder::new();
    let set = folder.simulate("sphere", "sphere", "pandar64", 6, &[]);
    let fuse = |name: &str, more: &[&str]| {
        let mesh = folder.text(name);
        (tsdfuse(&[&["fuse", &set, "-o", &mesh, "--json"], more].concat()), mesh)
    };
    let (run, whole) = fuse("whole.ply", &[]);
    assert_eq!(run.succeeded().json()["growth"], Value::Null);
    let (run, grown) = fuse("grown.ply", &["--mesh-every", "2"]);
    assert_eq!(run.succeeded().json()["growth"]["meshes"], 3);
    assert_eq!(fs::read(&grown).unwrap(), fs::read(&whole).unwrap());

    // Where the run ends early, the mesh of the scans before stands there.
    let (run, four) = fuse("four.ply", &["--scans", "0..4"]);
    run.succeeded();
    fs::write(format!("{set}/velodyne/000005.bin"), [0; 7]).unwrap();
    let (run, cut) = fuse("cut.ply", &["--mesh-every", "2"]);
    run.failed(1);
    assert_eq!(fs::read(cut).unwrap(), fs::read(four).unwrap());

    for (output, said) in [("-", "--mesh-every needs a file"), (&*grown, "invalid value '0'")] {
        let every = if output == "-" { "1" } else { "0" };
        let run = tsdfuse(&["fuse", &set, "-o", output, "--mesh-every", every]);
        assert!(run.code == 2 && run.stderr.contains(said), "{}", run.stderr);
    }
}
