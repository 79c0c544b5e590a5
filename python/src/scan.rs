//! One sweep of a sensor: arrays, and where the sensor was.

use std::sync::Arc;

use glam::Vec3;
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArray3, PyArrayLike2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tsdfuse::scan::{PoseAt, RangeLimits};
use tsdfuse::sensor::Pinhole;

use crate::arrays::{IntoRows, Rows, check_pinhole, column, pose, pose_array, pose_arrays, poses};
use crate::data::{from_python, to_python};
use crate::error::{OrRaise, exception, wrong};

/// What a log says of a scan beside the scan itself.
#[derive(Clone, Debug)]
pub(crate) struct Origin {
    /// The sensor that measured it.
    pub(crate) sensor: tsdfuse_io::Sensor,
    /// The ranges that suit the log.
    pub(crate) range: RangeLimits,
}

/// One sweep of a sensor.
#[pyclass(frozen, module = "tsdfuse")]
#[derive(Clone)]
pub(crate) struct Scan {
    pub(crate) scan: Arc<tsdfuse::Scan>,
    pub(crate) origin: Option<Arc<Origin>>,
    /// The limits by which invalid returns were dropped already.
    pub(crate) clean: Option<RangeLimits>,
}

impl From<tsdfuse::Scan> for Scan {
    fn from(scan: tsdfuse::Scan) -> Self {
        Self {
            scan: Arc::new(scan),
            origin: None,
            clean: None,
        }
    }
}

/// Seconds and poses of a sensor that moved: two arrays.
fn motion(value: &Bound<'_, PyAny>) -> PyResult<Vec<PoseAt>> {
    let (secs, matrices): (Bound<'_, PyAny>, Bound<'_, PyAny>) = value
        .extract()
        .map_err(|_| wrong("motion must be two arrays: seconds (K,) and poses (K, 4, 4)"))?;
    let (secs, matrices) = (column::<f64>("motion", &secs)?, poses("motion", &matrices)?);
    if secs.len() != matrices.len() {
        return Err(wrong(format_args!(
            "motion: {} times for {} poses",
            secs.len(),
            matrices.len()
        )));
    }
    Ok(secs
        .into_iter()
        .zip(matrices)
        .map(|(secs, pose)| PoseAt { secs, pose })
        .collect())
}

/// What Python may say of a scan beside its points.
#[derive(Default)]
pub(crate) struct Columns<'a, 'py> {
    pub(crate) rings: Option<&'a Bound<'py, PyAny>>,
    pub(crate) times: Option<&'a Bound<'py, PyAny>>,
    pub(crate) intensities: Option<&'a Bound<'py, PyAny>>,
    pub(crate) motion: Option<&'a Bound<'py, PyAny>>,
    pub(crate) time_ns: Option<i64>,
    pub(crate) name: Option<String>,
}

impl Columns<'_, '_> {
    /// A scan of points and these columns.
    pub(crate) fn scan(self, points: &Bound<'_, PyAny>, at: Option<&Bound<'_, PyAny>>) -> PyResult<tsdfuse::Scan> {
        let scan = tsdfuse::Scan {
            name: self.name.unwrap_or_else(|| "scan".to_owned()),
            time_ns: self.time_ns,
            points: Rows::<f32>::of("points", points)?.vectors()?.to_vec(),
            rings: self.rings.map(|rings| column("rings", rings)).transpose()?,
            times: self.times.map(|times| column("times", times)).transpose()?,
            intensities: self
                .intensities
                .map(|values| column("intensities", values))
                .transpose()?,
            pose: at.map(|at| pose("pose", at)).transpose()?,
            motion: self.motion.map(motion).transpose()?.unwrap_or_default(),
            ..tsdfuse::Scan::default()
        };
        scan.check().or_raise()?;
        Ok(scan)
    }
}

impl Scan {
    /// The scan without invalid returns, as one that can be fused.
    pub(crate) fn cleaned(&self, limits: &RangeLimits) -> Arc<tsdfuse::Scan> {
        if self.clean == Some(*limits) {
            return Arc::clone(&self.scan);
        }
        let mut scan = tsdfuse::Scan::clone(&self.scan);
        scan.drop_invalid(limits);
        Arc::new(scan)
    }

    fn changed(&self, change: impl FnOnce(&mut tsdfuse::Scan)) -> Self {
        let mut scan = tsdfuse::Scan::clone(&self.scan);
        change(&mut scan);
        Self {
            scan: Arc::new(scan),
            ..self.clone()
        }
    }
}

#[pymethods]
impl Scan {
    #[new]
    #[pyo3(signature = (points, pose=None, *, rings=None, times=None, intensities=None, motion=None, camera=None, time_ns=None, name=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        points: &Bound<'_, PyAny>,
        pose: Option<&Bound<'_, PyAny>>,
        rings: Option<&Bound<'_, PyAny>>,
        times: Option<&Bound<'_, PyAny>>,
        intensities: Option<&Bound<'_, PyAny>>,
        motion: Option<&Bound<'_, PyAny>>,
        camera: Option<&Bound<'_, PyAny>>,
        time_ns: Option<i64>,
        name: Option<String>,
    ) -> PyResult<Self> {
        let columns = Columns {
            rings,
            times,
            intensities,
            motion,
            time_ns,
            name,
        };
        let mut scan = columns.scan(points, pose)?;
        if let Some(camera) = camera {
            let camera: Pinhole = from_python(camera, "camera")?;
            check_pinhole(&camera)?;
            scan.camera = Some(camera);
        }
        Ok(scan.into())
    }

    /// A scan of a depth image.
    #[staticmethod]
    #[pyo3(signature = (depth, *, fx, fy, cx, cy, pose=None, time_ns=None, name=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn of_depth(
        depth: &Bound<'_, PyAny>,
        fx: f32,
        fy: f32,
        cx: f32,
        cy: f32,
        pose: Option<&Bound<'_, PyAny>>,
        time_ns: Option<i64>,
        name: Option<String>,
    ) -> PyResult<Self> {
        let depths: PyArrayLike2<'_, f32, AllowTypeChange> = depth
            .extract()
            .map_err(|error: PyErr| wrong(format_args!("depth must have the shape (H, W): {error}")))?;
        let (height, width) = (depths.shape()[0], depths.shape()[1]);
        let size = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let camera = Pinhole {
            width: size(width),
            height: size(height),
            fx,
            fy,
            cx,
            cy,
        };
        check_pinhole(&camera)?;
        let depths = depths.as_array();
        let measured = depths
            .indexed_iter()
            .filter(|(_, depth)| **depth > 0.0 && depth.is_finite());
        let points = measured.map(|((row, column), &depth)| {
            let ray: Vec3 = camera.ray(column as f32, row as f32);
            ray * (depth / ray.x)
        });
        let scan = tsdfuse::Scan {
            name: name.unwrap_or_else(|| "depth image".to_owned()),
            time_ns,
            points: points.collect(),
            pose: pose.map(|at| crate::arrays::pose("pose", at)).transpose()?,
            camera: Some(camera),
            ..tsdfuse::Scan::default()
        };
        Ok(scan.into())
    }

    #[getter]
    fn name(&self) -> &str {
        &self.scan.name
    }

    #[getter]
    fn time_ns(&self) -> Option<i64> {
        self.scan.time_ns
    }

    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.scan.points.clone().into_rows(py)
    }

    #[getter]
    fn rings<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<u16>>> {
        self.scan.rings.as_ref().map(|rings| PyArray1::from_slice(py, rings))
    }

    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        self.scan.times.as_ref().map(|times| PyArray1::from_slice(py, times))
    }

    #[getter]
    fn intensities<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        self.scan
            .intensities
            .as_ref()
            .map(|values| PyArray1::from_slice(py, values))
    }

    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.scan.pose.as_ref().map(|pose| pose_array(py, pose)).transpose()
    }

    #[getter]
    fn motion<'py>(&self, py: Python<'py>) -> PyResult<Option<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray3<f64>>)>> {
        let motion = &self.scan.motion;
        if motion.is_empty() {
            return Ok(None);
        }
        let secs = motion.iter().map(|at| at.secs).collect();
        let matrices = pose_arrays(py, motion.iter().map(|at| Some(at.pose)))?;
        Ok(Some((PyArray1::from_vec(py, secs), matrices)))
    }

    #[getter]
    fn camera<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.scan
            .camera
            .as_ref()
            .map(|camera| to_python(py, camera))
            .transpose()
    }

    #[getter]
    fn sensor(&self) -> Option<&str> {
        self.origin.as_ref().map(|origin| origin.sensor.name.as_str())
    }

    #[getter]
    fn dropped<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.scan.dropped)
    }

    /// The points in the world.
    fn points_in_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = py
            .detach(|| self.scan.points_in_world().map(Iterator::collect::<Vec<_>>))
            .or_raise()?;
        points.into_rows(py)
    }

    /// The same scan with another pose, and without motion unless that is given.
    #[pyo3(signature = (pose, motion=None))]
    fn with_pose(&self, pose: &Bound<'_, PyAny>, motion: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let at = crate::arrays::pose("pose", pose)?;
        let moved = motion.map(self::motion).transpose()?.unwrap_or_default();
        let placed = self.changed(|scan| (scan.pose, scan.motion) = (Some(at), moved));
        placed.scan.check().or_raise()?;
        Ok(placed)
    }

    /// The scan as it would have been measured all at once, at the time of its pose.
    fn undistorted(&self) -> Self {
        self.changed(tsdfuse::Scan::undistort)
    }

    /// The scan without returns that measure nothing.
    #[pyo3(signature = (min_range=None, max_range=None))]
    fn cleaned_by(&self, min_range: Option<f32>, max_range: Option<f32>) -> PyResult<Self> {
        let usual = self
            .origin
            .as_ref()
            .map_or_else(RangeLimits::default, |origin| origin.range);
        let limits = RangeLimits {
            min_range_m: min_range.unwrap_or(usual.min_range_m),
            max_range_m: max_range.unwrap_or(usual.max_range_m),
        };
        limits.validate().map_err(wrong)?;
        let cleaned = self.changed(|scan| scan.drop_invalid(&limits));
        Ok(Self {
            clean: Some(limits),
            ..cleaned
        })
    }

    fn __len__(&self) -> usize {
        self.scan.points.len()
    }

    fn __repr__(&self) -> String {
        let scan = &self.scan;
        let columns = [
            ("rings", scan.rings.is_some()),
            ("times", scan.times.is_some()),
            ("intensities", scan.intensities.is_some()),
            ("motion", !scan.motion.is_empty()),
        ];
        let columns: Vec<_> = columns.iter().filter(|(_, has)| *has).map(|(name, _)| *name).collect();
        let at = match &scan.pose {
            Some(pose) => format!("at {:.2?} m", pose.translation.to_array()),
            None => "without a pose".to_owned(),
        };
        let with = if columns.is_empty() {
            String::new()
        } else {
            format!(", with {}", columns.join(", "))
        };
        format!("<Scan {:?}: {} points {at}{with}>", scan.name, scan.points.len())
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<((Bound<'py, PyArray2<f32>>,), Bound<'py, PyDict>)> {
        if self.origin.as_ref().is_some_and(|origin| origin.sensor.model.is_some()) {
            // The sensor's model would be lost.
            return Err(exception(
                "ConfigError",
                "a scan of a log is not pickled: pickle the log's path and the scan's number",
            ));
        }
        let columns = PyDict::new(py);
        columns.set_item("pose", self.pose(py)?)?;
        columns.set_item("rings", self.rings(py))?;
        columns.set_item("times", self.times(py))?;
        columns.set_item("intensities", self.intensities(py))?;
        columns.set_item("motion", self.motion(py)?)?;
        columns.set_item("camera", self.camera(py)?)?;
        columns.set_item("time_ns", self.time_ns())?;
        columns.set_item("name", self.name())?;
        Ok(((self.points(py)?,), columns))
    }
}
