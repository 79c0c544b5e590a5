//! Stores.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use tsdfuse::mesh::MeshConfig;
use tsdfuse_run::report::MapReport;
use tsdfuse_run::saved::{STORE_BYTES, whole};
use tsdfuse_run::{scene, surface};
use tsdfuse_store::PagedMap;

use crate::data::to_python;
use crate::error::OrRaise;
use crate::map::Map;
use crate::trajectory::Trajectory;

/// A map of which only a part is in memory: opened for reading.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Store {
    map: Mutex<PagedMap>,
}

impl Store {
    /// To be called without the interpreter: another thread may be reading.
    pub(crate) fn lock(&self) -> MutexGuard<'_, PagedMap> {
        self.map.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Store {
    #[new]
    #[pyo3(signature = (path, *, memory=STORE_BYTES))]
    fn new(py: Python<'_>, path: PathBuf, memory: usize) -> PyResult<Self> {
        let (map, _) = py.detach(|| PagedMap::open_read_only(&path, Some(memory))).or_raise()?;
        Ok(Self { map: Mutex::new(map) })
    }

    /// Writes the surface: `.ply`, `.html`, or `NAME/tileset.json`.
    #[pyo3(signature = (path, *, min_weight=None))]
    fn write_mesh<'py>(&self, py: Python<'py>, path: PathBuf, min_weight: Option<f32>) -> PyResult<Bound<'py, PyAny>> {
        let usual = MeshConfig::default().min_weight;
        let config = MeshConfig {
            min_weight: min_weight.unwrap_or(usual),
        };
        config.validate().or_raise()?;
        surface::check_in_parts(&path).or_raise()?;
        let write = || {
            let mut map = self.lock();
            let title = map.path().to_string_lossy().into_owned();
            let scene = scene::of_map(
                &title,
                map.config().voxel_size_m,
                &MapReport::of_paged(&map),
                map.poses(),
            );
            surface::write_in_parts(&mut map, &config, &path, &scene)
        };
        let report = py.detach(write).or_raise()?;
        to_python(py, &report)
    }

    /// Saves the whole map as a map file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.lock().save(&path)).or_raise()
    }

    /// The whole map, in memory.
    fn map(&self, py: Python<'_>) -> PyResult<Map> {
        let (map, poses) = py.detach(|| whole(&mut self.lock())).or_raise()?;
        Map::made(map, poses)
    }

    #[getter]
    fn path(&self, py: Python<'_>) -> PathBuf {
        py.detach(|| self.lock().path().to_owned())
    }

    #[getter]
    fn poses(&self, py: Python<'_>) -> Trajectory {
        let poses = py.detach(|| self.lock().poses().to_vec());
        Trajectory::of_scans(poses)
    }

    #[getter]
    fn blocks(&self, py: Python<'_>) -> u64 {
        py.detach(|| self.lock().sizes().blocks)
    }

    #[getter]
    fn integrations(&self, py: Python<'_>) -> u32 {
        py.detach(|| self.lock().integrations())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (path, blocks) = (self.path(py), self.blocks(py));
        format!("<Store {path:?}: {blocks} blocks>")
    }
}
