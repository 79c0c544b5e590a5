//! Numbers of a surface, averaged in voxels beside those of a map.
//!
//! A layer is a [`VoxelMap`] of its own on the map's grid. Where voxels of a map hold a distance over the truncation, f ∈ [−1, 1], its
//! voxels hold a number that somebody else encodes. All else is as for any map: sums of integers that do not depend on order, files,
//! merging, cropping. The map itself, and its bits, stay as they are.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::map::VoxelUpdate;
use tsdfuse::{MapConfig, Mesh, VoxelMap};

use crate::error::{Result, RunError};

/// Truncation of a layer, in voxels: it only scales f, but must be one that a map may have.
const TRUNCATION_VOXELS: f64 = 16.0;

/// Voxels farther from a point than this do not count for it.
const REACH_VOXELS: f64 = 1.6;

/// Vertices of which nothing is known take the mean of their neighbours, so many times.
const FILL_ROUNDS: usize = 12;

/// Names of all layers, as they stand in files' names.
pub const NAMES: [&str; 4] = ["intensity", "red", "green", "blue"];

/// The file of a layer beside that of a map: `street.tsdf` has `street.intensity.tsdf`.
pub fn path_beside(map: &Path, name: &str) -> PathBuf {
    let stem = map.file_stem().unwrap_or_default().to_string_lossy();
    map.with_file_name(format!("{stem}.{name}.tsdf"))
}

/// A number for each voxel near the surface.
#[derive(Debug)]
pub(crate) struct Layer(VoxelMap);

impl Layer {
    /// Without observations, beside a map.
    ///
    /// # Errors
    /// As [`VoxelMap::new`].
    pub(crate) fn beside(map: &MapConfig) -> Result<Self> {
        let config = MapConfig {
            truncation_m: TRUNCATION_VOXELS * map.voxel_size_m,
            ..*map
        };
        Ok(Self(VoxelMap::new(config)?))
    }

    /// Reads a layer.
    ///
    /// # Errors
    /// As [`tsdfuse_io::map_file::read`]; [`RunError::Config`] for a map that is no such layer.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let map = tsdfuse_io::map_file::read(path)?;
        let MapConfig {
            truncation_m,
            voxel_size_m,
            ..
        } = map.config();
        if (truncation_m / voxel_size_m - TRUNCATION_VOXELS).abs() > 1e-6 {
            return Err(RunError::config(format_args!(
                "{}: is a map, not a layer beside one",
                path.display()
            )));
        }
        Ok(Self(map))
    }

    /// Saves the layer as a map file.
    pub(crate) fn save(&self, path: &Path) -> Result<()> {
        Ok(tsdfuse_io::map_file::write(path, &self.0)?)
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.0.memory_bytes()
    }

    /// Notes how many scans it holds.
    pub(crate) fn set_scans(&mut self, scans: usize) {
        self.0.set_integrations(scans as u32);
    }

    /// How many scans it holds, as far as that was noted.
    pub(crate) fn scans(&self) -> usize {
        self.0.integrations() as usize
    }

    /// Averages more numbers: where (world), f, and their weights.
    pub(crate) fn add(&mut self, values: impl IntoIterator<Item = (DVec3, f32, f32)>) -> Result<()> {
        let truncation_m = self.0.config().truncation_m as f32;
        let grid = self.0.grid();
        let updates = values.into_iter().filter_map(|(point, value, weight)| {
            let (voxel, _) = grid.anchor(point)?.split();
            Some(VoxelUpdate {
                voxel,
                distance_m: value * truncation_m,
                weight,
            })
        });
        self.0
            .update(updates)
            .map(drop)
            .map_err(|error| RunError::Full(error.to_string()))
    }

    /// Numbers of some voxels, spread over the layer.
    pub(crate) fn some(&self, count: usize) -> Vec<f32> {
        let blocks = self.0.block_indices();
        let step = blocks.len() * 512 / count.max(1) + 1;
        let voxels = blocks
            .iter()
            .filter_map(|block| self.0.block(*block))
            .flat_map(|block| block.voxels.iter());
        voxels
            .filter_map(|voxel| voxel.distance())
            .step_by(step.div_ceil(8))
            .collect()
    }

    /// The mean of the voxels around a point (world), f; `None` where nothing was measured.
    pub(crate) fn at(&self, point: DVec3) -> Option<f32> {
        let (voxel, fraction) = self.0.grid().anchor(point)?.split();
        let (mut sum, mut weights) = (0.0, 0.0);
        for z in -1..=1 {
            for y in -1..=1 {
                for x in -1..=1 {
                    let offset = IVec3::new(x, y, z);
                    let voxel = self.0.voxel(voxel + offset);
                    let far = (offset.as_dvec3() + 0.5 - fraction).length();
                    if let Some(f) = voxel.distance().filter(|_| far < REACH_VOXELS) {
                        let weight = voxel.weight() * (1.0 - far / REACH_VOXELS) as f32;
                        (sum, weights) = (sum + f * weight, weights + weight);
                    }
                }
            }
        }
        (weights > 0.0).then(|| sum / weights)
    }

    /// [`Self::at`] each vertex. Where nothing was measured, the mean of the vertices around; NaN if there is none within a few.
    pub(crate) fn of_vertices(&self, mesh: &Mesh) -> Vec<f32> {
        let at = |vertex: &DVec3| self.at(*vertex).unwrap_or(f32::NAN);
        let mut values: Vec<f32> = mesh.vertices.par_iter().map(at).collect();
        for _ in 0..FILL_ROUNDS {
            let mut sums = vec![(0.0_f32, 0.0_f32); values.len()];
            let mut add = |to: u32, from: u32| {
                let value = values[from as usize];
                if values[to as usize].is_nan() && !value.is_nan() {
                    let sum = &mut sums[to as usize];
                    *sum = (sum.0 + value, sum.1 + 1.0);
                }
            };
            for &[a, b, c] in &mesh.triangles {
                [(a, b), (a, c), (b, a), (b, c), (c, a), (c, b)]
                    .into_iter()
                    .for_each(|(to, from)| add(to, from));
            }
            let mut is_done = true;
            for (value, (sum, count)) in values.iter_mut().zip(sums).filter(|(_, (_, count))| *count > 0.0) {
                (*value, is_done) = (sum / count, false);
            }
            if is_done {
                break;
            }
        }
        values
    }

    #[cfg(test)]
    pub(crate) fn map(&self) -> &VoxelMap {
        &self.0
    }

    #[cfg(test)]
    pub(crate) fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0).unwrap();
    }
}
