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

use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tsdfuse::pose::Interpolation;
use tsdfuse::scan::{Dropped, Motion, Trajectory};
use tsdfuse::sensor::SensorError;
use tsdfuse::{Pose, Scan, SensorModel};

use crate::noise::NoiseModel;
use crate::scene::Scene;

/// Echoes closer together than this, metres, reach the sensor as one.
const ECHO_LENGTH_M: f64 = 0.5;

/// Rays that stand for a beam that has a width: one in the middle, six around it.
const BEAM_RAYS: u32 = 7;

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
    /// Varies all random numbers.
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

/// Why nothing can be simulated.
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
        /// What it says.
        value: f64,
    },
    /// The rate is finite and positive.
    #[error("{0} scans per second cannot be simulated")]
    Rate(f64),
}

/// A sensor that moves through a scene.
///
/// A scan holds the returns column by column, within a column by ring; what did not return is counted in
/// [`Scan::dropped`]. Points are in the sensor frame at their own time, intensities are the surface's reflectivity × the cosine
/// of incidence. With [`SimulatorConfig::motion`] every point has its time, and [`Scan::motion`] is the path's next pose: the
/// sensor moves exactly as [`Scan::trajectory`] says. The same input gives the same scans on any number of threads.
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

/// What became of one beam.
enum Beam {
    Return(Return),
    Nothing,
    TooNear,
    TooFar,
}

struct Return {
    point: Vec3,
    ring: u16,
    time: f32,
    intensity: f32,
}

/// Something that reflected a part of the beam.
#[derive(Clone, Copy)]
struct Echo {
    range: f64,
    /// Reflectivity × cos(incidence).
    albedo: f64,
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

    /// What is scanned.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What scans.
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
        let columns: Vec<Vec<Beam>> = (0..self.sensor.columns)
            .into_par_iter()
            .map(|column| self.fire(number, column, pose, motion.as_ref()))
            .collect();
        let beams = self.sensor.rings() * columns.len();
        let mut points = Vec::with_capacity(beams);
        let mut rings = Vec::with_capacity(beams);
        let mut times = Vec::with_capacity(beams);
        let mut intensities = Vec::with_capacity(beams);
        let mut dropped = Dropped::default();
        for beam in columns.into_iter().flatten() {
            match beam {
                Beam::Return(r) => {
                    points.push(r.point);
                    rings.push(r.ring);
                    times.push(r.time);
                    intensities.push(r.intensity);
                }
                Beam::Nothing => dropped.no_return += 1,
                Beam::TooNear => dropped.too_near += 1,
                Beam::TooFar => dropped.too_far += 1,
            }
        }
        Scan {
            name: format!("{number:06}"),
            timestamp_secs: Some(number as f64 / self.config.rate_hz),
            points,
            rings: Some(rings),
            times: motion.is_some().then_some(times),
            intensities: Some(intensities),
            pose,
            motion,
            dropped,
        }
    }

    /// Where the sensor is one turn later: at the path's next pose; after the last one it goes on as before.
    fn motion(&self, number: usize, pose: Pose) -> Option<Motion> {
        let next = || match (self.path.get(number + 1), number.checked_sub(1)) {
            (Some(&next), _) => next,
            (None, Some(previous)) => Interpolation::new(self.path[previous], pose).at(2.0),
            (None, None) => pose,
        };
        self.config.motion.then(|| Motion {
            pose: next(),
            secs: 1.0 / self.config.rate_hz,
        })
    }

    /// All beams of one column.
    fn fire(&self, scan: usize, column: u32, start: Pose, motion: Option<&Motion>) -> Vec<Beam> {
        let share = f64::from(column) / f64::from(self.sensor.columns);
        let azimuth = glam::DQuat::from_rotation_z(-TAU * share);
        // As stored, so that who reads the time finds the pose that was used.
        let time = (share / self.config.rate_hz) as f32;
        let (rotation, shift) = motion.map_or((start.rotation, DVec3::ZERO), |m| {
            Trajectory::new(start, m).relative_at(f64::from(time))
        });
        let origin = start.translation - self.scene.offset_m() + shift;
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        // Stream 0 made the lasers' errors.
        rng.set_stream(1 + scan as u64 * u64::from(self.sensor.columns) + u64::from(column));
        let lasers = self.lasers.iter().zip(&self.bias_m).enumerate();
        lasers
            .map(|(ring, (&laser, bias))| {
                let direction = azimuth * laser;
                let beam = self.measure(origin, rotation, direction, *bias, &mut rng);
                self.in_range(beam).map_or_else(
                    |beam| beam,
                    |echo| {
                        Beam::Return(Return {
                            point: (direction * echo.range).as_vec3(),
                            ring: ring as u16,
                            time,
                            intensity: echo.albedo as f32,
                        })
                    },
                )
            })
            .collect()
    }

    fn in_range(&self, echo: Option<Echo>) -> Result<Echo, Beam> {
        match echo {
            None => Err(Beam::Nothing),
            Some(e) if e.range < f64::from(self.sensor.min_range_m) => Err(Beam::TooNear),
            Some(e) if e.range > f64::from(self.sensor.max_range_m) => Err(Beam::TooFar),
            Some(e) => Ok(e),
        }
    }

    /// What the sensor reports for one beam, `direction` in the sensor frame, errors included.
    fn measure(
        &self,
        origin: DVec3,
        rotation: glam::DQuat,
        direction: DVec3,
        bias: f64,
        rng: &mut ChaCha8Rng,
    ) -> Option<Echo> {
        let noise = &self.config.noise;
        // All draws of a beam, whatever is switched on and hit.
        let [range_error, yaw_error, pitch_error] = [(); 3].map(|()| rng.sample::<f64, _>(StandardNormal));
        let [lost, unseen, airborne, where_airborne] = [(); 4].map(|()| rng.random::<f64>());

        let aside = DVec3::Z.cross(direction).normalize_or(DVec3::Y);
        let above = direction.cross(aside);
        let error = noise.angle_sigma_rad * (aside * yaw_error + above * pitch_error);
        let echo = self.echo(origin, rotation, (direction + error).normalize(), aside, above);

        let max_range = f64::from(self.sensor.max_range_m);
        if airborne < noise.airborne {
            let limit = echo.map_or(max_range, |e| e.range);
            let albedo = 0.01;
            let range = limit * where_airborne;
            return Some(Echo { range, albedo });
        }
        let echo = echo?;
        let strength = echo.albedo * (max_range / echo.range).powi(2);
        let seen = if noise.weak_echo > 0.0 {
            1.0 / (1.0 + (noise.weak_echo / strength).powi(2))
        } else {
            1.0
        };
        if lost < noise.dropout || unseen >= seen {
            return None;
        }
        let mut range = echo.range + noise.range_sigma_m * range_error + bias;
        if noise.range_step_m > 0.0 {
            range = (range / noise.range_step_m).round() * noise.range_step_m;
        }
        Some(Echo { range, ..echo })
    }

    /// The true echo of a beam, from one ray or from several across its width.
    fn echo(&self, origin: DVec3, rotation: glam::DQuat, direction: DVec3, aside: DVec3, above: DVec3) -> Option<Echo> {
        let cast = |direction_in_sensor: DVec3| {
            let direction = rotation * direction_in_sensor;
            let hit = self.scene.cast_local(origin, direction.normalize())?;
            let reflectivity = self.scene.primitives()[hit.primitive].reflectivity();
            Some(Echo {
                range: hit.range_m,
                albedo: reflectivity * -hit.normal.dot(direction),
            })
        };
        let radius = self.config.noise.divergence_rad / 2.0;
        if radius == 0.0 {
            return cast(direction);
        }
        let mut echoes: Vec<Echo> = (0..BEAM_RAYS)
            .filter_map(|i| {
                let (sin, cos) = (TAU * f64::from(i) / f64::from(BEAM_RAYS - 1)).sin_cos();
                // Two thirds out, the mean radius of a disc.
                let out = if i + 1 == BEAM_RAYS { 0.0 } else { radius * 2.0 / 3.0 };
                cast((direction + (aside * cos + above * sin) * out).normalize())
            })
            .collect();
        echoes.sort_by(|a, b| a.range.total_cmp(&b.range));
        let pulses = echoes.chunk_by(|a, b| b.range - a.range < ECHO_LENGTH_M);
        let merged = pulses.map(|pulse| {
            let albedo: f64 = pulse.iter().map(|e| e.albedo).sum();
            let range = pulse.iter().map(|e| e.range * e.albedo).sum::<f64>() / albedo;
            let albedo = albedo / f64::from(BEAM_RAYS);
            Echo { range, albedo }
        });
        merged.max_by(|a, b| (a.albedo / a.range.powi(2)).total_cmp(&(b.albedo / b.range.powi(2))))
    }
}
