//! LiDAR packets in messages of drivers: how they become sweeps.
//!
//! All packets are followed once when the recording is opened, to find where sweeps begin; a sweep's packets are decoded when it is
//! read.

use tsdfuse::trajectory::secs_between;
use tsdfuse::{ImuSample, SensorModel};
use tsdfuse_packets::{Calibration, Decoder, Maker, Sensor as Model};

use super::bag::Bag;
use super::container::Entry;
use super::messages;
use super::points::Points;
use super::schema::Schema;
use super::survey::with_message;
use super::value::Value;
use crate::calibrations::Calibrations;
use crate::error::{Error, Result};

/// Clocks that differ by less are taken to be set alike, seconds.
const SAME_CLOCK_SECS: f64 = 1.0;
/// Of a recording that is only to be described, so many packets are followed.
const GLANCE_PACKETS: u64 = 10_000;
/// At the ends of a recording, sweeps with less than this part of a turn are left out.
const MOST: f32 = 0.5;

/// The place of a packet: its message, its number there, and a column of it.
type At = (usize, usize, usize);

/// A sweep among the packets.
#[derive(Clone, Copy, Debug)]
struct Spot {
    first: At,
    /// The column before which it ends.
    last: At,
    time_ns: i64,
    packet_ns: i64,
    received_ns: i64,
    turn: f32,
}

/// The sweeps of one sensor's packets.
#[derive(Clone)]
pub(crate) struct PacketSweeps {
    model: Model,
    calibration: Calibration,
    pub(crate) beams: Option<SensorModel>,
    sweeps: Vec<Spot>,
    /// Added to the sensor's clock, nanoseconds.
    shift_ns: i64,
    pub(crate) facts: Vec<String>,
}

impl std::fmt::Debug for PacketSweeps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PacketSweeps")
            .field("model", &self.model)
            .finish_non_exhaustive()
    }
}

/// The packets of a message, each with the time at which it was received.
fn payloads<'a>(message: &Value<'a>, recorded_ns: i64) -> Result<Vec<(i64, &'a [u8])>, String> {
    if let Ok(buffer) = message.bytes("buf") {
        return Ok(vec![(recorded_ns, buffer)]);
    }
    let packet = |packet: &Value<'a>| {
        let data = packet.bytes("data")?;
        let size = packet.int("size").ok().and_then(|size| usize::try_from(size).ok());
        let data = size.and_then(|size| data.get(..size)).unwrap_or(data);
        Ok((messages::stamp(packet, "stamp")?, data))
    };
    message.list("packets")?.iter().map(packet).collect()
}

/// What Ouster's driver says of the sensor, from a topic beside that of the packets.
fn metadata(bag: &Bag, topic: &str) -> Option<Calibration> {
    let (parent, _) = topic.rsplit_once('/')?;
    let name = format!("{parent}/metadata");
    let number = bag.channels().iter().position(|channel| channel.topic == name)?;
    let channel = bag.channels().get(number)?;
    let schema = super::survey::schema(channel).ok()?;
    let entry = bag.entries(number).first()?;
    let text = with_message(bag, number, &schema, entry, |message| message.text("data")).ok()?;
    Calibration::parse(text.as_bytes()).ok()
}

impl PacketSweeps {
    /// Follows all packets of a channel, or, for a `glance`, the first ones. `told` is the model that was asked for.
    ///
    /// # Errors
    /// If there is none of a sensor that is known, or no calibration where one is needed.
    pub(crate) fn index(
        bag: &Bag,
        channel: usize,
        schema: &Schema,
        calibrations: &Calibrations,
        told: Option<Model>,
        glance: bool,
    ) -> Result<Self> {
        let topic = bag.channels().get(channel).map_or("", |c| c.topic.as_str());
        let wrong = |why: String| Error::dataset(topic, why);
        let mut index: Option<(Decoder, Model, Calibration)> = None;
        let (mut sweeps, mut open): (Vec<Spot>, Option<Spot>) = (Vec::new(), None);
        let (mut bad, mut facts) = (0_u64, Vec::new());
        let entries = bag.entries(channel);
        for (number, entry) in entries.iter().enumerate() {
            let packets = index.as_ref().map_or(0, |(decoder, ..)| decoder.counts().packets);
            if glance && packets >= GLANCE_PACKETS {
                facts.push(format!(
                    "this is an overview: the packets of {number} of {} messages were followed",
                    entries.len()
                ));
                break;
            }
            let mut refused = false;
            let followed = with_message(bag, channel, schema, entry, |message| {
                for (k, (received_ns, payload)) in payloads(message, entry.time_ns)?.into_iter().enumerate() {
                    if index.is_none() {
                        let found = Model::recognise(payload);
                        let model = match (found, told) {
                            (Some(found), Some(told))
                                if found.maker() == told.maker() && told.maker() != Maker::Ouster =>
                            {
                                told
                            }
                            (Some(found), _) => found,
                            (None, _) => {
                                bad += 1;
                                continue;
                            }
                        };
                        let beside = calibrations.of(model, payload).map(|(path, calibration)| {
                            facts.push(format!("calibration: {}", crate::files::name(path)));
                            calibration.clone()
                        });
                        let calibration = beside.or_else(|| metadata(bag, topic)).unwrap_or(Calibration::Nominal);
                        let decoder = Decoder::new(model, calibration.clone()).map_err(|e| {
                            refused = true;
                            format!("{e}; --calibration names a file")
                        })?;
                        index = Some((decoder, model, calibration));
                    }
                    let Some((decoder, ..)) = &mut index else { continue };
                    let place = match decoder.place(received_ns, payload) {
                        Ok(Some(place)) => place,
                        Ok(None) => continue,
                        Err(_) => {
                            bad += 1;
                            continue;
                        }
                    };
                    let begin = place.begins.map_or(place.columns, |(column, _)| column);
                    let at = |column| (number, k, column);
                    let spot = |column, time_ns| Spot {
                        first: at(column),
                        last: at(place.columns),
                        time_ns,
                        packet_ns: place.time_ns,
                        received_ns,
                        turn: place.turn_per_column * place.columns.saturating_sub(column) as f32,
                    };
                    match &mut open {
                        Some(open) => {
                            (open.last, open.turn) = (at(begin), open.turn + place.turn_per_column * begin as f32);
                        }
                        None if begin > 0 => {
                            let turn = place.turn_per_column * begin as f32;
                            open = Some(Spot {
                                last: at(begin),
                                turn,
                                ..spot(0, place.time_ns)
                            });
                        }
                        None => {}
                    }
                    if let Some((column, time_ns)) = place.begins {
                        sweeps.extend(open.take());
                        open = Some(spot(column, time_ns));
                    }
                }
                Ok(())
            });
            match followed {
                // A message that is damaged.
                Err(Error::Dataset { .. }) if !refused => bad += 1,
                followed => followed?,
            }
        }
        sweeps.extend(open);
        let Some((decoder, model, calibration)) = index else {
            return Err(wrong("holds no packets of a LiDAR that is known".to_owned()));
        };
        let mut turns: Vec<f64> = sweeps.iter().map(|sweep| f64::from(sweep.turn)).collect();
        let typical = super::point_times::median(&mut turns) as f32;
        for is_last in [true, false] {
            let end = if is_last { sweeps.last() } else { sweeps.first() };
            if sweeps.len() > 1 && end.is_some_and(|sweep| sweep.turn < MOST * typical) {
                sweeps.remove(if is_last { sweeps.len() - 1 } else { 0 });
            }
        }
        let mut late: Vec<f64> = sweeps
            .iter()
            .map(|sweep| secs_between(sweep.packet_ns, sweep.received_ns))
            .collect();
        let late = super::point_times::median(&mut late);
        let is_apart = late.abs() > SAME_CLOCK_SECS;
        let clock = if is_apart {
            format!("{late:.3} s off that of the packets' stamps; it is corrected")
        } else {
            format!("{late:.4} s before the packets' stamps")
        };
        let counts = decoder.counts();
        let also = [(counts.late, "late"), (bad, "damaged or another sensor's")];
        let also = also.into_iter().filter(|(count, _)| *count > 0);
        let also: String = also.map(|(count, what)| format!(", {count} {what}")).collect();
        facts.extend([
            format!(
                "{}: {} packets, {} lost{also}",
                model.name(),
                counts.packets,
                counts.lost
            ),
            format!("times and rings of points: the sensor's own; its clock is {clock}"),
        ]);
        facts.extend(decoder.notes());
        Ok(Self {
            beams: decoder.model(),
            model,
            calibration,
            sweeps,
            shift_ns: if is_apart { (late * 1e9) as i64 } else { 0 },
            facts,
        })
    }

    /// When each sweep began.
    pub(crate) fn times_ns(&self) -> Vec<i64> {
        let time = |sweep: &Spot| sweep.time_ns.saturating_add(self.shift_ns);
        self.sweeps.iter().map(time).collect()
    }

    /// The samples in a topic of packets of the sensor's inertial measurement unit, in the sensor's frame.
    ///
    /// # Errors
    /// Names the topic and what is wrong.
    pub(crate) fn imu(&self, bag: &Bag, channel: usize, schema: &Schema) -> Result<Vec<ImuSample>> {
        let topic = bag.channels().get(channel).map_or("", |c| c.topic.as_str());
        let decoder =
            Decoder::new(self.model, self.calibration.clone()).map_err(|e| Error::dataset(topic, e.to_string()))?;
        let mut samples = Vec::new();
        for entry in bag.entries(channel) {
            with_message(bag, channel, schema, entry, |message| {
                let packets = payloads(message, entry.time_ns)?.into_iter();
                samples.extend(packets.flat_map(|(received_ns, payload)| decoder.imu(received_ns, payload)));
                Ok(())
            })?;
        }
        for sample in &mut samples {
            sample.time_ns = sample.time_ns.saturating_add(self.shift_ns);
        }
        Ok(samples)
    }

    /// Decodes a sweep.
    ///
    /// # Errors
    /// Names the topic and what is wrong.
    pub(crate) fn read(
        &self,
        bag: &Bag,
        channel: usize,
        schema: &Schema,
        entries: &[Entry],
        sweep: usize,
    ) -> Result<Points> {
        let topic = bag.channels().get(channel).map_or("", |c| c.topic.as_str());
        let wrong = |why: String| Error::dataset(topic, why);
        let spot = self
            .sweeps
            .get(sweep)
            .ok_or_else(|| wrong(format!("no sweep {sweep}")))?;
        let mut decoder = Decoder::new(self.model, self.calibration.clone()).map_err(|e| wrong(e.to_string()))?;
        decoder.resume(spot.packet_ns, spot.received_ns);
        for (number, entry) in entries.iter().enumerate().take(spot.last.0 + 1).skip(spot.first.0) {
            let read = with_message(bag, channel, schema, entry, |message| {
                for (k, (received_ns, payload)) in payloads(message, entry.time_ns)?.into_iter().enumerate() {
                    let at = (number, k);
                    if at < (spot.first.0, spot.first.1) || at > (spot.last.0, spot.last.1) {
                        continue;
                    }
                    let from = if at == (spot.first.0, spot.first.1) {
                        spot.first.2
                    } else {
                        0
                    };
                    let to = if at == (spot.last.0, spot.last.1) {
                        spot.last.2
                    } else {
                        usize::MAX
                    };
                    // What is no packet was counted when the recording was opened.
                    let _ = decoder.decode(received_ns, payload, from..to);
                }
                Ok(())
            });
            if !matches!(read, Err(Error::Dataset { .. })) {
                read?;
            }
        }
        let taken = decoder
            .take()
            .ok_or_else(|| wrong(format!("sweep {sweep} has no returns")))?;
        Ok(Points {
            points: taken.scan.points,
            rings: taken.scan.rings,
            intensities: taken.scan.intensities,
            secs: taken.scan.times,
        })
    }
}
