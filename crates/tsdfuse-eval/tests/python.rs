//! The figures against an independent implementation, `independent.py`. It needs a Python with numpy and scipy:
//! `TSDFUSE_PYTHON` names the interpreter (an absolute path, or a command), and then it must have both, as in CI. Without
//! the variable `python3` is tried, and the test says so and passes if that lacks them.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;
use tsdfuse_eval::compare::Direction;
use tsdfuse_eval::protocol::Limit;
use tsdfuse_eval::{Protocol, Reference, compare, sample};

/// The interpreter, if it has what the script needs.
fn python() -> Option<String> {
    let python = std::env::var("TSDFUSE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let found = Command::new(&python)
        .args(["-c", "import numpy, scipy.spatial"])
        .output();
    if found.is_ok_and(|run| run.status.success()) {
        return Some(python);
    }
    assert!(
        std::env::var_os("TSDFUSE_PYTHON").is_none(),
        "{python} has no numpy and scipy"
    );
    eprintln!("SKIPPED: {python} has no numpy and scipy; TSDFUSE_PYTHON names another one");
    None
}

/// Numbers in [0, 1) that look random.
fn random(seed: u64) -> impl Iterator<Item = f64> {
    (0_u64..).map(move |i| {
        // SplitMix64.
        let mut z = (seed.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(i)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    })
}

fn random_points(seed: u64, count: usize, size_m: f64) -> Vec<DVec3> {
    let mut numbers = random(seed);
    let mut next = || numbers.next().unwrap() * size_m;
    (0..count).map(|_| DVec3::new(next(), next(), next())).collect()
}

/// Triangles of a few decimetres and a few long ones, near UTM's coordinates, and points about their surface.
fn scene() -> (Mesh, Vec<DVec3>) {
    let origin = DVec3::new(5e5, 5.5e6, 100.0);
    let mut vertices: Vec<DVec3> = Vec::new();
    for (i, corner) in random_points(1, 120, 2.0).into_iter().enumerate() {
        let size = if i % 20 == 0 { 3.0 } else { 0.4 };
        vertices.extend(
            random_points(100 + i as u64, 3, size)
                .iter()
                .map(|p| origin + corner + *p),
        );
    }
    let triangles = (0..vertices.len() as u32 / 3)
        .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
        .collect();
    let mesh = Mesh {
        vertices,
        triangles,
        ..Default::default()
    };
    let surface = sample::uniform(&mesh, 3000);
    let cloud = surface
        .iter()
        .zip(random_points(2, 3000, 0.1))
        .map(|(p, noise)| *p + noise)
        .collect();
    (mesh, cloud)
}

fn write(path: &Path, numbers: impl Iterator<Item = Vec<u8>>) {
    std::fs::write(path, numbers.flatten().collect::<Vec<u8>>()).unwrap();
}

fn agree(direction: &Direction, figures: &Value) -> Result<(), String> {
    let ours = serde_json::to_value(direction.stats).unwrap();
    for (name, theirs) in figures.as_object().unwrap() {
        let [ours, theirs] = [&ours[name], theirs].map(|v| v.as_f64().unwrap());
        if (ours - theirs).abs() > 1e-6 {
            return Err(format!("{name}: {ours} {theirs}"));
        }
    }
    Ok(())
}

#[test]
fn scipy_finds_the_same_figures() {
    let Some(python) = python() else { return };
    let (mesh, cloud) = scene();
    let surface = Protocol {
        samples: 5000,
        ..Protocol::surface()
    };
    let thin = Protocol {
        samples: 5000,
        within_reference_box: false,
        accuracy_limit: Some(Limit::LeaveOut(0.12)),
        completeness_limit: Some(Limit::Clamp(0.15)),
        ..Protocol::by_name("shine").unwrap()
    };
    let dir = tempfile::tempdir().unwrap();
    let samples = sample::uniform(&mesh, 5000);
    for (name, points) in [
        ("samples", &samples),
        ("reference", &cloud),
        ("vertices", &mesh.vertices),
    ] {
        let bytes = points
            .iter()
            .map(|p| p.to_array().iter().flat_map(|c| c.to_le_bytes()).collect());
        write(&dir.path().join(name).with_extension("f64"), bytes);
    }
    let corners = mesh
        .triangles
        .iter()
        .map(|t| t.iter().flat_map(|v| v.to_le_bytes()).collect());
    write(&dir.path().join("triangles.u32"), corners);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/independent.py");
    let run = Command::new(python)
        .arg(script)
        .arg(dir.path())
        .args(["0.04", "0.12", "0.15"])
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let theirs: Value = serde_json::from_slice(&run.stdout).unwrap();

    let reference = Reference::cloud(cloud).unwrap();
    let ours = compare(&mesh, &reference, &surface).unwrap().all;
    agree(&ours.mesh_to_reference, &theirs["there"]).unwrap();
    agree(&ours.reference_to_mesh, &theirs["back"]).unwrap();
    assert_eq!(ours.thresholds[0].precision, theirs["precision"].as_f64().unwrap());
    assert_eq!(
        ours.thresholds[0].completeness,
        theirs["completeness"].as_f64().unwrap()
    );
    let ours = compare(&mesh, &reference, &thin).unwrap().all;
    agree(&ours.mesh_to_reference, &theirs["thin_there"]).unwrap();
    agree(&ours.reference_to_mesh, &theirs["thin_back"]).unwrap();
    let (kept, left_out) = (ours.mesh_to_reference.stats.count, ours.mesh_to_reference.left_out);
    let counts = [kept + left_out, ours.reference_to_mesh.stats.count];
    assert_eq!(serde_json::to_value(counts).unwrap(), theirs["thin_counts"]);
    assert!(
        left_out > 0 && ours.reference_to_mesh.clamped > 0,
        "both limits are tried"
    );

    // The comparison can fail: 15 µm are found.
    let mut moved = mesh;
    moved.vertices.iter_mut().for_each(|v| v.z += 1.5e-5);
    let disturbed = compare(&moved, &reference, &surface).unwrap().all;
    assert!(agree(&disturbed.mesh_to_reference, &theirs["there"]).is_err());
}
