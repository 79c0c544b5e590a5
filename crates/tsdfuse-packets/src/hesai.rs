//! Hesai: packets of a header, blocks of one azimuth each, and a tail with the time.
//!
//! Layouts and firing times are those of the makers' manuals; points are computed as its ROS drivers and nebula do: the azimuth of a
//! return is its block's, plus the laser's offset.

mod angles;
mod layout;
mod nominal;

use std::ops::Range;

use tsdfuse::SensorModel;
use tsdfuse::glam::Vec3;

pub use angles::Angles;
pub(crate) use angles::parse_csv;
use layout::Layout;

use crate::bytes::{u8_at, u16_at, u32_at};
use crate::cutter::TURN;
use crate::decoder::{Head, Packets};
use crate::error::{PacketError, Result};
use crate::returns::Returns;
use crate::sensor::Sensor;

/// Which model sends such a packet.
pub(crate) fn recognise(payload: &[u8]) -> Option<Sensor> {
    let all = Sensor::ALL
        .into_iter()
        .filter_map(|sensor| Some((sensor, Layout::of(sensor)?)));
    all.into_iter()
        .find(|(_, layout)| layout.fits(payload).is_ok())
        .map(|(sensor, _)| sensor)
}

/// The ring of each laser: 0 is the lowest.
pub(crate) fn rings(elevations: impl Iterator<Item = f64>) -> Vec<u16> {
    let elevations: Vec<f64> = elevations.collect();
    let mut order: Vec<usize> = (0..elevations.len()).collect();
    order.sort_by(|&a, &b| elevations[a].total_cmp(&elevations[b]).then(a.cmp(&b)));
    let mut rings = vec![0; elevations.len()];
    for (ring, laser) in order.into_iter().enumerate() {
        rings[laser] = ring as u16;
    }
    rings
}

/// A sensor's model from the elevations of its lasers, degrees. Two that are the same are moved apart by less than anything can
/// measure, since rings have an order.
pub(crate) fn model(
    sensor: Sensor,
    elevations_deg: impl Iterator<Item = f64>,
    columns: u32,
    ranges: (f32, f32),
) -> Option<SensorModel> {
    let mut elevations: Vec<f32> = elevations_deg.map(|e| e as f32).collect();
    elevations.sort_by(f32::total_cmp);
    for i in 1..elevations.len() {
        if elevations[i] <= elevations[i - 1] {
            elevations[i] = elevations[i - 1].next_up();
        }
    }
    SensorModel::from_beams(sensor.name(), elevations, columns, ranges).ok()
}

/// A laser, ready to use.
#[derive(Clone, Copy, Debug)]
struct Beam {
    ring: u16,
    azimuth_rad: f64,
    elevation_rad: f64,
    elevation_sin_cos: (f64, f64),
}

/// The decoder of Hesai's packets.
pub(crate) struct Hesai {
    sensor: Sensor,
    layout: Layout,
    beams: Vec<Beam>,
    is_nominal: bool,
    bad_clock: bool,
}

impl Hesai {
    pub(crate) fn new(sensor: Sensor, calibration: crate::Calibration) -> Result<Self> {
        let layout = Layout::of(sensor)
            .ok_or_else(|| PacketError::calibration(format!("a {} is not a Hesai's", sensor.name())))?;
        let (angles, is_nominal) = match calibration {
            crate::Calibration::Hesai(angles) => (angles, false),
            crate::Calibration::Nominal => {
                let missing = || {
                    let reason = format!("a {} needs its calibration, a CSV of angles", sensor.name());
                    PacketError::calibration(reason)
                };
                (nominal::angles(sensor).ok_or_else(missing)?, true)
            }
            _ => return Err(PacketError::calibration("the calibration is not for a Hesai")),
        };
        if angles.deg.len() != layout.lasers {
            let (found, wanted) = (angles.deg.len(), layout.lasers);
            let reason = format!("the calibration has {found} lasers, a {} has {wanted}", sensor.name());
            return Err(PacketError::calibration(reason));
        }
        let rings = rings(angles.deg.iter().map(|[elevation, _]| *elevation));
        let beam = |(&[elevation, azimuth], ring): (&[f64; 2], u16)| Beam {
            ring,
            azimuth_rad: azimuth.to_radians(),
            elevation_rad: elevation.to_radians(),
            elevation_sin_cos: elevation.to_radians().sin_cos(),
        };
        Ok(Self {
            sensor,
            beams: angles.deg.iter().zip(rings).map(beam).collect(),
            layout,
            is_nominal,
            bad_clock: false,
        })
    }

    /// Where the range of a laser's return lies in the packet.
    fn at(&self, block: usize, laser: usize) -> usize {
        self.layout.block_at(block) + self.layout.block_head + laser * self.layout.unit
    }

    /// Hundredths of a degree.
    fn azimuth(&self, payload: &[u8], block: usize) -> u16 {
        u16_at(payload, self.layout.block_at(block) + self.layout.block_head - 2) % TURN
    }

    /// How often each firing is reported: the blocks of so many returns follow each other.
    fn returns(&self, payload: &[u8]) -> Option<usize> {
        Some(match u8_at(payload, self.layout.tail.mode) {
            0x33 | 0x34 | 0x37 | 0x38 => 1,
            0x03 | 0x39..=0x3c => 2,
            0x3d if self.layout.blocks.is_multiple_of(3) => 3,
            _ => return None,
        })
    }
}

impl Packets for Hesai {
    fn head(&mut self, near_ns: i64, payload: &[u8]) -> Result<Option<Head>> {
        // Packets of GPS.
        if payload.len() == 512 {
            return Ok(None);
        }
        self.layout
            .fits(payload)
            .map_err(|reason| PacketError::packet(format!("is not a {}'s: {reason}", self.sensor.name())))?;
        let returns = self.returns(payload).ok_or_else(|| {
            let mode = u8_at(payload, self.layout.tail.mode);
            PacketError::packet(format!("has a return mode that is not known: {mode:#04x}"))
        })?;
        let tail = &self.layout.tail;
        let micros = u32_at(payload, tail.time);
        let date = |i: usize| u8_at(payload, tail.date + i);
        let date: [u8; 6] = std::array::from_fn(date);
        let secs = date_secs(date, tail.first_year);
        self.bad_clock |= secs.is_none();
        let time_ns = match secs {
            Some(secs) => secs * 1_000_000_000 + i64::from(micros) * 1000,
            None => near_ns,
        };
        let mut head = Head {
            columns: self.layout.blocks,
            firings_per_column: 1.0 / returns as f32,
            ..Head::default()
        };
        for block in 0..self.layout.blocks {
            head.azimuths[block] = self.azimuth(payload, block);
            let offset_ns = self.layout.block_offset_ns(block, returns);
            head.times_ns[block] = time_ns.saturating_add(offset_ns);
        }
        head.sequence = self.layout.sequence_at(payload).map(|at| (u32_at(payload, at), 32));
        let firings = (self.layout.blocks / returns).max(1);
        head.period_ns = self.layout.cycle_ns * firings as i64;
        // The motor's speed, revolutions per minute.
        let rpm = u16_at(payload, tail.speed);
        if (60..=3000).contains(&rpm) {
            let per_turn = 60e9 / f64::from(rpm) / self.layout.cycle_ns as f64;
            head.columns_per_turn = Some((per_turn.round() as u32).clamp(1, 16_384));
        }
        Ok(Some(head))
    }

    fn decode(&self, payload: &[u8], head: &Head, columns: Range<usize>, out: &mut Returns) {
        let returns = self.returns(payload).unwrap_or(1);
        let unit_m = self.layout.range_unit_m(payload);
        for block in columns {
            let azimuth_rad = (f64::from(head.azimuths[block]) / 100.0).to_radians();
            let first = block - block % returns;
            for (laser, beam) in self.beams.iter().enumerate() {
                let at = self.at(block, laser);
                let (range, reflectivity) = (u16_at(payload, at), u8_at(payload, at + 2));
                if range == 0 {
                    out.no_return += u64::from(block == first);
                    continue;
                }
                // Of returns that are one, the last is kept, as the drivers do.
                let is_again = |later: usize| {
                    let later = self.at(later, laser);
                    (u16_at(payload, later), u8_at(payload, later + 2)) == (range, reflectivity)
                };
                if (block + 1..first + returns).any(is_again) {
                    continue;
                }
                let range_m = f64::from(range) * unit_m;
                let (sin_e, cos_e) = beam.elevation_sin_cos;
                let (sin_a, cos_a) = (azimuth_rad + beam.azimuth_rad).sin_cos();
                let flat = range_m * cos_e;
                let point = Vec3::new((flat * sin_a) as f32, (flat * cos_a) as f32, (range_m * sin_e) as f32);
                let offset_ns = self.layout.laser_offset_ns(payload, block, laser, returns);
                out.push(
                    point,
                    beam.ring,
                    head.times_ns[block].saturating_add(offset_ns),
                    f32::from(reflectivity),
                );
            }
        }
    }

    fn model(&self, columns: u32) -> Option<SensorModel> {
        let elevations = self.beams.iter().map(|beam| beam.elevation_rad.to_degrees());
        model(self.sensor, elevations, columns, self.layout.ranges_m)
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.is_nominal {
            notes.push(self.sensor.nominal_note());
        }
        if self.bad_clock {
            notes.push("packets with an impossible date: their times are those at which they were received".to_owned());
        }
        notes
    }
}

/// Seconds since 1970 of year, month, day, hour, minute and second; or, where the first byte is 0, of a 5-byte count.
fn date_secs(date: [u8; 6], first_year: i64) -> Option<i64> {
    let [year, month, day, hour, minute, second] = date.map(i64::from);
    if year == 0 {
        let secs = date.iter().fold(0, |secs, &byte| secs << 8 | i64::from(byte));
        return (secs > 0 && secs < 1 << 33).then_some(secs);
    }
    if !(1..=12).contains(&month) || !(1..=31).contains(&day) || hour > 23 || minute > 59 || second > 60 {
        return None;
    }
    // Days from civil, by Howard Hinnant; March is the first month of its year.
    let (y, m) = (year + first_year - i64::from(month <= 2), (month + 9) % 12);
    let (era, of_era) = (y.div_euclid(400), y.rem_euclid(400));
    let day_of_year = (153 * m + 2) / 5 + day - 1;
    let days = era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + day_of_year - 719_468;
    Some(days * 86_400 + hour * 3_600 + minute * 60 + second)
}

#[cfg(test)]
mod tests;
