//! The voxels that a line passes through (Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987).
//!
//! The time at which the line crosses a voxel border is computed from the border's number, never summed up: so the walk and
//! the literal test "does the line spend time in this voxel?" use the same numbers and agree exactly.

use glam::{IVec3, Vec3, Vec3A};

use super::cylinder::Member;
use crate::index::{BLOCK_EDGE, BlockIndex, GridPoint, round};

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
    fn member(&self, cell: Vec3A) -> Option<Member> {
        let offset = cell + 0.5 - Vec3A::from(self.center.fraction);
        let distance2 = offset.length_squared();
        let along = offset.dot(self.axis.into());
        let near = distance2 <= self.half_length * self.half_length;
        let voxel = self.center.voxel + IVec3::from(cell.to_array().map(round));
        near.then_some(Member {
            voxel,
            distance2,
            along,
        })
    }

    /// When the line crosses the border below cell `border` of one axis.
    #[inline]
    fn crossing(inverse: f32, border: f32, center: f32) -> f32 {
        (border - center) * inverse
    }

    /// Visits every pierced voxel once, in order along the line.
    #[inline]
    pub(crate) fn for_each(&self, mut visit: impl FnMut(Member)) {
        self.walk(self.reach(), |cell| {
            if let Some(member) = self.member(cell) {
                visit(member);
            }
        });
    }

    /// Visits every block that the segment passes through.
    pub(crate) fn for_each_block(&self, mut visit: impl FnMut(BlockIndex)) {
        let block = BlockIndex::of(self.center.voxel);
        let place = (self.center.voxel - block.first_voxel()).as_vec3() + self.center.fraction;
        let in_blocks = Self {
            center: GridPoint {
                voxel: block.0,
                fraction: place / BLOCK_EDGE as f32,
            },
            axis: self.axis,
            half_length: self.half_length / BLOCK_EDGE as f32,
        };
        in_blocks.walk(in_blocks.half_length, |cell| {
            visit(BlockIndex(block.0 + IVec3::from(cell.to_array().map(round))));
        });
    }

    /// Visits every cell that the line pierces within `reach` of the centre, by its place relative to the centre's cell.
    #[inline]
    fn walk(&self, reach: f32, mut visit: impl FnMut(Vec3A)) {
        let mut cell = [0.0_f32; 3];
        let mut step = [0.0_f32; 3];
        let mut border = [0.0_f32; 3]; // that the line crosses next
        let mut inverse = [f32::INFINITY; 3];
        for k in 0..3 {
            let (axis, center) = (self.axis[k], self.center.fraction[k]);
            if axis.abs() < STILL {
                cell[k] = if center >= 1.0 { 1.0 } else { 0.0 };
                border[k] = center + 1.0; // crossed never: 1·∞
                continue;
            }
            inverse[k] = 1.0 / axis;
            let ahead = if axis > 0.0 { 1.0 } else { 0.0 };
            step[k] = 2.0 * ahead - 1.0;
            border[k] = round(center - axis * reach - 0.5) as f32 + ahead;
            // This may be a neighbour's: the crossing times decide.
            while Self::crossing(inverse[k], border[k], center) <= -reach {
                border[k] += step[k];
            }
            while Self::crossing(inverse[k], border[k] - step[k], center) > -reach {
                border[k] -= step[k];
            }
            cell[k] = border[k] - ahead;
        }
        let center = Vec3A::from(self.center.fraction);
        let (mut cell, mut border) = (Vec3A::from(cell), Vec3A::from(border));
        let (step, inverse) = (Vec3A::from(step), Vec3A::from(inverse));
        loop {
            let next = (border - center) * inverse; // as `crossing`, for all axes
            visit(cell);
            let now = next.min_element();
            if !(now < reach) {
                return;
            }
            // Through an edge or a corner the line crosses several borders at once.
            let crossed = Vec3A::select(next.cmple(Vec3A::splat(now)), step, Vec3A::ZERO);
            cell += crossed;
            border += crossed;
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
                    let times = [0, 1].map(|b| Segment::crossing(1.0 / a, (cell[k] + b) as f32, c));
                    enter = enter.max(times[0].min(times[1]));
                    leave = leave.min(times[0].max(times[1]));
                }
            }
            if leave > enter && enter < reach {
                all.extend(s.member(cell.as_vec3a()));
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

    /// Every block near the segment that a fine walk along it meets.
    fn sampled_blocks(s: &Segment, steps: i32) -> std::collections::BTreeSet<BlockIndex> {
        let at = |i: i32| s.center.fraction + s.axis * s.half_length * (i as f32 / steps as f32);
        (-steps..=steps)
            .map(|i| BlockIndex::of(s.center.voxel + at(i).floor().as_ivec3()))
            .collect()
    }

    proptest! {
        #[test]
        fn the_blocks_of_a_segment_are_those_it_meets(s in any_segment()) {
            let mut walked = std::collections::BTreeSet::new();
            s.for_each_block(|block| assert!(walked.insert(block), "{block:?} twice"));
            // On a border the walk may take either side; no sample falls on one here.
            let s = Segment { center: GridPoint { fraction: s.center.fraction.clamp(Vec3::splat(0.01), Vec3::splat(0.99)), ..s.center }, ..s };
            let mut inner = std::collections::BTreeSet::new();
            s.for_each_block(|block| { inner.insert(block); });
            let met = sampled_blocks(&s, 4000);
            prop_assert!(met.is_subset(&inner), "{met:?} {inner:?}");
            // A block that is cut by less than a step may be missed by the samples.
            prop_assert!(inner.len() <= met.len() + 1, "{met:?} {inner:?}");
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
