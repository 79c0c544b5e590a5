//! What the map holds already: surface between returns is not fused again where scans before have settled it.
//!
//! On a drive the same road lies between the rings of dozens of scans, and what lies between returns is only inferred. So most lines of a
//! scan would tell the map what it knows.

use crate::{
    index::{Anchor, BlockIndex, local_number},
    map::{Recent, Voxel, VoxelMap, WEIGHT_SCALE},
    memory::prefetch,
};

use super::surface::Patch;

/// A voxel has settled if its weight is more than this many times that of the update.
pub const SETTLED: f32 = 4.0;

/// Links of fewer patches are always fused: where returns are near each other, what lies between makes up for their noise.
pub const LONG: usize = 4;

/// If the map's surface is farther than this from the patch, in voxels, it is another one.
pub const OTHER_SURFACE: f32 = 1.0;

/// Patches whose voxels are fetched from memory at a time.
const BURST: usize = 64;

/// Where the patches of a scan lie in a map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Held<'a> {
    pub(crate) map: &'a VoxelMap,
    pub(crate) anchor: Anchor,
}

/// Links, lists of patches, whose voxels were asked for.
pub(super) struct Links<'a> {
    held: Held<'a>,
    recent: Recent<'a>,
    /// The voxel of each patch, and the weight above which it has settled, in fixed point.
    voxels: Vec<(Option<&'a Voxel>, f32)>,
    /// Where links end in this list.
    ends: Vec<usize>,
}

impl<'a> Links<'a> {
    pub(super) fn new(held: Held<'a>) -> Self {
        Self {
            held,
            recent: Recent::new(held.map),
            voxels: Vec::with_capacity(BURST),
            ends: Vec::with_capacity(BURST),
        }
    }

    /// Adds the last link of a list, `length` patches, and takes out again those that the map holds, once there are many.
    #[inline(always)]
    pub(super) fn push(&mut self, patches: &mut Vec<Patch>, length: usize) {
        for patch in &patches[patches.len() - length..] {
            let center = self.held.anchor.locate(patch.center).filter(|_| length >= LONG);
            let voxel = center.and_then(|center| {
                let block = self.recent.block(BlockIndex::of(center.voxel))?;
                let voxel = &block.voxels[local_number(center.voxel)];
                prefetch(voxel);
                Some(voxel)
            });
            self.voxels
                .push((voxel, SETTLED * WEIGHT_SCALE as f32 * patch.weight()));
        }
        self.ends.push(self.voxels.len());
        if self.voxels.len() >= BURST {
            self.take_out(patches);
        }
    }

    /// Takes the links that the map holds out of the end of the list.
    pub(super) fn take_out(&mut self, patches: &mut Vec<Patch>) {
        let most_off = OTHER_SURFACE / self.held.map.config().truncation_vox();
        let is_held = |&(voxel, settled): &(Option<&Voxel>, f32)| {
            let voxel = voxel.copied().unwrap_or_default();
            let weight = voxel.weight_sum as f32;
            // Without branches, which would wait for memory one after the other.
            (weight > settled) & ((voxel.distance_sum as f32).abs() <= most_off * weight)
        };
        let first = patches.len() - self.voxels.len();
        let (mut start, mut kept) = (0, first);
        for &end in &self.ends {
            let is_all_held = self.voxels[start..end]
                .iter()
                .fold(true, |all, voxel| all & is_held(voxel));
            if !is_all_held {
                patches.copy_within(first + start..first + end, kept);
                kept += end - start;
            }
            start = end;
        }
        patches.truncate(kept);
        self.voxels.clear();
        self.ends.clear();
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::{MapConfig, patch::surface::Kind};

    /// A voxel with this many times the weight of an update by a patch that faces the sensor 10 m away, and this distance, in voxels.
    fn voxel(times: f32, distance_vox: f32) -> Voxel {
        let weight = times * 0.1 * WEIGHT_SCALE as f32;
        Voxel {
            weight_sum: weight as u32,
            distance_sum: (distance_vox / 4.0 * weight) as i32,
        }
    }

    /// Which links of `length` patches are left, if the map has these voxels along them, 5 cm apart, 40 in a row.
    fn left(voxels: &[Voxel], length: usize) -> Vec<usize> {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let anchor = map.grid().anchor(DVec3::ZERO).unwrap();
        let at = |i: usize| 0.05 * DVec3::new(200.0, (i % 40) as f64, (i / 40) as f64) + 0.025;
        for (i, &voxel) in voxels.iter().enumerate() {
            let place = anchor.locate(at(i).as_vec3()).unwrap().voxel;
            let index = BlockIndex::of(place);
            let mut block = map.block(index).cloned().unwrap_or(crate::map::Block::EMPTY);
            block.voxels[local_number(place)] = voxel;
            map.replace_block(index, block).unwrap();
        }
        let mut links = Links::new(Held { map: &map, anchor });
        let mut patches = Vec::new();
        for link in 0..voxels.len() / length {
            patches.extend((link * length..(link + 1) * length).map(|i| Patch {
                center: at(i).as_vec3(),
                normal: -Vec3::X,
                kind: Kind::Whole,
            }));
            links.push(&mut patches, length);
        }
        links.take_out(&mut patches);
        let number = |patch: &Patch| (patch.center.y / 0.05) as usize + 40 * (patch.center.z / 0.05) as usize;
        patches.iter().map(number).collect()
    }

    #[test]
    fn long_links_are_left_out_where_all_their_voxels_have_settled_near_the_surface() {
        let settled = [voxel(5.0, 0.5); 5];
        let with = |one: Voxel| [settled[0], settled[1], one, settled[3], settled[4]];
        let (light, other) = (with(voxel(3.0, 0.5)), with(voxel(5.0, -1.5)));
        let numbers = |links: &[usize]| -> Vec<usize> { links.iter().flat_map(|l| 5 * l..5 * (l + 1)).collect() };
        assert_eq!(
            left(&[settled, light, settled, other, settled].concat(), 5),
            numbers(&[1, 3])
        );
        assert_eq!(left(&[Voxel::default(); 5], 5), numbers(&[0]));
        // More than one burst.
        let many = [light, settled, settled].concat().repeat(20);
        let every_third: Vec<usize> = (0..60).step_by(3).collect();
        assert_eq!(left(&many, 5), numbers(&every_third));
        // Short ones stay.
        assert_eq!(left(&settled[..LONG - 1], LONG - 1).len(), LONG - 1);
    }
}
