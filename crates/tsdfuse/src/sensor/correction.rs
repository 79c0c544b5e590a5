//! Systematic errors of a LiDAR, taken back from its points.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::scan::Scan;

use super::MAX_BEAMS;

/// A larger error of an angle is none of a sensor's, degrees.
const MAX_DEG: f64 = 5.0;

/// A larger error of a range is none of a sensor's, metres.
const MAX_M: f64 = 2.0;

/// What is added to the returns of one beam.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BeamCorrection {
    /// To the angle above the sensor's horizontal plane, degrees.
    pub elevation_deg: f64,
    /// To the angle about the sensor's z axis, counterclockwise, degrees.
    pub azimuth_deg: f64,
    /// To the range, metres.
    pub range_m: f64,
}

/// What is added to a sensor's returns: its known systematic errors, taken back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorCorrection {
    /// Each return is turned up by this angle, degrees, about the horizontal axis across its azimuth.
    #[serde(rename = "elevation_correction_deg")]
    pub elevation_deg: f64,
    /// This is added to each range, metres.
    #[serde(rename = "range_correction_m")]
    pub range_m: f64,
    /// What is added besides to the returns of each ring, 0 = lowest. Scans without rings go without.
    #[serde(rename = "beam_corrections", skip_serializing_if = "Vec::is_empty")]
    pub beams: Vec<BeamCorrection>,
}

/// A correction that no sensor needs.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{0}")]
pub struct CorrectionError(String);

impl SensorCorrection {
    /// Of elevations alone.
    pub fn of_elevation(elevation_deg: f64) -> Self {
        Self {
            elevation_deg,
            ..Self::default()
        }
    }

    /// Whether returns stay as they are.
    pub fn is_none(&self) -> bool {
        self.elevation_deg == 0.0 && self.range_m == 0.0 && self.beams.iter().all(|b| *b == BeamCorrection::default())
    }

    /// Whether sensors can be off by this.
    ///
    /// # Errors
    /// Names the angle, range or number of beams that is too large.
    pub fn check(&self) -> Result<(), CorrectionError> {
        let least = |value: f64, most: f64, unit: &str| {
            if value.abs() <= most {
                Ok(())
            } else {
                let text = format!("{value}{unit} is no error of a sensor: at most {most}{unit} are possible");
                Err(CorrectionError(text))
            }
        };
        if self.beams.len() > MAX_BEAMS {
            let text = format!(
                "{} beams are corrected: at most {MAX_BEAMS} are possible",
                self.beams.len()
            );
            return Err(CorrectionError(text));
        }
        least(self.elevation_deg, MAX_DEG, "°")?;
        least(self.range_m, MAX_M, " m")?;
        self.beams.iter().try_for_each(|beam| {
            least(beam.elevation_deg, MAX_DEG, "°")?;
            least(beam.azimuth_deg, MAX_DEG, "°")?;
            least(beam.range_m, MAX_M, " m")
        })
    }

    /// Takes the errors out of a scan's points.
    pub fn apply(&self, scan: &mut Scan) {
        if self.is_none() {
            return;
        }
        let rings = scan.rings.as_deref().filter(|_| !self.beams.is_empty());
        if self.range_m == 0.0 && rings.is_none() {
            return turn_up(&mut scan.points, self.elevation_deg);
        }
        for (i, point) in scan.points.iter_mut().enumerate() {
            let beam = rings.and_then(|rings| self.beams.get(usize::from(*rings.get(i)?)));
            let beam = beam.copied().unwrap_or_default();
            *point = moved(
                *point,
                &BeamCorrection {
                    elevation_deg: self.elevation_deg + beam.elevation_deg,
                    azimuth_deg: beam.azimuth_deg,
                    range_m: self.range_m + beam.range_m,
                },
            );
        }
    }

    /// This correction, and one that was found needed after it.
    pub fn plus(&self, found: &Self) -> Self {
        let beam = |i: usize| {
            let [a, b] = [self, found].map(|of| of.beams.get(i).copied().unwrap_or_default());
            BeamCorrection {
                elevation_deg: a.elevation_deg + b.elevation_deg,
                azimuth_deg: a.azimuth_deg + b.azimuth_deg,
                range_m: a.range_m + b.range_m,
            }
        };
        Self {
            elevation_deg: self.elevation_deg + found.elevation_deg,
            range_m: self.range_m + found.range_m,
            beams: (0..self.beams.len().max(found.beams.len())).map(beam).collect(),
        }
    }
}

/// A return with its beam's correction; points above or below the sensor, and at it, stay where they are.
fn moved(point: Vec3, by: &BeamCorrection) -> Vec3 {
    let p = point.as_dvec3();
    let (range, across) = (p.length(), p.truncate().length());
    if !(across > 0.0) {
        return point;
    }
    let elevation = p.z.atan2(across) + by.elevation_deg.to_radians();
    let azimuth = p.y.atan2(p.x) + by.azimuth_deg.to_radians();
    let across = elevation.cos();
    (DVec3::new(across * azimuth.cos(), across * azimuth.sin(), elevation.sin()) * (range + by.range_m)).as_vec3()
}

/// Turns each point up by an angle about the horizontal axis across its azimuth.
/// Ranges and azimuths stay; points above or below the sensor stay where they are.
fn turn_up(points: &mut [Vec3], degrees: f64) {
    let (sin, cos) = degrees.to_radians().sin_cos();
    for point in points {
        let across = f64::from(point.x).hypot(f64::from(point.y));
        if across > 0.0 {
            let z = f64::from(point.z);
            let scale = cos - z / across * sin;
            *point = Vec3::new(
                (f64::from(point.x) * scale) as f32,
                (f64::from(point.y) * scale) as f32,
                (z * cos + across * sin) as f32,
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Vec<Vec3> {
        let point = |i: i32| {
            let (azimuth, elevation) = (0.3 * i as f32, (i as f32 * 0.37).sin() * 1.2);
            let (sin, cos) = elevation.sin_cos();
            Vec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin) * (1.0 + i as f32)
        };
        (0..200).map(point).collect()
    }

    fn elevation_deg(p: &Vec3) -> f64 {
        f64::from(p.z).atan2(f64::from(p.x).hypot(f64::from(p.y))).to_degrees()
    }

    #[test]
    fn elevations_rise_and_all_else_stays() {
        let (before, mut points) = (points(), points());
        turn_up(&mut points, 0.205);
        for (a, b) in before.iter().zip(&points) {
            assert!((elevation_deg(b) - elevation_deg(a) - 0.205).abs() < 1e-4, "{a} {b}");
            assert!((a.length() - b.length()).abs() < 1e-4 && (a.y.atan2(a.x) - b.y.atan2(b.x)).abs() < 1e-5);
        }
        let odd = [Vec3::ZERO, Vec3::Z, Vec3::NAN];
        let mut turned = odd;
        turn_up(&mut turned, 0.205);
        assert_eq!(turned[..2], odd[..2]);
        assert!(turned[2].is_nan());
    }

    #[test]
    fn each_beam_has_its_correction() {
        let before = points();
        let beam = |elevation_deg, azimuth_deg, range_m| BeamCorrection {
            elevation_deg,
            azimuth_deg,
            range_m,
        };
        let correction = SensorCorrection {
            elevation_deg: 0.1,
            range_m: 0.02,
            beams: vec![beam(0.3, -0.2, 0.04), BeamCorrection::default()],
        };
        let mut scan = Scan {
            points: before.clone(),
            ..Scan::default()
        };
        scan.rings = Some((0..before.len()).map(|i| (i % 3) as u16).collect());
        correction.apply(&mut scan);
        for (i, (a, b)) in before.iter().zip(&scan.points).enumerate() {
            let [elevation, azimuth, range] = if i % 3 == 0 {
                [0.4, -0.2, 0.06]
            } else {
                [0.1, 0.0, 0.02]
            };
            assert!((elevation_deg(b) - elevation_deg(a) - elevation).abs() < 1e-4);
            let turned = f64::from(b.y.atan2(b.x) - a.y.atan2(a.x)).to_degrees();
            assert!(
                ((turned - azimuth + 180.0).rem_euclid(360.0) - 180.0).abs() < 1e-3,
                "{turned}"
            );
            assert!((f64::from(b.length() - a.length()) - range).abs() < 1e-4);
        }
    }

    #[test]
    fn both_ways_of_turning_up_are_one() {
        let (mut fast, slow) = (points(), points());
        turn_up(&mut fast, 0.7);
        for (fast, slow) in fast.iter().zip(slow) {
            let by = BeamCorrection {
                elevation_deg: 0.7,
                ..BeamCorrection::default()
            };
            assert!(fast.distance(moved(slow, &by)) < 1e-5 * slow.length());
        }
    }

    #[test]
    fn corrections_add_up_and_impossible_ones_are_refused() {
        let one = BeamCorrection {
            range_m: 0.5,
            ..BeamCorrection::default()
        };
        let each = SensorCorrection {
            beams: vec![one; 3],
            ..SensorCorrection::of_elevation(0.2)
        };
        assert_eq!(SensorCorrection::default().plus(&each), each);
        let both = each.plus(&each);
        assert!(both.elevation_deg == 0.4 && both.beams.iter().all(|beam| beam.range_m == 1.0));
        assert!(both.check().is_ok() && !both.is_none() && SensorCorrection::default().is_none());
        let error = |of: SensorCorrection| of.check().unwrap_err().to_string();
        assert_eq!(
            error(SensorCorrection::of_elevation(7.0)),
            "7° is no error of a sensor: at most 5° are possible"
        );
        assert!(error(SensorCorrection::of_elevation(f64::NAN)).starts_with("NaN"));
        assert!(error(both.plus(&both).plus(&both)).starts_with("3 m"));
    }
}
