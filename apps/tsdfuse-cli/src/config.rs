//! What a run is told: defaults < `--config` file < `--set` < flags, resolved into one [`RunConfig`].

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};
use tsdfuse::fuse::{CaminalConfig, FuseConfig, KuehnerConfig, Method, PatchConfig, RaycastConfig, RoldaoConfig};
use tsdfuse::mesh::MeshConfig;
use tsdfuse::normals::NormalsConfig;
use tsdfuse::scan::RangeLimits;
use tsdfuse::sensor::Pinhole;
use tsdfuse::surfel::SurfelConfig;
use tsdfuse::{MapConfig, SensorModel};
use tsdfuse_io::Dataset;

use crate::exit::Usage;

/// Everything that decides the result of `tsdfuse fuse`, beside the data.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct RunConfig {
    /// How scans are fused.
    pub(crate) method: Method,
    /// The voxels.
    pub(crate) map: MapConfig,
    /// Which ranges are measurements. Unless they are set, the shortest is the data set's and the longest the sensor's, where
    /// these are known; as method and voxels, they have other defaults for depth cameras.
    pub(crate) range: RangeLimits,
    /// Options of the method `raycast`.
    pub(crate) raycast: RaycastConfig,
    /// Options of the method `normals`.
    pub(crate) normals: NormalsConfig,
    /// Options of the method `surfel`.
    pub(crate) surfel: SurfelConfig,
    /// Options of the method `kuehner`.
    pub(crate) kuehner: KuehnerConfig,
    /// Options of the method `caminal`.
    pub(crate) caminal: CaminalConfig,
    /// Options of the method `roldao`.
    pub(crate) roldao: RoldaoConfig,
    /// Options of the method `patch`.
    pub(crate) patch: PatchConfig,
    /// What becomes surface.
    pub(crate) mesh: MeshConfig,
}

impl RunConfig {
    /// The options of all methods.
    pub(crate) fn methods(&self) -> FuseConfig {
        FuseConfig {
            raycast: self.raycast,
            normals: self.normals,
            surfel: self.surfel,
            kuehner: self.kuehner,
            caminal: self.caminal,
            roldao: self.roldao,
            patch: self.patch,
        }
    }

    /// Whether the method wants to know the sensor, and guesses it from the first scan if nobody says.
    pub(crate) fn wants_sensor(&self) -> bool {
        !matches!(self.method, Method::Raycast | Method::Depth | Method::Roldao)
    }

    fn validate(&self) -> Result<(), Usage> {
        self.map.validate().map_err(Usage::new)?;
        self.methods().validate().map_err(Usage::new)?;
        self.range.validate().map_err(Usage::new)?;
        self.mesh.validate().map_err(Usage::new)
    }
}

/// What the data tell of how to fuse them, where that is not set.
#[derive(Debug, Default)]
pub(crate) struct Suggested {
    /// The sensor, whose longest range is that of the run.
    pub(crate) sensor: Option<SensorModel>,
    /// The shortest range.
    pub(crate) min_range_m: Option<f32>,
    /// The depth camera, for which there are settings of its own.
    pub(crate) camera: Option<Pinhole>,
}

impl Suggested {
    /// What a data set tells.
    pub(crate) fn by(dataset: &Dataset) -> Self {
        Self {
            sensor: dataset.sensor(),
            min_range_m: dataset.min_range_m(),
            camera: dataset.camera(),
        }
    }
}

/// The method for depth cameras; like what follows, for rooms and cameras as a Kinect is.
const DEPTH_CAMERA_METHOD: Method = Method::Depth;
/// Edge of a voxel, metres.
pub(crate) const DEPTH_CAMERA_VOXEL_SIZE_M: f64 = 0.02;
/// Half width of the band, metres; wider only where voxels are set that are larger than a quarter of it.
pub(crate) const DEPTH_CAMERA_TRUNCATION_M: f64 = 0.08;
/// The longest range, metres: noise grows with the square of the range, and a Kinect's is 4 cm there.
pub(crate) const DEPTH_CAMERA_MAX_RANGE_M: f32 = 5.0;

/// Settings, those set later going before those set earlier.
#[derive(Debug, Default)]
pub(crate) struct Layers(Table);

impl Layers {
    /// Settings from a TOML file; the first ones.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Usage::new(format_args!("{}: {e}", path.display())))?;
        let wrong = |error: toml::de::Error| {
            let start = error.span().map_or(0, |span| span.start);
            let number = text.get(..start).map_or(0, |before| before.matches('\n').count());
            let line = text.lines().nth(number).unwrap_or_default().trim();
            let reason = error.message().replace('\n', " ");
            Usage::new(format_args!(
                "{}: line {}, {line}: {reason}",
                path.display(),
                number + 1
            ))
        };
        toml::from_str::<RunConfig>(&text).map_err(&wrong)?;
        Ok(Self(toml::from_str(&text).map_err(&wrong)?))
    }

    /// Sets what a dotted key names; `flag` is for messages.
    pub(crate) fn set(&mut self, flag: &str, key: &str, value: impl Into<Value>) -> Result<()> {
        let wrong = |reason: &str| Usage::new(format_args!("{flag}: {}", reason.trim().replace('\n', " ")));
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

    /// Sets `key=value` as it stands on the command line: the value is TOML, or else text.
    pub(crate) fn set_text(&mut self, setting: &str) -> Result<()> {
        let (key, value) = setting.split_once('=').ok_or_else(|| {
            Usage::new(format_args!(
                "--set {setting}: key=value is wanted, as in map.voxel_size_m=0.1"
            ))
        })?;
        let (key, value) = (key.trim(), value.trim());
        let value = value.parse().unwrap_or_else(|_| Value::from(value));
        self.set(&format!("--set {setting}"), key, value)
    }

    /// Whether a key of a section is set.
    pub(crate) fn has(&self, section: &str, key: &str) -> bool {
        self.0.get(section).is_some_and(|section| section.get(key).is_some())
    }

    /// The whole configuration: what is set, else what the data suggest, else the defaults; checked.
    pub(crate) fn resolve(self, data: &Suggested) -> Result<RunConfig> {
        let [min_range, max_range] = ["min_range_m", "max_range_m"].map(|key| !self.has("range", key));
        let [voxel_size, truncation] = ["voxel_size_m", "truncation_m"].map(|key| !self.has("map", key));
        let method = !self.0.contains_key("method");
        let mut config: RunConfig = Value::Table(self.0).try_into().context("the configuration")?;
        if let Some(min_range_m) = data.min_range_m.filter(|_| min_range) {
            config.range.min_range_m = min_range_m;
        }
        if let Some(sensor) = data.sensor.as_ref().filter(|_| max_range) {
            config.range.max_range_m = sensor.max_range_m;
        }
        if data.camera.is_some() {
            if method {
                config.method = DEPTH_CAMERA_METHOD;
            }
            if voxel_size {
                config.map.voxel_size_m = DEPTH_CAMERA_VOXEL_SIZE_M;
            }
            if truncation {
                config.map.truncation_m = DEPTH_CAMERA_TRUNCATION_M.max(4.0 * config.map.voxel_size_m);
            }
            if max_range {
                config.range.max_range_m = DEPTH_CAMERA_MAX_RANGE_M;
            }
        }
        config.validate()?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> Result<Layers> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.toml");
        std::fs::write(&path, text).unwrap();
        Layers::read(&path)
    }

    fn message<T>(result: Result<T>) -> String {
        let error = result.err().unwrap();
        assert!(error.is::<Usage>());
        error.to_string()
    }

    #[test]
    fn later_settings_go_before_earlier_ones() {
        let mut layers = file("[map]\nvoxel_size_m = 0.1\ntruncation_m = 0.4\nmax_weight = 7").unwrap();
        layers.set_text("map.truncation_m = 1").unwrap();
        layers.set_text("raycast.distance=projective").unwrap();
        layers.set("--voxel-size", "map.voxel_size_m", 0.25).unwrap();
        let config = layers.resolve(&Suggested::default()).unwrap();
        assert_eq!(
            (config.map.voxel_size_m, config.map.truncation_m, config.map.max_weight),
            (0.25, 1.0, 7.0)
        );
        assert_eq!(config.raycast.distance, tsdfuse::fuse::Distance::Projective);
        assert_eq!(config.range, RangeLimits::default());
    }

    #[test]
    fn ranges_are_the_data_sets_and_the_sensors_unless_they_are_set() {
        let sensor = tsdfuse::sensor::model("vlp16").unwrap();
        let data = Suggested {
            sensor: Some(sensor.clone()),
            min_range_m: Some(2.5),
            camera: None,
        };
        let of = |setting: Option<&str>| {
            let mut layers = Layers::default();
            setting.into_iter().for_each(|s| layers.set_text(s).unwrap());
            let range = layers.resolve(&data).unwrap().range;
            (range.min_range_m, range.max_range_m)
        };
        assert_eq!(of(None), (2.5, sensor.max_range_m));
        assert_eq!(of(Some("range.min_range_m=1")), (1.0, sensor.max_range_m));
        assert_eq!(of(Some("range.max_range_m=30")), (2.5, 30.0));
    }

    #[test]
    fn depth_cameras_have_settings_of_their_own_unless_they_are_set() {
        let data = Suggested {
            min_range_m: Some(0.1),
            camera: Some(Pinhole::with_fov(640, 480, 1.0)),
            ..Default::default()
        };
        let of = |settings: &[&str]| {
            let mut layers = Layers::default();
            settings.iter().for_each(|s| layers.set_text(s).unwrap());
            let RunConfig { method, map, range, .. } = layers.resolve(&data).unwrap();
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
        let set = |setting: &str| message(Layers::default().set_text(setting));
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
        let mut layers = Layers::default();
        layers.set_text("method=raycast").unwrap();
        assert!(message(layers.set_text("method.x=1")).contains("method is a value, not a section"));
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
            let mut layers = Layers::default();
            layers.set_text(setting).unwrap();
            message(layers.resolve(&Suggested::default()))
        };
        assert!(resolved("map.voxel_size_m=-1").contains("voxel_size_m"));
        assert!(resolved("range.max_range_m=0.1").contains("max_range_m = 0.1"));
        assert!(resolved("range.min_range_m=nan").contains("min_range_m = NaN"));
        assert!(resolved("normals.min_dot=2").contains("min_dot"));
        assert!(resolved("mesh.min_weight=-1").contains("min_weight"));
    }
}
