//! Packets in, sweeps out: what all makers share.

use std::ops::Range;

use tsdfuse::{ImuSample, Scan, SensorModel};

use crate::calibration::Calibration;
use crate::cutter::{Cut, Cutter};
use crate::error::Result;
use crate::position::Position;
use crate::returns::Returns;
use crate::sensor::{Maker, Sensor};
use crate::{hesai, ouster, velodyne};

/// More returns than any sensor measures in a turn: a sweep with as many is cut.
const MAX_RETURNS: usize = 1 << 22;
/// A packet of a frame that is older by up to so many came late; by more, the sensor was switched on again.
const LATE_FRAMES: i32 = 16;
/// The same of packets.
const LATE_PACKETS: u32 = 1000;
/// And of packets without numbers, nanoseconds.
const LATE_NS: i64 = 500_000_000;
/// A gap that counts more lost packets than this is a pause, or a sensor that was switched on again.
const MAX_LOST: u64 = 100_000;

/// A maker's packets.
pub(crate) trait Packets: Send + Sync {
    /// Reads what a packet says of itself; `Ok(None)` for one that holds no returns. `near_ns` is about when it was sent, for
    /// clocks that do not tell all of the time.
    fn head(&mut self, near_ns: i64, payload: &[u8]) -> Result<Option<Head>>;

    /// Decodes the returns of some of the packet's columns.
    fn decode(&self, payload: &[u8], head: &Head, columns: Range<usize>, returns: &mut Returns);

    /// The beams; `columns` is how many firings a turn has.
    fn model(&self, columns: u32) -> Option<SensorModel>;

    /// What is odd, one sentence each.
    fn notes(&self) -> Vec<String>;

    /// Samples of the inertial measurement unit, where a packet has some. `near_ns` as in [`head`](Self::head).
    fn imu(&self, _near_ns: i64, _payload: &[u8]) -> Vec<ImuSample> {
        Vec::new()
    }

    /// What a GNSS receiver at the sensor told, where a packet passes that on. `near_ns` as in [`head`](Self::head).
    fn position(&mut self, _near_ns: i64, _payload: &[u8]) -> Option<Position> {
        None
    }
}

/// What a packet says of itself.
#[derive(Clone, Debug, Default)]
pub(crate) struct Head {
    /// Time of each column, nanoseconds of the sensor's clock.
    pub(crate) times_ns: [i64; Self::COLUMNS],
    /// Azimuth of each column in hundredths of a degree.
    pub(crate) azimuths: [u16; Self::COLUMNS],
    /// How many columns there are.
    pub(crate) columns: usize,
    /// How often all lasers fire for one column.
    pub(crate) firings_per_column: f32,
    /// The number of the frame, where the sensor counts them: then sweeps are frames.
    pub(crate) frame: Option<u32>,
    /// How many columns a frame has, of those that are sent.
    pub(crate) frame_columns: f32,
    /// The packet's number, where the sensor counts them, and how many bits it has.
    pub(crate) sequence: Option<(u32, u32)>,
    /// Nanoseconds from one packet to the next.
    pub(crate) period_ns: i64,
    /// Firings in one turn, where the packet tells.
    pub(crate) columns_per_turn: Option<u32>,
}

impl Head {
    /// More columns than a packet of any sensor has.
    pub(crate) const COLUMNS: usize = 32;
}

/// One turn of a sensor.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// The returns. Without a name and a pose; `time_ns` is the first column's on the sensor's clock, and time 0 of `times`.
    pub scan: Scan,
    /// When the packet with the first column was received. `received_ns − scan.time_ns` is how far the clocks are apart, and
    /// what the packet took.
    pub received_ns: i64,
    /// Whether it begins and ends where sweeps of this sensor do. The first and the last one mostly do not.
    pub is_whole: bool,
    /// Packets of which it has returns.
    pub packets: u64,
    /// How much of a turn it covers: 1 for all of it.
    pub turn: f32,
}

/// Where a packet lies among the sweeps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Time of its first column, nanoseconds of the sensor's clock.
    pub time_ns: i64,
    /// How many columns it has.
    pub columns: usize,
    /// The column that begins a new sweep, if one does, and that column's time.
    pub begins: Option<(usize, i64)>,
    /// Whether the sweep that ends with this is whole.
    pub was_whole: bool,
    /// How much of a turn one of its columns is.
    pub turn_per_column: f32,
}

/// What was decoded so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Packets with returns.
    pub packets: u64,
    /// Packets that were sent but did not come, as far as numbers or times tell.
    pub lost: u64,
    /// Packets that came after later ones; they are decoded, where they belong to the same sweep.
    pub late: u64,
}

/// Puts sweeps together from the packets of one sensor.
///
/// There are two ways to use it. [`push`](Self::push) takes packets in order and gives sweeps. Where any sweep is to be read at any
/// time, [`place`](Self::place) tells in which packets sweeps begin, without decoding them; later,
/// [`resume`](Self::resume) and [`decode`](Self::decode) take the packets of one sweep and [`take`](Self::take) gives it.
pub struct Decoder {
    sensor: Sensor,
    packets: Box<dyn Packets>,
    cutter: Cutter,
    frame: Option<u32>,
    last: Option<Last>,
    /// Whether the last packet waited for the end of a sector into which the sensor does not look.
    looked_away: bool,
    counts: Counts,
    columns_per_turn: Option<u32>,
    /// The sweep now.
    returns: Returns,
    began: Option<Began>,
    head: Head,
}

/// The packet before.
#[derive(Clone, Copy, Debug)]
struct Last {
    time_ns: i64,
    /// When the next one is due.
    next_ns: i64,
    number: Option<u32>,
    received_ns: i64,
}

/// What is known of the sweep now.
#[derive(Clone, Copy, Debug)]
struct Began {
    time_ns: i64,
    received_ns: i64,
    packets: u64,
    firings: f32,
    frame_columns: f32,
}

impl Decoder {
    /// A decoder of a sensor's packets.
    ///
    /// # Errors
    /// If the calibration is another sensor's, or there is none and it cannot be done without.
    pub fn new(sensor: Sensor, calibration: Calibration) -> Result<Self> {
        let packets: Box<dyn Packets> = match sensor.maker() {
            Maker::Velodyne => Box::new(velodyne::Velodyne::new(sensor, calibration)?),
            Maker::Hesai => Box::new(hesai::Hesai::new(sensor, calibration)?),
            Maker::Ouster => Box::new(ouster::Ouster::new(calibration)?),
        };
        Ok(Self {
            sensor,
            packets,
            cutter: Cutter::default(),
            frame: None,
            last: None,
            looked_away: false,
            counts: Counts::default(),
            columns_per_turn: None,
            returns: Returns::default(),
            began: None,
            head: Head::default(),
        })
    }

    /// The sensor.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// The sensor's beams. How many columns a turn has is known after the first packet.
    pub fn model(&self) -> Option<SensorModel> {
        self.packets.model(self.columns_per_turn.unwrap_or(1800))
    }

    /// What came and what did not.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// What is odd, one sentence each: angles that are nominal, for instance.
    pub fn notes(&self) -> Vec<String> {
        self.packets.notes()
    }

    /// Samples of the sensor's inertial measurement unit, in the sensor's frame, if the packet has some: in its own packets, as Ouster sends them, or
    /// beside a position, as an HDL-32E does.
    pub fn imu(&self, received_ns: i64, payload: &[u8]) -> Vec<ImuSample> {
        self.packets.imu(self.near_ns(received_ns), payload)
    }

    /// What a GNSS receiver at the sensor told, if the packet passes that on: in its own packets, as Velodyne sends them. A place is told again in every
    /// packet until there is a new one. It has the receiver's time, if the sensor's clock follows the receiver; otherwise, the time at which it was first
    /// passed on.
    pub fn position(&mut self, received_ns: i64, payload: &[u8]) -> Option<Position> {
        self.packets.position(self.near_ns(received_ns), payload)
    }

    /// Takes a packet that was received at `received_ns` (nanoseconds since 1970); gives the sweep that ends with it.
    ///
    /// # Errors
    /// If the packet is not one of this sensor. It is left out then, and the next one may be good.
    pub fn push(&mut self, received_ns: i64, payload: &[u8]) -> Result<Option<Sweep>> {
        let Some(place) = self.place(received_ns, payload)? else {
            return Ok(None);
        };
        let head = std::mem::take(&mut self.head);
        let begin = place.begins.map_or(place.columns, |(column, _)| column);
        self.add(received_ns, payload, &head, 0..begin);
        let mut sweep = None;
        if place.begins.is_some() {
            sweep = self.take_sweep(place.was_whole);
            self.add(received_ns, payload, &head, begin..place.columns);
        }
        self.head = head;
        Ok(sweep)
    }

    /// The sweep that is not at its end yet, if there is one.
    pub fn finish(&mut self) -> Option<Sweep> {
        self.take_sweep(false)
    }

    /// Follows a packet without decoding its returns; `None` if it holds none.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn place(&mut self, received_ns: i64, payload: &[u8]) -> Result<Option<Place>> {
        let Some(head) = self.packets.head(self.near_ns(received_ns), payload)? else {
            return Ok(None);
        };
        let columns = head.columns.min(Head::COLUMNS);
        self.counts.packets += 1;
        self.columns_per_turn = head.columns_per_turn.or(self.columns_per_turn);
        let time_ns = head.times_ns[0];
        let (mut begins, mut was_whole) = (None, false);
        // Whether the sensor looked away before this packet, and within.
        let (mut before, mut within) = (false, false);
        if let Some(frame) = head.frame {
            let step = self.frame.map_or(0, |before| frame.wrapping_sub(before) as i32);
            if (-LATE_FRAMES..0).contains(&step) {
                self.count_late();
                return Ok(None);
            }
            self.frame = Some(frame);
            begins = (step != 0).then_some((0, time_ns));
        } else {
            let times = head.azimuths.iter().zip(&head.times_ns).take(columns).enumerate();
            for (column, (&azimuth, &time_ns)) in times {
                if self.cutter.is_gap_before(azimuth, time_ns) {
                    *(if column == 0 { &mut before } else { &mut within }) = true;
                }
                // A packet is too short for two cuts.
                if let Some(cut) = self.cutter.column(azimuth, time_ns)
                    && begins.is_none()
                {
                    begins = Some((column, time_ns));
                    was_whole = cut == (Cut::Regular { whole: true });
                }
            }
        }
        before |= std::mem::replace(&mut self.looked_away, within);
        self.count_lost(&head, time_ns, received_ns, before);
        if self.returns.len() > MAX_RETURNS && begins.is_none() {
            begins = Some((0, time_ns));
        }
        let turn_per_column = head.firings_per_column / self.columns_per_turn.unwrap_or(1800).max(1) as f32;
        self.head = head;
        Ok(Some(Place {
            time_ns,
            columns,
            begins,
            was_whole,
            turn_per_column,
        }))
    }

    fn count_lost(&mut self, head: &Head, time_ns: i64, received_ns: i64, looked_away: bool) {
        let columns = head.columns.clamp(1, Head::COLUMNS);
        let after_last_ns = head.times_ns[columns - 1].saturating_sub(time_ns).max(0);
        // The packet is as long as always, or it waited at a sector's end until it was full.
        let next_ns = time_ns.saturating_add(after_last_ns.max(head.period_ns));
        let number = head.sequence.map(|(number, _)| number);
        let last = self.last.replace(Last {
            time_ns,
            next_ns,
            number,
            received_ns,
        });
        let Some(last) = last else { return };
        let missing = match (last.number, head.sequence) {
            (Some(before), Some((number, bits))) => {
                let mask = if bits >= 32 { u32::MAX } else { (1 << bits) - 1 };
                let back = before.wrapping_sub(number) & mask;
                if (1..LATE_PACKETS).contains(&back) {
                    self.last = Some(last);
                    self.count_late();
                    return;
                }
                u64::from(number.wrapping_sub(before) & mask).saturating_sub(1)
            }
            _ if looked_away => 0,
            _ if time_ns < last.time_ns => {
                // By more, its clock was set.
                if last.time_ns.saturating_sub(time_ns) < LATE_NS {
                    self.last = Some(last);
                    self.count_late();
                }
                return;
            }
            _ => {
                let (late_ns, period_ns) = (time_ns.saturating_sub(last.next_ns), head.period_ns.max(1));
                (late_ns.saturating_add(period_ns / 2) / period_ns).max(0) as u64
            }
        };
        if missing <= MAX_LOST {
            self.counts.lost += missing;
        }
    }

    /// A packet came that was thought to be lost.
    fn count_late(&mut self) {
        self.counts.late += 1;
        self.counts.lost = self.counts.lost.saturating_sub(1);
    }

    /// Makes ready to decode packets from a known one on: of this time on the sensor's clock, received then.
    pub fn resume(&mut self, time_ns: i64, received_ns: i64) {
        self.last = Some(Last {
            time_ns,
            next_ns: time_ns,
            number: None,
            received_ns,
        });
        (self.frame, self.began) = (None, None);
    }

    /// Decodes some columns of a packet into the sweep now, without looking where sweeps begin. A packet of another frame than
    /// the first one is left out.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn decode(&mut self, received_ns: i64, payload: &[u8], columns: Range<usize>) -> Result<()> {
        let Some(head) = self.packets.head(self.near_ns(received_ns), payload)? else {
            return Ok(());
        };
        self.columns_per_turn = head.columns_per_turn.or(self.columns_per_turn);
        if let Some(frame) = head.frame
            && *self.frame.get_or_insert(frame) != frame
        {
            return Ok(());
        }
        let time_ns = head.times_ns[0];
        self.last = Some(Last {
            time_ns,
            next_ns: time_ns,
            number: None,
            received_ns,
        });
        self.add(received_ns, payload, &head, columns);
        Ok(())
    }

    /// About when a packet was sent, on the sensor's clock, which goes on as the receiver's does.
    fn near_ns(&self, received_ns: i64) -> i64 {
        match self.last {
            Some(last) => last
                .time_ns
                .saturating_add(received_ns.saturating_sub(last.received_ns)),
            None => received_ns,
        }
    }

    /// The sweep of what was decoded.
    pub fn take(&mut self) -> Option<Sweep> {
        self.take_sweep(true)
    }

    fn add(&mut self, received_ns: i64, payload: &[u8], head: &Head, columns: Range<usize>) {
        let columns = columns.start..columns.end.min(head.columns).min(Head::COLUMNS);
        let Some(&time_ns) = head.times_ns.get(columns.start).filter(|_| !columns.is_empty()) else {
            return;
        };
        let began = self.began.get_or_insert(Began {
            time_ns,
            received_ns,
            packets: 0,
            firings: 0.0,
            frame_columns: head.frame_columns,
        });
        began.packets += 1;
        began.firings += head.firings_per_column * columns.len() as f32;
        self.packets.decode(payload, head, columns, &mut self.returns);
    }

    fn take_sweep(&mut self, is_whole: bool) -> Option<Sweep> {
        let Began {
            time_ns,
            received_ns,
            packets,
            firings,
            frame_columns,
        } = self.began.take()?;
        if self.returns.is_empty() {
            return None;
        }
        let turn = firings / self.columns_per_turn.unwrap_or(1800).max(1) as f32;
        Some(Sweep {
            scan: self.returns.take(time_ns),
            received_ns,
            // A frame is whole if all of its columns came.
            is_whole: if frame_columns > 0.0 {
                firings >= frame_columns
            } else {
                is_whole
            },
            packets,
            turn,
        })
    }
}

impl std::fmt::Debug for Decoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Decoder")
            .field("sensor", &self.sensor)
            .field("counts", &self.counts)
            .finish_non_exhaustive()
    }
}
