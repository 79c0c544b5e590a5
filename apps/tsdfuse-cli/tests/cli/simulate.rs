//! `tsdfuse simulate`: what it writes, and that it repeats itself.

use std::fs;
use std::path::{Path, PathBuf};

use crate::ply;
use crate::run::{Folder, names, tsdfuse};

/// All files below a folder, relative to it, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    for name in names(folder) {
        if folder.join(&name).is_dir() {
            all.extend(files(&folder.join(&name)).into_iter().map(|f| Path::new(&name).join(f)));
        } else {
            all.push(name.into());
        }
    }
    all
}

#[test]
fn a_sequence_is_complete_and_repeatable() {
    let folder = Folder::new();
    for name in ["a", "b"] {
        tsdfuse(&[
            "simulate",
            "--scene",
            "box",
            "--sensor",
            "vlp16",
            "--scans",
            "2",
            "--motion",
            "--seed",
            "7",
            "-o",
            &folder.text(name),
        ])
        .succeeded();
    }
    let (a, b) = (folder.path("a"), folder.path("b"));
    let wanted = [
        "hits.ply",
        "motion.txt",
        "poses.txt",
        "rings/000000.u16",
        "rings/000001.u16",
        "scene.ply",
        "sensor.toml",
        "simulation.toml",
        "times/000000.f32",
        "times/000001.f32",
        "times.txt",
        "velodyne/000000.bin",
        "velodyne/000001.bin",
    ];
    assert_eq!(files(&a), wanted.map(PathBuf::from));
    assert_eq!(files(&b), files(&a));
    for file in files(&a) {
        assert!(
            fs::read(a.join(&file)).unwrap() == fs::read(b.join(&file)).unwrap(),
            "{}",
            file.display()
        );
    }
    assert_eq!(ply::read(&a.join("scene.ply")).1, 12);
    // On the box, though the returns are noisy and the sensor moved.
    let (hits, _) = ply::read(&a.join("hits.ply"));
    let scene = tsdfuse_sim::scene::by_name("box", 7).unwrap();
    assert!(hits.len() > 500 && hits.iter().all(|p| scene.signed_distance(*p).abs() < 1e-5));
    assert!(
        fs::read_to_string(a.join("simulation.toml"))
            .unwrap()
            .contains("seed = 7\n")
    );
}

#[test]
fn an_offset_moves_the_poses_and_leaves_the_scans() {
    let folder = Folder::new();
    let here = folder.simulate("here", "box", "vlp16", 2, &["--path", "orbit"]);
    let there = folder.simulate(
        "there",
        "box",
        "vlp16",
        2,
        &["--path", "orbit", "--offset", "-691000,5335000,520"],
    );
    let read = |set: &str, file: &str| fs::read(Path::new(set).join(file)).unwrap();
    assert!(read(&here, "velodyne/000001.bin") == read(&there, "velodyne/000001.bin"));
    assert!(read(&here, "poses.txt") != read(&there, "poses.txt"));
    let (vertices, _) = ply::read(&Path::new(&there).join("scene.ply"));
    assert!(vertices.iter().all(|v| (v.y - 5_335_000.0).abs() < 3.0));
}

#[test]
fn noise_is_what_was_asked_for() {
    let folder = Folder::new();
    let clean = folder.simulate("clean", "plane", "vlp16", 1, &[]);
    let noisy = folder.simulate("noisy", "plane", "vlp16", 1, &["--noise", "0.1"]);
    let lossy = folder.simulate("lossy", "plane", "vlp16", 1, &["--dropout", "0.5"]);
    let grazing = folder.simulate("grazing", "plane", "vlp16", 1, &["--grazing-loss", "on"]);
    let ranges = |set: &str| -> Vec<f32> {
        let bytes = fs::read(Path::new(set).join("velodyne/000000.bin")).unwrap();
        let points = bytes
            .chunks_exact(16)
            .map(|p| [0, 4, 8].map(|i| f32::from_le_bytes(p[i..i + 4].try_into().unwrap())));
        points.map(|p| glam::Vec3::from(p).length()).collect()
    };
    let (clean, noisy, lossy, grazing) = (ranges(&clean), ranges(&noisy), ranges(&lossy), ranges(&grazing));
    let errors = clean.iter().zip(&noisy).map(|(c, n)| f64::from(n - c));
    let sigma = (errors.map(|e| e * e).sum::<f64>() / clean.len() as f64).sqrt();
    assert!((0.09..0.11).contains(&sigma), "{sigma}");
    let left = lossy.len() as f64 / clean.len() as f64;
    assert!((0.45..0.55).contains(&left), "{left}");
    assert!(grazing.len() < clean.len());
}

#[test]
fn what_is_there_is_not_overwritten() {
    let folder = Folder::new();
    fs::create_dir(folder.path("full")).unwrap();
    fs::write(folder.path("full/mine"), "mine").unwrap();
    let scan = |more: &[&str]| {
        let mut arguments = vec!["simulate", "--sensor", "vlp16", "--scans", "1"];
        arguments.extend(more);
        tsdfuse(&arguments)
    };
    let line = scan(&["--scene", "box", "-o", &folder.text("full")]).failed(1);
    assert!(line.contains("full: is not empty; name a new folder"), "{line}");
    let line = scan(&["--scene", "box", "-o", &folder.text("full/mine")]).failed(1);
    assert!(line.contains("full/mine: "), "{line}");
    let line = scan(&["--scene", "box", "-o", &folder.text("no/where")]).failed(1);
    assert!(line.contains("no/where: "), "{line}");
    let line = scan(&["--scene", "moon", "-o", &folder.text("new")]).failed(2);
    assert!(
        line.contains("'moon'") && line.contains("possible values: street, hall"),
        "{line}"
    );
    let line = scan(&["--scene", "box", "--noise", "nan", "-o", &folder.text("new")]).failed(2);
    assert!(line.contains("range_sigma_m"), "{line}");
    let line = scan(&["--scene", "box", "--offset", "1,2", "-o", &folder.text("new")]).failed(2);
    assert!(line.contains("three numbers"), "{line}");
    assert_eq!(
        (names(&folder.path("")), names(&folder.path("full"))),
        (vec!["full".into()], vec!["mine".into()])
    );
}
