//! Held-out scans: how well a map predicts returns that it has not seen. No ground truth is needed.
//!
//! ```text
//!             margin  return  margin
//!   sensor ○─────┤───────●───────┤        where the map, seen along the ray of a return that it does not hold, has its surface:
//!           ^^^^^ ^^^^^^^^^^^^^^^ ^^^^^
//!           false       hit      missing
//! ```
//!
//! Each return is searched along its own ray, from the sensor's position at the return's time. So this works for any sensor,
//! including depth cameras and sensors that move during a scan.

use serde::Serialize;
use tsdfuse::Scan;
use tsdfuse::render::{Ray, Renderer};
use tsdfuse::scan::ScanError;

use crate::stats::Stats;

/// How the returns of held-out scans compare with the surface of a map. The three shares add up to 1.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeldOut {
    /// Surface farther than this from a return, along the ray, counts as another surface, metres.
    pub margin_m: f64,
    /// The number of returns of the held-out scans.
    pub returns: u64,
    /// The share of the returns with surface within the margin.
    pub hit_rate: f64,
    /// The share with surface nearer to the sensor than that, where the ray has passed: false surface.
    pub false_surface: f64,
    /// The share without any surface up to the margin behind the return.
    pub missing: f64,
    /// |Δr| of the hits, the difference between the measured range and that of the surface; `None` if there are no hits.
    pub error: Option<Stats>,
    /// The mean of Δr = surface − measured over the hits, metres; negative if the surface is too near to the sensor, 0 if there
    /// are no hits.
    pub bias_m: f64,
    /// The mean of min(|Δr|, margin) over all returns, metres. False and missing surface count as the margin, so holes do not
    /// improve it.
    pub capped_error_m: f64,
}

/// Collects [`HeldOut`] scan by scan.
#[derive(Clone, Debug)]
pub struct Collector {
    margin_m: f64,
    returns: u64,
    in_front: u64,
    /// Δr of the hits.
    errors_m: Vec<f64>,
}

impl Collector {
    /// Starts with this margin: see [`HeldOut::margin_m`].
    pub fn new(margin_m: f64) -> Self {
        Self {
            margin_m,
            returns: 0,
            in_front: 0,
            errors_m: Vec::new(),
        }
    }

    /// Compares the returns of a scan that is not in the map. Invalid returns must have been dropped: see
    /// [`Scan::drop_invalid`].
    ///
    /// # Errors
    /// [`ScanError::NoPose`] names a scan without a pose.
    pub fn add(&mut self, renderer: &Renderer, scan: &Scan) -> Result<(), ScanError> {
        let ray = |(pose, point): (tsdfuse::Pose, &tsdfuse::glam::Vec3)| Ray {
            origin: pose.translation,
            direction: pose.rotation * point.as_dvec3(),
            length_m: f64::from(point.length()) + self.margin_m,
        };
        let rays: Vec<Ray> = scan.poses()?.zip(&scan.points).map(ray).collect();
        self.returns += rays.len() as u64;
        for (hit, ray) in renderer.cast(&rays).into_iter().zip(&rays) {
            let Some(hit) = hit else { continue };
            let off_m = f64::from(hit.range_m) - (ray.length_m - self.margin_m);
            if off_m < -self.margin_m {
                self.in_front += 1;
            } else {
                self.errors_m.push(off_m);
            }
        }
        Ok(())
    }

    /// Δr of all hits so far, metres.
    pub fn errors_m(&self) -> &[f64] {
        &self.errors_m
    }

    /// The result for all returns so far; `None` if there are none.
    pub fn result(&self) -> Option<HeldOut> {
        let share = |n: u64| n as f64 / self.returns as f64;
        let hits = self.errors_m.len() as u64;
        let absolute: Vec<f64> = self.errors_m.iter().map(|e| e.abs()).collect();
        let misses = (self.returns - hits) as f64;
        (self.returns > 0).then(|| HeldOut {
            margin_m: self.margin_m,
            returns: self.returns,
            hit_rate: share(hits),
            false_surface: share(self.in_front),
            missing: share(self.returns - hits - self.in_front),
            error: Stats::of(&absolute),
            bias_m: self.errors_m.iter().sum::<f64>() / hits.max(1) as f64,
            capped_error_m: (absolute.iter().sum::<f64>() + misses * self.margin_m) / self.returns as f64,
        })
    }
}

#[cfg(test)]
mod tests;
