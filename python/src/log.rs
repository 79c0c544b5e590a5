//! Logs: the scans of one or several sensors, whatever the files look like.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use numpy::{PyArray1, PyArray3};
use pyo3::exceptions::{PyIndexError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use tsdfuse_io::{OpenOptions, Selection};

use crate::arrays::{pose_array, pose_arrays};
use crate::config::Config;
use crate::data::{from_python, to_python};
use crate::error::{OrRaise, exception};
use crate::scan::{Origin, Scan};
use crate::trajectory::Trajectory;

/// An opened log.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Log {
    pub(crate) log: tsdfuse_io::Log,
    path: PathBuf,
    origins: Vec<Arc<Origin>>,
}

/// Which scans, as Python's dictionary of a selection.
pub(crate) fn selection(value: Option<&Bound<'_, PyAny>>) -> PyResult<Selection> {
    value.map_or(Ok(Selection::default()), |value| from_python(value, "scans"))
}

impl Log {
    fn scan(&self, sensor: usize, scan: tsdfuse::Scan, is_clean: bool) -> Scan {
        let origin = self.origins.get(sensor).cloned();
        let clean = origin.as_ref().filter(|_| is_clean).map(|origin| origin.range);
        Scan {
            scan: Arc::new(scan),
            origin,
            clean,
        }
    }
}

#[pymethods]
impl Log {
    #[new]
    #[pyo3(signature = (path, options=None))]
    fn new(py: Python<'_>, path: PathBuf, options: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let options: OpenOptions =
            options.map_or(Ok(OpenOptions::default()), |options| from_python(options, "open"))?;
        let log = py.detach(|| tsdfuse_io::open_with(&path, &options)).or_raise()?;
        let range = log.suggested().range;
        let origin = |sensor: &tsdfuse_io::Sensor| {
            Arc::new(Origin {
                sensor: sensor.clone(),
                range,
            })
        };
        let origins = log.sensors().iter().map(origin).collect();
        Ok(Self { log, path, origins })
    }

    #[getter]
    fn path(&self) -> &PathBuf {
        &self.path
    }

    #[getter]
    fn format(&self) -> &str {
        self.log.format()
    }

    /// The sensors.
    #[getter]
    fn sensors<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let told = |origin: &Arc<Origin>| {
            let (sensor, told) = (&origin.sensor, PyDict::new(py));
            told.set_item("name", &sensor.name)?;
            told.set_item(
                "model",
                sensor.model.as_ref().map(|model| to_python(py, model)).transpose()?,
            )?;
            told.set_item(
                "camera",
                sensor.camera.as_ref().map(|camera| to_python(py, camera)).transpose()?,
            )?;
            told.set_item("min_range_m", sensor.min_range_m)?;
            told.set_item("body_from_sensor", pose_array(py, &sensor.body_from_sensor)?)?;
            Ok(told)
        };
        self.origins.iter().map(told).collect()
    }

    /// The names of the scans.
    #[getter]
    fn names(&self) -> Vec<&str> {
        self.log.scans().iter().map(|scan| scan.name.as_str()).collect()
    }

    /// Of each scan: nanoseconds; `None` if one has no time.
    #[getter]
    fn times_ns<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<i64>>> {
        let times: Option<Vec<i64>> = self.log.scans().iter().map(|scan| scan.time_ns).collect();
        times.map(|times| PyArray1::from_vec(py, times))
    }

    /// Of each scan: `world_from_sensor`; NaN where it is not known.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        pose_arrays(py, self.log.scans().iter().map(|scan| scan.pose))
    }

    /// `world_from_body` over time.
    #[getter]
    fn trajectory(&self) -> Option<Trajectory> {
        let trajectory = self.log.trajectory()?;
        let times = trajectory.times_ns().iter().map(|&time| Some(time));
        Some(Trajectory::of(times.zip(trajectory.poses().iter().copied()).collect()))
    }

    /// What is missing or odd.
    #[getter]
    fn notes(&self) -> Vec<String> {
        [self.log.notes(), &self.log.news()].concat()
    }

    /// What fusing this log wants where nothing is set.
    #[getter]
    fn suggested(&self) -> PyResult<Config> {
        Config::all_of(&tsdfuse_run::RunConfig::for_log(&self.log))
    }

    /// What a recording of messages holds.
    #[getter]
    fn recorded<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.log.recorded().map(|recorded| to_python(py, recorded)).transpose()
    }

    /// The samples of the inertial measurement unit.
    fn imu<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let samples = py.detach(|| self.log.imu()).or_raise()?;
        let told = PyDict::new(py);
        let rows = |of: fn(&tsdfuse::ImuSample) -> glam::DVec3| samples.iter().map(of).collect::<Vec<_>>();
        use crate::arrays::IntoRows;
        told.set_item(
            "times_ns",
            PyArray1::from_vec(py, samples.iter().map(|s| s.time_ns).collect()),
        )?;
        told.set_item("angular_velocity", rows(|s| s.angular_velocity).into_rows(py)?)?;
        told.set_item("acceleration", rows(|s| s.acceleration).into_rows(py)?)?;
        Ok(told.into_any())
    }

    /// The places of a GNSS receiver.
    fn gnss<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let fixes = py.detach(|| self.log.gnss()).or_raise()?;
        to_python(py, &fixes)
    }

    /// The images, without their bytes.
    #[getter]
    fn images<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let told = |image: &tsdfuse_io::ImageRef| {
            let told = PyDict::new(py);
            told.set_item("name", &image.name)?;
            told.set_item("time_ns", image.time_ns)?;
            told.set_item("camera", to_python(py, &image.camera)?)?;
            told.set_item("distortion", image.distortion)?;
            told.set_item(
                "pose",
                image.pose.as_ref().map(|pose| pose_array(py, pose)).transpose()?,
            )?;
            Ok(told)
        };
        self.log.images().iter().map(told).collect()
    }

    /// The encoded bytes of an image.
    fn read_image<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach(|| self.log.read_image(index)).or_raise()?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// The model of the first sensor, guessed from its first scan where the log does not state it.
    fn guess_sensor<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let stated = self.log.sensors().first().and_then(|sensor| sensor.model.clone());
        let model = match stated {
            Some(model) => Some(model),
            None => {
                let scan = py.detach(|| {
                    let mut scan = self.log.read(0)?;
                    scan.drop_invalid(&self.log.suggested().range);
                    Ok::<_, tsdfuse_io::Error>(scan)
                });
                let scan = scan.or_raise()?;
                py.detach(|| tsdfuse::sensor::guess(&scan.points, scan.rings.as_deref()))
            }
        };
        model.map(|model| to_python(py, &model)).transpose()
    }

    fn __len__(&self) -> PyResult<usize> {
        let told = "a stream has no length: it comes as long as it comes";
        self.log.len().ok_or_else(|| PyTypeError::new_err(told))
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Scan> {
        let scans = self.__len__()?;
        let number = if index < 0 { index + scans as isize } else { index };
        let number = usize::try_from(number).ok().filter(|&number| number < scans);
        let number =
            number.ok_or_else(|| PyIndexError::new_err(format!("no scan {index}: there are {scans} scans")))?;
        let scan = py.detach(|| self.log.read(number)).or_raise()?;
        Ok(self.scan(self.log.scans()[number].sensor, scan, false))
    }

    /// Some scans in order, without invalid returns, read ahead: by their numbers, or a selection.
    #[pyo3(signature = (selection=None))]
    fn select(slf: &Bound<'_, Self>, selection: Option<&Bound<'_, PyAny>>) -> PyResult<Scans> {
        let log = &slf.get().log;
        let reading = match selection.and_then(|numbers| numbers.extract::<Vec<usize>>().ok()) {
            Some(numbers) => log.read_indices(numbers),
            None => log.read_ahead(&self::selection(selection)?),
        };
        Ok(Scans {
            log: slf.clone().unbind(),
            reading: Mutex::new(reading),
        })
    }

    fn __iter__(slf: &Bound<'_, Self>) -> PyResult<Scans> {
        Self::select(slf, None)
    }

    fn __repr__(&self) -> String {
        let scans = match self.log.len() {
            Some(scans) => format!("{scans} scans"),
            None => "a stream of scans".to_owned(),
        };
        let sensors: Vec<_> = self.log.sensors().iter().map(|sensor| sensor.name.as_str()).collect();
        format!(
            "<Log {:?}: {}, {scans} of {}>",
            self.path,
            self.log.format(),
            sensors.join(", ")
        )
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(exception(
            "ConfigError",
            "a log is not pickled: pickle its path, and open it again",
        ))
    }
}

/// Scans in order, read ahead.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Scans {
    log: Py<Log>,
    reading: Mutex<tsdfuse_io::ReadAhead>,
}

#[pymethods]
impl Scans {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Scan>> {
        let log = self.log.get();
        let range = log.log.suggested().range;
        let read = py.detach(|| {
            let mut read = self.reading.lock().unwrap_or_else(PoisonError::into_inner).next()?;
            if let Ok(scan) = &mut read.scan {
                scan.drop_invalid(&range);
            }
            Some(read)
        });
        let Some(read) = read else { return Ok(None) };
        Ok(Some(log.scan(read.sensor, read.scan.or_raise()?, true)))
    }
}
