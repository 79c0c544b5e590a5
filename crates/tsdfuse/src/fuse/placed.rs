//! Returns placed in the world: motion undone, every return with the ray it was measured along.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::FuseError;
use crate::{
    index::{Anchor, BLOCK_EDGE, Grid, GridPoint, REGION_SHIFT, hash, round},
    scan::Scan,
};

/// The returns of one scan, with motion undone: in world axes, relative to the scan's anchor (the sensor's position at the scan's pose),
/// metres. Keep it from scan to scan: it keeps its buffers.
#[derive(Debug, Default)]
pub struct Placed {
    anchor: Option<Anchor>,
    /// End of each ray.
    pub(crate) points: Vec<Vec3>,
    /// Start of each ray; empty if all start at the anchor.
    pub(crate) origins: Vec<Vec3>,
    /// The order of all returns, once they are sorted.
    pub(crate) order: Order,
}

/// The numbers of some points, neighbours in the world mostly one after the other.
#[derive(Debug, Default)]
pub(crate) struct Order {
    pub(crate) numbers: Vec<u32>,
    cells: Vec<u16>,
}

/// One return as the methods see it: the ray that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredRay {
    /// Where the ray ended.
    pub end: GridPoint,
    /// Unit vector from the sensor to the return, world axes.
    pub direction: Vec3,
    /// Distance from the sensor, at the time of the return.
    pub range_m: f32,
}

/// Regions that a scan is sorted into, and cells of all of them.
const REGIONS: i32 = 1 << 7;
const CELLS: usize = (REGIONS as usize) << 6;

/// The cell of what is not sorted.
const LEFT_OUT: u16 = u16::MAX;

impl Placed {
    /// Places all returns of a scan in a grid, in place of those that were there, and returns the scan's anchor.
    ///
    /// # Errors
    /// [`FuseError`] if the scan contradicts itself or its sensor is outside of the grid.
    pub fn place(&mut self, grid: Grid, scan: &Scan) -> Result<Anchor, FuseError> {
        scan.check()?;
        let pose = scan.world_from_sensor()?;
        let position = pose.translation;
        let anchor = grid.anchor(position).ok_or_else(|| FuseError::OutsideGrid {
            scan: scan.name.clone(),
            position,
        })?;
        self.anchor = Some(anchor);
        self.origins.clear();
        match (scan.sweep(), &scan.times) {
            (Some(sweep), Some(times)) => {
                let placed = scan.points.par_iter().zip(times).map(|(point, &secs)| {
                    let (rotation, shift) = sweep.relative_at(f64::from(secs));
                    ((rotation * point.as_dvec3() + shift).as_vec3(), shift.as_vec3())
                });
                placed.unzip_into_vecs(&mut self.points, &mut self.origins);
            }
            _ => {
                let rotation = glam::DMat3::from_quat(pose.rotation);
                scan.points
                    .par_iter()
                    .map(|p| (rotation * p.as_dvec3()).as_vec3())
                    .collect_into_vec(&mut self.points);
            }
        }
        Ok(anchor)
    }

    /// Sorts the placed returns, for [`Self::sorted`].
    pub fn sort(&mut self, grid: Grid) {
        if let Some(anchor) = self.anchor {
            let points = &self.points;
            self.order.sort(grid, anchor, points.len(), |i| Some(points[i]));
        }
    }

    /// The numbers of all returns, neighbours in the world mostly one after the other; after [`Self::sort`].
    pub fn sorted(&self) -> &[u32] {
        &self.order.numbers
    }

    /// The returns' positions.
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Where the scan is anchored, once returns are placed.
    pub fn anchor(&self) -> Option<Anchor> {
        self.anchor
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The number of returns.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// The sensor's position when it measured a return.
    #[inline(always)]
    pub fn origin(&self, i: usize) -> Vec3 {
        self.origins.get(i).copied().unwrap_or(Vec3::ZERO)
    }

    /// The ray of one return; `None` if it is invalid or outside the grid.
    #[inline(always)]
    pub fn ray(&self, i: usize) -> Option<MeasuredRay> {
        let point = self.points[i];
        let along = point - self.origin(i);
        let range_m = along.length();
        // Also false for NaN.
        if !(range_m > 0.0 && range_m < f32::MAX) {
            return None;
        }
        let end = self.anchor?.locate(point)?;
        Some(MeasuredRay {
            end,
            direction: along / range_m,
            range_m,
        })
    }
}

impl Order {
    /// Orders things that have a place by the regions of their places, and within these by cells of 2³ blocks, which a counting sort takes in any
    /// order (and some as one).
    pub(crate) fn sort(&mut self, grid: Grid, anchor: Anchor, count: usize, at: impl Fn(usize) -> Option<Vec3> + Sync) {
        let (voxel, fraction) = anchor.split();
        let cell_edge = (2 * BLOCK_EDGE) as f32;
        let scale = (1.0 / grid.voxel_size_m()) as f32 / cell_edge;
        // Within the anchor's region; rounding may move a return at a border to the next cell.
        let start = ((voxel & ((1 << REGION_SHIFT) - 1)).as_vec3() + fraction.as_vec3()) / cell_edge - 0.5;
        let cell = |p: Vec3| {
            let c = p * scale + start;
            let c = IVec3::new(round(c.x), round(c.y), round(c.z));
            let region: IVec3 = c >> 2;
            let within = c & 3;
            ((hash(region) & (REGIONS - 1)) << 6 | within.x | within.y << 2 | within.z << 4) as u16
        };
        (0..count)
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| at(i).map_or(LEFT_OUT, cell))
            .collect_into_vec(&mut self.cells);
        let mut starts = [0; CELLS + 1];
        let mut sorted = 0;
        for &cell in self.cells.iter().filter(|cell| **cell != LEFT_OUT) {
            starts[usize::from(cell) + 1] += 1;
            sorted += 1;
        }
        (0..CELLS).for_each(|c| starts[c + 1] += starts[c]);
        self.numbers.clear();
        self.numbers.resize(sorted, 0);
        for (i, &cell) in (0..).zip(&self.cells).filter(|(_, cell)| **cell != LEFT_OUT) {
            let next = &mut starts[usize::from(cell)];
            self.numbers[*next] = i;
            *next += 1;
        }
    }
}
