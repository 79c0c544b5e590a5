//! Stores, and reading maps of either kind.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use tsdfuse::VoxelMap;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_io::{npz, ply};
use tsdfuse_run::report::MapReport;
use tsdfuse_run::{RunError, scene, surface};
use tsdfuse_store::PagedMap;

use crate::data::to_python;
use crate::error::{OrRaise, wrong};
use crate::map::Map;
use crate::odometry::Trajectory;

/// Blocks of a store that are in memory while it is read.
const STORE_BYTES: usize = 256 << 20;

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
        Trajectory::of(poses.into_iter().map(|fused| (fused.time_ns, fused.pose)).collect())
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

/// All of a store.
fn whole(store: &mut PagedMap) -> Result<(VoxelMap, Vec<FusedPose>), RunError> {
    let mut map = VoxelMap::new(*store.config())?;
    map.set_integrations(store.integrations());
    store.for_each_region(|part, region| {
        for (index, block) in part.blocks_of(region) {
            map.insert_block(index, block.clone())?;
        }
        Ok::<_, RunError>(())
    })?;
    Ok((map, store.poses().to_vec()))
}

/// Reads a saved map or a store, with the poses of its scans.
pub(crate) fn read_any(path: &Path) -> Result<(VoxelMap, Vec<FusedPose>), RunError> {
    if tsdfuse_store::recognises(path) {
        return whole(&mut PagedMap::open_read_only(path, Some(STORE_BYTES))?.0);
    }
    Ok(map_file::read_with_poses(path)?)
}

/// Writes a map as arrays (`.npz`, `.zarr`), or its surface as points (`.ply`).
pub(crate) fn export(map: &VoxelMap, config: &MeshConfig, path: &Path) -> PyResult<()> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("npz") => npz::write(path, map).or_raise(),
        Some("ply") => ply::write_vertices(path, &extract_with(map, config).or_raise()?).or_raise(),
        Some("zarr") => zarr(map, path),
        _ => Err(wrong(format_args!(
            "{}: a map is exported as .npz, .zarr or .ply",
            path.display()
        ))),
    }
}

#[cfg(feature = "zarr")]
fn zarr(map: &VoxelMap, path: &Path) -> PyResult<()> {
    use rayon::prelude::*;
    use tsdfuse_io::zarr::Volume;

    tsdfuse_io::atomic::check_folder(path).or_raise()?;
    let regions = map.regions();
    let volume = Volume::create(path, map.config(), &regions).or_raise()?;
    let write = |&region| volume.region(region, map.blocks_of(region));
    regions.par_iter().try_for_each(write).or_raise()?;
    volume.finish().or_raise()
}

#[cfg(not(feature = "zarr"))]
fn zarr(_: &VoxelMap, path: &Path) -> PyResult<()> {
    let told = "this build writes no Zarr arrays: it was made without the feature zarr";
    Err(wrong(format_args!("{}: {told}", path.display())))
}
