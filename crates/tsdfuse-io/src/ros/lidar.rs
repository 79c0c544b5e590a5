//! The clouds of one topic: how its messages become sweeps.

use tsdfuse::glam::Vec3;
use tsdfuse::sensor::NO_RING;
use tsdfuse::trajectory::secs_between;

use super::bag::Bag;
use super::container::Entry;
use super::packets::PacketSweeps;
use super::point_times::{PointTimes, Sighting, median};
use super::points::{Columns, Points};
use super::schema::Schema;
use super::survey::{Stamps, with_message};
use super::value::{self, Rows, Value};
use crate::error::Result;

/// Messages from which is inferred what fields mean.
const SAMPLES: usize = 5;
/// Neighbouring messages that show whether each is only a part of a sweep.
const IN_A_ROW: usize = 12;
/// Parts of the circle in which points are looked for.
const SECTORS: usize = 72;
/// A message with points in more of them than this share is no part of a sweep.
const PART: f64 = 0.7;
/// The most messages that make a sweep.
const MOST_PARTS: f64 = 2000.0;
/// Rings whose points differ more in elevation than this are none, degrees.
const MAX_SPREAD_DEG: f32 = 1.5;

/// The clouds of one topic.
#[derive(Clone, Debug)]
pub(crate) struct Lidar {
    pub(crate) channel: usize,
    pub(crate) topic: String,
    pub(crate) frame: String,
    schema: Schema,
    pub(crate) entries: Vec<Entry>,
    /// When each message's points were measured, more or less: the stamps.
    pub(crate) times_ns: Vec<i64>,
    /// Messages that make a sweep.
    pub(crate) per_sweep: usize,
    times: Option<PointTimes>,
    rings: Rings,
    /// Where its messages hold packets.
    packets: Option<PacketSweeps>,
    /// Points of a message on average.
    pub(crate) points: f64,
    /// What was concluded, one line each.
    pub(crate) facts: Vec<String>,
}

/// What is done with the rings of points.
#[derive(Clone, Debug, PartialEq)]
enum Rings {
    AsTheyAre,
    /// The new number of each.
    Renamed(Vec<u16>),
    /// They are no lines of constant elevation.
    None,
}

/// The points of a message of either kind.
fn rows<'a>(message: &Value<'a>) -> Result<Rows<'a>, String> {
    match message.get("points") {
        Ok(Value::Records(records)) => Ok(Rows::one(records.clone())),
        Ok(_) => Err("points is no list of points".to_owned()),
        Err(_) => value::cloud(message),
    }
}

/// What a look at some messages tells.
#[derive(Default)]
struct Sample {
    count: usize,
    points: usize,
    sightings: Vec<Sighting>,
    fields: String,
    taken: [Option<String>; 3],
    /// Points with their rings.
    ringed: (Vec<Vec3>, Vec<u16>),
}

impl Lidar {
    /// Looks at some messages of a channel and concludes what they are. `None` if none of them can be read.
    ///
    /// # Errors
    /// That of the first message, if none can be read.
    pub(crate) fn look(bag: &Bag, channel: usize, schema: &Schema, stamps: &Stamps) -> Result<Self> {
        let topic = bag.channels().get(channel).map_or(String::new(), |c| c.topic.clone());
        let mut this = Self {
            channel,
            topic,
            frame: stamps.frame.clone(),
            schema: schema.clone(),
            entries: bag.entries(channel).to_vec(),
            times_ns: stamps.times_ns.clone(),
            per_sweep: 1,
            times: None,
            rings: Rings::AsTheyAre,
            packets: None,
            points: 0.0,
            facts: Vec::new(),
        };
        let sample = this.sample(bag)?;
        this.points = sample.points as f64 / sample.count.max(1) as f64;
        let period = this.period_secs();
        this.facts.push(format!("fields: {}", sample.fields));
        let [intensity, ring, time] = &sample.taken;
        if let Some(name) = time {
            match PointTimes::infer(&sample.sightings, period.unwrap_or(0.1)) {
                Ok(times) => {
                    this.facts.push(format!("times from {name}: {}", times.why));
                    this.times = Some(times);
                }
                Err(why) => this.facts.push(format!("no times: those of {name} {why}")),
            }
        } else {
            this.facts
                .push("no times of points: no field t, time, timestamp, offset_time or the like".to_owned());
        }
        this.conclude_rings(ring.as_deref(), sample.ringed);
        if let Some(name) = intensity {
            this.facts.push(format!("intensities from {name}"));
        }
        this.facts.push(match (stamps.unusable, stamps.delay_secs) {
            (Some(why), _) => format!("time of messages: when they were recorded, as {why}"),
            (None, Some(delay)) => format!("time of messages: their stamps, {delay:.4} s before they were recorded"),
            (None, None) => "time of messages: their stamps".to_owned(),
        });
        this.conclude_parts(bag);
        Ok(this)
    }

    /// The LiDAR whose packets a channel holds.
    ///
    /// # Errors
    /// That of the packets.
    pub(crate) fn of_packets(
        bag: &Bag,
        channel: usize,
        schema: &Schema,
        frame: &str,
        packets: PacketSweeps,
    ) -> Result<Self> {
        let mut this = Self {
            channel,
            topic: bag.channels().get(channel).map_or(String::new(), |c| c.topic.clone()),
            frame: frame.to_owned(),
            schema: schema.clone(),
            entries: bag.entries(channel).to_vec(),
            times_ns: packets.times_ns(),
            per_sweep: 1,
            times: None,
            rings: Rings::AsTheyAre,
            facts: packets.facts.clone(),
            packets: Some(packets),
            points: 0.0,
        };
        let middle = this.read(bag, this.sweeps() / 2)?;
        this.points = middle.points.len() as f64;
        Ok(this)
    }

    /// What its packets are put together from, where its messages hold packets.
    pub(crate) fn packets(&self) -> Option<&PacketSweeps> {
        self.packets.as_ref()
    }

    /// The beams, where packets tell them.
    pub(crate) fn beams(&self) -> Option<tsdfuse::SensorModel> {
        self.packets.as_ref()?.beams.clone()
    }

    /// Seconds from one message to the next.
    pub(crate) fn period_secs(&self) -> Option<f64> {
        let mut steps: Vec<f64> = self
            .times_ns
            .windows(2)
            .map(|pair| secs_between(pair[0], pair[1]))
            .collect();
        steps.retain(|step| *step > 0.0);
        Some(median(&mut steps)).filter(|period| period.is_finite())
    }

    /// How many sweeps there are.
    pub(crate) fn sweeps(&self) -> usize {
        self.times_ns.len() / self.per_sweep
    }

    /// When a sweep's first message was stamped.
    pub(crate) fn time_ns(&self, sweep: usize) -> i64 {
        self.times_ns.get(sweep * self.per_sweep).copied().unwrap_or_default()
    }

    fn with_rows<T>(
        &self,
        bag: &Bag,
        index: usize,
        f: impl FnOnce(&Rows<'_>) -> Result<T, String>,
    ) -> Result<Option<T>> {
        let Some(entry) = self.entries.get(index) else {
            return Ok(None);
        };
        with_message(bag, self.channel, &self.schema, entry, |message| f(&rows(message)?)).map(Some)
    }

    fn sample(&self, bag: &Bag) -> Result<Sample> {
        let mut sample = Sample::default();
        let mut error = None;
        let count = self.entries.len();
        for k in 0..SAMPLES.min(count) {
            let index = (2 * k + 1) * count / (2 * SAMPLES.min(count));
            let stamp_ns = self.times_ns.get(index).copied().unwrap_or_default();
            let looked = self.with_rows(bag, index, |rows| {
                let columns = Columns::find(rows)?;
                sample.points += rows.len();
                sample.count += 1;
                if rows.len() == 0 {
                    return Ok(());
                }
                sample.sightings.extend(columns.sighting(rows, stamp_ns));
                let fields = rows
                    .row
                    .fields
                    .iter()
                    .map(|(name, _, scalar)| format!("{name} {scalar:?}").to_lowercase());
                sample.fields = fields.collect::<Vec<_>>().join(", ");
                sample.taken = columns.names(rows).map(|name| name.map(str::to_owned));
                let Points { points, rings, .. } = columns.read(rows, None, stamp_ns)?;
                // Every other one suffices.
                if let Some(rings) = rings.filter(|_| k % 2 == 0) {
                    if k == 0 {
                        sample.ringed.0.reserve_exact(points.len() * SAMPLES.div_ceil(2));
                        sample.ringed.1.reserve_exact(rings.len() * SAMPLES.div_ceil(2));
                    }
                    sample.ringed.0.extend(points);
                    sample.ringed.1.extend(rings);
                }
                Ok(())
            });
            if let Err(e) = looked {
                error.get_or_insert(e);
            }
        }
        match error {
            Some(error) if sample.count == 0 => Err(error),
            _ => Ok(sample),
        }
    }

    fn conclude_rings(&mut self, name: Option<&str>, (points, rings): (Vec<Vec3>, Vec<u16>)) {
        let from = name.map_or("rows of the organized cloud".to_owned(), str::to_owned);
        if rings.is_empty() {
            self.facts
                .push("no rings: no field ring, channel, line or laser_id".to_owned());
            return;
        }
        if let Some(spread) = spread_deg(&points, &rings).filter(|spread| *spread > MAX_SPREAD_DEG) {
            self.facts.push(format!(
                "no rings: those of {from} are no lines of constant elevation (they are {spread:.1}° high)"
            ));
            self.rings = Rings::None;
            return;
        }
        let mut renamed = rings.clone();
        let order = if tsdfuse::sensor::sort_rings(&points, &mut renamed) {
            let most = rings.iter().copied().max().unwrap_or_default();
            let mut names = vec![NO_RING; usize::from(most) + 1];
            for (old, new) in rings.iter().zip(&renamed) {
                if let Some(name) = names.get_mut(usize::from(*old)) {
                    *name = *new;
                }
            }
            self.rings = Rings::Renamed(names);
            "renumbered from the lowest"
        } else {
            "0 is the lowest"
        };
        let mut seen = rings;
        seen.sort_unstable();
        seen.dedup();
        self.facts.push(format!("rings from {from}: {}, {order}", seen.len()));
    }

    /// Finds out whether each message is only a part of a sweep, and how many make one.
    fn conclude_parts(&mut self, bag: &Bag) {
        let first = (self.entries.len() / 2).saturating_sub(IN_A_ROW / 2);
        let mut seen = Vec::new();
        for index in first..self.entries.len().min(first + IN_A_ROW) {
            let looked = self.with_rows(bag, index, |rows| {
                let columns = Columns::find(rows)?;
                Ok(direction(&columns.read(rows, None, 0)?.points))
            });
            match looked {
                Ok(Some(Some(looked))) if looked.1 < PART => seen.push(looked),
                _ => return,
            }
        }
        let turn = |pair: &[(f64, f64)]| (pair[1].0 - pair[0].0 + 0.5).rem_euclid(1.0) - 0.5;
        let mut turns: Vec<f64> = seen.windows(2).map(turn).collect();
        let typical = median(&mut turns);
        let is_steady = turns.iter().all(|turn| (turn - typical).abs() < 0.3 * typical.abs());
        let share = seen.iter().map(|(_, share)| share).sum::<f64>() / seen.len().max(1) as f64;
        let parts = (turns.len() as f64 / turns.iter().sum::<f64>().abs()).round();
        // A part goes on where the last one ended: then the turn is about as wide as the part.
        if turns.len() >= 3 && is_steady && (2.0..=MOST_PARTS).contains(&parts) && typical.abs() > 0.4 * share {
            self.per_sweep = parts as usize;
            self.facts.push(format!(
                "{parts} messages make a sweep, as each turns on by {:.1}°",
                360.0 * typical.abs()
            ));
        }
    }

    /// Reads a sweep: its points, with times after the stamp of its first message.
    ///
    /// # Errors
    /// Names the topic, the message, and what is wrong with it.
    pub(crate) fn read(&self, bag: &Bag, sweep: usize) -> Result<Points> {
        if let Some(packets) = &self.packets {
            return packets.read(bag, self.channel, &self.schema, &self.entries, sweep);
        }
        let mut all = Points::default();
        let begin_ns = self.time_ns(sweep);
        let first = sweep * self.per_sweep;
        for index in first..first + self.per_sweep {
            let stamp_ns = self.times_ns.get(index).copied().unwrap_or(begin_ns);
            let part = self.with_rows(bag, index, |rows| {
                Columns::find(rows)?.read(rows, self.times.as_ref(), stamp_ns)
            })?;
            let Some(mut part) = part else { continue };
            if self.per_sweep > 1 {
                let later = secs_between(begin_ns, stamp_ns) as f32;
                let still = vec![0.0; part.points.len()];
                let secs = part.secs.get_or_insert(still);
                secs.iter_mut().for_each(|t| *t += later);
            }
            append(&mut all, part, index == first);
        }
        match &self.rings {
            Rings::AsTheyAre => {}
            Rings::None => all.rings = None,
            Rings::Renamed(names) => {
                let rename = |ring: &mut u16| *ring = names.get(usize::from(*ring)).copied().unwrap_or(NO_RING);
                all.rings.iter_mut().flatten().for_each(rename);
            }
        }
        Ok(all)
    }
}

/// Puts the points of a message behind those of others; columns that one of them lacks are left out.
fn append(all: &mut Points, part: Points, is_first: bool) {
    fn join<T>(all: &mut Option<Vec<T>>, part: Option<Vec<T>>) {
        match (all.as_mut(), part) {
            (Some(all), Some(part)) => all.extend(part),
            _ => *all = None,
        }
    }
    if is_first {
        *all = part;
        return;
    }
    all.points.extend(part.points);
    join(&mut all.rings, part.rings);
    join(&mut all.intensities, part.intensities);
    join(&mut all.secs, part.secs);
}

/// Where the points of a message lie, in turns, and in which share of the directions there are any.
fn direction(points: &[Vec3]) -> Option<(f64, f64)> {
    let mut sectors = [0usize; SECTORS];
    let (mut x, mut y) = (0.0, 0.0);
    for point in points
        .iter()
        .filter(|p| p.is_finite() && p.truncate().length_squared() > 0.01)
    {
        let flat = point.truncate().as_dvec2().normalize();
        (x, y) = (x + flat.x, y + flat.y);
        let turns = (flat.y.atan2(flat.x) / std::f64::consts::TAU).rem_euclid(1.0);
        if let Some(sector) = sectors.get_mut((turns * SECTORS as f64) as usize % SECTORS) {
            *sector += 1;
        }
    }
    let seen = sectors.iter().filter(|&&count| count > 0).count();
    (seen > 0).then(|| {
        (
            (y.atan2(x) / std::f64::consts::TAU).rem_euclid(1.0),
            seen as f64 / SECTORS as f64,
        )
    })
}

/// How high rings are: the middle 80 % of each one's elevations, median of all rings, degrees.
fn spread_deg(points: &[Vec3], rings: &[u16]) -> Option<f32> {
    let mut by_ring: std::collections::BTreeMap<u16, Vec<f32>> = std::collections::BTreeMap::new();
    for (point, ring) in points.iter().zip(rings) {
        let flat = point.truncate().length();
        if point.is_finite() && flat > 1.0 {
            by_ring
                .entry(*ring)
                .or_default()
                .push((point.z / flat).atan().to_degrees());
        }
    }
    let mut spreads: Vec<f32> = by_ring
        .into_values()
        .filter(|elevations| elevations.len() >= 20)
        .filter_map(|mut elevations| {
            elevations.sort_by(f32::total_cmp);
            let tenth = elevations.len() / 10;
            Some(elevations.get(elevations.len() - 1 - tenth)? - elevations.get(tenth)?)
        })
        .collect();
    spreads.sort_by(f32::total_cmp);
    spreads.get(spreads.len() / 2).copied()
}
