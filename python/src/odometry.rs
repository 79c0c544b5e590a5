//! Trajectories, and odometry.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{PyArray1, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tsdfuse::{ImuSample, Pose};
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::poses::{self, Poses};
use tsdfuse_odometry::{OdometryConfig, Tracker};
use tsdfuse_run::{Event, Observer};

use crate::arrays::{Rows, column, pose_arrays};
use crate::config::Config;
use crate::data::to_python;
use crate::error::{OrRaise, wrong};
use crate::log::{Log, selection};
use crate::scan::Scan;
use crate::watch::work;

/// Poses in order, with their times where these are known.
#[pyclass(frozen, module = "tsdfuse")]
#[derive(Clone, Default)]
pub(crate) struct Trajectory {
    pub(crate) poses: Vec<(Option<i64>, Pose)>,
    /// Of each scan, where odometry placed it.
    quality: Option<String>,
}

impl Trajectory {
    pub(crate) fn of(poses: Vec<(Option<i64>, Pose)>) -> Self {
        Self { poses, quality: None }
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
        Ok(Self::of(match &poses {
            Poses::Listed(poses) => poses.iter().map(|pose| (None, *pose)).collect(),
            Poses::Timed(trajectory) => {
                let times = trajectory.times_ns().iter().map(|&time| Some(time));
                times.zip(trajectory.poses().iter().copied()).collect()
            }
        }))
    }

    /// Writes the poses: as TUM where all have times that ascend, else as KITTI.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        let fused: Vec<_> = self
            .poses
            .iter()
            .map(|&(time_ns, pose)| FusedPose { time_ns, pose })
            .collect();
        tsdfuse_run::write_poses(&path, &fused).or_raise()
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

/// Tracks or refines the scans of a log.
#[pyfunction]
#[pyo3(signature = (log, *, scans=None, refine=false, loops=true, save_graph=None, config=None, progress=None, **options))]
#[allow(clippy::too_many_arguments)] // keywords
pub(crate) fn track(
    py: Python<'_>,
    log: &Log,
    scans: Option<&Bound<'_, PyAny>>,
    refine: bool,
    loops: bool,
    save_graph: Option<PathBuf>,
    config: Option<&Bound<'_, PyAny>>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Trajectory> {
    let config = Config::layered(config, options)?.0.resolve(&log.log).or_raise()?;
    let selection = selection(scans)?;
    let loops = loops.then_some(config.loops);
    let total = log.log.len().map(|scans| selection.indices(scans).len());
    let (tracked, report) = work(py, progress, |stop, teller| {
        teller.on(Event::Begun {
            scans: total,
            done: 0,
            device: None,
            voxel_size_m: config.map.voxel_size_m,
        });
        let start = std::time::Instant::now();
        let tracked = if refine {
            tsdfuse_run::refine(&log.log, &selection, config.odometry, loops, config.range, stop, teller)
        } else {
            tsdfuse_run::track(&log.log, &selection, config.odometry, loops, config.range, stop)
        };
        let tracked = tracked.or_raise()?;
        if let (Some(path), Some(graph)) = (&save_graph, &tracked.graph) {
            tsdfuse_io::g2o::write(path, graph).or_raise()?;
        }
        let report = tracked.report(start.elapsed().as_secs_f64());
        Ok((tracked.scans, report))
    })?;
    let quality = serde_json::to_string(&serde_json::json!({ "report": report, "scans": tracked })).map_err(wrong)?;
    let poses = tracked.iter().map(|scan| (scan.pose.time_ns, scan.pose.pose)).collect();
    Ok(Trajectory {
        poses,
        quality: Some(quality),
    })
}

/// Tracks scan by scan.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Odometry {
    tracker: Mutex<Tracker>,
    config: Config,
}

#[pymethods]
impl Odometry {
    #[new]
    #[pyo3(signature = (*, config=None, **options))]
    fn new(config: Option<&Bound<'_, PyAny>>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let config = Config::layered(config, options)?;
        let odometry: OdometryConfig = config.resolved()?.odometry;
        Ok(Self {
            tracker: Mutex::new(Tracker::new(odometry)),
            config,
        })
    }

    /// Takes samples of an inertial measurement unit, in the sensor's frame and in order of time: nanoseconds (N,), rates of turn (N, 3),
    /// rad/s, and specific force (N, 3), m/s². They come before the scan during which they were measured.
    fn push_imu(
        &self,
        times_ns: &Bound<'_, PyAny>,
        angular_velocity: &Bound<'_, PyAny>,
        acceleration: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let times = column::<i64>("times_ns", times_ns)?;
        let (rates, forces) = (
            Rows::<f64>::of("angular_velocity", angular_velocity)?,
            Rows::<f64>::of("acceleration", acceleration)?,
        );
        let (rates, forces) = (rates.vectors()?, forces.vectors()?);
        if times.len() != rates.len() || times.len() != forces.len() {
            let counts = format_args!(
                "{} times, {} rates and {} forces",
                times.len(),
                rates.len(),
                forces.len()
            );
            return Err(wrong(format_args!("{counts} are no samples")));
        }
        let samples = times
            .into_iter()
            .zip(rates)
            .zip(forces)
            .map(|((time_ns, rate), force)| ImuSample {
                time_ns,
                angular_velocity: *rate,
                acceleration: *force,
                orientation: None,
            });
        let mut tracker = self.tracker.lock().unwrap_or_else(PoisonError::into_inner);
        tracker.push_imu(samples);
        Ok(())
    }

    /// Takes a scan; those that are placed by now come back, with how well.
    fn push<'py>(&self, py: Python<'py>, scan: &Scan) -> PyResult<Vec<(Scan, Bound<'py, PyAny>)>> {
        let range = self.config.resolved()?.range;
        let placed = py.detach(|| {
            let mut tracker = self.tracker.lock().unwrap_or_else(PoisonError::into_inner);
            tracker.push(tsdfuse::Scan::clone(&scan.cleaned(&range)));
            std::iter::from_fn(|| tracker.pop()).collect::<Vec<_>>()
        });
        told(py, placed, scan)
    }

    /// The scans that still wait.
    fn finish<'py>(&self, py: Python<'py>) -> PyResult<Vec<(Scan, Bound<'py, PyAny>)>> {
        let placed = py.detach(|| {
            let mut tracker = self.tracker.lock().unwrap_or_else(PoisonError::into_inner);
            tracker.finish();
            std::iter::from_fn(|| tracker.pop()).collect::<Vec<_>>()
        });
        told(py, placed, &tsdfuse::Scan::default().into())
    }
}

/// Placed scans, which are of the same sensor as `like`.
fn told<'py>(
    py: Python<'py>,
    placed: Vec<tsdfuse_odometry::Tracked>,
    like: &Scan,
) -> PyResult<Vec<(Scan, Bound<'py, PyAny>)>> {
    let told = |tracked: tsdfuse_odometry::Tracked| {
        let quality = to_python(py, &tracked.quality)?;
        Ok((
            Scan {
                origin: like.origin.clone(),
                ..tracked.scan.into()
            },
            quality,
        ))
    };
    placed.into_iter().map(told).collect()
}
