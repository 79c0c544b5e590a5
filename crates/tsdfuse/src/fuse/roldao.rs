//! Local planes in adaptive neighbourhoods (Roldão et al. 2019), thesis 4.3: every voxel takes its distance to the plane through
//! the points around it.
//!
//! Points are summed up in cells of the voxel size, whose corners are the voxel centres (vertices v). Level k of a
//! vertex is the (2k)³ cells around it; k* is the first level of 1…k_max that decides the vertex:
//!
//! | | |
//! |---|---|
//! | which voxels | at least N_min points in level k (4.4), whose Gaussian in the plane has density ≥ τ at the projection of v (4.6); within μ of the plane |
//! | distance | n·(v − mean)/μ (4.7), where n is e₃ of the covariance of the points, facing the sensor (4.5) |
//! | weight | 1 |
//!
//! In the paper's form, [`RoldaoForm::Batch`], the points of all scans are summed up before planes are fitted. The map is written by
//! [`Integrator::finish`], with the same bits however the points were split into scans. Until then, a scan costs little time, and
//! each occupied cell 64 bytes (a block of 8³ cells some 200 more). It needs all points in memory, so it can neither be paged nor
//! resumed. [`RoldaoForm::Streaming`] is a variant of ours: planes are fitted to each scan by itself, and the map averages their
//! distances.
//!
//! Strong where points are dense: distances are point-to-plane, so grazing incidence does no harm; noise is averaged; and gaps
//! between the scan lines are covered as far as the Gaussian reaches. Weak on thin parts and at edges, where the points of two
//! surfaces make one plane. The streaming form is also weak on single scans with rings far apart: the points of one ring lie on a
//! line, and only the range noise spreads them across it. Their plane then contains the sensor, has any tilt, and faces either
//! way, so that ground and upper facades become litter. `min_spread_m` above the noise leaves such planes out, which leaves holes.
//!
//! A return counts as fused once it is summed up, whether or not it ends up in a plane.

mod adaptive;
mod cells;
mod near;
mod plane;

use std::{ops::Range, time::Instant};

use glam::IVec3;
use serde::{Deserialize, Serialize};

use self::{adaptive::Adaptive, cells::Cells, near::MAX_LEVEL};
use super::{
    FuseError, Integration, Integrator,
    gather::{Gather, Items, Near},
    placed::Placed,
};
use crate::{
    index::BlockIndex,
    map::{MapConfig, VoxelMap},
    reach::Reach,
    scan::Scan,
};

/// Which points planes are fitted to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RoldaoForm {
    /// The points of all scans together, after the last scan ([`Integrator::finish`]): the paper's form.
    #[default]
    Batch,
    /// The points of one scan at a time; the map averages the distances of all scans. A variant of ours, which also goes by its
    /// former name `scan`.
    #[serde(alias = "scan")]
    Streaming,
}

/// Options of [`Roldao`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoldaoConfig {
    /// Which form.
    pub form: RoldaoForm,
    /// N_min (4.4): fewer points in a neighbourhood make no plane. At least 3.
    pub min_points: u32,
    /// k_max: the largest neighbourhood is 2·k_max cells wide. 1 to 8.
    pub max_level: usize,
    /// τ (4.6), per κ² where κ is the voxel size, so that it fits voxels of any size. 0.03 at 5 cm is 12 per m². Points spread
    /// evenly over level k have a density of 0.48/k² in the middle, 0.21/k² at the middle of an edge and 0.09/k² at a corner.
    pub min_density: f64,
    /// Points whose second largest standard deviation is smaller than this span no plane. A value above the range noise leaves
    /// out single scan lines, which have no normal of their own. 0 as in the paper.
    pub min_spread_m: f64,
}

impl Default for RoldaoConfig {
    /// Few points and few levels: they give the most surface within 5 cm and the smallest error on sweeps of 64 and 128 beams.
    /// A third level closes more gaps and rounds edges.
    fn default() -> Self {
        Self {
            form: RoldaoForm::default(),
            min_points: 5,
            max_level: 2,
            min_density: 0.03,
            min_spread_m: 0.0,
        }
    }
}

impl RoldaoConfig {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`FuseError::Config`] names the field and what is possible.
    pub fn validate(&self) -> Result<(), FuseError> {
        let wrong = |reason: String| Err(FuseError::Config(reason));
        if !(3..=1 << 20).contains(&self.min_points) {
            return wrong(format!(
                "roldao.min_points must be 3 to 1048576, not {}",
                self.min_points
            ));
        }
        if !(1..=MAX_LEVEL).contains(&self.max_level) {
            return wrong(format!(
                "roldao.max_level must be 1 to {MAX_LEVEL}, not {}",
                self.max_level
            ));
        }
        for (name, value) in [("min_density", self.min_density), ("min_spread_m", self.min_spread_m)] {
            if !(value >= 0.0 && value.is_finite()) {
                return wrong(format!("roldao.{name} must be 0 or more, not {value}"));
            }
        }
        Ok(())
    }
}

/// The integrator with planes from adaptive neighbourhoods.
#[derive(Debug, Default)]
pub struct Roldao {
    config: RoldaoConfig,
    placed: Placed,
    cells: Cells,
    gather: Gather<u32>,
}

impl Roldao {
    /// With the given options.
    pub fn new(config: RoldaoConfig) -> Self {
        Self {
            config,
            ..Self::default()
        }
    }

    /// Updates the map with the planes fitted to the points in the cells.
    fn write(&mut self, map: &mut VoxelMap) -> Integration {
        let adaptive = Adaptive::new(
            (self.config.min_points, self.config.max_level),
            (self.config.min_spread_m, self.config.min_density),
            map.config(),
        );
        let blocks = self.cells.blocks();
        let reach = self.config.max_level as i32;
        let name = |i: usize, near: &mut Near<u32>| {
            let (BlockIndex(block), cells) = blocks[i];
            // Cell j lies in the neighbourhoods of vertices j − reach … j + reach − 1.
            let (low, high) = cells.bounds();
            let first: IVec3 = block + ((low - reach) >> 3);
            let last: IVec3 = block + ((high + (reach - 1)) >> 3);
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    for x in first.x..=last.x {
                        near.block(BlockIndex(IVec3::new(x, y, z)), i as u32, i as u32);
                    }
                }
            }
        };
        let name = |range: Range<usize>, near: &mut Near<u32>| range.for_each(|i| name(i, near));
        let blocks_about = |block, named: &Items<'_, u32>, updates: &mut _| {
            let cells = named.iter().map(|&i| blocks[i as usize]);
            adaptive.update(block, cells, updates);
        };
        self.gather.run(map, blocks.len(), name, |_| false, blocks_about)
    }
}

impl Integrator for Roldao {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        self.placed.place(map.grid(), scan)?;
        if self.config.form == RoldaoForm::Streaming {
            self.cells.clear();
        }
        let fused_returns = self.cells.add(&self.placed, map.config().voxel_size_m);
        let prepare_secs = start.elapsed().as_secs_f64();
        let mut done = match self.config.form {
            RoldaoForm::Streaming => self.write(map),
            RoldaoForm::Batch => Integration::default(),
        };
        done.fused_returns = fused_returns;
        done.skipped.outside_grid = self.placed.len() as u64 - fused_returns;
        done.prepare_secs = prepare_secs;
        Ok(done)
    }

    fn finish(&mut self, map: &mut VoxelMap) -> Integration {
        match self.config.form {
            RoldaoForm::Streaming => Integration::default(),
            RoldaoForm::Batch => {
                let done = self.write(map);
                self.cells = Cells::default();
                // The engine counts blocks of cells; returns were counted scan by scan.
                Integration {
                    fused_returns: 0,
                    ..done
                }
            }
        }
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        false
    }
}
