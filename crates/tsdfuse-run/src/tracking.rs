//! Poses by odometry: scans wait here until they are placed.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use tsdfuse::glam::DQuat;
use tsdfuse::mesh;
use tsdfuse::scan::RangeLimits;
use tsdfuse::sensor::SensorCorrection;
use tsdfuse::{ImuSample, Pose, Scan};
use tsdfuse_io::g2o;
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::poses::{self, Poses};
use tsdfuse_io::{Log, ReadScan, Selection, sensor_file};
use tsdfuse_loops::LoopConfig;
use tsdfuse_odometry::{
    Calibrate, ImuReport, Mounting, OdometryConfig, Quality, Refined, Refiner, Search, Tracker, bridge, common_shift,
    mounting, shared_errors,
};

use crate::error::{BadScan, Result, RunError};
use crate::event::{Event, Observer, Stop};
use crate::load::Loading;
use crate::loops::{Corrections, Loops, LoopsReport};
use crate::report::OdometryReport;

/// Scans on their way through the tracker.
pub(crate) struct Tracking {
    tracker: Tracker,
    sensor_from_body: DQuat,
    /// What was read with the scans that are not placed yet, which the tracker has.
    waiting: VecDeque<ReadScan>,
    limits: RangeLimits,
    pub(crate) seconds: f64,
}

impl Tracking {
    /// Of a log with one LiDAR, whose IMU is used if it has one.
    ///
    /// # Errors
    /// [`RunError::Config`] if the log has several sensors or depth images; if its IMU samples cannot be read.
    pub(crate) fn new(log: &Log, config: OdometryConfig, limits: RangeLimits) -> Result<Self> {
        Self::with(log, Tracker::new(config), config, limits)
    }

    /// The same in the frame of a saved map, in which the sensor is sought: near a pose, or else along the poses of the map's scans.
    ///
    /// # Errors
    /// As [`Self::new`]; if the map cannot be read, or does not say where to look.
    pub(crate) fn in_map(
        log: &Log,
        config: OdometryConfig,
        limits: RangeLimits,
        map: &Path,
        near: Option<Pose>,
    ) -> Result<Self> {
        let mut loading = Loading::open(map)?;
        let search = match near {
            Some(near) => Search {
                near: vec![near],
                ..Search::default()
            },
            None => Search {
                along: loading.take_poses().iter().map(|fused| fused.pose).collect(),
                ..Search::default()
            },
        };
        if near.is_none() && search.along.is_empty() {
            return Err(RunError::config(format_args!(
                "{}: the map does not tell the poses of its scans, so say with --initial-pose where the sensor is",
                map.display()
            )));
        }
        let (map, _) = loading.read()?;
        let surface = mesh::extract(&map)?.vertices;
        let tracker = Tracker::in_map(config, surface, search);
        Self::with(log, tracker, config, limits)
    }

    fn with(log: &Log, tracker: Tracker, config: OdometryConfig, limits: RangeLimits) -> Result<Self> {
        check(log)?;
        let mut tracking = Self {
            tracker,
            sensor_from_body: log.sensors()[0].body_from_sensor.rotation.inverse(),
            waiting: VecDeque::new(),
            limits,
            seconds: 0.0,
        };
        if config.imu {
            tracking.push_imu(log.imu()?);
        }
        Ok(tracking)
    }

    /// Takes samples in the log's body frame.
    fn push_imu(&mut self, samples: Vec<ImuSample>) {
        let sensor_from_body = self.sensor_from_body;
        self.tracker.push_imu(samples.into_iter().map(|sample| ImuSample {
            angular_velocity: sensor_from_body * sample.angular_velocity,
            acceleration: sensor_from_body * sample.acceleration,
            ..sample
        }));
    }

    /// Pieces of the trajectory that have nothing to do with each other.
    pub(crate) fn pieces(&self) -> usize {
        self.tracker.pieces()
    }

    /// What was found out about the log's IMU, if it has one.
    pub(crate) fn imu(&self) -> Option<ImuReport> {
        self.tracker.imu()
    }

    /// Takes a scan; those that are placed come out, in order. Scans that could not be read come out at once.
    pub(crate) fn push(&mut self, mut read: ReadScan) -> Vec<(ReadScan, Option<Quality>)> {
        let start = Instant::now();
        self.push_imu(std::mem::take(&mut read.imu));
        let placed = match &mut read.scan {
            Ok(scan) => {
                scan.drop_invalid(&self.limits);
                self.tracker.push(std::mem::take(scan));
                self.waiting.push_back(read);
                self.placed()
            }
            Err(_) => vec![(read, None)],
        };
        self.seconds += start.elapsed().as_secs_f64();
        placed
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

/// Rounds of refinement, and how far from their poses surfaces are looked for in each, metres.
const REFINE_REACH_M: [f64; 6] = [0.5, 0.2, 0.1, 0.1, 0.1, 0.1];

/// Scans at most from which the errors are found that all beams share.
const CALIBRATED_BY: usize = 30;

/// Scans at most whose odometry is compared with the given poses.
const MOUNTED_BY: usize = 1000;

/// The round of refinement after which errors of the sensor are looked for: before, the poses are too rough.
const CALIBRATED_AFTER: usize = 1;

/// Poses that are known before anything is fused, by the scans' numbers in the log.
pub(crate) struct Refinement {
    refined: HashMap<usize, Refined>,
    pub(crate) seconds: f64,
    /// Pieces that have nothing to do with each other.
    pub(crate) pieces: usize,
    pub(crate) imu: Option<ImuReport>,
    pub(crate) loops: Option<LoopsReport>,
    graph: Option<g2o::Graph>,
    /// Systematic errors of the sensor that were found, taken back.
    pub(crate) correction: Option<SensorCorrection>,
    /// Where the sensor is, seen from where the given poses put it, if that is elsewhere.
    pub(crate) mounting: Option<Mounting>,
}

impl Refinement {
    /// Reads the scans of these numbers several times, and refines their poses each time.
    ///
    /// # Errors
    /// [`RunError::Config`] if the log has several sensors or depth images, or cannot be read twice.
    pub(crate) fn of(
        log: &Log,
        indices: &[usize],
        config: OdometryConfig,
        loops: Option<LoopConfig>,
        limits: &RangeLimits,
        stop: &Stop,
        observer: &mut dyn Observer,
    ) -> Result<Self> {
        check(log)?;
        if log.len().is_none() {
            return Err(RunError::config(
                "--poses refine reads a log several times, and a stream comes once",
            ));
        }
        let start = Instant::now();
        let mounting = match config.calibrate {
            Calibrate::Off => None,
            Calibrate::Auto | Calibrate::Beams => {
                observer.on(Event::Working("comparing the poses with odometry"));
                mounting_of(log, indices, config, limits, stop)?
            }
        };
        let mended = mended(log, indices, mounting.as_ref());
        observer.on(Event::Working("refining the poses"));
        // Poses to begin with, where they are not those of the log.
        let mut refined: HashMap<usize, Refined> = HashMap::new();
        let mut closed = None;
        if loops.is_some() || mounting.is_some() {
            let mut loops = loops.map(|loops| Loops::of(log, loops)).transpose()?;
            for read in log.read_indices(indices.to_vec()) {
                if stop.is_stopped() {
                    break;
                }
                let Ok(mut scan) = read.scan else { continue };
                let Some(&pose) = mended.get(&read.index) else { continue };
                if let Some(mounting) = &mounting {
                    place_as(&mut scan, pose, &mounting.pose());
                }
                scan.drop_invalid(limits);
                if let Some(loops) = &mut loops {
                    loops.push(read.index, &scan, &Quality::GIVEN);
                }
                let given = Refined {
                    pose,
                    motion: scan.motion,
                    quality: Quality::default(),
                };
                refined.insert(read.index, given);
            }
            closed = loops.map(Loops::finish);
            if let Some(corrections) = &closed {
                for (index, refined) in &mut refined {
                    *refined = refined.moved(&corrections.of(*index));
                }
            }
        }
        let mut correction = SensorCorrection::default();
        for (round, reach_m) in REFINE_REACH_M.into_iter().enumerate() {
            let mut refiner = Refiner::new(config, reach_m);
            let mut waiting = VecDeque::new();
            let mut next = HashMap::new();
            let mut take = |waiting: &mut VecDeque<usize>, placed: Vec<Option<Refined>>| {
                for refined in placed {
                    next.extend(waiting.pop_front().zip(refined));
                }
            };
            for read in log.read_indices(indices.to_vec()) {
                if stop.is_stopped() {
                    break;
                }
                // A scan that cannot be read is told when it is fused.
                let Ok(mut scan) = read.scan else { continue };
                correction.apply(&mut scan);
                scan.drop_invalid(limits);
                if let Some(refined) = refined.get(&read.index) {
                    refined.place(&mut scan);
                }
                waiting.push_back(read.index);
                take(&mut waiting, refiner.push(&scan));
            }
            take(&mut waiting, refiner.finish());
            // A round that was stopped has not placed all: the last whole one is better.
            if stop.is_stopped() && !refined.is_empty() {
                break;
            }
            refined = next;
            if round == CALIBRATED_AFTER && config.calibrate != Calibrate::Off {
                observer.on(Event::Working("looking for errors of the sensor"));
                let scans = of_the_middle(log, indices, &refined, limits);
                correction = shared_errors(&scans, config).unwrap_or_default();
                observer.on(Event::Working("refining the poses"));
            }
            if round > CALIBRATED_AFTER && round + 1 < REFINE_REACH_M.len() && config.calibrate == Calibrate::Beams {
                correction = correction.plus(&refiner.errors().by_beam());
            }
        }
        let pairs = indices
            .iter()
            .filter_map(|index| Some((*mended.get(index)?, refined.get(index)?.pose)));
        let shift = common_shift(&pairs.collect::<Vec<_>>());
        let refined = refined
            .into_iter()
            .map(|(index, refined)| (index, refined.moved(&shift)))
            .collect();
        let (loops, graph) = closed.map(|closed| (closed.report, closed.graph)).unzip();
        Ok(Self {
            refined,
            seconds: start.elapsed().as_secs_f64(),
            pieces: 1,
            imu: None,
            loops,
            graph,
            correction: (!correction.is_none()).then_some(correction),
            mounting,
        })
    }

    /// Reads the scans of these numbers, finds their poses by odometry, and closes their loops.
    ///
    /// # Errors
    /// As [`Tracking::new`].
    pub(crate) fn tracked(
        log: &Log,
        indices: &[usize],
        config: OdometryConfig,
        loops: LoopConfig,
        limits: RangeLimits,
        stop: &Stop,
    ) -> Result<Self> {
        let start = Instant::now();
        let mut tracking = Tracking::new(log, config, limits)?;
        let mut loops = Loops::of(log, loops)?;
        let mut way = Way::default();
        let mut take = |placed: Vec<(ReadScan, Option<Quality>)>| {
            for (read, quality) in placed {
                // A scan that cannot be read is told when it is fused.
                let Ok(scan) = read.scan else { continue };
                let quality = quality.unwrap_or_default();
                loops.push(read.index, &scan, &quality);
                way.push(read.index, scan, quality);
            }
        };
        for read in log.read_indices(indices.to_vec()) {
            if stop.is_stopped() {
                break;
            }
            take(tracking.push(read));
        }
        take(tracking.finish());
        let corrections = loops.finish();
        way.correct(&tracking, Some(&corrections));
        Ok(Self {
            refined: way.indices.into_iter().zip(way.scans).collect(),
            seconds: start.elapsed().as_secs_f64(),
            pieces: tracking.pieces(),
            imu: tracking.imu(),
            loops: Some(corrections.report),
            graph: Some(corrections.graph),
            correction: None,
            mounting: None,
        })
    }

    /// The pose of a scan.
    pub(crate) fn pose(&self, index: usize) -> Option<Pose> {
        self.refined.get(&index).map(|refined| refined.pose)
    }

    /// Places a scan, if it had a pose, and takes back the sensor's errors.
    pub(crate) fn place(&self, index: usize, scan: &mut Scan) -> Option<Quality> {
        if let Some(correction) = &self.correction {
            correction.apply(scan);
        }
        let refined = self.refined.get(&index)?;
        refined.place(scan);
        Some(refined.quality)
    }
}

/// A trajectory that was tracked, as a whole.
#[derive(Default)]
struct Way {
    /// Of each scan, its number in the log and its name.
    indices: Vec<usize>,
    names: Vec<String>,
    times_ns: Vec<Option<i64>>,
    scans: Vec<Refined>,
}

impl Way {
    fn push(&mut self, index: usize, scan: Scan, quality: Quality) {
        let Some(pose) = scan.pose else { return };
        self.indices.push(index);
        self.names.push(scan.name);
        self.times_ns.push(scan.time_ns);
        self.scans.push(Refined {
            pose,
            motion: scan.motion,
            quality,
        });
    }

    /// Moves what loops and fixes correct; where they, and accelerations, tell nothing, gaps are bridged.
    fn correct(&mut self, tracking: &Tracking, corrections: Option<&Corrections>) {
        let is_forced = tracking.imu().is_some_and(|imu| imu.predicted[1] > 0);
        let times_ns: Option<Vec<i64>> = self.times_ns.iter().copied().collect();
        if let Some(times_ns) = times_ns
            && tracking.pieces() == 1
            && !is_forced
            && corrections.is_none_or(Corrections::move_nothing)
        {
            let begin_ns = times_ns.first().copied().unwrap_or_default();
            let secs: Vec<f64> = times_ns.iter().map(|ns| 1e-9 * (ns - begin_ns) as f64).collect();
            bridge(&secs, &mut self.scans);
        }
        if let Some(corrections) = corrections {
            for (index, scan) in self.indices.iter().zip(&mut self.scans) {
                *scan = scan.moved(&corrections.of(*index));
            }
        }
    }
}

/// Where the sensor is, seen from where the poses of its scans put it: odometry tells.
fn mounting_of(
    log: &Log,
    indices: &[usize],
    config: OdometryConfig,
    limits: &RangeLimits,
    stop: &Stop,
) -> Result<Option<Mounting>> {
    let mut tracking = Tracking::new(log, config, *limits)?;
    let mut poses = Vec::new();
    let mut take = |placed: Vec<(ReadScan, Option<Quality>)>| {
        poses.extend(placed.into_iter().filter_map(|(read, _)| {
            let scan = &log.scans()[read.index];
            Some((scan.time_ns?, scan.pose?, read.scan.ok()?.pose?))
        }));
    };
    let from = indices.len().saturating_sub(MOUNTED_BY) / 2;
    let indices = indices.iter().skip(from).take(MOUNTED_BY).copied();
    for read in log.read_indices(indices.collect()) {
        if stop.is_stopped() {
            return Ok(None);
        }
        take(tracking.push(read));
    }
    take(tracking.finish());
    // Pieces have nothing to do with each other.
    Ok(mounting(&poses).filter(|_| tracking.pieces() == 1))
}

/// The given poses of these scans, of a sensor that sits there.
fn mended(log: &Log, indices: &[usize], mounting: Option<&Mounting>) -> HashMap<usize, Pose> {
    let given = indices
        .iter()
        .filter_map(|index| Some((*index, log.scans()[*index].pose?)));
    let Some(mounting) = mounting else {
        return given.collect();
    };
    let (indices, timed): (Vec<_>, Vec<_>) = given
        .filter_map(|(index, pose)| Some((index, (log.scans()[index].time_ns?, pose))))
        .unzip();
    indices.into_iter().zip(mounting.mended(&timed)).collect()
}

/// Gives a scan a pose that was mended, with the same motion of the body.
fn place_as(scan: &mut Scan, pose: Pose, given_from_sensor: &Pose) {
    if let Some(given) = scan.pose.replace(pose) {
        for at in &mut scan.motion {
            at.pose = pose * given_from_sensor.inverse() * given.inverse() * at.pose * *given_from_sensor;
        }
    }
}

/// The scans in the middle of a log, with refined poses.
fn of_the_middle(log: &Log, indices: &[usize], refined: &HashMap<usize, Refined>, limits: &RangeLimits) -> Vec<Scan> {
    let from = indices.len().saturating_sub(CALIBRATED_BY) / 2;
    let indices = indices.iter().skip(from).take(CALIBRATED_BY).copied();
    let scans = log.read_indices(indices.collect()).filter_map(|read| {
        let mut scan = read.scan.ok()?;
        scan.drop_invalid(limits);
        refined.get(&read.index)?.place(&mut scan);
        Some(scan)
    });
    scans.collect()
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

/// A trajectory that was tracked.
#[derive(Clone, Debug)]
pub struct Track {
    /// The scans in order.
    pub scans: Vec<TrackedScan>,
    /// Pieces that have nothing to do with each other: one if the sensor was never lost.
    pub pieces: usize,
    /// What was found out about the log's IMU, if it has one.
    pub imu: Option<ImuReport>,
    /// The loops, if any were looked for.
    pub loops: Option<LoopsReport>,
    /// The pose graph of the local maps, whose nodes have the numbers of scans.
    pub graph: Option<g2o::Graph>,
    /// Systematic errors of the sensor that refinement found, taken back.
    pub correction: Option<SensorCorrection>,
    /// Where the sensor is, seen from where the given poses put it, if refinement found it elsewhere.
    pub mounting: Option<Mounting>,
}

impl Track {
    /// What was done, in so many seconds.
    pub fn report(&self, seconds: f64) -> OdometryReport {
        let poses: Vec<FusedPose> = self.scans.iter().map(|scan| scan.pose).collect();
        OdometryReport {
            pieces: self.pieces,
            imu: self.imu.clone(),
            loops: self.loops.clone(),
            correction: self.correction.clone(),
            mounting: self.mounting,
            ..OdometryReport::of(seconds, &poses, self.scans.iter().map(|scan| &scan.quality))
        }
    }
}

/// Tracks the selected scans of a log, without a map.
///
/// # Errors
/// [`RunError::BadScan`] for a scan that cannot be read; [`RunError::Config`] if the log has several sensors or depth images.
pub fn track(
    log: &Log,
    selection: &Selection,
    config: OdometryConfig,
    loops: Option<LoopConfig>,
    limits: RangeLimits,
    stop: &Stop,
) -> Result<Track> {
    let mut tracking = Tracking::new(log, config, limits)?;
    let mut way = Way::default();
    let mut loops = loops.map(|loops| Loops::of(log, loops)).transpose()?;
    let mut take = |placed: Vec<(ReadScan, Option<Quality>)>| {
        for (read, quality) in placed {
            let index = read.index;
            let scan = read.scan.map_err(|error| {
                RunError::from(BadScan {
                    scan: format!("scan {index}"),
                    reason: error.to_string(),
                })
            })?;
            let quality = quality.unwrap_or_default();
            if let Some(loops) = &mut loops {
                loops.push(index, &scan, &quality);
            }
            way.push(index, scan, quality);
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
    let closed = loops.map(Loops::finish);
    way.correct(&tracking, closed.as_ref());
    let (loops, graph) = closed.map(|closed| (closed.report, closed.graph)).unzip();
    let scans = way.indices.into_iter().zip(way.times_ns).zip(way.scans).zip(way.names);
    let scans = scans.map(
        |(((index, time_ns), Refined { pose, quality, .. }), name)| TrackedScan {
            index,
            name,
            pose: FusedPose { time_ns, pose },
            quality,
        },
    );
    Ok(Track {
        scans: scans.collect(),
        pieces: tracking.pieces(),
        imu: tracking.imu(),
        loops,
        graph,
        correction: None,
        mounting: None,
    })
}

/// Refines the poses of the selected scans of a log, without a map; those without a pose are left out.
///
/// # Errors
/// As [`track`]; [`RunError::Config`] also for a log that cannot be read twice.
pub fn refine(
    log: &Log,
    selection: &Selection,
    config: OdometryConfig,
    loops: Option<LoopConfig>,
    limits: RangeLimits,
    stop: &Stop,
    observer: &mut dyn Observer,
) -> Result<Track> {
    let indices = selection.indices(log.scans().len());
    let refinement = Refinement::of(log, &indices, config, loops, &limits, stop, observer)?;
    let tracked = indices.into_iter().filter_map(|index| {
        let (scan, refined) = (&log.scans()[index], refinement.refined.get(&index)?);
        let (time_ns, pose) = (scan.time_ns, refined.pose);
        Some(TrackedScan {
            index,
            name: scan.name.clone(),
            pose: FusedPose { time_ns, pose },
            quality: refined.quality,
        })
    });
    Ok(Track {
        scans: tracked.collect(),
        pieces: 1,
        imu: None,
        loops: refinement.loops,
        graph: refinement.graph,
        correction: refinement.correction,
        mounting: refinement.mounting,
    })
}

/// Writes poses of the sensor ([`poses::write_of_sensor`]): as TUM where all have times that ascend, else as KITTI.
///
/// # Errors
/// If the file cannot be written.
pub fn write_poses(path: &Path, poses: &[FusedPose]) -> Result<()> {
    let poses = poses.iter().map(|fused| (fused.time_ns, fused.pose));
    Ok(poses::write_of_sensor(path, &Poses::of(poses))?)
}

/// Writes what is known of a log's first sensor, and what was found besides.
///
/// # Errors
/// If the file cannot be written.
pub fn write_sensor(
    path: &Path,
    log: &Log,
    correction: Option<&SensorCorrection>,
    mounting: Option<&Mounting>,
) -> Result<()> {
    let Some(mut sensor) = log.sensors().first().cloned() else {
        return Ok(());
    };
    if let Some(found) = correction {
        sensor.correction = sensor.correction.plus(found);
    }
    if let Some(found) = mounting {
        sensor.body_from_sensor = sensor.body_from_sensor * found.pose();
        let offset_s = sensor.time_offset_s.unwrap_or_default() + found.time_offset_s;
        sensor.time_offset_s = (offset_s != 0.0).then_some(offset_s);
    }
    Ok(sensor_file::write(path, &sensor)?)
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
