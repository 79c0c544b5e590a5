//! The voxels, and the blocks, that a line passes through.

use fearless_simd::{Simd, mask32x8, prelude::*};
use glam::{IVec3, Vec3, Vec3A};

use super::cylinder::EightVoxels;
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

/// Those of eight voxels that a line along `axis` passes through. Seen along each edge of a voxel, the line must run within
/// the square that the voxel shows (the axes that can separate a line from a box); on the border, it belongs to one side.
#[inline(always)]
pub(crate) fn pierced<S: Simd>(axis: Vec3, row: &EightVoxels<S>) -> mask32x8<S> {
    let Vec3 { x: ax, y: ay, z: az } = axis;
    let half = |j: f32, k: f32| (0.5 * (j.abs() + k.abs())).max(STILL);
    let (x, y, z) = (row.x, row.y, row.z);
    let along_x = y * az - z * ay;
    let along_x = along_x.simd_gt(-half(ay, az)) & along_x.simd_le(half(ay, az));
    let along_y = z * ax - x * az;
    let along_y = along_y.simd_gt(-half(ax, az)) & along_y.simd_le(half(ax, az));
    let along_z = x * ay - y * ax;
    let along_z = along_z.simd_gt(-half(ax, ay)) & along_z.simd_le(half(ax, ay));
    along_x & along_y & along_z
}

impl Segment {
    /// Visits every block that the segment passes through.
    #[inline(always)]
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
    #[inline(always)]
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
            while crossing(inverse[k], border[k], center) <= -reach {
                border[k] += step[k];
            }
            while crossing(inverse[k], border[k] - step[k], center) > -reach {
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

/// When the line crosses the border below cell `border` of one axis.
#[inline(always)]
fn crossing(inverse: f32, border: f32, center: f32) -> f32 {
    (border - center) * inverse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::cylinder::{
        Cylinder, VOXEL_RADIUS,
        tests::{any_cylinder, literal},
    };
    use proptest::prelude::*;

    /// Whether the line spends time in the voxel at `v`, axis by axis, in f64; `None` if it is too close to tell.
    fn is_pierced(line: &Cylinder, cell: Vec3) -> Option<bool> {
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for k in 0..3 {
            let (a, c) = (f64::from(line.axis[k]), f64::from(line.center.fraction[k]));
            let borders = [0.0, 1.0].map(|b| f64::from(cell[k]) + b - c);
            let drift = 10.0 * a.abs(); // over the length of the line
            if drift < 1e-3 && borders.iter().any(|b| b.abs() < drift + 1e-5) {
                return None;
            }
            if a.abs() < f64::from(STILL) {
                if borders[0] > 0.0 || borders[1] < 0.0 {
                    return Some(false);
                }
            } else {
                let times = borders.map(|b| b / a);
                enter = enter.max(times[0].min(times[1]));
                leave = leave.min(times[0].max(times[1]));
            }
        }
        let lasts = leave - enter;
        (lasts.abs() > 1e-4 * (1.0 + enter.abs())).then_some(lasts > 0.0)
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

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]
        #[test]
        fn pierced_voxels_are_those_that_the_line_spends_time_in(line in any_cylinder(Just(VOXEL_RADIUS))) {
            let found = pierced_by(&line);
            for voxel in literal(&line, |_, _| true) {
                if let Some(wanted) = is_pierced(&line, (voxel - line.center.voxel).as_vec3()) {
                    let (v, along) = (voxel, ((voxel - line.center.voxel).as_vec3() + 0.5 - line.center.fraction).dot(line.axis));
                    let inside = along.abs() < line.half_length - 1e-3;
                    prop_assert!(!inside || wanted == found.contains(&v), "{v} {wanted}");
                }
            }
        }
    }

    /// The pierced voxels of a cylinder.
    fn pierced_by(line: &Cylinder) -> Vec<IVec3> {
        let mut all = Vec::new();
        line.for_each_block_here(|block| {
            fearless_simd::dispatch!(fearless_simd::Level::new(), simd => line.for_each_row(simd, block, |row, v| {
                let mask = (pierced(line.axis, v) & v.within(line.radius, line.half_length)).to_bitmask();
                let first = block.first_voxel() + IVec3::new(0, row as i32 % 8, row as i32 / 8);
                all.extend((0..8).filter(|x| mask >> x & 1 == 1).map(|x| first + IVec3::X * x));
            }));
        });
        all
    }

    #[test]
    fn a_line_along_an_axis_pierces_one_voxel_after_the_other() {
        for fraction in [0.0, 0.3, 0.5, 1.0] {
            for axis in [Vec3::X, -Vec3::Y, Vec3::Z] {
                let center = GridPoint {
                    voxel: IVec3::new(-3, 6, 9),
                    fraction: Vec3::splat(fraction),
                };
                let found = pierced_by(&Cylinder::new(center, axis, VOXEL_RADIUS, 4.2));
                assert!((8..=9).contains(&found.len()), "{fraction} {axis}: {found:?}");
                let beside = |v: &IVec3| ((*v - found[0]).as_vec3() * (Vec3::ONE - axis.abs())).length() > 0.0;
                assert!(!found.iter().any(beside), "{fraction} {axis}: {found:?}");
            }
        }
    }
}
