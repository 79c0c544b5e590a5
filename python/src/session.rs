//! A run step by step: of a log, or of scans that come from Python, with any backend.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use tsdfuse_io::{Stream, StreamedScan};
use tsdfuse_run::{Event, Setup};

use crate::data::{from_python, to_python};
use crate::error::{OrRaise, wrong};
use crate::log::Log;
use crate::map::{Changes, Map, Pieces};
use crate::mesh::Mesh;
use crate::scan::Scan;
use crate::sensor;
use crate::trajectory::Trajectory;
use crate::watch::work;

/// A log without scans, whose sensors are known: scans come from Python.
struct Pushed(Vec<tsdfuse_io::Sensor>);

impl Stream for Pushed {
    fn format(&self) -> &str {
        "scans from Python"
    }

    fn sensors(&self) -> &[tsdfuse_io::Sensor] {
        &self.0
    }

    fn next(&mut self) -> Option<StreamedScan> {
        None
    }
}

/// A session, and what changed of its surface.
struct Running {
    session: tsdfuse_run::Session,
    changes: Vec<Pieces>,
}

/// A run, step by step.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Session {
    /// `None` once it is closed.
    running: Mutex<Option<Running>>,
}

impl Session {
    /// Works without the interpreter: another thread may be fusing.
    fn with<T: Send>(&self, py: Python<'_>, act: impl FnOnce(&mut Running) -> PyResult<T> + Send) -> PyResult<T> {
        py.detach(|| self.locked(act))
    }

    fn locked<T>(&self, act: impl FnOnce(&mut Running) -> PyResult<T>) -> PyResult<T> {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        act(running.as_mut().ok_or_else(|| wrong("the session is closed"))?)
    }

    /// As [`Self::with`], once all scans are in the map.
    fn settled<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut tsdfuse_run::Session) -> Result<T, tsdfuse_run::RunError> + Send,
    ) -> PyResult<T> {
        self.with(py, |Running { session, .. }| {
            session.wait(&mut tsdfuse_run::Silent).or_raise()?;
            act(session).or_raise()
        })
    }
}

#[pymethods]
impl Session {
    #[new]
    #[pyo3(signature = (setup, log=None, sensor=None, progress=None))]
    fn new(
        py: Python<'_>,
        setup: &Bound<'_, PyAny>,
        log: Option<&Log>,
        sensor: Option<&Bound<'_, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let setup: Setup = from_python(setup, "session")?;
        let log = match log {
            Some(log) => log.log.clone(),
            None => {
                let mut only = tsdfuse_io::Sensor::new("sensor");
                only.model = sensor.map(sensor::model).transpose()?;
                tsdfuse_io::Log::of_stream(Pushed(vec![only]))
            }
        };
        let session = work(py, progress, |_, teller| {
            tsdfuse_run::Session::begin(&log, setup, teller).or_raise()
        })?;
        Ok(Self {
            running: Mutex::new(Some(Running {
                session,
                changes: Vec::new(),
            })),
        })
    }

    /// Reads and fuses the next scan of the log; whether there may be more.
    fn step(&self, py: Python<'_>) -> PyResult<bool> {
        self.with(py, |Running { session, changes }| {
            session.step(&mut |event: Event<'_>| keep(event, changes)).or_raise()
        })
    }

    /// Fuses the rest of the log.
    #[pyo3(signature = (progress=None))]
    fn run(&self, py: Python<'_>, progress: Option<Py<PyAny>>) -> PyResult<()> {
        work(py, progress, |stop, teller| {
            self.locked(|Running { session, .. }| {
                session.stop_by(stop);
                session.run(teller).or_raise()
            })
        })
    }

    /// Fuses a scan that does not come from the log.
    fn fuse(&self, py: Python<'_>, scan: &Scan) -> PyResult<()> {
        let scan = tsdfuse::Scan::clone(&scan.scan);
        self.with(py, |Running { session, changes }| {
            session
                .fuse(0, scan, &mut |event: Event<'_>| keep(event, changes))
                .or_raise()
        })
    }

    /// Ends the fusing.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |Running { session, changes }| {
            session.finish(&mut |event: Event<'_>| keep(event, changes)).or_raise()
        })
    }

    /// Makes all that was fused survive a crash, if there is a store.
    fn commit(&self, py: Python<'_>) -> PyResult<()> {
        self.settled(py, |session| session.commit(&mut tsdfuse_run::Silent))
    }

    /// Lets go of the map and of the store, which others can open then.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(self.running.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }

    /// The pieces of the surface that changed since this was asked last.
    fn changes(&self, py: Python<'_>) -> PyResult<Vec<Changes>> {
        let changes = self.with(py, |running| Ok(std::mem::take(&mut running.changes)))?;
        changes.into_iter().map(|changes| Changes::of(py, changes)).collect()
    }

    /// The surface of the scans so far.
    fn mesh(&self, py: Python<'_>) -> PyResult<Mesh> {
        Mesh::of(py, self.settled(py, tsdfuse_run::Session::mesh)?)
    }

    /// Writes the surface of the scans so far.
    fn write_mesh<'py>(&self, py: Python<'py>, path: PathBuf) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.settled(py, |session| session.write_surface(&path))?)
    }

    /// Saves the map of the scans so far.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.settled(py, |session| session.save_map(&path).map(drop))
    }

    /// A copy of the map, where all of it is in memory.
    fn map(&self, py: Python<'_>) -> PyResult<Map> {
        let map = self.settled(py, |session| Ok(session.map().cloned()))?;
        Map::made(
            map.ok_or_else(|| wrong("the map is not in memory: save it, and load the file"))?,
            Vec::new(),
        )
    }

    /// Scans that are done, fused or skipped.
    #[getter]
    fn done(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |running| Ok(running.session.done()))
    }

    /// The GPU that fuses, if one does.
    #[getter]
    fn device(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.with(py, |running| Ok(running.session.device()))
    }

    /// The poses of the scans that are in the map.
    #[getter]
    fn poses(&self, py: Python<'_>) -> PyResult<Trajectory> {
        let poses = self.with(py, |running| Ok(running.session.poses().to_vec()))?;
        Ok(Trajectory::of_scans(poses))
    }

    /// What was done, as plain data.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let told = self.with(py, |Running { session, .. }| {
            Ok(serde_json::json!({
                "device": session.device(),
                "config": session.config(),
                "totals": session.totals(),
                "odometry": session.odometry(),
                "stopped": session.was_stopped(),
                "map": session.map_report(),
                "paging": session.paging(),
                "scans": session.scans(),
                "skipped_scans": session.skipped(),
                "full": session.full(),
            }))
        })?;
        to_python(py, &told)
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (kind, _error, _traceback))]
    fn __exit__(
        &self,
        py: Python<'_>,
        kind: &Bound<'_, PyAny>,
        _error: &Bound<'_, PyAny>,
        _traceback: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        if kind.is_none() { self.finish(py) } else { Ok(()) }
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        self.done(py).map_or_else(
            |_| "<Session: closed>".to_owned(),
            |done| format!("<Session: {done} scans done>"),
        )
    }
}

/// Keeps what changed of the surface.
fn keep(event: Event<'_>, changes: &mut Vec<Pieces>) {
    if let Event::SurfaceChanged(changed) = event {
        changes.push(Pieces::of(changed));
    }
}
