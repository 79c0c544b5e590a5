//! Euclidean distances to the nearest surface.
//!
//! ```text
//!   pieces of the surface that changed ─▶ sites: points of the surface, one per cell of half a voxel
//!     └─▶ chunks of 32³ voxels within the radius of sites that changed ─▶ their distances, anew
//! ```
//!
//! The distance to the nearest site is found exactly, one axis after another as by Felzenszwalb and Huttenlocher ("Distance
//! Transforms of Sampled Functions", 2012, section 3), but by trying all sites within the radius: this takes two
//! vector instructions for 16 voxels or more. Sites depend on nothing but the surface as it is, so distances that follow a map are the same, bit for
//! bit, as those computed at its end; erased surface is forgotten.

use rayon::prelude::*;
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::index::Grid;
use tsdfuse::mesh::{Nearby, Piece};

use crate::dense::Dense;
use crate::error::PlanError;

mod chunks;
mod lattice;
mod sites;
mod transform;

use chunks::Chunks;
pub use chunks::{CHUNK, Chunk};
use lattice::Lattice;

/// Options of an [`Esdf`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EsdfConfig {
    /// Edge of its voxels, metres: that of the map's voxels or more.
    pub voxel_size_m: f64,
    /// Distances are known up to this one, metres: at most 45 voxels.
    pub radius_m: f64,
}

impl Default for EsdfConfig {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.2,
            radius_m: 2.0,
        }
    }
}

/// The distance to the nearest surface, and which way leads away from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Metres, 0 or more: behind a surface, distances grow again.
    pub distance_m: f32,
    /// The derivative of the distance by position, world axes; about as long as 1 where there is one nearest surface.
    pub gradient: Vec3,
}

/// Euclidean signed-distance fields without the sign: for each voxel near surface, the distance of its centre to the nearest one.
///
/// Distances are within half a voxel of those to the mesh.
#[derive(Clone, Debug)]
pub struct Esdf {
    config: EsdfConfig,
    lattice: Lattice,
    chunks: Chunks,
    /// Chunks whose distances are not up to date, sorted.
    waiting: Vec<IVec3>,
}

impl Esdf {
    /// Distances of a map without surface so far.
    ///
    /// # Errors
    /// [`PlanError`] names the option that makes no sense.
    pub fn new(config: EsdfConfig) -> Result<Self, PlanError> {
        let lattice = Lattice::new(&config)?;
        Ok(Self {
            config,
            lattice,
            chunks: Chunks::default(),
            waiting: Vec::new(),
        })
    }

    /// The options.
    pub fn config(&self) -> &EsdfConfig {
        &self.config
    }

    /// The voxel grid.
    pub fn grid(&self) -> Grid {
        Grid::new(self.config.voxel_size_m)
    }

    /// Takes in pieces of the surface that changed, each in place of what its block had before: those of
    /// [`Changes`](tsdfuse::mesh::Changes) or of a [`Surface`](tsdfuse::mesh::Surface). Returns the chunks whose distances were
    /// computed anew, sorted.
    pub fn update<'a>(&mut self, pieces: impl IntoIterator<Item = Piece<'a>>) -> Vec<IVec3> {
        self.take_in(pieces);
        self.compute(|_| true)
    }

    /// [`Self::update`] for a robot: chunks that are not near are computed in turns, if they changed. Until then they keep the distances that they
    /// had. [`Self::update`], also without pieces, computes all that wait.
    pub fn update_near<'a>(&mut self, pieces: impl IntoIterator<Item = Piece<'a>>, nearby: &Nearby) -> Vec<IVec3> {
        self.take_in(pieces);
        let edge_m = f64::from(CHUNK) * self.config.voxel_size_m;
        self.compute(|index| nearby.is_due(index, edge_m))
    }

    /// Changes sites; the chunks within the radius wait then.
    fn take_in<'a>(&mut self, pieces: impl IntoIterator<Item = Piece<'a>>) {
        self.waiting.extend(self.chunks.take_in(&self.lattice, pieces));
        self.waiting.sort_unstable_by_key(IVec3::to_array);
        self.waiting.dedup();
    }

    /// Computes the distances of waiting chunks that are due; which these are, sorted.
    fn compute(&mut self, is_due: impl Fn(IVec3) -> bool) -> Vec<IVec3> {
        let (due, waiting) = self.waiting.iter().partition::<Vec<IVec3>, _>(|index| is_due(**index));
        self.waiting = waiting;
        let before = due.iter().map(|&index| (index, self.chunks.take(index))).collect();
        let distances = transform::run(&self.lattice, &self.chunks, before);
        self.chunks.set(distances);
        due
    }

    /// The distance from the centre of a voxel to the nearest surface, metres; `None` beyond the radius.
    pub fn distance_m(&self, voxel: IVec3) -> Option<f32> {
        let squared = self.chunks.get(voxel.div_euclid(IVec3::splat(CHUNK)))?.squared(voxel)?;
        Some(self.lattice.metres(squared))
    }

    /// The distance at a place in the world, interpolated between eight voxels, and its gradient; `None` where one of these is
    /// farther from surface than the radius.
    pub fn sample(&self, point: DVec3) -> Option<Nearest> {
        let cell = self.grid().cell(point)?;
        let corner = |i: i32| self.distance_m(cell.voxel + IVec3::new(i & 1, i >> 1 & 1, i >> 2));
        let mut corners = [0.0; 8];
        for (i, distance) in (0..).zip(&mut corners) {
            *distance = corner(i)?;
        }
        let Vec3 { x, y, z } = cell.fraction;
        let mix = |a: f32, b: f32, s: f32| a + s * (b - a);
        let [a, b, c, d] = [0, 2, 4, 6].map(|i| mix(corners[i], corners[i + 1], x));
        let along_x = [0, 2, 4, 6].map(|i| corners[i + 1] - corners[i]);
        let per_voxel = Vec3::new(
            mix(mix(along_x[0], along_x[1], y), mix(along_x[2], along_x[3], y), z),
            mix(b - a, d - c, z),
            mix(c, d, y) - mix(a, b, y),
        );
        Some(Nearest {
            distance_m: mix(mix(a, b, y), mix(c, d, y), z),
            gradient: per_voxel / self.config.voxel_size_m as f32,
        })
    }

    /// [`Self::sample`] at many places, in parallel.
    pub fn sample_all(&self, points: &[DVec3]) -> Vec<Option<Nearest>> {
        points.par_iter().map(|&point| self.sample(point)).collect()
    }

    /// The chunks with voxels within the radius of surface, sorted. Chunk c begins at voxel c · [`CHUNK`].
    pub fn chunks(&self) -> Vec<IVec3> {
        self.chunks.with_distances()
    }

    /// Visits all voxels within the radius of surface, chunk by chunk: voxel and distance in metres.
    pub fn for_each(&self, mut visit: impl FnMut(IVec3, f32)) {
        for index in self.chunks() {
            let chunk = self.chunks.get(index).into_iter();
            chunk
                .flat_map(|chunk| chunk.known(index))
                .for_each(|(voxel, squared)| visit(voxel, self.lattice.metres(squared)));
        }
    }

    /// All distances as an array, metres; NaN beyond the radius.
    ///
    /// # Errors
    /// [`PlanError`] if it would have more than 2³¹ voxels.
    pub fn dense(&self) -> Result<Dense<f32>, PlanError> {
        Dense::of(f32::NAN, |visit| self.for_each(visit))
    }

    /// Bytes of distances and sites.
    pub fn memory_bytes(&self) -> usize {
        self.chunks.memory_bytes() + size_of_val(self.waiting.as_slice())
    }
}

impl PartialEq for Esdf {
    /// Whether all distances are the same.
    fn eq(&self, other: &Self) -> bool {
        self.config == other.config && self.chunks.have_same_distances(&other.chunks)
    }
}
