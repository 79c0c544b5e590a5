//! The command, and what holds for the whole process.

use std::ffi::OsString;

use pyo3::prelude::*;

use crate::error::wrong;

/// The version of the engine.
#[pyfunction]
pub(crate) fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// Runs the command: `start` starts it again, `arguments` begin with its name. Gives the exit code.
#[pyfunction]
pub(crate) fn command(py: Python<'_>, start: Vec<OsString>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| tsdfuse_cli::run(start, arguments))
}

/// How many threads work.
#[pyfunction]
pub(crate) fn threads(py: Python<'_>) -> usize {
    py.detach(rayon::current_num_threads)
}

/// Sets how many threads work, before the first work.
#[pyfunction]
pub(crate) fn set_threads(count: usize) -> PyResult<()> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count);
    pool.build_global()
        .map_err(|_| wrong("set_threads comes before the first work: there are threads already"))
}
