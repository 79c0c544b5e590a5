//! Thesis 7.3: a piece of road of 5 m × 6 m that a car comes up to.

use std::collections::HashSet;
use std::ops::Range;

use tsdfuse::{Scan, fuse::Method, glam::DVec3, mesh, sensor::model};

use crate::{fuse, ground, only, simulator, triangles, turned};

fn on_patch(p: DVec3) -> bool {
    (40.0..45.0).contains(&p.x) && p.y.abs() < 3.0
}

/// Of the squares of 10 cm that were hit, the share with surface that faces up; of the mesh's area, the share that faces up.
fn road(method: Method, car_at: Range<u32>) -> (f64, f64) {
    let path = car_at.map(|i| turned(DVec3::new(0.5 * f64::from(i), 0.0, 1.8), 0.0, 0.0, 0.0));
    let simulator = simulator(vec![ground()], model("pandar64").unwrap(), path.collect(), 0.01);
    let near = |p: DVec3| (p.x - 42.5).abs() < 6.0 && p.y.abs() < 4.0;
    let scans: Vec<Scan> = simulator.scans().map(|s| only(s, near)).collect();
    let mesh = mesh::extract(&fuse(method, simulator.sensor(), &scans).0).unwrap();

    let square = |p: DVec3| (p * 10.0).floor().as_ivec3().truncate().to_array();
    let returns = scans
        .iter()
        .flat_map(|s| s.points.iter().map(|p| s.pose.unwrap().transform_point(p.as_dvec3())));
    let hit: HashSet<_> = returns.filter(|&p| on_patch(p)).map(square).collect();
    let on_road: Vec<_> = triangles(&mesh).filter(|(center, _)| on_patch(*center)).collect();
    let faces_up = |(_, area): &&(DVec3, DVec3)| area.z > 0.7 * area.length();
    let closed: HashSet<_> = on_road.iter().filter(faces_up).map(|(c, _)| square(*c)).collect();
    let area = |triangles: &mut dyn Iterator<Item = &(DVec3, DVec3)>| triangles.map(|t| t.1.length()).sum::<f64>();
    (
        hit.intersection(&closed).count() as f64 / hit.len() as f64,
        area(&mut on_road.iter().filter(faces_up)) / area(&mut on_road.iter()),
    )
}

/// A ray that grazes the road changes sign along itself, so that the surface stands across it, in shreds.
#[test]
fn raycasting_shreds_a_distant_road_until_it_is_near() {
    let (far, middle, near) = (0..20, 20..40, 60..80); // 45 to 30 m away, 35 to 20 m, 15 to 0 m
    for (car_at, closed, up) in [
        (far, 0.0..0.4, 0.0..0.2),
        (middle, 0.3..0.6, 0.1..0.4),
        (near, 0.95..1.01, 0.85..1.01),
    ] {
        let (is_closed, is_up) = road(Method::Raycast, car_at.clone());
        assert!(
            closed.contains(&is_closed),
            "from {car_at:?}: {is_closed} of what was hit is closed"
        );
        assert!(up.contains(&is_up), "from {car_at:?}: {is_up} of the mesh faces up");
    }
    // All of it, near and far: the near returns weigh more.
    let (closed, up) = road(Method::Raycast, 0..80);
    assert!(closed > 0.99 && up > 0.9, "{closed}, {up}");
}

/// The same scans with normals: what is there is road, from far away too.
#[test]
fn normals_see_a_distant_road_as_road() {
    for (car_at, closed) in [(0..20, 0.35), (20..40, 0.7), (60..80, 0.9)] {
        let (is_closed, is_up) = road(Method::Normals, car_at.clone());
        assert!(
            is_closed > closed,
            "from {car_at:?}: {is_closed} of what was hit is closed"
        );
        assert!(is_up > 0.95, "from {car_at:?}: {is_up} of the mesh faces up");
    }
}
