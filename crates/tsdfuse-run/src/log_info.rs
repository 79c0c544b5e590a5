//! What lies in a log: its sensors, scans, times and extent, from a sample of its scans.

use std::path::{Path, PathBuf};

use serde::Serialize;
use tsdfuse::glam::DVec3;
use tsdfuse::scan::{Dropped, RangeLimits};
use tsdfuse::sensor::{Pinhole, SensorCorrection};
use tsdfuse::trajectory::length_m;
use tsdfuse::{Scan, SensorModel};
use tsdfuse_io::{Log, OpenOptions, Recorded, ScanRef};

use crate::error::{Result, RunError};

/// How far reading is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// So many scans will be read.
    Begun(usize),
    /// One more was read.
    Scan,
}

/// What lies in a log.
#[derive(Debug, Serialize)]
pub struct LogInfo {
    /// The log.
    pub path: PathBuf,
    /// Its format.
    pub format: String,
    /// How many scans it has.
    pub scans: usize,
    /// The model of the first sensor, as far as it is known or was guessed.
    pub sensor: Option<SensorModel>,
    /// The names of all sensors.
    pub sensors: Vec<String>,
    /// Whether the sensor's model was guessed from a scan.
    pub sensor_guessed: bool,
    /// Each point is turned up by this: a known error of the sensor's elevations.
    #[serde(flatten)]
    pub correction: SensorCorrection,
    /// The camera, where the scans are depth images.
    pub camera: Option<Pinhole>,
    /// Median rate of the scans.
    pub rate_hz: Option<f64>,
    /// From the first scan to the last.
    pub duration_secs: Option<f64>,
    /// How many of the scans have a pose.
    pub placed_scans: usize,
    /// Length of the line through all poses.
    pub path_length_m: f64,
    /// What the scans that were read have in them.
    pub sample: Sample,
    /// Poses of the trajectory.
    pub trajectory_poses: Option<usize>,
    /// Samples of the inertial measurement unit.
    pub imu_samples: usize,
    /// Images.
    pub images: usize,
    /// Places of a GNSS receiver.
    pub gnss_fixes: usize,
    /// Topics of a recording, and what was concluded from it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorded: Option<Recorded>,
    /// What is missing or odd.
    pub notes: Vec<String>,
}

/// What a part of the scans has in it.
#[derive(Debug, Default, Serialize)]
pub struct Sample {
    /// Scans that were read.
    pub scans: usize,
    /// Scans that could not be read, with the reason.
    pub unreadable: Vec<String>,
    /// Points of a scan.
    pub points: Points,
    /// Points that measure nothing, or belong to another sensor of the log.
    pub invalid: Dropped,
    /// The shortest and the longest range of a point, metres.
    pub range_m: Option<[f32; 2]>,
    /// The corners of the box around all points, world, metres.
    pub extent_m: Option<[DVec3; 2]>,
    /// How many of the scans have the laser of each point.
    pub with_rings: usize,
    /// How many have the time of each point.
    pub with_times: usize,
    /// How many say how the sensor moved meanwhile.
    pub with_motion: usize,
    /// How many have intensities.
    pub with_intensities: usize,
}

/// Points of a scan, invalid ones included.
#[derive(Debug, Default, Serialize)]
pub struct Points {
    /// The fewest.
    pub min: u64,
    /// On average.
    pub mean: f64,
    /// The most.
    pub max: u64,
}

impl LogInfo {
    /// Reads up to `sample` scans of a log, spread evenly. `watch` is told how many there will be, once that is known, and after each that
    /// one more was read.
    ///
    /// # Errors
    /// If the log cannot be opened; [`RunError::Nothing`] if none of the scans can be read.
    pub fn read(path: &Path, options: &OpenOptions, sample: usize, watch: &mut dyn FnMut(Reading)) -> Result<Self> {
        let log = tsdfuse_io::open_with(path, options)?;
        let first = log.sensors().first();
        let mut info = Self {
            path: path.to_owned(),
            format: log.format().to_owned(),
            scans: log.scans().len(),
            sensor: first.and_then(|sensor| sensor.model.clone()),
            sensors: log.sensors().iter().map(|sensor| sensor.name.clone()).collect(),
            sensor_guessed: false,
            correction: first.map_or_else(Default::default, |sensor| sensor.correction.clone()),
            camera: first.and_then(|sensor| sensor.camera),
            rate_hz: rate_hz(log.scans()),
            duration_secs: duration_secs(log.scans()),
            placed_scans: log.scans().iter().filter(|scan| scan.pose.is_some()).count(),
            path_length_m: path_length_m(log.scans()),
            sample: Sample::default(),
            trajectory_poses: log.trajectory().map(|trajectory| trajectory.poses().len()),
            imu_samples: samples(&log, "/Imu", |log| log.imu().map(|samples| samples.len()))?,
            images: log.images().len(),
            gnss_fixes: samples(&log, "/NavSatFix", |log| log.gnss().map(|fixes| fixes.len()))?,
            recorded: log.recorded().cloned(),
            notes: log.notes().to_vec(),
        };
        info.sample(&log, sample, watch)?;
        Ok(info)
    }

    /// Whether all scans that were tried could be read.
    pub fn is_complete(&self) -> bool {
        self.sample.unreadable.is_empty()
    }

    fn sample(&mut self, log: &Log, count: usize, watch: &mut dyn FnMut(Reading)) -> Result<()> {
        let scans = log.scans().len();
        let count = count.min(scans);
        if count == 0 {
            return Ok(());
        }
        let indices: Vec<_> = (0..count).map(|i| i * scans / count).collect();
        watch(Reading::Begun(count));
        for read in log.read_indices(indices) {
            match read.scan {
                Ok(scan) => {
                    if self.sensor.is_none() && self.camera.is_none() && self.sample.scans == 0 {
                        self.sensor = tsdfuse::sensor::guess(&scan.points, scan.rings.as_deref());
                        self.sensor_guessed = self.sensor.is_some();
                    }
                    self.sample.add(scan);
                }
                Err(error) => self.sample.unreadable.push(error.to_string().replace('\n', " ")),
            }
            watch(Reading::Scan);
        }
        match self.sample.unreadable.first() {
            Some(reason) if self.sample.scans == 0 => Err(RunError::Nothing(format!("no scan can be read: {reason}"))),
            _ => Ok(()),
        }
    }
}

impl Sample {
    fn add(&mut self, mut scan: Scan) {
        let points = scan.points.len() as u64 + scan.dropped.total();
        let Points { min, mean, max } = self.points;
        let before = self.scans as f64;
        self.points = Points {
            min: if self.scans == 0 { points } else { min.min(points) },
            mean: (mean * before + points as f64) / (before + 1.0),
            max: max.max(points),
        };
        self.scans += 1;
        self.with_rings += usize::from(scan.rings.is_some());
        self.with_times += usize::from(scan.times.is_some());
        self.with_motion += usize::from(!scan.motion.is_empty());
        self.with_intensities += usize::from(scan.intensities.is_some());
        scan.drop_invalid(&RangeLimits {
            min_range_m: 0.0,
            max_range_m: f32::INFINITY,
        });
        self.invalid += scan.dropped;
        for range in scan.points.iter().map(|p| p.length()) {
            let [near, far] = self.range_m.unwrap_or([range; 2]);
            self.range_m = Some([near.min(range), far.max(range)]);
        }
        for point in scan.points_in_world().into_iter().flatten() {
            let [low, high] = self.extent_m.unwrap_or([point; 2]);
            self.extent_m = Some([low.min(point), high.max(point)]);
        }
    }
}

/// How many samples there are: in a recording by its index, of the topic with the most.
fn samples(log: &Log, kind: &str, count: impl Fn(&Log) -> tsdfuse_io::Result<usize>) -> Result<usize> {
    let topics = log.recorded().map_or(&[][..], |recorded| &recorded.topics);
    let of_kind = topics.iter().filter(|topic| topic.kind.ends_with(kind));
    match of_kind.map(|topic| topic.messages).max() {
        Some(messages) => Ok(messages),
        None => Ok(count(log)?),
    }
}

fn path_length_m(scans: &[ScanRef]) -> f64 {
    length_m(scans.iter().filter_map(|scan| scan.pose.as_ref()))
}

fn duration_secs(scans: &[ScanRef]) -> Option<f64> {
    secs_between(scans.first()?, scans.last()?)
}

fn secs_between(a: &ScanRef, b: &ScanRef) -> Option<f64> {
    Some((b.time_ns? - a.time_ns?) as f64 * 1e-9)
}

/// The rate of most scans: of the median step.
fn rate_hz(scans: &[ScanRef]) -> Option<f64> {
    let steps = scans.iter().zip(scans.iter().skip(1));
    let mut steps: Vec<f64> = steps.filter_map(|(a, b)| secs_between(a, b)).collect();
    steps.sort_by(f64::total_cmp);
    let median = steps.get(steps.len() / 2)?;
    (*median > 0.0).then(|| 1.0 / median)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::Pose;

    #[test]
    fn the_rate_is_that_of_most_scans() {
        let at = |secs: f64| ScanRef {
            name: String::new(),
            sensor: 0,
            time_ns: Some((secs * 1e9) as i64),
            pose: Some(Pose {
                translation: DVec3::X * secs * 10.0,
                ..Pose::IDENTITY
            }),
        };
        let scans = [0.0, 0.125, 0.25, 0.375, 2.375].map(at);
        assert_eq!(rate_hz(&scans), Some(8.0));
        assert_eq!(duration_secs(&scans), Some(2.375));
        assert!((path_length_m(&scans) - 23.75).abs() < 1e-9);
        assert_eq!((rate_hz(&scans[..1]), duration_secs(&[])), (None, None));
    }
}
