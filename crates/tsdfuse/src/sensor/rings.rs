//! Ring recovery: which laser measured each return of a cloud that lost its laser ids.
//!
//! Every laser of a rotating sensor keeps its elevation, so a return's elevation tells its laser, if the return is given
//! in the sensor frame at its own time. What remains of the vehicle's wobble within a sweep looks like a small tilt of
//! the sensor; it is estimated and taken out (on PandaSet it reaches 0.05°, a third of the beam spacing). Where
//! elevations are not sharp, the order of the points may tell instead: see [`super::rings_by_order`].

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::approx::atan2_f32;
use super::{MAX_BEAMS, SensorModel};

/// The ring of a return that no beam explains.
pub const NO_RING: u16 = u16::MAX;

/// No return is farther than this from the beam that measured it, however wide the gap between beams.
const REACH_DEG: f32 = 0.5;
/// A deviation that speaks for a beam is at most this, however wide the gap.
const SHARP_DEG: f32 = 0.25;
/// Below this share of sharp returns, elevations do not tell the ring.
pub(super) const CLEAR: f32 = 0.9;
/// A larger apparent tilt of the sensor is not the wobble of a vehicle within a sweep.
const MAX_TILT_DEG: f64 = 0.25;
/// How many returns are enough to estimate three numbers.
const TILT_SAMPLE: u32 = 8192;

/// The rings of a cloud, and how well they explain it.
#[derive(Clone, Debug, PartialEq)]
pub struct RingRecovery {
    /// The ring of each point, 0 = lowest; [`NO_RING`] where there is none.
    pub rings: Vec<u16>,
    /// What the rings were read from.
    pub source: RingSource,
    /// Share of the valid points that speak for their ring. By elevation: deviating by less than a quarter of the gap to
    /// the next beam, and 0.25°; by order: less than half of the way to the neighbouring ring at that azimuth.
    pub within_tolerance: f32,
    /// Median deviation of the valid points from their ring, degrees.
    pub median_deviation_deg: f32,
}

/// What rings can be read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RingSource {
    /// Elevation above the sensor's horizontal plane.
    Elevation,
    /// Order of the points: one laser's whole turn after the other's.
    Order,
}

/// Renumbers rings so that 0 is the lowest, whatever the sensor's own numbering; true if anything changed.
///
/// Numbers of 1024 and more become [`NO_RING`].
pub fn sort_rings(points: &[Vec3], rings: &mut [u16]) -> bool {
    let elevations = median_elevations(points, rings);
    let present: Vec<usize> = (0..elevations.len()).filter(|&r| elevations[r].is_some()).collect();
    if present.is_sorted_by(|&a, &b| elevations[a] < elevations[b]) {
        return false;
    }
    let mut renamed = vec![NO_RING; elevations.len()];
    if present.is_sorted_by(|&a, &b| elevations[a] > elevations[b]) {
        // Upside down: rings without a return keep their place.
        let names = (0..elevations.len()).rev();
        names.zip(&mut renamed).for_each(|(new, name)| *name = new as u16);
    } else {
        let mut by_elevation = present;
        by_elevation.sort_by(|&a, &b| elevations[a].unwrap_or(0.0).total_cmp(&elevations[b].unwrap_or(0.0)));
        by_elevation
            .iter()
            .enumerate()
            .for_each(|(new, &old)| renamed[old] = new as u16);
    }
    for ring in rings {
        *ring = renamed.get(usize::from(*ring)).copied().unwrap_or(NO_RING);
    }
    true
}

/// Median elevation of each ring, degrees; `None` for rings without a return.
pub(super) fn median_elevations(points: &[Vec3], rings: &[u16]) -> Vec<Option<f32>> {
    let mut seen: Vec<Vec<f32>> = Vec::new();
    for (point, &ring) in points.iter().zip(rings) {
        let ring = usize::from(ring);
        if let (true, Some(sight)) = (ring < MAX_BEAMS, Sight::of(*point)) {
            if ring >= seen.len() {
                seen.resize(ring + 1, Vec::new());
            }
            seen[ring].push(sight.elevation_deg);
        }
    }
    seen.iter_mut().map(|elevations| median(elevations)).collect()
}

/// The middle one of some numbers, which are reordered.
pub(super) fn median(numbers: &mut [f32]) -> Option<f32> {
    let middle = numbers.len() / 2;
    (!numbers.is_empty()).then(|| *numbers.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Where a return is seen.
#[derive(Clone, Copy)]
pub(super) struct Sight {
    /// Above the sensor's horizontal plane.
    pub(super) elevation_deg: f32,
    /// Unit vector of the azimuth; zero at the poles.
    cos: f32,
    sin: f32,
}

impl Sight {
    /// `None` for an invalid point.
    #[inline]
    pub(super) fn of(p: Vec3) -> Option<Self> {
        if !p.is_finite() || p == Vec3::ZERO {
            return None;
        }
        let rho = (p.x * p.x + p.y * p.y).sqrt();
        let per_rho = if rho > 0.0 { 1.0 / rho } else { 0.0 };
        Some(Self {
            elevation_deg: atan2_f32(p.z, rho).to_degrees(),
            cos: p.x * per_rho,
            sin: p.y * per_rho,
        })
    }
}

/// Apparent tilt of the sensor: elevations are read `a + b·cos φ + c·sin φ` too high at azimuth φ, degrees.
#[derive(Clone, Copy, Default)]
struct Tilt([f32; 3]);

impl Tilt {
    #[inline]
    fn at(self, s: Sight) -> f32 {
        self.0[0] + self.0[1] * s.cos + self.0[2] * s.sin
    }
}

/// A beam table prepared for nearest-beam queries, degrees.
pub(super) struct Beams {
    elevations: Vec<f32>,
    /// Upper end of each beam's half of the gap.
    borders: Vec<f32>,
    /// Smaller gap beside each beam.
    gaps: Vec<f32>,
}

impl Beams {
    pub(super) fn new(model: &SensorModel) -> Self {
        let elevations = model.elevations_deg.clone();
        let pairs = || elevations.windows(2).map(|pair| (pair[0], pair[1]));
        let borders = pairs().map(|(a, b)| 0.5 * (a + b)).collect();
        let gaps: Vec<f32> = pairs().map(|(a, b)| b - a).collect();
        let beside = |i: usize| gaps.get(i).copied().unwrap_or(f32::INFINITY);
        let gaps = (0..elevations.len())
            .map(|i| beside(i).min(beside(i.wrapping_sub(1))))
            .collect();
        Self {
            elevations,
            borders,
            gaps,
        }
    }

    /// The nearest beam, and how far above it the elevation is.
    #[inline]
    fn nearest(&self, elevation_deg: f32) -> (usize, f32) {
        let ring = self.borders.partition_point(|&b| b < elevation_deg);
        (ring, elevation_deg - self.elevations[ring])
    }

    /// Whether a deviation speaks for the beam.
    fn is_sharp(&self, ring: usize, deviation: f32) -> bool {
        deviation.abs() < (0.25 * self.gaps[ring]).min(SHARP_DEG)
    }

    /// Whether a return can be of the beam at all.
    fn is_within_reach(&self, ring: usize, deviation: f32) -> bool {
        deviation.abs() <= (0.5 * self.gaps[ring]).min(REACH_DEG)
    }

    /// Rings by elevation alone.
    pub(super) fn recover(&self, points: &[Vec3]) -> RingRecovery {
        let tilt = self.tilt(points);
        let (mut rings, mut deviations) = (Vec::new(), Vec::new());
        points
            .par_iter()
            .with_min_len(4096)
            .map(|&p| {
                let Some(sight) = Sight::of(p) else {
                    return (NO_RING, f32::NAN);
                };
                let (ring, deviation) = self.nearest(sight.elevation_deg - tilt.at(sight));
                let reached = self.is_within_reach(ring, deviation);
                (if reached { ring as u16 } else { NO_RING }, deviation.abs())
            })
            .unzip_into_vecs(&mut rings, &mut deviations);
        let sharp = |(&ring, &d): (&u16, &f32)| ring != NO_RING && self.is_sharp(usize::from(ring), d);
        let sharp = rings.iter().zip(&deviations).filter(|&pair| sharp(pair)).count();
        deviations.retain(|d| !d.is_nan());
        RingRecovery {
            rings,
            source: RingSource::Elevation,
            within_tolerance: sharp as f32 / deviations.len().max(1) as f32,
            median_deviation_deg: median(&mut deviations).unwrap_or(0.0),
        }
    }

    /// Least squares over a sample, twice refined; no tilt where it comes out implausible.
    fn tilt(&self, points: &[Vec3]) -> Tilt {
        let sights: Vec<Sight> = sample(points, TILT_SAMPLE)
            .filter_map(|i| Sight::of(points[i]))
            .collect();
        let mut tilt = Tilt::default();
        for _ in 0..3 {
            let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
            for &sight in &sights {
                let (ring, left_over) = self.nearest(sight.elevation_deg - tilt.at(sight));
                if left_over.abs() < (0.4 * self.gaps[ring]).min(SHARP_DEG) {
                    let row = DVec3::new(1.0, f64::from(sight.cos), f64::from(sight.sin));
                    normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                    right += row * f64::from(left_over + tilt.at(sight));
                }
            }
            if normal.determinant() < 1.0 {
                return Tilt::default(); // too few points, or all in one direction
            }
            let solved = normal.inverse() * right;
            if !(solved.is_finite() && solved.abs().max_element() < MAX_TILT_DEG) {
                return Tilt::default();
            }
            tilt = Tilt(solved.as_vec3().to_array());
        }
        tilt
    }
}

/// About `wanted` indices of a cloud, always the same, in no step with rings or columns.
pub(super) fn sample(points: &[Vec3], wanted: u32) -> impl Iterator<Item = usize> {
    let share = f64::from(wanted) / points.len().max(1) as f64;
    let limit = (share * f64::from(u32::MAX)) as u32; // saturates: all of them
    (0..points.len()).filter(move |&i| {
        // Fibonacci hashing alone is too even; two rounds with a shift are not.
        let h = (i as u32).wrapping_mul(0x9E37_79B9);
        (h ^ (h >> 15)).wrapping_mul(0x85EB_CA6B) <= limit
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::testing::scan_room;
    use crate::sensor::{model, names, recover_rings};

    #[test]
    fn every_known_sensor_gets_its_rings_back() {
        for name in names() {
            let model = model(name).unwrap();
            let (points, rings) = scan_room(&model, |_| 0.0);
            let found = recover_rings(&points, &model);
            assert!(found.rings == rings, "{name}");
            assert!(
                found.within_tolerance == 1.0 && found.median_deviation_deg < 1e-4,
                "{name}: {found:?}"
            );
            assert_eq!(found.source, RingSource::Elevation);
        }
    }

    #[test]
    fn a_small_tilt_is_found_and_a_large_one_is_not_believed() {
        let model = model("pandar64").unwrap();
        let (points, rings) = scan_room(&model, |_| 0.0);
        let tilted = |deg: f32| -> Vec<Vec3> {
            let tilt = glam::Quat::from_rotation_y(deg.to_radians());
            points.iter().map(|&p| tilt * p).collect()
        };
        let found = recover_rings(&tilted(0.06), &model);
        assert!(
            found.within_tolerance > 0.999 && found.median_deviation_deg < 0.001,
            "{}",
            found.within_tolerance
        );
        assert!(found.rings == rings);
        let found = Beams::new(&model).recover(&tilted(5.0));
        assert!(found.within_tolerance < 0.8, "{}", found.within_tolerance);
    }

    #[test]
    fn what_no_beam_explains_has_no_ring() {
        let model = model("pandar64").unwrap();
        let at = |deg: f32| Vec3::new(deg.to_radians().cos(), 0.0, deg.to_radians().sin()) * 9.0;
        let points = [
            Vec3::ZERO,
            Vec3::NAN,
            at(14.882),
            at(13.0),
            at(15.3),
            at(16.0),
            at(-24.9),
            at(-26.0),
            Vec3::Z,
        ];
        let found = recover_rings(&points, &model);
        let none = NO_RING;
        assert_eq!(found.rings, [none, none, 63, none, 63, none, 0, none, none]);
    }

    #[test]
    fn rings_are_renumbered_from_the_lowest() {
        let model = model("vlp16").unwrap();
        let (points, rings) = scan_room(&model, |_| 0.0);
        let renamed = |f: fn(u16) -> u16| rings.iter().map(|&r| f(r)).collect::<Vec<u16>>();
        assert!(!sort_rings(&points, &mut rings.clone()));
        // upside down, and in the order of firing, where even and odd lasers alternate
        for scrambled in [|r| 15 - r, |r| if r < 8 { 2 * r } else { 2 * r - 15 }] {
            let mut sorted = renamed(scrambled);
            assert!(sort_rings(&points, &mut sorted));
            assert!(sorted == rings);
        }
        // upside down with a ring that returned nothing
        let seen: Vec<usize> = (0..points.len()).filter(|&i| rings[i] != 4).collect();
        let points: Vec<Vec3> = seen.iter().map(|&i| points[i]).collect();
        let mut sorted: Vec<u16> = seen.iter().map(|&i| 15 - rings[i]).collect();
        sort_rings(&points, &mut sorted);
        assert!(sorted.iter().zip(&seen).all(|(&r, &i)| r == rings[i]));
    }

    #[test]
    fn samples_have_the_size_asked_for_and_miss_no_ring() {
        let points = vec![Vec3::X; 64 * 1800];
        let mut of_ring = [0; 64];
        sample(&points, 8192).for_each(|i| of_ring[i % 64] += 1);
        let total: usize = of_ring.iter().sum();
        assert!(
            (7500..9000).contains(&total) && of_ring.iter().all(|&n| n > 64),
            "{of_ring:?}"
        );
        assert_eq!(sample(&points[..99], 8192).count(), 99);
    }
}
