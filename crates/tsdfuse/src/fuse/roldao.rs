//! Local planes from an adaptive neighbourhood (Roldão et al. 2019), thesis 4.3.
mod cells;
mod near;
mod plane;

use std::{array, cell::RefCell, time::Instant};

use glam::{DVec3, IVec3};
use serde::{Deserialize, Serialize};

use self::{
    cells::{CellBlock, Cells},
    near::{Around, MAX_LEVEL, Sums},
    plane::{LANES, Limits, Neighbourhoods},
};
use super::{
    FuseError, Integration, Integrator,
    gather::{Gather, Updates},
    placed::Placed,
};
use crate::{
    index::{BLOCK_EDGE, BlockIndex},
    map::VoxelMap,
    scan::Scan,
};

/// What planes are fitted to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// The points of one scan; the map averages the distances of all scans.
    #[default]
    Scan,
    /// The points of all scans together, when the last one has come ([`Integrator::finish`]).
    Batch,
}

/// Options of [`Roldao`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoldaoConfig {
    /// Which form.
    pub form: Form,
    /// N_min (4.4): fewer points in a neighbourhood make no plane. At least 3.
    pub min_points: u32,
    /// k_max: the largest neighbourhood has 2·k_max cells along an edge. 1 to 8.
    pub max_level: usize,
    /// τ (4.6), per m².
    pub min_density: f64,
    /// Points whose second largest standard deviation is less than this span no plane: more than the noise of ranges leaves
    /// out single scan lines, which have no normal of their own. 0: the paper's form.
    pub min_spread_m: f64,
}

impl Default for RoldaoConfig {
    fn default() -> Self {
        Self {
            form: Form::default(),
            min_points: 8,
            max_level: 4,
            min_density: 2.0,
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
    gather: Gather,
}

impl Roldao {
    /// With the given options.
    pub fn new(config: RoldaoConfig) -> Self {
        Self {
            config,
            ..Self::default()
        }
    }

    /// Updates the map by the planes through the points in the cells.
    fn write(&mut self, map: &mut VoxelMap) -> Integration {
        let reach = self.config.max_level;
        let voxel_size_m = map.config().voxel_size_m;
        let method = Method {
            config: &self.config,
            truncation: map.config().truncation_vox(),
            limits: Limits {
                min_density: (self.config.min_density * voxel_size_m * voxel_size_m) as f32,
                min_spread: ((self.config.min_spread_m / voxel_size_m) as f32).max(LEAST_SPREAD),
            },
        };
        let blocks = self.cells.blocks();
        let name = |i: usize, near: &mut super::gather::Near| {
            let (BlockIndex(block), cells) = blocks[i];
            let (low, high) = cells.bounds();
            let first: IVec3 = block + ((low - reach as i32) >> 3);
            let last: IVec3 = block + ((high + reach as i32 - 1) >> 3);
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    for x in first.x..=last.x {
                        near.block(BlockIndex(IVec3::new(x, y, z)), i as u32);
                    }
                }
            }
            Ok(())
        };
        self.gather.run(
            map,
            blocks.len(),
            name,
            |_| false,
            |block, named, updates| {
                SCRATCH.with_borrow_mut(|scratch| {
                    let items = named.iter().map(|&(_, i)| blocks[i as usize]);
                    method.update(block, items, scratch, updates);
                });
            },
        )
    }
}

impl Integrator for Roldao {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        self.placed.place(map.grid(), scan)?;
        if self.config.form == Form::Scan {
            self.cells.clear();
        }
        let fused_returns = self.cells.add(&self.placed, map.config().voxel_size_m);
        let prepare_secs = start.elapsed().as_secs_f64();
        let mut done = match self.config.form {
            Form::Scan => self.write(map),
            Form::Batch => Integration::default(),
        };
        done.fused_returns = fused_returns;
        done.skipped.outside_grid = self.placed.len() as u64 - fused_returns;
        done.prepare_secs = prepare_secs;
        Ok(done)
    }

    fn finish(&mut self, map: &mut VoxelMap) -> Integration {
        match self.config.form {
            Form::Scan => Integration::default(),
            Form::Batch => {
                let done = self.write(map);
                self.cells = Cells::default();
                Integration {
                    fused_returns: 0,
                    ..done
                }
            }
        }
    }
}

/// Below this, in voxels, a spread is rounding: the points lie on a line.
const LEAST_SPREAD: f32 = 0.01;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Buffers for one block, kept by each thread.
#[derive(Debug, Default)]
struct Scratch {
    sums: Sums,
    queue: Vec<(u8, u8, [usize; 4])>,
}

struct Method<'a> {
    config: &'a RoldaoConfig,
    truncation: f32,
    limits: Limits,
}

impl Method<'_> {
    fn update<'c>(
        &self,
        block: BlockIndex,
        items: impl Iterator<Item = (BlockIndex, &'c CellBlock)>,
        scratch: &mut Scratch,
        updates: &mut Updates,
    ) {
        const EDGE: usize = BLOCK_EDGE as usize;
        let Scratch { sums, queue } = scratch;
        let &RoldaoConfig {
            min_points, max_level, ..
        } = self.config;
        let around = Around::new(block, items, max_level);
        if !around.has(min_points) {
            return;
        }
        sums.count(&around);
        // The vertices with enough points in the largest neighbourhood: a bit for each x, by rows.
        let mut undecided: [u8; EDGE * EDGE] = array::from_fn(|row| {
            let rows = sums.rows(max_level, row % EDGE, row / EDGE);
            rows.map_or(0, |rows| sums.crowded(max_level, rows, min_points as i32))
        });
        if undecided == [0; EDGE * EDGE] {
            return;
        }
        sums.sum(&around);
        let mut neighbourhoods = Neighbourhoods::default();
        for k in 1..=max_level {
            queue.clear();
            for (number, left) in undecided.iter().enumerate().filter(|(_, left)| **left != 0) {
                let Some(rows) = sums.rows(k, number % EDGE, number / EDGE) else {
                    continue;
                };
                let mut bits = left & sums.crowded(k, rows, min_points as i32); // (4.4)
                while bits != 0 {
                    queue.push((bits.trailing_zeros() as u8, number as u8, rows));
                    bits &= bits - 1;
                }
            }
            for vertices in queue.chunks(LANES) {
                for (lane, &(x, row, rows)) in vertices.iter().enumerate() {
                    let vertex = DVec3::new(f64::from(x), f64::from(row % 8), f64::from(row / 8)) - 3.5;
                    neighbourhoods.set(lane, &sums.moments(k, x.into(), rows), vertex);
                }
                let planes = neighbourhoods.planes(&self.limits);
                for (lane, &(x, row, rows)) in vertices.iter().enumerate() {
                    if planes.accepted >> lane & 1 == 0 {
                        continue;
                    }
                    undecided[usize::from(row)] &= !(1 << x);
                    let (normal, distance) = planes.plane(lane);
                    if distance.abs() > self.truncation {
                        continue;
                    }
                    let facing = match around.side(normal) {
                        0 => normal.as_dvec3().dot(sums.towards(&around, k, x.into(), rows)) > 0.0, // (4.5)
                        side => side > 0,
                    };
                    let distance = if facing { distance } else { -distance };
                    updates.add(
                        usize::from(row) * EDGE + usize::from(x),
                        distance / self.truncation,
                        1.0,
                    );
                }
            }
        }
    }
}
