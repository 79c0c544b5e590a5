//! Maps on another grid: with voxels of another size, or moved and turned.
//!
//! A motion by whole voxels and quarter turns only renumbers voxels. Any other grid is sampled: a new voxel takes what a linear
//! function has at its centre that is fitted to the old voxels about it,
//!
//! ```text
//!   min over a, g of  Σ c (F − a − g·x)²,    F' = a        c = Π max(0, 1 − |x|/h) per axis
//! ```
//!
//! x being the old centres relative to the new one, and h the larger of both voxel sizes. Where all of them were observed this
//! is trilinear interpolation. At the border of what was observed, interpolation alone would lose the outermost voxels or shift
//! them, so h is doubled there. A plane stays a plane. The new weight is the mean of the old ones, by c: how often the place was observed, not
//! how often all of them were.

use glam::{DMat3, DQuat, DVec3, IVec3};
use hashbrown::HashSet;
use rayon::prelude::*;
use rustc_hash::FxBuildHasher;

use super::{
    block::{Block, MAX_WEIGHT_SUM, Voxel},
    config::MapConfig,
    error::MapError,
    recent::Recent,
    voxel_map::VoxelMap,
};
use crate::{
    index::{BLOCK_EDGE, BlockIndex, local_number, voxel_at},
    pose::Pose,
};

/// A new voxel needs this share of the sum of c to be observed: so that what a surface needs about it is there, too, in voxels
/// that are coarser.
const LEAST_SHARE: f64 = 0.25;

/// Keeps gradients from growing where the observed voxels do not tell them, times h².
const STIFFNESS: f64 = 1e-4;

impl VoxelMap {
    /// The map with voxels of another size; the truncation stays.
    ///
    /// # Errors
    /// [`MapError`] if the truncation is not 1 to 64 of such voxels.
    pub fn resampled(&self, voxel_size_m: f64) -> Result<Self, MapError> {
        let config = MapConfig {
            voxel_size_m,
            ..self.config
        };
        Warp::new(self.config.voxel_size_m, voxel_size_m, Pose::IDENTITY).of(self, config)
    }

    /// The map moved by a rigid motion, and whether that only renumbered voxels: then no bit of them changed.
    ///
    /// # Errors
    /// [`MapError::Outside`] if it would leave the grid.
    pub fn transformed(&self, new_from_old: &Pose) -> Result<(Self, bool), MapError> {
        let size = self.config.voxel_size_m;
        match Renumbering::of(new_from_old, size) {
            Some(renumbering) => Ok((renumbering.of_map(self)?, true)),
            None => Ok((Warp::new(size, size, *new_from_old).of(self, self.config)?, false)),
        }
    }
}

/// A motion that takes voxels to voxels: of each new axis, the old one, whether it is reversed, and the shift.
struct Renumbering([(usize, bool, i32); 3]);

impl Renumbering {
    /// `None` if the motion is no such.
    fn of(new_from_old: &Pose, voxel_size_m: f64) -> Option<Self> {
        /// What is left of sines and cosines, and of metres divided by the voxels' size.
        const ROUNDING: f64 = 1e-6;
        let rows = DMat3::from_quat(new_from_old.rotation).transpose();
        let mut axes = [(0, false, 0); 3];
        for (axis, known) in axes.iter_mut().enumerate() {
            let row = rows.col(axis);
            let old = (0..3).find(|&old| (row[old].abs() - 1.0).abs() < ROUNDING)?;
            let shift = new_from_old.translation[axis] / voxel_size_m;
            let whole = shift.round();
            if (0..3).any(|other| other != old && row[other].abs() > ROUNDING)
                || (shift - whole).abs() > ROUNDING
                || whole.abs() > f64::from(1 << 30)
            {
                return None;
            }
            *known = (old, row[old] < 0.0, whole as i32);
        }
        Some(Self(axes))
    }

    /// `None` if it leaves the grid.
    fn of_voxel(&self, voxel: IVec3) -> Option<IVec3> {
        let mut new = IVec3::ZERO;
        for (axis, &(old, reversed, shift)) in self.0.iter().enumerate() {
            // The centre i + ½ becomes −i − ½, that of voxel −i − 1.
            let turned = if reversed { !voxel[old] } else { voxel[old] };
            new[axis] = turned.checked_add(shift)?;
        }
        Some(new)
    }

    fn of_map(&self, map: &VoxelMap) -> Result<VoxelMap, MapError> {
        let mut moved = VoxelMap::new(map.config)?;
        moved.integrations = map.integrations;
        for region in map.regions() {
            for (index, block) in map.blocks_of(region) {
                let outside = MapError::Outside { block: index };
                // A block's voxels lie in up to eight new ones.
                let mut parts: Vec<(BlockIndex, Block)> = Vec::new();
                for (number, &voxel) in block.voxels.iter().enumerate() {
                    let new = self.of_voxel(voxel_at(index, number)).ok_or_else(|| outside.clone())?;
                    let target = BlockIndex::of(new);
                    let at = parts
                        .iter()
                        .position(|(index, _)| *index == target)
                        .unwrap_or(parts.len());
                    if at == parts.len() {
                        parts.push((target, Block::EMPTY));
                    }
                    parts[at].1.voxels[local_number(new)] = voxel;
                }
                // Each voxel has one source: nothing is added to anything.
                for (target, part) in parts.iter().filter(|(_, part)| part.is_observed()) {
                    moved.add_block(*target, part)?;
                }
            }
        }
        Ok(moved)
    }
}

/// Where new voxels are among old ones.
struct Warp {
    /// To old coordinates from new ones, both in voxels; a rotation times `scale`.
    old_from_new: DMat3,
    shift: DVec3,
    /// New voxels per old voxel, by length.
    scale: f64,
}

impl Warp {
    fn new(old_size_m: f64, new_size_m: f64, new_from_old: Pose) -> Self {
        let Pose { rotation, translation } = new_from_old.inverse();
        let scale = new_size_m / old_size_m;
        Self {
            old_from_new: DMat3::from_quat(DQuat::normalize(rotation)) * scale,
            shift: translation / old_size_m,
            scale,
        }
    }

    /// The new map.
    fn of(&self, old: &VoxelMap, config: MapConfig) -> Result<VoxelMap, MapError> {
        let mut new = VoxelMap::new(config)?;
        new.integrations = old.integrations;
        let candidates = self.candidates(old)?;
        for some in candidates.chunks(1 << 14) {
            let blocks = some
                .par_iter()
                .map_init(|| Recent::new(old), |recent, &index| self.block(index, recent));
            for (&index, block) in some.iter().zip(blocks.collect::<Vec<_>>()) {
                if let Some(block) = block {
                    new.insert_block(index, *block)?;
                }
            }
        }
        Ok(new)
    }

    /// How far from its centre a new voxel looks, in old voxels.
    fn reach(&self) -> f64 {
        self.scale.max(1.0)
    }

    /// The new blocks that old ones reach into, sorted.
    fn candidates(&self, old: &VoxelMap) -> Result<Vec<BlockIndex>, MapError> {
        let (new_from_old, reach) = (self.old_from_new.inverse(), self.reach());
        let absolute = DMat3::from_cols(
            new_from_old.x_axis.abs(),
            new_from_old.y_axis.abs(),
            new_from_old.z_axis.abs(),
        );
        let half = absolute * DVec3::splat(0.5 * f64::from(BLOCK_EDGE) + reach);
        let mut all = HashSet::<BlockIndex, FxBuildHasher>::default();
        for block in old.block_indices() {
            let middle = block.first_voxel().as_dvec3() + 0.5 * f64::from(BLOCK_EDGE);
            let middle = new_from_old * (middle - self.shift);
            // Also false for NaN.
            if !middle.abs().cmplt(DVec3::splat(f64::from(1 << 30))).all() {
                return Err(MapError::Outside { block });
            }
            let [low, high] = [middle - half, middle + half].map(|c| BlockIndex::of(c.floor().as_ivec3()).0);
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    all.extend((low.x..=high.x).map(|x| BlockIndex(IVec3::new(x, y, z))));
                }
            }
        }
        let mut all: Vec<_> = all.into_iter().collect();
        all.par_sort_unstable();
        Ok(all)
    }

    /// `None` if none of its voxels is known.
    fn block(&self, index: BlockIndex, old: &mut Recent<'_>) -> Option<Box<Block>> {
        let mut block = Box::new(Block::EMPTY);
        let mut known = false;
        for (number, voxel) in block.voxels.iter_mut().enumerate() {
            let center = voxel_at(index, number).as_dvec3() + 0.5;
            if let Some(sampled) = sample(self.old_from_new * center + self.shift, self.reach(), old) {
                (*voxel, known) = (sampled, true);
            }
        }
        known.then_some(block)
    }
}

/// What a place in the old map's grid (in voxels) has; `None` if too little of what is about it was observed.
fn sample(place: DVec3, reach: f64, old: &mut Recent<'_>) -> Option<Voxel> {
    let (near, all) = Sums::about(place, reach, old);
    if near.c <= 0.0 || near.c < LEAST_SHARE * all {
        return None;
    }
    let mut voxel = near.voxel(reach);
    if near.c < (1.0 - 1e-9) * all {
        let wide = Sums::about(place, 2.0 * reach, old).0.voxel(2.0 * reach);
        voxel.distance_sum = (wide.distance()? * voxel.weight_sum as f32).round() as i32;
    }
    Some(voxel)
}

/// Σ c, and of weights, places and distances times c.
#[derive(Default)]
struct Sums {
    c: f64,
    weight: f64,
    f: f64,
    x: DVec3,
    fx: DVec3,
    xx: DMat3,
}

impl Sums {
    /// Of the observed voxels about a place, and Σ c over all of them.
    fn about(place: DVec3, reach: f64, old: &mut Recent<'_>) -> (Self, f64) {
        let first = (place - 0.5 - reach).ceil().as_ivec3();
        let last = (place - 0.5 + reach).floor().as_ivec3();
        // A matrix is the identity by default.
        let zero = Self {
            xx: DMat3::ZERO,
            ..Self::default()
        };
        let (mut sums, mut all) = (zero, 0.0);
        for z in first.z..=last.z {
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    let voxel = IVec3::new(x, y, z);
                    let offset = voxel.as_dvec3() + 0.5 - place;
                    let near = DVec3::ONE - offset.abs() / reach;
                    let c = near.x * near.y * near.z;
                    all += c;
                    sums.add(c, offset, old.voxel(voxel));
                }
            }
        }
        (sums, all)
    }

    fn add(&mut self, c: f64, x: DVec3, voxel: Voxel) {
        if voxel.weight_sum == 0 || c <= 0.0 {
            return;
        }
        let f = f64::from(voxel.distance_sum) / f64::from(voxel.weight_sum);
        self.c += c;
        self.weight += c * f64::from(voxel.weight_sum);
        self.f += c * f;
        self.x += c * x;
        self.fx += c * f * x;
        self.xx += DMat3::from_cols(x * x.x, x * x.y, x * x.z) * c;
    }

    /// The fitted function at x = 0, and the mean weight.
    fn voxel(&self, reach: f64) -> Voxel {
        let (x, f) = (self.x / self.c, self.f / self.c);
        let spread = self.xx * (1.0 / self.c) - DMat3::from_cols(x * x.x, x * x.y, x * x.z);
        let stiff = DMat3::from_diagonal(DVec3::splat(STIFFNESS * reach * reach));
        let gradient = (spread + stiff).inverse() * (self.fx / self.c - x * f);
        let f = (f - gradient.dot(x)).clamp(-1.0, 1.0);
        let weight = (self.weight / self.c).round().clamp(1.0, f64::from(MAX_WEIGHT_SUM));
        Voxel {
            weight_sum: weight as u32,
            distance_sum: (f * weight).round() as i32,
        }
    }
}
