//! `tsdfuse eval`.

use std::fs;

use serde_json::Value;

use crate::run::{Folder, tsdfuse};

/// A simulated plane without noise, fused.
fn plane() -> (Folder, String, String) {
    let folder = Folder::new();
    let set = folder.simulate("plane", "plane", "vlp16", 8, &["--path", "vehicle"]);
    let mesh = folder.text("plane.ply");
    tsdfuse(&[
        "fuse",
        &set,
        "-o",
        &mesh,
        "--max-range",
        "12",
        "--set",
        "raycast.distance=projective",
    ])
    .succeeded();
    (folder, set, mesh)
}

/// A PLY of a square about the plane's middle, at a height, in a unit.
fn square(folder: &Folder, name: &str, z: f64, unit: f64) -> String {
    let corners = [(-30, -30), (60, -30), (60, 30), (-30, 30)].map(|(x, y)| (f64::from(x) * unit, f64::from(y) * unit));
    let rows: Vec<_> = corners.iter().map(|(x, y)| format!("{x} {y} {}\n", z * unit)).collect();
    let header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
                  element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let path = folder.path(name);
    fs::write(&path, format!("{header}{}4 0 1 2 3\n", rows.concat())).unwrap();
    path.to_str().unwrap().to_owned()
}

fn number(value: &Value, path: &str) -> f64 {
    let found = value.pointer(path).and_then(Value::as_f64);
    assert!(found.is_some(), "{path}: {value}");
    found.unwrap()
}

#[test]
fn a_fused_plane_is_near_the_true_one_and_farther_from_a_wrong_one() {
    let (folder, set, mesh) = plane();
    let mean_m = |reference: &str, more: &[&str]| {
        let arguments = [
            &["eval", &mesh, "--reference", reference, "--json", "--samples", "20000"],
            more,
        ]
        .concat();
        let found = tsdfuse(&arguments).succeeded().json();
        (number(&found, "/all/mesh_to_reference/mean_m"), found)
    };
    let (truth, found) = mean_m(&square(&folder, "truth.ply", 0.0, 1.0), &[]);
    // Grazing incidence, 5 cm voxels.
    assert!(truth < 0.012, "{truth}");
    assert_eq!(
        (
            number(&found, "/all/thresholds/0/precision"),
            &found["inputs"]["reference"]
        ),
        (1.0, &"mesh".into())
    );
    // A disturbed reference shows its disturbance.
    let (disturbed, found) = mean_m(&square(&folder, "higher.ply", 0.08, 1.0), &[]);
    assert!((disturbed - 0.08).abs() < 0.012, "{disturbed}");
    let [at_5_cm, at_10_cm] = [0, 1].map(|i| number(&found, &format!("/all/thresholds/{i}/precision")));
    assert!(at_5_cm < 0.1 && at_10_cm > 0.85, "{at_5_cm} {at_10_cm}");
    // Against the points that it came from, by the thesis's rules.
    let (_, all) = mean_m(&set, &["--protocol", "thesis", "--crop=-2,-5,-1,12,5,1"]);
    let (_, fourth) = mean_m(
        &set,
        &["--protocol", "thesis", "--crop=-2,-5,-1,12,5,1", "--every", "4"],
    );
    let points = |found: &Value| number(found, "/inputs/reference_points");
    assert!(
        (3.5..4.5).contains(&(points(&all) / points(&fourth))),
        "{} {}",
        points(&all),
        points(&fourth)
    );
    // Rings are far apart: the plane is closed between them, so samples there are far from points.
    let at_10_cm = ["precision", "completeness"].map(|share| number(&all, &format!("/all/thresholds/1/{share}")));
    assert!((0.6..0.8).contains(&at_10_cm[0]) && at_10_cm[1] > 0.9, "{at_10_cm:?}");
    assert_eq!(all["protocol"]["sampling"], "poisson_disk");
}

#[test]
fn errors_become_colours() {
    let (folder, _, mesh) = plane();
    let higher = square(&folder, "higher.ply", 0.08, 1.0);
    for name in ["errors.ply", "errors.glb"] {
        let colored = folder.text(name);
        let run = tsdfuse(&[
            "eval",
            &mesh,
            "--reference",
            &higher,
            "--colored",
            &colored,
            "--max-error",
            "0.05",
        ]);
        let table = String::from_utf8(run.succeeded().stdout).unwrap();
        assert!(table.contains("mesh → reference") && table.contains("50 mm"), "{table}");
        let bytes = fs::read(folder.path(name)).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        assert!(
            text.contains("property uchar red") || text.contains("COLOR_0"),
            "{name}"
        );
        if name == "errors.ply" {
            // All is beyond the scale: yellow, the last three bytes of the first vertex.
            let start = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            assert_eq!(bytes[start + 24..start + 27], [253, 231, 37]);
        }
    }
}

#[test]
fn wrong_inputs_are_named() {
    let (folder, set, mesh) = plane();
    let truth = square(&folder, "truth.ply", 0.0, 1.0);
    let cloud = folder.path("cloud.ply");
    let header =
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    fs::write(&cloud, format!("{header}nan 0 0\nnan nan nan\n")).unwrap();
    let cloud = cloud.to_str().unwrap();
    let failed = |arguments: &[&str], code: i32| tsdfuse(&[&["eval"], arguments].concat()).failed(code);
    let told = failed(&[cloud, "--reference", &truth], 1);
    assert!(
        told.contains("cloud.ply: is a cloud of 2 points, not a mesh: it has no faces"),
        "{told}"
    );
    let told = failed(&[&mesh, "--reference", cloud], 1);
    assert!(
        told.contains("cloud.ply: none of the 2 points of the reference is finite"),
        "{told}"
    );
    let told = failed(&[&mesh, "--reference", &truth, "--crop", "100,100,100,101,101,101"], 1);
    assert!(told.contains("no part of the mesh lies within the crop"), "{told}");
    let told = failed(&[&mesh, "--reference", &truth, "--thresholds", "0.05,-1"], 2);
    assert!(told.contains("thresholds_m must be more than 0, not -1"), "{told}");
    let told = failed(&[&mesh, "--reference", &truth, "--colored", "a.obj"], 2);
    assert!(
        told.contains("a.obj: a coloured mesh is written as .ply or .glb"),
        "{told}"
    );
    for input in [&mesh, &truth] {
        let before = fs::read(input).unwrap();
        let told = failed(&[&mesh, "--reference", &truth, "--colored", input], 2);
        assert!(told.contains("would overwrite"), "{told}");
        assert!(fs::read(input).unwrap() == before);
    }
    let told = failed(&[&set, "--reference", &truth], 1);
    assert!(told.contains("is none of .ply, .obj, .glb and .pcd"), "{told}");
    assert_eq!(
        tsdfuse(&["eval", &mesh, "--reference", &truth, "--protocol", "magic"]).code,
        2
    );

    // What can be measured is, with a warning.
    let millimetres = square(&folder, "mm.ply", 0.08, 1000.0);
    let part = ["--crop=-5,-5,-1,5,5,1", "--samples", "2000"];
    let run = tsdfuse(
        &[
            &["eval", &mesh, "--reference", &square(&folder, "far.ply", 30.0, 1.0)],
            &part[1..],
        ]
        .concat(),
    );
    assert!(
        run.succeeded()
            .stderr
            .contains("the boxes around mesh and reference do not overlap")
    );
    let run = tsdfuse(&[&["eval", &mesh, "--reference", &millimetres], &part[1..]].concat());
    assert!(run.succeeded().stderr.contains("apart"), "a plane 80 m above");
}
