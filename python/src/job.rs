//! Runs: from a log to files, as the command does it.

use std::path::PathBuf;

use pyo3::prelude::*;
use tsdfuse_run::{Job, Report};

use crate::data::{from_python, to_python};
use crate::error::OrRaise;
use crate::watch::work;

/// Runs a job, which is plain data, and reports.
#[pyfunction]
#[pyo3(signature = (job, progress=None))]
pub(crate) fn run<'py>(
    py: Python<'py>,
    job: &Bound<'py, PyAny>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let mut job: Job = from_python(job, "job")?;
    job.command_line = vec!["tsdfuse.fuse".to_owned()];
    let report: Report = work(py, progress, |stop, teller| job.run(stop, teller).or_raise())?;
    to_python(py, &report)
}

/// Goes on with the job of a store.
#[pyfunction]
#[pyo3(signature = (store, output=None, progress=None))]
pub(crate) fn resume<'py>(
    py: Python<'py>,
    store: PathBuf,
    output: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let store = store.canonicalize().map_err(tsdfuse_io::Error::io(&store)).or_raise()?;
    let report: Report = work(py, progress, |stop, teller| {
        let (mut job, resumed) = Job::of_store(&store).or_raise()?;
        job.store = Some(store);
        job.command_line = vec!["tsdfuse.resume".to_owned()];
        job.outputs.mesh = output.or(job.outputs.mesh);
        job.resume(resumed, stop, teller).or_raise()
    })?;
    to_python(py, &report)
}
