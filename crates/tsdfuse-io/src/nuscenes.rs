//! nuScenes: the tables `v1.0-*/*.json`, and the sweeps of the scanner on the roof, `samples/` and `sweeps/`.
//!
//! A scene is a log: `nuscenes/scene-0061`, although there is no such folder; the data set's folder itself if it has only one scene.
//! Points have their laser, the frame is that of the scanner (x right, y forward, z up). The makers took motion out of the sweeps, to
//! their time, which is their end; when each return was measured is not told. Poses are the vehicle's at that time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use serde::de::{DeserializeOwned, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, Scan, Trajectory};

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::listed::Listed;
use crate::poses;
use crate::scalar::Scalar;
use crate::source::{ImageRef, OpenOptions, ScanRef, Sensor};
use crate::{files, records};

/// The scanner's channel.
const LIDAR: &str = "LIDAR_TOP";
/// What a point is in a file.
const POINT: [(&str, Scalar); 5] = [
    ("x", Scalar::F32),
    ("y", Scalar::F32),
    ("z", Scalar::F32),
    ("intensity", Scalar::F32),
    ("ring", Scalar::F32),
];

#[derive(Deserialize)]
struct Scene {
    token: String,
    name: String,
}

#[derive(Deserialize)]
struct Sample {
    token: String,
    scene_token: String,
}

#[derive(Deserialize)]
struct SampleData {
    sample_token: String,
    ego_pose_token: String,
    calibrated_sensor_token: String,
    /// Microseconds since 1970.
    timestamp: i64,
    filename: String,
    #[serde(default)]
    width: u32,
    #[serde(default)]
    height: u32,
}

#[derive(Deserialize)]
struct SensorRow {
    token: String,
    channel: String,
}

/// A sensor on the vehicle, or the vehicle in the world.
#[derive(Deserialize)]
struct Placed {
    token: String,
    /// Metres.
    translation: [f64; 3],
    /// w x y z.
    rotation: [f64; 4],
    #[serde(default)]
    sensor_token: String,
    #[serde(default)]
    camera_intrinsic: Vec<Vec<f64>>,
}

/// Whether it is the data set or one of its scenes.
pub(crate) fn recognises(path: &Path) -> bool {
    place(path).is_some()
}

/// The data set's folder, that of its tables, and the scene that is named.
fn place(path: &Path) -> Option<(PathBuf, PathBuf, Option<String>)> {
    let tables = |root: &Path| {
        let names = files::names(root).ok()?;
        let versions = names.iter().filter(|name| name.starts_with("v1.0-"));
        let tables = versions.map(|name| root.join(name));
        tables
            .into_iter()
            .find(|tables| tables.join("sample_data.json").is_file())
    };
    if let Some(tables) = tables(path) {
        return Some((path.to_owned(), tables, None));
    }
    let (root, name) = (path.parent()?, path.file_name()?.to_str()?);
    let root = if root.as_os_str().is_empty() {
        Path::new(".")
    } else {
        root
    };
    let scene = name.starts_with("scene-").then(|| name.to_owned())?;
    Some((root.to_owned(), tables(root)?, Some(scene)))
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Listed> {
    let (root, tables, name) = place(path).ok_or_else(|| Error::dataset(path, "is no nuScenes"))?;
    let scene = scene(path, &tables, name.as_deref())?;
    if let Some(other) = options.sensors.iter().find(|name| *name != LIDAR) {
        return Err(Error::dataset(
            path,
            format!("there is no scanner {other:?}; there is {LIDAR}"),
        ));
    }
    let samples: Vec<Sample> = rows(&tables.join("sample.json"), |sample: &Sample| {
        sample.scene_token == scene
    })?;
    let samples: BTreeSet<_> = samples.into_iter().map(|sample| sample.token).collect();
    let sensors: Vec<SensorRow> = rows(&tables.join("sensor.json"), |_| true)?;
    let sensors: BTreeMap<_, _> = sensors
        .into_iter()
        .map(|sensor| (sensor.token, sensor.channel))
        .collect();
    let calibrated: Vec<Placed> = rows(&tables.join("calibrated_sensor.json"), |_| true)?;
    let calibrated: BTreeMap<_, _> = calibrated
        .iter()
        .map(|placed| (placed.token.as_str(), placed))
        .collect();
    let channel = |data: &SampleData| {
        let sensor = &calibrated.get(data.calibrated_sensor_token.as_str())?.sensor_token;
        sensors.get(sensor).map(String::as_str)
    };
    let is_read = |data: &SampleData| {
        let channel = channel(data).unwrap_or_default();
        samples.contains(&data.sample_token) && (channel == LIDAR || channel.starts_with("CAM"))
    };
    let mut all: Vec<SampleData> = rows(&tables.join("sample_data.json"), is_read)?;
    all.sort_by(|a, b| (a.timestamp, &a.filename).cmp(&(b.timestamp, &b.filename)));
    let wanted: BTreeSet<&str> = all.iter().map(|data| data.ego_pose_token.as_str()).collect();
    let ego: Vec<Placed> = rows(&tables.join("ego_pose.json"), |ego: &Placed| {
        wanted.contains(ego.token.as_str())
    })?;
    let ego: BTreeMap<_, _> = ego.iter().map(|placed| (placed.token.as_str(), placed)).collect();
    let in_ego = |data: &SampleData| -> Result<(Pose, &Placed)> {
        let placed = calibrated.get(data.calibrated_sensor_token.as_str());
        let placed = placed.ok_or_else(|| Error::dataset(&data.filename, "is of no calibrated sensor"))?;
        Ok((placed.pose(&tables)?, placed))
    };
    let in_world = |data: &SampleData| {
        ego.get(data.ego_pose_token.as_str())
            .map(|ego| ego.pose(&tables))
            .transpose()
    };
    let given = options
        .poses
        .as_deref()
        .map(|file| Ok((file, poses::read(file)?)))
        .transpose()?;
    let (mut scans, mut places, mut timed, mut images) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut missing, mut body_from_sensor) = (0, Pose::IDENTITY);
    for data in &all {
        let file = root.join(&data.filename);
        let time_ns = data.timestamp.saturating_mul(1000);
        let (ego_from_sensor, placed) = in_ego(data)?;
        let world_from_ego = in_world(data)?;
        if channel(data) != Some(LIDAR) {
            images.extend(placed.camera(data).map(|camera| ImageRef {
                name: files::name(&file),
                time_ns: Some(time_ns),
                camera,
                distortion: None,
                pose: world_from_ego.map(|world_from_ego| world_from_ego * ego_from_sensor),
                path: Some(file),
            }));
            continue;
        }
        if !file.is_file() {
            missing += 1;
            continue;
        }
        body_from_sensor = options.extrinsics.unwrap_or(ego_from_sensor);
        let world_from_ego = match &given {
            Some((_, poses::Poses::Timed(trajectory))) => poses::at(trajectory, time_ns).ok(),
            Some((file, poses::Poses::Listed(_))) => {
                return Err(Error::dataset(file, "has no times, which these sweeps need"));
            }
            None => world_from_ego,
        };
        timed.extend(world_from_ego.map(|pose| (time_ns, pose)));
        scans.push(ScanRef {
            name: files::name(&file),
            sensor: 0,
            time_ns: Some(time_ns),
            pose: world_from_ego.map(|world_from_ego| world_from_ego * body_from_sensor),
        });
        places.push(file);
    }
    timed.dedup_by_key(|(time_ns, _)| *time_ns);
    let mut notes = Vec::new();
    if missing > 0 {
        notes.push(format!("{missing} sweeps of the scene have no file here"));
    }
    let read = move |index: usize| {
        let cloud: Cloud = records::parse(&places[index], &files::read(&places[index])?, &POINT)?;
        Ok(Scan {
            points: cloud.points,
            rings: cloud.rings,
            intensities: cloud.intensities,
            ..Scan::default()
        })
    };
    Ok(Listed {
        format: "nuScenes",
        sensors: vec![Sensor {
            model: tsdfuse::sensor::model("hdl32e"),
            body_from_sensor,
            ..Sensor::new(LIDAR)
        }],
        scans,
        trajectory: Trajectory::new(timed).ok(),
        images,
        notes,
        read: Box::new(read),
    })
}

/// The token of the scene that is meant.
fn scene(path: &Path, tables: &Path, name: Option<&str>) -> Result<String> {
    let scenes: Vec<Scene> = rows(&tables.join("scene.json"), |_| true)?;
    let names = || {
        let names: Vec<_> = scenes.iter().take(12).map(|scene| scene.name.as_str()).collect();
        let more = if scenes.len() > names.len() { ", …" } else { "" };
        format!("{}{more}", names.join(", "))
    };
    let found = match name {
        Some(name) => scenes.iter().find(|scene| scene.name == name),
        None => scenes.first().filter(|_| scenes.len() == 1),
    };
    let reason = || match name {
        Some(name) => format!("there is no scene {name}; there are {}", names()),
        None => format!(
            "holds {} scenes: open one of them, as in {}/{}; there are {}",
            scenes.len(),
            path.display(),
            scenes[0].name,
            names()
        ),
    };
    match found {
        Some(scene) => Ok(scene.token.clone()),
        None if scenes.is_empty() => Err(Error::dataset(tables, "tells of no scenes")),
        None => Err(Error::dataset(path, reason())),
    }
}

impl Placed {
    fn pose(&self, tables: &Path) -> Result<Pose> {
        let [w, x, y, z] = self.rotation;
        let pose = Pose::new(DQuat::from_xyzw(x, y, z, w), DVec3::from_array(self.translation));
        pose.map_err(|e| Error::dataset(tables, format!("{}: {e}", self.token)))
    }

    fn camera(&self, data: &SampleData) -> Option<Pinhole> {
        let row = |row: usize, column: usize| Some(*self.camera_intrinsic.get(row)?.get(column)? as f32);
        Some(Pinhole {
            width: data.width,
            height: data.height,
            fx: row(0, 0)?,
            fy: row(1, 1)?,
            cx: row(0, 2)?,
            cy: row(1, 2)?,
        })
    }
}

/// The rows of a table that are wanted. Tables may be larger than memory: one row at a time is in it.
fn rows<T: DeserializeOwned>(path: &Path, is_wanted: impl Fn(&T) -> bool) -> Result<Vec<T>> {
    let file = BufReader::new(File::open(path).map_err(Error::io(path))?);
    let mut json = serde_json::Deserializer::from_reader(file);
    parse_rows(&mut json, is_wanted).map_err(|e| Error::format(path, e.to_string()))
}

fn parse_rows<'de, T: DeserializeOwned, D: Deserializer<'de>>(
    json: D,
    is_wanted: impl Fn(&T) -> bool,
) -> Result<Vec<T>, D::Error> {
    struct Rows<T, F>(F, std::marker::PhantomData<T>);
    impl<'de, T: DeserializeOwned, F: Fn(&T) -> bool> Visitor<'de> for Rows<T, F> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a table's rows")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut all: A) -> Result<Vec<T>, A::Error> {
            let mut rows = Vec::new();
            while let Some(row) = all.next_element::<T>()? {
                if (self.0)(&row) {
                    rows.push(row);
                }
            }
            Ok(rows)
        }
    }
    json.deserialize_seq(Rows(is_wanted, std::marker::PhantomData))
}

/// All tables, for tests of hostile bytes.
pub(crate) fn parse_tables(bytes: &[u8]) {
    fn table<T: DeserializeOwned>(bytes: &[u8]) {
        let _ = parse_rows(&mut serde_json::Deserializer::from_slice(bytes), |_: &T| true);
    }
    table::<Scene>(bytes);
    table::<Sample>(bytes);
    table::<SampleData>(bytes);
    table::<SensorRow>(bytes);
    table::<Placed>(bytes);
}
