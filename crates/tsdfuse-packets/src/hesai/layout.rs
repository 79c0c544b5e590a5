//! Where things are in the packets of each model, and when its lasers fire.

use super::nominal::{
    OT128_HIGH_NS, OT128_NS, PANDAR40P_NS, PANDAR64_NS, PANDAR128_HIGH_NS, PANDAR128_NS, QT64_NS, QT128_LOOP_1_NS,
    QT128_LOOP_2_NS,
};
use crate::bytes::{u8_at, u16_at};
use crate::sensor::Sensor;

/// The layout of a model's packets.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    sensor: Sensor,
    /// Bytes of the header, of a block before its returns, of a return.
    header: usize,
    pub(super) block_head: usize,
    pub(super) unit: usize,
    pub(super) blocks: usize,
    pub(super) lasers: usize,
    pub(super) tail: Tail,
    /// Between two firings of all lasers, nanoseconds.
    pub(super) cycle_ns: i64,
    pub(super) ranges_m: (f32, f32),
}

/// Offsets in the packet of what stands behind the blocks.
#[derive(Clone, Debug)]
pub(super) struct Tail {
    pub(super) mode: usize,
    pub(super) speed: usize,
    pub(super) date: usize,
    pub(super) time: usize,
    /// To which the date's year is added.
    pub(super) first_year: i64,
    /// Where the tail ends: a packet may go on with a number, a checksum, a signature.
    end: usize,
}

impl Layout {
    /// `None` for what is no Hesai.
    pub(super) fn of(sensor: Sensor) -> Option<Self> {
        // Header, block head, bytes of a return, blocks, lasers.
        let (header, block_head, unit, blocks, lasers) = match sensor {
            Sensor::Pandar40p => (0, 4, 3, 10, 40),
            Sensor::Pandar64 => (8, 2, 3, 6, 64),
            Sensor::Qt64 => (12, 2, 4, 4, 64),
            Sensor::Qt128 => (12, 2, 4, 2, 128),
            Sensor::Xt16 => (12, 2, 4, 8, 16),
            Sensor::Xt32 => (12, 2, 4, 8, 32),
            Sensor::Xt32m => (12, 2, 4, 6, 32),
            Sensor::Pandar128 | Sensor::Ot128 => (12, 2, 3, 2, 128),
            _ => return None,
        };
        let body = header + blocks * (block_head + unit * lasers);
        // The old tail: speed, time, mode, factory, date. The new one: mode, speed, date, time, factory.
        let old = |at: usize, first_year| Tail {
            speed: body + at,
            time: body + at + 2,
            mode: body + at + 6,
            date: body + at + 8,
            first_year,
            end: body + at + 14,
        };
        let new = |at: usize| Tail {
            mode: body + at,
            speed: body + at + 1,
            date: body + at + 3,
            time: body + at + 9,
            first_year: 1900,
            end: body + at + 14,
        };
        let (tail, cycle_ns, ranges_m) = match sensor {
            Sensor::Pandar40p => (old(8, 2000), 55_560, (0.3, 200.0)),
            Sensor::Pandar64 => (old(8, 2000), 55_560, (0.3, 200.0)),
            Sensor::Qt64 => (old(10, 1900), 166_667, (0.1, 60.0)),
            // A checksum and 17 bytes of functional safety stand before the tail.
            Sensor::Qt128 => (new(4 + 17 + 12), 111_110, (0.05, 50.0)),
            Sensor::Pandar128 | Sensor::Ot128 => (new(4 + 17 + 12), 55_556, (0.1, 230.0)),
            Sensor::Xt32m => (new(10), 50_000, (0.5, 300.0)),
            _ => (new(10), 50_000, (0.05, 120.0)),
        };
        Some(Self {
            sensor,
            header,
            block_head,
            unit,
            blocks,
            lasers,
            tail,
            cycle_ns,
            ranges_m,
        })
    }

    /// Where a block begins.
    pub(super) fn block_at(&self, block: usize) -> usize {
        self.header + block * (self.block_head + self.unit * self.lasers)
    }

    /// Whether a packet is of this layout, or what is wrong.
    pub(super) fn fits(&self, payload: &[u8]) -> Result<(), String> {
        let (least, most) = (self.tail.end, self.tail.end + 80);
        if !(least..=most).contains(&payload.len()) {
            return Err(format!("it has {} bytes, not {least} to {most}", payload.len()));
        }
        let is_block = |block: usize| u16_at(payload, self.block_at(block)) == 0xEEFF;
        let mark = [u8_at(payload, 0), u8_at(payload, 1)];
        let (version, lasers, blocks) = match self.header {
            0 if (0..self.blocks).all(is_block) => return Ok(()),
            8 => ([0; 2], u8_at(payload, 2), u8_at(payload, 3)),
            _ => (
                [u8_at(payload, 2), u8_at(payload, 3)],
                u8_at(payload, 6),
                u8_at(payload, 7),
            ),
        };
        let wanted = match self.sensor {
            Sensor::Qt64 => [3, 1],
            Sensor::Qt128 => [3, 2],
            Sensor::Pandar128 => [1, 3],
            Sensor::Ot128 => [1, 4],
            Sensor::Pandar64 => [0, 0],
            _ => [6, 1],
        };
        if self.header == 0 || mark != [0xEE, 0xFF] || version != wanted {
            return Err("its marks are another sensor's".to_owned());
        }
        if (usize::from(lasers), usize::from(blocks)) != (self.lasers, self.blocks) {
            return Err(format!("it has {blocks} blocks of {lasers} lasers"));
        }
        Ok(())
    }

    /// Metres for which a count of the range stands.
    pub(super) fn range_unit_m(&self, payload: &[u8]) -> f64 {
        let millimetres = match self.header {
            0 => 4,
            8 => u8_at(payload, 5),
            _ => u8_at(payload, 9),
        };
        f64::from(millimetres) / 1000.0
    }

    /// Where the packet's number is, if it has one.
    pub(super) fn sequence_at(&self, payload: &[u8]) -> Option<usize> {
        // A flag of the header says so, where there are flags.
        let has = self.header < 12 || u8_at(payload, 11) & 1 != 0;
        (has && payload.len() >= self.tail.end + 4).then_some(self.tail.end)
    }

    /// Time of a block's firing after the packet's, nanoseconds.
    pub(super) fn block_offset_ns(&self, block: usize, returns: usize) -> i64 {
        let later = ((self.blocks - 1 - block) / returns) as i64;
        match self.sensor {
            Sensor::Pandar40p => -28_580 - self.cycle_ns * later,
            Sensor::Pandar64 => -42_580 - self.cycle_ns * later,
            Sensor::Qt64 => 25_710 + 500_000 * (block / returns) as i64 / 3,
            Sensor::Qt128 => 9_000 - 111_110 * (1 - block as i64) / returns as i64,
            Sensor::Pandar128 => 3_148 - 55_556 * (1 - block as i64) / returns as i64,
            Sensor::Ot128 => 43_346 - if returns == 1 { 55_556 * (1 - block as i64) } else { 0 },
            _ => 5_632 - self.cycle_ns * later,
        }
    }

    /// Time of a laser's firing after its block's, nanoseconds.
    pub(super) fn laser_offset_ns(&self, payload: &[u8], block: usize, laser: usize, returns: usize) -> i64 {
        let of = |table: &[i32]| i64::from(table.get(laser).copied().unwrap_or(0));
        match self.sensor {
            Sensor::Pandar40p => of(&PANDAR40P_NS),
            Sensor::Pandar64 => of(&PANDAR64_NS),
            Sensor::Qt64 => of(&QT64_NS),
            Sensor::Qt128 => {
                let is_first = match returns {
                    1 => block.is_multiple_of(2),
                    _ => u8_at(payload, self.tail.mode - 7) & 1 != 0,
                };
                of(if is_first { &QT128_LOOP_1_NS } else { &QT128_LOOP_2_NS })
            }
            Sensor::Xt16 => 368 + 3_024 * laser as i64,
            Sensor::Xt32m => 368 + 2_888 * (laser % 16) as i64,
            Sensor::Xt32 => 368 + 1_512 * laser as i64,
            Sensor::Ot128 | Sensor::Pandar128 => {
                let is_ot = self.sensor == Sensor::Ot128;
                let sequence = usize::from(self.azimuth_state(payload, block) % 2);
                match (is_ot, self.is_high_resolution(payload)) {
                    (true, false) => of(&OT128_NS),
                    (true, true) => of(&OT128_HIGH_NS[sequence]),
                    (false, false) => of(&PANDAR128_NS),
                    (false, true) => of(&PANDAR128_HIGH_NS[sequence]),
                }
            }
            _ => 0,
        }
    }

    /// Pandar128 and OT128: which of the firing sequences a block has.
    fn azimuth_state(&self, payload: &[u8], block: usize) -> u16 {
        u16_at(payload, self.tail.mode - 3) >> (14 - 2 * block.min(7)) & 3
    }

    fn is_high_resolution(&self, payload: &[u8]) -> bool {
        u8_at(payload, self.tail.mode - 1) == 0
    }
}
