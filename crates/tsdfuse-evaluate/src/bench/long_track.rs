//! Whether a scan takes longer to be placed as the drive goes on: lap after lap through a simulated hall, with places recognised.
//!
//! Each lap has the same scans, so odometry does the same work in each; places are recognised all the time, and there are more and more of them. What
//! differs between laps is the length of the drive.

use std::time::Instant;

use serde::Serialize;
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::{Pose, Scan};
use tsdfuse_loops::Closer;
use tsdfuse_odometry::Tracker;
use tsdfuse_run::{Machine, RunConfig, Settings, cpu_secs, peak_memory_bytes};
use tsdfuse_sim::{Simulator, SimulatorConfig, scene};

use super::drive::SENSOR;
use super::pieces::pieces;
use crate::error::{Error, Result};
use crate::progress::{Progress, Watch};

/// Scans of a lap, ten a second.
const LAP: usize = 112;

/// Half axes of the ellipse that is flown, and its height, metres: above what stands in the hall, inside of the pillars.
const WAY_M: DVec3 = DVec3::new(10.0, 3.5, 3.2);

/// Nanoseconds from scan to scan.
const STEP_NS: i64 = 100_000_000;

/// Rows of the table.
const ROWS: usize = 10;

/// Laps through a simulated hall.
#[derive(Clone, Debug)]
pub struct LongTrack {
    /// How many scans of a VLP-16.
    pub scans: usize,
    /// Options of odometry and loops.
    pub settings: Settings,
    /// The arguments of the program, for the results.
    pub command_line: Vec<String>,
}

/// How long scans took to be placed.
#[derive(Clone, Debug, Serialize)]
pub struct LongTrackResults {
    /// The version of this crate.
    pub version: &'static str,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// This machine.
    pub machine: Machine,
    /// With what scans were placed.
    pub config: RunConfig,
    /// Length of the drive, km.
    pub length_km: f64,
    /// All laps that were completed.
    pub laps: Vec<Lap>,
    /// How far scans are from where they were taken after all loops were closed: root mean square, metres, with the first scan put where it was taken.
    pub error_m: f64,
    /// Seconds for what is done once, after the last scan.
    pub finish_secs: f64,
    /// The most memory that the process held, where the system tells.
    pub peak_memory_bytes: Option<u64>,
}

/// A lap.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Lap {
    /// Seconds of all processors, where the system tells.
    pub cpu_secs: Option<f64>,
    /// Seconds by the clock.
    pub seconds: f64,
    /// Of these, for places and the pose graph.
    pub loops_seconds: f64,
    /// Places that were recognised so far.
    pub closures: usize,
}

impl LongTrack {
    /// Drives.
    ///
    /// # Errors
    /// [`Error::Config`] for settings that are wrong; if the hall cannot be simulated.
    pub fn run(&self, watch: &mut Watch<'_>) -> Result<LongTrackResults> {
        let config = self.settings.resolve_over(&RunConfig::default())?;
        let (way, scans) = lap()?;
        let mut tracker = Tracker::new(config.odometry);
        let mut closer = Closer::new(config.loops);
        let mut laps = Vec::new();
        watch(Progress::Begun {
            work: "placing scans",
            steps: Some(self.scans),
        });
        let (mut begun, mut cpu, mut loops_seconds) = (Instant::now(), cpu_secs(), 0.0);
        for number in 0..self.scans {
            let mut scan = scans[number % LAP].clone();
            scan.time_ns = Some(number as i64 * STEP_NS);
            scan.drop_invalid(&config.range);
            tracker.push(scan);
            loops_seconds += close(&mut tracker, &mut closer);
            watch(Progress::Step);
            if (number + 1).is_multiple_of(LAP) {
                let cpu_now = cpu_secs();
                laps.push(Lap {
                    cpu_secs: cpu_now.zip(cpu).map(|(now, before)| now - before),
                    seconds: begun.elapsed().as_secs_f64(),
                    loops_seconds,
                    closures: closer.closures().len(),
                });
                (begun, cpu, loops_seconds) = (Instant::now(), cpu_now, 0.0);
            }
        }
        let begun = Instant::now();
        tracker.finish();
        close(&mut tracker, &mut closer);
        closer.finish();
        let finish_secs = begun.elapsed().as_secs_f64();
        watch(Progress::Done);
        let truth = |scan: usize| way[scan % LAP];
        let world = truth(0) * closer.pose(0).inverse();
        let squared = |scan| {
            let here = world * closer.pose(scan);
            here.translation.distance_squared(truth(scan).translation)
        };
        let error_m = ((0..closer.len()).map(squared).sum::<f64>() / closer.len().max(1) as f64).sqrt();
        let steps = (1..self.scans).map(|scan| truth(scan).translation.distance(truth(scan - 1).translation));
        Ok(LongTrackResults {
            version: env!("CARGO_PKG_VERSION"),
            command_line: self.command_line.clone(),
            machine: Machine::here(rayon::current_num_threads()),
            config,
            length_km: steps.sum::<f64>() / 1e3,
            laps,
            error_m,
            finish_secs,
            peak_memory_bytes: peak_memory_bytes(),
        })
    }
}

/// Hands on the scans that are placed; seconds that it took.
fn close(tracker: &mut Tracker, closer: &mut Closer) -> f64 {
    let mut seconds = 0.0;
    while let Some(tracked) = tracker.pop() {
        let begun = Instant::now();
        closer.push(&tracked.scan, &tracked.quality);
        seconds += begun.elapsed().as_secs_f64();
    }
    seconds
}

/// The poses and scans of a lap, whose last scan leads to the first one.
fn lap() -> Result<(Vec<Pose>, Vec<Scan>)> {
    let unknown = || Error::failed("nothing is known of the hall, or of its sensor");
    let hall = scene::by_name("hall", 0).ok_or_else(unknown)?;
    let sensor = tsdfuse::sensor::model(SENSOR).ok_or_else(unknown)?;
    let offset = hall.offset_m();
    // One scan more, towards which the last one moves.
    let way = (0..=LAP).map(|scan| {
        let angle = std::f64::consts::TAU * scan as f64 / LAP as f64;
        let ahead = f64::atan2(WAY_M.y * angle.cos(), -WAY_M.x * angle.sin());
        Pose {
            rotation: DQuat::from_rotation_z(ahead),
            translation: offset + WAY_M * DVec3::new(angle.cos(), angle.sin(), 1.0),
        }
    });
    let way: Vec<Pose> = way.collect();
    let simulator = Simulator::new(hall, sensor, way.clone(), SimulatorConfig::default())?;
    let scans = simulator.scans().take(LAP);
    Ok((way, scans.collect()))
}

impl LongTrackResults {
    /// All figures.
    pub fn text(&self) -> String {
        let Self { machine, laps, .. } = self;
        let threads = machine.threads;
        let mut text = format!(
            "{}, {threads} thread{}, {}, {}\n{} laps of {LAP} scans of a {SENSOR} through a simulated hall, {:.2} km; {} closures, error {:.3} m; \
             {:.2} s after the last scan\n",
            machine.processor.as_deref().unwrap_or(&machine.system),
            if threads == 1 { "" } else { "s" },
            machine.simd,
            machine.date,
            laps.len(),
            self.length_km,
            laps.last().map_or(0, |lap| lap.closures),
            self.error_m,
            self.finish_secs,
        );
        // In the first two laps there is less to recognise.
        let alike = laps.get(2..).unwrap_or_default();
        text += &format!(
            "\n{:>11} {:>11} {:>11} {:>11}\n",
            "laps", "CPU, ms", "clock, ms", "loops, ms"
        );
        let mut from = 3;
        let mut rows = Vec::new();
        for row in pieces(alike, ROWS) {
            let scans = (row.len() * LAP) as f64;
            let ms = |of: fn(&Lap) -> f64| 1e3 * row.iter().map(of).sum::<f64>() / scans;
            let cpu = ms(|lap| lap.cpu_secs.unwrap_or(lap.seconds));
            text += &format!(
                "{:>11} {cpu:>11.2} {:>11.2} {:>11.2}\n",
                format!("{from}–{}", from + row.len() - 1),
                ms(|lap| lap.seconds),
                ms(|lap| lap.loops_seconds),
            );
            from += row.len();
            rows.push(cpu);
        }
        if let [first, .., last] = rows.as_slice() {
            text += &format!(
                "\nFor each scan, means. CPU: that of all threads. Last row to first: {:.3}.\n",
                last / first
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lap_ends_where_it_began_and_goes_through_free_space() {
        let (way, scans) = lap().unwrap();
        assert_eq!((way.len(), scans.len()), (LAP + 1, LAP));
        assert!(way[0].translation.distance(way[LAP].translation) < 1e-6);
        let hall = scene::by_name("hall", 0).unwrap();
        for pose in &way {
            assert!(hall.signed_distance(pose.translation) > 0.3, "{pose:?}");
        }
        for pair in way.windows(2) {
            let step = pair[0].inverse() * pair[1];
            assert!((0.1..0.7).contains(&step.translation.length()), "{step:?}");
            assert!(pair[0].rotation.angle_between(pair[1].rotation) < 0.2);
        }
    }
}
