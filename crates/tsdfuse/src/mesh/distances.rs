//! F near the surface, and the vertices that follow from it.

use fearless_simd::{Simd, f32x8, i32x8, mask32x8, prelude::*};
use glam::{DVec3, Vec3};

use super::{
    near::Near,
    neighbourhood::{OWN, Rows, needed, row_of},
    signs::load,
};
use crate::{
    index::BLOCK_EDGE,
    map::{Block, Voxel},
};

/// Vertices keep this distance, in voxels, from voxel centres, so that no two vertices coincide and no triangle is degenerate.
const MARGIN: f32 = 1e-3;

/// Voxels −1 … 9 of each axis.
const EDGE: usize = 11;

/// From a voxel's place to those of its neighbours along x, y and z.
pub(super) const STRIDES: [usize; 3] = [1, EDGE, EDGE * EDGE];

/// A power of two, so that places need no check.
const PLACES: usize = 2048;

/// F of a block's voxels and of a rim around it, as far as vertices need it; NaN where unobserved.
pub(super) struct Distances {
    /// By [`place`].
    f: [f32; PLACES],
}

/// The place of the voxel with these coordinates, −1..=9 each.
#[inline(always)]
pub(super) fn place([x, y, z]: [i32; 3]) -> usize {
    ((x + 1) + EDGE as i32 * ((y + 1) + EDGE as i32 * (z + 1))) as usize
}

/// A grid edge: the place of its lower voxel (11 bits), times 4, plus its axis; above bit 12, the coordinates of the lower voxel, four bits
/// each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct GridEdge(u32);

impl GridEdge {
    /// All edges have numbers below this.
    pub(super) const NUMBERS: usize = 4 * PLACES;

    #[inline(always)]
    pub(super) fn new(voxel: [i32; 3], axis: usize) -> Self {
        let [x, y, z] = voxel;
        let coordinates = (x | y << 4 | z << 8) as u32;
        Self((4 * place(voxel) + axis) as u32 | (coordinates << 13))
    }

    /// The centre of the first voxel of the block that owns the edge, so that a vertex has the same position whichever of two
    /// neighbouring blocks computes it.
    #[inline(always)]
    fn origin(self, [own, after]: [DVec3; 2]) -> DVec3 {
        let of = |own, after, bit: u32| if self.0 >> bit & 1 == 0 { own } else { after };
        DVec3::new(of(own.x, after.x, 16), of(own.y, after.y, 20), of(own.z, after.z, 24))
    }

    /// Its number.
    #[inline(always)]
    pub(super) fn number(self) -> usize {
        self.0 as usize % Self::NUMBERS
    }
}

impl Distances {
    pub(super) fn new() -> Self {
        Self { f: [f32::NAN; PLACES] }
    }

    /// Loads what the vertices on these edges need.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&mut self, simd: S, near: &Near<&Block>, edges: &[Rows; 3], min_sum: i32) {
        let needed = needed(simd, edges);
        for z in -1..=9 {
            for y in -1..=9 {
                let voxels = needed[row_of(y, z)];
                if voxels != 0 {
                    self.load_row(simd, near, [y, z], voxels, min_sum);
                }
            }
        }
    }

    /// Loads at least those voxels of a row whose bits are set.
    #[inline(always)]
    fn load_row<S: Simd>(&mut self, simd: S, near: &Near<&Block>, [y, z]: [i32; 2], voxels: u16, min_sum: i32) {
        let part = |c: i32| ((c >> 3) + 1) as usize;
        let first = 3 * part(y) + 9 * part(z);
        let row = ((y & 7) + BLOCK_EDGE * (z & 7)) as usize % 64;
        let at = place([-1, y, z]) % (PLACES - EDGE);
        let f = &mut self.f[at..at + EDGE];
        let of = [near[first], near[first + 1], near[first + 2]];
        let mut eight = [f32::NAN; 8];
        if let Some(block) = of[1] {
            let (weights, distances) = load(simd, &block.voxels.as_chunks().0[row]);
            eight = quotient(weights, distances, min_sum);
        }
        f[1..9].copy_from_slice(&eight);
        if voxels & !OWN != 0 {
            // No branch on what is read: it may still be far away.
            let [mut weights, mut distances] = [[0; 8]; 2];
            let rim = [(0, 7), (2, 0), (2, 1)];
            for (k, (n, x)) in rim.into_iter().enumerate() {
                let voxel = of[n].map_or(Voxel::default(), |block| block.voxels[8 * row + x]);
                (weights[k], distances[k]) = (voxel.weight_sum as i32, voxel.distance_sum);
            }
            let rim = quotient(
                i32x8::simd_from(simd, weights),
                i32x8::simd_from(simd, distances),
                min_sum,
            );
            (f[0], f[9], f[10]) = (rim[0], rim[1], rim[2]);
        }
    }

    /// Position and normal of the vertices on some edges; `origins` are the centres of the first voxels of
    /// the block and of the one after it along all axes.
    #[inline(always)]
    pub(super) fn vertices<S: Simd>(
        &self,
        simd: S,
        edges: &[GridEdge],
        origins: [DVec3; 2],
        voxel_size_m: f64,
        positions: &mut [DVec3],
        normals: &mut [Vec3],
    ) {
        let out = positions.chunks_mut(8).zip(normals.chunks_mut(8));
        for (edges, (positions, normals)) in edges.chunks(8).zip(out) {
            let mut eight = [edges[0]; 8];
            eight[..edges.len()].copy_from_slice(edges);
            let [x, y, z, normal_x, normal_y, normal_z] = self.eight(simd, &eight);
            for (lane, (position, normal)) in positions.iter_mut().zip(normals).enumerate() {
                let in_voxels = Vec3::new(x[lane], y[lane], z[lane]);
                *position = edges[lane].origin(origins) + in_voxels.as_dvec3() * voxel_size_m;
                *normal = Vec3::new(normal_x[lane], normal_y[lane], normal_z[lane]);
            }
        }
    }

    /// Position relative to the centre of the first voxel of the block that owns the edge, in voxels, and normal of the vertices on eight edges.
    #[inline(always)]
    fn eight<S: Simd>(&self, simd: S, edges: &[GridEdge; 8]) -> [[f32; 8]; 6] {
        let mut codes = [0; 8];
        // F at the lower and the higher end, and before and after each along x, y and z.
        let mut ends = [[0.0; 8]; 2];
        let mut beside = [[[[0.0; 8]; 2]; 3]; 2];
        for (lane, &edge) in edges.iter().enumerate() {
            codes[lane] = edge.0 as i32;
            let low = edge.number() / 4;
            let high = low + STRIDES[edge.number() % 4 % 3];
            for (end, at) in [low, high].into_iter().enumerate() {
                ends[end][lane] = self.f[at % PLACES];
                for (axis, stride) in STRIDES.into_iter().enumerate() {
                    beside[end][axis][0][lane] = self.f[at.wrapping_sub(stride) % PLACES];
                    beside[end][axis][1][lane] = self.f[(at + stride) % PLACES];
                }
            }
        }
        let codes = i32x8::simd_from(simd, codes);
        let [f0, f1] = ends;
        let (f0, f1) = (f32x8::simd_from(simd, f0), f32x8::simd_from(simd, f1));
        let t = f0 / (f0 - f1);
        let t = t.max(MARGIN).min(1.0 - MARGIN);

        let [x0, y0, z0] = &beside[0];
        let [x1, y1, z1] = &beside[1];
        let gx = difference(f0, x0) * (1.0 - t) + difference(f1, x1) * t;
        let gy = difference(f0, y0) * (1.0 - t) + difference(f1, y1) * t;
        let gz = difference(f0, z0) * (1.0 - t) + difference(f1, z1) * t;
        let per_length = 1.0 / (gx * gx + gy * gy + gz * gz).sqrt();

        // Where the field is flat, the edge tells the direction.
        let has_direction = per_length.simd_lt(f32::INFINITY) & per_length.simd_gt(0.0);
        let along_edge = f1.simd_gt(f0).select(f32x8::splat(simd, 1.0), f32x8::splat(simd, -1.0));
        let axis = codes & 3;
        let (on_x, on_y, on_z) = (axis.simd_eq(0), axis.simd_eq(1), axis.simd_eq(2));
        let zero = f32x8::splat(simd, 0.0);
        [
            (whole(codes >> 13) + on_x.select(t, zero)).into(),
            (whole(codes >> 17) + on_y.select(t, zero)).into(),
            (whole(codes >> 21) + on_z.select(t, zero)).into(),
            has_direction
                .select(gx * per_length, on_x.select(along_edge, zero))
                .into(),
            has_direction
                .select(gy * per_length, on_y.select(along_edge, zero))
                .into(),
            has_direction
                .select(gz * per_length, on_z.select(along_edge, zero))
                .into(),
        ]
    }
}

/// F of eight voxels.
#[inline(always)]
fn quotient<S: Simd>(weights: i32x8<S>, distances: i32x8<S>, min_sum: i32) -> [f32; 8] {
    let f = distances.to_float::<f32x8<S>>() / weights.to_float::<f32x8<S>>();
    let is_observed = weights.simd_ge(min_sum);
    is_observed.select(f, f32x8::splat(weights.token(), f32::NAN)).into()
}

/// F's derivative at voxels along one axis, per voxel: the central difference where both sides are observed.
#[inline(always)]
fn difference<S: Simd>(here: f32x8<S>, [before, after]: &[[f32; 8]; 2]) -> f32x8<S> {
    let simd = here.token();
    let (before, after) = (f32x8::simd_from(simd, *before), f32x8::simd_from(simd, *after));
    let (low, high, central) = (here - before, after - here, (after - before) * 0.5);
    let other = is_number(low).select(low, is_number(high).select(high, f32x8::splat(simd, 0.0)));
    is_number(central).select(central, other)
}

#[inline(always)]
fn is_number<S: Simd>(f: f32x8<S>) -> mask32x8<S> {
    f.simd_eq(f)
}

/// The coordinate in the lowest four bits, within the block that owns the edge.
#[inline(always)]
fn whole<S: Simd>(codes: i32x8<S>) -> f32x8<S> {
    (codes & 7).to_float()
}
