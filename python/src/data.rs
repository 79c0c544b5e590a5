//! Plain data in both directions: dictionaries, lists, numbers and text, by way of JSON.

use pyo3::intern;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::wrong;

/// A value of the engine as Python's own dictionaries, lists, numbers and text.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(wrong)?;
    py.import(intern!(py, "json"))?
        .call_method1(intern!(py, "loads"), (text,))
}

/// A value of the engine from what Python says; `what` is for messages.
pub(crate) fn from_python<T: DeserializeOwned>(value: &Bound<'_, PyAny>, what: &str) -> PyResult<T> {
    let py = value.py();
    let plain = py
        .import(intern!(py, "tsdfuse._plain"))?
        .getattr(intern!(py, "plain"))?;
    let text = py
        .import(intern!(py, "json"))?
        .call_method1(intern!(py, "dumps"), (plain.call1((value,))?,))?;
    serde_json::from_str(&text.extract::<String>()?).map_err(|error| {
        // Where in the text it is does not matter to who gave an object.
        let told = error.to_string();
        let told = told.split(" at line ").next().unwrap_or(&told);
        wrong(format_args!("{what}: {told}"))
    })
}
