//! Odometry.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use tsdfuse::ImuSample;
use tsdfuse_odometry::{OdometryConfig, Tracker};
use tsdfuse_run::{Event, Observer};

use crate::arrays::{Rows, column};
use crate::config::Config;
use crate::data::to_python;
use crate::error::{OrRaise, wrong};
use crate::log::{Log, selection};
use crate::scan::Scan;
use crate::trajectory::Trajectory;
use crate::watch::work;

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
    Ok(Trajectory {
        quality: Some(quality),
        ..Trajectory::of_scans(tracked.iter().map(|scan| scan.pose))
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
