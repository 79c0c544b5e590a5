//! Velodyne: 1206 bytes of 12 blocks, each with an azimuth and 32 returns; 512 bytes with what a GNSS receiver told,
//! and an HDL-32E's gyroscopes and accelerometers.
//!
//! Layouts, firing times and angles are those of the makers' manuals. Points are computed as the ROS drivers of these sensors
//! do (`velodyne_pointcloud`, nebula), against whose output they are tested:
//!
//! | sensor | azimuth of a laser |
//! |---|---|
//! | VLP-16, VLP-32C, VLS-128 | between those of its block and the next, by the time of firing. In a packet's last block, that of the block; of second returns, that of the next firing: the drivers are 0.2° off there, and so is this. The drivers take the lasers of a VLP-32C to fire one by one, though they fire in pairs |
//! | HDL-32E | the same without the exceptions; the last block goes on as the one before (manual) |
//! | HDL-64E | its block's |

mod calibration;
mod imu;
mod nominal;

use std::ops::Range;

use tsdfuse::glam::Vec3;
use tsdfuse::{ImuSample, SensorModel};

pub use calibration::{Calibration, Laser};
pub(crate) use calibration::{parse_xml, parse_yaml};

use crate::bytes::{u8_at, u16_at, u32_at};
use crate::cutter::{TURN, turned};
use crate::decoder::{Head, Packets};
use crate::error::{PacketError, Result};
use crate::hesai;
use crate::position::{self, Position};
use crate::returns::Returns;
use crate::sensor::Sensor;

/// Every packet of returns is this long, and every packet of a position.
const PACKET: usize = 1206;
const POSITION: usize = 512;
const BLOCKS: usize = 12;
const BLOCK: usize = 100;
const LASERS_PER_BLOCK: usize = 32;
/// Where the time, the mode and the model are.
const TIME: usize = 1200;
const MODE: usize = 1204;
const MODEL: usize = 1205;
/// In a packet of a position: when it was sent, and what the receiver told last.
const SENT: usize = 198;
const SENTENCE: usize = 206;
/// A receiver tells a place sooner after it was there: if not, the sensor's clock does not follow it.
const LATEST_NS: i64 = 2_000_000_000;
const DUAL: u8 = 0x39;
const HOUR_NS: i64 = 3_600_000_000_000;

/// The marks of a block: which lasers it holds.
const BANKS: [u16; 4] = [0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF];

/// Which model sends such a packet.
pub(crate) fn recognise(payload: &[u8]) -> Option<Sensor> {
    if payload.len() != PACKET {
        return None;
    }
    let marks: Vec<u16> = (0..BLOCKS).map(|block| u16_at(payload, block * BLOCK)).collect();
    if !marks.first().is_some_and(|mark| BANKS.contains(mark)) {
        return None;
    }
    match u8_at(payload, MODEL) {
        _ if marks.contains(&BANKS[3]) => Some(Sensor::Vls128),
        _ if marks.contains(&BANKS[1]) => Some(Sensor::Hdl64e),
        0x21 => Some(Sensor::Hdl32e),
        0x22 => Some(Sensor::Vlp16),
        0x24 => Some(Sensor::Vlp16HiRes),
        0x28 => Some(Sensor::Vlp32c),
        0x63 | 0xA1 => Some(Sensor::Vls128),
        _ => None,
    }
}

/// How a model's packets are to be read.
#[derive(Clone, Copy, Debug)]
struct Layout {
    lasers: usize,
    /// Blocks that one firing of all lasers takes, and firings of all lasers in a block.
    blocks_per_firing: usize,
    firings_per_block: usize,
    /// Nanoseconds from one firing of all lasers to the next, and from laser to laser.
    cycle_ns: f64,
    laser_ns: f64,
    /// Lasers that fire at once.
    at_once: usize,
    range_unit_m: f64,
    min_range_m: f32,
    max_range_m: f32,
}

fn layout(sensor: Sensor) -> Layout {
    let usual = Layout {
        lasers: 32,
        blocks_per_firing: 1,
        firings_per_block: 1,
        cycle_ns: 55_296.0,
        laser_ns: 2_304.0,
        at_once: 1,
        range_unit_m: 0.002,
        min_range_m: 0.9,
        max_range_m: 100.0,
    };
    match sensor {
        Sensor::Vlp32c => Layout {
            at_once: 2,
            range_unit_m: 0.004,
            max_range_m: 200.0,
            ..usual
        },
        Sensor::Hdl32e => Layout {
            cycle_ns: 46_080.0,
            laser_ns: 1_152.0,
            min_range_m: 1.0,
            ..usual
        },
        Sensor::Hdl64e => Layout {
            lasers: 64,
            blocks_per_firing: 2,
            cycle_ns: 48_000.0,
            laser_ns: 1_500.0,
            max_range_m: 120.0,
            ..usual
        },
        Sensor::Vls128 => Layout {
            lasers: 128,
            blocks_per_firing: 4,
            cycle_ns: 53_300.0,
            laser_ns: 2_665.0,
            at_once: 8,
            range_unit_m: 0.004,
            max_range_m: 245.0,
            ..usual
        },
        _ => Layout {
            lasers: 16,
            firings_per_block: 2,
            ..usual
        },
    }
}

/// A laser's angles and offsets, ready to use.
#[derive(Clone, Copy, Debug)]
struct Beam {
    ring: u16,
    laser: Laser,
    elevation_sin_cos: (f64, f64),
}

/// The decoder of Velodyne's packets.
pub(crate) struct Velodyne {
    sensor: Sensor,
    layout: Layout,
    beams: Vec<Beam>,
    range_unit_m: f64,
    is_nominal: bool,
    /// What the GNSS receiver told last.
    sentence: Option<Vec<u8>>,
}

impl Velodyne {
    pub(crate) fn new(sensor: Sensor, calibration: crate::Calibration) -> Result<Self> {
        let layout = layout(sensor);
        let (calibration, is_nominal) = match calibration {
            crate::Calibration::Velodyne(calibration) => (calibration, false),
            crate::Calibration::Nominal => {
                let missing = || PacketError::calibration("an HDL-64E needs its calibration, an XML or a YAML");
                (nominal::calibration(sensor).ok_or_else(missing)?, true)
            }
            _ => return Err(PacketError::calibration("the calibration is not for a Velodyne")),
        };
        if calibration.lasers.len() != layout.lasers {
            let (found, wanted) = (calibration.lasers.len(), layout.lasers);
            let reason = format!("the calibration has {found} lasers, a {} has {wanted}", sensor.name());
            return Err(PacketError::calibration(reason));
        }
        let rings = hesai::rings(calibration.lasers.iter().map(|laser| laser.elevation_rad));
        let beam = |(&laser, ring): (&Laser, u16)| Beam {
            ring,
            laser,
            elevation_sin_cos: laser.elevation_rad.sin_cos(),
        };
        Ok(Self {
            sensor,
            layout,
            beams: calibration.lasers.iter().zip(rings).map(beam).collect(),
            range_unit_m: calibration.range_unit_m.unwrap_or(layout.range_unit_m),
            is_nominal,
            sentence: None,
        })
    }

    /// The bank of a block's lasers, by its mark.
    fn bank(&self, payload: &[u8], block: usize) -> Option<usize> {
        let mark = u16_at(payload, block * BLOCK);
        let bank = BANKS.iter().position(|&bank| bank == mark)?;
        (bank < self.layout.blocks_per_firing).then_some(bank)
    }

    /// Blocks that hold returns.
    fn blocks(&self, is_dual: bool) -> usize {
        // One firing of 128 lasers, twice; the rest of the packet is empty.
        if is_dual && self.sensor == Sensor::Vls128 {
            8
        } else {
            BLOCKS
        }
    }

    /// The number of the firing of a block's first laser.
    fn firing(&self, block: usize, is_dual: bool) -> usize {
        let returns = 1 + usize::from(is_dual);
        block / (returns * self.layout.blocks_per_firing) * self.layout.firings_per_block
    }

    /// Time of a laser's firing after the packet's, nanoseconds.
    fn offset_ns(&self, block: usize, laser: usize, firing_in_block: usize, is_dual: bool) -> i64 {
        let Layout { cycle_ns, laser_ns, .. } = self.layout;
        let firing = (self.firing(block, is_dual) + firing_in_block) as f64;
        let slot = match self.sensor {
            // A pause after the first half of the lasers; the first firing is 8.7 µs before the packet's time.
            Sensor::Vls128 => (laser / 8 + laser / 64) as f64 - 8_700.0 / laser_ns,
            // Both blocks of 32 lasers fire together.
            Sensor::Hdl64e => (laser % 32) as f64,
            _ => (laser / self.layout.at_once) as f64,
        };
        (firing * cycle_ns + slot * laser_ns).round() as i64
    }

    /// Azimuth of each block, and how far it goes on until the next firing, hundredths of a degree.
    fn azimuths(&self, payload: &[u8], is_dual: bool) -> [(u16, f64); BLOCKS] {
        let azimuth = |block: usize| u16_at(payload, block * BLOCK + 2) % TURN;
        let mut azimuths: [(u16, f64); BLOCKS] = std::array::from_fn(|block| (azimuth(block), 0.0));
        let step = |from: u16, to: u16| f64::from(turned(to, from));
        match self.sensor {
            Sensor::Hdl64e => {}
            Sensor::Hdl32e => {
                let apart = 1 + usize::from(is_dual);
                for (block, (_, going_on)) in azimuths.iter_mut().enumerate() {
                    let from = block.min(BLOCKS - 1 - apart);
                    *going_on = step(azimuth(from), azimuth(from + apart));
                }
            }
            // The drivers' rule, with what is odd in it: the last block of the first returns keeps its azimuth, and second
            // returns have that of the next firing.
            _ => {
                let apart = 1 + usize::from(is_dual);
                let (mut next, mut last) = (azimuth(0), 0.0);
                let ends = match self.sensor {
                    Sensor::Vls128 if is_dual => 7,
                    _ => BLOCKS - apart,
                };
                for (block, entry) in azimuths.iter_mut().enumerate() {
                    let from = next;
                    *entry = if block < BLOCKS - apart {
                        next = azimuth(block + apart);
                        last = step(from, next);
                        (from, last)
                    } else {
                        (from, if block == ends { 0.0 } else { last })
                    };
                }
            }
        }
        // Into another sector: no sensor turns this far from one firing to the next.
        azimuths.map(|(azimuth, step)| (azimuth, if step < 500.0 { step } else { 0.0 }))
    }

    /// The share of that step until a laser fires.
    fn share(&self, laser: usize, firing_in_block: usize) -> f64 {
        let Layout {
            cycle_ns,
            laser_ns,
            firings_per_block,
            ..
        } = self.layout;
        let passed = match self.sensor {
            Sensor::Vls128 => (laser / 8 + laser / 64) as f64 * laser_ns,
            _ => firing_in_block as f64 * cycle_ns + laser as f64 * laser_ns,
        };
        passed / (cycle_ns * firings_per_block as f64)
    }
}

impl Packets for Velodyne {
    fn head(&mut self, near_ns: i64, payload: &[u8]) -> Result<Option<Head>> {
        // Of a position, to the same port.
        if payload.len() == POSITION || payload.len() == 554 {
            return Ok(None);
        }
        if payload.len() != PACKET {
            let reason = format!("of {} bytes is not a Velodyne's, which has {PACKET}", payload.len());
            return Err(PacketError::packet(reason));
        }
        let is_dual = self.is_dual(payload);
        let columns = self.blocks(is_dual);
        if (0..columns).any(|block| self.bank(payload, block).is_none()) {
            let reason = format!("has a block that is no {}'s", self.sensor.name());
            return Err(PacketError::packet(reason));
        }
        let time_ns = in_hour(u32_at(payload, TIME), near_ns);
        let blocks_per_firing = self.layout.blocks_per_firing * (1 + usize::from(is_dual));
        let mut head = Head {
            columns,
            firings_per_column: self.layout.firings_per_block as f32 / blocks_per_firing as f32,
            ..Head::default()
        };
        for block in 0..columns {
            head.azimuths[block] = u16_at(payload, block * BLOCK + 2) % TURN;
            head.times_ns[block] = time_ns.saturating_add(self.offset_ns(block, 0, 0, is_dual));
        }
        // Before a sector that the sensor does not look into, a packet waits until it is full.
        let step = |block: usize| turned(head.azimuths[block], head.azimuths[block - 1]);
        if let Some(gap) = (1..columns).find(|&block| step(block) > 1_000) {
            let small = (1..columns).filter(|&block| block != gap && step(block) < 500);
            let (turned, passed_ns) = small.fold((0.0, 0.0), |(turned, passed_ns), block| {
                let offset_ns = |block: usize| self.offset_ns(block, 0, 0, is_dual);
                let between_ns = offset_ns(block) - offset_ns(block - 1);
                (turned + f64::from(step(block)), passed_ns + between_ns as f64)
            });
            if turned > 0.0 {
                let waited_ns = (f64::from(step(gap)) * passed_ns / turned) as i64;
                let later = head.times_ns[gap..columns].iter_mut();
                later.for_each(|time_ns| *time_ns = time_ns.saturating_add(waited_ns));
            }
        }
        let firings = self.firing(columns - 1, is_dual) + self.layout.firings_per_block;
        head.period_ns = (firings as f64 * self.layout.cycle_ns) as i64;
        let turned = turned(head.azimuths[columns - 1], head.azimuths[0]);
        let last = self.firing(columns - 1, is_dual);
        if last > 0 && turned > 0 && turned < TURN / 2 {
            let per_turn = (f64::from(TURN) * last as f64 / f64::from(turned)).round() as u32;
            head.columns_per_turn = Some(per_turn);
        }
        Ok(Some(head))
    }

    fn decode(&self, payload: &[u8], head: &Head, columns: Range<usize>, returns: &mut Returns) {
        let is_dual = self.is_dual(payload);
        let azimuths = self.azimuths(payload, is_dual);
        for (block, (azimuth, step)) in azimuths.into_iter().enumerate().take(columns.end).skip(columns.start) {
            let Some(bank) = self.bank(payload, block) else {
                continue;
            };
            for slot in 0..LASERS_PER_BLOCK {
                let (firing_in_block, laser) = (slot / self.layout.lasers, bank * 32 + slot % self.layout.lasers);
                let at = block * BLOCK + 4 + 3 * slot;
                let raw = u16_at(payload, at);
                // Of two returns that are one, the first is kept.
                if is_dual && block % 2 == 1 && raw == u16_at(payload, at - BLOCK) {
                    continue;
                }
                let Some(beam) = self.beams.get(laser) else { continue };
                if raw == 0 {
                    returns.no_return += u64::from(!is_dual || block % 2 == 0);
                    continue;
                }
                let turned_rad = (f64::from(azimuth) + step * self.share(laser, firing_in_block)).to_radians() / 100.0;
                let point = beam.point(f64::from(raw) * self.range_unit_m, turned_rad);
                let offset_ns =
                    self.offset_ns(block, laser, firing_in_block, is_dual) - self.offset_ns(block, 0, 0, is_dual);
                let intensity = beam.laser.intensity(u8_at(payload, at + 2), raw);
                returns.push(
                    point,
                    beam.ring,
                    head.times_ns[block].saturating_add(offset_ns),
                    intensity,
                );
            }
        }
    }

    fn model(&self, columns: u32) -> Option<SensorModel> {
        let elevations = self.beams.iter().map(|beam| beam.laser.elevation_rad.to_degrees());
        let ranges = (self.layout.min_range_m, self.layout.max_range_m);
        hesai::model(self.sensor, elevations, columns, ranges)
    }

    fn notes(&self) -> Vec<String> {
        Vec::from_iter(self.is_nominal.then(|| self.sensor.nominal_note()))
    }

    fn imu(&self, near_ns: i64, payload: &[u8]) -> Vec<ImuSample> {
        if self.sensor != Sensor::Hdl32e || payload.len() != POSITION {
            return Vec::new();
        }
        Vec::from_iter(imu::sample(in_hour(u32_at(payload, SENT), near_ns), payload))
    }

    fn position(&mut self, near_ns: i64, payload: &[u8]) -> Option<Position> {
        if payload.len() != POSITION {
            return None;
        }
        let sentence = position::sentence(&payload[SENTENCE..]);
        if self.sentence.as_deref() == Some(sentence) {
            return Some(Position::Repeated);
        }
        let is_first = self.sentence.replace(sentence.to_vec()).is_none();
        let Some(place) = position::parse(sentence) else {
            return Some(Position::Void);
        };
        let sent_ns = in_hour(u32_at(payload, SENT), near_ns);
        let measured_ns = in_hour(place.micros, sent_ns);
        let follows = (0..LATEST_NS).contains(&sent_ns.saturating_sub(measured_ns));
        // Since when the first one was told is not known.
        if is_first && !follows {
            return Some(Position::Repeated);
        }
        Some(Position::Fix {
            time_ns: if follows { measured_ns } else { sent_ns },
            latitude_deg: place.latitude_deg,
            longitude_deg: place.longitude_deg,
        })
    }
}

impl Velodyne {
    fn is_dual(&self, payload: &[u8]) -> bool {
        // There, these bytes say other things.
        if self.sensor == Sensor::Hdl64e {
            let azimuth = |block: usize| u16_at(payload, block * BLOCK + 2);
            return azimuth(0) == azimuth(2) && azimuth(1) == azimuth(3) && azimuth(4) == azimuth(6);
        }
        u8_at(payload, MODE) == DUAL
    }
}

impl Beam {
    /// Where a return of this range lies, at this azimuth of the sensor.
    fn point(&self, range_m: f64, azimuth_rad: f64) -> Vec3 {
        let laser = &self.laser;
        let range_m = range_m + laser.range_offset_m;
        let (sin_e, cos_e) = self.elevation_sin_cos;
        // Velodyne's manual: clockwise from y, which is ahead.
        let (sin_a, cos_a) = (azimuth_rad - laser.azimuth_rad).sin_cos();
        let (across, up) = (laser.horizontal_offset_m, laser.vertical_offset_m);
        let flat = |range_m: f64| range_m * cos_e - up * sin_e;
        let right = |range_m: f64| flat(range_m) * sin_a - across * cos_a;
        let ahead = |range_m: f64| flat(range_m) * cos_a + across * sin_a;
        let (mut in_x, mut in_y) = (range_m, range_m);
        // The correction was measured at two distances, 25.04 m and 2.4 m (1.93 m), and lies on the line through them.
        if let Some([near_x, near_y]) = laser.near_range_offset_m {
            let between = |near: f64, distance: f64, at: f64| {
                (laser.range_offset_m - near) * (distance - at) / (25.04 - at) + near - laser.range_offset_m
            };
            in_x += between(near_x, right(range_m).abs(), 2.4);
            in_y += between(near_y, ahead(range_m).abs(), 1.93);
        }
        let z = in_y * sin_e + up * cos_e;
        Vec3::new(ahead(in_y) as f32, -right(in_x) as f32, z as f32)
    }
}

/// The time of a clock that tells microseconds in the hour, near another time.
fn in_hour(micros: u32, near_ns: i64) -> i64 {
    let in_hour_ns = i64::from(micros) * 1000;
    let off = (in_hour_ns as i128 - near_ns as i128).rem_euclid(HOUR_NS as i128) as i64;
    let off = if off > HOUR_NS / 2 { off - HOUR_NS } else { off };
    near_ns.saturating_add(off)
}

#[cfg(test)]
mod tests;
