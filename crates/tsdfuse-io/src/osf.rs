//! Ouster's OSF: range images, compressed as PNG or ZPNG, with the sensors' metadata.
//!
//! A file has a header, chunks of messages, and a directory of them at its end. It is gone through once when it is opened, for
//! times and poses; a scan is decoded when it is read, from its chunk. If its columns have poses that are not all the identity (as
//! the SDK's SLAM writes them), they are used. They are those of the body on which the metadata's extrinsic places the sensor.

mod image;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use tsdfuse::glam::{DMat4, DVec4};
use tsdfuse::scan::{Dropped, PoseAt};
use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Scan, Trajectory};
use tsdfuse_packets::ouster::{Beams, Metadata};

use crate::error::{Error, Result};
use crate::flatbuffer::Table;
use crate::mounted::Mounted;
use crate::source::{OpenOptions, ScanRef, Sensor, Source};
use crate::{placed, poses};

/// More sensors than any file has.
const MAX_SENSORS: usize = 64;
/// Poses that tell how the body moved during a scan.
const KNOTS: usize = 8;
/// A pixel's range and what its intensity is, as OSF numbers fields: the range, the second one, signal, reflectivity.
const RANGES: [u8; 2] = [1, 2];
const SIGNALS: [u8; 2] = [3, 4];
const REFLECTIVITIES: [u8; 2] = [5, 6];

/// Whether a file begins as an OSF does.
pub(crate) fn recognises(path: &Path) -> bool {
    let mut head = [0; 12];
    let read = path.is_file().then(|| File::open(path)?.read_exact(&mut head));
    read.is_some_and(|read: std::io::Result<()>| read.is_ok()) && &head[8..12] == b"OSF$"
}

/// An opened file.
pub(crate) struct Osf {
    path: PathBuf,
    sensors: Vec<Sensor>,
    metadata: Vec<(Metadata, Beams)>,
    scans: Vec<ScanRef>,
    /// Chunk, and number of the message there, of each scan.
    places: Vec<(u64, usize)>,
    /// Whether the poses are those of the columns.
    has_own_poses: bool,
    /// Of a pose file.
    trajectory: Option<Trajectory>,
    notes: Vec<String>,
}

/// The part of the file from an offset on that begins with its size.
fn part(path: &Path, file: &mut File, offset: u64, length: u64) -> Result<Vec<u8>> {
    let wrong = || Error::format(path, format!("has no part at byte {offset}"));
    let mut size = [0; 4];
    file.seek(SeekFrom::Start(offset)).map_err(Error::io(path))?;
    file.read_exact(&mut size).map_err(|_| wrong())?;
    let bytes = u64::from(u32::from_le_bytes(size));
    if offset.checked_add(4 + bytes).is_none_or(|end| end > length) {
        return Err(Error::format(
            path,
            format!("has a part of {bytes} bytes at byte {offset}, but {length} bytes in all"),
        ));
    }
    let mut part = size.to_vec();
    part.resize(4 + bytes as usize, 0);
    file.read_exact(&mut part[4..]).map_err(|_| wrong())?;
    Ok(part)
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Osf> {
    let wrong = |what: &str| Error::format(path, what);
    let mut file = File::open(path).map_err(Error::io(path))?;
    let length = file.metadata().map_err(Error::io(path))?.len();
    let header_part = part(path, &mut file, 0, length)?;
    let header = Table::root(&header_part).ok_or_else(|| wrong("has a damaged header"))?;
    let at = header
        .u64(2)
        .filter(|&at| at > 1)
        .ok_or_else(|| wrong("was not finished: its header names no directory"))?;
    // A checksum stands behind each part.
    let chunks_at = header_part.len() as u64 + 4;
    let directory_part = part(path, &mut file, at, length)?;
    let directory = Table::root(&directory_part).ok_or_else(|| wrong("has a damaged directory"))?;
    let mut metadata: Vec<(u32, Metadata)> = Vec::new();
    let mut streams: Vec<(u32, u32)> = Vec::new();
    for entry in directory.tables(4).into_iter().flatten() {
        let (id, kind) = (entry.u32(0).unwrap_or(0), entry.text(1).unwrap_or_default());
        let Some(inner) = entry.bytes(2).and_then(Table::root) else {
            continue;
        };
        if kind.ends_with("/LidarSensor") && metadata.len() < MAX_SENSORS {
            let text = inner.text(0).ok_or_else(|| wrong("has a sensor without metadata"))?;
            let read = Metadata::parse(text).map_err(|reason| Error::format(path, reason.to_string()))?;
            metadata.push((id, read));
        } else if kind.ends_with("/LidarScanStream") && streams.len() < MAX_SENSORS {
            streams.push((id, inner.u32(0).unwrap_or(0)));
        }
    }
    // Stream and sensor of each message's number.
    let sensor_of = |id: u32| {
        let (_, sensor) = streams.iter().find(|(stream, _)| *stream == id)?;
        metadata.iter().position(|(id, _)| id == sensor)
    };
    let mut found: Vec<(ScanRef, (u64, usize))> = Vec::new();
    for chunk in directory.vector(3, 24).into_iter().flatten() {
        let offset = chunk
            .get(16..24)
            .and_then(|bytes| bytes.try_into().ok())
            .map_or(0, u64::from_le_bytes);
        let at = chunks_at
            .checked_add(offset)
            .ok_or_else(|| wrong("has a chunk beyond its end"))?;
        let chunk = part(path, &mut file, at, length)?;
        let messages = Table::root(&chunk).and_then(|chunk| chunk.tables(0));
        for (number, message) in messages.into_iter().flatten().enumerate() {
            let Some(sensor) = message.u32(1).and_then(sensor_of) else {
                continue;
            };
            let Some(scan) = message.bytes(2).and_then(Table::root) else {
                continue;
            };
            let columns = Columns::of(&scan);
            let Some((first, _)) = columns.ends() else { continue };
            let reference = ScanRef {
                name: String::new(),
                sensor,
                time_ns: Some(columns.times_ns[first]),
                pose: columns.pose(first),
            };
            found.push((reference, (at, number)));
        }
    }
    found.sort_by_key(|(scan, place)| (scan.time_ns, *place));
    let plain: Vec<String> = metadata.iter().map(|(_, metadata)| metadata.name()).collect();
    let names = plain
        .iter()
        .enumerate()
        .map(|(i, name)| match plain.iter().filter(|other| *other == name).count() {
            1 => name.clone(),
            _ => format!("{name}-{}", i + 1),
        });
    let names: Vec<String> = names.collect();
    let is_asked = |i: &usize| options.sensors.is_empty() || names.len() == 1 || options.sensors.contains(&names[*i]);
    let asked: Vec<usize> = (0..names.len()).filter(is_asked).collect();
    if asked.is_empty() {
        return Err(Error::dataset(
            path,
            format!("has no such sensor; there are: {}", names.join(", ")),
        ));
    }
    // Nobody has computed them, if all are the identity.
    let has_own_poses = options.poses.is_none()
        && found.iter().all(|(scan, _)| scan.pose.is_some())
        && found.iter().any(|(scan, _)| scan.pose != Some(Pose::IDENTITY));
    let of_asked = |f: &dyn Fn(usize) -> usize| asked.iter().map(|&i| f(i)).collect::<Vec<_>>();
    let amounts = of_asked(&|i| found.iter().filter(|(scan, _)| scan.sensor == i).count());
    let told: Vec<Option<Pose>> = asked.iter().map(|&i| metadata[i].1.body_from_sensor).collect();
    let asked_names: Vec<String> = asked.iter().map(|&i| names[i].clone()).collect();
    let has_poses = has_own_poses || options.poses.is_some();
    let mounted = Mounted::choose(path, &asked_names, &amounts, &told, has_poses, options)?;
    let kept = asked.iter().zip(&mounted.is_kept).filter(|(_, is_kept)| **is_kept);
    let kept: Vec<usize> = kept.map(|(i, _)| *i).collect();
    found.retain(|(scan, _)| kept.contains(&scan.sensor));
    let several = kept.len() > 1;
    for (i, (scan, _)) in found.iter_mut().enumerate() {
        let name = &names[scan.sensor];
        scan.name = if several {
            format!("{name} scan {i}")
        } else {
            format!("scan {i}")
        };
        scan.sensor = kept.iter().position(|&i| i == scan.sensor).unwrap_or(0);
        let sitting = mounted.body_from_sensor.get(scan.sensor).copied().unwrap_or_default();
        scan.pose = scan.pose.filter(|_| has_own_poses).map(|pose| pose * sitting);
    }
    let sensors = kept
        .iter()
        .zip(mounted.body_from_sensor)
        .map(|(&i, body_from_sensor)| Sensor {
            model: metadata[i].1.model(metadata[i].1.columns_per_frame as u32),
            body_from_sensor,
            ..Sensor::new(&names[i])
        });
    let sensors: Vec<Sensor> = sensors.collect();
    let (mut scans, mut places): (Vec<ScanRef>, Vec<_>) = found.into_iter().unzip();
    let (mut trajectory, mut notes) = (None, mounted.notes);
    if scans.is_empty() {
        notes.push("there are no scans in it".to_owned());
    } else if let Some(file) = &options.poses {
        let poses = poses::read(file)?;
        let (timed, note) = placed::by_file(path, file, poses, &sensors, &mut scans, &mut places)?;
        trajectory = timed;
        notes.extend(note);
    }
    let metadata = kept
        .iter()
        .map(|&i| (metadata[i].1.clone(), Beams::new(&metadata[i].1)));
    Ok(Osf {
        path: path.to_owned(),
        metadata: metadata.collect(),
        notes,
        sensors,
        scans,
        places,
        has_own_poses,
        trajectory,
    })
}

/// What a message says of its columns.
struct Columns {
    times_ns: Vec<i64>,
    is_valid: Vec<bool>,
    poses: Vec<[f64; 16]>,
}

impl Columns {
    fn of(scan: &Table) -> Self {
        let u64_of = |bytes: &[u8]| bytes.try_into().map_or(0, u64::from_le_bytes);
        let times = scan.vector(2, 8).into_iter().flatten().map(u64_of);
        let status = scan.vector(4, 4).into_iter().flatten();
        let numbers = scan.vector(6, 8).into_iter().flatten();
        let numbers: Vec<f64> = numbers
            .map(|bytes| bytes.try_into().map_or(0.0, f64::from_le_bytes))
            .collect();
        let times_ns: Vec<i64> = times.map(|ns| i64::try_from(ns).unwrap_or(i64::MAX)).collect();
        let mut is_valid: Vec<bool> = status
            .map(|status| status.first().is_some_and(|status| status & 1 != 0))
            .collect();
        is_valid.resize(times_ns.len(), false);
        Self {
            times_ns,
            is_valid,
            poses: numbers.as_chunks().0.to_vec(),
        }
    }

    /// The first and the last column that were measured.
    fn ends(&self) -> Option<(usize, usize)> {
        let first = self.is_valid.iter().position(|valid| *valid)?;
        Some((first, self.is_valid.iter().rposition(|valid| *valid)?))
    }

    /// Where the body was at a column. Matrices lie row by row, those of old files column by column.
    fn pose(&self, column: usize) -> Option<Pose> {
        let matrix = DMat4::from_cols_array(self.poses.get(column)?);
        let is_by_rows = matrix.w_axis == DVec4::W;
        let (_, rotation, translation) =
            if is_by_rows { matrix.transpose() } else { matrix }.to_scale_rotation_translation();
        Pose::new(rotation, translation).ok()
    }

    /// How the body moved from the first column to the last, which is measured `secs_of` after the scan's time.
    fn motion(&self, secs_of: impl Fn(usize) -> f64) -> Vec<PoseAt> {
        let Some((first, last)) = self.ends() else {
            return Vec::new();
        };
        let knots = (1..=KNOTS).map(|k| first + (last - first) * k / KNOTS);
        let moved = knots.filter_map(|column| {
            let (secs, pose) = (secs_of(column), self.pose(column)?);
            (secs > 0.0).then_some(PoseAt { secs, pose })
        });
        let mut moved: Vec<PoseAt> = moved.collect();
        moved.dedup_by(|later, before| later.secs <= before.secs);
        let begin = self.pose(first);
        if moved.iter().all(|at| Some(at.pose) == begin) {
            moved.clear();
        }
        moved
    }
}

/// A field of the range image.
struct Field {
    /// One value a pixel, row by row.
    pixels: Vec<u32>,
    /// Whether rows are shifted such that they make a picture.
    is_shifted: bool,
}

/// `None` where the message has no such field.
fn field(scan: &Table, number: u8, rows: usize, columns: usize) -> Result<Option<Field>, String> {
    let mut kinds = scan.vector(1, 2).into_iter().flatten();
    let Some(channel) = kinds.position(|kind| kind.first() == Some(&number)) else {
        return Ok(None);
    };
    let image = scan
        .tables(0)
        .and_then(|mut channels| channels.nth(channel))
        .and_then(|channel| channel.bytes(0));
    let image = image.ok_or("a field has no image")?;
    let is_zpng = image.starts_with(&image::ZPNG);
    let pixels = if is_zpng {
        image::zpng(image, rows, columns)?
    } else {
        image::png(image, rows, columns)?
    };
    Ok(Some(Field {
        pixels,
        is_shifted: !is_zpng,
    }))
}

/// Reads a chunk's messages as far as their fields, for fuzzing.
pub(crate) fn parse_part(bytes: &[u8]) {
    let messages = Table::root(bytes).and_then(|chunk| chunk.tables(0));
    for message in messages.into_iter().flatten().take(16) {
        for scan in [Some(message), message.bytes(2).and_then(Table::root)]
            .into_iter()
            .flatten()
        {
            let columns = Columns::of(&scan);
            let _ = (
                columns.pose(0),
                columns.motion(|column| column as f64),
                field(&scan, RANGES[0], 8, 8),
            );
        }
    }
}

impl Osf {
    fn decode(&self, index: usize) -> Result<Scan, String> {
        let (reference, (at, number)) = (&self.scans[index], self.places[index]);
        let gone = || "is not there any more: the file has changed".to_owned();
        let mut file = File::open(&self.path).map_err(|e| e.to_string())?;
        let length = file.metadata().map_err(|e| e.to_string())?.len();
        let chunk = part(&self.path, &mut file, at, length).map_err(|e| e.to_string())?;
        let message = Table::root(&chunk)
            .and_then(|chunk| chunk.tables(0)?.nth(number))
            .ok_or_else(gone)?;
        let message = message.bytes(2).and_then(Table::root).ok_or_else(gone)?;
        let (metadata, beams) = &self.metadata[reference.sensor];
        let (rows, width) = (metadata.rows(), metadata.columns_per_frame);
        let columns = Columns::of(&message);
        if columns.times_ns.len() != width {
            return Err(format!("has {} columns, not {width}", columns.times_ns.len()));
        }
        let (first, last) = columns.ends().ok_or_else(gone)?;
        let begin_ns = columns.times_ns[first];
        let rings = tsdfuse_packets::ouster::rings(metadata);
        let shift = |row: usize| {
            metadata
                .pixel_shifts
                .get(row)
                .copied()
                .unwrap_or(0)
                .rem_euclid(width as i32) as usize
        };
        let mut scan = Scan {
            name: reference.name.clone(),
            time_ns: reference.time_ns,
            ..Scan::default()
        };
        let (mut all_rings, mut times, mut intensities, mut no_return) = (Vec::new(), Vec::new(), Vec::new(), 0);
        let mut images = Vec::new();
        for echo in 0..2 {
            let read = |number: u8| field(&message, number, rows, width);
            if let Some(range) = read(RANGES[echo])? {
                let intensity = match read(SIGNALS[echo])? {
                    Some(signal) => Some(signal),
                    None => read(REFLECTIVITIES[echo])?,
                };
                images.push((range, intensity));
            }
        }
        for column in (first..=last).filter(|&column| columns.is_valid[column]) {
            let secs = secs_between(begin_ns, columns.times_ns[column]) as f32;
            for (row, &ring) in rings.iter().enumerate() {
                let value = |field: &Field| {
                    let shift = if field.is_shifted { shift(row) } else { 0 };
                    field
                        .pixels
                        .get(row * width + (column + shift) % width)
                        .copied()
                        .unwrap_or(0)
                };
                let mut before = 0;
                for (echo, (range, intensity)) in images.iter().enumerate() {
                    let range_mm = value(range);
                    if range_mm == 0 || range_mm == before {
                        no_return += u64::from(echo == 0);
                        continue;
                    }
                    before = range_mm;
                    scan.points.push(beams.point(row, column, range_mm));
                    all_rings.push(ring);
                    times.push(secs);
                    intensities.push(intensity.as_ref().map_or(0, value) as f32);
                }
            }
        }
        (scan.rings, scan.times, scan.intensities) = (Some(all_rings), Some(times), Some(intensities));
        scan.dropped = Dropped {
            no_return,
            ..Dropped::default()
        };
        scan.pose = reference.pose;
        let sitting = self.sensors[reference.sensor].body_from_sensor;
        scan.motion = if self.has_own_poses {
            let mut motion = columns.motion(|column| secs_between(begin_ns, columns.times_ns[column]));
            motion.iter_mut().for_each(|at| at.pose = at.pose * sitting);
            motion
        } else {
            let times = scan.times.as_deref().unwrap_or_default();
            placed::motion(&self.scans, index, times, self.trajectory.as_ref(), &sitting)
        };
        Ok(scan)
    }
}

impl Source for Osf {
    fn format(&self) -> &str {
        "Ouster OSF"
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let name = &self.scans[index].name;
        self.decode(index)
            .map_err(|reason| Error::format(&self.path, format!("{name}: {reason}")))
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.trajectory.as_ref()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

#[cfg(test)]
mod tests;
