//! Which returns move: those in space that was known to be free.
//!
//! After Schmid et al., "Dynablox", RA-L 2023, with rays instead of a distance field. A voxel is *free* after rays have passed through it in
//! several scans without ending there. A return is a *seed* if all voxels around its own are free, two to each side: so neither
//! noise in front of a wall nor rays that graze the ground make one. What lies up to three free voxels from a seed moves with it:
//! wheels, and feet. Space stays free while something moves through it.
//!
//! ```
//! use tsdfuse::{Pose, Scan, glam::Vec3};
//! use tsdfuse_plan::{Moving, MovingConfig};
//!
//! let mut moving = Moving::new(MovingConfig::default())?;
//! // A wall, and later something in front of it.
//! let wall = |y: i32| (-100..100).map(move |z| Vec3::new(8.0, 0.04 * y as f32, 0.04 * z as f32));
//! let mut scan = Scan { points: (-100..100).flat_map(wall).collect(), pose: Some(Pose::IDENTITY), ..Default::default() };
//! for _ in 0..10 {
//!     assert!(!moving.classify(&scan)?.contains(&true));
//! }
//! let thing = |y: i32| (-10..10).map(move |z| Vec3::new(5.0, 0.04 * y as f32, 0.04 * z as f32));
//! scan.points.extend((-10..10).flat_map(thing));
//! let is_moving = moving.classify(&scan)?;
//! assert!(is_moving.iter().zip(&scan.points).all(|(is_moving, point)| *is_moving == (point.x < 6.0)));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;
use tsdfuse::Scan;
use tsdfuse::glam::IVec3;
use tsdfuse::scan::ScanError;

use crate::error::{PlanError, check_rays};
use crate::marks::{CHUNK, Marks, VOXELS, bits, number, voxel_of};
use crate::rays::Rays;

/// Options of [`Moving`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovingConfig {
    /// Edge of its voxels, metres.
    pub voxel_size_m: f64,
    /// Returns beyond this range are not looked at, metres.
    pub max_range_m: f64,
    /// Scans in which rays passed through a voxel, and none ended there, after which it is free.
    pub free_after: u8,
    /// Scans after which something that came and stayed is no longer moving.
    pub still_after: u8,
    /// The least number of returns of something that moves.
    pub min_returns: usize,
}

impl Default for MovingConfig {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.25,
            max_range_m: 80.0,
            free_after: 5,
            still_after: 50,
            min_returns: 8,
        }
    }
}

/// Voxels to each side of a seed that must be free.
const SEED_REACH: i32 = 2;
/// So many voxels from a seed, returns in free voxels move with it.
const GROWTH: usize = 3;

/// What is remembered of a voxel.
#[derive(Clone, Copy, Debug, Default)]
struct Voxel {
    /// Scans whose rays have passed since the last one that ended there, or moving things were there only.
    passed: u8,
    /// Scans since rays passed last in which something moving was there.
    visited: u8,
}

/// Tells scan by scan which returns move.
#[derive(Clone, Debug)]
pub struct Moving {
    config: MovingConfig,
    chunks: HashMap<IVec3, Box<[Voxel; VOXELS]>, FxBuildHasher>,
}

impl Moving {
    /// No scan has been seen so far.
    ///
    /// # Errors
    /// [`PlanError`] names the option that makes no sense.
    pub fn new(config: MovingConfig) -> Result<Self, PlanError> {
        check_rays(config.voxel_size_m, config.max_range_m)?;
        Ok(Self {
            config,
            chunks: HashMap::default(),
        })
    }

    /// Whether each return of the next scan moves. Scans are told in order, without invalid returns ([`Scan::drop_invalid`]).
    ///
    /// # Errors
    /// [`ScanError::NoPose`] names a scan without a pose.
    pub fn classify(&mut self, scan: &Scan) -> Result<Vec<bool>, ScanError> {
        let rays = Rays::of(scan, self.config.voxel_size_m, self.config.max_range_m)?;
        let mut in_voxels: HashMap<IVec3, usize, FxBuildHasher> = HashMap::default();
        for voxel in rays.hits.iter().flatten() {
            *in_voxels.entry(*voxel).or_default() += 1;
        }
        let moving = self.moving(&in_voxels);
        let marks = rays.marks();
        self.remember(marks, &moving);
        let is_moving = |hit: &Option<IVec3>| hit.is_some_and(|voxel| moving.contains(&voxel));
        Ok(rays.hits.iter().map(is_moving).collect())
    }

    /// The voxels in which something moves, of those in which rays end and how many.
    fn moving(&self, hits: &HashMap<IVec3, usize, FxBuildHasher>) -> HashSet<IVec3, FxBuildHasher> {
        let mut voxels: Vec<IVec3> = hits.keys().copied().filter(|voxel| self.is_free(*voxel)).collect();
        voxels.par_sort_unstable_by_key(IVec3::to_array);
        let around = |reach: i32| {
            let edge = 2 * reach + 1;
            (0..edge.pow(3)).map(move |i| IVec3::new(i % edge, i / edge % edge, i / edge / edge) - reach)
        };
        let is_seed = |voxel: &IVec3| around(SEED_REACH).all(|offset| self.is_free(*voxel + offset));
        let seeds: Vec<IVec3> = voxels.par_iter().copied().filter(is_seed).collect();
        let free: HashSet<IVec3, FxBuildHasher> = voxels.into_iter().collect();
        let mut moving: HashSet<IVec3, FxBuildHasher> = seeds.iter().copied().collect();
        let mut last = seeds;
        for _ in 0..GROWTH {
            let mut next = Vec::new();
            for voxel in last {
                let near = around(1).map(|offset| voxel + offset);
                next.extend(near.filter(|near| free.contains(near) && moving.insert(*near)));
            }
            last = next;
        }
        self.without_small(moving, hits)
    }

    /// Leaves out connected voxels with too few returns.
    fn without_small(
        &self,
        moving: HashSet<IVec3, FxBuildHasher>,
        hits: &HashMap<IVec3, usize, FxBuildHasher>,
    ) -> HashSet<IVec3, FxBuildHasher> {
        let mut left = moving.clone();
        let mut kept = moving;
        let mut order: Vec<IVec3> = kept.iter().copied().collect();
        order.sort_unstable_by_key(IVec3::to_array);
        for first in order {
            if !left.remove(&first) {
                continue;
            }
            let (mut together, mut done) = (vec![first], 0);
            while let Some(&voxel) = together.get(done) {
                done += 1;
                let near = (0..27).map(|i| voxel + IVec3::new(i % 3, i / 3 % 3, i / 9) - 1);
                together.extend(near.filter(|near| left.remove(near)));
            }
            let returns: usize = together.iter().filter_map(|voxel| hits.get(voxel)).sum();
            if returns < self.config.min_returns {
                together.iter().for_each(|voxel| {
                    kept.remove(voxel);
                });
            }
        }
        kept
    }

    fn is_free(&self, voxel: IVec3) -> bool {
        let chunk = self.chunks.get(&(voxel >> CHUNK.trailing_zeros()));
        chunk.is_some_and(|chunk| chunk[number(voxel)].passed >= self.config.free_after)
    }

    /// Counts what passed, and what ended.
    fn remember(&mut self, marks: Marks, moving: &HashSet<IVec3, FxBuildHasher>) {
        let still_after = self.config.still_after;
        let mut touched: Vec<_> = marks
            .into_chunks()
            .map(|(index, marks)| {
                let known = self
                    .chunks
                    .remove(&index)
                    .unwrap_or_else(|| Box::new([Voxel::default(); VOXELS]));
                (index, marks, known)
            })
            .collect();
        touched.par_iter_mut().for_each(|(index, marks, known)| {
            for (word, (passed, hit)) in marks.words().enumerate() {
                bits(hit, |bit| {
                    let at = word * 64 + bit;
                    let voxel = &mut known[at];
                    voxel.visited = voxel.visited.saturating_add(1);
                    if voxel.visited > still_after || !moving.contains(&voxel_of(*index, at)) {
                        *voxel = Voxel::default();
                    }
                });
                bits(passed & !hit, |bit| {
                    let voxel = &mut known[word * 64 + bit];
                    voxel.passed = voxel.passed.saturating_add(1);
                    voxel.visited = 0;
                });
            }
        });
        self.chunks
            .extend(touched.into_iter().map(|(index, _, known)| (index, known)));
    }

    /// Bytes of all voxels.
    pub fn memory_bytes(&self) -> usize {
        self.chunks.len() * VOXELS * size_of::<Voxel>()
    }
}
