use super::*;

/// Two triangles in the plane z = 0 from the origin.
pub(crate) fn rectangle(width_m: f64, height_m: f64) -> Mesh {
    let corner = |x, y| DVec3::new(x * width_m, y * height_m, 0.0);
    Mesh {
        vertices: vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    }
}

/// A sphere of radius 1 m far from the origin.
pub(crate) fn sphere() -> Mesh {
    let (rings, sectors) = (24_u32, 48_u32);
    let at = |i: u32, j: u32| {
        let (polar, turn) = (
            std::f64::consts::PI * f64::from(i) / 24.0,
            std::f64::consts::TAU * f64::from(j) / 48.0,
        );
        DVec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos()) + DVec3::new(5e5, 4e6, 100.0)
    };
    let vertices = (0..=rings).flat_map(|i| (0..sectors).map(move |j| at(i, j))).collect();
    let quad = |i: u32, j: u32| {
        let [a, b] = [i, i + 1].map(|i| [j, (j + 1) % sectors].map(|j| i * sectors + j));
        [[a[0], b[0], b[1]], [a[0], b[1], a[1]]]
    };
    let triangles = (0..rings)
        .flat_map(|i| (0..sectors).flat_map(move |j| quad(i, j)))
        .collect();
    Mesh {
        vertices,
        triangles,
        ..Default::default()
    }
}

#[test]
fn samples_are_as_dense_on_every_triangle() {
    // One large and many small triangles of half the area together.
    let mut mesh = rectangle(1.0, 1.0);
    mesh.vertices.push(DVec3::new(0.3, 0.6, 0.0));
    mesh.triangles.remove(1);
    mesh.triangles.extend([[0, 2, 4], [0, 4, 3], [3, 4, 2]]);
    let samples = uniform(&mesh, 10_000);
    assert_eq!(samples.len(), 10_000);
    let below = samples.iter().filter(|p| p.y < p.x).count();
    assert!(below.abs_diff(5000) <= 1, "{below}");
    let mean = samples.iter().sum::<DVec3>() / 10_000.0;
    assert!(mean.distance(DVec3::new(0.5, 0.5, 0.0)) < 1e-3, "{mean}");
}

#[test]
fn triangles_that_are_not_finite_get_no_samples() {
    let mut mesh = rectangle(1.0, 1.0);
    mesh.vertices.push(DVec3::NAN);
    mesh.triangles.insert(1, [0, 1, 4]);
    assert_eq!(area_m2(&mesh), 1.0);
    let samples = uniform(&mesh, 1000);
    assert!(samples.len() == 1000 && samples.iter().all(|p| p.is_finite()));
    assert!(uniform(&Mesh::default(), 10).is_empty());
}
