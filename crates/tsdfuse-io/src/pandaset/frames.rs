//! The frames of a sequence: poses, times, and which of them have a scan.

use std::collections::BTreeMap;
use std::path::Path;

use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor};
use tsdfuse::Trajectory;
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::pose::{Pose, PoseError};
use tsdfuse::trajectory::ns_after;

use crate::error::{Error, Result};
use crate::{files, present};

/// What a `lidar` folder holds. The scan `NN.pkl.gz` belongs to entry NN of `poses.json` and of `timestamps.json`.
#[derive(Debug)]
pub(super) struct Frames {
    /// `world_from_ego` of each frame.
    pub(super) poses: Vec<Pose>,
    /// Seconds of each frame, ascending: when its sweep ended.
    times: Option<Vec<f64>>,
    /// The names of the scans' files by frame number.
    pub(super) scans: BTreeMap<usize, String>,
    /// Names that look like scans but have no number.
    unnumbered: Vec<String>,
}

impl Frames {
    /// Lists the folder and reads its two JSON files.
    pub(super) fn open(lidar: &Path) -> Result<Self> {
        let (scans, unnumbered) = scan_files(lidar)?;
        let path = lidar.join("poses.json");
        let poses = parse_poses(&path, &files::read(&path)?)?;
        let times = lidar.join("timestamps.json");
        let read = || parse_times(&times, &files::read(&times)?, poses.len());
        let times = present::file(&times)?.then(read).transpose()?;
        Ok(Self {
            poses,
            times,
            scans,
            unnumbered,
        })
    }

    /// When the frame's sweep ended, seconds.
    pub(super) fn time(&self, frame: usize) -> Option<f64> {
        self.times.as_ref()?.get(frame).copied()
    }

    /// `world_from_ego` over time.
    pub(super) fn trajectory(&self) -> Option<Trajectory> {
        let times_ns = self.times.as_ref()?.iter().map(|&secs| ns_after(0, secs));
        Trajectory::new(times_ns.zip(self.poses.iter().copied()).collect()).ok()
    }

    /// The frame before, from whose pose the sensor comes (for the first one: the frame after), and the seconds until it.
    pub(super) fn neighbour(&self, frame: usize) -> Option<(usize, f64)> {
        let other = frame.checked_sub(1).unwrap_or(1);
        Some((other, self.time(other)? - self.time(frame)?))
    }

    /// What is missing, one sentence each.
    pub(super) fn notes(&self) -> Vec<String> {
        let known = 0..self.poses.len();
        let no_scan: Vec<_> = known.clone().filter(|n| !self.scans.contains_key(n)).collect();
        let no_pose: Vec<_> = self.scans.keys().copied().filter(|n| !known.contains(n)).collect();
        let mut notes = Vec::new();
        if !no_scan.is_empty() {
            notes.push(format!("{} a pose but no scan", frames_have(&no_scan)));
        }
        if !no_pose.is_empty() {
            notes.push(format!("{} a scan but no pose: skipped", frames_have(&no_pose)));
        }
        if !self.unnumbered.is_empty() {
            notes.push(format!(
                "no frame's number is the name of {}: skipped",
                self.unnumbered.join(", ")
            ));
        }
        let still = "all returns of a scan are placed from one pose (no deskewing)";
        match &self.times {
            None => notes.push(format!("timestamps.json is missing: {still}")),
            Some(times) if times.len() < 2 => notes.push(format!("there is only one pose: {still}")),
            Some(_) => {}
        }
        notes
    }
}

/// The names of the scans in a folder by number, and the names of pickles without one.
pub(super) fn scan_files(lidar: &Path) -> Result<(BTreeMap<usize, String>, Vec<String>)> {
    let (mut scans, mut unnumbered) = (BTreeMap::new(), Vec::new());
    for name in files::names(lidar)? {
        let Some(stem) = name.strip_suffix(".pkl.gz").or_else(|| name.strip_suffix(".pkl")) else {
            continue;
        };
        let digits = !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_digit());
        match stem.parse().ok().filter(|_| digits) {
            None => unnumbered.push(name),
            Some(number) => {
                if let Some(other) = scans.insert(number, name.clone()) {
                    return Err(Error::dataset(
                        lidar,
                        format!("has two scans of frame {number}: {other} and {name}"),
                    ));
                }
            }
        }
    }
    Ok((scans, unnumbered))
}

#[derive(serde::Deserialize)]
struct VehiclePose {
    position: Position,
    heading: Heading,
}

#[derive(serde::Deserialize)]
struct Position {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(serde::Deserialize)]
struct Heading {
    w: f64,
    x: f64,
    y: f64,
    z: f64,
}

/// Parses `poses.json`: `world_from_ego` of each frame. `path` is for messages.
///
/// # Errors
/// Names the file, the frame and the reason.
pub(crate) fn parse_poses(path: &Path, bytes: &[u8]) -> Result<Vec<Pose>> {
    let poses: Vec<VehiclePose> = parse_list(path, bytes)?;
    let pose = |(
        frame,
        VehiclePose {
            position: p,
            heading: q,
        },
    )| {
        let heading = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
        Pose::new(heading, DVec3::new(p.x, p.y, p.z)).map_err(|e| {
            let reason = match e {
                PoseError::NotRigid(_) => format!("its heading has length {}, not 1", heading.length()),
                PoseError::NotFinite => e.to_string(),
            };
            Error::format(path, format!("frame {frame}: {reason}"))
        })
    };
    poses.into_iter().enumerate().map(pose).collect()
}

/// Parses `timestamps.json`: ascending seconds, as many as there are poses. `path` is for messages.
///
/// # Errors
/// Names the file, the frame and the reason.
pub(crate) fn parse_times(path: &Path, bytes: &[u8], poses: usize) -> Result<Vec<f64>> {
    let times: Vec<f64> = parse_list(path, bytes)?;
    if times.len() != poses {
        let reason = format!("{} times, but poses.json has {poses} poses", times.len());
        return Err(Error::format(path, reason));
    }
    let wrong = times.windows(2).position(|w| !matches!(w, [a, b] if a < b));
    match wrong {
        None => Ok(times),
        Some(before) => {
            let reason = format!("frame {}: its time is not after that of frame {before}", before + 1);
            Err(Error::format(path, reason))
        }
    }
}

/// Parses a JSON list with one entry a frame, so that an error can name the frame.
fn parse_list<T: DeserializeOwned>(path: &Path, bytes: &[u8]) -> Result<Vec<T>> {
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let mut entries = Vec::new();
    let read = List(&mut entries).deserialize(&mut json);
    read.map_err(|e| Error::format(path, format!("frame {}: {e}", entries.len())))?;
    json.end().map_err(|e| Error::format(path, e.to_string()))?;
    Ok(entries)
}

/// A list whose entries are kept even if a later one is wrong.
struct List<'v, T>(&'v mut Vec<T>);

impl<'de, T: DeserializeOwned> DeserializeSeed<'de> for List<'_, T> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<(), D::Error> {
        json.deserialize_seq(self)
    }
}

impl<'de, T: DeserializeOwned> Visitor<'de> for List<'_, T> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a list with one entry a frame")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<(), A::Error> {
        while let Some(entry) = entries.next_element()? {
            self.0.push(entry);
        }
        Ok(())
    }
}

/// `frames 0-35 and 40 have`, from ascending numbers.
fn frames_have(numbers: &[usize]) -> String {
    let ranges: Vec<String> = (numbers.chunk_by(|a, b| a + 1 == *b))
        .map(|run| match *run {
            [first, .., last] => format!("{first}-{last}"),
            _ => run.iter().map(usize::to_string).collect(),
        })
        .collect();
    let list = match ranges.as_slice() {
        [others @ .., last] if !others.is_empty() => format!("{} and {last}", others.join(", ")),
        _ => ranges.concat(),
    };
    match numbers {
        [_] => format!("frame {list} has"),
        _ => format!("frames {list} have"),
    }
}
