use super::*;
use crate::dense::DenseRule;
use crate::protocol::Limit;
use crate::sample::tests::{rectangle, sphere};
use crate::triangle::closest_on;

fn moved(mesh: &Mesh, by: DVec3) -> Mesh {
    let mut mesh = mesh.clone();
    mesh.vertices.iter_mut().for_each(|v| *v += by);
    mesh
}

/// A cloud of one point in the middle of each square of 5 cm.
fn squares(width: u32, height: u32, z: f64) -> Vec<DVec3> {
    let at = |x: u32, y: u32| DVec3::new(0.05 * (f64::from(x) + 0.5), 0.05 * (f64::from(y) + 0.5), z);
    (0..width).flat_map(|x| (0..height).map(move |y| at(x, y))).collect()
}

fn quick(protocol: Protocol) -> Protocol {
    Protocol {
        samples: 4000,
        ..protocol
    }
}

/// Every figure from the definitions, point by point.
fn literal(mesh: &Mesh, cloud: &[DVec3], protocol: &Protocol) -> Measures {
    let samples = take_samples(mesh, protocol);
    let nearest = |cloud: &[DVec3], p: DVec3| cloud.iter().map(|c| c.distance(p)).fold(f64::INFINITY, f64::min);
    let surface = |p: DVec3| {
        let triangles = mesh
            .triangles
            .iter()
            .map(|t| closest_on(sample::corners(mesh, t), p).distance(p));
        triangles.fold(f64::INFINITY, f64::min)
    };
    let there: Vec<f64> = samples.iter().map(|&p| nearest(cloud, p)).collect();
    let back = cloud.iter().map(|&p| match protocol.to_mesh {
        ToMesh::Surface => surface(p),
        ToMesh::Samples => nearest(&samples, p),
    });
    Measures::of(&there, &back.collect::<Vec<_>>(), protocol).unwrap()
}

fn assert_near(a: &Measures, b: &Measures) {
    for (a, b) in [
        (&a.mesh_to_reference, &b.mesh_to_reference),
        (&a.reference_to_mesh, &b.reference_to_mesh),
    ] {
        let figures = |d: &Direction| {
            [
                d.stats.mean_m,
                d.stats.std_m,
                d.stats.rmse_m,
                d.stats.median_m,
                d.stats.p95_m,
                d.stats.max_m,
            ]
        };
        for (a, b) in figures(a).into_iter().zip(figures(b)) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
    for (a, b) in a.thresholds.iter().zip(&b.thresholds) {
        // A distance may lie within the rounding of a threshold.
        assert!(
            (a.precision - b.precision).abs() < 1e-3 && (a.completeness - b.completeness).abs() < 1e-3,
            "{a:?} {b:?}"
        );
    }
    assert!((a.chamfer_l1_m - b.chamfer_l1_m).abs() < 1e-6);
}

#[test]
fn all_figures_are_those_of_the_definitions() {
    let mesh = sphere();
    let cloud: Vec<DVec3> = sample::uniform(&moved(&mesh, DVec3::new(0.02, 0.0, 0.05)), 3000);
    let reference = Reference::cloud(cloud.clone()).unwrap();
    for protocol in [Protocol::surface(), Protocol::thesis()] {
        let protocol = quick(protocol);
        let found = compare(&mesh, &reference, &protocol).unwrap();
        assert_near(&found.all, &literal(&mesh, &cloud, &protocol));
        let samples = Protocol {
            to_mesh: ToMesh::Samples,
            ..protocol
        };
        assert_near(
            &compare(&mesh, &reference, &samples).unwrap().all,
            &literal(&mesh, &cloud, &samples),
        );
    }
}

#[test]
#[should_panic(expected = "0.0")]
fn the_comparison_with_the_definitions_can_fail() {
    let (mesh, protocol) = (sphere(), quick(Protocol::surface()));
    let cloud: Vec<DVec3> = sample::uniform(&mesh, 2000);
    let reference = Reference::cloud(cloud.iter().map(|&p| p + DVec3::Z * 1e-3).collect()).unwrap();
    assert_near(
        &compare(&mesh, &reference, &protocol).unwrap().all,
        &literal(&mesh, &cloud, &protocol),
    );
}

#[test]
fn a_mesh_beside_a_mesh_is_measured_exactly_both_ways() {
    let mesh = rectangle(2.0, 1.0);
    let reference = Reference::mesh(moved(&mesh, DVec3::Z * 0.07)).unwrap();
    let found = compare(&mesh, &reference, &quick(Protocol::surface())).unwrap();
    for direction in [&found.all.mesh_to_reference, &found.all.reference_to_mesh] {
        assert!((direction.stats.mean_m - 0.07).abs() < 1e-12 && direction.stats.std_m < 1e-12);
    }
    let shares: Vec<_> = found
        .all
        .thresholds
        .iter()
        .map(|t| (t.precision, t.completeness, t.f_score))
        .collect();
    assert_eq!(shares, [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]);
    assert_eq!(
        (found.dense, found.warnings.len(), found.inputs.reference),
        (None, 0, "mesh")
    );
}

#[test]
fn what_is_missing_lowers_completeness_and_what_is_too_much_precision() {
    let (half, whole) = (rectangle(1.0, 1.0), rectangle(2.0, 1.0));
    let protocol = quick(Protocol::surface());
    let at_5_cm = |mesh: &Mesh, reference: &Mesh| {
        compare(mesh, &Reference::mesh(reference.clone()).unwrap(), &protocol)
            .unwrap()
            .all
            .thresholds[0]
    };
    let missing = at_5_cm(&half, &whole);
    assert!(
        missing.precision == 1.0 && (missing.completeness - 0.525).abs() < 2e-3,
        "{missing:?}"
    );
    assert!((missing.f_score - 2.0 * 0.525 / 1.525).abs() < 2e-3);
    let too_much = at_5_cm(&whole, &half);
    assert!(
        too_much.completeness == 1.0 && (too_much.precision - 0.525).abs() < 2e-3,
        "{too_much:?}"
    );
    // Only what was seen is asked for.
    let seen = Reference::mesh(whole)
        .unwrap()
        .with_observed(squares(20, 20, 0.0))
        .unwrap();
    let found = compare(&half, &seen, &protocol).unwrap();
    assert_eq!(
        (found.all.thresholds[0].completeness, found.inputs.reference_points),
        (1.0, 400)
    );
}

#[test]
fn densely_observed_places_have_figures_of_their_own() {
    // The left half of the wall is seen at a point for each 5 cm square, the right one not; the mesh is off there.
    let mut mesh = rectangle(2.0, 1.0);
    mesh.vertices.iter_mut().filter(|v| v.x > 1.0).for_each(|v| v.z = 0.5);
    let mut cloud = squares(20, 20, 0.0);
    cloud.extend((1..10).map(|i| DVec3::new(1.0 + 0.1 * f64::from(i), 0.5, 0.0)));
    let mut protocol = quick(Protocol::surface());
    protocol.dense = DenseRule {
        cube_m: 0.25,
        points: 80,
    };
    let found = compare(&mesh, &Reference::cloud(cloud.clone()).unwrap(), &protocol).unwrap();
    let dense = found.dense.unwrap();
    assert!((0.3..0.6).contains(&dense.share_of_mesh), "{}", dense.share_of_mesh);
    let [there, everywhere] = [&dense.measures, &found.all].map(|m| m.mesh_to_reference.stats);
    assert!(
        there.max_m < 0.8 * everywhere.max_m && there.mean_m < everywhere.mean_m,
        "{there:?} {everywhere:?}"
    );
    // Voxels thin out what is measured, not what was observed.
    protocol.voxel_m = Some(0.2);
    let thinned = compare(&mesh, &Reference::cloud(cloud.clone()).unwrap(), &protocol).unwrap();
    assert!((thinned.dense.unwrap().share_of_mesh - dense.share_of_mesh).abs() < 0.1);
    protocol.dense.points = 100_000;
    let nowhere = compare(&mesh, &Reference::cloud(cloud).unwrap(), &protocol).unwrap();
    assert!(nowhere.dense.is_none() && nowhere.warnings[0].starts_with("no part of both is densely observed"));
}

#[test]
fn limits_leave_out_or_clamp() {
    let distances = [0.1, 0.4, 0.5, 3.0];
    let of = |limit| {
        let (counting, direction) = Direction::of(&distances, limit, "a to b").unwrap();
        (counting, direction.left_out, direction.clamped)
    };
    assert_eq!(of(None), (distances.to_vec(), 0, 0));
    assert_eq!(of(Some(Limit::LeaveOut(0.5))), (vec![0.1, 0.4], 2, 0));
    assert_eq!(of(Some(Limit::Clamp(0.5))), (vec![0.1, 0.4, 0.5, 0.5], 0, 2));
    let none = Direction::of(&distances, Some(Limit::LeaveOut(0.1)), "a to b")
        .unwrap_err()
        .to_string();
    assert!(none.starts_with("all 4 distances from a to b exceed 0.1 m"), "{none}");
}

#[test]
fn the_papers_protocol_masks_thins_and_truncates() {
    // A wall, with a sheet that the reference does not know beyond its box and a bump within it.
    let mut mesh = rectangle(2.0, 1.0);
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend([
        DVec3::new(5.0, 0.0, 0.0),
        DVec3::new(6.0, 0.0, 0.0),
        DVec3::new(5.0, 1.0, 0.0),
    ]);
    mesh.triangles.push([first, first + 1, first + 2]);
    let mut cloud = squares(44, 24, 0.0);
    cloud.iter_mut().for_each(|p| *p -= DVec3::new(0.1, 0.1, 0.0));
    cloud.push(DVec3::new(1.0, 0.5, 3.0));
    let reference = Reference::cloud(cloud).unwrap();
    let protocol = Protocol {
        samples: 20_000,
        ..Protocol::by_name("shine").unwrap()
    };
    let found = compare(&mesh, &reference, &protocol).unwrap();
    // The sheet is masked: nothing is left out as too far.
    assert_eq!(found.all.mesh_to_reference.left_out, 0);
    // 1057 points stay at 4 cm, about 50 × 25 voxels of samples.
    assert!(
        (1200..1500).contains(&found.all.mesh_to_reference.stats.count),
        "{:?}",
        found.all.mesh_to_reference.stats
    );
    assert_eq!(
        (
            found.all.reference_to_mesh.clamped,
            found.all.reference_to_mesh.stats.max_m
        ),
        (1, 2.0)
    );
    let unmasked = Protocol {
        within_reference_box: false,
        ..protocol
    };
    assert!(
        compare(&mesh, &reference, &unmasked)
            .unwrap()
            .all
            .mesh_to_reference
            .left_out
            > 100
    );
}

#[test]
fn a_crop_looks_at_a_part_but_measures_to_the_whole() {
    let mut mesh = rectangle(2.0, 1.0);
    mesh.vertices.iter_mut().filter(|v| v.x > 1.0).for_each(|v| v.z = 1.0);
    let reference = Reference::mesh(rectangle(2.0, 1.0)).unwrap();
    let cropped = |low: f64, high: f64| {
        let crop = Some([DVec3::new(low, -1.0, -1.0), DVec3::new(high, 2.0, 2.0)]);
        compare(
            &mesh,
            &reference,
            &Protocol {
                crop,
                ..quick(Protocol::surface())
            },
        )
    };
    let [left, right] = [cropped(0.0, 0.5), cropped(1.5, 2.0)].map(|found| found.unwrap().all);
    assert!(left.mesh_to_reference.stats.max_m <= 0.25 && right.mesh_to_reference.stats.mean_m > 0.75);
    assert!(left.mesh_to_reference.stats.count < 4000);
    let nothing = cropped(7.0, 8.0).unwrap_err().to_string();
    assert_eq!(
        nothing,
        "no part of the mesh lies within the crop, [7, -1, -1] to [8, 2, 2]"
    );
}

#[test]
fn other_units_and_places_are_called_out() {
    let mesh = sphere();
    let center = DVec3::new(5e5, 4e6, 100.0);
    let warnings = |change: &dyn Fn(DVec3) -> DVec3| {
        let mut other = mesh.clone();
        other.vertices.iter_mut().for_each(|v| *v = change(*v));
        compare(&mesh, &Reference::mesh(other).unwrap(), &quick(Protocol::surface()))
            .unwrap()
            .warnings
    };
    assert_eq!(warnings(&|v| v), [""; 0]);
    for (factor, unit) in [
        (1000.0, "reference in millimetres"),
        (1.0 / 0.3048, "reference in feet"),
        (0.01, "mesh in centimetres"),
        (1.0 / 0.0254, "reference in inches"),
    ] {
        let told = warnings(&|v| center + (v - center) * factor);
        assert!(told.iter().any(|w| w.contains(unit)), "{factor}: {told:?}");
    }
    let told = warnings(&|v| v + DVec3::X * 10.0);
    assert!(
        told.len() == 1
            && told[0].starts_with("the boxes around mesh and reference do not overlap: they are 8.000 m apart"),
        "{told:?}"
    );
    // A sphere within a room: the boxes overlap, the surfaces are apart.
    let told = warnings(&|v| center + (v - center) * 5.0);
    assert!(
        told.len() == 1 && told[0].starts_with("half of the mesh is more than 3.9"),
        "{told:?}"
    );
}

#[test]
fn parts_that_are_not_finite_are_left_out_and_told() {
    let mut mesh = rectangle(1.0, 1.0);
    mesh.vertices.push(DVec3::NAN);
    mesh.triangles.push([0, 1, 4]);
    let mut cloud = squares(20, 20, 0.0);
    cloud.push(DVec3::NAN);
    let told = compare(&mesh, &Reference::cloud(cloud).unwrap(), &quick(Protocol::surface()))
        .unwrap()
        .warnings;
    assert!(
        told.contains(&"1 triangles of the mesh are not finite or absurdly far away; they are left out".to_owned()),
        "{told:?}"
    );
    assert!(
        told.contains(
            &"1 parts of the reference cloud are not finite or absurdly far away; they are left out".to_owned()
        ),
        "{told:?}"
    );
    let empty = compare(
        &Mesh::default(),
        &Reference::cloud(vec![DVec3::ZERO]).unwrap(),
        &Protocol::surface(),
    );
    assert_eq!(
        empty.unwrap_err().to_string(),
        "the mesh has no triangles: is it a cloud of points?"
    );
}

#[test]
fn threads_do_not_matter() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let reference = Reference::cloud(sample::uniform(&sphere(), 2000)).unwrap();
        pool.install(|| compare(&sphere(), &reference, &quick(Protocol::thesis())).unwrap())
    };
    assert_eq!(with(1), with(3));
}
