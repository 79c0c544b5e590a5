//! Thesis 7.6: a ledge 15 cm before a wall, its horizontal edge 1 m up.

use std::collections::HashSet;
use std::f64::consts::TAU;

use tsdfuse::{Scan, SensorModel, fuse::Method, glam::DVec3, mesh};
use tsdfuse_sim::Primitive;

use crate::{fuse, only, simulator, turned};

const COLUMNS: u32 = 768;
const FRONT_M: f64 = 0.013;
const DEPTH_M: f64 = 0.15;

/// 41 beams about the horizon, one for each row of the image. Their places within the rows are spread over `spread` of a row.
fn sensor(spread: f64) -> SensorModel {
    let tangent = |k: u32| {
        let within = match k {
            0 | 40 => 0.0,
            _ => spread * ((f64::from(k) * 0.618).fract() - 0.5),
        };
        (f64::from(k) - 20.0 + within) * TAU / f64::from(COLUMNS)
    };
    SensorModel {
        name: "beams in rows".to_owned(),
        elevations_deg: (0..41).map(|k| tangent(k).atan().to_degrees() as f32).collect(),
        columns: COLUMNS,
        min_range_m: 0.3,
        max_range_m: 50.0,
    }
}

/// The share of the ledge's face in the 5 cm below its edge that is where it should be, and of all faces up to 30 cm above
/// and below, without the 10 cm about the edge.
fn intact(method: Method, spread: f64) -> (f64, f64) {
    let block = |front: f64, top: f64| Primitive::cuboid(DVec3::new(1.0, 10.0, 4.0)).at(front + 0.5, 0.0, top - 2.0);
    let solids = vec![block(FRONT_M, 1.0), block(FRONT_M + DEPTH_M, 2.0)];
    let path = (0..160).map(|i| {
        let i = f64::from(i);
        let height = 0.8 + 0.4 * (i * 0.382).fract();
        turned(
            DVec3::new(-16.0 + 0.04 * i, 0.1, height),
            0.3 * (i * 0.618).fract(),
            0.0,
            0.0,
        )
    });
    let simulator = simulator(solids, sensor(spread), path.collect(), 0.01);
    let scans: Vec<Scan> = simulator.scans().map(|s| only(s, |p| p.y.abs() < 1.5)).collect();
    let mesh = mesh::extract(&fuse(method, simulator.sensor(), &scans).0).unwrap();

    // A flat face has a vertex per voxel of 5 cm.
    let share = |rows: &mut dyn Iterator<Item = i32>| {
        let (mut found, mut all) = (0, 0);
        for row in rows {
            let front = if row < 20 { FRONT_M } else { FRONT_M + DEPTH_M };
            let low = 0.05 * f64::from(row);
            let in_row = |v: &&DVec3| (low..low + 0.05).contains(&v.z) && v.y.abs() < 1.0 && (v.x - front).abs() < 0.03;
            let voxel = |v: &DVec3| (v.y / 0.05).floor() as i32;
            found += mesh
                .vertices
                .iter()
                .filter(in_row)
                .map(voxel)
                .collect::<HashSet<_>>()
                .len();
            all += 40;
        }
        f64::from(found as u32) / f64::from(all)
    };
    (share(&mut (19..20)), share(&mut (14..19).chain(21..26)))
}

/// With every beam in the middle of its row nothing is rounded; with beams anywhere in their rows, the edge goes.
#[test]
fn cylindrical_images_erode_an_edge_that_raycasting_keeps() {
    for (method, spread) in [
        (Method::Raycast, 0.0),
        (Method::Raycast, 0.9),
        (Method::Cylindrical, 0.0),
        (Method::Cylindrical, 0.9),
    ] {
        let (edge, faces) = intact(method, spread);
        let eroded = method == Method::Cylindrical && spread > 0.0;
        assert!(
            if eroded { edge < 0.3 } else { edge > 0.9 },
            "{method:?}, {spread}: {edge} of the edge"
        );
        assert!(faces > 0.99, "{method:?}, {spread}: {faces} of the faces");
    }
}
