//! `--device gpu`; without any adapter these tests say so and pass, unless `TSDFUSE_REQUIRE_GPU` is set.

use crate::ply;
use crate::run::{Folder, tsdfuse};

/// Whether there is a device to test with.
fn has_gpu() -> bool {
    let there = tsdfuse_gpu::Gpu::open(None).is_ok();
    if !there {
        assert!(std::env::var_os("TSDFUSE_REQUIRE_GPU").is_none(), "there is no GPU");
        eprintln!("skipped: there is no GPU");
    }
    there
}

#[test]
fn a_gpu_makes_the_mesh_that_the_cpu_makes() {
    if !has_gpu() {
        return;
    }
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 5, &["--motion"]);
    let run = |device: &str| {
        let mesh = folder.text(&format!("{device}.ply"));
        let run = tsdfuse(&["fuse", &set, "-o", &mesh, "--device", device, "--json"]).succeeded();
        (run.json(), ply::read(mesh.as_ref()).1)
    };
    let ((cpu, triangles), (gpu, on_gpu)) = (run("cpu"), run("gpu"));
    assert!(triangles > 1000);
    assert!(on_gpu.abs_diff(triangles) < triangles / 500, "{triangles} {on_gpu}");
    assert!(gpu["device"].as_str().unwrap().contains('('), "{}", gpu["device"]);
    assert!(cpu["device"].is_null());
    assert_eq!(gpu["map"]["blocks"], cpu["map"]["blocks"]);
    let scans = |report: &serde_json::Value| report["scans"].as_array().unwrap().clone();
    assert_eq!(scans(&gpu).len(), 5);
    for (a, b) in scans(&gpu).iter().zip(&scans(&cpu)) {
        for key in ["name", "points", "fused", "dropped", "skipped", "updated_blocks"] {
            assert_eq!(a[key], b[key], "{key}");
        }
    }
}

#[test]
fn a_saved_map_is_meshed_and_seen_by_both_alike() {
    if !has_gpu() {
        return;
    }
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 5, &[]);
    let map = folder.text("map.tsdf");
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let run = |device: &str| {
        let (mesh, view) = (
            folder.text(&format!("{device}.ply")),
            folder.text(&format!("{device}.png")),
        );
        let device = ["--json", "--device", device];
        let mesh = tsdfuse(&[&["mesh", &map, "-o", &mesh][..], &device].concat())
            .succeeded()
            .json();
        let view = tsdfuse(&[&["render", &map, "-o", &view, "--size", "160x90"][..], &device].concat());
        let pixels = view.succeeded().json()["views"][0]["surface_pixels"].as_u64().unwrap();
        (
            mesh["mesh"]["vertices"].clone(),
            mesh["mesh"]["triangles"].clone(),
            pixels,
        )
    };
    let (cpu, gpu) = (run("cpu"), run("gpu"));
    assert!(cpu.2 > 500, "{cpu:?}");
    assert_eq!((&cpu.0, &cpu.1), (&gpu.0, &gpu.1));
    assert!(gpu.2.abs_diff(cpu.2) <= cpu.2 / 500, "{cpu:?} {gpu:?}");
}

#[test]
fn patches_are_continued_followed_and_seen_on_a_gpu() {
    if !has_gpu() {
        return;
    }
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 5, &["--motion"]);
    let [mesh, half, all, view] = ["mesh.ply", "half.tsdf", "all.tsdf", "view.png"].map(|name| folder.text(name));
    let run = |more: &[&str]| {
        let coarse = ["--voxel-size", "0.1"];
        let base = ["fuse", &set, "--method", "patch", "--sensor", "vlp16", "--json"];
        tsdfuse(&[&base[..], &coarse, more].concat()).succeeded().json()
    };
    let cpu = run(&["-o", &mesh]);
    let triangles = ply::read(mesh.as_ref()).1;
    let gpu = ["--device", "gpu"];
    run(&[&["--scans", "0..3", "--save-map", &half][..], &gpu].concat());
    let rest = ["--scans", "3..5", "--load-map", &half, "-o", &mesh, "--mesh-every", "1"];
    let report = run(&[&rest[..], &["--save-map", &all, "--preview", &view], &gpu].concat());
    assert_eq!(report["loaded_map"]["integrations"], 3);
    assert_eq!(report["growth"]["meshes"], 2);
    assert_eq!(report["map"]["blocks"], cpu["map"]["blocks"]);
    let on_gpu = ply::read(mesh.as_ref()).1;
    assert!(
        triangles > 1000 && on_gpu.abs_diff(triangles) < triangles / 100,
        "{triangles} {on_gpu}"
    );
    assert!(report["preview"]["surface_pixels"].as_u64().unwrap() > 500, "{report}");
    let again = run(&["--scans", "4..5", "--load-map", &all, "-o", &mesh]);
    assert_eq!(again["loaded_map"]["integrations"], 5);
}

#[test]
fn what_a_gpu_cannot_do_is_told_in_one_sentence() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let mesh = folder.text("mesh.ply");
    let fuse = |more: &[&str]| tsdfuse(&[&["fuse", &set, "-o", &mesh], more].concat());
    let told = fuse(&["--device", "gpu", "--memory", "1G"]).failed(2);
    assert!(told.contains("leave out --device"), "{told}");
    let wrong = fuse(&["--device", "tpu"]);
    assert!(
        wrong.code == 2 && wrong.stderr.contains("cpu, gpu or gpu:NAME is wanted"),
        "{}",
        wrong.stderr
    );
    let told = fuse(&["--device", "gpu:no such adapter"]).failed(1);
    assert!(told.contains("no GPU can be used"), "{told}");
    if has_gpu() {
        let told = fuse(&["--device", "gpu", "--method", "surfel"]).failed(2);
        assert!(
            told.contains("surfel does not run on the GPU; there are raycast"),
            "{told}"
        );
    }
}

#[test]
fn a_gpu_is_measured_kernel_by_kernel() {
    if !has_gpu() {
        return;
    }
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let bench = [
        "bench",
        &set,
        "--device",
        "gpu",
        "--runs",
        "1",
        "--voxel-size",
        "0.2",
        "--truncation",
        "0.6",
    ];
    let methods = ["--methods", "raycast,surfel"];
    let results = tsdfuse(&[&bench[..], &methods, &["--json"]].concat())
        .succeeded()
        .json();
    let raycast = &results["methods"][0];
    assert!(raycast["triangles"].as_u64().unwrap() > 100);
    for key in ["scan", "mesh", "view"] {
        assert!(raycast[key][0].as_f64().unwrap() > 0.0, "{key}");
    }
    let kernels = raycast["kernels"].as_array().unwrap();
    assert!(
        kernels.is_empty() || kernels.iter().any(|k| k["name"] == "fuse" && k["passes"] == 2),
        "{kernels:?}"
    );
    assert!(
        results["failed"][0]["reason"]
            .as_str()
            .unwrap()
            .contains("surfel does not run on the GPU")
    );
}
