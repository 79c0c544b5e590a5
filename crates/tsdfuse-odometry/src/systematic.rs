//! Systematic errors of single beams, found from how scans disagree.
//!
//! A return off its plane (see [`crate::Refiner`]) by r says `r = nᵀ R (∂p/∂e) e` about the errors e of its beam (elevation, azimuth, range), where
//! p is the return in the sensor frame. All returns of a beam are summed up and solved by least squares, with a prior. The planes were made by
//! all beams, so what these have in common does not show (see [`crate::shared_errors`]), and one round finds only a part of the rest: points
//! are corrected, scans registered again, and what is left is found in the next round.

use glam::DVec3;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use tsdfuse::sensor::{BeamCorrection, SensorCorrection};

use crate::cells::Cells;
use crate::motion::Motion;
use crate::returns::{KERNEL, Return, kernel};

/// What refinement does about systematic errors of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Calibrate {
    /// Nothing.
    Off,
    /// It takes back errors that all beams share, if they are there beyond doubt.
    #[default]
    Auto,
    /// It takes back the errors of each beam, too.
    Beams,
}

/// Standard deviation of errors before anything is known: elevation and azimuth, radians, and range, metres.
const PRIOR: [f64; 3] = [0.005, 0.005, 0.05];

/// The share of returns that count: neighbours share the errors of their plane.
const INDEPENDENT: f64 = 0.02;

/// Beams at most; rings beyond are left out.
const MOST_BEAMS: usize = 256;

/// A return farther than this from its plane lies on something else, metres.
const MOST_OFF_M: f64 = 0.1;

/// Sums over the returns of a beam.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    h: Matrix3<f64>,
    g: Vector3<f64>,
}

/// Collects what returns say about the errors of their beams.
#[derive(Clone, Debug, Default)]
pub struct ErrorSums {
    beams: Vec<Sums>,
    /// For each sweep, the mean distance of its returns from their planes, metres, each at most [`MOST_OFF_M`].
    pub(crate) off_m: Vec<f64>,
}

impl ErrorSums {
    /// Adds the returns of a sweep that is registered, and that the cells do not hold; `of_beams`: also what they say of their beams.
    pub(crate) fn add(&mut self, cells: &Cells, returns: &[Return], motion: &Motion, of_beams: bool) {
        let placer = motion.placer();
        let (mut off_m, mut n) = (0.0, 0.0);
        for Return { point, share, ring } in returns {
            let x = placer.place(*point, *share);
            let Some((plane, r, variance)) = cells.plane_at(x) else {
                continue;
            };
            (off_m, n) = (off_m + r.abs().min(MOST_OFF_M), n + 1.0);
            let Some(ring) = ring.map(usize::from).filter(|ring| of_beams && *ring < MOST_BEAMS) else {
                continue;
            };
            let p = point.as_dvec3();
            let (range, across) = (p.length(), p.truncate().length());
            if !(across > 0.0) {
                continue;
            }
            let by_elevation = DVec3::new(-p.z * p.x / across, -p.z * p.y / across, across);
            let by_azimuth = DVec3::new(-p.y, p.x, 0.0);
            let by = [by_elevation, by_azimuth, p / range];
            let along = |v: DVec3| plane.normal.dot(placer.place((p + v).as_vec3(), *share) - x);
            let j = Vector3::from(by.map(along));
            let weight = INDEPENDENT * kernel(r, KERNEL * KERNEL * variance) / variance;
            if self.beams.len() <= ring {
                self.beams.resize(ring + 1, Sums::default());
            }
            self.beams[ring].h += weight * j * j.transpose();
            self.beams[ring].g += weight * r * j;
        }
        self.off_m.push(if n > 0.0 { off_m / n } else { MOST_OFF_M });
    }

    /// Counts a sweep that is not registered, so that each sweep has a distance.
    pub(crate) fn skip(&mut self) {
        self.off_m.push(MOST_OFF_M);
    }

    /// What takes back by how much the errors of each ring differ from their mean; nothing without rings.
    pub fn by_beam(&self) -> SensorCorrection {
        let errors: Vec<_> = self
            .beams
            .iter()
            .map(|sums| sums.solved().unwrap_or_default())
            .collect();
        let mean = errors.iter().sum::<Vector3<f64>>() / errors.len().max(1) as f64;
        let beam = |error: &Vector3<f64>| BeamCorrection {
            elevation_deg: (mean - error)[0].to_degrees(),
            azimuth_deg: (mean - error)[1].to_degrees(),
            range_m: (mean - error)[2],
        };
        SensorCorrection {
            beams: errors.iter().map(beam).collect(),
            ..SensorCorrection::default()
        }
    }
}

impl Sums {
    /// Errors of elevation, azimuth and range.
    fn solved(&self) -> Option<Vector3<f64>> {
        let prior = Matrix3::from_diagonal(&Vector3::from(PRIOR.map(|sigma| sigma.powi(-2))));
        Some((self.h + prior).cholesky()?.solve(&self.g))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of returns that see these errors.
    fn sums(errors: Vector3<f64>) -> Sums {
        let mut sums = Sums::default();
        for i in 0..10_000 {
            let at = f64::from(i);
            let j = Vector3::new((at * 0.7).sin() * 20.0, (at * 1.3).cos() * 20.0, (at * 2.1).sin());
            let weight = INDEPENDENT / 0.03_f64.powi(2);
            sums.h += weight * j * j.transpose();
            sums.g += weight * j.dot(&errors) * j;
        }
        sums
    }

    #[test]
    fn rings_differ_from_their_mean() {
        let found = ErrorSums {
            beams: [0.001, 0.002, 0.003]
                .map(|turn| sums(Vector3::new(0.002, turn, -10.0 * turn)))
                .to_vec(),
            off_m: Vec::new(),
        }
        .by_beam();
        for (beam, turn) in found.beams.iter().zip([-0.001, 0.0, 0.001_f64]) {
            assert!((beam.azimuth_deg + turn.to_degrees()).abs() < 1e-3, "{beam:?}");
            assert!(
                beam.elevation_deg.abs() < 1e-3 && (beam.range_m - 10.0 * turn).abs() < 1e-3,
                "{beam:?}"
            );
        }
        assert!(ErrorSums::default().by_beam().is_none());
    }
}
