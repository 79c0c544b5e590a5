//! How well a scan agrees with the surface that the map holds already: what the scan's pose and the sensor's calibration are worth.
//!
//! At some of the scan's planes, the map's surface is looked for along the normal. How far it is off tells nothing about one return,
//! since things move; the median over many tells the standard deviation σ. A pose that is turned a little, or a beam that is a
//! little off, moves a plane along its normal by the angle times the *arm*, ‖p × n‖: nothing on a wall that is met head-on, however far away
//! it is, much on the road ahead. So there is one σ for each power of two of arms. Nothing is kept from scan to scan, so that a run that was
//! interrupted continues with the same bits.

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    index::{Anchor, BlockIndex, GridPoint, floor, local_number},
    map::{Block, Voxel, VoxelMap},
    patch::{Patch, SAMPLE},
};

/// The map's surface is looked for this far from a plane, along its normal, in voxels.
pub const LOOK: usize = 4;

/// Arms: below 2 m, 4 m, …, and all above.
pub const ARMS: usize = 6;

/// Up to this many voxels behind or in front of a place, surface is that of the place itself; …
pub const OWN_STEPS: usize = 2;

/// … from there up to this many, as deep as windows lie in façades, it is another one.
pub const OTHER_STEPS: usize = 6;

/// Offsets are counted in bins, this many to a voxel.
pub const BINS_PER_VOXEL: usize = 16;

/// Fewer offsets than this do not tell; what shorter arms tell holds then.
pub const LEAST_OFFSETS: u32 = 40;

/// The standard deviation of normal numbers, over the median of their absolute values.
pub const OF_MEDIAN: f32 = 1.4826;

/// Ranges, voxels and shapes leave this much where poses are perfect, in voxels.
pub const BLUR: f32 = 0.25;

/// Lines reach this many σ in front of their plane, if that is more than they reach anyway.
pub const SIGMAS: f32 = 3.0;

/// A plane that is off by this σ, in voxels, weighs half as much.
pub const HALVING: f32 = 1.2;

/// Rays tell nothing about voxels nearer to their ends than by this many σ, beside what they never tell.
pub const SIGMAS_OF_RAYS: f32 = 2.0;

/// Planes whose lines pass one voxel, for each cell of the image that the voxel covers as the sensor sees it.
pub(super) const CROWD: f32 = 3.0;

const BINS: usize = BINS_PER_VOXEL * LOOK;

/// The standard deviation of planes from the surface of the map, along their normals, in voxels, by arms. 0: as good as perfect.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Agreement {
    sigma_vox: [f32; ARMS],
}

impl Agreement {
    /// Measures it at one of [`SAMPLE`] returns. `places` is a buffer.
    pub(super) fn of(map: &VoxelMap, anchor: Anchor, patches: &[Patch], places: &mut Vec<Option<(u8, u8)>>) -> Self {
        (0..patches.len().div_ceil(SAMPLE))
            .into_par_iter()
            .with_min_len(256)
            .map(|k| {
                let patch = &patches[k * SAMPLE];
                let center = anchor.locate(patch.center).filter(|_| patch.is_plane())?;
                let bin = (offset(map, center, patch.normal)?.abs() * BINS_PER_VOXEL as f32) as usize;
                Some((place_of(patch.arm_m()) as u8, bin.min(BINS - 1) as u8))
            })
            .collect_into_vec(places);
        let mut counts = [[0; BINS]; ARMS];
        for &(arm, bin) in places.iter().flatten() {
            counts[usize::from(arm)][usize::from(bin)] += 1;
        }
        let mut last = 0.0;
        let sigma_vox = counts.map(|counts| {
            last = sigma(&counts).unwrap_or(last);
            last
        });
        Self { sigma_vox }
    }

    /// The standard deviation of a patch, in voxels.
    #[inline(always)]
    pub(super) fn sigma_of(&self, patch: &Patch) -> f32 {
        if self.is_perfect() {
            0.0
        } else {
            self.sigma_vox(patch.arm_m())
        }
    }

    /// Whether all standard deviations are 0, as they mostly are where poses are good.
    #[inline(always)]
    fn is_perfect(&self) -> bool {
        self.sigma_vox == [0.0; ARMS]
    }

    /// The standard deviation for an arm, in voxels.
    #[inline(always)]
    pub(super) fn sigma_vox(&self, arm_m: f32) -> f32 {
        // Each holds in the middle of its arms.
        let place = (place_of(arm_m) - 0.5).clamp(0.0, (ARMS - 1) as f32);
        let low = place as usize;
        let [a, b] = [self.sigma_vox[low], self.sigma_vox[(low + 1).min(ARMS - 1)]];
        a + (b - a) * (place - low as f32)
    }
}

/// What a plane of some standard deviation weighs, if as many of the same scan, which are off together, meet in one voxel: information of
/// many that are off by errors of their own, and by one that all share.
#[inline(always)]
pub(super) fn share(sigma_vox: f32, crowd: f32) -> f32 {
    let off = sigma_vox * (1.0 / HALVING);
    1.0 / (1.0 + crowd.max(1.0) * off * off)
}

/// The logarithm to base 2 of an arm, from 0 on, by straight lines between whole numbers, which any processor computes alike.
#[inline(always)]
fn place_of(arm_m: f32) -> f32 {
    let log2 = arm_m.max(1.0).to_bits() as f32 * (1.0 / (1 << 23) as f32) - 127.0;
    log2.clamp(0.0, (ARMS - 1) as f32 + 0.5)
}

/// The standard deviation that the offsets of some arms tell.
fn sigma(counts: &[u32; BINS]) -> Option<f32> {
    let half = 0.5 * counts.iter().sum::<u32>() as f32;
    if half < 0.5 * LEAST_OFFSETS as f32 {
        return None;
    }
    let mut below = 0.0;
    for (bin, &count) in counts.iter().enumerate() {
        let count = count as f32;
        if below + count >= half {
            let median = (bin as f32 + (half - below) / count) * (1.0 / BINS_PER_VOXEL as f32);
            let sigma = OF_MEDIAN * median;
            return Some((sigma * sigma - BLUR * BLUR).max(0.0).sqrt());
        }
        below += count;
    }
    None
}

/// Reads the map along a normal.
struct Along<'a> {
    map: &'a VoxelMap,
    at: GridPoint,
    normal: Vec3,
    /// Mostly it is that of the next voxel, too.
    last_block: Option<(BlockIndex, Option<&'a Block>)>,
}

impl<'a> Along<'a> {
    fn new(map: &'a VoxelMap, at: GridPoint, normal: Vec3) -> Self {
        Self {
            map,
            at,
            normal,
            last_block: None,
        }
    }

    /// The voxel some steps in front of the place, as long as voxels: how far its centre is along the normal, and what it holds, if it was observed.
    #[inline(always)]
    fn read(&mut self, step: f32) -> Option<(f32, Voxel)> {
        let Self { map, at, normal, .. } = *self;
        let low = floor((at.fraction + normal * step).as_dvec3());
        let (corner, place) = (low.as_vec3(), at.voxel + low);
        let index = BlockIndex::of(place);
        let block = match self.last_block {
            Some((last, block)) if last == index => block,
            _ => map.block(index),
        };
        self.last_block = Some((index, block));
        let voxel = block?.voxels[local_number(place)];
        (voxel.weight_sum > 0).then(|| ((corner + 0.5 - at.fraction).dot(normal), voxel))
    }
}

/// How far in front of a place the map's surface is, along a normal, in voxels: where the distance passes 0, the nearest first.
fn offset(map: &VoxelMap, at: GridPoint, normal: Vec3) -> Option<f32> {
    let truncation = map.config().truncation_vox();
    let mut along = Along::new(map, at, normal);
    let mut read = |step: f32| {
        let distance = |voxel: Voxel| truncation * voxel.distance_sum as f32 / voxel.weight_sum as f32;
        along.read(step).map(|(along, voxel)| (along, distance(voxel)))
    };
    let mut last = [read(0.0); 2];
    for step in 1..=LOOK {
        for (last, step) in last.iter_mut().zip([step as f32, -(step as f32)]) {
            let next = read(step);
            let (behind, front) = if step > 0.0 { (*last, next) } else { (next, *last) };
            if let (Some((low, inside)), Some((high, outside))) = (behind, front)
                && inside < 0.0
                && outside >= 0.0
                && high > low
            {
                let off = low + (high - low) * inside / (inside - outside);
                return (off.abs() < LOOK as f32).then_some(off);
            }
            *last = next;
        }
    }
    None
}

/// Whether the map holds another surface a little behind a place or in front of it, along a normal, that faces the same way: what was seen
/// of the one behind was seen through the place, and behind the one in front nothing is seen.
pub(super) fn is_contradicted(map: &VoxelMap, at: GridPoint, normal: Vec3) -> bool {
    let mut along = Along::new(map, at, normal);
    [-1.0, 1.0].into_iter().any(|side| {
        let mut sum = |step: usize| along.read(side * step as f32).map(|(_, voxel)| voxel.distance_sum);
        let mut last = sum(OWN_STEPS);
        (OWN_STEPS + 1..=OTHER_STEPS).any(|step| {
            let next = sum(step);
            let (behind, front) = if side > 0.0 { (last, next) } else { (next, last) };
            last = next;
            behind.is_some_and(|sum| sum < 0) && front.is_some_and(|sum| sum >= 0)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Integrator, MapConfig, Pose, Scan,
        map::testing::map_of,
        sensor::{model, testing::scan_room},
    };
    use glam::{DQuat, DVec3, IVec3};

    #[test]
    fn arms_are_powers_of_two() {
        for (arm, place) in [
            (0.0, 0.0),
            (1.0, 0.0),
            (2.0, 1.0),
            (3.0, 1.5),
            (8.0, 3.0),
            (1e9, 5.5),
            (f32::NAN, 0.0),
        ] {
            assert_eq!(place_of(arm), place, "{arm}");
        }
    }

    #[test]
    fn few_offsets_tell_nothing() {
        let mut counts = [0; BINS];
        counts[3] = LEAST_OFFSETS - 1;
        assert_eq!(sigma(&counts), None);
        counts[3] += 1;
        let told = sigma(&counts).unwrap();
        let want = OF_MEDIAN * 3.5 / BINS_PER_VOXEL as f32;
        assert!((told * told + BLUR * BLUR - want * want).abs() < 1e-5, "{told}");
    }

    /// What a second scan of a room tells that is moved and turned from where it says it is.
    fn told(moved: DVec3, turned_rad: f64) -> Agreement {
        let sensor = model("os1-64").unwrap();
        let (points, rings) = scan_room(&sensor, |_| 0.0);
        let scan = Scan {
            points,
            rings: Some(rings),
            pose: Some(Pose::IDENTITY),
            ..Scan::default()
        };
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let mut method = crate::Patch::new(crate::fuse::PatchConfig::default(), Some(sensor));
        method.integrate(&mut map, &scan).unwrap();
        let anchor = map.grid().anchor(DVec3::ZERO).unwrap();
        let wrong = |p: &Patch| Patch {
            center: (DQuat::from_rotation_y(turned_rad) * p.center.as_dvec3() + moved).as_vec3(),
            ..*p
        };
        let patches: Vec<Patch> = method.planes()[..scan.points.len()].iter().map(wrong).collect();
        Agreement::of(&map, anchor, &patches, &mut Vec::new())
    }

    #[test]
    fn scans_that_agree_are_told_from_those_that_are_moved_or_turned() {
        let good = told(DVec3::ZERO, 0.0);
        let moved = told(DVec3::new(0.03, 0.03, 0.03), 0.0);
        let turned = told(DVec3::ZERO, 0.01);
        let all = |agreement: Agreement| [1.0, 3.0].map(|arm_m| agreement.sigma_vox(arm_m));
        assert!(all(good).iter().all(|&sigma| sigma < 0.1), "{good:?}");
        assert!(all(moved).iter().all(|sigma| (0.4..1.5).contains(sigma)), "{moved:?}");
        // Vertical walls do not move when the sensor pitches, and all near surface hardly.
        assert!(
            turned.sigma_vox(12.0) > 1.0 && turned.sigma_vox(1.0) < 0.1,
            "{turned:?}"
        );
        assert_eq!(share(0.0, 20.0), 1.0);
        assert!(share(1.0, 20.0) < share(1.0, 1.0) && share(1.0, 1.0) < 1.0);
    }

    #[test]
    fn surface_behind_or_in_front_contradicts_but_not_the_other_side_of_a_wall() {
        let is_contradicted = |height_m: fn(f32) -> f32, x: f32| {
            let map = map_of(IVec3::new(4, -1, -1), IVec3::new(7, 1, 1), |place| height_m(place.x));
            let anchor = map.grid().anchor(DVec3::ZERO).unwrap();
            is_contradicted(&map, anchor.locate(Vec3::new(x, 0.0, 0.0)).unwrap(), -Vec3::X)
        };
        // Seen from smaller x.
        let pane = |x: f32| 2.02 - x;
        for (x, expected) in [
            (1.6, false),
            (1.78, true),
            (1.87, true),
            (2.0, false),
            (2.05, false),
            (2.17, true),
            (2.27, true),
            (2.45, false),
        ] {
            assert_eq!(is_contradicted(pane, x), expected, "{x}");
        }
        // 20 cm thick, seen from both sides.
        let wall = |x: f32| (x - 2.0).abs() - 0.1;
        assert!(!is_contradicted(wall, 1.9) && !is_contradicted(wall, 1.95) && is_contradicted(wall, 1.7));
    }
}
