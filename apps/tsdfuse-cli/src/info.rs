//! `tsdfuse info`: what lies in a data set, a saved map or a store.

mod map;
mod table;

use std::path::PathBuf;

use anyhow::{Result, bail};
use glam::DVec3;
use serde::Serialize;
use tsdfuse::scan::{Dropped, RangeLimits};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Scan, SensorModel};
use tsdfuse_io::{Dataset, ScanRef};

use crate::exit::{Outcome, one_line};
use crate::progress;
use crate::report::{print, print_json};
use map::MapInfo;

const EXAMPLES: &str = "\
Examples:
  tsdfuse info pandaset/002
  tsdfuse info kitti/sequences/00 --sample 200 --json
  tsdfuse info street.tsdf";

/// Say what lies in a data set (format, sensor, scans, points, extent), in a saved map or in a store.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The data set's folder, or the file of a saved map or a store.
    path: PathBuf,
    /// How many scans are read, spread evenly over all.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    sample: u32,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// What lies in a data set.
#[derive(Debug, Serialize)]
struct Info {
    path: PathBuf,
    format: &'static str,
    scans: usize,
    sensor: Option<SensorModel>,
    /// Whether the sensor's model was guessed from a scan.
    sensor_guessed: bool,
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

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let map = if tsdfuse_store::recognises(&args.path) {
        Some(MapInfo::of_store(&args.path)?)
    } else if tsdfuse_io::map_file::recognises(&args.path) {
        Some(MapInfo::read(&args.path)?)
    } else {
        None
    };
    if let Some(info) = map {
        match args.json {
            true => print_json(&info)?,
            false => print(&info.table())?,
        }
        return Ok(Outcome::Complete);
    }
    let dataset = tsdfuse_io::open(&args.path)?;
    let mut info = Info {
        path: args.path.clone(),
        format: dataset.format(),
        scans: dataset.len(),
        sensor: dataset.sensor(),
        sensor_guessed: false,
        camera: dataset.camera(),
        rate_hz: rate_hz(dataset.scans()),
        duration_secs: duration_secs(dataset.scans()),
        path_length_m: path_length_m(dataset.scans()),
        sample: Sample::default(),
        notes: dataset.notes().to_vec(),
    };
    info.read(&dataset, args.sample as usize)?;
    if args.json {
        print_json(&info)?;
    } else {
        print(&table::of(&info))?;
    }
    Ok(if info.sample.unreadable.is_empty() {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}

impl Info {
    /// Reads up to `count` scans, spread evenly.
    fn read(&mut self, dataset: &Dataset, count: usize) -> Result<()> {
        let count = count.min(dataset.len());
        let indices: Vec<_> = (0..count).map(|i| i * dataset.len() / count).collect();
        let bar = progress::scans("reading", count);
        for read in dataset.iter_indices(indices) {
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
        self.with_motion += usize::from(scan.motion.is_some());
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
        for point in scan.points_in_world() {
            let [low, high] = self.extent_m.unwrap_or([point; 2]);
            self.extent_m = Some([low.min(point), high.max(point)]);
        }
    }
}

fn path_length_m(scans: &[ScanRef]) -> f64 {
    let steps = scans.iter().zip(scans.iter().skip(1));
    steps
        .map(|(a, b)| a.pose.translation.distance(b.pose.translation))
        .sum()
}

fn duration_secs(scans: &[ScanRef]) -> Option<f64> {
    Some(scans.last()?.timestamp_secs? - scans.first()?.timestamp_secs?)
}

/// The rate of most scans: of the median step.
fn rate_hz(scans: &[ScanRef]) -> Option<f64> {
    let steps = scans.iter().zip(scans.iter().skip(1));
    let mut steps: Vec<f64> = steps
        .filter_map(|(a, b)| Some(b.timestamp_secs? - a.timestamp_secs?))
        .collect();
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
            timestamp_secs: Some(secs),
            pose: Pose {
                translation: DVec3::X * secs * 10.0,
                ..Pose::IDENTITY
            },
        };
        let scans = [0.0, 0.125, 0.25, 0.375, 2.375].map(at);
        assert_eq!(rate_hz(&scans), Some(8.0));
        assert_eq!(duration_secs(&scans), Some(2.375));
        assert!((path_length_m(&scans) - 23.75).abs() < 1e-9);
        assert_eq!((rate_hz(&scans[..1]), duration_secs(&[])), (None, None));
    }
}
