//! Where free space meets unknown space: what an explorer has not seen yet (Yamauchi, "A Frontier-Based Approach for Autonomous
//! Exploration", CIRA 1997).

use std::cmp::Reverse;

use hashbrown::HashSet;
use rustc_hash::FxBuildHasher;
use tsdfuse::glam::{DVec3, IVec3};

use super::{Occupancy, State};

/// Free voxels next to unknown ones that touch each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Frontier {
    /// Its voxels, sorted.
    pub voxels: Vec<IVec3>,
    /// The mean of their centres, world, metres.
    pub center: DVec3,
}

const FACES: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];

impl Occupancy {
    /// The frontiers between two heights (of voxel centres, world, metres) with at least so many voxels, the largest first. Voxels belong
    /// together if they share a corner.
    pub fn frontiers(&self, low_m: f64, high_m: f64, min_voxels: usize) -> Vec<Frontier> {
        let grid = self.grid();
        let is_between = |voxel: IVec3| (low_m..=high_m).contains(&grid.center(voxel).z);
        let is_frontier = |voxel: IVec3| FACES.iter().any(|face| self.state(voxel + face) == State::Unknown);
        let free = self
            .known()
            .filter(|(voxel, state)| *state == State::Free && is_between(*voxel));
        let all: Vec<IVec3> = free
            .map(|(voxel, _)| voxel)
            .filter(|voxel| is_frontier(*voxel))
            .collect();
        let mut left: HashSet<IVec3, FxBuildHasher> = all.iter().copied().collect();
        let mut found = Vec::new();
        for first in all {
            if !left.remove(&first) {
                continue;
            }
            let (mut voxels, mut done) = (vec![first], 0);
            while let Some(&voxel) = voxels.get(done) {
                done += 1;
                let around = (0..27).map(|i| voxel + IVec3::new(i % 3, i / 3 % 3, i / 9) - 1);
                voxels.extend(around.filter(|near| left.remove(near)));
            }
            if voxels.len() >= min_voxels {
                voxels.sort_unstable_by_key(IVec3::to_array);
                let sum: DVec3 = voxels.iter().map(|voxel| grid.center(*voxel)).sum();
                let center = sum / voxels.len() as f64;
                found.push(Frontier { voxels, center });
            }
        }
        found.sort_by_key(|frontier: &Frontier| Reverse(frontier.voxels.len()));
        found
    }
}
