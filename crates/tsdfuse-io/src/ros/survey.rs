//! One pass over a recording before it is used: stamps of all messages that matter, and all poses.

use std::collections::{BTreeMap, BTreeSet};

use tsdfuse::trajectory::{ns_after, secs_between};

use super::bag::Bag;
use super::container::{Channel, Entry, NO_CHUNK};
use super::frames::Frames;
use super::messages::{self, Header, Placed};
use super::motion::Track;
use super::point_times::median;
use super::schema::{Schema, known};
use super::value::{self, Value};
use crate::error::{Error, Result};

/// Header and stamp of a message lie within this many bytes, unless the frame's name is very long.
const HEAD: usize = 512;

/// Parts of a recording that are read for a glance, and bytes of a part where there are no chunks.
const GLANCES: usize = 32;
const PART: u64 = 1 << 22;
/// From one interpolated pose to the next.
const GLANCE_STEP_NS: i64 = 100_000_000;

/// The part of a recording in which a message lies.
fn place(entry: &Entry) -> (u32, u32, u64) {
    let part = if entry.chunk == NO_CHUNK {
        entry.offset / PART
    } else {
        0
    };
    (entry.part, entry.chunk, part)
}

/// What a channel is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// Points: `PointCloud2` or Livox's `CustomMsg`.
    Points,
    /// Packets of a LiDAR.
    Packets,
    /// Frames in frames.
    Transforms,
    /// Stamped poses: odometry and others.
    Poses,
    Path,
    Imu,
    Gnss,
    /// Encoded or raw images.
    Image,
    CameraInfo,
    /// Nothing.
    None,
}

/// What the type of a channel makes of it.
pub(crate) fn use_of(channel: &Channel) -> Use {
    match channel.short_kind() {
        "PointCloud2" | "CustomMsg" => Use::Points,
        "VelodyneScan" | "PandarScan" | "NebulaPackets" | "PacketMsg" => Use::Packets,
        "TFMessage" | "tfMessage" | "TransformStamped" => Use::Transforms,
        "Odometry" | "PoseStamped" | "PoseWithCovarianceStamped" => Use::Poses,
        "Path" if channel.kind.starts_with("nav_msgs/") => Use::Path,
        "Imu" => Use::Imu,
        "NavSatFix" => Use::Gnss,
        "Image" | "CompressedImage" => Use::Image,
        "CameraInfo" => Use::CameraInfo,
        _ => Use::None,
    }
}

/// What the pass found of a channel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stamps {
    /// The stamp of each message; where that cannot be used, the time at which it was recorded.
    pub(crate) times_ns: Vec<i64>,
    /// The frame that the first message names.
    pub(crate) frame: String,
    /// How much later messages were recorded than they are stamped, seconds.
    pub(crate) delay_secs: Option<f64>,
    /// Why the stamps are not used.
    pub(crate) unusable: Option<&'static str>,
}

/// What the pass found.
pub(crate) struct Survey {
    /// By the number of the channel.
    pub(crate) schemas: BTreeMap<usize, Schema>,
    pub(crate) stamps: BTreeMap<usize, Stamps>,
    pub(crate) frames: Frames,
    /// How much later tf was recorded than it is stamped.
    pub(crate) frames_delay_secs: Option<f64>,
    pub(crate) tracks: Vec<Track>,
    pub(crate) notes: Vec<String>,
}

/// The definition of a channel's messages: the recording's own, or the one that is known.
pub(crate) fn schema(channel: &Channel) -> Result<Schema, String> {
    let text = if channel.schema.trim().is_empty() {
        known(&channel.kind)
    } else {
        Some(channel.schema.clone())
    };
    let text = text.ok_or_else(|| format!("has no definition of {}", channel.kind))?;
    Schema::parse(&channel.kind, &text)
}

/// Reads a message and hands it to `f`.
pub(crate) fn with_message<T>(
    bag: &Bag,
    channel: usize,
    schema: &Schema,
    entry: &Entry,
    f: impl FnOnce(&Value<'_>) -> Result<T, String>,
) -> Result<T> {
    let told = bag.channels().get(channel);
    let (topic, encoding) = told.map_or(("", super::container::Encoding::Other), |c| {
        (c.topic.as_str(), c.encoding)
    });
    let data = bag.read(entry, usize::MAX)?;
    let read = value::read(schema, encoding, &data).and_then(|message| f(&message));
    read.map_err(|why| wrong(topic, entry, &why))
}

fn wrong(topic: &str, entry: &Entry, why: &str) -> Error {
    let secs = secs_between(0, entry.time_ns);
    Error::dataset(topic, format!("the message recorded at {secs:.6} s: {why}"))
}

/// Reads only the header of a message.
fn head(bag: &Bag, channel: &Channel, schema: &Schema, entry: &Entry) -> Result<Header> {
    let data = bag.read(entry, HEAD)?;
    let read = |data: &[u8]| messages::header(&value::read_until(schema, channel.encoding, data, 1)?);
    match read(&data) {
        Ok(header) => Ok(header),
        Err(_) if data.len() >= HEAD => {
            read(&bag.read(entry, usize::MAX)?).map_err(|why| wrong(&channel.topic, entry, &why))
        }
        Err(why) => Err(wrong(&channel.topic, entry, &why)),
    }
}

impl Survey {
    /// Makes the pass. For a `glance`, of a large recording only some chunks are read, evenly spread: other stamps are estimated from
    /// when messages were recorded, and poses between are interpolated.
    ///
    /// # Errors
    /// If the files cannot be read. Messages that are damaged are counted and noted.
    pub(crate) fn make(bag: &Bag, glance: bool) -> Result<Self> {
        let mut this = Self {
            schemas: BTreeMap::new(),
            stamps: BTreeMap::new(),
            frames: Frames::default(),
            frames_delay_secs: None,
            tracks: Vec::new(),
            notes: Vec::new(),
        };
        let mut wanted: Vec<(Entry, usize, usize)> = Vec::new();
        for (number, channel) in bag.channels().iter().enumerate() {
            let entries = bag.entries(number);
            if use_of(channel) == Use::None || entries.is_empty() {
                continue;
            }
            match schema(channel) {
                Ok(schema) => {
                    this.schemas.insert(number, schema);
                }
                Err(why) => {
                    this.notes.push(format!("{}: is not read: {why}", channel.topic));
                    continue;
                }
            }
            // These have no header; they are followed later.
            if channel.short_kind() == "PacketMsg" {
                continue;
            }
            // Each message repeats the path, and the last one is the longest.
            let skip = if use_of(channel) == Use::Path {
                entries.len() - 1
            } else {
                0
            };
            wanted.extend(
                entries
                    .iter()
                    .copied()
                    .enumerate()
                    .skip(skip)
                    .map(|(i, entry)| (entry, number, i)),
            );
        }
        // As they lie, so that each chunk is unpacked once.
        wanted.sort_by_key(|(entry, ..)| (entry.part, entry.chunk, entry.offset));
        let is_static = |number: usize| {
            bag.channels()
                .get(number)
                .is_some_and(|channel| channel.topic.contains("static"))
        };
        let places = wanted.iter().map(|(entry, ..)| place(entry)).collect::<BTreeSet<_>>();
        let is_glance = glance && places.len() > GLANCES;
        if is_glance {
            let places: Vec<_> = places.into_iter().collect();
            let some = (0..GLANCES).filter_map(|k| places.get(k * (places.len() - 1) / (GLANCES - 1)));
            let some: BTreeSet<_> = some.collect();
            wanted.retain(|(entry, number, _)| some.contains(&place(entry)) || is_static(*number));
            this.notes.push(format!(
                "this is an overview: {GLANCES} of {} parts of the recording were read; stamps and poses between are estimated",
                places.len()
            ));
        }
        let mut heads: BTreeMap<usize, Vec<Option<Header>>> = BTreeMap::new();
        let mut placed: Vec<(i64, usize, Vec<Placed>)> = Vec::new();
        let mut damaged: BTreeMap<usize, (usize, String)> = BTreeMap::new();
        for (entry, number, index) in wanted {
            let (Some(channel), Some(schema)) = (bag.channels().get(number), this.schemas.get(&number)) else {
                continue;
            };
            let read = match use_of(channel) {
                Use::Transforms | Use::Poses | Use::Path => {
                    let poses = |message: &Value<'_>| match use_of(channel) {
                        Use::Path => messages::path(message),
                        Use::Poses => Ok(vec![messages::stamped_pose(message)?]),
                        _ if channel.short_kind() == "TransformStamped" => Ok(vec![messages::transform(message)?]),
                        _ => messages::transforms(message),
                    };
                    with_message(bag, number, schema, &entry, poses)
                        .map(|poses| placed.push((entry.time_ns, number, poses)))
                }
                _ => head(bag, channel, schema, &entry).map(|header| {
                    let list = heads
                        .entry(number)
                        .or_insert_with(|| vec![None; bag.entries(number).len()]);
                    if let Some(place) = list.get_mut(index) {
                        *place = Some(header);
                    }
                }),
            };
            match read {
                Ok(()) => {}
                // The file itself is broken.
                Err(error @ (Error::Io { .. } | Error::Format { .. })) => return Err(error),
                Err(error) => {
                    let (count, first) = damaged.entry(number).or_default();
                    *count += 1;
                    if *count == 1 {
                        *first = error.to_string();
                    }
                }
            }
        }
        this.notes
            .extend(damaged.into_values().map(|(count, first)| match count {
                1 => first,
                _ => format!("{first} (and {} more like it)", count - 1),
            }));
        for (number, heads) in heads {
            this.stamps.insert(number, stamps(bag.entries(number), heads));
        }
        placed.sort_by_key(|(recorded_ns, ..)| *recorded_ns);
        this.take_poses(bag, placed);
        if is_glance {
            this.frames.fill(GLANCE_STEP_NS);
            this.tracks.iter_mut().for_each(|track| track.fill(GLANCE_STEP_NS));
        }
        Ok(this)
    }

    fn take_poses(&mut self, bag: &Bag, all: Vec<(i64, usize, Vec<Placed>)>) {
        let mut tracks: BTreeMap<usize, Track> = BTreeMap::new();
        let mut delays: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
        let mut tf_delays = Vec::new();
        for (recorded_ns, number, poses) in all {
            let Some(channel) = bag.channels().get(number) else {
                continue;
            };
            let delay = poses.last().map(|last| secs_between(last.time_ns, recorded_ns));
            if use_of(channel) == Use::Transforms {
                let is_static = channel.topic.contains("static");
                if !is_static {
                    tf_delays.extend(delay);
                }
                for p in poses {
                    self.frames.add(&p.parent, &p.child, p.time_ns, p.pose, is_static);
                }
                continue;
            }
            delays.entry(number).or_default().extend(delay);
            let track = tracks.entry(number).or_insert_with(|| Track {
                topic: channel.topic.clone(),
                kind: channel.kind.clone(),
                ..Track::default()
            });
            for p in poses {
                (track.world, track.body) = (p.parent, p.child);
                track.poses.push((p.time_ns, p.pose));
            }
        }
        self.frames.settle();
        self.frames_delay_secs = Some(median(&mut tf_delays)).filter(|delay| delay.is_finite());
        for (number, mut track) in tracks {
            let delay = delays.get_mut(&number).map(|delays| median(delays));
            // A path has the times of its poses, and was recorded at its end.
            track.delay_secs = delay.filter(|delay| delay.is_finite() && !track.kind.ends_with("/Path"));
            self.tracks.push(track);
        }
        for frame in &self.frames.torn {
            self.notes
                .push(format!("tf tells of two parents of {frame}; the first one is used"));
        }
    }
}

/// The times of a channel's messages: their stamps where these go on, else the times at which they were recorded.
fn stamps(entries: &[Entry], heads: Vec<Option<Header>>) -> Stamps {
    let frame = heads
        .iter()
        .flatten()
        .next()
        .map_or(String::new(), |header| header.frame.clone());
    let known: Vec<i64> = heads.iter().flatten().map(|header| header.stamp_ns).collect();
    let steps = known.windows(2).filter(|pair| pair[0] != pair[1]).count();
    let back = known.windows(2).filter(|pair| pair[0] > pair[1]).count();
    let unusable = if known.iter().all(|&stamp| stamp == 0) {
        Some("the stamps are zero")
    } else if steps * 2 < known.len().saturating_sub(1) {
        Some("the stamps stand still")
    } else if back * 4 > known.len() {
        Some("the stamps go back and forth")
    } else {
        None
    };
    let delays = entries
        .iter()
        .zip(&heads)
        .filter_map(|(entry, header)| Some(secs_between(header.as_ref()?.stamp_ns, entry.time_ns)));
    let mut delays: Vec<f64> = delays.collect();
    let delay = median(&mut delays);
    let usual = if delay.is_finite() { delay } else { 0.0 };
    let times_ns = entries.iter().zip(heads).map(|(entry, header)| match header {
        Some(header) if unusable.is_none() => header.stamp_ns,
        None if unusable.is_none() => ns_after(entry.time_ns, -usual),
        _ => entry.time_ns,
    });
    Stamps {
        times_ns: times_ns.collect(),
        frame,
        delay_secs: Some(delay).filter(|delay| delay.is_finite() && unusable.is_none()),
        unusable,
    }
}
