//! Saved maps in, a saved map out: merged, cropped, resampled, moved, aligned, repaired. What lies beside the maps (intensities, colours)
//! comes along.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use tsdfuse::glam::DVec3;
use tsdfuse::map::MapError;
use tsdfuse::{Pose, VoxelMap};
use tsdfuse_io::Error;
use tsdfuse_io::map_file::{self, Damage, FusedPose, Reader};
use tsdfuse_loops::{Alignment, Mapped};
use tsdfuse_store::Salvage;

use crate::error::{Result, RunError};
use crate::layer;
use crate::report::{MapReport, SavedMap};
use crate::saved::{add, move_poses, read_map};

/// What makes a map of saved maps.
#[derive(Clone, Debug, PartialEq)]
pub enum Operation {
    /// Adds maps with the same grid ([`VoxelMap::merge`]), in this order.
    Merge {
        /// One map or more.
        maps: Vec<PathBuf>,
    },
    /// Keeps the voxels whose centres lie in a box ([`VoxelMap::cropped`]).
    Crop {
        /// The map.
        map: PathBuf,
        /// The lowest corner, world, metres; may be infinite.
        low: DVec3,
        /// The highest corner.
        high: DVec3,
    },
    /// Changes the size of the voxels ([`VoxelMap::resampled`]).
    Resample {
        /// The map.
        map: PathBuf,
        /// Edge of the new voxels, metres.
        voxel_size_m: f64,
    },
    /// Moves a map ([`VoxelMap::transformed`]).
    Transform {
        /// The map.
        map: PathBuf,
        /// The motion.
        new_from_old: Pose,
    },
    /// Brings a map into the frame of another one ([`tsdfuse_loops::align`]).
    Align {
        /// The map that stays.
        first: PathBuf,
        /// The map that is moved.
        second: PathBuf,
    },
    /// Recovers the intact parts of a damaged map or store.
    Repair {
        /// The map.
        map: PathBuf,
    },
}

/// A map that was made, and where it is. Its figures are `None` where the operation has no such.
#[derive(Clone, Debug, Serialize)]
pub struct Operated {
    /// The map.
    pub map: MapReport,
    /// Its file.
    pub saved_map: SavedMap,
    /// What the operation found.
    #[serde(flatten)]
    pub findings: Findings,
    /// The layers that were made beside the map.
    #[serde(skip)]
    pub layers: Vec<PathBuf>,
}

/// What an operation found.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Findings {
    /// How the second map was aligned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alignment: Option<Aligned>,
    /// Merged voxels that are at the weight's limit: a mean of all maps, but not the bits that fusing would give.
    pub limited_voxels: Option<u64>,
    /// Whether the motion only renumbered voxels.
    pub exact: Option<bool>,
    /// What was wrong with a repaired map.
    pub damage: Option<Damage>,
}

/// How a map lies in the frame of another one.
#[derive(Clone, Debug, Serialize)]
pub struct Aligned {
    /// The row-major 3×4 matrix.
    pub first_from_second: [f64; 12],
    /// Places along the second map's way that were looked for in the first.
    pub places: usize,
    /// Of these, those that were recognised and agree.
    pub agreeing: usize,
    /// Those that were recognised, and say something else.
    pub contradicting: usize,
    /// Root mean square of distances between both surfaces where both are, metres.
    pub rms_m: f64,
    /// Share of the second surface that lies where the first map has one.
    pub common: f64,
}

impl From<Alignment> for Aligned {
    fn from(alignment: Alignment) -> Self {
        Self {
            first_from_second: alignment.pose.to_row_major_3x4(),
            places: alignment.places,
            agreeing: alignment.agreeing,
            contradicting: alignment.contradicting,
            rms_m: alignment.rms_m,
            common: alignment.common,
        }
    }
}

/// A map, the poses of its scans, and what is to be said of it.
type Made = (VoxelMap, Vec<FusedPose>, Findings);

impl Operation {
    /// The maps that are read.
    pub fn inputs(&self) -> Vec<&Path> {
        match self {
            Self::Merge { maps } => maps.iter().map(PathBuf::as_path).collect(),
            Self::Align { first, second } => vec![first, second],
            Self::Crop { map, .. }
            | Self::Resample { map, .. }
            | Self::Transform { map, .. }
            | Self::Repair { map } => vec![map],
        }
    }

    /// Makes the map and saves it, and does the same to the layers that lie beside all of the maps. Of a repaired map these are left alone,
    /// since they may be whole; resampled and aligned maps have none.
    ///
    /// # Errors
    /// [`RunError::Config`] for an empty box, or a store where a map is wanted; otherwise names the map and what is wrong with it.
    pub fn write(&self, output: &Path) -> Result<Operated> {
        let (map, poses, findings) = self.make()?;
        let start = Instant::now();
        map_file::write_with_poses(output, &map, &poses)?;
        let saved_map = SavedMap::written(output, start);
        let mut layers = Vec::new();
        for name in layer::NAMES {
            let inputs = self.inputs();
            if !inputs.iter().all(|path| layer::path_beside(path, name).is_file()) {
                continue;
            }
            let Some(same) = self.of_layer(name) else { break };
            let path = layer::path_beside(output, name);
            map_file::write_with_poses(&path, &same.make()?.0, &[])?;
            layers.push(path);
        }
        Ok(Operated {
            map: MapReport::of(&map),
            saved_map,
            findings,
            layers,
        })
    }

    /// The same for the layers of this name beside the maps, if it makes sense for layers.
    fn of_layer(&self, name: &str) -> Option<Self> {
        let beside = |path: &PathBuf| layer::path_beside(path, name);
        match self {
            Self::Merge { maps } => Some(Self::Merge {
                maps: maps.iter().map(beside).collect(),
            }),
            &Self::Crop { ref map, low, high } => Some(Self::Crop {
                map: beside(map),
                low,
                high,
            }),
            &Self::Transform { ref map, new_from_old } => Some(Self::Transform {
                map: beside(map),
                new_from_old,
            }),
            Self::Resample { .. } | Self::Align { .. } | Self::Repair { .. } => None,
        }
    }

    fn make(&self) -> Result<Made> {
        match self {
            Self::Merge { maps } => merged(maps),
            Self::Crop { map, low, high } => {
                let (map, poses) = read_map(map)?;
                // Scans from outside of the box have seen what is in it.
                Ok((
                    map.cropped(*low, *high).map_err(RunError::config)?,
                    poses,
                    Findings::default(),
                ))
            }
            Self::Resample { map, voxel_size_m } => {
                let (old, poses) = read_map(map)?;
                let resampled = old.resampled(*voxel_size_m).map_err(wrong(map))?;
                Ok((resampled, poses, Findings::default()))
            }
            Self::Transform { map, new_from_old } => moved(map, read_map(map)?, new_from_old),
            Self::Align { first, second } => aligned(first, second),
            Self::Repair { map } => repaired(map),
        }
    }
}

/// What is wrong with a map, which it names.
fn wrong(path: &Path) -> impl FnOnce(MapError) -> RunError {
    move |error| Error::dataset(path, error.to_string()).into()
}

/// The first map, with the blocks of the others added as they are read, and the poses of all, one map after the other.
fn merged(paths: &[PathBuf]) -> Result<Made> {
    let (first, others) = paths.split_first().ok_or_else(|| RunError::config("maps are wanted"))?;
    let (mut map, mut poses) = read_map(first)?;
    let mut limited = 0;
    for path in others {
        let reader = Reader::open(path)?;
        let both = PathBuf::from(format!("{} and {}", first.display(), path.display()));
        map.config().check_same(reader.config()).map_err(wrong(&both))?;
        limited += add(&mut map, &mut poses, reader, drop)?;
    }
    let findings = Findings {
        limited_voxels: Some(limited),
        ..Findings::default()
    };
    Ok((map, poses, findings))
}

/// A map that was moved, with the poses of its scans.
fn moved(path: &Path, (map, mut poses): (VoxelMap, Vec<FusedPose>), new_from_old: &Pose) -> Result<Made> {
    let (map, exact) = map.transformed(new_from_old).map_err(wrong(path))?;
    move_poses(&mut poses, new_from_old);
    let findings = Findings {
        exact: Some(exact),
        ..Findings::default()
    };
    Ok((map, poses, findings))
}

/// The second map in the frame of the first.
fn aligned(first: &Path, second: &Path) -> Result<Made> {
    let refused = |path: &Path, reason: String| RunError::from(Error::dataset(path, reason));
    let mapped = |path: &Path| {
        let (map, poses) = read_map(path)?;
        if poses.is_empty() {
            let reason = "does not tell the poses of its scans, along which places are looked for";
            return Err(refused(path, reason.to_owned()));
        }
        let mapped = Mapped {
            surface: tsdfuse::mesh::extract(&map)?.vertices,
            poses: poses.iter().map(|fused| fused.pose).collect(),
        };
        Ok((map, poses, mapped))
    };
    let (_, _, there) = mapped(first)?;
    let (map, poses, own) = mapped(second)?;
    let alignment = tsdfuse_loops::align(&there, &own).ok_or_else(|| {
        let reason = format!(
            "too few places of it were recognised in {}, or they disagree: the map was not moved",
            first.display()
        );
        refused(second, reason)
    })?;
    let (map, poses, findings) = moved(second, (map, poses), &alignment.pose)?;
    let findings = Findings {
        alignment: Some(alignment.into()),
        ..findings
    };
    Ok((map, poses, findings))
}

/// What is intact of a map or a store.
fn repaired(path: &Path) -> Result<Made> {
    let (map, poses, damage) = if tsdfuse_store::recognises(path) {
        let salvage = Salvage::scan(path)?;
        let damage = Damage {
            places: salvage.damage().places.clone(),
            lost_blocks: salvage.damage().lost.as_ref().map(|(_, blocks)| *blocks),
        };
        (salvage.map()?, salvage.poses().to_vec(), damage)
    } else {
        let map_file::Repaired { map, poses, damage } = map_file::repair(path)?;
        (map, poses, damage)
    };
    let findings = Findings {
        damage: Some(damage),
        ..Findings::default()
    };
    Ok((map, poses, findings))
}
