//! Errors of the engine as exceptions: the same sentences, of the classes in `tsdfuse/errors.py`.

use std::fmt::Display;
use std::path::Path;

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use tsdfuse::fuse::FuseError;
use tsdfuse::map::MapError;
use tsdfuse_run::RunError;

/// An exception of a class of `tsdfuse.errors`, or why that is not there.
pub(crate) fn exception(class: &str, message: impl Display) -> PyErr {
    Python::attach(|py| {
        let made = py
            .import("tsdfuse.errors")
            .and_then(|errors| errors.getattr(class)?.call1((message.to_string(),)));
        made.map_or_else(|error| error, PyErr::from_value)
    })
}

/// An option, or an argument, has an impossible value.
pub(crate) fn wrong(message: impl Display) -> PyErr {
    exception("ConfigError", message)
}

/// What the system said of a file: `FileNotFoundError`, `PermissionError`, …
fn of_system(path: &Path, error: &std::io::Error) -> PyErr {
    Python::attach(|py| match error.raw_os_error() {
        Some(code) => {
            let told = error.to_string();
            let told = told.split(" (os error").next().unwrap_or(&told).to_owned();
            let made = py.get_type::<PyOSError>().call1((code, told, path.to_string_lossy()));
            made.map_or_else(|error| error, PyErr::from_value)
        }
        None => PyOSError::new_err(format!("{}: {error}", path.display())),
    })
}

/// An error that Python can be told.
pub(crate) trait Told {
    fn told(self) -> PyErr;
}

/// The value, or an exception.
pub(crate) trait OrRaise<T> {
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Told> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(Told::told)
    }
}

impl Told for tsdfuse_io::Error {
    fn told(self) -> PyErr {
        match &self {
            Self::Io { path, reason } => of_system(path, reason),
            Self::Format { .. } | Self::Dataset { .. } => exception("FormatError", self),
        }
    }
}

impl Told for tsdfuse_store::StoreError {
    fn told(self) -> PyErr {
        exception("StoreError", self)
    }
}

impl Told for MapError {
    fn told(self) -> PyErr {
        match self {
            Self::OutOfMemory(_) => exception("FullError", self),
            _ => wrong(self),
        }
    }
}

impl Told for FuseError {
    fn told(self) -> PyErr {
        match self {
            Self::Config(_) => wrong(self),
            Self::OutOfMemory(_) => exception("FullError", self),
            _ => exception("BadScanError", self),
        }
    }
}

impl Told for RunError {
    fn told(self) -> PyErr {
        match self {
            Self::Config(_) => wrong(self),
            Self::BadScan(_) => exception("BadScanError", self),
            Self::Full(_) => exception("FullError", self),
            Self::Nothing(_) => exception("EmptyResultError", self),
            Self::Io(error) => error.told(),
            Self::Store(error) => error.told(),
            Self::Map(error) => error.told(),
            Self::Mesh(_) => exception("FullError", self),
            Self::Render(error) => error.told(),
            #[cfg(feature = "gpu")]
            Self::Gpu(_) => exception("DeviceError", self),
            #[cfg(feature = "tiles")]
            Self::Tiles(error) => error.told(),
        }
    }
}

impl Told for tsdfuse_evaluate::Error {
    fn told(self) -> PyErr {
        match self {
            Self::Run(error) => error.told(),
            Self::Io(error) => error.told(),
            Self::Config(_) => wrong(self),
            _ => exception("EmptyResultError", self),
        }
    }
}

/// Errors of one kind only.
macro_rules! told_as {
    ($($class:literal: $($error:ty),*;)*) => {
        $($(
            impl Told for $error {
                fn told(self) -> PyErr {
                    exception($class, self)
                }
            }
        )*)*
    };
}

told_as! {
    "ConfigError": tsdfuse::render::RenderError, tsdfuse::pose::PoseError, tsdfuse_sim::SimulationError, tsdfuse_eval::EvalError,
        tsdfuse_eval::trajectory::TrajectoryError, tsdfuse::trajectory::TrajectoryError, tsdfuse::sensor::PinholeError, tsdfuse::sensor::SensorError;
    "BadScanError": tsdfuse::scan::ScanError;
    "FullError": tsdfuse::mesh::MeshError;
}

#[cfg(feature = "tiles")]
impl Told for tsdfuse_tiles::TilesError {
    fn told(self) -> PyErr {
        match self {
            Self::File(error) => error.told(),
            Self::NoSurface { .. } => exception("EmptyResultError", self),
            _ => exception("StoreError", self),
        }
    }
}
