//! The measure of `cargo bench --bench methods`, on surfaces whose answer is known.

#[path = "../benches/methods/measure.rs"]
mod measure;

use measure::{accuracy, closest_on, completeness};
use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

/// The rectangle [0, `length`) × [0, 1) at z = `height`, in triangles of 2 cm.
fn sheet(length: f64, height: f64) -> Mesh {
    let (nx, ny) = ((length / 0.02).round() as u32, 50);
    let vertices = (0..=ny).flat_map(|y| (0..=nx).map(move |x| DVec3::new(f64::from(x), f64::from(y), 0.0)));
    let at = |x: u32, y: u32| y * (nx + 1) + x;
    let cells = (0..ny).flat_map(|y| (0..nx).map(move |x| (x, y)));
    Mesh {
        vertices: vertices.map(|v| v * 0.02 + DVec3::Z * height).collect(),
        triangles: cells
            .flat_map(|(x, y)| {
                let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect(),
        ..Default::default()
    }
}

/// Points of the unit square at z = 0.
fn square() -> Vec<DVec3> {
    let row = |y: i32| (0..100).map(move |x| DVec3::new(f64::from(x), f64::from(y), 0.0) / 100.0 + 0.005);
    (0..100).flat_map(row).map(|p| p.with_z(0.0)).collect()
}

#[test]
fn a_sheet_beside_the_plane_is_as_far_away_as_it_lies() {
    for height in [0.013, -0.013] {
        let a = accuracy(&sheet(1.0, height), 10_000, 0.05, |p| p.z).unwrap();
        for error in [a.mean_m, a.rmse_m, a.p95_m] {
            assert!((error - 0.013).abs() < 1e-12, "{a:?}");
        }
        assert_eq!(a.precision, 1.0);
        assert_eq!(completeness(&sheet(1.0, height), &square(), 0.0131), 1.0);
        assert_eq!(completeness(&sheet(1.0, height), &square(), 0.0129), 0.0);
    }
    let a = accuracy(&sheet(1.0, 0.06), 1000, 0.05, |p| p.z).unwrap();
    assert_eq!(
        (a.precision, completeness(&sheet(1.0, 0.06), &square(), 0.05)),
        (0.0, 0.0)
    );
}

/// Distances to a plane across the sheet are spread evenly over 0 … 1 m: their moments are known.
#[test]
fn samples_are_spread_by_area() {
    // Half of the triangles lie on a tenth of the area.
    let mut mesh = sheet(0.1, 0.0);
    let big = sheet(0.9, 0.0);
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(big.vertices.iter().map(|v| *v + DVec3::X * 0.1));
    mesh.triangles
        .extend(big.triangles.iter().map(|t| t.map(|v| v + first)));
    for axis in [DVec3::X, DVec3::Y] {
        let a = accuracy(&mesh, 100_000, 0.25, |p| p.dot(axis)).unwrap();
        let wanted = [0.5, 1.0 / 3_f64.sqrt(), 0.95, 0.25];
        for (is, wanted) in [a.mean_m, a.rmse_m, a.p95_m, a.precision].into_iter().zip(wanted) {
            assert!((is - wanted).abs() < 0.002, "{axis}: {a:?}");
        }
    }
    assert!(accuracy(&Mesh::default(), 10, 0.05, |p| p.z).is_none());
}

#[test]
fn half_a_surface_is_half_complete() {
    let half = completeness(&sheet(0.5, 0.0), &square(), 1e-6);
    assert_eq!(half, 0.5);
    // The tolerance reaches past the border too.
    let more = completeness(&sheet(0.5, 0.03), &square(), 0.05);
    assert!((more - 0.54).abs() < 0.0051, "{more}");
    assert_eq!(completeness(&Mesh::default(), &square(), 0.05), 0.0);
}

/// Every corner, edge and the face of a triangle against many points of it.
#[test]
fn the_closest_point_of_a_triangle_is_closer_than_all_others() {
    let t = [
        DVec3::new(0.1, 0.2, -0.3),
        DVec3::new(1.3, -0.1, 0.2),
        DVec3::new(0.4, 0.9, 0.5),
    ];
    let on = |u: f64, v: f64| t[0] + (t[1] - t[0]) * u + (t[2] - t[0]) * v;
    for i in 0..1000 {
        let step = |s: f64| (s * f64::from(i)).fract() * 4.0 - 1.5;
        let p = DVec3::new(step(0.618), step(0.382), step(0.123));
        let found = closest_on(t, p).distance(p);
        let grid = (0..=200).flat_map(|u| (0..=200 - u).map(move |v| (f64::from(u) / 200.0, f64::from(v) / 200.0)));
        let least = grid.map(|(u, v)| on(u, v).distance(p)).fold(f64::INFINITY, f64::min);
        assert!(found <= least + 1e-12 && found > least - 0.01, "{p}: {found}, {least}");
    }
}
