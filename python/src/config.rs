//! Settings, in layers: what was set, over what a log suggests, over the defaults.

use std::path::PathBuf;

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use serde_json::Value;
use tsdfuse_run::{RunConfig, Settings};

use crate::data::{from_python, to_python};
use crate::error::{OrRaise, wrong};

/// What is set of all options; the rest is what a log suggests, or the default.
#[pyclass(frozen, module = "tsdfuse", eq)]
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Config(pub(crate) Settings);

/// The options that have names of their own, and their keys.
pub(crate) const NAMED: [(&str, &str); 7] = [
    ("method", "method"),
    ("voxel_size", "map.voxel_size_m"),
    ("truncation", "map.truncation_m"),
    ("max_weight", "map.max_weight"),
    ("min_range", "range.min_range_m"),
    ("max_range", "range.max_range_m"),
    ("min_weight", "mesh.min_weight"),
];

/// Sets a value, or each value of a dictionary.
fn set(settings: &mut Settings, origin: &str, key: &str, value: &Value) -> PyResult<()> {
    match value {
        Value::Null => Ok(()),
        Value::Object(section) => section
            .iter()
            .try_for_each(|(name, value)| set(settings, origin, &format!("{key}.{name}"), value)),
        value => {
            let value = toml::Value::try_from(value).map_err(wrong)?;
            settings.set(origin, key, value).or_raise()
        }
    }
}

impl Config {
    /// A file, a dictionary, another configuration, or nothing.
    fn of(value: Option<&Bound<'_, PyAny>>) -> PyResult<Settings> {
        let Some(value) = value else {
            return Ok(Settings::default());
        };
        if let Ok(config) = value.cast::<Self>() {
            return Ok(config.get().0.clone());
        }
        if value.cast::<PyMapping>().is_ok() {
            let mut settings = Settings::default();
            let given: serde_json::Map<String, Value> = from_python(value, "config")?;
            for (key, value) in &given {
                set(&mut settings, &format!("config: {key}"), key, value)?;
            }
            return Ok(settings);
        }
        let path: PathBuf = value
            .extract()
            .map_err(|_| wrong("config must be a Config, a dictionary or the path of a TOML file"))?;
        Settings::read(&path).or_raise()
    }

    /// Options by name over a configuration.
    pub(crate) fn layered(config: Option<&Bound<'_, PyAny>>, named: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut settings = Self::of(config)?;
        let given: serde_json::Map<String, Value> = match named {
            Some(named) => from_python(named, "options")?,
            None => serde_json::Map::default(),
        };
        for (name, value) in &given {
            let Some((_, key)) = NAMED.iter().find(|(known, _)| known == name) else {
                let known = NAMED.map(|(known, _)| known).join(", ");
                return Err(wrong(format_args!(
                    "no option {name}; there are {known}, and config= for all others"
                )));
            };
            set(&mut settings, name, key, value)?;
        }
        Ok(Self(settings))
    }

    /// All options: what is set, or the default.
    pub(crate) fn resolved(&self) -> PyResult<RunConfig> {
        self.0.resolve_over(&RunConfig::default()).or_raise()
    }

    /// Whether the method is set.
    pub(crate) fn has_method(&self) -> bool {
        self.0.texts().iter().any(|text| text.starts_with("method="))
    }

    /// Everything set as it is in a configuration.
    pub(crate) fn all_of(config: &RunConfig) -> PyResult<Self> {
        let Ok(Value::Object(sections)) = serde_json::to_value(config) else {
            return Err(wrong("the configuration is no table"));
        };
        let mut settings = Settings::default();
        for (key, value) in &sections {
            set(&mut settings, key, key, value)?;
        }
        Ok(Self(settings))
    }
}

#[pymethods]
impl Config {
    #[new]
    #[pyo3(signature = (config=None, /, **options))]
    fn new(config: Option<&Bound<'_, PyAny>>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let config = Self::layered(config, options)?;
        config.resolved()?;
        Ok(config)
    }

    /// What is set: a dictionary of sections.
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.0)
    }

    /// All options, those of a log's suggestions and the defaults included: a dictionary of sections.
    #[pyo3(signature = (log=None))]
    fn resolve<'py>(&self, py: Python<'py>, log: Option<&Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        let resolved = match log {
            Some(log) => {
                let suggested = log.getattr("suggested")?.extract::<PyRef<'_, Self>>()?.resolved()?;
                self.0.resolve_over(&suggested).or_raise()?
            }
            None => self.resolved()?,
        };
        to_python(py, &resolved)
    }

    fn __getitem__<'py>(&self, py: Python<'py>, key: &str) -> PyResult<Bound<'py, PyAny>> {
        let mut value = self.resolve(py, None)?;
        for name in key.split('.') {
            value = value.get_item(name)?;
        }
        Ok(value)
    }

    fn __repr__(&self) -> PyResult<String> {
        let usual = Self::all_of(&RunConfig::default())?.0.texts();
        let set = self.0.texts().into_iter().filter(|text| !usual.contains(text));
        Ok(format!("Config({})", set.collect::<Vec<_>>().join(", ")))
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>,)> {
        Ok((self.settings(py)?,))
    }
}
