//! Maps in memory: fused, asked, changed, saved.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use glam::DVec3;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::basic::CompareOp;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use tsdfuse::fuse::{Method, Skipped};
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::mesh::{Incremental, MeshConfig};
use tsdfuse::scan::{Dropped, RangeLimits};
use tsdfuse::{Integration, Integrator, SensorModel, VoxelMap};
use tsdfuse_io::map_file::{self, FusedPose, Reader};
use tsdfuse_run::report::MapReport;
use tsdfuse_run::{Device, RunConfig, export, saved, scene, surface};

use crate::arrays::{IntoRows, Rows, pose, triple};
use crate::config::Config;
use crate::data::{from_python, to_python};
use crate::error::{OrRaise, exception, wrong};
use crate::mesh::Mesh;
use crate::piece::OwnPiece;
use crate::reach::Reach;
use crate::scan::{Columns, Scan};
use crate::sensor;
use crate::trajectory::Trajectory;

/// A sensor whose scans were fused, and what fuses them.
struct Fuser {
    name: Option<String>,
    model: Option<SensorModel>,
    method: Box<dyn Integrator>,
}

/// The map, and the poses of its scans.
pub(crate) struct Content {
    pub(crate) map: VoxelMap,
    poses: Vec<FusedPose>,
}

impl Content {
    /// Where the sensor was, world.
    pub(crate) fn path(&self) -> Vec<DVec3> {
        self.poses.iter().map(|fused| fused.pose.translation).collect()
    }
}

/// A map in memory. Threads may ask it at the same time; fusing waits for them.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Map {
    config: Config,
    /// The model of sensors whose scans do not tell it.
    sensor: Option<SensorModel>,
    /// Locked before the content.
    fusers: Mutex<Vec<Fuser>>,
    surface: Mutex<Option<Incremental>>,
    content: RwLock<Content>,
}

impl Map {
    /// A map that is continued with these options.
    pub(crate) fn of(config: Config, sensor: Option<SensorModel>, map: VoxelMap, poses: Vec<FusedPose>) -> Self {
        Self {
            config,
            sensor,
            fusers: Mutex::default(),
            surface: Mutex::default(),
            content: RwLock::new(Content { map, poses }),
        }
    }

    /// A map that was made elsewhere, with its voxels and the defaults of all else.
    pub(crate) fn made(map: VoxelMap, poses: Vec<FusedPose>) -> PyResult<Self> {
        let mut config = Config::default();
        config.0.set_missing("the map", map.config()).or_raise()?;
        Ok(Self::of(config, None, map, poses))
    }

    /// Made of this map: its options go along, as far as the voxels allow.
    fn like(&self, map: VoxelMap, poses: Vec<FusedPose>) -> PyResult<Self> {
        let mut config = self.config.clone();
        config
            .0
            .set("the map", "map.voxel_size_m", map.config().voxel_size_m)
            .or_raise()?;
        config
            .0
            .set("the map", "map.truncation_m", map.config().truncation_m)
            .or_raise()?;
        Ok(Self::of(config, self.sensor.clone(), map, poses))
    }

    /// To be called without the interpreter: another thread may be fusing.
    pub(crate) fn read(&self) -> RwLockReadGuard<'_, Content> {
        self.content.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Content> {
        self.content.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn mesh_config(&self, min_weight: Option<f32>) -> PyResult<MeshConfig> {
        let mut config = self.config.resolved()?.mesh;
        config.min_weight = min_weight.unwrap_or(config.min_weight);
        config.validate().or_raise()?;
        Ok(config)
    }

    /// How a scan is fused here: its method and its ranges.
    fn run_config(&self, scan: &Scan) -> PyResult<(RunConfig, RangeLimits)> {
        let mut config = self.config.resolved()?;
        if scan.scan.camera.is_some() && !self.config.has_method() {
            config.method = Method::Depth;
        }
        let mut range = config.range;
        if let Some(origin) = &scan.origin {
            if !self.config.0.has("range", "min_range_m") {
                range.min_range_m = origin.range.min_range_m;
            }
            if !self.config.0.has("range", "max_range_m") {
                range.max_range_m = origin.range.max_range_m;
            }
        }
        Ok((config, range))
    }

    /// Fuses a scan; `number` is its own among all that are fused, where this map does not hold all.
    fn integrate(&self, scan: &Scan, number: Option<u32>) -> PyResult<(Integration, Dropped)> {
        let (config, range) = self.run_config(scan)?;
        let clean = scan.cleaned(&range);
        let mut fusers = self.fusers.lock().unwrap_or_else(PoisonError::into_inner);
        let fuser = self.fuser(&mut fusers, scan, &config, &clean);
        let mut content = self.write();
        if let Some(number) = number {
            content.map.set_integrations(number);
        }
        let done = fuser.method.integrate(&mut content.map, &clean).or_raise()?;
        let time_ns = clean.time_ns;
        content.poses.extend(clean.pose.map(|pose| FusedPose { time_ns, pose }));
        if let Some(surface) = &mut *self.surface.lock().unwrap_or_else(PoisonError::into_inner) {
            surface.note(&done.updated_blocks);
        }
        Ok((done, clean.dropped))
    }

    /// What fuses the scans of a sensor.
    fn fuser<'a>(
        &self,
        fusers: &'a mut Vec<Fuser>,
        scan: &Scan,
        config: &RunConfig,
        clean: &tsdfuse::Scan,
    ) -> &'a mut Fuser {
        let sensor = scan.origin.as_ref().map(|origin| &origin.sensor);
        let name = sensor.map(|sensor| sensor.name.clone());
        let known = fusers.iter().position(|fuser| fuser.name == name);
        let at = known.unwrap_or_else(|| {
            let methods = config.methods();
            let mut model = sensor
                .and_then(|sensor| sensor.model.clone())
                .or_else(|| self.sensor.clone());
            if model.is_none() && config.method.build(&methods, None).needs_sensor() {
                model = tsdfuse::sensor::guess(&clean.points, clean.rings.as_deref());
            }
            let method = config.method.build(&methods, model.as_ref());
            fusers.push(Fuser { name, model, method });
            fusers.len() - 1
        });
        &mut fusers[at]
    }

    fn summary(&self) -> (usize, f64, usize, u32) {
        let content = self.read();
        let map = &content.map;
        (
            map.block_count(),
            map.config().voxel_size_m,
            map.memory_bytes(),
            map.integrations(),
        )
    }
}

/// A scan, or the arrays that make one.
fn scan_of(scan: &Bound<'_, PyAny>, pose: Option<&Bound<'_, PyAny>>, columns: Columns<'_, '_>) -> PyResult<Scan> {
    let Ok(made) = scan.cast::<Scan>() else {
        return Ok(columns.scan(scan, pose)?.into());
    };
    let others = [columns.rings, columns.times, columns.intensities, columns.motion];
    if pose.is_some() || others.iter().any(Option::is_some) {
        return Err(PyTypeError::new_err(
            "a Scan has its own pose and columns: Scan.with_pose changes the pose",
        ));
    }
    Ok(made.get().clone())
}

#[pymethods]
impl Map {
    #[new]
    #[pyo3(signature = (voxel_size=None, truncation=None, *, config=None, sensor=None, **options))]
    fn new(
        voxel_size: Option<f64>,
        truncation: Option<f64>,
        config: Option<&Bound<'_, PyAny>>,
        sensor: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut config = Config::layered(config, options)?;
        for (key, value) in [("map.voxel_size_m", voxel_size), ("map.truncation_m", truncation)] {
            if let Some(value) = value {
                config.0.set(key, key, value).or_raise()?;
            }
        }
        let map = VoxelMap::new(config.resolved()?.map).or_raise()?;
        Ok(Self::of(
            config,
            sensor.map(sensor::model).transpose()?,
            map,
            Vec::new(),
        ))
    }

    /// Loads a saved map or a store.
    #[staticmethod]
    #[pyo3(signature = (path, *, config=None, sensor=None, **options))]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        config: Option<&Bound<'_, PyAny>>,
        sensor: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (map, poses) = py.detach(|| saved::read(&path)).or_raise()?;
        let mut config = Config::layered(config, options)?;
        config.0.set_missing("the map", map.config()).or_raise()?;
        let asked = config.resolved()?.map;
        map.config()
            .check_same(&asked)
            .map_err(|error| wrong(format_args!("{}: {error}", path.display())))?;
        Ok(Self::of(config, sensor.map(sensor::model).transpose()?, map, poses))
    }

    /// Fuses a scan.
    #[pyo3(signature = (scan, pose=None, *, rings=None, times=None, intensities=None, motion=None, time_ns=None, name=None, number=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn fuse(
        &self,
        py: Python<'_>,
        scan: &Bound<'_, PyAny>,
        pose: Option<&Bound<'_, PyAny>>,
        rings: Option<&Bound<'_, PyAny>>,
        times: Option<&Bound<'_, PyAny>>,
        intensities: Option<&Bound<'_, PyAny>>,
        motion: Option<&Bound<'_, PyAny>>,
        time_ns: Option<i64>,
        name: Option<String>,
        number: Option<u32>,
    ) -> PyResult<Fused> {
        let scan = scan_of(
            scan,
            pose,
            Columns {
                rings,
                times,
                intensities,
                motion,
                time_ns,
                name,
            },
        )?;
        let (done, dropped) = py.detach(|| self.integrate(&scan, number))?;
        Ok(Fused {
            returns: done.fused_returns,
            skipped: done.skipped,
            dropped,
            blocks: done.updated_blocks,
        })
    }

    /// Lets methods that collect scans fuse them.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            let mut fusers = self.fusers.lock().unwrap_or_else(PoisonError::into_inner);
            let mut content = self.write();
            for fuser in fusers.iter_mut() {
                let done = fuser.method.finish(&mut content.map).or_raise()?;
                if let Some(surface) = &mut *self.surface.lock().unwrap_or_else(PoisonError::into_inner) {
                    surface.note(&done.updated_blocks);
                }
            }
            Ok(())
        })
    }

    /// What a scan may change.
    fn reach(&self, py: Python<'_>, scan: &Scan) -> PyResult<Reach> {
        py.detach(|| {
            let (config, range) = self.run_config(scan)?;
            let clean = scan.cleaned(&range);
            let mut fusers = self.fusers.lock().unwrap_or_else(PoisonError::into_inner);
            let reach = self
                .fuser(&mut fusers, scan, &config, &clean)
                .method
                .reach(&config.map, &clean);
            Ok(Reach::of(reach.or_raise()?, self.read().map.grid()))
        })
    }

    /// Forgets all that lies outside of the regions from `first` to `end`, that one excluded.
    fn keep_regions(&self, py: Python<'_>, first: [i32; 3], end: [i32; 3]) {
        let (first, end) = (glam::IVec3::from(first), glam::IVec3::from(end));
        py.detach(|| {
            let mut content = self.write();
            for RegionIndex(region) in content.map.regions() {
                if region.cmplt(first).any() || region.cmpge(end).any() {
                    drop(content.map.take_region(RegionIndex(region)));
                }
            }
            content.map.forget_empty_regions();
        });
    }

    /// The surface.
    #[pyo3(signature = (*, min_weight=None, device="cpu"))]
    fn mesh(&self, py: Python<'_>, min_weight: Option<f32>, device: &str) -> PyResult<Mesh> {
        let (config, device) = (self.mesh_config(min_weight)?, device.parse::<Device>().map_err(wrong)?);
        let mesh = py.detach(|| device.mesh(&self.read().map, &config)).or_raise()?;
        Mesh::of(py, mesh)
    }

    /// Writes the surface to a file, or as 3D Tiles.
    #[pyo3(signature = (path, *, min_weight=None))]
    fn write_mesh<'py>(&self, py: Python<'py>, path: PathBuf, min_weight: Option<f32>) -> PyResult<Bound<'py, PyAny>> {
        let config = self.mesh_config(min_weight)?;
        surface::check(&path).or_raise()?;
        let write = || {
            let content = self.read();
            let Content { map, poses } = &*content;
            let scene = scene::of_map("tsdfuse", map.config().voxel_size_m, &MapReport::of(map), poses);
            surface::write(map, &config, &path, &scene)
        };
        let report = py.detach(write).or_raise()?;
        to_python(py, &report)
    }

    /// The pieces of the surface that changed since this was asked last.
    #[pyo3(signature = (nearby=None))]
    fn changes(&self, py: Python<'_>, nearby: Option<PyRef<'_, Nearby>>) -> PyResult<Changes> {
        let (config, nearby) = (self.mesh_config(None)?, nearby.map(|nearby| nearby.get()));
        let changes = py.detach(|| {
            let content = self.read();
            let mut surface = self.surface.lock().unwrap_or_else(PoisonError::into_inner);
            let surface = surface.get_or_insert_with(|| {
                let mut surface = Incremental::new(&config);
                surface.note(&content.map.block_indices());
                surface
            });
            let mut changes = tsdfuse::mesh::Changes::default();
            match nearby {
                Some(nearby) => surface.changes_near(&content.map, &nearby, &mut changes),
                None => surface.changes(&content.map, &mut changes),
            }
            Pieces::of(&changes)
        });
        Changes::of(py, changes)
    }

    /// The field at points.
    fn distance<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
    ) -> PyResult<(
        Bound<'py, PyArray1<f32>>,
        Bound<'py, PyArray2<f32>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        let (distances, gradients, weights) = self.sample(py, points)?;
        let seen = weights.into_iter().map(|weight| weight > 0.0).collect();
        Ok((
            PyArray1::from_vec(py, distances),
            gradients.into_rows(py)?,
            PyArray1::from_vec(py, seen),
        ))
    }

    /// The weights at points.
    fn weight<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let (_, _, weights) = self.sample(py, points)?;
        Ok(PyArray1::from_vec(py, weights))
    }

    /// The voxels of a box as arrays.
    #[pyo3(name = "box")]
    fn dense<'py>(
        &self,
        py: Python<'py>,
        low: &Bound<'py, PyAny>,
        high: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (low, high) = (triple("low", low)?, triple("high", high)?);
        let dense = py.detach(|| self.read().map.dense(low, high)).or_raise()?;
        let told = PyDict::new(py);
        told.set_item(
            "distance",
            PyArray1::from_vec(py, dense.distance_m).reshape(dense.shape)?,
        )?;
        told.set_item("weight", PyArray1::from_vec(py, dense.weight).reshape(dense.shape)?)?;
        told.set_item("origin", PyArray1::from_slice(py, &dense.origin.to_array()))?;
        told.set_item("first", dense.first.to_array())?;
        told.set_item("voxel_size", dense.voxel_size_m)?;
        Ok(told)
    }

    /// All observed voxels.
    fn voxels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (mut indices, mut centers) = (Vec::new(), Vec::new());
        let (mut distances, mut weights) = (Vec::new(), Vec::new());
        py.detach(|| {
            for voxel in self.read().map.voxels() {
                indices.push(voxel.index);
                centers.push(voxel.center);
                distances.push(voxel.distance_m);
                weights.push(voxel.weight);
            }
        });
        let told = PyDict::new(py);
        told.set_item("index", indices.into_rows(py)?)?;
        told.set_item("center", centers.into_rows(py)?)?;
        told.set_item("distance", PyArray1::from_vec(py, distances))?;
        told.set_item("weight", PyArray1::from_vec(py, weights))?;
        Ok(told)
    }

    /// Adds other maps.
    #[pyo3(signature = (*others))]
    fn merge(&self, py: Python<'_>, others: &Bound<'_, pyo3::types::PyTuple>) -> PyResult<u64> {
        let mut limited = 0;
        for other in others {
            limited += match other.cast::<Self>() {
                Ok(other) => self.merge_map(py, other.get())?,
                Err(_) => self.merge_file(py, other.extract()?)?,
            };
        }
        Ok(limited)
    }

    /// The voxels in a box.
    fn cropped(&self, py: Python<'_>, low: &Bound<'_, PyAny>, high: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (low, high) = (triple("low", low)?, triple("high", high)?);
        let (map, poses) = py.detach(|| {
            let content = self.read();
            Ok::<_, PyErr>((content.map.cropped(low, high).or_raise()?, content.poses.clone()))
        })?;
        self.like(map, poses)
    }

    /// The same map with voxels of another size.
    fn resampled(&self, py: Python<'_>, voxel_size: f64) -> PyResult<Self> {
        let (map, poses) = py.detach(|| {
            let content = self.read();
            Ok::<_, PyErr>((content.map.resampled(voxel_size).or_raise()?, content.poses.clone()))
        })?;
        self.like(map, poses)
    }

    /// The map in another frame, and whether all voxels are unchanged.
    fn transformed(&self, py: Python<'_>, new_from_old: &Bound<'_, PyAny>) -> PyResult<(Self, bool)> {
        let new_from_old = pose("new_from_old", new_from_old)?;
        let ((map, exact), mut poses) = py.detach(|| {
            let content = self.read();
            Ok::<_, PyErr>((
                content.map.transformed(&new_from_old).or_raise()?,
                content.poses.clone(),
            ))
        })?;
        saved::move_poses(&mut poses, &new_from_old);
        Ok((self.like(map, poses)?, exact))
    }

    /// A map of its own with the same content.
    fn copy(&self, py: Python<'_>) -> Self {
        let (map, poses) = py.detach(|| {
            let content = self.read();
            (content.map.clone(), content.poses.clone())
        });
        Self::of(self.config.clone(), self.known_sensor(), map, poses)
    }

    /// Saves the map, with the poses of its scans.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| {
            let content = self.read();
            map_file::write_with_poses(&path, &content.map, &content.poses)
        })
        .or_raise()
    }

    /// Writes the voxels as arrays, or the surface as points.
    fn export(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let config = self.mesh_config(None)?;
        py.detach(|| export::map(&self.read().map, &config, &path))
            .or_raise()
            .map(drop)
    }

    /// Frees the memory of everything that is kept to mesh what changes.
    fn forget_changes(&self) {
        *self.surface.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    #[getter]
    fn config(&self) -> PyResult<Config> {
        Config::all_of(&self.config.resolved()?)
    }

    #[getter]
    fn voxel_size(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.read().map.config().voxel_size_m)
    }

    #[getter]
    fn truncation(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.read().map.config().truncation_m)
    }

    #[getter]
    fn blocks(&self, py: Python<'_>) -> usize {
        py.detach(|| self.read().map.block_count())
    }

    #[getter]
    fn observed_voxels(&self, py: Python<'_>) -> usize {
        py.detach(|| self.read().map.observed_voxel_count())
    }

    #[getter]
    fn memory_bytes(&self, py: Python<'_>) -> usize {
        py.detach(|| self.read().map.memory_bytes())
    }

    /// How many scans were fused.
    #[getter]
    fn integrations(&self, py: Python<'_>) -> u32 {
        py.detach(|| self.read().map.integrations())
    }

    #[setter]
    fn set_integrations(&self, py: Python<'_>, integrations: u32) {
        py.detach(|| self.write().map.set_integrations(integrations));
    }

    /// The box around all that was observed: (2, 3).
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let bounds = py.detach(|| self.read().map.bounds());
        bounds.map(|(low, high)| vec![low, high].into_rows(py)).transpose()
    }

    /// The poses of the scans that were fused.
    #[getter]
    fn poses(&self, py: Python<'_>) -> Trajectory {
        let poses = py.detach(|| self.read().poses.clone());
        Trajectory::of_scans(poses)
    }

    fn __richcmp__(&self, py: Python<'_>, other: &Self, op: CompareOp) -> PyResult<bool> {
        let equal = || py.detach(|| std::ptr::eq(self, other) || self.read().map == other.read().map);
        match op {
            CompareOp::Eq => Ok(equal()),
            CompareOp::Ne => Ok(!equal()),
            _ => Err(PyTypeError::new_err("maps have no order")),
        }
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (blocks, voxel_size_m, bytes, scans) = py.detach(|| self.summary());
        let mib = bytes as f64 / f64::from(1 << 20);
        format!("<Map: {blocks} blocks of voxels of {voxel_size_m} m, {mib:.1} MiB, {scans} scans>")
    }

    fn __copy__(&self, py: Python<'_>) -> Self {
        self.copy(py)
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> Self {
        self.copy(py)
    }

    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>, Config, Bound<'py, PyAny>))> {
        let (py, this) = (slf.py(), slf.get());
        let mut bytes = Vec::new();
        py.detach(|| {
            let content = this.read();
            map_file::write_to(&mut bytes, &content.map, &content.poses)
        })?;
        let sensor = to_python(py, &this.known_sensor())?;
        Ok((
            slf.get_type().getattr("_of_bytes")?,
            (PyBytes::new(py, &bytes), this.config.clone(), sensor),
        ))
    }

    #[staticmethod]
    fn _of_bytes(py: Python<'_>, bytes: &[u8], config: &Config, sensor: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (map, poses) = py
            .detach(|| {
                let mut reader = Reader::new(Path::new("a pickled map"), bytes)?;
                let poses = reader.take_poses();
                Ok::<_, tsdfuse_io::Error>((reader.map()?, poses))
            })
            .or_raise()?;
        Ok(Self::of(config.clone(), from_python(sensor, "sensor")?, map, poses))
    }
}

impl Map {
    /// The model of the sensor, if only one is known or was guessed.
    fn known_sensor(&self) -> Option<SensorModel> {
        let fusers = self.fusers.lock().unwrap_or_else(PoisonError::into_inner);
        self.sensor
            .clone()
            .or_else(|| fusers.first().and_then(|fuser| fuser.model.clone()))
    }

    fn merge_map(&self, py: Python<'_>, other: &Self) -> PyResult<u64> {
        if std::ptr::eq(self, other) {
            return Err(wrong("a map cannot be merged into itself: merge a copy"));
        }
        py.detach(|| {
            // A copy, so that two threads that merge two maps into each other do not wait for ever.
            let (map, poses) = {
                let other = other.read();
                (other.map.clone(), other.poses.clone())
            };
            let mut content = self.write();
            let limited = content.map.merge(&map).or_raise()?;
            content.poses.extend(poses);
            self.note_all(&map.block_indices());
            Ok(limited)
        })
    }

    /// Adds the blocks of a file as they are read.
    fn merge_file(&self, py: Python<'_>, path: PathBuf) -> PyResult<u64> {
        py.detach(|| {
            let reader = Reader::open(&path).or_raise()?;
            let mut content = self.write();
            let same = content.map.config().check_same(reader.config());
            same.map_err(|error| wrong(format_args!("{}: {error}", path.display())))?;
            let mut blocks = Vec::new();
            let Content { map, poses } = &mut *content;
            let limited = saved::add(map, poses, reader, |block| blocks.push(block)).or_raise()?;
            self.note_all(&blocks);
            Ok(limited)
        })
    }

    fn note_all(&self, blocks: &[BlockIndex]) {
        if let Some(surface) = &mut *self.surface.lock().unwrap_or_else(PoisonError::into_inner) {
            surface.note(blocks);
        }
    }

    /// Distances, gradients and weights at points; NaN, zero and zero where the map does not know.
    fn sample(&self, py: Python<'_>, points: &Bound<'_, PyAny>) -> PyResult<(Vec<f32>, Vec<glam::Vec3>, Vec<f32>)> {
        let rows = Rows::<f64>::of("points", points)?;
        let points: &[DVec3] = rows.vectors()?;
        let samples = py.detach(|| self.read().map.sample_all(points));
        let (mut distances, mut gradients, mut weights) = (Vec::new(), Vec::new(), Vec::new());
        for sample in samples {
            distances.push(sample.map_or(f32::NAN, |sample| sample.distance_m));
            gradients.push(sample.map_or(glam::Vec3::ZERO, |sample| sample.gradient));
            weights.push(sample.map_or(0.0, |sample| sample.weight));
        }
        Ok((distances, gradients, weights))
    }
}

/// What became of a scan.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Fused {
    returns: u64,
    skipped: Skipped,
    dropped: Dropped,
    blocks: Vec<BlockIndex>,
}

#[pymethods]
impl Fused {
    /// Returns that reached the map.
    #[getter]
    fn returns(&self) -> u64 {
        self.returns
    }

    /// Measurements that the method had no use for, by reason.
    #[getter]
    fn skipped<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.skipped)
    }

    /// Returns that are no measurements, by reason.
    #[getter]
    fn dropped<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.dropped)
    }

    /// The blocks that changed: (K, 3).
    #[getter]
    fn blocks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        self.blocks
            .iter()
            .map(|block| block.0)
            .collect::<Vec<_>>()
            .into_rows(py)
    }

    fn __repr__(&self) -> String {
        format!(
            "<Fused: {} returns, {} blocks changed>",
            self.returns,
            self.blocks.len()
        )
    }
}

/// The space around a robot.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Nearby(Mutex<tsdfuse::mesh::Nearby>);

impl Nearby {
    pub(crate) fn get(&self) -> tsdfuse::mesh::Nearby {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Nearby {
    #[new]
    #[pyo3(signature = (radius=30.0))]
    fn new(radius: f64) -> Self {
        Self(Mutex::new(tsdfuse::mesh::Nearby::new(radius)))
    }

    /// The next turn, with the robot at a place.
    fn move_to(&self, place: &Bound<'_, PyAny>) -> PyResult<()> {
        let place = triple("place", place)?;
        self.0.lock().unwrap_or_else(PoisonError::into_inner).move_to(place);
        Ok(())
    }
}

/// The pieces of a surface that changed, as flat arrays.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Changes {
    blocks: Py<PyArray2<i32>>,
    vertices: Py<PyArray2<f64>>,
    normals: Py<PyArray2<f32>>,
    triangles: Py<PyArray2<i32>>,
    vertex_offsets: Py<PyArray1<i64>>,
    triangle_offsets: Py<PyArray1<i64>>,
}

/// What changed, before Python has it.
#[derive(Default)]
pub(crate) struct Pieces {
    blocks: Vec<glam::IVec3>,
    vertices: Vec<DVec3>,
    normals: Vec<glam::Vec3>,
    triangles: Vec<[u32; 3]>,
    vertex_offsets: Vec<i64>,
    triangle_offsets: Vec<i64>,
}

impl Pieces {
    /// One piece after the other.
    pub(crate) fn of(changes: &tsdfuse::mesh::Changes) -> Self {
        let mut all = Self {
            vertex_offsets: vec![0],
            triangle_offsets: vec![0],
            ..Self::default()
        };
        for piece in changes.iter() {
            all.blocks.push(piece.block.0);
            all.vertices.extend_from_slice(piece.vertices);
            all.normals.extend_from_slice(piece.normals);
            all.triangles.extend_from_slice(piece.triangles);
            all.vertex_offsets.push(all.vertices.len() as i64);
            all.triangle_offsets.push(all.triangles.len() as i64);
        }
        all
    }
}

impl Changes {
    /// The pieces, as the engine takes them.
    pub(crate) fn pieces(&self, py: Python<'_>) -> PyResult<Vec<OwnPiece>> {
        let (blocks, vertices) = (self.blocks.bind(py).to_vec()?, self.vertices.bind(py).to_vec()?);
        let triangles = self.triangles.bind(py).to_vec()?;
        let ends = |offsets: &Py<PyArray1<i64>>| -> PyResult<Vec<usize>> {
            Ok(offsets.bind(py).to_vec()?.into_iter().map(|end| end as usize).collect())
        };
        let (vertex_ends, triangle_ends) = (ends(&self.vertex_offsets)?, ends(&self.triangle_offsets)?);
        let piece = |i: usize| {
            let block = glam::IVec3::from_slice(blocks.get(3 * i..)?.get(..3)?);
            let vertices = vertices.get(3 * vertex_ends[i]..3 * vertex_ends[i + 1])?;
            let triangles = triangles.get(3 * triangle_ends[i]..3 * triangle_ends[i + 1])?;
            Some(OwnPiece {
                block,
                vertices: vertices.chunks_exact(3).map(DVec3::from_slice).collect(),
                triangles: triangles
                    .chunks_exact(3)
                    .map(|t| [t[0] as u32, t[1] as u32, t[2] as u32])
                    .collect(),
            })
        };
        let count = vertex_ends.len().min(triangle_ends.len()).saturating_sub(1);
        let pieces: Option<Vec<OwnPiece>> = (0..count).map(piece).collect();
        pieces.ok_or_else(|| wrong("the arrays of these changes do not fit together"))
    }

    pub(crate) fn of(py: Python<'_>, pieces: Pieces) -> PyResult<Self> {
        Ok(Self {
            blocks: pieces.blocks.into_rows(py)?.unbind(),
            vertices: pieces.vertices.into_rows(py)?.unbind(),
            normals: pieces.normals.into_rows(py)?.unbind(),
            triangles: pieces.triangles.into_rows(py)?.unbind(),
            vertex_offsets: PyArray1::from_vec(py, pieces.vertex_offsets).unbind(),
            triangle_offsets: PyArray1::from_vec(py, pieces.triangle_offsets).unbind(),
        })
    }
}

#[pymethods]
impl Changes {
    #[getter]
    fn blocks(&self, py: Python<'_>) -> Py<PyArray2<i32>> {
        self.blocks.clone_ref(py)
    }

    #[getter]
    fn vertices(&self, py: Python<'_>) -> Py<PyArray2<f64>> {
        self.vertices.clone_ref(py)
    }

    #[getter]
    fn normals(&self, py: Python<'_>) -> Py<PyArray2<f32>> {
        self.normals.clone_ref(py)
    }

    #[getter]
    fn triangles(&self, py: Python<'_>) -> Py<PyArray2<i32>> {
        self.triangles.clone_ref(py)
    }

    #[getter]
    fn vertex_offsets(&self, py: Python<'_>) -> Py<PyArray1<i64>> {
        self.vertex_offsets.clone_ref(py)
    }

    #[getter]
    fn triangle_offsets(&self, py: Python<'_>) -> Py<PyArray1<i64>> {
        self.triangle_offsets.clone_ref(py)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        use numpy::PyUntypedArrayMethods;
        self.blocks.bind(py).shape()[0]
    }

    /// Block and mesh of each piece.
    fn __iter__(slf: &Bound<'_, Self>) -> PyResult<Py<PyAny>> {
        let convert = slf.py().import("tsdfuse._convert")?;
        Ok(convert.call_method1("pieces", (slf,))?.unbind())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("<Changes: {} pieces>", self.__len__(py))
    }
}

/// The message for what a map without surface cannot do.
pub(crate) fn no_surface() -> PyErr {
    exception("EmptyResultError", "the map has no surface")
}
