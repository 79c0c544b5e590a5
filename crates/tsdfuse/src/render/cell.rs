//! The field in one cell: trilinear between its eight corners, and cubic along a ray.
//!
//! ```text
//!   F ▲ ●                       the samples at 0, ⅓, ⅔ and 1 of the way through the cell tell the cubic; it is
//!     │    ╲  e₁        ╱●      monotone between its extrema e₁, e₂, so the first piece that falls from F ≥ 0
//!   0 ┼─────╳──────╳───╳──▶     to F < 0 holds the first crossing from the front
//!     │       ╲__╱
//! ```

use glam::Vec3;

use crate::trilinear::{Corners, trilinear};

/// A ray that enters a cell this little behind the surface came from the front; the difference is due to rounding. In units of
/// the truncation.
const ROUNDING: f32 = 1e-6;

/// Where the way from `enter` to `leave` first crosses the surface from the front (F ≥ 0) to behind it (F < 0), as a share of
/// the way.
#[inline]
pub(super) fn crossing(corners: &Corners<f32>, enter: Vec3, leave: Vec3) -> Option<f32> {
    let third = (leave - enter) * (1.0 / 3.0);
    let samples = [0.0, 1.0, 2.0, 3.0].map(|u| trilinear(corners, enter + third * u));
    let cubic = Cubic::through(samples);
    let mut from = (0.0, samples[0]);
    for u in cubic.extrema().into_iter().chain([3.0]) {
        let to = (u, if u == 3.0 { samples[3] } else { cubic.at(u) });
        let in_front = from.1 >= if from.0 == 0.0 { -ROUNDING } else { 0.0 };
        if in_front && to.1 < 0.0 && to.1 < from.1 {
            return Some(cubic.root(from, to) * (1.0 / 3.0));
        }
        from = to;
    }
    None
}

/// c₀ + c₁u + c₂u² + c₃u³.
struct Cubic([f32; 4]);

impl Cubic {
    /// Through the values at u = 0, 1, 2, 3 (Newton's forward differences).
    #[inline]
    fn through([a, b, c, d]: [f32; 4]) -> Self {
        let (first, second, third) = (b - a, c - 2.0 * b + a, d - 3.0 * c + 3.0 * b - a);
        Self([
            a,
            first - 0.5 * second + third * (1.0 / 3.0),
            0.5 * (second - third),
            third * (1.0 / 6.0),
        ])
    }

    #[inline]
    fn at(&self, u: f32) -> f32 {
        let [a, b, c, d] = self.0;
        a + u * (b + u * (c + u * d))
    }

    /// Where it turns within 0 < u < 3, ascending; 3 stands for nowhere.
    #[inline]
    fn extrema(&self) -> [f32; 2] {
        let [_, b, c, d] = self.0;
        // 3 d u² + 2 c u + b = 0, by the form that does not cancel.
        let inside = c * c - 3.0 * b * d;
        if inside <= 0.0 {
            return [3.0; 2];
        }
        let q = -(c + inside.sqrt().copysign(c));
        let within = |u: f32| if u > 0.0 && u < 3.0 { u } else { 3.0 };
        let (u, v) = (within(q / (3.0 * d)), within(b / q));
        [u.min(v), u.max(v)]
    }

    /// The root on a monotone piece between two places on either side of it, by false position (Illinois).
    fn root(&self, (mut a, mut fa): (f32, f32), (mut b, mut fb): (f32, f32)) -> f32 {
        if fa <= 0.0 {
            return a;
        }
        let mut u = a;
        for _ in 0..16 {
            u = a + (b - a) * (fa / (fa - fb));
            let f = self.at(u);
            if f.abs() < ROUNDING {
                break;
            }
            if f > 0.0 {
                (a, fa, fb) = (u, f, 0.5 * fb);
            } else {
                (b, fb, fa) = (u, f, 0.5 * fa);
            }
        }
        u
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The first step of many at which the field falls below zero.
    fn literal(corners: &Corners<f32>, enter: Vec3, leave: Vec3) -> Option<f32> {
        let at = |i: i32| trilinear(corners, enter.lerp(leave, i as f32 / 3000.0));
        (1..=3000)
            .find(|&i| at(i - 1) >= 0.0 && at(i) < 0.0)
            .map(|i| (i as f32 - 0.5) / 3000.0)
    }

    fn place() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(0.0..1.0f32).prop_map(Vec3::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn crossings_are_where_small_steps_find_them(
            corners in prop::array::uniform8(-1.0..1.0f32), enter in place(), leave in place(),
        ) {
            let (got, want) = (crossing(&corners, enter, leave), literal(&corners, enter, leave));
            match (got, want) {
                (Some(got), Some(want)) => prop_assert!((got - want).abs() < 2e-3, "{got} {want}"),
                (None, None) => {}
                // A dip, or a corner of the cube, too short for the steps.
                (Some(s), None) => prop_assert!(trilinear(&corners, enter.lerp(leave, s)).abs() < 1e-4),
                (None, Some(s)) => prop_assert!(false, "missed at {s}"),
            }
        }

        #[test]
        fn a_linear_field_is_met(normal in place(), enter in place(), leave in place(), offset in 0.0..1.5f32) {
            let corners = std::array::from_fn(|c| {
                let corner = Vec3::new((c & 1) as f32, (c >> 1 & 1) as f32, (c >> 2) as f32);
                normal.dot(corner) - offset
            });
            let (f, g) = (normal.dot(enter) - offset, normal.dot(leave) - offset);
            prop_assume!(f.abs() > 1e-3 && g.abs() > 1e-3 && (f - g).abs() > 1e-3);
            let want = (f > 0.0 && g < 0.0).then(|| f / (f - g));
            let got = crossing(&corners, enter, leave);
            prop_assert_eq!(got.is_some(), want.is_some());
            if let (Some(got), Some(want)) = (got, want) {
                prop_assert!((got - want).abs() < 1e-3, "{got} {want}");
            }
        }
    }

    #[test]
    fn only_the_way_in_counts_and_the_first_of_two() {
        let wall = |front: f32, back: f32| [front, back, front, back, front, back, front, back];
        let across = |corners: &Corners<f32>| crossing(corners, Vec3::new(0.0, 0.5, 0.5), Vec3::new(1.0, 0.5, 0.5));
        assert!((across(&wall(0.3, -0.1)).unwrap() - 0.75).abs() < 1e-5);
        assert_eq!(across(&wall(-0.3, 0.1)), None);
        assert_eq!(across(&wall(-0.1, -0.3)), None);
        // Left by rounding on the front, entered by rounding behind: seen once, here.
        assert_eq!(across(&wall(-1e-8, -0.3)), Some(0.0));
        assert_eq!(across(&wall(0.3, 1e-8)), None);
    }
}
