//! LiDAR as depth images: Caminal et al. 2018 (thesis 4.1).
//!
//! Returns are projected into virtual pinhole cameras at the sensor, pixels as fine as its columns. Holes between them are
//! filled by 8-connected morphological interpolation (Casas, 1996), which keeps every measured pixel: first the measured depths
//! spread, each round into the pixels beside what is filled, where several meet as their mean; then, for as many rounds, every
//! spread pixel becomes the mean of its neighbourhood; then what is not between measured pixels is drawn back (so that the filled
//! set is the morphological closing of the measured one). What comes out is fused by [`super::Depth`]: which voxels, what distance
//! (5.2)(5.3), weight 1.
//!
//! The paper looks through one camera (`cameras = 1`, 90° ahead); by default four see all around.
//!
//! Strong in front of dense rings on large surfaces, which get no holes. Weak wherever depth jumps: interpolation draws a slope
//! from one surface to the other; and all of a pixel's frustum gets the same weight, near or far, measured or drawn.

use std::{f32::consts::TAU, time::Instant};

use glam::Mat3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    FuseError, Integration, Integrator, Skipped,
    beams::Beams,
    depth::{self, View, world_axes},
    gather::Gather,
    placed::Placed,
};
use crate::{
    map::{MapConfig, VoxelMap},
    reach::Reach,
    scan::Scan,
    sensor::{DepthImage, MAX_IMAGE_EDGE, Pinhole, SensorModel},
};

/// Options of [`Caminal`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaminalConfig {
    /// Virtual cameras: 1 looks ahead with 90°, 3 and more share the turn.
    pub cameras: u32,
    /// The widest hole between measured pixels that is filled.
    pub max_gap_deg: f32,
}

impl Default for CaminalConfig {
    fn default() -> Self {
        Self {
            cameras: 4,
            max_gap_deg: 2.0,
        }
    }
}

impl CaminalConfig {
    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// [`FuseError::Config`] names the field.
    pub fn validate(&self) -> Result<(), FuseError> {
        let Self { cameras, max_gap_deg } = *self;
        if !(cameras == 1 || (3..=16).contains(&cameras)) {
            return Err(FuseError::Config(format!(
                "caminal.cameras is {cameras}; 1 and 3 to 16 are possible"
            )));
        }
        // Also false for NaN.
        if !(0.0..=90.0).contains(&max_gap_deg) {
            return Err(FuseError::Config(format!(
                "caminal.max_gap_deg is {max_gap_deg}; 0 to 90 are possible"
            )));
        }
        Ok(())
    }
}

/// The integrator of virtual depth images.
#[derive(Debug, Default)]
pub struct Caminal {
    config: CaminalConfig,
    beams: Beams,
    placed: Placed,
    gather: Gather,
}

impl Caminal {
    /// With the given options. Without a sensor's model, the first scan decides which one it is.
    pub fn new(config: CaminalConfig, sensor: Option<SensorModel>) -> Self {
        Self {
            config,
            beams: Beams::new(sensor),
            ..Self::default()
        }
    }
}

impl Integrator for Caminal {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        self.placed.place(map.grid(), scan)?;
        let (Some(anchor), false) = (self.placed.anchor(), scan.points.is_empty()) else {
            return Ok(Integration::default());
        };
        let camera = camera(self.config.cameras, self.beams.of(scan)?);
        let rounds = (0.5 * self.config.max_gap_deg.to_radians() * camera.fx).ceil() as usize;
        let (placed, world_from_sensor) = (&self.placed.points, world_axes(scan)?);
        let look = |k: u32| {
            let world_from_camera =
                world_from_sensor * Mat3::from_rotation_z(-TAU * k as f32 / self.config.cameras as f32);
            let camera_from_world = world_from_camera.transpose();
            let mut image = DepthImage::default();
            image.render(&camera, placed, |p| camera_from_world * p);
            let (seen, hidden) = (placed.len() as u64 - image.outside, image.hidden);
            interpolate(&mut image.depths_m, camera.width as usize, rounds);
            (View::new(camera, world_from_camera, image), seen, hidden)
        };
        let (mut views, mut seen, mut hidden) = (Vec::new(), 0, 0);
        for (view, sees, hides) in (0..self.config.cameras).into_par_iter().map(look).collect::<Vec<_>>() {
            views.push(view);
            (seen, hidden) = (seen + sees, hidden + hides);
        }
        let prepare_secs = start.elapsed().as_secs_f64();
        let mut done = depth::integrate(map, anchor, &views, &mut self.gather)?;
        // On the border between two cameras rounding may show a return to both.
        let seen = seen.min(placed.len() as u64);
        done.fused_returns = seen - hidden.min(seen);
        done.skipped = Skipped {
            outside_image: placed.len() as u64 - seen,
            hidden,
            ..Default::default()
        };
        done.prepare_secs = prepare_secs;
        Ok(done)
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        // Filled pixels lie at most half the widest gap beside a measured one.
        Ok(Reach::of(map, scan)?.turned(0.5 * f64::from(self.config.max_gap_deg).to_radians()))
    }

    fn needs_sensor(&self) -> bool {
        true
    }
}

/// A camera that sees its share of the turn and all beams of the sensor, with pixels that are as wide as its columns.
fn camera(cameras: u32, sensor: &SensorModel) -> Pinhole {
    let half_fov = 0.5 * TAU / if cameras == 1 { 4.0 } else { cameras as f32 };
    let focal = sensor.columns as f32 / TAU;
    // Beams rise towards the sides of the image.
    let tangent = |beam: Option<&f32>| beam.map_or(0.0, |e| e.clamp(-75.0, 75.0).to_radians().tan()) / half_fov.cos();
    let bottom = tangent(sensor.elevations_deg.first()).min(0.0);
    let top = tangent(sensor.elevations_deg.last()).max(0.0);
    let edge = |tangents: f32| ((focal * tangents).ceil() as u32 + 2).min(MAX_IMAGE_EDGE);
    let width = edge(2.0 * half_fov.tan());
    Pinhole {
        width,
        height: edge(top - bottom),
        fx: focal,
        fy: focal,
        cx: 0.5 * (width - 1) as f32,
        cy: (focal * top).ceil(),
    }
}

/// Fills holes (0), which are up to `2·rounds` pixels wide.
fn interpolate(depths: &mut [f32], width: usize, rounds: usize) {
    // A frame of empty pixels, so that borders are no holes.
    let padded_width = width + 2 * rounds;
    let frame = vec![0.0; rounds * padded_width];
    let mut padded = frame.clone();
    for row in depths.chunks(width) {
        padded.extend(
            std::iter::repeat_n(0.0, rounds)
                .chain(row.iter().copied())
                .chain(std::iter::repeat_n(0.0, rounds)),
        );
    }
    padded.extend(frame);
    interpolate_within(&mut padded, padded_width, rounds);
    let rows = padded.chunks(padded_width).skip(rounds);
    depths
        .chunks_mut(width)
        .zip(rows)
        .for_each(|(to, from)| to.copy_from_slice(&from[rounds..rounds + width]));
}

fn interpolate_within(depths: &mut [f32], width: usize, rounds: usize) {
    let measured: Vec<bool> = depths.iter().map(|&depth| depth > 0.0).collect();
    let mut before = depths.to_vec();
    let mut round = |change: &dyn Fn(f32, About) -> f32| {
        before.copy_from_slice(depths);
        for (pixel, depth) in depths.iter_mut().enumerate().filter(|(pixel, _)| !measured[*pixel]) {
            *depth = change(*depth, about(&before, width, pixel));
        }
    };
    let spread = |depth, about: About| if depth == 0.0 { about.mean() } else { depth };
    let smooth = |depth, about: About| if depth > 0.0 { about.mean() } else { depth };
    let draw_back = |depth, about: About| if about.empty > 0 { 0.0 } else { depth };
    (0..rounds).for_each(|_| round(&spread));
    (0..rounds).for_each(|_| round(&smooth));
    (0..rounds).for_each(|_| round(&draw_back));
}

/// A pixel and its eight neighbours.
#[derive(Clone, Copy, Debug, Default)]
struct About {
    sum: f32,
    filled: u32,
    empty: u32,
}

impl About {
    /// The mean of the filled pixels; 0 if there is none.
    fn mean(self) -> f32 {
        self.sum / self.filled.max(1) as f32
    }
}

#[inline]
fn about(depths: &[f32], width: usize, pixel: usize) -> About {
    let (row, column) = (pixel / width, pixel % width);
    let mut about = About::default();
    for beside in row.saturating_sub(1)..=row + 1 {
        let Some(depths) = depths.get(beside * width..(beside + 1) * width) else {
            continue;
        };
        for &depth in &depths[column.saturating_sub(1)..(column + 2).min(width)] {
            about.sum += depth;
            about.filled += u32::from(depth > 0.0);
            about.empty += u32::from(depth == 0.0);
        }
    }
    about
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::sensor::{model, names};

    #[test]
    fn cameras_together_see_all_beams() {
        for name in names() {
            let sensor = model(name).unwrap();
            for cameras in [3, 4, 7] {
                let camera = camera(cameras, &sensor);
                for column in 0..sensor.columns {
                    let azimuth = -(column as f32) * sensor.column_width_rad() as f32;
                    let seen = |elevation: &f32| {
                        let (sin, cos) = elevation.to_radians().sin_cos();
                        let ray = Vec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
                        let turned = |k| Mat3::from_rotation_z(TAU * k as f32 / cameras as f32) * ray;
                        (0..cameras).any(|k| camera.pixel(turned(k)).is_some())
                    };
                    assert!(
                        sensor.elevations_deg.iter().all(seen),
                        "{name}, {cameras} cameras, column {column}"
                    );
                }
            }
        }
    }

    #[test]
    fn measured_pixels_stay_and_only_holes_are_filled() {
        let sparse = |columns: &[usize]| {
            let mut depths = vec![0.0; 9 * 9];
            columns
                .iter()
                .for_each(|&column| depths[4 * 9 + column] = column as f32);
            depths
        };
        let filled = |columns: &[usize], rounds| {
            let mut depths = sparse(columns);
            interpolate(&mut depths, 9, rounds);
            depths[4 * 9..5 * 9].to_vec()
        };
        let row = filled(&[2, 6], 2);
        assert_eq!((row[2], row[6]), (2.0, 6.0));
        assert!(
            row[2] < row[3] && row[3] < row[4] && row[4] < row[5] && row[5] < row[6],
            "{row:?}"
        );
        assert_eq!([row[0], row[1], row[7], row[8]], [0.0; 4], "it spreads outwards");
        // A hole that is too wide, and nothing to fill.
        assert_eq!(filled(&[1, 7], 2), sparse(&[1, 7])[36..45]);
        assert_eq!(filled(&[4], 3), sparse(&[4])[36..45]);
    }

    #[test]
    fn options_without_sense_are_refused() {
        let with = |cameras, max_gap_deg| {
            CaminalConfig { cameras, max_gap_deg }
                .validate()
                .err()
                .map(|e| e.to_string())
        };
        assert_eq!(with(1, 0.0), None);
        assert!(with(2, 2.0).unwrap().contains("caminal.cameras is 2"));
        assert!(with(4, f32::NAN).unwrap().contains("caminal.max_gap_deg is NaN"));
    }
}
