//! The cells of a map that a scan may change.

use glam::IVec3;
use pyo3::prelude::*;
use rayon::prelude::*;
use tsdfuse::index::{Grid, RegionIndex};

use crate::error::wrong;

/// Blocks along the edge of a region, as a shift.
pub(crate) const REGION_SHIFT: u32 = 3;

/// Regions along the edge of the cubes that surfaces are extracted by: a cell is made of whole ones.
pub(crate) const CUBE: i32 = 4;

/// Checks the edge of a cell, in regions: of a power of two, so that its tiles end where it ends, at each level.
pub(crate) fn check_edge(edge: i32) -> PyResult<()> {
    if edge >= CUBE && edge.count_ones() == 1 {
        return Ok(());
    }
    Err(wrong(format_args!(
        "the edge of a cell must be {CUBE} regions or a larger power of two, not {edge}"
    )))
}

/// The cell of a region.
pub(crate) fn cell_of(RegionIndex(region): RegionIndex, edge: i32) -> IVec3 {
    region.div_euclid(IVec3::splat(edge))
}

/// Ordered by z, then y, then x.
pub(crate) fn key(cell: IVec3) -> [i32; 3] {
    [cell.z, cell.y, cell.x]
}

/// The part of a map that a scan may change.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Reach {
    reach: tsdfuse::Reach,
    grid: Grid,
}

impl Reach {
    pub(crate) fn of(reach: tsdfuse::Reach, grid: Grid) -> Self {
        Self { reach, grid }
    }
}

#[pymethods]
impl Reach {
    /// The cells, of so many regions along each edge, that the scan may change.
    fn cells(&self, py: Python<'_>, edge: i32) -> PyResult<Vec<[i32; 3]>> {
        check_edge(edge)?;
        Ok(py.detach(|| {
            let edge_m = f64::from(edge << (2 * REGION_SHIFT)) * self.grid.voxel_size_m();
            // More than the slack of any method.
            let radius_m = 1.2 * f64::from(self.reach.farthest_m()) + 64.0 * self.grid.voxel_size_m() + 10.0;
            let low = ((self.reach.center - radius_m) / edge_m).floor().as_ivec3();
            let high = ((self.reach.center + radius_m) / edge_m).floor().as_ivec3();
            let along = |low: i32, high: i32| low..=high;
            let cells: Vec<IVec3> = along(low.z, high.z)
                .flat_map(|z| along(low.y, high.y).map(move |y| (y, z)))
                .flat_map(|(y, z)| along(low.x, high.x).map(move |x| IVec3::new(x, y, z)))
                .collect();
            let touched = |cell: &IVec3| {
                let within = || 0..edge;
                within().any(|z| {
                    within().any(|y| {
                        within().any(|x| {
                            self.reach
                                .touches(RegionIndex(*cell * edge + IVec3::new(x, y, z)), self.grid)
                        })
                    })
                })
            };
            cells
                .into_par_iter()
                .filter(touched)
                .map(|cell| cell.to_array())
                .collect()
        }))
    }

    /// The range of the farthest return, metres.
    #[getter]
    fn farthest(&self) -> f32 {
        self.reach.farthest_m()
    }
}
