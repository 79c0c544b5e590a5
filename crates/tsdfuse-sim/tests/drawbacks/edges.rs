//! Thesis 7.4, the other drawback: returns at an edge lack neighbours, so they are lost, and the edge with them.

use std::f64::consts::TAU;

use tsdfuse::{
    Scan,
    fuse::Method,
    fuse::rings_of,
    glam::{DQuat, DVec3},
    mesh,
    normals::{NormalsConfig, estimate},
    sensor::{ScanImage, model},
};
use tsdfuse_sim::Primitive;

use crate::{fuse, simulator, turned};

/// A box in the air, seen from all sides.
#[test]
fn normals_lose_the_edges_of_a_box_and_raycasting_does_not() {
    let size = DVec3::new(3.0, 2.0, 1.5);
    let path = (0..12).map(|i| {
        let yaw = 0.05 + TAU * f64::from(i) / 12.0;
        turned(DQuat::from_rotation_z(yaw) * DVec3::new(-6.0, 0.0, 2.5), yaw, 0.2, 0.0)
    });
    let cuboid = Primitive::cuboid(size).at(0.0, 0.0, 0.75);
    let simulator = simulator(vec![cuboid], model("os0-128").unwrap(), path.collect(), 0.0);
    let scans: Vec<Scan> = simulator.scans().collect();
    // How far a return on the box is from its nearest edge: the second smallest distance to a face.
    let from_edge = |s: &Scan, i: usize| {
        let p = s.pose.unwrap().transform_point(s.points[i].as_dvec3()) - DVec3::Z * 0.75;
        let mut to_face = (size / 2.0 - p.abs()).to_array();
        to_face.sort_by(f64::total_cmp);
        (to_face[0].abs() < 1e-3 && p.z > -0.7).then_some(to_face[1])
    };
    let mut lost = [(0, 0); 2]; // within 4 cm of an edge, farther than 20 cm from it
    let (mut image, mut normals) = (ScanImage::new(), Vec::new());
    for scan in &scans {
        image.update(&scan.points, &rings_of(scan, simulator.sensor()), simulator.sensor());
        estimate(&image, &scan.points, None, &NormalsConfig::default(), &mut normals);
        for (i, normal) in normals.iter().enumerate() {
            let side = match from_edge(scan, i) {
                Some(d) if d < 0.04 => 0,
                Some(d) if d > 0.2 => 1,
                _ => continue,
            };
            lost[side].0 += u32::from(!normal.is_some());
            lost[side].1 += 1;
        }
    }
    let [at_edges, on_faces] = lost.map(|(lost, all)| f64::from(lost) / f64::from(all));
    assert!(
        at_edges > 0.25 && on_faces < 0.05,
        "lost {at_edges} at edges, {on_faces} on faces"
    );

    // Raycasting uses every return; what normals lose leaves the edges ragged.
    let borders = [Method::Raycast, Method::Normals].map(|method| {
        let (map, done) = fuse(method, simulator.sensor(), &scans);
        let skipped: u64 = done.iter().map(|d| d.skipped.without_normal).sum();
        assert_eq!(
            skipped > 0,
            method == Method::Normals,
            "{method:?} skips {skipped} returns"
        );
        mesh::extract(&map).unwrap().topology().border_edges
    });
    let [raycast, normals] = borders.map(|edges| edges as f64);
    assert!(normals > 1.4 * raycast, "{borders:?} open edges");
}
