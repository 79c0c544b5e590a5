use super::*;
use crate::sample::tests::{rectangle, sphere};
use crate::sample::uniform;
use proptest::prelude::*;
use tsdfuse::glam::DVec3;

/// Every weight is computed anew before each elimination, from all that are left.
fn literal(positions: &[Vec3], count: usize, kernel: &Kernel) -> Vec<u32> {
    let mut left: Vec<u32> = (0..positions.len() as u32).collect();
    while left.len() > count {
        let weight = |i: u32| -> u64 {
            let others = left.iter().filter(|&&j| j != i);
            others
                .map(|&j| kernel.weight(positions[i as usize], positions[j as usize]))
                .sum()
        };
        let heaviest = left.iter().map(|&i| (weight(i), i)).max().unwrap().1;
        left.retain(|&i| i != heaviest);
    }
    left
}

fn nearest_pair_m(points: &[DVec3]) -> f64 {
    let from = |i: usize| points[i + 1..].iter().map(move |p| p.distance(points[i]));
    (0..points.len()).flat_map(from).fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn as_literally(
        points in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f32), 2..160),
        twins in 0..20_usize,
        count in 1..60_usize,
        area in 0.5..20.0,
    ) {
        let mut points: Vec<Vec3> = points.into_iter().map(Vec3::from).collect();
        points.extend_from_within(..twins.min(points.len()));
        let count = count.min(points.len());
        let kernel = Kernel::new(area, count);
        prop_assert_eq!(eliminate(points.clone(), count, &kernel), literal(&points, count, &kernel));
    }
}

#[test]
fn the_comparison_with_the_literal_one_can_fail() {
    let points: Vec<Vec3> = (0..60)
        .map(|i| Vec3::new((i as f32 * 0.618).fract(), (i as f32 * 0.755).fract(), 0.0))
        .collect();
    let kernel = Kernel::new(1.0, 12);
    let mut moved = points.clone();
    moved[7].x += 0.2;
    assert_ne!(eliminate(moved, 12, &kernel), literal(&points, 12, &kernel));
}

#[test]
fn samples_keep_their_distance() {
    // The paper's figure 9: about 0.7 of the largest radius in two dimensions; uniform samples have almost 0.
    for (mesh, name) in [(rectangle(4.0, 1.0), "rectangle"), (sphere(), "sphere")] {
        let area = ByArea::of(&mesh).total_m2();
        let r_max = (area / (2.0 * 3_f64.sqrt() * 1000.0)).sqrt();
        let samples = poisson_disk(&mesh, 1000);
        assert_eq!(samples.len(), 1000, "{name}");
        let rho = nearest_pair_m(&samples) / 2.0 / r_max;
        let plain = nearest_pair_m(&uniform(&mesh, 1000)) / 2.0 / r_max;
        eprintln!("{name}: {rho:.3}, uniform {plain:.3}");
        assert!((0.68..1.0).contains(&rho) && plain < 0.6, "{name}: {rho} {plain}");
    }
}

#[test]
fn every_part_of_the_area_gets_its_share() {
    let samples = poisson_disk(&rectangle(4.0, 1.0), 4000);
    for x in 0..8 {
        let slab = f64::from(x) / 2.0..f64::from(x + 1) / 2.0;
        let count = samples.iter().filter(|p| slab.contains(&p.x)).count();
        assert!((460..=540).contains(&count), "{slab:?}: {count}");
    }
}

#[test]
fn threads_do_not_matter() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| poisson_disk(&sphere(), 2000))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn what_has_no_area_has_no_samples() {
    assert!(poisson_disk(&Mesh::default(), 10).is_empty());
    assert!(poisson_disk(&rectangle(0.0, 1.0), 10).is_empty());
    assert!(poisson_disk(&rectangle(1.0, 1.0), 0).is_empty());
    assert_eq!(poisson_disk(&rectangle(1.0, 1.0), 1).len(), 1);
}
