//! Cylindrical projection (CP), the thesis's re-implementation of Kühner and Kümmerle (5.6, 6.4).
//!
//! A scan becomes a cylindrical depth image of square pixels, as many columns as the sensor fires in a turn. The nearest return
//! of a pixel stays. Each filled pixel becomes a point at its **centre** again (5.31), which is fused exactly as by
//! [`Raycast`]: which voxels (5.33)(5.34), what distance (5.7), what weight (5.8).
//!
//! Strong where raycasting is; an image is a handy thing to have. Weak at edges: rounding moves a return by up to half a pixel up
//! or down, past the edge or back from it, and what one scan puts there the next one cancels (thesis 7.6). [`super::Kuehner`]
//! is the method as its authors have it.

use std::time::Instant;

use super::{FuseError, Integration, Integrator, Raycast, Skipped, beams::Beams};
use crate::{
    map::{MapConfig, VoxelMap},
    reach::Reach,
    scan::Scan,
    sensor::{CylindricalPoint, CylindricalProjection as Projection, NONE, SensorModel},
};

/// The integrator of cylindrical depth images.
#[derive(Debug, Default)]
pub struct Cylindrical {
    beams: Beams,
    /// Per pixel: the return seen in it, or [`NONE`].
    pixels: Vec<u32>,
    /// Where each return is seen.
    seen: Vec<CylindricalPoint>,
    raycast: Raycast,
}

impl Cylindrical {
    /// Without a sensor's model, the first scan decides which one it is.
    pub fn new(sensor: Option<SensorModel>) -> Self {
        Self {
            beams: Beams::new(sensor),
            ..Self::default()
        }
    }

    /// The scan as its image has it: a return at the centre of each filled pixel.
    ///
    /// Returns are projected as the sensor measured them, each at its own time; motion is undone afterwards.
    fn round(&mut self, scan: &Scan) -> Result<(Scan, Skipped), FuseError> {
        let sensor = self.beams.of(scan)?;
        let phase = Projection::phase_of(&scan.points, sensor.columns);
        let image = cylindrical_image(sensor, phase);
        self.pixels.clear();
        self.pixels.resize(image.rows() * image.columns(), NONE);
        let mut lost = Skipped::default();
        image.project_all(&scan.points, |p| p, &mut self.seen);
        let depth = |i: u32| self.seen[i as usize].depth_m;
        for (i, &seen) in self.seen.iter().enumerate() {
            let Some((row, column)) = image.pixel(seen) else {
                lost.outside_image += 1;
                continue;
            };
            let holder = &mut self.pixels[row * image.columns() + column];
            lost.hidden += u64::from(*holder != NONE);
            if *holder == NONE || seen.depth_m < depth(*holder) {
                *holder = i as u32;
            }
        }
        let filled = || self.pixels.iter().enumerate().filter(|(_, i)| **i != NONE);
        let centre =
            |(pixel, &i): (usize, &u32)| image.unproject(pixel / image.columns(), pixel % image.columns(), depth(i));
        let time = |times: &Vec<f32>| filled().map(|(_, &i)| times[i as usize]).collect();
        let rounded = Scan {
            name: scan.name.clone(),
            points: filled().map(centre).collect(),
            times: scan.times.as_ref().map(time),
            pose: scan.pose,
            motion: scan.motion.clone(),
            ..Default::default()
        };
        Ok((rounded, lost))
    }
}

/// The image of a sensor, with a row more on both sides: the outermost beams have their tolerances.
pub fn cylindrical_image(sensor: &SensorModel, phase: f32) -> Projection {
    Projection::new(sensor, 0.0, phase, sensor.column_width_rad() as f32)
}

impl Integrator for Cylindrical {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        scan.check()?;
        if scan.points.is_empty() {
            return Ok(Integration::default());
        }
        let (rounded, lost) = self.round(scan)?;
        let prepare_secs = start.elapsed().as_secs_f64();
        let mut done = self.raycast.integrate(map, &rounded)?;
        done.skipped += lost;
        done.prepare_secs += prepare_secs;
        Ok(done)
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        true
    }
}
