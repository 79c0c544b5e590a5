//! Poses over time.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray3};
use pyo3::prelude::*;
use tsdfuse::Pose;
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::poses::{self, Poses};

use crate::arrays::{column, pose_arrays};
use crate::error::{OrRaise, wrong};

/// Poses in order, with their times where these are known.
#[pyclass(frozen, module = "tsdfuse")]
#[derive(Clone, Default)]
pub(crate) struct Trajectory {
    pub(crate) poses: Vec<(Option<i64>, Pose)>,
    /// Whether these are surely a sensor's poses, not those of a body that carries it.
    pub(crate) is_of_sensor: bool,
    /// Of each scan, where odometry placed it.
    pub(crate) quality: Option<String>,
}

impl Trajectory {
    pub(crate) fn of(poses: Vec<(Option<i64>, Pose)>) -> Self {
        Self {
            poses,
            is_of_sensor: false,
            quality: None,
        }
    }

    /// Where a sensor was during scans.
    pub(crate) fn of_scans(poses: impl IntoIterator<Item = FusedPose>) -> Self {
        let poses = poses.into_iter().map(|fused| (fused.time_ns, fused.pose));
        Self {
            is_of_sensor: true,
            ..Self::of(poses.collect())
        }
    }
}

#[pymethods]
impl Trajectory {
    #[new]
    #[pyo3(signature = (poses, times_ns=None))]
    fn new(poses: &Bound<'_, PyAny>, times_ns: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let poses = crate::arrays::poses("poses", poses)?;
        let times: Vec<Option<i64>> = match times_ns {
            Some(times) => column::<i64>("times_ns", times)?.into_iter().map(Some).collect(),
            None => vec![None; poses.len()],
        };
        if times.len() != poses.len() {
            return Err(wrong(format_args!("{} times for {} poses", times.len(), poses.len())));
        }
        Ok(Self::of(times.into_iter().zip(poses).collect()))
    }

    /// Reads a TUM or KITTI file.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        let poses = poses::read(&path).or_raise()?;
        let read = Self::of(match &poses {
            Poses::Listed(poses) => poses.iter().map(|pose| (None, *pose)).collect(),
            Poses::Timed(trajectory) => {
                let times = trajectory.times_ns().iter().map(|&time| Some(time));
                times.zip(trajectory.poses().iter().copied()).collect()
            }
        });
        Ok(Self {
            is_of_sensor: poses::is_of_sensor(&path),
            ..read
        })
    }

    /// Writes the poses: as TUM where all have times that ascend, else as KITTI.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        let write = if self.is_of_sensor {
            poses::write_of_sensor
        } else {
            poses::write
        };
        write(path, &Poses::of(self.poses.iter().copied())).or_raise()
    }

    /// Nanoseconds (N,); `None` if a pose has no time.
    #[getter]
    fn times_ns<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<i64>>> {
        let times: Option<Vec<i64>> = self.poses.iter().map(|(time, _)| *time).collect();
        times.map(|times| PyArray1::from_vec(py, times))
    }

    /// `world_from_sensor` (N, 4, 4).
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        pose_arrays(py, self.poses.iter().map(|(_, pose)| Some(*pose)))
    }

    /// How well odometry placed each scan.
    #[getter]
    fn quality<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let json = py.import("json")?;
        self.quality
            .as_ref()
            .map(|text| json.call_method1("loads", (text,)))
            .transpose()
    }

    /// The distance travelled, metres.
    #[getter]
    fn length(&self) -> f64 {
        tsdfuse::trajectory::length_m(self.poses.iter().map(|(_, pose)| pose))
    }

    fn __len__(&self) -> usize {
        self.poses.len()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        (self.times_ns(py), self.poses(py)?)
            .into_pyobject(py)?
            .into_any()
            .call_method0("__iter__")
    }

    fn __repr__(&self) -> String {
        let times = if self.poses.iter().all(|(time, _)| time.is_some()) {
            ""
        } else {
            " without times"
        };
        format!(
            "<Trajectory: {} poses{times}, {:.2} m>",
            self.poses.len(),
            self.length()
        )
    }

    fn __getnewargs__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, Option<Bound<'py, PyArray1<i64>>>)> {
        Ok((self.poses(py)?, self.times_ns(py)))
    }
}
