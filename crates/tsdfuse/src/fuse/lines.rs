//! The engine for thin lines: updating the voxels along them, as raycasting, local normals and patches do, a hundred thousand times a scan.
//!
//! ```text
//!   returns ─┬─ piece 0 ─▶ lines, by the regions of 8³ blocks that they may reach into     pass 1: threads own pieces
//!            └─ piece …
//!   shard 0 ◀─ the lines of every piece, region by region ─▶ voxels of the map             pass 2: threads own shards
//!   shard …
//! ```
//!
//! A line of this kind is short, 2μ, and no wider than a voxel, so that it touches some twenty voxels, two in each cache line
//! that it touches, and few other lines of the scan touch the same ones. What costs time is therefore
//!
//! - *finding these voxels.* Cut by the planes through voxel centres across its dominant axis, a cylinder of radius √3/2 shows
//!   ellipses that reach at most 1.225 voxels from the line along either other axis. So its voxels are among the 3 × 3
//!   around the one that the line meets, often 2 × 2: four to nine steps for eight planes, one in each lane of a vector;
//! - *finding their blocks.* Within a region a voxel has an address of 18 bits, which the steps work out along the way; a table of
//!   512 slots leads from there to its block. Blocks are looked up in the map once a scan;
//! - *the way to memory.* Lines are sorted by place, so that a voxel's cache line is mostly near when the next one needs it; and
//!   updates wait in a queue while the memory that they go to is fetched.
//!
//! What each of these brought is told in `docs/performance.md`.
//!
//! No locks, no atomics. The same bits on any number of threads: sums are integers, lines come in one order, and a
//! region is written by the thread that owns its shard.

use std::time::Instant;

use fearless_simd::{Level, Simd, dispatch, f32x4, f32x8, i32x4, i32x8, mask32x8, prelude::*};
use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::{
    Integration,
    cylinder::{EightVoxels, SLACK, VOXEL_RADIUS},
    engine::{Counts, PIECES, Skip, fixed_row},
};
use crate::{
    index::{BlockIndex, GridPoint, REGION_BITS, REGION_SHIFT, ROUND, SHARDS, round, shard_of_region},
    map::{OpenRegion, OutOfMemory, VoxelMap},
    memory::prefetch,
};

/// A short line, whose voxels are updated.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// A point on the line, mostly that of the surface.
    pub center: GridPoint,
    /// Unit vector along the line, world axes.
    pub axis: Vec3,
    /// How far from the centre, along the line, voxels are updated at most, in voxels: finite, and 0 or more.
    pub reach: f32,
    /// The weight of the updates, for the [`Rule`].
    pub weight: f32,
}

impl Line {
    /// Whether the numbers make a line; [`Lines::run`] demands it.
    fn is_valid(&self) -> bool {
        (self.axis.length_squared() - 1.0).abs() < 1e-3 && (0.0..=1e4).contains(&self.reach)
    }
}

/// Which voxels near a line a method updates, with what distance and what weight, eight voxels at a time.
pub trait Rule: Sync {
    /// The shape that holds all voxels that may be updated.
    const SHAPE: Shape;

    /// How many planes of voxels are processed together: no more than most lines cross.
    const PLANES: Planes = Planes::Eight;

    /// Returns the rule for one line: eight voxels near the line in; out come the mask of those to update, their distances over μ, and
    /// their weights (both clamped as in [`Updates::add`](super::Updates::add)). The mask may only hold voxels within [`Self::SHAPE`].
    ///
    /// Write `#[inline(always)]` on this function and on the closure that it returns: a closure that is not inlined is not compiled
    /// for the CPU's vector instructions.
    fn of<S: Simd>(&self, simd: S, line: &Line) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>);
}

/// Which voxels near a line may be updated. Distances are those of voxel centres, in voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Those at most [`VOXEL_RADIUS`] from the line and, measured along it, at most its reach from its centre.
    Cylinder,
    /// Those of the cylinder that are at most its reach from its centre.
    RoundedCylinder,
    /// Those of the rounded cylinder that the line passes through.
    Pierced,
}

impl Shape {
    /// How far from the centre voxels may lie along an axis of the grid, along which the line's axis is `axis_m`.
    #[inline(always)]
    fn reach(self, axis_m: f32, reach: f32) -> f32 {
        let across = (1.0 - axis_m * axis_m).max(0.0).sqrt();
        self.capped(axis_m.abs() * reach + across * VOXEL_RADIUS, reach)
    }

    /// The first and the last region that a line may reach into, along each axis.
    #[inline(always)]
    fn regions<S: Simd>(self, simd: S, line: &Line) -> [i32x4<S>; 2] {
        let GridPoint { voxel, fraction } = line.center;
        let four = |v: Vec3| f32x4::simd_from(simd, [v.x, v.y, v.z, 0.0]);
        let (fraction, axis) = (four(fraction), four(line.axis));
        let voxel = i32x4::simd_from(simd, [voxel.x, voxel.y, voxel.z, 0]);
        let across = (1.0 - axis * axis).max(0.0).sqrt();
        let extent = axis.abs() * line.reach + across * VOXEL_RADIUS;
        let extent = if self == Self::Cylinder {
            extent
        } else {
            extent.min(line.reach)
        } + SLACK;
        let (low, high) = ((fraction - extent) + ROUND, (fraction + extent - 1.0) + ROUND);
        let voxel = voxel - ROUND.to_bits() as i32;
        [
            (voxel + low.bitcast::<i32x4<S>>()) >> REGION_SHIFT,
            (voxel + high.bitcast::<i32x4<S>>()) >> REGION_SHIFT,
        ]
    }

    /// The extent of a cylinder as that of this shape, with some slack.
    #[inline(always)]
    fn capped(self, extent: f32, reach: f32) -> f32 {
        SLACK
            + if self == Self::Cylinder {
                extent
            } else {
                extent.min(reach)
            }
    }

    /// How many voxels side by side along axis `u`, in a plane across the dominant axis, the line may have: two or three.
    #[inline(always)]
    fn wide(self, [axis_m, axis_u, axis_w]: [f32; 3]) -> usize {
        // Whether half the extent of a square pulled along by half a plane, ½ + ½|a_u/a_m|, or of an ellipse, r√(1−a_w²)/|a_m|, is
        // below 1, with some slack.
        let below_one = match self {
            Self::Pierced => axis_u.abs() < (1.0 - 2.0 * SLACK) * axis_m.abs(),
            _ => 0.75 * (1.0 - axis_w * axis_w) < (1.0 - 2.0 * SLACK) * axis_m * axis_m,
        };
        if below_one { 2 } else { 3 }
    }
}

/// How many planes across a line's dominant axis are processed together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planes {
    /// One vector lane each.
    Eight,
    /// Two vector lanes each, for two voxels of each plane.
    Four,
}

/// Which of 2 × 2 × 2 regions there are, if there is a second one along x (1), y (2) and z (4).
const CORNERS: [u64; 8] = [
    0b0000_0001,
    0b0000_0011,
    0b0000_0101,
    0b0000_1111,
    0b0001_0001,
    0b0011_0011,
    0b0101_0101,
    0b1111_1111,
];

/// How many items ahead memory is asked for.
const AHEAD: usize = 16;

/// Voxels along the edge of a region.
const REGION_EDGE: i32 = 1 << REGION_SHIFT;

/// A line that may reach into a region passes its middle no farther away than this.
const FAR: f32 = 0.5 * 1.732_050_8 * REGION_EDGE as f32 + VOXEL_RADIUS + SLACK;

/// The middle of a region as seen from a place.
#[inline(always)]
fn middle_of(region: IVec3, center: GridPoint) -> Vec3 {
    ((region << REGION_SHIFT) + REGION_EDGE / 2 - center.voxel).as_vec3() - center.fraction
}

/// Of voxel coordinates within a region, none of these is set.
const BEYOND: i32 = !(REGION_EDGE - 1);

/// The engine that updates the voxels along thin lines. Keep it from scan to scan: it keeps its buffers.
#[derive(Debug)]
pub struct Lines {
    /// The vector instructions of this CPU.
    level: Level,
    pieces: Vec<Piece>,
}

/// The lines of one piece of a scan.
#[derive(Debug, Default)]
struct Piece {
    lines: Vec<Line>,
    buckets: Vec<Bucket>,
    counts: Counts,
}

/// What a piece of a scan has for one shard.
#[derive(Debug, Default)]
struct Bucket {
    /// The numbers of lines, one region after the other.
    numbers: Vec<u32>,
    /// Regions, and where the numbers end of lines that may reach into them.
    runs: Vec<(IVec3, usize)>,
}

impl Default for Lines {
    fn default() -> Self {
        Self::with(Level::new())
    }
}

impl Lines {
    /// With given instructions.
    fn with(level: Level) -> Self {
        let buckets = || (0..SHARDS).map(|_| Bucket::default()).collect();
        let piece = |_| Piece {
            buckets: buckets(),
            ..Default::default()
        };
        Self {
            level,
            pieces: (0..PIECES).map(piece).collect(),
        }
    }

    /// Makes a line of each of some items (or counts why there is none) and updates the voxels along it by a rule. It counts as one
    /// integration. It is fastest if items that follow each other are neighbours ([`Placed::sorted`](super::Placed::sorted)).
    ///
    /// `ask` is called some items ahead of `make`, to prefetch what the line will be made of; `|_| ()` will do.
    ///
    /// Lines must be valid: an axis of unit length and a finite reach, as debug builds check.
    ///
    /// # Errors
    /// There is no memory for a block; a part of the updates is made.
    pub fn run<R: Rule>(
        &mut self,
        map: &mut VoxelMap,
        items: &[u32],
        ask: impl Fn(usize) + Sync,
        make: impl Fn(usize) -> Result<Line, Skip> + Sync,
        rule: &R,
    ) -> Result<Integration, OutOfMemory> {
        let start = Instant::now();
        let (stamp, limit) = map.begin_integration();
        let level = self.level;
        self.pieces.par_iter_mut().enumerate().for_each(|(k, piece)| {
            piece.clear();
            let items = &items[items.len() * k / PIECES..items.len() * (k + 1) / PIECES];
            dispatch!(level, simd => for (k, &i) in items.iter().enumerate() {
                if let Some(&later) = items.get(k + AHEAD) {
                    ask(later as usize);
                }
                let line = make(i as usize);
                piece.counts.count(line.map(|_| ()));
                if let Ok(line) = line {
                    debug_assert!(line.is_valid(), "{line:?}");
                    piece.push(simd, line, R::SHAPE);
                }
            });
        });
        let find_secs = start.elapsed().as_secs_f64();
        let touched = self.update(map, stamp, limit, rule)?;
        let counts = self.pieces.iter().map(|piece| &piece.counts);
        Ok(Counts::sum(touched, find_secs, counts))
    }

    /// The second pass: updates the voxels about all lines, and tells which blocks they are in.
    fn update<R: Rule>(
        &self,
        map: &mut VoxelMap,
        stamp: u32,
        limit: u32,
        rule: &R,
    ) -> Result<Vec<BlockIndex>, OutOfMemory> {
        let Self { level, pieces } = self;
        let shards = map.shards.par_iter_mut().enumerate();
        let touched: Result<Vec<Vec<BlockIndex>>, OutOfMemory> = shards
            .map(|(s, shard)| {
                let mut runs: Vec<Run<'_>> = pieces.iter().flat_map(|piece| piece.runs(s)).collect();
                runs.sort_by_key(|run| run.region.to_array());
                let (mut touched, mut queue) = (Vec::new(), Queue::NEW);
                for runs in runs.chunk_by(|a, b| a.region == b.region) {
                    let region = runs[0].region;
                    let mut writer = Writer {
                        region: shard.open(region, stamp, &mut touched)?,
                        limit,
                        queue: &mut queue,
                        full: Ok(()),
                    };
                    for Run { lines, numbers, .. } in runs {
                        dispatch!(*level, simd => for (k, &number) in numbers.iter().enumerate() {
                            if let Some(&later) = numbers.get(k + AHEAD) {
                                let later = &lines[later as usize];
                                prefetch(&later.center);
                                prefetch(&later.weight);
                            }
                            update(simd, &lines[number as usize], rule, region, &mut writer);
                        });
                    }
                    writer.ask();
                    writer.write();
                    writer.full?;
                }
                Ok(touched)
            })
            .collect();
        Ok(touched?.concat())
    }
}

/// Lines of a piece that may reach into one region.
struct Run<'a> {
    region: IVec3,
    lines: &'a [Line],
    numbers: &'a [u32],
}

impl Piece {
    /// What there is for a shard.
    fn runs(&self, shard: usize) -> impl Iterator<Item = Run<'_>> {
        let Bucket { numbers, runs } = &self.buckets[shard];
        let starts = std::iter::once(0).chain(runs.iter().map(|run| run.1));
        runs.iter().zip(starts).map(|(&(region, end), start)| Run {
            region,
            lines: &self.lines,
            numbers: &numbers[start..end],
        })
    }

    fn clear(&mut self) {
        for bucket in &mut self.buckets {
            bucket.numbers.clear();
            bucket.runs.clear();
        }
        self.lines.clear();
        self.counts = Counts::default();
    }

    /// Puts a line to each region that it may reach into.
    #[inline(always)]
    fn push<S: Simd>(&mut self, simd: S, line: Line, shape: Shape) {
        let [first, last] = shape.regions(simd, &line);
        self.lines.push(line);
        let is_one = first.simd_eq(last).all_true();
        let first = IVec3::new(first[0], first[1], first[2]);
        if is_one {
            self.push_to(first);
        } else {
            self.push_to_each(simd, first, IVec3::new(last[0], last[1], last[2]), &line);
        }
    }

    /// Puts the last line to each of some regions that it passes near the middle of.
    #[inline(always)]
    fn push_to_each<S: Simd>(&mut self, simd: S, first: IVec3, last: IVec3, line: &Line) {
        let many = last - first;
        if many.max_element() > 1 {
            self.push_to_many(first, last);
            return;
        }
        let middle = middle_of(first, line.center);
        let edge = REGION_EDGE as f32;
        let x = f32x8::simd_from(simd, [0.0, edge, 0.0, edge, 0.0, edge, 0.0, edge]) + middle.x;
        let y = f32x8::simd_from(simd, [0.0, 0.0, edge, edge, 0.0, 0.0, edge, edge]) + middle.y;
        let z = f32x8::simd_from(simd, [0.0, 0.0, 0.0, 0.0, edge, edge, edge, edge]) + middle.z;
        let along = x * line.axis.x + (y * line.axis.y + z * line.axis.z);
        let beside2 = x * x + (y * y + z * z) - along * along;
        let near = along.abs().simd_le(FAR + line.reach) & beside2.simd_le(FAR * FAR);
        let mut near = near.to_bitmask() & CORNERS[(many.x | many.y << 1 | many.z << 2) as usize & 7];
        while near != 0 {
            let b = near.trailing_zeros() as i32;
            near &= near - 1;
            self.push_to(first + IVec3::new(b & 1, b >> 1 & 1, b >> 2));
        }
    }

    /// As [`Self::push_to_each`], for long lines.
    #[inline(never)]
    fn push_to_many(&mut self, first: IVec3, last: IVec3) {
        let Some(&line) = self.lines.last() else { return };
        for z in first.z..=last.z {
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    let region = IVec3::new(x, y, z);
                    let middle = middle_of(region, line.center);
                    let along = middle.dot(line.axis);
                    if along.abs() <= FAR + line.reach && (middle - along * line.axis).length() <= FAR {
                        self.push_to(region);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn push_to(&mut self, region: IVec3) {
        let bucket = &mut self.buckets[shard_of_region(region)];
        bucket.numbers.push(self.lines.len() as u32 - 1);
        let end = bucket.numbers.len();
        match bucket.runs.last_mut() {
            Some(last) if last.0 == region => last.1 = end,
            _ => bucket.runs.push((region, end)),
        }
    }
}

/// Where the updates of a region go: found, then asked for, then written. So memory is fetched while others are found.
struct Writer<'a> {
    region: OpenRegion<'a>,
    limit: u32,
    queue: &'a mut Queue,
    /// The error, once there is no memory for a block. Updates are dropped from then on.
    full: Result<(), OutOfMemory>,
}

/// Updates on their way.
struct Queue {
    /// Three lists, [`QUEUE`] apart: voxels ([`OpenRegion`] tells their numbers), weights and weighted distances in fixed point.
    lists: [i32; 3 * QUEUE + 8],
    found: usize,
    asked: usize,
}

/// Updates that are under way at most.
const QUEUE: usize = 512;

/// Updates that memory is asked for at a time.
const BURST: usize = 96;

/// The most voxels that are found at a time: eight planes of 3 × 3.
const FOUND: usize = 72;

impl Queue {
    const NEW: Self = Self {
        lists: [0; 3 * QUEUE + 8],
        found: 0,
        asked: 0,
    };

    /// Puts those of eight voxels that are updated behind `found` others, and counts them. There must be room for eight.
    #[inline(always)]
    fn push<S: Simd>(
        &mut self,
        found: &mut usize,
        updated: mask32x8<S>,
        address: i32x8<S>,
        weight: i32x8<S>,
        distance: i32x8<S>,
    ) {
        let at = &mut self.lists[*found % QUEUE..][..2 * QUEUE + 8];
        address.compress(updated).store_slice(&mut at[..8]);
        weight.compress(updated).store_slice(&mut at[QUEUE..QUEUE + 8]);
        distance.compress(updated).store_slice(&mut at[2 * QUEUE..]);
        *found += updated.to_bitmask().count_ones() as usize;
    }
}

impl Writer<'_> {
    /// Asks for the memory of what was found.
    #[inline(never)]
    fn ask(&mut self) {
        let Queue { lists, found, asked } = &mut *self.queue;
        for &place in &lists[*asked..*found] {
            if let Err(full) = self.region.fetch(place as u32) {
                (self.full, *found) = (Err(full), *asked);
                return;
            }
        }
        *asked = *found;
        if *found > QUEUE - BURST - FOUND {
            self.write();
        }
    }

    /// Makes the updates.
    #[inline(never)]
    fn write(&mut self) {
        let Queue { lists, found, .. } = &*self.queue;
        let (places, sums) = lists.split_at(QUEUE);
        let (weights, distances) = sums.split_at(QUEUE);
        let all = places[..*found].iter().zip(weights).zip(distances);
        for ((&place, &weight), &distance) in all {
            if let Some(voxel) = self.region.voxel(place as u32) {
                voxel.add_sums(weight, distance);
                voxel.limit(self.limit);
            }
        }
        (self.queue.found, self.queue.asked) = (0, 0);
    }
}

/// Updates the voxels of a line within a region.
#[inline(always)]
fn update<S: Simd, R: Rule>(simd: S, line: &Line, rule: &R, region: IVec3, writer: &mut Writer<'_>) {
    let a = line.axis.abs();
    if a.x >= a.y && a.x >= a.z {
        update_along::<S, R, 0, 1, 2>(simd, line, rule, region, writer);
    } else if a.y >= a.z {
        update_along::<S, R, 1, 2, 0>(simd, line, rule, region, writer);
    } else {
        update_along::<S, R, 2, 0, 1>(simd, line, rule, region, writer);
    }
}

/// As [`update`], for a line whose dominant axis is M; U and W are the others.
#[inline(always)]
fn update_along<S: Simd, R: Rule, const M: usize, const U: usize, const W: usize>(
    simd: S,
    line: &Line,
    rule: &R,
    region: IVec3,
    writer: &mut Writer<'_>,
) {
    let (axis, fraction) = (line.axis.to_array(), line.center.fraction.to_array());
    let center = (line.center.voxel - (region << REGION_SHIFT)).to_array();
    let slope = 1.0 / axis[M];
    let rule_of_line = rule.of(simd, line);

    let wide_u = R::SHAPE.wide([axis[M], axis[U], axis[W]]);
    let wide_w = R::SHAPE.wide([axis[M], axis[W], axis[U]]);
    let reach = R::SHAPE.reach(axis[M], line.reach);
    let mut plane = round(fraction[M] - reach).max(-center[M]);
    let last = round(fraction[M] + reach - 1.0).min(REGION_EDGE - 1 - center[M]);
    let (planes, count) = match R::PLANES {
        Planes::Eight => ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], 8),
        Planes::Four => ([0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0], 4),
    };
    while plane <= last {
        // Coordinates relative to the centre's voxel: of the planes, of the first voxels beside the line there.
        let planes = f32x8::simd_from(simd, planes) + plane as f32;
        let m = Places::<S, M>::of(planes + ROUND, fraction[M], axis[M], center[M]);
        let t = m.offset * slope;
        let first = |u: usize, wide: usize| t * axis[u] + (fraction[u] - 0.5 * wide as f32) + ROUND;
        let (u, w) = (first(U, wide_u), first(W, wide_w));

        if writer.queue.found - writer.queue.asked > BURST {
            writer.ask();
        }
        let queue = &mut *writer.queue;
        let mut found = queue.found;
        match R::PLANES {
            Planes::Eight => {
                let (u_offset, u_along, u_square, u_coordinate, u_address) =
                    Places::<S, U>::of_three(u, fraction[U], axis[U], center[U]);
                let mut w = w;
                for _ in 0..wide_w {
                    let places = Places::<S, W>::of(w, fraction[W], axis[W], center[W]);
                    for j in 0..wide_u.min(3) {
                        let u = Places {
                            offset: u_offset[j],
                            along: u_along[j],
                            square: u_square[j],
                            coordinate: u_coordinate[j],
                            address: u_address[j],
                        };
                        find::<S, M, U, W>(&m, &u, &places, &rule_of_line, queue, &mut found);
                    }
                    w += 1.0;
                }
            }
            Planes::Four => {
                // Two beside each other along U, with two or three along W; then, if there is a third along U, two and two along W.
                let two = f32x8::simd_from(simd, [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
                let (fraction_u, axis_u, center_u) = (fraction[U], axis[U], center[U]);
                let (fraction_w, axis_w, center_w) = (fraction[W], axis[W], center[W]);
                let u_two = Places::<S, U>::of(u + two, fraction_u, axis_u, center_u);
                let beside = Places::<S, W>::of(w, fraction_w, axis_w, center_w);
                find(&m, &u_two, &beside, &rule_of_line, queue, &mut found);
                let beside = Places::<S, W>::of(w + 1.0, fraction_w, axis_w, center_w);
                find(&m, &u_two, &beside, &rule_of_line, queue, &mut found);
                if wide_w == 3 {
                    let beside = Places::<S, W>::of(w + 2.0, fraction_w, axis_w, center_w);
                    find(&m, &u_two, &beside, &rule_of_line, queue, &mut found);
                }
                if wide_u == 3 {
                    let u_third = Places::<S, U>::of(u + 2.0, fraction_u, axis_u, center_u);
                    let beside = Places::<S, W>::of(w + two, fraction_w, axis_w, center_w);
                    find(&m, &u_third, &beside, &rule_of_line, queue, &mut found);
                    if wide_w == 3 {
                        // The fourth is farther than any.
                        let beside = Places::<S, W>::of(w + (two + two + 2.0), fraction_w, axis_w, center_w);
                        find(&m, &u_third, &beside, &rule_of_line, queue, &mut found);
                    }
                }
            }
        }
        queue.found = found;
        plane += count;
    }
}

/// Finds which of eight voxels are updated. (A function, since closures are not compiled for the CPU's vector instructions where
/// they are not inlined.)
#[inline(always)]
fn find<S: Simd, const M: usize, const U: usize, const W: usize>(
    m: &Places<S, M>,
    u: &Places<S, U>,
    w: &Places<S, W>,
    rule_of_line: &impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>),
    queue: &mut Queue,
    found: &mut usize,
) {
    let xyz = |m: f32x8<S>, u: f32x8<S>, w: f32x8<S>| {
        let mut of = [m; 3];
        (of[U], of[W]) = (u, w);
        of
    };
    let [x, y, z] = xyz(m.offset, u.offset, w.offset);
    let [along_x, along_y, along_z] = xyz(m.along, u.along, w.along);
    let [x2, y2, z2] = xyz(m.square, u.square, w.square);
    let voxels = EightVoxels {
        x,
        y,
        z,
        along: along_x + (along_y + along_z),
        distance2: x2 + (y2 + z2),
    };
    let (inside, distance, weight) = rule_of_line(&voxels);
    let (weight, distance) = fixed_row(distance, weight);
    let here = (m.coordinate | u.coordinate | w.coordinate) & BEYOND;
    let updated = inside & here.simd_eq(0) & weight.simd_gt(0);
    let address = m.address | u.address | w.address;
    queue.push(found, updated, address, weight, distance);
}

/// What is to be known of eight voxels along one axis of the grid.
#[derive(Clone, Copy)]
struct Places<S: Simd, const AXIS: usize> {
    /// From the line's centre to theirs; this times the line's axis; and its square.
    offset: f32x8<S>,
    along: f32x8<S>,
    square: f32x8<S>,
    /// In the region; these bits of an address.
    coordinate: i32x8<S>,
    address: i32x8<S>,
}

impl<S: Simd, const AXIS: usize> Places<S, AXIS> {
    /// `voxels`: whole numbers relative to the centre's voxel, plus [`ROUND`].
    #[inline(always)]
    fn of(voxels: f32x8<S>, fraction: f32, axis: f32, center: i32) -> Self {
        let offset = ((voxels - ROUND) + 0.5) - fraction;
        let coordinate = voxels.bitcast::<i32x8<S>>() + center.wrapping_sub(ROUND.to_bits() as i32);
        Self {
            offset,
            along: offset * axis,
            square: offset * offset,
            coordinate,
            address: ((coordinate >> 3) << (9 + REGION_BITS * AXIS as u32)) | ((coordinate & 7) << (3 * AXIS as u32)),
        }
    }

    /// Three side by side: a list of each number, so that what is not needed is not kept.
    #[inline(always)]
    #[allow(clippy::type_complexity)]
    fn of_three(
        first: f32x8<S>,
        fraction: f32,
        axis: f32,
        center: i32,
    ) -> (
        [f32x8<S>; 3],
        [f32x8<S>; 3],
        [f32x8<S>; 3],
        [i32x8<S>; 3],
        [i32x8<S>; 3],
    ) {
        let (a, b, c) = (
            Self::of(first, fraction, axis, center),
            Self::of(first + 1.0, fraction, axis, center),
            Self::of(first + 2.0, fraction, axis, center),
        );
        (
            [a.offset, b.offset, c.offset],
            [a.along, b.along, c.along],
            [a.square, b.square, c.square],
            [a.coordinate, b.coordinate, c.coordinate],
            [a.address, b.address, c.address],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        fuse::{
            cylinder::tests::any_cylinder, normals::AlongNormal, patch::AlongPatch, raycast::Euclidean,
            raycast::Projective,
        },
        map::{MapConfig, Voxel, fixed},
    };
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Every voxel of a cube, tested one by one.
    fn literal<S: Simd>(simd: S, line: &Line, rule: &impl Rule) -> Vec<(IVec3, i32, i32)> {
        let rule = rule.of(simd, line);
        let reach = line.reach.ceil() as i32 + 3;
        let cube = || -reach..=reach;
        let mut all = Vec::new();
        for (x, y, z) in cube().flat_map(|x| cube().flat_map(move |y| cube().map(move |z| (x, y, z)))) {
            let v = IVec3::new(x, y, z).as_vec3() + 0.5 - line.center.fraction;
            let [x8, y8, z8] = v.to_array().map(|c| f32x8::splat(simd, c));
            let (inside, distance, weight) = rule(&EightVoxels {
                x: x8,
                y: y8,
                z: z8,
                along: f32x8::splat(simd, v.x * line.axis.x + (v.y * line.axis.y + v.z * line.axis.z)),
                distance2: f32x8::splat(simd, v.x * v.x + (v.y * v.y + v.z * v.z)),
            });
            if inside.all_true() {
                let (weight, distance) = fixed(distance[0], weight[0]);
                all.push((line.center.voxel + IVec3::new(x, y, z), weight, distance));
            }
        }
        all
    }

    fn literal_sums(lines: &[Line], rule: &impl Rule) -> BTreeMap<[i32; 3], Voxel> {
        let mut sums = BTreeMap::<_, Voxel>::new();
        for line in lines {
            for (voxel, weight, distance) in dispatch!(Level::new(), simd => literal(simd, line, rule)) {
                if weight > 0 {
                    sums.entry(voxel.to_array()).or_default().add_sums(weight, distance);
                }
            }
        }
        sums
    }

    fn fused(level: Level, lines: &[Line], config: MapConfig, rule: &impl Rule) -> (VoxelMap, Integration) {
        let mut map = VoxelMap::new(config).unwrap();
        let all: Vec<u32> = (0..lines.len() as u32).collect();
        let done = Lines::with(level)
            .run(&mut map, &all, |_| (), |i| Ok(lines[i]), rule)
            .unwrap();
        (map, done)
    }

    fn sums_of(map: &VoxelMap) -> BTreeMap<[i32; 3], Voxel> {
        let mut sums = BTreeMap::new();
        for block in map.block_indices() {
            for (i, voxel) in map.block(block).unwrap().voxels.iter().enumerate() {
                if voxel.weight_sum > 0 {
                    sums.insert(crate::index::voxel_at(block, i).to_array(), *voxel);
                }
            }
        }
        sums
    }

    fn config() -> MapConfig {
        MapConfig {
            voxel_size_m: 0.125, // an exact number
            truncation_m: 0.5,
            ..Default::default()
        }
    }

    fn check(lines: &[Line], rule: &impl Rule) -> Result<(), TestCaseError> {
        let (map, done) = fused(Level::new(), lines, config(), rule);
        prop_assert_eq!(sums_of(&map), literal_sums(lines, rule));
        let mut touched = done.updated_blocks;
        touched.sort();
        prop_assert_eq!(touched, map.block_indices());
        Ok(())
    }

    fn short() -> impl Strategy<Value = f32> {
        prop_oneof![1.0..9.0f32, Just(4.0), Just(8.0)]
    }

    fn any_line(reach: impl Strategy<Value = f32>) -> impl Strategy<Value = Line> {
        (any_cylinder(Just(VOXEL_RADIUS)), reach, 0.0..1.0f32).prop_map(|(c, reach, weight)| Line {
            center: c.center,
            axis: c.axis,
            reach,
            weight,
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn updates_are_those_of_the_literal_test(lines in proptest::collection::vec(any_line(short()), 1..12)) {
            check(&lines, &Euclidean)?;
            check(&lines, &Projective)?;
            check(&lines, &AlongNormal)?;
            check(&lines, &AlongPatch { truncation: 5.0 })?;
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5))]
        #[test]
        fn long_lines_cross_many_regions(line in any_line(30.0..64.0f32)) {
            check(&[line], &Euclidean)?;
            check(&[line], &AlongNormal)?;
        }
    }

    /// The instructions that can be tried on this CPU, the plainest first.
    fn levels() -> Vec<Level> {
        let mut levels = vec![Level::baseline(), Level::new()];
        #[cfg(target_arch = "x86_64")]
        levels.extend(Level::new().as_avx2().map(Level::Avx2));
        levels
    }

    proptest! {
        #[test]
        fn all_instructions_give_the_same_map(lines in proptest::collection::vec(any_line(short()), 1..30)) {
            let of = |level, lines: &[Line]| fused(level, lines, config(), &Euclidean).0;
            let maps: Vec<VoxelMap> = levels().into_iter().map(|level| of(level, &lines)).collect();
            prop_assert!(maps.iter().all(|map| *map == maps[0]));
            let short = |level| fused(level, &lines, config(), &AlongPatch { truncation: 5.0 }).0;
            let patches: Vec<VoxelMap> = levels().into_iter().map(short).collect();
            prop_assert!(patches.iter().all(|map| *map == patches[0]));
            // And the comparison would see one that is missing.
            prop_assert!(of(Level::new(), &lines[1..]) != maps[0] || lines[0].weight < 1.0 / 32_768.0);
        }
    }

    #[test]
    fn the_weight_is_limited_and_the_distance_kept() {
        let line = Line {
            center: GridPoint {
                voxel: IVec3::new(31, -1, 64),
                fraction: Vec3::splat(0.25),
            },
            axis: Vec3::X,
            reach: 4.0,
            weight: 0.3,
        };
        let limited = |max_weight| {
            let config = MapConfig { max_weight, ..config() };
            sums_of(&fused(Level::new(), &[line; 100], config, &AlongNormal).0)
        };
        let (few, all) = (limited(2.0), limited(1000.0));
        assert!(few.keys().eq(all.keys()) && few.len() > 8);
        for (few, all) in few.values().zip(all.values()) {
            assert_eq!(few.weight(), 2.0);
            assert!((all.weight() - 30.0).abs() < 0.01);
            assert!((few.distance().unwrap() - all.distance().unwrap()).abs() < 1e-3);
        }
    }
}
