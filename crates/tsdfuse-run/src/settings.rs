//! Settings in layers: defaults < what the log suggests < a TOML file < single keys, resolved into one [`RunConfig`].

use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};
use tsdfuse::MapConfig;
use tsdfuse_io::{Log, OpenOptions};

use crate::config::RunConfig;
use crate::error::{Result, RunError};

/// What was set of a [`RunConfig`], later settings going before earlier ones. The rest is the log's or the default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings(Table);

impl Settings {
    /// Settings from a TOML file.
    ///
    /// # Errors
    /// [`RunError::Config`] names the file, the line and what is possible there.
    pub fn read(path: &Path) -> Result<Self> {
        let text =
            std::fs::read_to_string(path).map_err(|e| RunError::config(format_args!("{}: {e}", path.display())))?;
        let wrong = |error: toml::de::Error| {
            let start = error.span().map_or(0, |span| span.start);
            let number = text.get(..start).map_or(0, |before| before.matches('\n').count());
            let line = text.lines().nth(number).unwrap_or_default().trim();
            let reason = error.message().replace('\n', " ");
            RunError::config(format_args!(
                "{}: line {}, {line}: {reason}",
                path.display(),
                number + 1
            ))
        };
        toml::from_str::<RunConfig>(&text).map_err(&wrong)?;
        Ok(Self(toml::from_str(&text).map_err(&wrong)?))
    }

    /// Sets what a dotted key names, for instance `map.voxel_size_m`; `origin` is for messages.
    ///
    /// # Errors
    /// [`RunError::Config`] for keys and values that a [`RunConfig`] cannot have.
    pub fn set(&mut self, origin: &str, key: &str, value: impl Into<Value>) -> Result<()> {
        let wrong = |reason: &str| RunError::config(format_args!("{origin}: {}", reason.trim().replace('\n', " ")));
        let (sections, name) = key.rsplit_once('.').unwrap_or(("", key));
        let mut table = &mut self.0;
        for section in sections.split('.').filter(|s| !s.is_empty()) {
            let entry = table.entry(section).or_insert_with(|| Table::new().into());
            let reason = format!("{section} is a value, not a section");
            table = entry.as_table_mut().ok_or_else(|| wrong(&reason))?;
        }
        table.insert(name.to_owned(), value.into());
        RunConfig::deserialize(Value::Table(self.0.clone())).map_err(|e| wrong(e.message()))?;
        Ok(())
    }

    /// Sets `key=value`; the value is TOML, or else text.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn set_text(&mut self, setting: &str) -> Result<()> {
        let (key, value) = setting.split_once('=').ok_or_else(|| {
            RunError::config(format_args!(
                "--set {setting}: key=value is wanted, as in map.voxel_size_m=0.1"
            ))
        })?;
        let (key, value) = (key.trim(), value.trim());
        let value = value.parse().unwrap_or_else(|_| Value::from(value));
        self.set(&format!("--set {setting}"), key, value)
    }

    /// Sets the fields of a map's configuration that are not set yet.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn set_missing(&mut self, origin: &str, map: &MapConfig) -> Result<()> {
        for (key, value) in [
            ("voxel_size_m", map.voxel_size_m),
            ("truncation_m", map.truncation_m),
            ("max_weight", map.max_weight.into()),
        ] {
            if !self.has("map", key) {
                self.set(origin, &format!("map.{key}"), value)?;
            }
        }
        Ok(())
    }

    /// Whether a key of a section is set.
    pub fn has(&self, section: &str, key: &str) -> bool {
        self.0.get(section).is_some_and(|section| section.get(key).is_some())
    }

    /// These without a section.
    pub fn without(&self, section: &str) -> Self {
        let mut left = self.clone();
        left.0.remove(section);
        left
    }

    /// All that is set, as [`Self::set_text`] takes it.
    pub fn texts(&self) -> Vec<String> {
        let mut texts = Vec::new();
        for (name, value) in &self.0 {
            match value {
                Value::Table(section) => {
                    texts.extend(section.iter().map(|(key, value)| format!("{name}.{key}={value}")));
                }
                value => texts.push(format!("{name}={value}")),
            }
        }
        texts.iter_mut().for_each(|text| *text = text.replace('"', ""));
        texts
    }

    /// Opens a log as these settings ask for.
    ///
    /// # Errors
    /// As [`tsdfuse_io::open_with`].
    pub fn open(&self, path: &Path, options: &OpenOptions) -> Result<Log> {
        let log = tsdfuse_io::open_with(path, options)?;
        if !self.0.contains_key("sensor") {
            return Ok(log);
        }
        let correction = self.resolve(&log)?.sensor;
        Ok(log.with_correction(&correction)?)
    }

    /// The whole configuration: what is set, else what the log suggests, else the defaults; checked.
    ///
    /// # Errors
    /// [`RunError::Config`] for options that do not fit together.
    pub fn resolve(&self, log: &Log) -> Result<RunConfig> {
        self.resolve_over(&RunConfig::for_log(log))
    }

    /// As [`Self::resolve`], over other defaults.
    ///
    /// # Errors
    /// As [`Self::resolve`].
    pub fn resolve_over(&self, defaults: &RunConfig) -> Result<RunConfig> {
        let mut config: RunConfig = Value::Table(self.0.clone()).try_into().map_err(RunError::config)?;
        if !self.0.contains_key("method") {
            config.method = defaults.method;
        }
        if !self.has("range", "min_range_m") {
            config.range.min_range_m = defaults.range.min_range_m;
        }
        if !self.has("range", "max_range_m") {
            config.range.max_range_m = defaults.range.max_range_m;
        }
        let sensor = &defaults.sensor;
        if !self.has("sensor", "elevation_correction_deg") {
            config.sensor.elevation_deg = sensor.elevation_deg;
        }
        if !self.has("sensor", "range_correction_m") {
            config.sensor.range_m = sensor.range_m;
        }
        if !self.has("sensor", "beam_corrections") {
            config.sensor.beams.clone_from(&sensor.beams);
        }
        if !self.has("map", "voxel_size_m") {
            config.map.voxel_size_m = defaults.map.voxel_size_m;
        }
        if !self.has("map", "truncation_m") {
            // A band that suits the default voxels need not suit larger ones.
            let least = if defaults.map == MapConfig::default() {
                0.0
            } else {
                4.0 * config.map.voxel_size_m
            };
            config.map.truncation_m = defaults.map.truncation_m.max(least);
        }
        config.validate()?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::fuse::Method;
    use tsdfuse::scan::RangeLimits;

    fn file(text: &str) -> Result<Settings> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.toml");
        std::fs::write(&path, text).unwrap();
        Settings::read(&path)
    }

    fn message<T>(result: Result<T>) -> String {
        match result.err().unwrap() {
            RunError::Config(text) => text,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn later_settings_go_before_earlier_ones() {
        let mut settings = file("[map]\nvoxel_size_m = 0.1\ntruncation_m = 0.4\nmax_weight = 7").unwrap();
        settings.set_text("map.truncation_m = 1").unwrap();
        settings.set_text("raycast.distance=projective").unwrap();
        settings.set("--voxel-size", "map.voxel_size_m", 0.25).unwrap();
        let config = settings.resolve_over(&RunConfig::default()).unwrap();
        assert_eq!(
            (config.map.voxel_size_m, config.map.truncation_m, config.map.max_weight),
            (0.25, 1.0, 7.0)
        );
        assert_eq!(config.raycast.distance, tsdfuse::fuse::Distance::Projective);
        assert_eq!(config.range, RangeLimits::default());
    }

    #[test]
    fn settings_read_back_from_their_texts() {
        let mut settings = Settings::default();
        for text in [
            "method=normals",
            "map.max_weight=9",
            "raycast.distance=projective",
            "patch.carve=false",
        ] {
            settings.set_text(text).unwrap();
        }
        let mut again = Settings::default();
        settings.texts().iter().for_each(|text| again.set_text(text).unwrap());
        assert_eq!((&again, again.texts().len()), (&settings, 4));
        let json = serde_json::to_string(&settings).unwrap();
        assert_eq!(serde_json::from_str::<Settings>(&json).unwrap(), settings);
    }

    #[test]
    fn what_a_log_suggests_counts_unless_it_is_set() {
        let log = RunConfig {
            range: RangeLimits {
                min_range_m: 2.5,
                max_range_m: 100.0,
            },
            ..RunConfig::default()
        };
        let of = |setting: Option<&str>| {
            let mut settings = Settings::default();
            setting.into_iter().for_each(|s| settings.set_text(s).unwrap());
            let range = settings.resolve_over(&log).unwrap().range;
            (range.min_range_m, range.max_range_m)
        };
        assert_eq!(of(None), (2.5, 100.0));
        assert_eq!(of(Some("range.min_range_m=1")), (1.0, 100.0));
        assert_eq!(of(Some("range.max_range_m=30")), (2.5, 30.0));
    }

    #[test]
    fn depth_cameras_have_settings_of_their_own_unless_they_are_set() {
        let camera = RunConfig {
            method: Method::Depth,
            map: MapConfig {
                voxel_size_m: 0.02,
                truncation_m: 0.08,
                ..MapConfig::default()
            },
            range: RangeLimits {
                min_range_m: 0.1,
                max_range_m: 5.0,
            },
            ..RunConfig::default()
        };
        let of = |texts: &[&str]| {
            let mut settings = Settings::default();
            texts.iter().for_each(|s| settings.set_text(s).unwrap());
            let RunConfig { method, map, range, .. } = settings.resolve_over(&camera).unwrap();
            let map = (map.voxel_size_m, map.truncation_m);
            (method, map, (range.min_range_m, range.max_range_m))
        };
        assert_eq!(of(&[]), (Method::Depth, (0.02, 0.08), (0.1, 5.0)));
        let set = [
            "method=normals",
            "map.voxel_size_m=0.05",
            "range.max_range_m=200",
            "range.min_range_m=0.5",
        ];
        assert_eq!(of(&set), (Method::Normals, (0.05, 0.2), (0.5, 200.0)));
        assert_eq!(of(&["map.truncation_m=0.05"]).1, (0.02, 0.05));
        assert_eq!(of(&["map.voxel_size_m=0.01"]).1, (0.01, 0.08));
    }

    #[test]
    fn wrong_keys_and_values_are_named_with_what_is_possible() {
        let set = |setting: &str| message(Settings::default().set_text(setting));
        let told = set("map.voxel=0.1");
        assert!(
            told.starts_with("--set map.voxel=0.1: unknown field `voxel`, expected one of `voxel_size_m`"),
            "{told}"
        );
        assert!(set("colour=red").contains("unknown field `colour`, expected one of `method`, `map`"));
        assert!(set("method=magic").contains("unknown variant `magic`, expected"));
        assert!(set("map.voxel_size_m=big").contains("invalid type: string \"big\", expected f64"));
        assert!(set("map=3").contains("invalid type"));
        assert!(set("map").contains("key=value is wanted"));
        let mut settings = Settings::default();
        settings.set_text("method=raycast").unwrap();
        assert!(message(settings.set_text("method.x=1")).contains("method is a value, not a section"));
        let told = message(file("method = \"raycast\"\n\n[map]\nvoxel = 1"));
        assert!(
            told.contains("run.toml: line 4, voxel = 1: unknown field `voxel`, expected one of"),
            "{told}"
        );
        assert!(message(file("[map")).contains("run.toml: line 1, [map: "));
        let told = message(file("[map]\nvoxel_size_m = 'big'"));
        assert!(
            told.contains("line 2, voxel_size_m = 'big': invalid type: string"),
            "{told}"
        );
    }

    #[test]
    fn values_without_sense_are_refused() {
        let resolved = |setting: &str| {
            let mut settings = Settings::default();
            settings.set_text(setting).unwrap();
            message(settings.resolve_over(&RunConfig::default()))
        };
        assert!(resolved("map.voxel_size_m=-1").contains("voxel_size_m"));
        assert!(resolved("range.max_range_m=0.1").contains("max_range_m = 0.1"));
        assert!(resolved("range.min_range_m=nan").contains("min_range_m = NaN"));
        assert!(resolved("normals.min_dot=2").contains("min_dot"));
        assert!(resolved("mesh.min_weight=-1").contains("min_weight"));
    }
}
