//! Ouster: packets of some columns of the range image, laid out as the sensor's metadata say.
//!
//! Layouts are those of the maker's manual and SDK, and so are the points: a pixel's beam turns with its column, and starts where
//! the beam leaves the lens, not in the axis. Against the SDK's output, this is tested.

mod beams;
mod imu;
mod metadata;
mod profile;

use std::ops::Range;

use tsdfuse::{ImuSample, SensorModel};

pub use beams::Beams;
pub use metadata::Metadata;
use profile::Profile;

use crate::bytes::{u8_at, u16_at, u32_at, u64_at};
use crate::decoder::{Head, Packets};
use crate::error::{PacketError, Result};
use crate::returns::Returns;
use crate::sensor::Sensor;

/// The kind of a packet that holds returns, in its first byte; others are those of the inertial measurement unit and of zones.
const RETURNS: u8 = 1;

/// Whether this looks like a packet of an Ouster; which one and how it is laid out, only its metadata say.
pub(crate) fn recognise(payload: &[u8]) -> Option<Sensor> {
    let heights = [16, 32, 64, 128];
    let is_legacy = || {
        let of = |height: usize| {
            let status = u32_at(payload, 16 + 12 * height);
            payload.len() == 16 * (20 + 12 * height) && (status == 0 || status == u32::MAX)
        };
        heights.into_iter().any(of)
    };
    let is_later = || {
        let column = |columns: usize| {
            let bytes = payload.len().checked_sub(64)?;
            let pixels = (bytes % columns == 0).then_some(bytes / columns)?.checked_sub(12)?;
            heights
                .into_iter()
                .find(|height| [4, 8, 12, 16, 20].map(|unit| unit * height).contains(&pixels))
        };
        payload.len() > 64
            && u8_at(payload, 0) == RETURNS
            && [16, 8, 4, 2, 1].into_iter().any(|columns| column(columns).is_some())
    };
    (is_legacy() || is_later()).then_some(Sensor::Ouster)
}

/// The ring of each row: 0 is the lowest.
pub fn rings(metadata: &Metadata) -> Vec<u16> {
    crate::hesai::rings(metadata.elevations_deg.iter().copied())
}

/// The decoder of Ouster's packets.
pub(crate) struct Ouster {
    metadata: Metadata,
    profile: Profile,
    beams: Beams,
    rings: Vec<u16>,
    /// The frame's number without the overflow of its 16 bits, and as it was told.
    frame: Option<(u32, u32)>,
}

/// The places of what is in a packet.
#[derive(Clone, Copy, Debug)]
struct Places {
    header: usize,
    column_header: usize,
    column: usize,
    packet: usize,
}

impl Ouster {
    pub(crate) fn new(calibration: crate::Calibration) -> Result<Self> {
        let metadata = match calibration {
            crate::Calibration::Ouster(metadata) => *metadata,
            crate::Calibration::Nominal => {
                let reason = "an Ouster needs its metadata, a JSON that its SDK and its web page write";
                return Err(PacketError::calibration(reason));
            }
            _ => return Err(PacketError::calibration("the calibration is not for an Ouster")),
        };
        let profile = Profile::of(&metadata)?;
        Ok(Self {
            rings: rings(&metadata),
            beams: Beams::new(&metadata),
            frame: None,
            profile,
            metadata,
        })
    }

    fn places(&self) -> Places {
        places(&self.metadata, &self.profile)
    }
}

fn places(metadata: &Metadata, profile: &Profile) -> Places {
    let (header, column_header, column_footer) = if profile.is_legacy { (0, 16, 4) } else { (32, 12, 0) };
    let column = column_header + metadata.rows() * profile.pixel + column_footer;
    Places {
        header,
        column_header,
        column,
        packet: header + metadata.columns_per_packet * column + header,
    }
}

impl Metadata {
    /// Whether a packet can be of this sensor: as long as its packets are, and with its serial number, where packets have it.
    pub fn fits(&self, payload: &[u8]) -> bool {
        let Ok(profile) = Profile::of(self) else {
            return false;
        };
        let serial = || {
            let at = if profile.has_long_frame { 11 } else { 7 };
            u64_at(payload, at) & 0xFF_FFFF_FFFF
        };
        let is_it = |serial: u64| self.serial.is_none_or(|known| serial == 0 || serial == known);
        payload.len() == places(self, &profile).packet && (profile.is_legacy || is_it(serial()))
    }
}

impl Packets for Ouster {
    fn head(&mut self, _near_ns: i64, payload: &[u8]) -> Result<Option<Head>> {
        let is_other = !self.profile.is_legacy && (2..=3).contains(&u8_at(payload, 0));
        if is_other || self.metadata.imu.fits(payload) {
            return Ok(None);
        }
        let places = self.places();
        if payload.len() != places.packet {
            let (found, wanted, profile) = (payload.len(), places.packet, &self.metadata.profile);
            let reason = format!("of {found} bytes is not of this sensor, whose have {wanted} (profile {profile})");
            return Err(PacketError::packet(reason));
        }
        let told = match &self.profile {
            profile if profile.is_legacy => u32::from(u16_at(payload, 10)),
            profile if profile.has_long_frame => u32_at(payload, 4),
            _ => u32::from(u16_at(payload, 2)),
        };
        let frame = match self.frame {
            Some((frame, before)) if self.profile.has_long_frame => frame.wrapping_add(told.wrapping_sub(before)),
            Some((frame, before)) => {
                frame.wrapping_add_signed(i32::from((told as u16).wrapping_sub(before as u16) as i16))
            }
            None => told,
        };
        let columns = self.metadata.columns_per_packet;
        let mut head = Head {
            columns,
            firings_per_column: 1.0,
            frame: Some(frame),
            frame_columns: self.metadata.window_columns() as f32,
            columns_per_turn: Some(self.metadata.columns_per_frame as u32),
            ..Head::default()
        };
        let mut first = None;
        for column in 0..columns {
            if let Some((id, time_ns)) = self.column(payload, column) {
                head.times_ns[column] = time_ns;
                first = first.or(Some((column, id)));
            } else {
                head.times_ns[column] = if column > 0 { head.times_ns[column - 1] } else { 0 };
            }
        }
        // Not one of its columns was measured.
        let Some((valid, id)) = first else { return Ok(None) };
        self.frame = Some((frame, told));
        let first_ns = head.times_ns[valid];
        head.times_ns[..valid].fill(first_ns);
        let per_frame = self.metadata.columns_per_frame.div_ceil(columns) as u32;
        let in_frame = (id.saturating_sub(valid) / columns) as u32;
        // Packets out of the window are not sent.
        let [from, _] = self.metadata.window;
        let (sent, from) = (self.metadata.window_packets() as u32, (from / columns) as u32);
        let in_window = (in_frame + per_frame).wrapping_sub(from) % per_frame;
        head.sequence = Some((frame.wrapping_mul(sent).wrapping_add(in_window), 32));
        Ok(Some(head))
    }

    fn decode(&self, payload: &[u8], head: &Head, columns: Range<usize>, returns: &mut Returns) {
        let places = self.places();
        for column in columns {
            let Some((id, _)) = self.column(payload, column) else {
                continue;
            };
            let at = places.header + column * places.column + places.column_header;
            for (row, &ring) in self.rings.iter().enumerate() {
                let at = at + row * self.profile.pixel;
                let mut before = 0;
                for (number, echo) in self.profile.echoes.iter().enumerate() {
                    let range_mm =
                        (u32_at(payload, at + echo.range) & self.profile.range_mask) << self.profile.range_shift;
                    if range_mm == 0 || range_mm == before {
                        returns.no_return += u64::from(number == 0);
                        continue;
                    }
                    before = range_mm;
                    let intensity = match echo.signal {
                        Some(signal) => f32::from(u16_at(payload, at + signal)),
                        None => f32::from(u8_at(payload, at + echo.reflectivity)),
                    };
                    let point = self.beams.point(row, id, range_mm);
                    returns.push(point, ring, head.times_ns[column], intensity);
                }
            }
        }
    }

    fn model(&self, columns: u32) -> Option<SensorModel> {
        self.metadata.model(columns)
    }

    fn notes(&self) -> Vec<String> {
        self.metadata.notes.clone()
    }

    fn imu(&self, _near_ns: i64, payload: &[u8]) -> Vec<ImuSample> {
        self.metadata.imu.samples(payload, &self.metadata.sensor_from_imu)
    }
}

impl Ouster {
    /// Measurement number and time of a column, if it was measured.
    fn column(&self, payload: &[u8], column: usize) -> Option<(usize, i64)> {
        let places = self.places();
        let at = places.header + column * places.column;
        let is_valid = if self.profile.is_legacy {
            u32_at(payload, at + places.column - 4) == u32::MAX
        } else {
            u8_at(payload, at + 10) & 1 != 0
        };
        let id = usize::from(u16_at(payload, at + 8));
        let time_ns = i64::try_from(u64_at(payload, at)).ok()?;
        (is_valid && id < self.metadata.columns_per_frame).then_some((id, time_ns))
    }
}

#[cfg(test)]
mod tests;
