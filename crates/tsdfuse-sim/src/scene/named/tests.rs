use glam::DVec3;

use super::*;
use crate::primitive::{Aabb, Primitive};

const SEEDS: [u64; 2] = [0, 7];

/// A point in both solids, up to `slack`, by projecting on one and the other in turn; sure to be found where both are convex.
fn touch((a, a_box): &(&Primitive, Aabb), (b, b_box): &(&Primitive, Aabb), slack: f64) -> bool {
    let (low, high) = (a_box.min.max(b_box.min), a_box.max.min(b_box.max));
    if (low - high).max_element() > slack {
        return false;
    }
    [0.5, 0.1, 0.9].into_iter().any(|start| {
        let mut p = low.lerp(high, start);
        let mut before = f64::INFINITY;
        loop {
            let mut outside = 0.0_f64;
            for solid in [*a, *b] {
                let d = solid.signed_distance(p);
                outside = outside.max(d);
                if d > 0.0 {
                    p -= d * gradient(solid, p);
                }
            }
            // Between solids that are apart the point goes to and fro.
            if outside < slack || outside > before - 1e-5 {
                return outside < slack;
            }
            before = outside;
        }
    })
}

fn gradient(solid: &Primitive, p: DVec3) -> DVec3 {
    let step = 1e-6;
    let d = |axis: DVec3| solid.signed_distance(p + axis * step) - solid.signed_distance(p - axis * step);
    DVec3::new(d(DVec3::X), d(DVec3::Y), d(DVec3::Z)).normalize_or_zero()
}

/// Bounds of the parts that are not joined to the largest solid, the ground.
fn floating(solids: &[Primitive]) -> Vec<Aabb> {
    let boxed: Vec<_> = solids.iter().map(|s| (s, s.bounds())).collect();
    let volume = |i: &usize| (boxed[*i].1.max - boxed[*i].1.min).element_product();
    let mut loose: Vec<usize> = (0..boxed.len()).collect();
    loose.sort_by(|i, j| volume(i).total_cmp(&volume(j)));
    let mut front: Vec<usize> = loose.pop().into_iter().collect();
    while let Some(joined) = front.pop() {
        loose.retain(|&i| {
            let touches = touch(&boxed[joined], &boxed[i], 2e-3);
            if touches {
                front.push(i);
            }
            !touches
        });
    }
    loose.into_iter().map(|i| boxed[i].1).collect()
}

#[test]
fn nothing_floats() {
    for name in ["street", "hall"] {
        for seed in SEEDS {
            let scene = by_name(name, seed).unwrap();
            let loose = floating(scene.primitives());
            assert!(
                loose.is_empty(),
                "{name} {seed}: {} loose: {:.2?}",
                loose.len(),
                &loose[..loose.len().min(12)]
            );
        }
    }
}

#[test]
fn what_floats_is_found() {
    let scene = by_name("hall", 0).unwrap();
    let mut solids = scene.primitives().to_vec();
    solids.push(Primitive::ellipsoid(DVec3::splat(0.1)).at(0.0, 0.0, 3.0));
    assert_eq!(floating(&solids).len(), 1);
}

#[test]
fn seeds_vary_the_scene_and_repeat_it() {
    for name in ["street", "hall"] {
        let probe = |seed| {
            let scene = by_name(name, seed).unwrap();
            let points = (0..2000).map(|i| DVec3::new(f64::from(i) * 0.01 - 10.0, f64::from(i % 17) - 8.0, 0.7));
            points.map(|p| scene.signed_distance(p)).collect::<Vec<_>>()
        };
        assert_eq!(probe(3), probe(3));
        assert_ne!(probe(3), probe(4));
    }
    assert!(names().iter().all(|name| by_name(name, 0).is_some()));
    assert!(by_name("moon", 0).is_none());
}
