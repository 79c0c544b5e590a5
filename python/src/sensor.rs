//! Sensor models: by name, or as dictionaries.

use pyo3::prelude::*;
use tsdfuse::SensorModel;

use crate::data::{from_python, to_python};
use crate::error::{OrRaise, wrong};

/// The names of all sensors that are known.
#[pyfunction]
pub(crate) fn sensors() -> Vec<&'static str> {
    tsdfuse::sensor::names().to_vec()
}

/// The model of a sensor: a dictionary.
#[pyfunction]
pub(crate) fn sensor<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    to_python(py, &by_name(name)?)
}

fn by_name(name: &str) -> PyResult<SensorModel> {
    let known = || tsdfuse::sensor::names().join(", ");
    tsdfuse::sensor::model(name).ok_or_else(|| wrong(format_args!("no sensor {name}; there are {}", known())))
}

/// The model that Python names, or describes as a dictionary.
pub(crate) fn model(value: &Bound<'_, PyAny>) -> PyResult<SensorModel> {
    if let Ok(name) = value.extract::<String>() {
        return by_name(&name);
    }
    let model: SensorModel = from_python(value, "sensor")?;
    model.check().or_raise()?;
    Ok(model)
}
