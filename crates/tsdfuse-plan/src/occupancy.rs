//! Known free, occupied, unknown: what rays have passed through, and where they ended.
//!
//! Each voxel holds the log-odds of being occupied (Moravec and Elfes 1985), updated once per scan, with the numbers of Hornung et
//! al., "OctoMap", Autonomous Robots 2013: a voxel in which a ray ended counts as hit, however many rays of the scan passed through it.

use hashbrown::HashMap;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;
use tsdfuse::Scan;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::index::Grid;
use tsdfuse::scan::ScanError;

use crate::dense::Dense;
use crate::error::{PlanError, check_rays};
use crate::marks::{CHUNK, VOXELS, bits, number, voxel_of};
use crate::rays::Rays;

mod frontier;
mod slice;

pub use frontier::Frontier;
pub use slice::Slice;

/// Log-odds are counted in units of 1/20.
const HIT: i8 = 17;
const MISS: i8 = -8;
const LEAST: i8 = -40;
const MOST: i8 = 70;
/// Nothing is known of a voxel.
const UNKNOWN: i8 = i8::MIN;

/// Options of an [`Occupancy`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OccupancyConfig {
    /// Edge of its voxels, metres.
    pub voxel_size_m: f64,
    /// Rays are followed up to this range, metres; returns beyond it are no hits.
    pub max_range_m: f64,
}

impl Default for OccupancyConfig {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.2,
            max_range_m: 60.0,
        }
    }
}

/// What is known of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No ray has touched it.
    Unknown,
    /// Rays have passed through it.
    Free,
    /// Rays have ended in it.
    Occupied,
}

/// Which voxels are known to be free, and which to be occupied.
#[derive(Clone, Debug, PartialEq)]
pub struct Occupancy {
    config: OccupancyConfig,
    chunks: HashMap<IVec3, Box<[i8; VOXELS]>, FxBuildHasher>,
}

impl Occupancy {
    /// Nothing is known so far.
    ///
    /// # Errors
    /// [`PlanError`] names the option that makes no sense.
    pub fn new(config: OccupancyConfig) -> Result<Self, PlanError> {
        check_rays(config.voxel_size_m, config.max_range_m)?;
        Ok(Self {
            config,
            chunks: HashMap::default(),
        })
    }

    /// The options.
    pub fn config(&self) -> &OccupancyConfig {
        &self.config
    }

    /// The voxel grid.
    pub fn grid(&self) -> Grid {
        Grid::new(self.config.voxel_size_m)
    }

    /// Takes in the rays of a scan, each from where the sensor was at its time. Invalid returns must have been dropped:
    /// see [`Scan::drop_invalid`].
    ///
    /// # Errors
    /// [`ScanError::NoPose`] names a scan without a pose.
    pub fn integrate(&mut self, scan: &Scan) -> Result<(), ScanError> {
        let marks = Rays::of(scan, self.config.voxel_size_m, self.config.max_range_m)?.marks();
        let mut touched: Vec<_> = marks
            .into_chunks()
            .map(|(index, marks)| {
                let known = self
                    .chunks
                    .remove(&index)
                    .unwrap_or_else(|| Box::new([UNKNOWN; VOXELS]));
                (index, marks, known)
            })
            .collect();
        touched.par_iter_mut().for_each(|(_, marks, known)| {
            for (word, (passed, hit)) in marks.words().enumerate() {
                bits(hit, |bit| update(&mut known[word * 64 + bit], HIT));
                bits(passed & !hit, |bit| update(&mut known[word * 64 + bit], MISS));
            }
        });
        self.chunks
            .extend(touched.into_iter().map(|(index, _, known)| (index, known)));
        Ok(())
    }

    /// What is known of a voxel.
    pub fn state(&self, voxel: IVec3) -> State {
        let chunk = self.chunks.get(&voxel.div_euclid(IVec3::splat(CHUNK)));
        chunk.map_or(State::Unknown, |chunk| state(chunk[number(voxel)]))
    }

    /// What is known of the voxel at a place in the world.
    pub fn at(&self, point: DVec3) -> State {
        let voxel = (point / self.config.voxel_size_m).floor();
        if voxel.abs().max_element() < 1e9 {
            self.state(voxel.as_ivec3())
        } else {
            State::Unknown
        }
    }

    /// All voxels that are known, sorted by chunks of 16³.
    pub fn known(&self) -> impl Iterator<Item = (IVec3, State)> {
        let mut indices: Vec<IVec3> = self.chunks.keys().copied().collect();
        indices.sort_unstable_by_key(IVec3::to_array);
        let of = |index: IVec3| {
            let chunk = self.chunks.get(&index).into_iter();
            let known = chunk.flat_map(|chunk| chunk.iter().enumerate());
            known.map(move |(number, odds)| (voxel_of(index, number), state(*odds)))
        };
        indices
            .into_iter()
            .flat_map(of)
            .filter(|(_, state)| *state != State::Unknown)
    }

    /// The lowest and the highest known voxel along each axis.
    pub fn bounds(&self) -> Option<(IVec3, IVec3)> {
        self.known().fold(None, |bounds, (voxel, _)| {
            let (low, high) = bounds.unwrap_or((voxel, voxel));
            Some((low.min(voxel), high.max(voxel)))
        })
    }

    /// All that is known as an array.
    ///
    /// # Errors
    /// [`PlanError`] if it would have more than 2³¹ voxels.
    pub fn dense(&self) -> Result<Dense<State>, PlanError> {
        Dense::of(State::Unknown, |visit| {
            self.known().for_each(|(voxel, state)| visit(voxel, state));
        })
    }

    /// Bytes of all voxels.
    pub fn memory_bytes(&self) -> usize {
        self.chunks.len() * VOXELS
    }
}

fn update(odds: &mut i8, by: i8) {
    let before = if *odds == UNKNOWN { 0 } else { *odds };
    *odds = (before + by).clamp(LEAST, MOST);
}

fn state(odds: i8) -> State {
    match odds {
        UNKNOWN => State::Unknown,
        1.. => State::Occupied,
        _ => State::Free,
    }
}
