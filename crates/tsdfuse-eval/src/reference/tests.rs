use super::*;
use proptest::prelude::*;

use crate::triangle::closest_on;

fn nearest(cloud: &[DVec3], p: DVec3) -> f64 {
    cloud.iter().map(|c| c.distance(p)).fold(f64::INFINITY, f64::min)
}

fn points(range: std::ops::Range<usize>) -> impl Strategy<Value = Vec<DVec3>> {
    // Whole numbers make equal coordinates and equal points likely.
    let whole = prop::array::uniform3(-3..3_i32).prop_map(|c| DVec3::from(c.map(f64::from)));
    let any = prop::array::uniform3(-3.0..3.0).prop_map(DVec3::from);
    prop::collection::vec(prop_oneof![whole, any], range)
}

proptest! {
    #[test]
    fn distances_to_a_cloud_are_those_to_its_nearest_point(cloud in points(1..120), queries in points(1..20), far in any::<bool>()) {
        let shift = DVec3::new(5e5, 5e6, 100.0) * f64::from(u8::from(far));
        let [cloud, queries] = [cloud, queries].map(|p| p.into_iter().map(|p| p + shift).collect::<Vec<_>>());
        let found = Reference::cloud(cloud.clone()).unwrap().distances(&queries);
        for (d, &p) in found.iter().zip(&queries) {
            prop_assert!((d - nearest(&cloud, p)).abs() < 2e-7);
        }
    }

    #[test]
    fn distances_to_a_mesh_are_those_to_its_nearest_triangle(
        vertices in points(3..40),
        corners in prop::collection::vec(prop::array::uniform3(any::<prop::sample::Index>()), 1..80),
        queries in points(1..20),
    ) {
        let triangles: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|i| i.index(vertices.len()) as u32)).collect();
        let mesh = Mesh { vertices, triangles, ..Default::default() };
        if let Ok(reference) = Reference::mesh(mesh.clone()) {
            for (d, &p) in reference.distances(&queries).iter().zip(&queries) {
                let to = |t: &[u32; 3]| closest_on(sample::corners(&mesh, t), p).distance(p);
                let literal = mesh.triangles.iter().map(to).fold(f64::INFINITY, f64::min);
                prop_assert!((d - literal).abs() < 1e-12, "{d} {literal}");
            }
        }
    }
}

#[test]
fn many_equal_and_adjacent_points_are_no_trouble() {
    let next = |x: f64| f64::from_bits(x.to_bits() + 1);
    let mut cloud = vec![DVec3::new(1.0, 2.0, 0.0); 50_000];
    cloud.extend((0..100).map(|i| DVec3::new(if i % 2 == 0 { 7.0 } else { next(7.0) }, 2.0, 0.0)));
    let reference = Reference::cloud(cloud).unwrap();
    let found = reference.distances(&[DVec3::new(1.0, 2.0, 0.5), DVec3::new(9.0, 2.0, 0.0)]);
    assert_eq!(found, [0.5, 2.0]);
}

#[test]
fn what_is_not_finite_is_left_out_and_counted() {
    let reference = Reference::cloud(vec![DVec3::NAN, DVec3::ZERO, DVec3::X * 1e300, DVec3::Y]).unwrap();
    assert_eq!((reference.left_out(), reference.points().unwrap().len()), (2, 2));
    let mesh = Mesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::INFINITY],
        triangles: vec![[0, 1, 2], [1, 2, 3]],
        ..Default::default()
    };
    let reference = Reference::mesh(mesh).unwrap();
    assert_eq!(
        (reference.left_out(), reference.bounds().max),
        (1, DVec3::new(1.0, 1.0, 0.0))
    );
}

#[test]
fn useless_references_are_refused_in_words() {
    let cloud = |points: &[DVec3]| Reference::cloud(points.to_vec()).unwrap_err().to_string();
    assert_eq!(cloud(&[]), "the reference has no points");
    assert!(cloud(&[DVec3::NAN]).starts_with("none of the 1 points of the reference is finite"));
    let mesh = |triangles: &[[u32; 3]]| {
        let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let triangles = triangles.to_vec();
        let mesh = Mesh {
            vertices,
            triangles,
            ..Default::default()
        };
        Reference::mesh(mesh).unwrap_err().to_string()
    };
    assert_eq!(mesh(&[]), "the reference has no triangles: is it a cloud of points?");
    assert_eq!(
        mesh(&[[0, 1, 1]]),
        "the reference has no area: all its 1 triangles are degenerate or not finite"
    );
    assert_eq!(
        mesh(&[[0, 1, 2], [0, 1, 3]]),
        "triangle 1 of the reference has corner 3, but there are 3 vertices"
    );
}

#[test]
fn boxes_know_their_gap() {
    let cube = |low: f64, high: f64| Bounds {
        min: DVec3::splat(low),
        max: DVec3::splat(high),
    };
    assert_eq!(cube(0.0, 1.0).gap_m(&cube(0.5, 2.0)), 0.0);
    let mut beside = cube(0.0, 1.0);
    beside.min.x = 4.0;
    beside.max.x = 5.0;
    assert_eq!(
        (cube(0.0, 1.0).gap_m(&beside), beside.gap_m(&cube(0.0, 1.0))),
        (3.0, 3.0)
    );
}
