//! What ring recovery finds, and what both ways to it need.

use glam::Vec3;

use super::approx::atan2_f32;

/// The ring of a return that no beam explains.
pub const NO_RING: u16 = u16::MAX;

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
    pub(super) cos: f32,
    pub(super) sin: f32,
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
