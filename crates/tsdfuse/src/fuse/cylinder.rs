//! The voxels about a line: what raycasting (5.5)(5.6), local normals (5.14)(5.15) and surfels (5.21)(5.22) all update.
//!
//! A literal implementation tests every voxel of a cube. This one names the blocks that the cylinder may reach into, and in a
//! block visits the rows, along x, that it may reach into, eight voxels at a time. Both only propose: they are widened by
//! [`SLACK`], and the predicates that methods apply to the eight voxels decide, so that rounding cannot make the two differ.

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};
use glam::{IVec3, Vec3};

use super::gather::{ROW, ROWS};
use crate::index::{BLOCK_EDGE, BlockIndex, GridPoint, round};

/// √3/2: the largest distance of a point in a voxel to its centre, in voxels (5.6).
pub const VOXEL_RADIUS: f32 = 0.866_025_4;

/// Widening of what is proposed, in voxels: far above the rounding errors of f32 within a cylinder.
pub(super) const SLACK: f32 = 0.01;

/// From the middle of a block to the centres of its outermost voxels.
const HALF_BLOCK: f32 = 0.5 * (BLOCK_EDGE - 1) as f32;

/// All voxels whose centre is at most `radius` from the line through `center` along `axis`, and at most `half_length` from
/// the plane through `center` across it. Lengths in voxels, `axis` of unit length.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Cylinder {
    pub(crate) center: GridPoint,
    pub(crate) axis: Vec3,
    pub(crate) radius: f32,
    pub(crate) half_length: f32,
    /// Half the edges of the bounding box.
    half_box: Vec3,
    /// 1/√(1 − a_x²): how much farther it is along x than straight to the axis; not infinite.
    stretch_x: f32,
}

/// Eight voxels, in a row of a block or not: their centres v relative to the centre c of a line, in voxels.
#[derive(Clone, Copy, Debug)]
pub struct EightVoxels<S: Simd> {
    /// v − c along the world's x axis.
    pub x: f32x8<S>,
    /// v − c along y.
    pub y: f32x8<S>,
    /// v − c along z.
    pub z: f32x8<S>,
    /// (v − c)·axis: how far they are along the line.
    pub along: f32x8<S>,
    /// ‖v − c‖².
    pub distance2: f32x8<S>,
}

impl<S: Simd> EightVoxels<S> {
    /// Those at most `radius` from the line, and at most `half_length` from its centre along it.
    #[inline(always)]
    pub fn within(&self, radius: f32, half_length: f32) -> mask32x8<S> {
        (self.distance2 - self.along * self.along).simd_le(radius * radius) & self.along.abs().simd_le(half_length)
    }
}

impl Cylinder {
    #[inline(always)]
    pub(crate) fn new(center: GridPoint, axis: Vec3, radius: f32, half_length: f32) -> Self {
        let across = (Vec3::ONE - axis * axis).max(Vec3::ZERO);
        let across = Vec3::new(across.x.sqrt(), across.y.sqrt(), across.z.sqrt());
        Self {
            center,
            axis,
            radius,
            half_length,
            half_box: axis.abs() * half_length + across * radius + SLACK,
            stretch_x: 1.0 / across.x.max(1e-3),
        }
    }

    /// The centre of a voxel relative to the cylinder's.
    #[inline(always)]
    fn offset(&self, voxel: IVec3) -> Vec3 {
        (voxel - self.center.voxel).as_vec3() + 0.5 - self.center.fraction
    }

    /// Visits the blocks that the cylinder may reach into.
    #[inline(always)]
    pub(crate) fn for_each_block<S: Simd>(&self, simd: S, mut visit: impl FnMut(BlockIndex)) {
        let lowest = self.center.fraction - self.half_box;
        let highest = self.center.fraction + self.half_box;
        let of = |v: Vec3| BlockIndex::of(self.center.voxel + IVec3::new(round(v.x), round(v.y), round(v.z)));
        let (first, last) = (of(lowest).0, of(highest - 1.0).0);
        if (last - first).max_element() <= 1 {
            self.for_each_corner(simd, first, visit);
        } else {
            self.for_each_column(&mut visit);
        }
    }

    /// As [`Self::for_each_block`], if all blocks are among the 2 × 2 × 2 from `first` on: all of them at once.
    #[inline(always)]
    fn for_each_corner<S: Simd>(&self, simd: S, first: IVec3, mut visit: impl FnMut(BlockIndex)) {
        let (axis, a, edge) = (self.axis, self.axis.abs(), BLOCK_EDGE as f32);
        let middle = self.offset(BlockIndex(first).first_voxel()) + HALF_BLOCK;
        let x = f32x8::simd_from(simd, [0.0, edge, 0.0, edge, 0.0, edge, 0.0, edge]) + middle.x;
        let y = f32x8::simd_from(simd, [0.0, 0.0, edge, edge, 0.0, 0.0, edge, edge]) + middle.y;
        let z = f32x8::simd_from(simd, [0.0, 0.0, 0.0, 0.0, edge, edge, edge, edge]) + middle.z;
        let near_box = self.half_box + HALF_BLOCK;
        let in_box = x.abs().simd_le(near_box.x) & y.abs().simd_le(near_box.y) & z.abs().simd_le(near_box.z);
        // Seen along an edge of the blocks.
        let wide = self.half_box - a * self.half_length + HALF_BLOCK * (a.element_sum() - a);
        let near_line = (y * axis.z - z * axis.y).abs().simd_le(wide.x)
            & (z * axis.x - x * axis.z).abs().simd_le(wide.y)
            & (x * axis.y - y * axis.x).abs().simd_le(wide.z);
        let thick = self.half_length + HALF_BLOCK * a.element_sum() + SLACK;
        let near_plane = (x * axis.x + (y * axis.y + z * axis.z)).abs().simd_le(thick);
        let mut blocks = (in_box & near_line & near_plane).to_bitmask();
        while blocks != 0 {
            let b = blocks.trailing_zeros() as i32;
            blocks &= blocks - 1;
            visit(BlockIndex(first + IVec3::new(b & 1, b >> 1 & 1, b >> 2)));
        }
    }

    /// As [`Self::for_each_block`]: column by column along the dominant axis.
    #[inline(never)]
    fn for_each_column(&self, visit: &mut impl FnMut(BlockIndex)) {
        let a = self.axis.abs();
        if a.x >= a.y && a.x >= a.z {
            self.walk_columns::<0, 1, 2>(visit);
        } else if a.y >= a.z {
            self.walk_columns::<1, 2, 0>(visit);
        } else {
            self.walk_columns::<2, 0, 1>(visit);
        }
    }

    #[inline(always)]
    fn walk_columns<const M: usize, const U: usize, const W: usize>(&self, visit: &mut impl FnMut(BlockIndex)) {
        let edge = BLOCK_EDGE as f32;
        let home = BlockIndex::of(self.center.voxel);
        let middle = self.offset(home.first_voxel()) + HALF_BLOCK; // of the centre's block
        let (axis, a) = (self.axis, self.axis.abs());
        let half_box = self.half_box + HALF_BLOCK;
        let (low, high) = ((-half_box - middle) / edge, (half_box - middle) / edge);
        // How far the middle of a block may be from the plane, and from the line seen along an edge of the block.
        let thick = self.half_length + HALF_BLOCK * a.element_sum() + SLACK;
        let wide =
            |j: usize, k: usize| HALF_BLOCK * (a[j] + a[k]) + self.radius * (a[j] * a[j] + a[k] * a[k]).sqrt() + SLACK;
        let (wide_m, wide_u, wide_w) = (wide(U, W), wide(W, M), wide(M, U));
        let inverse = 1.0 / axis[M];
        for w in round(low[W] + 0.5)..=round(high[W] - 0.5) {
            let dw = middle[W] + edge * w as f32;
            for u in round(low[U] + 0.5)..=round(high[U] - 0.5) {
                let du = middle[U] + edge * u as f32;
                if (du * axis[W] - dw * axis[U]).abs() > wide_m {
                    continue;
                }
                let plane = -(du * axis[U] + dw * axis[W]) * inverse - middle[M];
                let half = thick * inverse.abs();
                let first = low[M].max((plane - half) / edge);
                let last = high[M].min((plane + half) / edge);
                for m in round(first + 0.5)..=round(last - 0.5) {
                    let dm = middle[M] + edge * m as f32;
                    let beside = (dw * axis[M] - dm * axis[W]).abs() > wide_u;
                    if beside || (dm * axis[U] - du * axis[M]).abs() > wide_w {
                        continue;
                    }
                    let mut block = home.0;
                    (block[M], block[U], block[W]) = (home.0[M] + m, home.0[U] + u, home.0[W] + w);
                    visit(BlockIndex(block));
                }
            }
        }
    }

    /// Visits the rows of a block, by their numbers y + 8 z, that the cylinder may reach into.
    #[inline(always)]
    pub(crate) fn for_each_row<S: Simd>(
        &self,
        simd: S,
        block: BlockIndex,
        mut visit: impl FnMut(usize, &EightVoxels<S>),
    ) {
        let cell = (block.first_voxel() - self.center.voxel).as_vec3();
        let steps = f32x8::simd_from(simd, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let x = (steps + cell.x) + 0.5 - self.center.fraction.x;
        let y = (steps + cell.y) + 0.5 - self.center.fraction.y;
        let (x2, y2) = (x * x, y * y);
        let (along_x, along_y) = (x * self.axis.x, y * self.axis.y);

        // Which rows: eight of them at a time, those with one z. A row is a line along x.
        let Vec3 { x: ax, y: ay, z: az } = self.axis;
        let middle = cell.x + 0.5 - self.center.fraction.x + HALF_BLOCK;
        let wide = self.radius * (1.0 - ax * ax) * self.stretch_x + SLACK; // how near to the axis it must come, over `stretch_x`
        let nearest = ax * self.stretch_x * self.stretch_x; // where it comes nearest to the axis
        let reach_x = HALF_BLOCK + self.radius * self.stretch_x + SLACK;
        let thick = self.half_length + HALF_BLOCK * ax.abs() + SLACK; // how near to the plane its middle must be
        let in_box = y.abs().simd_le(self.half_box.y);
        let mut rows = 0_u64;
        let mut along_yz = [[0.0; ROW]; ROW];
        let mut distance2_yz = [[0.0; ROW]; ROW];
        for k in 0..ROW {
            let z = (cell.z + k as f32) + 0.5 - self.center.fraction.z;
            let along = along_y + z * az;
            let near_line = (y * az - z * ay).abs().simd_le(wide) & (along * nearest - middle).abs().simd_le(reach_x);
            let near_plane = (along + middle * ax).abs().simd_le(thick);
            rows |= (in_box & near_line & near_plane).to_bitmask() << (ROW * k);
            along_yz[k] = along.into();
            distance2_yz[k] = (y2 + z * z).into();
        }
        let first_z = cell.z + 0.5 - self.center.fraction.z;
        rows &= layers(-self.half_box.z - first_z, self.half_box.z - first_z);
        while rows != 0 {
            let row = rows.trailing_zeros() as usize % ROWS;
            rows &= rows - 1;
            let (j, k) = (row % ROW, row / ROW);
            let voxels = EightVoxels {
                x,
                y: f32x8::splat(simd, (cell.y + j as f32) + 0.5 - self.center.fraction.y),
                z: f32x8::splat(simd, (cell.z + k as f32) + 0.5 - self.center.fraction.z),
                along: along_x + along_yz[k][j],
                distance2: x2 + distance2_yz[k][j],
            };
            visit(row, &voxels);
        }
    }
}

/// The rows of a block between two coordinates z relative to its first one; either may lie far outside.
#[inline(always)]
fn layers(low: f32, high: f32) -> u64 {
    below(high) & !below(low)
}

/// The rows of a block below a coordinate z.
#[inline(always)]
fn below(z: f32) -> u64 {
    let k = round((z + 0.5).max(0.0).min(ROW as f32)) as u32;
    u64::MAX.checked_shr(64 - ROW as u32 * k).unwrap_or(0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    impl Cylinder {
        pub(crate) fn for_each_block_here(&self, visit: impl FnMut(BlockIndex)) {
            dispatch!(Level::new(), simd => self.for_each_block(simd, visit));
        }
    }

    /// Every block that any voxel of a cube lies in, in which every row is visited that the fast walk visits.
    pub(crate) fn visited(c: &Cylinder, inside: impl Fn(f32, f32) -> bool) -> Vec<IVec3> {
        let mut all = Vec::new();
        c.for_each_block_here(|block| {
            dispatch!(Level::new(), simd => c.for_each_row(simd, block, |row, v| {
                let (y, z) = (row as i32 % 8, row as i32 / 8);
                for x in 0..8 {
                    if inside(v.along[x], v.distance2[x]) {
                        all.push(block.first_voxel() + IVec3::new(x as i32, y, z));
                    }
                }
            }));
        });
        all.sort_by_key(glam::IVec3::to_array);
        all
    }

    /// Every voxel of a cube, tested one by one.
    pub(crate) fn literal(c: &Cylinder, inside: impl Fn(f32, f32) -> bool) -> Vec<IVec3> {
        let reach = (c.half_length + c.radius).ceil() as i32 + 2;
        let cube = || -reach..=reach;
        let mut all = Vec::new();
        for (x, y, z) in cube().flat_map(|x| cube().flat_map(move |y| cube().map(move |z| (x, y, z)))) {
            let voxel = c.center.voxel + IVec3::new(x, y, z);
            let v = c.offset(voxel);
            let along = v.x * c.axis.x + (v.y * c.axis.y + v.z * c.axis.z);
            if inside(along, v.x * v.x + (v.y * v.y + v.z * v.z)) {
                all.push(voxel);
            }
        }
        all
    }

    pub(crate) fn any_cylinder(radius: impl Strategy<Value = f32>) -> impl Strategy<Value = Cylinder> {
        let axis = prop_oneof![
            prop::array::uniform3(-1.0..1.0f32),
            prop::array::uniform3(-1..=1i32).prop_map(|v| IVec3::from(v).as_vec3().to_array()),
            prop::array::uniform3(prop_oneof![-1.0..1.0f32, -1e-5..1e-5f32]),
        ];
        let fraction = prop::array::uniform3(prop_oneof![0.0..1.0f32, Just(0.5), Just(0.0), Just(1.0)]);
        (axis, fraction, radius, 0.5..9.0f32, 0..512).prop_filter_map("no axis", |(a, f, radius, half_length, at)| {
            let axis = Vec3::from(a).try_normalize()?;
            let center = GridPoint {
                voxel: IVec3::new(-3 + (at & 7), 1000 + (at >> 3 & 7), -70_000 + (at >> 6)),
                fraction: f.into(),
            };
            Some(Cylinder::new(center, axis, radius, half_length))
        })
    }

    fn member(c: &Cylinder) -> impl Fn(f32, f32) -> bool {
        let (radius2, half_length) = (c.radius * c.radius, c.half_length);
        move |along, distance2| distance2 - along * along <= radius2 && along.abs() <= half_length
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn thin_ones_hold_what_the_literal_test_finds(c in any_cylinder(0.3..2.0f32)) {
            prop_assert_eq!(visited(&c, member(&c)), literal(&c, member(&c)));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn discs_hold_what_the_literal_test_finds(c in any_cylinder(2.0..20.0f32)) {
            prop_assert_eq!(visited(&c, member(&c)), literal(&c, member(&c)));
        }

        #[test]
        fn rows_are_not_visited_for_nothing(c in any_cylinder(Just(VOXEL_RADIUS))) {
            let mut rows = BTreeMap::new();
            c.for_each_block_here(|block| {
                dispatch!(Level::new(), simd => c.for_each_row(simd, block, |row, _| {
                    *rows.entry((block, row)).or_insert(0) += 1;
                }));
            });
            prop_assert!(rows.values().all(|&n| n == 1));
            prop_assert!(rows.len() as f32 <= 25.0 + 12.0 * c.half_length, "{} rows", rows.len());
        }
    }

    #[test]
    fn the_comparison_would_see_a_missing_voxel() {
        let center = GridPoint {
            voxel: IVec3::ZERO,
            fraction: Vec3::splat(0.3),
        };
        let c = Cylinder::new(center, Vec3::new(0.6, 0.0, 0.8), VOXEL_RADIUS, 4.0);
        let all = visited(&c, member(&c));
        assert_eq!(all, literal(&c, member(&c)));
        let shorter = Cylinder { half_length: 3.5, ..c };
        assert_ne!(all, visited(&shorter, member(&shorter)));
    }
}
