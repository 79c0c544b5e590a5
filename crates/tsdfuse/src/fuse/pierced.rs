//! The voxels that a line passes through (Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987).
//!
//! The time at which the line crosses a voxel border is computed from the border's number, never summed up: so the walk and
//! the literal test "does the line spend time in this voxel?" use the same numbers and agree exactly.

use glam::{IVec3, Vec3};

use super::cylinder::{Member, round};
use crate::index::GridPoint;

/// A line through `center` along the unit vector `axis`, of which the part within `half_length` voxels of `center` counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment {
    pub(crate) center: GridPoint,
    pub(crate) axis: Vec3,
    pub(crate) half_length: f32,
}

/// An axis along which the line moves slower than this counts as standing still.
const STILL: f32 = 1e-6;

impl Segment {
    /// Half the length of the walk: a voxel whose centre is at most `half_length` from `center` is pierced within it.
    fn reach(&self) -> f32 {
        self.half_length + super::cylinder::VOXEL_RADIUS + 0.01
    }

    /// The voxel with the lowest coordinates that the segment may pierce.
    pub(crate) fn lowest_voxel(&self) -> IVec3 {
        self.center.voxel - (self.reach() * self.axis.abs()).as_ivec3() - 1
    }

    /// The voxel's place relative to the segment's, if its centre is at most `half_length` from `center`.
    #[inline]
    fn member(&self, cell: IVec3) -> Option<Member> {
        let offset = cell.as_vec3() + 0.5 - self.center.fraction;
        let distance2 = offset.length_squared();
        let near = distance2 <= self.half_length * self.half_length;
        near.then(|| Member {
            voxel: self.center.voxel + cell,
            distance2,
            along: offset.dot(self.axis),
        })
    }

    /// When the line crosses the border below cell `border` of one axis.
    #[inline]
    fn crossing(inverse: f32, border: i32, center: f32) -> f32 {
        (border as f32 - center) * inverse
    }

    /// Visits every pierced voxel once, in order along the line.
    #[inline]
    pub(crate) fn for_each(&self, mut visit: impl FnMut(Member)) {
        let reach = self.reach();
        let center = self.center.fraction.to_array();
        let axis = self.axis.to_array();
        let mut cell = [0_i32; 3];
        let mut step = [0_i32; 3];
        let mut ahead = [0_i32; 3]; // from a cell to the border that the line crosses next
        let mut inverse = [0.0_f32; 3];
        let mut next = [f32::INFINITY; 3];
        for k in 0..3 {
            if axis[k].abs() < STILL {
                cell[k] = i32::from(center[k] >= 1.0);
                continue;
            }
            inverse[k] = 1.0 / axis[k];
            (step[k], ahead[k]) = if axis[k] > 0.0 { (1, 1) } else { (-1, 0) };
            cell[k] = round(center[k] - axis[k] * reach - 0.5);
            // This may be a neighbour: the crossing times decide.
            while Self::crossing(inverse[k], cell[k] + ahead[k], center[k]) <= -reach {
                cell[k] += step[k];
            }
            while Self::crossing(inverse[k], cell[k] + ahead[k] - step[k], center[k]) > -reach {
                cell[k] -= step[k];
            }
            next[k] = Self::crossing(inverse[k], cell[k] + ahead[k], center[k]);
        }
        let mut now = -reach;
        loop {
            let k = if next[0] <= next[1] && next[0] <= next[2] {
                0
            } else if next[1] <= next[2] {
                1
            } else {
                2
            };
            if next[k] > now
                && let Some(member) = self.member(cell.into())
            {
                visit(member);
            }
            now = next[k];
            if !(now < reach) {
                return;
            }
            cell[k] += step[k];
            next[k] = Self::crossing(inverse[k], cell[k] + ahead[k], center[k]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every voxel of a cube, tested by its own six borders.
    fn literal(s: &Segment) -> Vec<Member> {
        let reach = s.reach();
        let n = reach.ceil() as i32 + 2;
        let mut all = Vec::new();
        for (z, y, x) in (-n..=n).flat_map(|z| (-n..=n).flat_map(move |y| (-n..=n).map(move |x| (z, y, x)))) {
            let cell = IVec3::new(x, y, z);
            let (mut enter, mut leave) = (-reach, f32::INFINITY);
            for k in 0..3 {
                let (a, c) = (s.axis[k], s.center.fraction[k]);
                if a.abs() < STILL {
                    if cell[k] != c.floor() as i32 {
                        leave = f32::NEG_INFINITY;
                    }
                } else {
                    let times = [0, 1].map(|b| Segment::crossing(1.0 / a, cell[k] + b, c));
                    enter = enter.max(times[0].min(times[1]));
                    leave = leave.min(times[0].max(times[1]));
                }
            }
            if leave > enter && enter < reach {
                all.extend(s.member(cell));
            }
        }
        all
    }

    fn any_segment() -> impl Strategy<Value = Segment> {
        let axis = prop_oneof![
            prop::array::uniform3(-1.0..1.0f32),
            prop::array::uniform3(-1..=1i32).prop_map(|v| IVec3::from(v).as_vec3().to_array()),
            prop::array::uniform3(prop_oneof![-1.0..1.0f32, -1e-5..1e-5f32]),
        ];
        let fraction = prop::array::uniform3(prop_oneof![0.0..1.0f32, Just(0.5), Just(0.0), Just(1.0)]);
        (axis, fraction, 0.5..9.0f32).prop_filter_map("no axis", |(a, f, half_length)| {
            let axis = Vec3::from(a).try_normalize()?;
            Some(Segment {
                center: GridPoint {
                    voxel: IVec3::new(7, -9, 5_000_000),
                    fraction: f.into(),
                },
                axis,
                half_length,
            })
        })
    }

    fn walked(s: &Segment) -> Vec<Member> {
        let mut all = Vec::new();
        s.for_each(|m| all.push(m));
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn the_walk_visits_what_the_literal_test_finds(s in any_segment()) {
            let (mut fast, mut slow) = (walked(&s), literal(&s));
            fast.sort_by_key(|m| m.voxel.to_array());
            slow.sort_by_key(|m| m.voxel.to_array());
            prop_assert_eq!(fast, slow);
        }
    }

    #[test]
    fn a_line_along_an_axis_visits_one_voxel_after_the_other() {
        let center = GridPoint {
            voxel: IVec3::ZERO,
            fraction: Vec3::splat(0.5),
        };
        let x: Vec<i32> = walked(&Segment {
            center,
            axis: -Vec3::X,
            half_length: 4.0,
        })
        .iter()
        .map(|m| m.voxel.x)
        .collect();
        assert_eq!(x, [4, 3, 2, 1, 0, -1, -2, -3, -4]);
    }
}
