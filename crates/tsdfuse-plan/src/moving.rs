//! Which returns move: those in space that was known to be free.
//!
//! After Schmid et al., "Dynablox", RA-L 2023, with rays instead of a distance field. A voxel is *free* after rays have passed through it in
//! several scans without ending there. It is *clear* once all voxels around it are free, two to each side: so neither noise in front of a
//! wall nor rays that graze the ground end in clear voxels. Clear voxels stay clear while something moves in or beside them. A return in a clear
//! voxel moves. So does what lies up to three free voxels from there: wheels, and feet. What is more than 250 m from the sensor is forgotten.
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
use crate::marks::{CHUNK, ChunkMarks, Marks, VOXELS, bits, number, voxel_of};
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

/// What is farther from the sensor is forgotten, metres.
const FORGOTTEN_M: f64 = 250.0;
/// Voxels to each side of a clear one that were free at the same time.
const REACH: i32 = 2;
/// So many voxels from a clear one, returns in free voxels move with it.
const GROWTH: usize = 3;
/// Scans that ended in a free voxel, though nothing moved there, after which those around are no longer clear: something thin was missed before.
const MISSED: u8 = 10;

/// What is remembered of a voxel.
#[derive(Clone, Copy, Debug, Default)]
struct Voxel {
    /// Scans whose rays have passed since the last one that ended there, or moving things were there only.
    passed: u8,
    /// Scans since rays passed last in which something moving was there.
    visited: u8,
    /// Scans that ended there since it was free, though nothing moved.
    missed: u8,
}

/// A bit for each voxel of a chunk.
type Bits = [u64; VOXELS / 64];

/// What is remembered of 16³ voxels.
#[derive(Clone, Debug)]
struct Chunk {
    voxels: Box<[Voxel; VOXELS]>,
    free: Bits,
    clear: Bits,
}

impl Default for Chunk {
    fn default() -> Self {
        Self {
            voxels: Box::new([Voxel::default(); VOXELS]),
            free: [0; VOXELS / 64],
            clear: [0; VOXELS / 64],
        }
    }
}

fn has(bits: &Bits, number: usize) -> bool {
    bits[number / 64] >> (number % 64) & 1 == 1
}

/// The voxels of a chunk around which all are free, by the free ones of the chunks around it, its own in the middle.
fn clear(around: &[Option<&Bits>; 27]) -> Bits {
    const EDGE: usize = CHUNK as usize;
    const WIDE: usize = EDGE + 2 * REACH as usize;
    // Rows along z of this chunk and of as much of its neighbours as is looked at; one bit a voxel.
    let row = |x: usize, y: usize| {
        // Chunk and voxel of a place along an axis.
        let split = |at: usize| ((at + EDGE - REACH as usize) / EDGE, (at + EDGE - REACH as usize) % EDGE);
        let ((cx, x), (cy, y)) = (split(x), split(y));
        let of = |cz: usize| {
            let number = x * EDGE + y;
            around[(cx * 3 + cy) * 3 + cz].map_or(0, |bits| bits[number / 4] >> (EDGE * (number % 4)) & 0xffff)
        };
        (of(0) >> (EDGE - REACH as usize) | of(1) << REACH | of(2) << (EDGE + REACH as usize)) as u32
    };
    let eroded = |bits: u32| (1..=2 * REACH).fold(bits, |all, by| all & bits >> by);
    let mut rows = [[0_u32; WIDE]; WIDE];
    for (x, rows) in rows.iter_mut().enumerate() {
        for (y, bits) in rows.iter_mut().enumerate() {
            *bits = eroded(row(x, y));
        }
    }
    let width = 2 * REACH as usize + 1;
    let along_y = rows.map(|rows| {
        let of = |y: usize| rows[y..y + width].iter().fold(u32::MAX, |all, bits| all & bits);
        std::array::from_fn::<u32, EDGE, _>(of)
    });
    let mut clear = [0; VOXELS / 64];
    for number in 0..EDGE * EDGE {
        let (x, y) = (number / EDGE, number % EDGE);
        let bits = along_y[x..x + width].iter().fold(0xffff, |all, rows| all & rows[y]);
        clear[number / 4] |= u64::from(bits) << (EDGE * (number % 4));
    }
    clear
}

/// Offsets to all voxels up to so many to each side.
fn around(reach: i32) -> impl Iterator<Item = IVec3> {
    let edge = 2 * reach + 1;
    (0..edge.pow(3)).map(move |i| IVec3::new(i / edge / edge, i / edge % edge, i % edge) - reach)
}

/// Tells scan by scan which returns move.
#[derive(Clone, Debug)]
pub struct Moving {
    config: MovingConfig,
    chunks: HashMap<IVec3, Chunk, FxBuildHasher>,
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
        let mut rays = Rays::of(scan, self.config.voxel_size_m, self.config.max_range_m)?;
        let moving = self.moving(&rays.hits);
        rays.thin();
        self.remember(rays.marks(), &moving);
        let chunk_m = self.config.voxel_size_m * f64::from(CHUNK);
        let sensor = scan.world_from_sensor()?.translation;
        self.chunks
            .retain(|index, _| (index.as_dvec3() * chunk_m).distance(sensor) < FORGOTTEN_M);
        let is_moving = |hit: &Option<IVec3>| hit.is_some_and(|voxel| moving.contains(&voxel));
        Ok(rays.hits.par_iter().map(is_moving).collect())
    }

    /// The voxels in which something moves, of those in which rays end.
    fn moving(&self, hits: &[Option<IVec3>]) -> HashSet<IVec3, FxBuildHasher> {
        let free: Vec<IVec3> = hits
            .par_iter()
            .flatten()
            .copied()
            .filter(|voxel| self.is_free(*voxel))
            .collect();
        let mut returns: HashMap<IVec3, usize, FxBuildHasher> = HashMap::default();
        for voxel in free {
            *returns.entry(voxel).or_default() += 1;
        }
        let mut voxels: Vec<IVec3> = returns.keys().copied().collect();
        voxels.sort_unstable_by_key(IVec3::to_array);
        let seeds: Vec<IVec3> = voxels.iter().copied().filter(|voxel| self.is_clear(*voxel)).collect();
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
        self.without_small(moving, &returns)
    }

    /// Leaves out connected voxels with too few returns.
    fn without_small(
        &self,
        moving: HashSet<IVec3, FxBuildHasher>,
        returns: &HashMap<IVec3, usize, FxBuildHasher>,
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
            let count: usize = together.iter().filter_map(|voxel| returns.get(voxel)).sum();
            if count < self.config.min_returns {
                together.iter().for_each(|voxel| {
                    kept.remove(voxel);
                });
            }
        }
        kept
    }

    fn chunk(&self, voxel: IVec3) -> Option<&Chunk> {
        self.chunks.get(&(voxel >> CHUNK.trailing_zeros()))
    }

    fn is_free(&self, voxel: IVec3) -> bool {
        self.chunk(voxel).is_some_and(|chunk| has(&chunk.free, number(voxel)))
    }

    fn is_clear(&self, voxel: IVec3) -> bool {
        self.chunk(voxel).is_some_and(|chunk| has(&chunk.clear, number(voxel)))
    }

    /// Counts what passed, and what ended.
    fn remember(&mut self, marks: Marks, moving: &HashSet<IVec3, FxBuildHasher>) {
        struct Touched {
            index: IVec3,
            marks: ChunkMarks,
            chunk: Chunk,
            /// Whether more voxels are free than before.
            is_freer: bool,
            /// Voxels in which something thin was missed.
            missed: Vec<IVec3>,
        }
        let MovingConfig {
            still_after,
            free_after,
            ..
        } = self.config;
        let mut touched: Vec<Touched> = marks
            .into_chunks()
            .map(|(index, marks)| Touched {
                chunk: self.chunks.remove(&index).unwrap_or_default(),
                index,
                marks,
                is_freer: false,
                missed: Vec::new(),
            })
            .collect();
        touched.par_iter_mut().for_each(|touched| {
            let Chunk { voxels, free, clear } = &mut touched.chunk;
            for (word, (passed, hit)) in touched.marks.words().enumerate() {
                bits(hit, |bit| {
                    let (at, mask) = (word * 64 + bit, 1_u64 << bit);
                    let voxel = &mut voxels[at];
                    voxel.visited = voxel.visited.saturating_add(1);
                    let place = voxel_of(touched.index, at);
                    if voxel.visited > still_after || !moving.contains(&place) {
                        let was_free = free[word] & mask != 0 || voxel.missed > 0;
                        let missed = if was_free { voxel.missed.saturating_add(1) } else { 0 };
                        if missed == MISSED {
                            touched.missed.push(place);
                        }
                        *voxel = Voxel {
                            missed,
                            ..Voxel::default()
                        };
                        free[word] &= !mask;
                        clear[word] &= !mask;
                    }
                });
                bits(passed & !hit, |bit| {
                    let voxel = &mut voxels[word * 64 + bit];
                    voxel.passed = voxel.passed.saturating_add(1);
                    voxel.visited = 0;
                    if voxel.passed == free_after {
                        free[word] |= 1 << bit;
                        touched.is_freer = true;
                    }
                });
            }
        });
        let mut freer: HashSet<IVec3, FxBuildHasher> = HashSet::default();
        let mut missed = Vec::new();
        for touched in touched {
            if touched.is_freer {
                freer.extend(around(1).map(|offset| touched.index + offset));
            }
            missed.extend(touched.missed);
            self.chunks.insert(touched.index, touched.chunk);
        }
        let freer: Vec<IVec3> = freer.into_iter().collect();
        let of = |index: &IVec3| {
            self.chunks.get(index)?;
            let mut beside = [None; 27];
            for (place, offset) in beside.iter_mut().zip(around(1)) {
                *place = self.chunks.get(&(*index + offset)).map(|chunk| &chunk.free);
            }
            Some((*index, clear(&beside)))
        };
        let clearer: Vec<(IVec3, Bits)> = freer.par_iter().filter_map(of).collect();
        for (index, more) in clearer {
            if let Some(chunk) = self.chunks.get_mut(&index) {
                chunk
                    .clear
                    .iter_mut()
                    .zip(more)
                    .for_each(|(clear, more)| *clear |= more);
            }
        }
        for voxel in missed
            .into_iter()
            .flat_map(|voxel| around(REACH).map(move |offset| voxel + offset))
        {
            if let Some(chunk) = self.chunks.get_mut(&(voxel >> CHUNK.trailing_zeros())) {
                let number = number(voxel);
                chunk.clear[number / 64] &= !(1 << (number % 64));
            }
        }
    }

    /// Bytes of all voxels.
    pub fn memory_bytes(&self) -> usize {
        self.chunks.len() * (VOXELS * size_of::<Voxel>() + size_of::<Chunk>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tsdfuse::Pose;
    use tsdfuse::glam::{DVec3, Vec3};

    /// A wall 8 m ahead of a sensor.
    fn wall(sensor: DVec3) -> Scan {
        let points = (0..10_000).map(|i| Vec3::new(8.0, 0.08 * (i % 100 - 50) as f32, 0.08 * (i / 100 - 50) as f32));
        Scan {
            points: points.collect(),
            pose: Some(Pose {
                translation: sensor,
                ..Pose::IDENTITY
            }),
            ..Default::default()
        }
    }

    #[test]
    fn memory_does_not_grow_with_the_drive() {
        let mut moving = Moving::new(MovingConfig::default()).unwrap();
        let after = |moving: &mut Moving, metres: std::ops::Range<i32>| {
            for metre in metres {
                moving.classify(&wall(DVec3::X * f64::from(10 * metre))).unwrap();
            }
            moving.memory_bytes()
        };
        let short = after(&mut moving, 0..30);
        assert_eq!(after(&mut moving, 30..100), short);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Bits against a look at each voxel around.
        #[test]
        fn voxels_are_clear_whose_neighbours_are_all_free(
            taken in prop::collection::vec((-20..36_i32, -20..36_i32, -20..36_i32), 0..60),
            without in prop::collection::vec(0..27_usize, 0..3),
        ) {
            let taken: HashSet<IVec3> = taken.into_iter().map(IVec3::from).collect();
            let missing: Vec<IVec3> = without.iter().filter_map(|i| around(1).nth(*i)).collect();
            let is_free = |voxel: IVec3| !taken.contains(&voxel) && !missing.contains(&(voxel >> 4));
            let chunks: Vec<Bits> = around(1)
                .map(|index| {
                    let mut free = [0; VOXELS / 64];
                    for at in (0..VOXELS).filter(|at| is_free(voxel_of(index, *at))) {
                        free[at / 64] |= 1 << (at % 64);
                    }
                    free
                })
                .collect();
            let beside: Vec<Option<&Bits>> =
                around(1).zip(&chunks).map(|(index, bits)| (!missing.contains(&index)).then_some(bits)).collect();
            let found = clear(&beside.try_into().unwrap());
            for at in 0..VOXELS {
                let voxel = voxel_of(IVec3::ZERO, at);
                let expected = around(REACH).all(|offset| is_free(voxel + offset));
                prop_assert_eq!(has(&found, at), expected, "{}", voxel);
            }
        }
    }
}
