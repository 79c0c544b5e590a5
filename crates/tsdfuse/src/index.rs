//! All arithmetic of voxels, blocks, regions, shards and the world, and nothing else.
//!
//! ```text
//!   world x, metres     -0.40            0.00  0.05  0.10            0.40          κ = 0.05 m
//!                         |---- block -1 ---|---- block 0 -------------|
//!   voxel index             -8 … -1            0     1   …     7         8 …
//!   voxel i covers [iκ, (i+1)κ), its centre is (i+½)κ;   block = floor(i / 8),  local = i mod 8
//!
//!   number of a voxel in its block: x + 8 y + 64 z  (local coordinates);   of a block in its region: the same
//!
//!   voxel ─ 8³ ─▶ block ─ 8³ ─▶ region ─ spatial hash (5.1) ─▶ shard: the part of a map's table that holds it
//! ```

use glam::{DVec3, IVec3, Vec3};

/// Voxels along the edge of a block.
pub const BLOCK_EDGE: i32 = 8;
/// Voxels in a block.
pub const BLOCK_VOXELS: usize = 512;

/// Parts of a map's block table.
pub const SHARDS: usize = 64;

/// Bits of a voxel's coordinate within its region.
pub(crate) const REGION_SHIFT: u32 = 6;

/// Blocks in a region.
pub(crate) const REGION_BLOCKS: usize = 512;

/// Bits of a block's coordinate within its region.
pub(crate) const REGION_BITS: u32 = REGION_SHIFT - 3;

/// Voxel coordinates beyond this are not stored: ±53 000 km at 5 cm.
const MAX_VOXEL: f64 = (1 << 30) as f64;

/// Scan origins are rounded to this fraction of a voxel (12 µm at 5 cm), so that moving a whole data set by a multiple of the
/// block's edge moves the map exactly, whatever the size of the coordinates.
const ORIGIN_STEPS_PER_VOXEL: f64 = 4096.0;

/// The integer coordinates of a voxel block. Ordered by z, then y, then x.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlockIndex(pub IVec3);

impl BlockIndex {
    /// The block that holds a voxel (true floor: negative indices too).
    #[inline]
    pub fn of(voxel: IVec3) -> Self {
        Self(voxel >> 3)
    }

    /// The voxel with the block's lowest coordinates.
    #[inline]
    pub fn first_voxel(self) -> IVec3 {
        self.0 << 3
    }
}

/// The integer coordinates of a region: a cube of 8³ blocks, which maps are divided into. Ordered by z, then y, then x.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RegionIndex(pub IVec3);

impl RegionIndex {
    /// The region that holds a block.
    #[inline]
    pub fn of(BlockIndex(block): BlockIndex) -> Self {
        Self(block >> REGION_BITS)
    }
}

macro_rules! ordered_by_z_y_x {
    ($index:ty) => {
        impl Ord for $index {
            fn cmp(&self, other: &Self) -> std::cmp::Ordering {
                let key = |i: &Self| (i.0.z, i.0.y, i.0.x);
                key(self).cmp(&key(other))
            }
        }

        impl PartialOrd for $index {
            fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
                Some(self.cmp(other))
            }
        }
    };
}

ordered_by_z_y_x!(BlockIndex);
ordered_by_z_y_x!(RegionIndex);

/// The number of a voxel within its block, 0..512.
#[inline]
pub fn local_number(voxel: IVec3) -> usize {
    let v = voxel & 7;
    (v.x | v.y << 3 | v.z << 6) as usize
}

/// The voxel with number `local` in a block.
#[inline]
pub fn voxel_at(block: BlockIndex, local: usize) -> IVec3 {
    let l = local as i32;
    block.first_voxel() + IVec3::new(l & 7, (l >> 3) & 7, l >> 6)
}

/// The region of a block, and the block's number in it, 0..512.
#[inline(always)]
pub(crate) fn in_region(BlockIndex(b): BlockIndex) -> (IVec3, usize) {
    let within = b & ((1 << REGION_BITS) - 1);
    let number = within.x | within.y << REGION_BITS | within.z << (2 * REGION_BITS);
    (b >> REGION_BITS, number as usize % REGION_BLOCKS)
}

/// The block with a number in a region: the inverse of [`in_region`].
pub(crate) fn block_of_region(region: IVec3, number: usize) -> BlockIndex {
    let n = number as i32;
    let within = IVec3::new(n, n >> REGION_BITS, n >> (2 * REGION_BITS)) & ((1 << REGION_BITS) - 1);
    BlockIndex((region << REGION_BITS) + within)
}

/// The part of the table that holds a block: the hash of voxel block hashing (5.1), of the region it lies in, so that
/// what touches one block and its neighbours mostly touches one shard.
#[inline]
pub(crate) fn shard_of(BlockIndex(b): BlockIndex) -> usize {
    shard_of_region(b >> REGION_BITS)
}

/// As [`shard_of`], for all blocks of a region.
#[inline]
pub(crate) fn shard_of_region(region: IVec3) -> usize {
    hash(region) as usize % SHARDS
}

/// The hash of (5.1).
#[inline(always)]
pub(crate) fn hash(v: IVec3) -> i32 {
    v.x.wrapping_mul(73_856_093) ^ v.y.wrapping_mul(19_349_669) ^ v.z.wrapping_mul(83_492_791)
}

/// A place in the grid: a voxel, and the position within it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridPoint {
    /// The voxel that holds the point.
    pub voxel: IVec3,
    /// Position within the voxel, in voxels, each coordinate in [0, 1].
    pub fraction: Vec3,
}

/// A regular grid of voxels over the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    voxel_size_m: f64,
}

impl Grid {
    /// A grid of voxels with this edge.
    pub fn new(voxel_size_m: f64) -> Self {
        Self { voxel_size_m }
    }

    /// The edge of a voxel.
    pub fn voxel_size_m(&self) -> f64 {
        self.voxel_size_m
    }

    /// The centre of a voxel in the world.
    pub fn center(&self, voxel: IVec3) -> DVec3 {
        (voxel.as_dvec3() + 0.5) * self.voxel_size_m
    }

    /// The cell between eight voxel centres that holds a point in the world: the voxel at its lowest corner, and the position within
    /// the cell. `None` where the grid ends, and for coordinates that are not finite.
    pub fn cell(&self, world: DVec3) -> Option<GridPoint> {
        let v = world / self.voxel_size_m - 0.5;
        // Also false for NaN.
        if !v.abs().cmplt(DVec3::splat(MAX_VOXEL)).all() {
            return None;
        }
        let voxel = floor(v);
        Some(GridPoint {
            voxel,
            fraction: (v - voxel.as_dvec3()).as_vec3(),
        })
    }

    /// The voxels whose centres lie in a box in the world (`low` included, `high` not): the first along all axes, and the first
    /// beyond them. Corners may be infinite. `None` if no point lies in the box.
    pub fn voxels_within(&self, low: DVec3, high: DVec3) -> Option<(IVec3, IVec3)> {
        // Voxel i has its centre at i + ½; a corner beyond all voxels becomes the last one.
        let first = |corner: DVec3| (corner / self.voxel_size_m - 0.5).ceil().as_ivec3();
        // Also false for NaN.
        low.cmplt(high).all().then(|| (first(low), first(high)))
    }

    /// Anchors a scan in the grid at its sensor's position in the world; `None` where the grid ends.
    pub fn anchor(&self, world: DVec3) -> Option<Anchor> {
        let v = world / self.voxel_size_m;
        // Also false for NaN.
        if !v.abs().cmplt(DVec3::splat(MAX_VOXEL)).all() {
            return None;
        }
        // Halves go up, on both sides of zero: so a move by whole voxels changes nothing.
        let v = (v * ORIGIN_STEPS_PER_VOXEL + 0.5).floor() / ORIGIN_STEPS_PER_VOXEL;
        let base = floor(v);
        let fraction = v - base.as_dvec3();
        Some(Anchor {
            base,
            fraction,
            voxels_per_m: 1.0 / self.voxel_size_m,
        })
    }
}

/// Where a scan's origin lies in the grid; its points are located relative to it, with no large coordinates involved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    base: IVec3,
    fraction: DVec3,
    voxels_per_m: f64,
}

impl Anchor {
    /// The voxel that holds the origin, and the position within it, in voxels.
    pub fn split(&self) -> (IVec3, DVec3) {
        (self.base, self.fraction)
    }

    /// The centre of a voxel relative to the anchor (world axes, metres).
    #[inline]
    pub fn offset_of(&self, voxel: IVec3) -> Vec3 {
        let offset = (voxel.as_i64vec3() - self.base.as_i64vec3()).as_dvec3() + 0.5 - self.fraction;
        (offset / self.voxels_per_m).as_vec3()
    }

    /// Locates a point given relative to the anchor (world axes, metres); `None` where the grid ends or for NaN.
    #[inline(always)]
    pub fn locate(&self, from_anchor_m: Vec3) -> Option<GridPoint> {
        let v = self.fraction + from_anchor_m.as_dvec3() * self.voxels_per_m;
        // Also false for NaN.
        if !v.abs().cmplt(DVec3::splat(MAX_VOXEL)).all() {
            return None;
        }
        let base = floor(v);
        Some(GridPoint {
            voxel: self.base + base,
            fraction: (v - base.as_dvec3()).as_vec3(),
        })
    }
}

/// The floor of numbers below 2³⁰ in magnitude: a few instructions, where the library's is a call on the x86-64 baseline, and conversions look for
/// numbers that do not fit. Of others it is any number.
#[inline(always)]
pub(crate) fn floor(v: DVec3) -> IVec3 {
    // As with `ROUND`, the nearest integer sits in the low bits of the sum.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let sum = v + ROUND;
    let above = (sum - ROUND).cmpgt(v);
    let nearest = IVec3::new(sum.x.to_bits() as i32, sum.y.to_bits() as i32, sum.z.to_bits() as i32);
    nearest - IVec3::new(above.x.into(), above.y.into(), above.z.into())
}

/// Adding this makes an f32 below 2²² in magnitude round to the nearest integer, which then sits in its low bits: cheaper than
/// a call to a rounding function, and the same on every CPU.
pub(crate) const ROUND: f32 = 12_582_912.0;

/// The nearest integer, |x| < 2²².
#[inline]
pub(crate) fn round(x: f32) -> i32 {
    (x + ROUND).to_bits() as i32 - ROUND.to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_voxel() -> impl Strategy<Value = IVec3> {
        prop::array::uniform3(-100_000_000..100_000_000i32).prop_map(IVec3::from)
    }

    proptest! {
        #[test]
        fn floors_are_those_of_the_library(v in prop::array::uniform3(prop_oneof![-1e9..1e9f64, -3.0..3.0f64, (-9..9i32).prop_map(f64::from)])) {
            prop_assert_eq!(floor(v.into()), DVec3::from(v).floor().as_ivec3());
        }

        #[test]
        fn block_and_local_name_the_voxel(v in any_voxel()) {
            prop_assert_eq!(voxel_at(BlockIndex::of(v), local_number(v)), v);
            for axis in 0..3 {
                prop_assert_eq!(BlockIndex::of(v).0[axis], (f64::from(v[axis]) / 8.0).floor() as i32);
            }
        }

        #[test]
        fn a_located_point_lies_in_its_voxel(o in prop::array::uniform3(-6e6..6e6f64), p in prop::array::uniform3(-200.0..200.0f32)) {
            let grid = Grid::new(0.05);
            let at = grid.anchor(o.into()).unwrap().locate(p.into()).unwrap();
            let world = (at.voxel.as_dvec3() + at.fraction.as_dvec3()) * 0.05;
            prop_assert!(world.distance(DVec3::from(o) + Vec3::from(p).as_dvec3()) < 2e-5);
        }

        #[test]
        fn moving_by_whole_voxels_moves_exactly(
            o in prop::array::uniform3(-50.0..50.0f64), p in prop::array::uniform3(-200.0..200.0f32),
        ) {
            // Rounded positions, so that the test does not sit on a rounding border of the anchor.
            let o = (DVec3::from(o) * 1000.0).round() / 1000.0;
            let grid = Grid::new(0.05);
            let near = grid.anchor(o).unwrap().locate(p.into()).unwrap();
            let far = grid.anchor(o + DVec3::new(5e5, 5.4e6, 300.0)).unwrap().locate(p.into()).unwrap();
            prop_assert_eq!(far.voxel - near.voxel, IVec3::new(10_000_000, 108_000_000, 6_000));
            prop_assert_eq!(far.fraction, near.fraction);
        }
    }

    #[test]
    fn positions_between_two_steps_go_to_the_same_side_everywhere() {
        let grid = Grid::new(0.125);
        let anchor = |steps: f64, voxels: i32| {
            let position = (steps / ORIGIN_STEPS_PER_VOXEL + f64::from(voxels)) * grid.voxel_size_m();
            grid.anchor(DVec3::splat(position)).unwrap().split()
        };
        for steps in [-2.5, -1.5, -0.5, 0.5, 1.5] {
            let (near, far) = (anchor(steps, 0), anchor(steps, 1024));
            assert_eq!((far.0 - near.0, far.1), (IVec3::splat(1024), near.1), "{steps}");
        }
    }

    #[test]
    fn the_grid_has_an_end() {
        let grid = Grid::new(0.05);
        assert!(grid.anchor(DVec3::new(1e9, 0.0, 0.0)).is_none());
        let anchor = grid.anchor(DVec3::ZERO).unwrap();
        assert!(anchor.locate(Vec3::splat(f32::INFINITY)).is_none());
        for axis in 0..3 {
            let (mut position, mut point) = (DVec3::ZERO, Vec3::ZERO);
            (position[axis], point[axis]) = (f64::NAN, f32::NAN);
            assert!(grid.anchor(position).is_none() && anchor.locate(point).is_none());
        }
        assert!(anchor.locate(Vec3::splat(1e9)).is_none());
    }
}
