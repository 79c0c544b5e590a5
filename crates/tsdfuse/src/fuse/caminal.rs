//! LiDAR as depth images: Caminal et al. 2018 (thesis 4.1).
//!
//! Returns are projected into virtual pinhole cameras at the sensor, with pixels as fine as its columns. Holes between them are
//! filled by 8-connected morphological interpolation (Casas 1996), which keeps every measured pixel, in three steps:
//!
//! 1. Measured depths spread. In each round, an empty pixel takes the mean of the filled pixels among its eight neighbours.
//! 2. Filled pixels become smooth: in as many rounds, each becomes the mean of its neighbourhood.
//! 3. What lies outside the morphological closing of the measured pixels is emptied again.
//!
//! The result is fused as [`super::Depth`] fuses a depth image: the same voxels, the same distance (5.2)(5.3), weight 1.
//!
//! The paper looks through one camera (`cameras = 1`, 90° ahead); by default, four cameras see all around. The thesis also names
//! the paper's second way, which hands the clouds to RTAB-Map; it is another program's method, and is not implemented.
//!
//! Strong for dense rings on large surfaces: no holes. Weak where depth jumps: interpolation draws a slope from one surface to
//! the other. The whole frustum of a pixel has the same weight, near or far, measured or interpolated.

use std::{f32::consts::TAU, time::Instant};

use fearless_simd::{Level, dispatch};
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
    index::{Anchor, Grid},
    map::{MapConfig, VoxelMap},
    reach::Reach,
    scan::Scan,
    sensor::{DepthImage, MAX_IMAGE_EDGE, Pinhole, SensorModel},
};

/// Options of [`Caminal`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaminalConfig {
    /// Virtual cameras: 1 looks ahead with a field of view of 90°; 3 and more share the turn.
    pub cameras: u32,
    /// The widest hole between measured pixels that is filled, at most 15°.
    pub max_gap_deg: f32,
}

/// Wider holes would cost seconds a scan, and a plane through them is a guess.
const MAX_GAP_DEG: f32 = 15.0;

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
        if !(0.0..=MAX_GAP_DEG).contains(&max_gap_deg) {
            return Err(FuseError::Config(format!(
                "caminal.max_gap_deg is {max_gap_deg}; 0 to {MAX_GAP_DEG} are possible"
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

/// What one virtual camera sees, holes filled.
pub(super) struct Look {
    pub(super) camera: Pinhole,
    world_from_camera: Mat3,
    pub(super) image: DepthImage,
    seen: u64,
    hidden: u64,
}

impl Caminal {
    /// What the cameras see of a scan, clockwise, beginning straight ahead.
    pub(super) fn look(&mut self, grid: Grid, scan: &Scan) -> Result<(Anchor, Vec<Look>), FuseError> {
        let anchor = self.placed.place(grid, scan)?;
        let camera = camera(self.config.cameras, self.beams.of(scan)?);
        let rounds = (0.5 * self.config.max_gap_deg.to_radians() * camera.fx).ceil() as usize;
        let (placed, world_from_sensor) = (&self.placed.points, world_axes(scan)?);
        let look = |k: u32| {
            let turn = Mat3::from_rotation_z(-TAU * k as f32 / self.config.cameras as f32);
            let world_from_camera = world_from_sensor * turn;
            let camera_from_world = world_from_camera.transpose();
            let mut image = DepthImage::default();
            image.render(&camera, placed, |p| camera_from_world * p);
            let (seen, hidden) = (placed.len() as u64 - image.outside, image.hidden);
            interpolate(&mut image.depths_m, camera.width as usize, rounds);
            Look {
                camera,
                world_from_camera,
                image,
                seen,
                hidden,
            }
        };
        let looks = (0..self.config.cameras).into_par_iter().map(look).collect();
        Ok((anchor, looks))
    }
}

impl Integrator for Caminal {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        if scan.points.is_empty() {
            self.placed.place(map.grid(), scan)?;
            return Ok(Integration::default());
        }
        let (anchor, looks) = self.look(map.grid(), scan)?;
        let returns = scan.points.len() as u64;
        // On the border between two cameras, rounding may show a return to both.
        let seen = looks.iter().map(|look| look.seen).sum::<u64>().min(returns);
        let hidden: u64 = looks.iter().map(|look| look.hidden).sum();
        let view = |look: Look| View::new(look.camera, look.world_from_camera, look.image);
        let views: Vec<View> = looks.into_iter().map(view).collect();
        let prepare_secs = start.elapsed().as_secs_f64();
        let mut done = depth::integrate(map, anchor, &views, &mut self.gather);
        done.fused_returns = seen - hidden.min(seen);
        done.skipped = Skipped {
            outside_image: returns - seen,
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

/// Fills holes (depth 0) up to `2·rounds` pixels wide.
fn interpolate(depths: &mut [f32], width: usize, rounds: usize) {
    if rounds == 0 {
        return;
    }
    // Around the image is a frame of empty pixels, into which depths spread, and around that one that stays empty.
    let frame = rounds + 1;
    let wide = width + 2 * frame;
    let rows = depths.len() / width + 2 * frame;
    let mut padded = vec![0.0; wide * rows];
    for (row, from) in depths.chunks(width).enumerate() {
        let start = (row + frame) * wide + frame;
        padded[start..start + width].copy_from_slice(from);
    }
    // 1 for a pixel that may change.
    let mut free: Vec<f32> = padded.iter().map(|&depth| f32::from(depth == 0.0)).collect();
    for row in free.chunks_mut(wide) {
        (row[0], row[wide - 1]) = (0.0, 0.0);
    }
    let mut before = padded.clone();
    let level = Level::new(); // the vector instructions of this CPU
    for round in 0..2 * rounds {
        std::mem::swap(&mut before, &mut padded);
        let spread = round < rounds;
        for row in 1..rows - 1 {
            let about = [row - 1, row, row + 1].map(|row| &before[row * wide..(row + 1) * wide]);
            let range = row * wide..(row + 1) * wide;
            dispatch!(level, _ => change(about, &free[range.clone()], spread, &mut padded[range.clone()]));
        }
    }
    let closed = closing(&padded, wide, 2 * rounds + 1);
    for (row, to) in depths.chunks_mut(width).enumerate() {
        for (column, to) in to.iter_mut().enumerate() {
            let at = (row + frame) * wide + column + frame;
            // The window around this pixel ends `rounds` rows and columns further.
            *to = if closed[at + rounds * wide + rounds] {
                padded[at]
            } else {
                0.0
            };
        }
    }
}

/// One round for one row: its free pixels become the means of the filled pixels among them and their eight neighbours.
/// While depths `spread`, only empty pixels change, and afterwards only filled ones.
#[inline(always)]
fn change(about: [&[f32]; 3], free: &[f32], spread: bool, to: &mut [f32]) {
    let n = to.len() - 2;
    (to[0], to[n + 1]) = (about[1][0], about[1][n + 1]);
    let [[a, b, c], [d, here, e], [f, g, h]] = about.map(|row| [0, 1, 2].map(|at| &row[at..at + n]));
    let (free, to) = (&free[1..=n], &mut to[1..=n]);
    for x in 0..n {
        let (mut sum, mut filled) = (0.0, 0.0);
        // In this order, so that sums are rounded as pixel by pixel.
        for depth in [a[x], b[x], c[x], d[x], here[x], e[x], f[x], g[x], h[x]] {
            sum += depth;
            filled += if depth > 0.0 { 1.0f32 } else { 0.0 };
        }
        let changes = (free[x] > 0.0) & ((here[x] == 0.0) == spread);
        to[x] = if changes { sum / filled.max(1.0) } else { here[x] };
    }
}

/// Of each pixel, whether it is the last one (lowest, rightmost) of a square window without empty pixels.
fn closing(depths: &[f32], width: usize, window: usize) -> Vec<bool> {
    let mut below = vec![0; width]; // rows in a row, by column
    let mut last = vec![false; depths.len()];
    for (depths, last) in depths.chunks(width).zip(last.chunks_mut(width)) {
        let mut filled = 0;
        for ((depth, last), below) in depths.iter().zip(last).zip(&mut below) {
            filled = if *depth > 0.0 { filled + 1 } else { 0 };
            *below = if filled >= window { *below + 1 } else { 0 };
            *last = *below >= window;
        }
    }
    last
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::sensor::{model, names, testing::random};

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

    /// The three steps pixel by pixel, in an image with a wide frame.
    fn plainly(depths: &[f32], width: usize, rounds: usize) -> Vec<f32> {
        let (height, frame) = (depths.len() / width, 2 * rounds as i32 + 2);
        let inside = |v: i32, u: i32| (0..height as i32).contains(&v) && (0..width as i32).contains(&u);
        let mut image = std::collections::BTreeMap::new();
        for (v, u) in (-frame..height as i32 + frame).flat_map(|v| (-frame..width as i32 + frame).map(move |u| (v, u)))
        {
            let depth = if inside(v, u) {
                depths[v as usize * width + u as usize]
            } else {
                0.0
            };
            image.insert((v, u), depth);
        }
        let measured = image.clone();
        for round in 0..3 * rounds {
            let before = image.clone();
            for (&(v, u), depth) in image.iter_mut().filter(|(at, _)| measured[*at] == 0.0) {
                let about = (-1..=1).flat_map(|y| (-1..=1).map(move |x| (v + y, u + x)));
                let about: Vec<f32> = about.filter_map(|at| before.get(&at).copied()).collect();
                let filled = about.iter().filter(|depth| **depth > 0.0).count();
                let mean = about.iter().fold(0.0, |sum, depth| sum + depth) / filled.max(1) as f32;
                match round / rounds {
                    0 if *depth == 0.0 => *depth = mean,
                    1 if *depth > 0.0 => *depth = mean,
                    2 if about.contains(&0.0) => *depth = 0.0,
                    _ => (),
                }
            }
        }
        image.retain(|at, _| inside(at.0, at.1));
        image.into_values().collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn holes_are_filled_as_pixel_by_pixel(
            width in 1..24_usize, height in 1..14_usize, rounds in 0..5_usize, density in 1..60_u32, seed in 0..1000_usize,
        ) {
            let depth = |i| if random(seed + 7 * i) * 100.0 < density as f32 { 1.0 + 9.0 * random(seed + 7 * i + 3) } else { 0.0 };
            let image: Vec<f32> = (0..width * height).map(depth).collect();
            let mut filled = image.clone();
            interpolate(&mut filled, width, rounds);
            prop_assert_eq!(&filled, &plainly(&image, width, rounds));
        }
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
        assert_eq!(with(4, 15.0), None);
        let told = with(4, 15.1).unwrap();
        assert_eq!(told, "caminal.max_gap_deg is 15.1; 0 to 15 are possible");
    }
}
