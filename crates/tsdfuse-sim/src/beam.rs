//! One beam: what it hits, and how the sensor reports the echo.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::noise::NoiseModel;
use crate::scene::Scene;

/// Echoes closer together than this, metres, reach the sensor as one.
const ECHO_LENGTH_M: f64 = 0.5;

/// The rays that represent a beam with a width: one in the middle, six around it.
const BEAM_RAYS: u32 = 7;

/// Reflectivity of dust and rain.
const DUST: f64 = 0.01;

/// Where a beam starts and points.
pub(crate) struct Beam {
    /// In the scene, before it is translated.
    pub(crate) origin: DVec3,
    /// `world_from_sensor`.
    pub(crate) rotation: DQuat,
    /// Nominal unit direction in the sensor frame.
    pub(crate) direction: DVec3,
}

/// Something that reflected a beam.
#[derive(Clone, Copy)]
pub(crate) struct Echo {
    pub(crate) range_m: f64,
    /// Reflectivity × cos(incidence).
    pub(crate) albedo: f64,
}

/// What beams are fired at, and how they are measured.
pub(crate) struct Receiver<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) noise: &'a NoiseModel,
    pub(crate) max_range_m: f64,
}

impl Receiver<'_> {
    /// The echo that the sensor reports, at any range, with all errors except those of the laser.
    pub(crate) fn measure(&self, beam: &Beam, rng: &mut ChaCha8Rng) -> Option<Echo> {
        let noise = self.noise;
        // All random numbers of a beam are drawn, whichever effects are switched on.
        let [range_error, yaw_error, pitch_error] = [(); 3].map(|()| rng.sample::<f64, _>(StandardNormal));
        let [lost, unseen, airborne, where_airborne] = [(); 4].map(|()| rng.random::<f64>());

        let aside = DVec3::Z.cross(beam.direction).normalize_or(DVec3::Y);
        let above = beam.direction.cross(aside);
        let axes = [aside, above];
        let error = noise.angle_sigma_rad * (aside * yaw_error + above * pitch_error);
        let echo = self.echo(beam, (beam.direction + error).normalize(), axes);

        if airborne < noise.airborne {
            let limit = echo.map_or(self.max_range_m, |e| e.range_m);
            return Some(Echo {
                range_m: limit * where_airborne,
                albedo: DUST,
            });
        }
        let echo = echo?;
        if lost < noise.dropout || unseen >= self.visibility(&echo) {
            return None;
        }
        let range_m = echo.range_m + noise.range_sigma_m * range_error;
        Some(Echo { range_m, ..echo })
    }

    /// Probability that the echo is strong enough.
    fn visibility(&self, echo: &Echo) -> f64 {
        let strength = echo.albedo * (self.max_range_m / echo.range_m).powi(2);
        if self.noise.weak_echo > 0.0 {
            1.0 / (1.0 + (self.noise.weak_echo / strength).powi(2))
        } else {
            1.0
        }
    }

    /// The true echo in a direction of the sensor frame, of one ray or of several across the beam's width.
    fn echo(&self, beam: &Beam, direction: DVec3, [aside, above]: [DVec3; 2]) -> Option<Echo> {
        let radius = self.noise.divergence_rad / 2.0;
        if radius == 0.0 {
            return self.cast(beam, direction);
        }
        let ray = |i: u32| {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(BEAM_RAYS - 1)).sin_cos();
            // Two thirds out, the mean radius of a disc.
            let out = if i + 1 == BEAM_RAYS { 0.0 } else { radius * 2.0 / 3.0 };
            self.cast(beam, (direction + (aside * cos + above * sin) * out).normalize())
        };
        let mut echoes: Vec<Echo> = (0..BEAM_RAYS).filter_map(ray).collect();
        echoes.sort_by(|a, b| a.range_m.total_cmp(&b.range_m));
        let pulses = echoes.chunk_by(|a, b| b.range_m - a.range_m < ECHO_LENGTH_M);
        let merged = pulses.map(|pulse| {
            let albedo: f64 = pulse.iter().map(|e| e.albedo).sum();
            let range_m = pulse.iter().map(|e| e.range_m * e.albedo).sum::<f64>() / albedo;
            let albedo = albedo / f64::from(BEAM_RAYS);
            Echo { range_m, albedo }
        });
        let power = |e: &Echo| e.albedo / e.range_m.powi(2);
        merged.max_by(|a, b| power(a).total_cmp(&power(b)))
    }

    fn cast(&self, beam: &Beam, direction_in_sensor: DVec3) -> Option<Echo> {
        let direction = (beam.rotation * direction_in_sensor).normalize();
        let hit = self.scene.cast_local(beam.origin, direction)?;
        let reflectivity = self.scene.primitives()[hit.primitive].reflectivity();
        Some(Echo {
            range_m: hit.range_m,
            // Never 0, since echoes are weighted by it.
            albedo: (reflectivity * -hit.normal.dot(direction)).max(1e-6),
        })
    }
}
