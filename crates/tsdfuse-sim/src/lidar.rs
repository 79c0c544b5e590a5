//! The rotating LiDAR.
//!
//! Seen from above, x ahead: columns are fired clockwise, all lasers of one column at the same moment.
//!
//! ```text
//!            x, column 0
//!            ▲
//!   y ◀──────┼──────▶ column columns/4        azimuth of column j = −2π j / columns
//!            │                                time of column j = j / columns / rate after the scan's pose
//! ```

use std::f64::consts::TAU;

use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tsdfuse::pose::Interpolation;
use tsdfuse::scan::{Dropped, PoseAt, Sweep};
use tsdfuse::sensor::SensorError;
use tsdfuse::trajectory::ns_after;
use tsdfuse::{Pose, Scan, SensorModel};

use crate::beam::{Beam, Receiver};
use crate::noise::NoiseModel;
use crate::scene::Scene;

/// How a scene is scanned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatorConfig {
    /// Measurement errors.
    pub noise: NoiseModel,
    /// Turns of the sensor per second; one scan is one turn, from one pose of the path to the next.
    pub rate_hz: f64,
    /// Whether the sensor moves during a scan. If not, a whole scan is taken from its pose.
    pub motion: bool,
    /// The seed of all random numbers.
    pub seed: u64,
}

impl Default for SimulatorConfig {
    fn default() -> Self {
        Self {
            noise: NoiseModel::default(),
            rate_hz: 10.0,
            motion: false,
            seed: 0,
        }
    }
}

/// What can be wrong with a simulation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// The sensor's model is not usable.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// A number of the noise model is negative, not finite, or a probability above 1.
    #[error("noise model: {name} cannot be {value}")]
    Noise {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The rate is not finite or not positive.
    #[error("{0} scans per second cannot be simulated")]
    Rate(f64),
}

/// A sensor that moves through a scene.
///
/// A scan holds the returns column by column, within a column by ring; beams without a return are counted in
/// [`Scan::dropped`]. Points are in the sensor frame at their own time, intensities are the surface's reflectivity × the cosine
/// of incidence. With [`SimulatorConfig::motion`] every point has its time, and [`Scan::motion`] is the path's next pose: the
/// sensor moves exactly as [`Scan::sweep`] says. The same input gives the same scans on any number of threads.
#[derive(Clone, Debug)]
pub struct Simulator {
    scene: Scene,
    sensor: SensorModel,
    path: Vec<Pose>,
    config: SimulatorConfig,
    /// Unit directions of the lasers in column 0.
    lasers: Vec<DVec3>,
    /// Constant range errors of the lasers.
    bias_m: Vec<f64>,
}

/// The returns of one column.
#[derive(Default)]
struct Column {
    returns: Vec<Return>,
    dropped: Dropped,
}

struct Return {
    point: Vec3,
    ring: u16,
    time: f32,
    intensity: f32,
}

impl Simulator {
    /// A simulator of one scan per pose of the path (`world_from_sensor`, see [`crate::path`]).
    ///
    /// # Errors
    /// [`SimulationError`] names the number that is out of range.
    pub fn new(
        scene: Scene,
        sensor: SensorModel,
        path: Vec<Pose>,
        config: SimulatorConfig,
    ) -> Result<Self, SimulationError> {
        sensor.check()?;
        if let Some((name, value)) = config.noise.first_invalid() {
            return Err(SimulationError::Noise { name, value });
        }
        if !(config.rate_hz.is_finite() && config.rate_hz > 0.0) {
            return Err(SimulationError::Rate(config.rate_hz));
        }
        let lasers = sensor.elevations_deg.iter().map(|&e| {
            let (sin, cos) = f64::from(e).to_radians().sin_cos();
            DVec3::new(cos, 0.0, sin)
        });
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let bias_m = (0..sensor.rings())
            .map(|_| config.noise.laser_bias_sigma_m * rng.sample::<f64, _>(StandardNormal))
            .collect();
        Ok(Self {
            lasers: lasers.collect(),
            bias_m,
            scene,
            sensor,
            path,
            config,
        })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The sensor.
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }

    /// Poses at the start of each scan, `world_from_sensor`.
    pub fn path(&self) -> &[Pose] {
        &self.path
    }

    /// All scans in order.
    pub fn scans(&self) -> impl ExactSizeIterator<Item = Scan> + '_ {
        (0..self.path.len()).map(|number| self.scan(number, self.path[number]))
    }

    /// The scan from one pose of the path, `None` beyond its end. Any order gives the same scans.
    pub fn nth_scan(&self, number: usize) -> Option<Scan> {
        self.path.get(number).map(|&pose| self.scan(number, pose))
    }

    fn scan(&self, number: usize, pose: Pose) -> Scan {
        let motion = self.motion(number, pose);
        let sweep = motion.map(|next| Sweep::new(pose, &[next]));
        let columns: Vec<Column> = (0..self.sensor.columns)
            .into_par_iter()
            .map(|column| self.fire(number, column, pose, sweep.as_ref()))
            .collect();
        let returns = || columns.iter().flat_map(|c| &c.returns);
        let mut dropped = Dropped::default();
        for column in &columns {
            dropped += column.dropped;
        }
        Scan {
            name: format!("{number:06}"),
            time_ns: Some(ns_after(0, number as f64 / self.config.rate_hz)),
            points: returns().map(|r| r.point).collect(),
            rings: Some(returns().map(|r| r.ring).collect()),
            times: motion.map(|_| returns().map(|r| r.time).collect()),
            intensities: Some(returns().map(|r| r.intensity).collect()),
            pose: Some(pose),
            motion: motion.into_iter().collect(),
            dropped,
            ..Default::default()
        }
    }

    /// The sensor's pose one turn later: the path's next pose; after the last one the sensor continues as before.
    fn motion(&self, number: usize, pose: Pose) -> Option<PoseAt> {
        let next = || match (self.path.get(number + 1), number.checked_sub(1)) {
            (Some(&next), _) => next,
            (None, Some(previous)) => Interpolation::new(self.path[previous], pose).at(2.0),
            (None, None) => pose,
        };
        self.config.motion.then(|| PoseAt {
            pose: next(),
            secs: 1.0 / self.config.rate_hz,
        })
    }

    /// All beams of one column.
    fn fire(&self, scan: usize, column: u32, start: Pose, sweep: Option<&Sweep>) -> Column {
        let share = f64::from(column) / f64::from(self.sensor.columns);
        let azimuth = DQuat::from_rotation_z(-TAU * share);
        // Rounded as stored, so that the stored time gives the pose that was used.
        let time = (share / self.config.rate_hz) as f32;
        let (rotation, shift) = sweep.map_or((start.rotation, DVec3::ZERO), |sweep| {
            sweep.relative_at(f64::from(time))
        });
        let origin = start.translation - self.scene.offset_m() + shift;
        let [near, far] = [self.sensor.min_range_m, self.sensor.max_range_m].map(f64::from);
        let receiver = Receiver {
            scene: &self.scene,
            noise: &self.config.noise,
            max_range_m: far,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        // Stream 0 made the lasers' errors.
        rng.set_stream(1 + scan as u64 * u64::from(self.sensor.columns) + u64::from(column));
        let mut shot = Column::default();
        for (ring, (&laser, bias_m)) in self.lasers.iter().zip(&self.bias_m).enumerate() {
            let direction = azimuth * laser;
            let beam = Beam {
                origin,
                rotation,
                direction,
            };
            let Some(echo) = receiver.measure(&beam, &mut rng) else {
                shot.dropped.no_return += 1;
                continue;
            };
            match self.config.noise.rounded(echo.range_m + bias_m) {
                range if range < near => shot.dropped.too_near += 1,
                range if range > far => shot.dropped.too_far += 1,
                range => shot.returns.push(Return {
                    point: (direction * range).as_vec3(),
                    ring: ring as u16,
                    time,
                    intensity: echo.albedo as f32,
                }),
            }
        }
        shot
    }
}
