use std::f64::consts::TAU;

use glam::{DQuat, DVec2, dvec3};
use proptest::prelude::*;

use super::*;

/// One solid of every kind, turned and shifted; all fit into a ball of 4 m about the origin.
fn solids() -> Vec<Primitive> {
    let star = |i: u32| DVec2::from_angle(TAU * f64::from(i) / 10.0) * if i.is_multiple_of(2) { 1.5 } else { 0.6 };
    let shapes = [
        Primitive::cuboid(dvec3(2.0, 1.0, 0.5)),
        Primitive::frustum(0.8, 0.8, 1.5),
        Primitive::frustum(1.0, 0.3, 1.2),
        Primitive::frustum(0.0, 0.9, 2.0),
        Primitive::ellipsoid(DVec3::splat(1.3)),
        Primitive::ellipsoid(dvec3(1.5, 0.4, 0.9)),
        Primitive::ellipsoid(dvec3(1.2, 1.2, 0.2)),
        Primitive::prism((0..10).map(star).collect(), 0.8),
        Primitive::profile(
            [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.5], [2.0, 0.5], [2.0, 0.0]]
                .map(DVec2::from)
                .into(),
            1.0,
        ),
    ];
    let place = |(i, solid): (usize, Primitive)| {
        let axis = dvec3(0.3, -0.5, 0.8).normalize();
        let pose = Pose {
            rotation: DQuat::from_axis_angle(axis, 0.7 * i as f64),
            translation: dvec3(0.3, -0.2, 0.5),
        };
        solid.placed(&pose)
    };
    shapes.into_iter().enumerate().map(place).collect()
}

/// A hill with a kerb, 8 m × 6 m.
fn hill() -> Primitive {
    let along = (0..=8).map(|i| 0.3 * f64::from(i).sin()).collect();
    let across = vec![(-3.0, 0.5), (-0.5, 0.0), (0.4, 0.1), (0.4, 0.6), (3.0, 0.5)];
    Primitive::terrain(Terrain::new(-4.0, 1.0, along, across).unwrap())
}

fn to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a);
    let inside = |u: DVec3, v: DVec3| normal.cross(v - u).dot(p - u) >= 0.0;
    if normal.length_squared() > 0.0 && inside(a, b) && inside(b, c) && inside(c, a) {
        return (p - a).dot(normal.normalize()).abs();
    }
    let edge = |u: DVec3, v: DVec3| {
        let s = ((p - u).dot(v - u) / (v - u).length_squared().max(1e-300)).clamp(0.0, 1.0);
        p.distance(u.lerp(v, s))
    };
    edge(a, b).min(edge(b, c)).min(edge(c, a))
}

fn corners(facets: &Facets) -> impl Iterator<Item = [DVec3; 3]> {
    facets.triangles.iter().map(|t| t.map(|v| facets.vertices[v as usize]))
}

/// Winding number of a closed mesh about `p`: 1 inside, 0 outside (Van Oosterom & Strackee 1983).
fn winding(p: DVec3, facets: &Facets) -> f64 {
    let solid_angle = |t: [DVec3; 3]| {
        let [a, b, c] = t.map(|v| v - p);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        2.0 * a
            .dot(b.cross(c))
            .atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    };
    corners(facets).map(solid_angle).sum::<f64>() / (2.0 * TAU)
}

fn grid() -> impl Iterator<Item = DVec3> {
    let n = 7_i32;
    (0..n.pow(3)).map(move |i| dvec3(f64::from(i % n), f64::from(i / n % n), f64::from(i / n / n)) * 0.7 - 2.03)
}

#[test]
fn distance_agrees_with_the_mesh() {
    const CHORD_M: f64 = 1e-3;
    for (number, solid) in solids().iter().enumerate() {
        let facets = solid.facets(CHORD_M);
        for p in grid() {
            let brute = corners(&facets)
                .map(|t| to_triangle(p, t))
                .fold(f64::INFINITY, f64::min);
            let distance = solid.signed_distance(p);
            assert!(
                (distance.abs() - brute).abs() < CHORD_M + 1e-9,
                "{number} {p}: {distance} {brute}"
            );
            let wound = winding(p, &facets);
            assert!((wound - wound.round()).abs() < 1e-6, "{number}: the mesh is not closed");
            if distance.abs() > CHORD_M {
                assert_eq!(distance < 0.0, wound.round() == 1.0, "{number} {p}: {distance} {wound}");
            }
        }
    }
}

#[test]
fn terrain_agrees_with_its_mesh() {
    let hill = hill();
    let facets = hill.facets(1e-3);
    let Shape::Terrain(terrain) = &hill.shape else {
        unreachable!()
    };
    let mut below = 0;
    for p in grid().chain(grid().map(|p| p * 2.5)) {
        let brute = corners(&facets)
            .map(|t| to_triangle(p, t))
            .fold(f64::INFINITY, f64::min);
        let within = p.x.abs() < 4.0 && p.y.abs() < 3.0;
        let height = terrain.height_m(p.x, p.y);
        let distance = hill.signed_distance(p);
        if within && p.z < height {
            below += 1;
            // Its sides and underside have no triangles.
            let to_sides = (4.0 - p.x.abs()).min(3.0 - p.y.abs()).min(p.z - hill.bounds().min.z);
            assert!((distance + brute.min(to_sides)).abs() < 1e-9, "{p}: {distance} {brute}");
        } else if p.z >= height {
            assert!((distance - brute).abs() < 1e-9, "{p}: {distance} {brute}");
        }
    }
    assert!(below > 50);
    // Beside and below: to the side of the solid.
    assert!((hill.signed_distance(dvec3(5.0, 0.0, -3.0)) - 1.0).abs() < 1e-9);
}

#[test]
fn mesh_lies_on_the_surface() {
    for (number, solid) in solids().iter().chain([&hill()]).enumerate() {
        let facets = solid.facets(1e-3);
        for (&v, &n) in facets.vertices.iter().zip(&facets.normals) {
            assert!(
                solid.signed_distance(v).abs() < 1e-9,
                "{number} {v}: {}",
                solid.signed_distance(v)
            );
            assert!((n.length() - 1.0).abs() < 1e-12);
        }
        for (t, c) in facets.triangles.iter().zip(corners(&facets)) {
            let normal = (c[1] - c[0]).cross(c[2] - c[0]);
            assert!(normal.length() > 1e-12, "{number}: a triangle without area");
            for v in t {
                assert!(
                    normal.dot(facets.normals[*v as usize]) > 0.0,
                    "{number}: {c:?} faces inwards"
                );
            }
        }
    }
}

#[test]
fn terrain_refuses_what_has_no_surface() {
    let flat = vec![(0.0, 0.0), (1.0, 0.0)];
    assert!(Terrain::new(0.0, 1.0, vec![0.0, 0.0], flat.clone()).is_some());
    assert!(Terrain::new(0.0, 1.0, vec![0.0], flat.clone()).is_none());
    assert!(Terrain::new(0.0, 0.0, vec![0.0, 0.0], flat.clone()).is_none());
    assert!(Terrain::new(0.0, 1.0, vec![0.0, f64::NAN], flat).is_none());
    assert!(Terrain::new(0.0, 1.0, vec![0.0, 0.0], vec![(1.0, 0.0), (0.0, 0.0)]).is_none());
}

fn direction() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-1.0..1.0f64).prop_filter_map("short", |v| DVec3::from(v).try_normalize())
}

fn point() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-3.0..3.0f64).prop_map(DVec3::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// The first entry of a ray against a walk along it that takes the signed distance for its steps.
    #[test]
    fn rays_agree_with_the_distance(aim in point(), direction in direction(), far in 8.0..150.0f64) {
        for (number, solid) in solids().iter().chain([&hill()]).enumerate() {
            let is_terrain = matches!(solid.shape, Shape::Terrain(_));
            // A terrain is seen from above only, not through its sides.
            let (aim, steepness) = if is_terrain { (aim * dvec3(0.6, 0.3, 0.0), -0.55) } else { (aim, 1.0) };
            if direction.z > steepness {
                continue;
            }
            let origin = aim - direction * far;
            let entry = solid.enter(origin, direction);
            prop_assert!(entry.is_some() || !is_terrain);
            if let Some(e) = entry {
                let p = origin + direction * e.t;
                prop_assert!(solid.signed_distance(p).abs() < 1e-9, "{number}: {}", solid.signed_distance(p));
                prop_assert!(e.normal.dot(direction) <= 0.0 && (e.normal.length() - 1.0).abs() < 1e-12);
                // Just outside along the normal, as far as the step (nearer in a concave corner).
                let out = solid.signed_distance(p + e.normal * 1e-6);
                prop_assert!(out > 1e-9 && out < 1.000001e-6, "{number}: {out}");
            }
            let end = entry.map_or(2.0 * far, |e| e.t) - 1e-6;
            let mut t = 0.0;
            while t < end {
                let d = solid.signed_distance(origin + direction * t);
                prop_assert!(d > -1e-9, "{number}: {d} inside at {t}, before {entry:?}");
                // Not slower than this past a surface that is only grazed.
                t += d.max(1e-3);
            }
        }
    }

    #[test]
    fn distances_grow_no_faster_than_the_way(a in point(), b in point()) {
        for solid in solids().iter().chain([&hill()]) {
            let change = (solid.signed_distance(a) - solid.signed_distance(b)).abs();
            prop_assert!(change <= a.distance(b) + 1e-9);
        }
    }

    /// Points at a known distance: from a point of the surface along its normal.
    #[test]
    fn ellipsoids_find_the_foot(
        axes in prop::array::uniform3(0.05..5.0f64), n in direction(), out in 0.0..10.0f64, depth in 0.0..0.9f64,
    ) {
        let axes = DVec3::from(axes);
        let ellipsoid = Primitive::ellipsoid(axes);
        let foot = axes * axes * n / (axes * n).length();
        prop_assert!((ellipsoid.signed_distance(foot + n * out) - out).abs() < 1e-9);
        // Inwards up to the least radius of curvature anywhere, the foot stays the nearest.
        let inwards = depth * axes.min_element().powi(2) / axes.max_element();
        prop_assert!((ellipsoid.signed_distance(foot - n * inwards) + inwards).abs() < 1e-9);
    }
}

#[test]
fn ellipsoid_centres_are_as_deep_as_the_least_axis() {
    for axes in [
        dvec3(1.0, 2.0, 3.0),
        dvec3(3.0, 1.0, 1.0),
        dvec3(2.0, 2.0, 0.5),
        dvec3(5.0, 0.05, 5.0),
    ] {
        let solid = Primitive::ellipsoid(axes);
        assert!((solid.signed_distance(DVec3::ZERO) + axes.min_element()).abs() < 1e-9);
        for axis in DVec3::AXES {
            assert!((solid.signed_distance(axis * 7.0) - (7.0 - axes.dot(axis))).abs() < 1e-9);
        }
    }
}
