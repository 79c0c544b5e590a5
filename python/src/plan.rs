//! What planners ask: distances to the surface, free space, which returns move, the ground.

use std::sync::{Mutex, MutexGuard, PoisonError, RwLock};

use glam::{DVec2, DVec3, IVec3};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tsdfuse::mesh::{MeshConfig, Surface, extract};
use tsdfuse::raster::Raster;
use tsdfuse_plan::occupancy::State;
use tsdfuse_plan::{EsdfConfig, GroundConfig, GroundGrid, MovingConfig, OccupancyConfig};

use crate::arrays::{IntoRows, Rows};
use crate::error::{OrRaise, wrong};
use crate::map::{Changes, Map, Nearby};
use crate::piece::OwnPiece;
use crate::scan::Scan;

/// Euclidean distances to the nearest surface, which follow a map.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Esdf(RwLock<tsdfuse_plan::Esdf>);

#[pymethods]
impl Esdf {
    #[new]
    #[pyo3(signature = (voxel_size=0.2, radius=2.0))]
    fn new(voxel_size: f64, radius: f64) -> PyResult<Self> {
        let config = EsdfConfig {
            voxel_size_m: voxel_size,
            radius_m: radius,
        };
        Ok(Self(RwLock::new(tsdfuse_plan::Esdf::new(config).map_err(wrong)?)))
    }

    /// Takes in what changed of a surface, or the whole surface of a map; how many chunks of 32³ voxels were computed anew.
    #[pyo3(signature = (surface, nearby=None))]
    fn update(&self, py: Python<'_>, surface: &Bound<'_, PyAny>, nearby: Option<PyRef<'_, Nearby>>) -> PyResult<usize> {
        let lock = || self.0.write().unwrap_or_else(PoisonError::into_inner);
        if let Ok(map) = surface.cast::<Map>() {
            let map = map.get();
            return py.detach(|| {
                let (content, mut esdf) = (map.read(), lock());
                let mut surface = Surface::new(&content.map, &MeshConfig::default());
                let mut chunks = 0;
                for cube in surface.cubes() {
                    chunks += esdf.update(surface.pieces(cube)?).len();
                }
                Ok(chunks)
            });
        }
        let changes = surface
            .cast::<Changes>()
            .map_err(|_| wrong("surface must be Changes or a Map"))?;
        let pieces = changes.get().pieces(py)?;
        let (pieces, nearby) = (pieces.iter().map(OwnPiece::as_piece), nearby.map(|nearby| nearby.get()));
        Ok(py.detach(|| match nearby {
            Some(nearby) => lock().update_near(pieces, &nearby).len(),
            None => lock().update(pieces).len(),
        }))
    }

    /// Distances, their gradients, and where they are known.
    fn distance<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
    ) -> PyResult<(
        Bound<'py, PyArray1<f32>>,
        Bound<'py, PyArray2<f32>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        let rows = Rows::<f64>::of("points", points)?;
        let points: &[DVec3] = rows.vectors()?;
        let found = py.detach(|| {
            let esdf = self.0.read().unwrap_or_else(PoisonError::into_inner);
            esdf.sample_all(points)
        });
        let distances = found
            .iter()
            .map(|nearest| nearest.map_or(f32::NAN, |nearest| nearest.distance_m));
        let gradients = found
            .iter()
            .map(|nearest| nearest.map_or(glam::Vec3::ZERO, |nearest| nearest.gradient));
        let known: Vec<bool> = found.iter().map(Option::is_some).collect();
        Ok((
            PyArray1::from_vec(py, distances.collect()),
            gradients.collect::<Vec<_>>().into_rows(py)?,
            PyArray1::from_vec(py, known),
        ))
    }

    /// All voxels within the radius of surface, and their distances.
    fn voxels<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<i32>>, Bound<'py, PyArray1<f32>>)> {
        let (voxels, distances) = py.detach(|| {
            let esdf = self.0.read().unwrap_or_else(PoisonError::into_inner);
            let (mut voxels, mut distances): (Vec<IVec3>, Vec<f32>) = Default::default();
            esdf.for_each(|voxel, distance_m| {
                voxels.push(voxel);
                distances.push(distance_m);
            });
            (voxels, distances)
        });
        Ok((voxels.into_rows(py)?, PyArray1::from_vec(py, distances)))
    }

    /// All distances as an array, and the voxel at its lowest corner.
    fn dense<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray3<f32>>, [i32; 3])> {
        let dense = py.detach(|| {
            let esdf = self.0.read().unwrap_or_else(PoisonError::into_inner);
            esdf.dense().map_err(wrong)
        })?;
        Ok((
            PyArray1::from_vec(py, dense.values).reshape(dense.size)?,
            dense.low.to_array(),
        ))
    }
}

/// Known free, occupied, unknown.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Occupancy(RwLock<tsdfuse_plan::Occupancy>);

#[pymethods]
impl Occupancy {
    #[new]
    #[pyo3(signature = (voxel_size=0.2, max_range=60.0))]
    fn new(voxel_size: f64, max_range: f64) -> PyResult<Self> {
        let config = OccupancyConfig {
            voxel_size_m: voxel_size,
            max_range_m: max_range,
        };
        Ok(Self(RwLock::new(tsdfuse_plan::Occupancy::new(config).map_err(wrong)?)))
    }

    /// Takes in the rays of a scan, which has a pose.
    fn fuse(&self, py: Python<'_>, scan: &Scan) -> PyResult<()> {
        py.detach(|| {
            let mut scan = (*scan.scan).clone();
            scan.drop_invalid(&tsdfuse::scan::RangeLimits::default());
            let mut occupancy = self.0.write().unwrap_or_else(PoisonError::into_inner);
            occupancy.integrate(&scan).map_err(wrong)
        })
    }

    /// What is known at points: 0 unknown, 1 free, 2 occupied.
    fn at<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<u8>>> {
        let rows = Rows::<f64>::of("points", points)?;
        let points: &[DVec3] = rows.vectors()?;
        let states = py.detach(|| {
            let occupancy = self.0.read().unwrap_or_else(PoisonError::into_inner);
            points.iter().map(|point| number(occupancy.at(*point))).collect()
        });
        Ok(PyArray1::from_vec(py, states))
    }

    /// All voxels that are known, and whether they are occupied.
    fn voxels<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<i32>>, Bound<'py, PyArray1<bool>>)> {
        let (voxels, occupied): (Vec<IVec3>, Vec<bool>) = py.detach(|| {
            let occupancy = self.0.read().unwrap_or_else(PoisonError::into_inner);
            occupancy
                .known()
                .map(|(voxel, state)| (voxel, state == State::Occupied))
                .unzip()
        });
        Ok((voxels.into_rows(py)?, PyArray1::from_vec(py, occupied)))
    }

    /// All that is known as an array, and the voxel at its lowest corner.
    fn dense<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray3<u8>>, [i32; 3])> {
        let (dense, values) = py.detach(|| {
            let occupancy = self.0.read().unwrap_or_else(PoisonError::into_inner);
            let dense = occupancy.dense().map_err(wrong)?;
            let values = dense.values.iter().map(|state| number(*state)).collect();
            PyResult::Ok((dense, values))
        })?;
        Ok((
            PyArray1::from_vec(py, values).reshape(dense.size)?,
            dense.low.to_array(),
        ))
    }

    /// Costs from above between two heights, row by row from the lowest y on, and the lower left corner.
    #[pyo3(signature = (low=f64::NEG_INFINITY, high=f64::INFINITY, inflate=0.0))]
    fn slice<'py>(
        &self,
        py: Python<'py>,
        low: f64,
        high: f64,
        inflate: f64,
    ) -> PyResult<(Bound<'py, PyArray2<i8>>, [f64; 2])> {
        let (slice, costs) = py.detach(|| {
            let occupancy = self.0.read().unwrap_or_else(PoisonError::into_inner);
            let nothing = || wrong(format!("nothing is known between {low} and {high} m"));
            let slice = occupancy.slice(low, high).ok_or_else(nothing)?;
            // No cost is more than 100.
            let cost = |cost: Option<u8>| cost.map_or(-1, |cost| cost as i8);
            let costs = slice.costs(inflate).into_iter().map(cost).collect();
            PyResult::Ok((slice, costs))
        })?;
        let costs = PyArray1::from_vec(py, costs).reshape([slice.height, slice.width])?;
        Ok((costs, slice.origin.to_array()))
    }

    /// Where free space meets unknown space: the middle and the voxels of each frontier, the largest first.
    #[pyo3(signature = (low=f64::NEG_INFINITY, high=f64::INFINITY, min_voxels=20))]
    fn frontiers<'py>(
        &self,
        py: Python<'py>,
        low: f64,
        high: f64,
        min_voxels: usize,
    ) -> PyResult<Vec<([f64; 3], Bound<'py, PyArray2<i32>>)>> {
        let found = py.detach(|| {
            let occupancy = self.0.read().unwrap_or_else(PoisonError::into_inner);
            occupancy.frontiers(low, high, min_voxels)
        });
        let told = found
            .into_iter()
            .map(|frontier| Ok((frontier.center.to_array(), frontier.voxels.into_rows(py)?)));
        told.collect()
    }
}

fn number(state: State) -> u8 {
    match state {
        State::Unknown => 0,
        State::Free => 1,
        State::Occupied => 2,
    }
}

/// Tells scan by scan which returns move.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Moving(Mutex<tsdfuse_plan::Moving>);

#[pymethods]
impl Moving {
    #[new]
    #[pyo3(signature = (voxel_size=0.25, max_range=80.0))]
    fn new(voxel_size: f64, max_range: f64) -> PyResult<Self> {
        let config = MovingConfig {
            voxel_size_m: voxel_size,
            max_range_m: max_range,
            ..MovingConfig::default()
        };
        Ok(Self(Mutex::new(tsdfuse_plan::Moving::new(config).map_err(wrong)?)))
    }

    /// Whether each return of the next scan moves, which has a pose; invalid returns do not.
    fn classify<'py>(&self, py: Python<'py>, scan: &Scan) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let is_moving = py.detach(|| {
            let mut moving: MutexGuard<'_, tsdfuse_plan::Moving> =
                self.0.lock().unwrap_or_else(PoisonError::into_inner);
            moving.classify(&scan.scan).map_err(wrong)
        })?;
        Ok(PyArray1::from_vec(py, is_moving))
    }
}

/// The ground of a map within a rectangle, layer by layer, row by row from the highest y on.
#[pyfunction]
#[pyo3(signature = (map, low, high, cell=0.2, *, radius=0.5, clearance=2.0, max_slope=25.0, max_step=0.2, max_roughness=0.1))]
#[expect(clippy::too_many_arguments, reason = "Python names them")]
pub(crate) fn ground<'py>(
    py: Python<'py>,
    map: &Map,
    low: (f64, f64),
    high: (f64, f64),
    cell: f64,
    radius: f64,
    clearance: f64,
    max_slope: f64,
    max_step: f64,
    max_roughness: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let config = GroundConfig {
        radius_m: radius,
        clearance_m: clearance,
        max_slope_deg: max_slope,
        max_step_m: max_step,
        max_roughness_m: max_roughness,
    };
    let shape = Raster::covering(DVec2::from(low), DVec2::from(high), cell).map_err(wrong)?;
    let ground = py.detach(|| {
        let mesh = extract(&map.read().map).or_raise()?;
        GroundGrid::of(&mesh, &shape, &config).map_err(wrong)
    })?;
    let layers = PyDict::new(py);
    for (name, layer) in ground.layers() {
        let values = PyArray1::from_vec(py, layer.values.clone()).reshape([layer.height, layer.width])?;
        layers.set_item(name, values)?;
    }
    Ok(layers)
}
