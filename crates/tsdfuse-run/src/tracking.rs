//! Poses by odometry: scans wait here until they are placed.

use std::collections::VecDeque;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tsdfuse::Pose;
use tsdfuse::scan::RangeLimits;
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::poses::{self, Poses};
use tsdfuse_io::{Log, ReadScan, Selection};
use tsdfuse_odometry::{OdometryConfig, Quality, Tracker};

use crate::error::{BadScan, Result, RunError};
use crate::event::Stop;

/// Where the poses of scans come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PosesFrom {
    /// From the log (or the pose file that is named); by odometry if there are none.
    #[default]
    Any,
    /// From the log (or the pose file that is named).
    Log,
    /// By odometry, whatever the log has.
    Track,
}

/// Scans on their way through the tracker.
pub(crate) struct Tracking {
    tracker: Tracker,
    /// What was read with the scans that are not placed yet, which the tracker has.
    waiting: VecDeque<ReadScan>,
    limits: RangeLimits,
}

impl Tracking {
    pub(crate) fn new(config: OdometryConfig, limits: RangeLimits) -> Self {
        Self {
            tracker: Tracker::new(config),
            waiting: VecDeque::new(),
            limits,
        }
    }

    /// Takes a scan; those that are placed come out, in order. Scans that could not be read come out at once.
    pub(crate) fn push(&mut self, mut read: ReadScan) -> Vec<(ReadScan, Option<Quality>)> {
        match &mut read.scan {
            Ok(scan) => {
                scan.drop_invalid(&self.limits);
                self.tracker.push(std::mem::take(scan));
                self.waiting.push_back(read);
                self.placed()
            }
            Err(_) => vec![(read, None)],
        }
    }

    /// The scans that still wait.
    pub(crate) fn finish(&mut self) -> Vec<(ReadScan, Option<Quality>)> {
        self.tracker.finish();
        self.placed()
    }

    fn placed(&mut self) -> Vec<(ReadScan, Option<Quality>)> {
        let mut placed = Vec::new();
        while let Some(tracked) = self.tracker.pop() {
            if let Some(read) = self.waiting.pop_front() {
                let read = ReadScan {
                    scan: Ok(tracked.scan),
                    ..read
                };
                placed.push((read, Some(tracked.quality)));
            }
        }
        placed
    }
}

/// A scan that was tracked.
#[derive(Clone, Debug, Serialize)]
pub struct TrackedScan {
    /// Its number in the log.
    pub index: usize,
    /// Its name.
    pub name: String,
    /// Its time and `world_from_sensor`; the world is the sensor's frame at the begin of the first scan.
    #[serde(skip)]
    pub pose: FusedPose,
    /// How well it was placed.
    pub quality: Quality,
}

/// Tracks the selected scans of a log, without a map.
///
/// # Errors
/// [`RunError::BadScan`] for a scan that cannot be read; [`RunError::Config`] if the log has several sensors or depth images.
pub fn track(
    log: &Log,
    selection: &Selection,
    config: OdometryConfig,
    limits: RangeLimits,
    stop: &Stop,
) -> Result<Vec<TrackedScan>> {
    check(log)?;
    let mut tracking = Tracking::new(config, limits);
    let mut all = Vec::new();
    let mut take = |placed: Vec<(ReadScan, Option<Quality>)>| {
        for (read, quality) in placed {
            let index = read.index;
            let scan = read.scan.map_err(|error| {
                RunError::from(BadScan {
                    scan: format!("scan {index}"),
                    reason: error.to_string(),
                })
            })?;
            let (pose, time_ns) = (scan.pose.unwrap_or(Pose::IDENTITY), scan.time_ns);
            all.push(TrackedScan {
                index,
                name: scan.name,
                pose: FusedPose { time_ns, pose },
                quality: quality.unwrap_or_default(),
            });
        }
        Ok::<_, RunError>(())
    };
    for read in log.read_ahead(selection) {
        if stop.is_stopped() {
            break;
        }
        take(tracking.push(read))?;
    }
    take(tracking.finish())?;
    Ok(all)
}

/// Writes poses: as TUM where all have times that ascend, else as KITTI.
///
/// # Errors
/// If the file cannot be written.
pub fn write_poses(path: &Path, poses: &[FusedPose]) -> Result<()> {
    let poses = poses.iter().map(|fused| (fused.time_ns, fused.pose));
    Ok(poses::write(path, &Poses::of(poses))?)
}

/// Whether a log can be tracked.
pub(crate) fn check(log: &Log) -> Result<()> {
    match log.sensors() {
        [only] if only.camera.is_none() => Ok(()),
        [_] => Err(RunError::config(
            "odometry needs a LiDAR's scans, and these are depth images: name their poses with --poses",
        )),
        sensors => Err(RunError::config(format_args!(
            "odometry follows one sensor, and there are {}: choose one with --sensor",
            sensors.len()
        ))),
    }
}
