//! Systematic errors of a sensor, found from how scans disagree: of elevations, azimuths and ranges, of all beams together or of each.
//!
//! A return off its plane (see [`crate::Refiner`]) by r says `r = nᵀ R (∂p/∂e) e` about the errors e of its beam, where p is the return in the
//! sensor frame. All returns of a beam are summed up and solved by least squares, with a prior. The planes were made with the same errors, so one
//! round finds only a part of them: points are corrected, scans registered again, and what is left is found in the next round.

use glam::{DVec3, Vec3};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use tsdfuse::Scan;

use crate::cells::Cells;
use crate::motion::Motion;
use crate::register::{KERNEL, Return, kernel};

/// Standard deviation of errors before anything is known: elevation and azimuth, radians, and range, metres.
const PRIOR: [f64; 3] = [0.005, 0.005, 0.05];

/// The share of returns that count: neighbours share the errors of their plane.
const INDEPENDENT: f64 = 0.02;

/// Beams at most; rings beyond are left out.
const MOST_BEAMS: usize = 256;

/// What a beam measures too much: subtract it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BeamError {
    /// Of the angle above the sensor's horizontal plane, degrees.
    pub elevation_deg: f64,
    /// Of the angle about the sensor's z axis, counterclockwise, degrees.
    pub azimuth_deg: f64,
    /// Of the range, metres.
    pub range_m: f64,
}

impl BeamError {
    fn plus(&self, other: &Self) -> Self {
        Self {
            elevation_deg: self.elevation_deg + other.elevation_deg,
            azimuth_deg: self.azimuth_deg + other.azimuth_deg,
            range_m: self.range_m + other.range_m,
        }
    }

    /// The point without the error.
    fn corrected(&self, p: Vec3) -> Vec3 {
        let (range, across) = (p.as_dvec3().length(), p.as_dvec3().truncate().length());
        if !(across > 0.0) {
            return p;
        }
        let elevation = f64::from(p.z).atan2(across) - self.elevation_deg.to_radians();
        let azimuth = f64::from(p.y).atan2(f64::from(p.x)) - self.azimuth_deg.to_radians();
        let (range, across) = (range - self.range_m, elevation.cos());
        (DVec3::new(across * azimuth.cos(), across * azimuth.sin(), elevation.sin()) * range).as_vec3()
    }
}

/// Errors of a sensor: one for all beams, or those of each ring.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorErrors {
    /// By ring, 0 = lowest; a single one holds for all returns. Empty: none.
    pub beams: Vec<BeamError>,
}

impl SensorErrors {
    /// Takes the errors out of a scan's points.
    pub fn correct(&self, scan: &mut Scan) {
        match (self.beams.as_slice(), &scan.rings) {
            ([], _) => {}
            ([only], _) => scan.points.iter_mut().for_each(|p| *p = only.corrected(*p)),
            (beams, Some(rings)) => {
                for (p, ring) in scan.points.iter_mut().zip(rings) {
                    if let Some(beam) = beams.get(usize::from(*ring)) {
                        *p = beam.corrected(*p);
                    }
                }
            }
            (_, None) => {}
        }
    }

    /// These errors, and those that were found after they had been taken out.
    pub fn plus(&self, found: &Self) -> Self {
        let at = |errors: &Self, i: usize| match errors.beams.as_slice() {
            [] => BeamError::default(),
            [only] => *only,
            beams => beams.get(i).copied().unwrap_or_default(),
        };
        let beams = self.beams.len().max(found.beams.len());
        Self {
            beams: (0..beams).map(|i| at(self, i).plus(&at(found, i))).collect(),
        }
    }
}

/// Sums over the returns of a beam.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    h: Matrix3<f64>,
    g: Vector3<f64>,
}

/// Collects what returns say about the errors of their beams.
#[derive(Clone, Debug, Default)]
pub struct ErrorSums {
    all: Sums,
    beams: Vec<Sums>,
}

impl ErrorSums {
    /// Adds the returns of a sweep that is registered, and that the cells do not hold.
    pub(crate) fn add(&mut self, cells: &Cells, returns: &[Return], motion: &Motion) {
        let placer = motion.placer();
        for Return { point, share, ring } in returns {
            let x = placer.place(*point, *share);
            let Some((plane, r, variance)) = cells.plane_at(x) else {
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
            let sums = Sums {
                h: weight * j * j.transpose(),
                g: weight * r * j,
            };
            let ring = ring.map(usize::from).filter(|ring| *ring < MOST_BEAMS);
            if let Some(ring) = ring {
                if self.beams.len() <= ring {
                    self.beams.resize(ring + 1, Sums::default());
                }
                self.beams[ring].h += sums.h;
                self.beams[ring].g += sums.g;
            }
            self.all.h += sums.h;
            self.all.g += sums.g;
        }
    }

    /// The errors of all beams together; `None` without returns that tell.
    pub fn common(&self) -> SensorErrors {
        SensorErrors {
            beams: solved(&self.all).into_iter().collect(),
        }
    }

    /// The errors of each ring; those of all together where there are no rings.
    pub fn by_beam(&self) -> SensorErrors {
        if self.beams.len() < 2 {
            return self.common();
        }
        SensorErrors {
            beams: self.beams.iter().map(|sums| solved(sums).unwrap_or_default()).collect(),
        }
    }
}

fn solved(sums: &Sums) -> Option<BeamError> {
    let prior = Matrix3::from_diagonal(&Vector3::from(PRIOR.map(|sigma| sigma.powi(-2))));
    let e = (sums.h + prior).cholesky()?.solve(&sums.g);
    Some(BeamError {
        elevation_deg: e[0].to_degrees(),
        azimuth_deg: e[1].to_degrees(),
        range_m: e[2],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrections_undo_errors() {
        let error = BeamError {
            elevation_deg: 0.3,
            azimuth_deg: -0.2,
            range_m: 0.04,
        };
        let p = Vec3::new(7.0, -4.0, 1.5);
        let corrected = error.corrected(p).as_dvec3();
        let p = p.as_dvec3();
        assert!((p.length() - corrected.length() - 0.04).abs() < 1e-6);
        let elevation = |p: DVec3| p.z.atan2(p.truncate().length()).to_degrees();
        assert!((elevation(p) - elevation(corrected) - 0.3).abs() < 1e-5);
        assert!((p.y.atan2(p.x) - corrected.y.atan2(corrected.x) + 0.2_f64.to_radians()).abs() < 1e-6);
        assert_eq!(error.corrected(Vec3::Z), Vec3::Z);
    }

    #[test]
    fn errors_add_up_whether_of_all_beams_or_of_each() {
        let one = BeamError {
            range_m: 1.0,
            ..BeamError::default()
        };
        let (all, each) = (SensorErrors { beams: vec![one] }, SensorErrors { beams: vec![one; 3] });
        assert_eq!(SensorErrors::default().plus(&each), each);
        assert_eq!(all.plus(&SensorErrors::default()), all);
        let both = all.plus(&each);
        assert!(both.beams.len() == 3 && both.beams.iter().all(|beam| beam.range_m == 2.0));
    }
}
