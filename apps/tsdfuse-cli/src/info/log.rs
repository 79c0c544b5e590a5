//! What `tsdfuse info` tells of a log.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use glam::DVec3;
use indicatif::HumanCount;
use serde::Serialize;
use tsdfuse::scan::{Dropped, RangeLimits};
use tsdfuse::sensor::{Pinhole, SensorCorrection};
use tsdfuse::trajectory::length_m;
use tsdfuse::{Scan, SensorModel};
use tsdfuse_io::{Log, OpenOptions, Recorded, ScanRef, Topic};
use tsdfuse_run::report::counted;

use super::rows::{Rows, extent_line};
use crate::exit::one_line;
use crate::progress;

/// What lies in a log.
#[derive(Debug, Serialize)]
pub(super) struct LogInfo {
    path: PathBuf,
    format: String,
    scans: usize,
    sensor: Option<SensorModel>,
    /// The names of all sensors.
    sensors: Vec<String>,
    /// Whether the sensor's model was guessed from a scan.
    sensor_guessed: bool,
    /// Each point is turned up by this: a known error of the sensor's elevations.
    #[serde(flatten)]
    correction: SensorCorrection,
    /// The camera, where the scans are depth images.
    camera: Option<Pinhole>,
    /// Median rate of the scans.
    rate_hz: Option<f64>,
    /// From the first scan to the last.
    duration_secs: Option<f64>,
    /// Length of the line through all poses.
    path_length_m: f64,
    /// What the scans that were read have in them.
    sample: Sample,
    /// Poses of the trajectory, IMU samples and images in the log.
    trajectory_poses: Option<usize>,
    imu_samples: usize,
    images: usize,
    /// Places of a GNSS receiver.
    gnss_fixes: usize,
    /// Topics of a recording, and what was concluded from it.
    #[serde(skip_serializing_if = "Option::is_none")]
    recorded: Option<Recorded>,
    /// What is missing or odd.
    notes: Vec<String>,
}

/// What a part of the scans has in it.
#[derive(Debug, Default, Serialize)]
struct Sample {
    /// Scans that were read.
    scans: usize,
    /// Scans that could not be read, with the reason.
    unreadable: Vec<String>,
    points: Points,
    /// Points that measure nothing, or belong to another sensor of the log.
    invalid: Dropped,
    /// The shortest and the longest range of a point, metres.
    range_m: Option<[f32; 2]>,
    /// The corners of the box around all points, world, metres.
    extent_m: Option<[DVec3; 2]>,
    /// How many of the scans have the laser of each point.
    with_rings: usize,
    /// How many have the time of each point.
    with_times: usize,
    /// How many say how the sensor moved meanwhile.
    with_motion: usize,
    /// How many have intensities.
    with_intensities: usize,
}

/// Points of a scan, invalid ones included.
#[derive(Debug, Default, Serialize)]
struct Points {
    min: u64,
    mean: f64,
    max: u64,
}

impl LogInfo {
    /// Reads up to `sample` scans of a log, spread evenly.
    pub(super) fn read(path: &Path, options: &OpenOptions, sample: usize) -> Result<Self> {
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
            path_length_m: path_length_m(log.scans()),
            sample: Sample::default(),
            trajectory_poses: log.trajectory().map(|trajectory| trajectory.poses().len()),
            imu_samples: samples(&log, "/Imu", |log| log.imu().map(|samples| samples.len()))?,
            images: log.images().len(),
            gnss_fixes: samples(&log, "/NavSatFix", |log| log.gnss().map(|fixes| fixes.len()))?,
            recorded: log.recorded().cloned(),
            notes: log.notes().to_vec(),
        };
        info.sample(&log, sample)?;
        Ok(info)
    }

    /// Whether all scans that were tried could be read.
    pub(super) fn is_complete(&self) -> bool {
        self.sample.unreadable.is_empty()
    }

    fn sample(&mut self, log: &Log, count: usize) -> Result<()> {
        let scans = log.scans().len();
        let count = count.min(scans);
        if count == 0 {
            return Ok(());
        }
        let indices: Vec<_> = (0..count).map(|i| i * scans / count).collect();
        let bar = progress::scans("reading", Some(count));
        for read in log.read_indices(indices) {
            match read.scan {
                Ok(scan) => {
                    if self.sensor.is_none() && self.camera.is_none() && self.sample.scans == 0 {
                        self.sensor = tsdfuse::sensor::guess(&scan.points, scan.rings.as_deref());
                        self.sensor_guessed = self.sensor.is_some();
                    }
                    self.sample.add(scan);
                }
                Err(error) => self.sample.unreadable.push(one_line(&error.into())),
            }
            bar.inc(1);
        }
        drop(bar);
        match self.sample.unreadable.first() {
            Some(reason) if self.sample.scans == 0 => bail!("no scan can be read: {reason}"),
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

/// All that is known, a line each.
pub(super) fn table(info: &LogInfo) -> String {
    let mut rows = Rows::default();
    let sample = &info.sample;
    rows.add("log", format!("{} ({})", info.path.display(), info.format));
    match &info.camera {
        Some(camera) => rows.add("camera", camera_line(camera)),
        None => rows.add("sensor", sensor_line(info)),
    }
    let correction = &info.correction;
    if correction.elevation_deg != 0.0 {
        rows.add(
            "elevations",
            format!(
                "each point is turned up by {}°, a known error of this sensor; --set sensor.elevation_correction_deg=0 leaves it",
                correction.elevation_deg
            ),
        );
    }
    if correction.range_m != 0.0 {
        rows.add("ranges", format!("{} m are added to each", correction.range_m));
    }
    if !correction.beams.is_empty() {
        rows.add("beams", format!("{} are corrected one by one", correction.beams.len()));
    }
    rows.add("scans", scans_line(info));
    rows.add("path", format!("{:.1} m", info.path_length_m));
    let read = match sample.scans {
        n if n == info.scans => "all scans".to_owned(),
        n => format!("{n} of {} scans", info.scans),
    };
    let Points { min, mean, max } = &sample.points;
    let (min, max) = (HumanCount(*min), HumanCount(*max));
    let mean = HumanCount(mean.round() as u64);
    rows.add(
        "points",
        format!("{min} to {max} a scan, {mean} on average ({read} read)"),
    );
    rows.add(
        "left out",
        match counted(&sample.invalid) {
            none if none.is_empty() => "none".to_owned(),
            invalid => invalid.join(", "),
        },
    );
    if let Some([near, far]) = sample.range_m {
        rows.add("ranges", format!("{near:.2} to {far:.2} m"));
    }
    if let Some([low, high]) = sample.extent_m {
        rows.add("extent", extent_line(low, high));
    }
    let columns = [
        ("rings", sample.with_rings),
        ("times", sample.with_times),
        ("motion", sample.with_motion),
        ("intensities", sample.with_intensities),
    ];
    // Pixels have no such columns.
    for (name, scans) in columns.into_iter().filter(|_| info.camera.is_none()) {
        let which = match scans {
            0 => "no".to_owned(),
            n if n == sample.scans => "yes".to_owned(),
            n => format!("in {n} of {} scans", sample.scans),
        };
        rows.add(name, which);
    }
    if info.sensors.len() > 1 {
        rows.add("sensors", info.sensors.join(", "));
    }
    if let Some(poses) = info.trajectory_poses {
        rows.add("trajectory", format!("{} poses", HumanCount(poses as u64)));
    }
    for (name, count) in [
        ("IMU samples", info.imu_samples),
        ("images", info.images),
        ("GNSS fixes", info.gnss_fixes),
    ] {
        if count > 0 {
            rows.add(name, HumanCount(count as u64));
        }
    }
    if let Some(Recorded { topics, conclusions }) = &info.recorded {
        topics.iter().for_each(|topic| rows.add("topic", topic_line(topic)));
        for (subject, text) in conclusions {
            rows.add(subject, text);
        }
    }
    info.notes.iter().for_each(|note| rows.add("note", note));
    let unreadable = sample.unreadable.iter();
    unreadable.for_each(|reason| rows.add("unreadable", reason));
    rows.finish()
}

fn camera_line(camera: &Pinhole) -> String {
    let Pinhole {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    } = *camera;
    let across = (camera.ray(-0.5, cy).y.atan() - camera.ray(width as f32 - 0.5, cy).y.atan()).to_degrees();
    let down = (camera.ray(cx, -0.5).z.atan() - camera.ray(cx, height as f32 - 0.5).z.atan()).to_degrees();
    format!("{width} x {height} pixels, {across:.1}° x {down:.1}°, fx {fx} fy {fy} cx {cx} cy {cy}")
}

fn sensor_line(info: &LogInfo) -> String {
    let Some(sensor) = &info.sensor else {
        return "not known".to_owned();
    };
    let low = sensor.elevations_deg.first().copied().unwrap_or_default();
    let high = sensor.elevations_deg.last().copied().unwrap_or_default();
    format!(
        "{}{}: {} beams from {low:.1}° to {high:.1}°, {} columns, {} m to {} m",
        sensor.name,
        if info.sensor_guessed { ", guessed" } else { "" },
        sensor.rings(),
        sensor.columns,
        sensor.min_range_m,
        sensor.max_range_m
    )
}

fn topic_line(topic: &Topic) -> String {
    let Topic {
        name, kind, messages, ..
    } = topic;
    let mut line = format!("{name} ({kind}), {} messages", HumanCount(*messages as u64));
    if let Some(rate) = topic.rate_hz {
        line += &format!(", {rate:.1} Hz");
        if let Some(gap) = topic.longest_gap_secs.filter(|gap| gap * rate > 2.5) {
            line += &format!(", a gap of {gap:.2} s");
        }
    }
    if let Some(delay) = topic.delay_secs.filter(|delay| delay.abs() > 1.0) {
        line += &format!(", its clock is {delay:.3} s behind the recorder's");
    }
    line + if topic.is_read { ", read" } else { "" }
}

fn scans_line(info: &LogInfo) -> String {
    let secs = info.duration_secs.map(|secs| format!(" in {secs:.2} s"));
    let rate = info.rate_hz.map(|rate| format!(", {rate:.2} Hz"));
    let timed = secs.unwrap_or_else(|| ", without times".to_owned());
    format!("{}{timed}{}", info.scans, rate.unwrap_or_default())
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
