//! Triangles: nearest points and areas.

use glam::DVec3;

/// The point of a triangle that is nearest to `p` (Ericson, Real-Time Collision Detection, 2005, 5.1.5). If the triangle has no
/// area, the nearest point of its sides.
pub fn closest_on([a, b, c]: [DVec3; 3], p: DVec3) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let longest_squared = ab.length_squared().max(ac.length_squared());
    // For smaller areas the quotients of the inner cases are noise.
    if ab.cross(ac).length_squared() <= 1e-24 * longest_squared * longest_squared {
        let sides = [[a, b], [b, c], [c, a]].map(|side| closest_on_segment(side, p));
        let nearer = |x: DVec3, y: DVec3| {
            if y.distance_squared(p) < x.distance_squared(p) {
                y
            } else {
                x
            }
        };
        return sides.into_iter().fold(a, nearer);
    }
    let [d1, d2] = [ab.dot(p - a), ac.dot(p - a)];
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let [d3, d4] = [ab.dot(p - b), ac.dot(p - b)];
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let [d5, d6] = [ab.dot(p - c), ac.dot(p - c)];
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    a + (ab * vb + ac * vc) / (va + vb + vc)
}

/// The point of a segment that is nearest to `p`.
fn closest_on_segment([a, b]: [DVec3; 2], p: DVec3) -> DVec3 {
    let ab = b - a;
    let along = ab.dot(p - a) / ab.length_squared();
    // NaN for a segment without length.
    if along > 0.0 { a + ab * along.min(1.0) } else { a }
}

/// The area of a triangle, m².
pub fn area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The nearest of a fine lattice of barycentric points: never nearer than the truth.
    fn by_lattice([a, b, c]: [DVec3; 3], p: DVec3, n: u32) -> f64 {
        let at = |i: u32, j: u32| a + (b - a) * (f64::from(i) / f64::from(n)) + (c - a) * (f64::from(j) / f64::from(n));
        let lattice = (0..=n).flat_map(|i| (0..=n - i).map(move |j| (i, j)));
        lattice.map(|(i, j)| at(i, j).distance(p)).fold(f64::INFINITY, f64::min)
    }

    fn point() -> impl Strategy<Value = DVec3> {
        // Whole numbers make degenerate triangles likely.
        let whole = prop::array::uniform3(-2..=2_i32).prop_map(|c| DVec3::from(c.map(f64::from)));
        prop_oneof![whole, prop::array::uniform3(-2.0..2.0).prop_map(DVec3::from)]
    }

    proptest! {
        #[test]
        fn the_nearest_point_is_on_the_triangle_and_nearest(t in prop::array::uniform3(point()), p in point()) {
            let found = closest_on(t, p).distance(p);
            let lattice = by_lattice(t, p, 60);
            // The lattice's cells are at most 6 m / 60 across.
            prop_assert!(found <= lattice + 1e-9 && lattice <= found + 0.1, "{found} {lattice}");
            prop_assert!(by_lattice(t, closest_on(t, p), 60) <= 0.1);
        }
    }
}
