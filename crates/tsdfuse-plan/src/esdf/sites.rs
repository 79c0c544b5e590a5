//! Points that stand for a piece of the surface.

use fearless_simd::{Level, dispatch};
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::mesh::Piece;

use super::lattice::{CELLS, Lattice};

/// A point of the surface: the mean height of all samples in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Site {
    /// Cells.
    pub(super) x: i32,
    /// Cells.
    pub(super) y: i32,
    /// Steps.
    pub(super) z: i32,
}

/// Longer edges than this are sampled along, voxels.
const SPACING: f64 = 0.5;
/// Samples along an edge, at most. A triangle is no longer than √3 voxels of the map.
const MAX_SAMPLES: i32 = 16;

/// Farther from the origin, steps do not fit an `i32`.
const FAR: DVec3 = DVec3::splat((1 << 30) as f64);
const OUTSIDE: IVec3 = IVec3::MAX;

/// Samples pieces; keeps memory between them.
#[derive(Debug, Default)]
pub(super) struct Sampler {
    /// In steps: the vertices, and what lies between them.
    samples: Vec<IVec3>,
    /// Sum of heights above the lowest cell, and number of samples of each cell.
    cells: Vec<(i64, i64)>,
    sites: Vec<Site>,
}

impl Sampler {
    /// The sites of a piece, in order; none for what lies outside of the grid.
    pub(super) fn sites(&mut self, lattice: &Lattice, piece: &Piece<'_>) -> &[Site] {
        self.sites.clear();
        let Some((low, high)) = dispatch!(Level::new(), _ => self.sample(lattice, piece)) else {
            return &[];
        };
        // A power of two.
        let shift = lattice.cell_steps().trailing_zeros();
        let (low, high) = (low >> shift, high >> shift);
        let size = high - low + 1;
        self.cells.clear();
        self.cells.resize((size.x * size.y * size.z) as usize, (0, 0));
        for sample in self.samples.iter().filter(|sample| **sample != OUTSIDE) {
            let at = (*sample >> shift) - low;
            let (sum, count) = &mut self.cells[((at.x * size.y + at.y) * size.z + at.z) as usize];
            (*sum, *count) = (*sum + i64::from(sample.z), *count + 1);
        }
        let mut cells = self.cells.iter();
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for &(sum, count) in cells.by_ref().take(size.z as usize) {
                    if count > 0 {
                        // To the nearest, halves up: so a move by whole voxels changes nothing.
                        let z = (2 * sum + count).div_euclid(2 * count) as i32;
                        self.sites.push(Site { x, y, z });
                    }
                }
            }
        }
        &self.sites
    }

    /// All vertices, and points in between where they are far apart; the lowest and the highest.
    #[inline(always)]
    fn sample(&mut self, lattice: &Lattice, piece: &Piece<'_>) -> Option<(IVec3, IVec3)> {
        let scale = lattice.steps_per_m();
        let sample = |point: DVec3| {
            let steps = point * scale;
            match steps.abs().cmplt(FAR).all() {
                true => nearest(steps),
                false => OUTSIDE,
            }
        };
        self.samples.clear();
        self.samples.resize(piece.vertices.len(), OUTSIDE);
        for (out, vertex) in self.samples.iter_mut().zip(piece.vertices) {
            *out = sample(*vertex);
        }
        let spacing_m = SPACING * lattice.voxel_size_m;
        // Less by what rounding can hide.
        let spacing = SPACING * f64::from(lattice.steps) - 2.0;
        let squared = (spacing * spacing) as i32;
        let count = self.samples.len();
        let with_long_edges = match longest_m(piece) <= spacing_m {
            true => &[],
            false => piece.triangles,
        };
        for triangle in with_long_edges {
            let [a, b, c] =
                triangle.map(|corner| self.samples[..count].get(corner as usize).copied().unwrap_or_default());
            let is_long = |a: IVec3, b: IVec3| {
                let [x, y, z] = [a.x.wrapping_sub(b.x), a.y.wrapping_sub(b.y), a.z.wrapping_sub(b.z)];
                x.wrapping_mul(x)
                    .wrapping_add(y.wrapping_mul(y))
                    .wrapping_add(z.wrapping_mul(z))
                    > squared
            };
            if !(is_long(a, b) | is_long(b, c) | is_long(c, a)) {
                continue;
            }
            let [a, b, c] = triangle.map(|corner| piece.vertices.get(corner as usize).copied().unwrap_or_default());
            let longest_m = a.distance(b).max(b.distance(c)).max(c.distance(a));
            if longest_m <= spacing_m {
                continue;
            }
            let n = ((longest_m / spacing_m).ceil() as i32).min(MAX_SAMPLES);
            for i in 0..=n {
                for j in 0..=n - i {
                    let [s, t] = [i, j].map(|k| f64::from(k) / f64::from(n));
                    self.samples.push(sample(a + (b - a) * s + (c - a) * t));
                }
            }
        }
        let mut ends = None;
        for &sample in self.samples.iter().filter(|sample| **sample != OUTSIDE) {
            let (low, high) = ends.unwrap_or((sample, sample));
            ends = Some((sample.min(low), sample.max(high)));
        }
        ends
    }
}

/// No edge of a triangle is longer, in metres. Infinite near the origin, where a piece's place does not tell the size of the map's voxels.
#[inline(always)]
fn longest_m(piece: &Piece<'_>) -> f64 {
    // How large can voxels be, if a vertex lies between the centres of the block's first ones and those of the first beyond?
    let vertex = piece.vertices.first().copied().unwrap_or_default().abs().to_array();
    let voxels = piece.block.0.to_array().map(|block| match f64::from(block) * 8.0 {
        begin if begin < 0.0 => -begin - 8.5,
        begin => begin + 0.5,
    });
    let sizes = vertex.into_iter().zip(voxels).filter(|(_, voxels)| *voxels > 0.0);
    let largest = sizes
        .map(|(vertex, voxels)| vertex / voxels)
        .fold(f64::INFINITY, f64::min);
    // A triangle lies between eight centres; and a little for rounding.
    1.0001 * 3_f64.sqrt() * largest
}

/// The nearest whole numbers. Of two that are as near, as voxel centres on borders of cells have them, the even one: a move by whole voxels, which are
/// even numbers of steps, changes nothing. Added to this number, they are its lowest bits.
#[inline(always)]
fn nearest(steps: DVec3) -> IVec3 {
    const WHOLE: f64 = (3_u64 << 51) as f64;
    let bits = |steps: f64| (steps + WHOLE).to_bits() as i32;
    IVec3::new(bits(steps.x), bits(steps.y), bits(steps.z))
}

const _: () = assert!(CELLS == 2, "the docs say half a voxel");

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::{Vec3, Vec3Swizzles};
    use tsdfuse::mesh::{Changes, Incremental};
    use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap};

    /// Slanted walls on all sides of the origin, meshed.
    fn walls() -> Changes {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let wall = |i: i32| (-40..40).map(move |k| Vec3::new(6.0 + 0.01 * k as f32, 0.03 * i as f32, 0.03 * k as f32));
        let points: Vec<Vec3> = (-40..40).flat_map(wall).collect();
        let turns = [
            |p: Vec3| p,
            |p: Vec3| -p,
            |p: Vec3| p.yzx(),
            |p: Vec3| -p.zxy(),
            |p: Vec3| 0.1 * p,
        ];
        let scan = Scan {
            points: turns.iter().flat_map(|turn| points.iter().copied().map(turn)).collect(),
            pose: Some(Pose::IDENTITY),
            ..Default::default()
        };
        let (mut surface, mut changes) = (Incremental::default(), Changes::default());
        surface.note(&Raycast::default().integrate(&mut map, &scan).unwrap().updated_blocks);
        surface.changes(&map, &mut changes);
        changes
    }

    #[test]
    fn no_edge_is_longer_than_a_pieces_place_tells() {
        let (changes, mut told) = (walls(), 0);
        for piece in changes.iter().filter(|piece| !piece.triangles.is_empty()) {
            let corners = piece
                .triangles
                .iter()
                .map(|triangle| triangle.map(|i| piece.vertices[i as usize]));
            let edges = corners.flat_map(|[a, b, c]| [a.distance(b), b.distance(c), c.distance(a)]);
            let longest = edges.fold(0.0, f64::max);
            assert!(longest <= longest_m(&piece), "{:?}: {longest}", piece.block);
            told += usize::from(longest_m(&piece) < 0.1);
        }
        assert!(told > changes.len() / 4, "{told} of {}", changes.len());
    }
}
