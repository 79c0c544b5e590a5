//! Writes a scene's true mesh and a cloud of all its scans, to look at in any mesh viewer:
//!
//! ```sh
//! cargo run --release -p tsdfuse-sim --example preview -- street 1 pandar64 80 out
//! ```
//!
//! makes `out/mesh.obj` and `out/cloud.xyz` (x y z intensity, world coordinates) and prints how fast rays were cast.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Instant;

use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, seed, sensor, scans, folder] = arguments.as_slice() else {
        return Err("arguments: SCENE SEED SENSOR SCANS FOLDER".into());
    };
    let scene = scene::by_name(name, seed.parse()?).ok_or_else(|| format!("scenes: {:?}", scene::names()))?;
    let sensor = tsdfuse::sensor::model(sensor).ok_or_else(|| format!("sensors: {:?}", tsdfuse::sensor::names()))?;
    let rays = sensor.rings() * sensor.columns as usize;
    let folder = Path::new(folder);
    std::fs::create_dir_all(folder)?;

    let mesh = scene.mesh(0.002);
    let mut obj = BufWriter::new(File::create(folder.join("mesh.obj"))?);
    for v in &mesh.vertices {
        writeln!(obj, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| v + 1);
        writeln!(obj, "f {a} {b} {c}")?;
    }
    writeln!(
        std::io::stderr(),
        "{} solids, {} triangles",
        scene.primitives().len(),
        mesh.triangles.len()
    )?;

    let path = path::default_for(&scene, scans.parse()?);
    let simulator = Simulator::new(scene, sensor, path, SimulatorConfig::default())?;
    let mut cloud = BufWriter::new(File::create(folder.join("cloud.xyz"))?);
    for scan in simulator.scans() {
        let intensities = scan.intensities.iter().flatten();
        for (point, intensity) in scan.points.iter().zip(intensities) {
            let p = scan.pose.unwrap().transform_point(point.as_dvec3());
            writeln!(cloud, "{:.4} {:.4} {:.4} {intensity:.3}", p.x, p.y, p.z)?;
        }
    }

    let start = Instant::now();
    let points: usize = simulator.scans().take(5).map(|s| s.points.len()).sum();
    let taken = simulator.path().len().min(5);
    let rate = (rays * taken) as f64 / start.elapsed().as_secs_f64() / 1e6;
    writeln!(
        std::io::stderr(),
        "{} points a scan, {rate:.2} million rays a second on {} threads",
        points / taken.max(1),
        rayon::current_num_threads()
    )?;
    Ok(())
}
