//! ROS 1 bags, version 2.0: the index at the end of a file, or what a pass over a file without one finds.
//!
//! Everything is a record: a header of `name=value` fields, and data, each with its length in front.

use std::collections::BTreeMap;
use std::path::Path;

use super::container::{
    Channel, Chunk, Chunks, Compression, Container, Data, Encoding, Entry, RandomFile, u32_at, u64_at,
};
use crate::error::{Error, Result};

const MAGIC: &[u8] = b"#ROSBAG V";
const VERSION: &[u8] = b"#ROSBAG V2.0\n";
/// Headers of records are read up to this length; only connections have long ones.
const HEADER: u64 = 1 << 12;
const MAX_HEADER: u64 = 1 << 24;

/// Opcodes of records.
mod op {
    pub(super) const MESSAGE: u8 = 2;
    pub(super) const INDEX: u8 = 4;
    pub(super) const CHUNK: u8 = 5;
    pub(super) const CHUNK_INFO: u8 = 6;
    pub(super) const CONNECTION: u8 = 7;
}

/// Whether a file begins like a ROS 1 bag.
pub(crate) fn recognises(begin: &[u8]) -> bool {
    begin.starts_with(MAGIC)
}

/// The index of a ROS 1 bag.
pub(crate) struct Bag1 {
    chunks: Chunks,
    /// Where each connection is in `channels`.
    numbers: BTreeMap<u32, usize>,
    channels: Vec<Channel>,
    entries: Vec<Vec<Entry>>,
    notes: Vec<String>,
}

/// The fields of a record's header.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn get(&self, name: &str) -> Option<&'a [u8]> {
        let mut rest = self.0;
        while let Some(len) = u32_at(rest, 0) {
            let field = rest.get(4..4usize.checked_add(usize::try_from(len).ok()?)?)?;
            rest = rest.get(4 + field.len()..)?;
            let equals = field.iter().position(|&b| b == b'=')?;
            if field.get(..equals)? == name.as_bytes() {
                return field.get(equals + 1..);
            }
        }
        None
    }

    fn u32(&self, name: &str) -> Option<u32> {
        u32_at(self.get(name)?, 0)
    }

    fn text(&self, name: &str) -> Option<String> {
        Some(String::from_utf8_lossy(self.get(name)?).into_owned())
    }

    fn op(&self) -> Option<u8> {
        self.get("op")?.first().copied()
    }
}

/// A record outside of chunks, without its data.
struct Record {
    header: Vec<u8>,
    data_at: u64,
    data_len: u64,
}

/// A time as it lies in records.
fn time(bytes: &[u8]) -> Option<i64> {
    let (secs, nanos) = (u32_at(bytes, 0)?, u32_at(bytes, 4)?);
    Some(i64::from(secs) * 1_000_000_000 + i64::from(nanos))
}

impl Bag1 {
    /// Reads the index of a file.
    pub(crate) fn open(file: RandomFile) -> Result<Self> {
        let path = &file.path().to_owned();
        let begin = file.read_up_to(0, VERSION.len() as u64)?;
        if begin != VERSION {
            let version = String::from_utf8_lossy(begin.get(MAGIC.len()..).unwrap_or_default())
                .trim()
                .to_owned();
            return Err(Error::format(
                path,
                format!("is a ROS 1 bag of version {version}; only 2.0 is read"),
            ));
        }
        let mut this = Self {
            chunks: Chunks::new(file),
            numbers: BTreeMap::new(),
            channels: Vec::new(),
            entries: Vec::new(),
            notes: Vec::new(),
        };
        let first = this.record(VERSION.len() as u64)?;
        let index_at = first
            .as_ref()
            .and_then(|first| u64_at(Fields(&first.header).get("index_pos")?, 0));
        let begin = first.map_or(0, |first| first.data_at + first.data_len);
        match index_at.filter(|&at| at > 0 && at < this.chunks.file.len()) {
            Some(at) => this.read_index(at)?,
            None => {
                this.scan(begin)?;
                let name = crate::files::name(path);
                this.notes.push(format!(
                    "{name}: was not closed: it has no index, and is read up to its last whole chunk"
                ));
            }
        }
        this.entries.iter_mut().for_each(|entries| entries.sort());
        Ok(this)
    }

    fn path(&self) -> &Path {
        self.chunks.file.path()
    }

    fn wrong(&self, at: u64, what: impl std::fmt::Display) -> Error {
        Error::format(self.path(), format!("the record at byte {at} {what}"))
    }

    /// The record at `at`; `None` where the file ends.
    fn record(&self, at: u64) -> Result<Option<Record>> {
        let file = &self.chunks.file;
        let mut bytes = file.read_up_to(at, HEADER)?;
        let Some(header_len) = u32_at(&bytes, 0).map(u64::from) else {
            return Ok(None);
        };
        if header_len > MAX_HEADER {
            return Err(self.wrong(at, format_args!("has a header of {header_len} bytes")));
        }
        if header_len + 8 > bytes.len() as u64 {
            bytes = file.read_up_to(at, header_len + 8)?;
        }
        let end = 4 + header_len as usize;
        let (Some(header), Some(data_len)) = (bytes.get(4..end), u32_at(&bytes, end)) else {
            return Ok(None);
        };
        let data_at = at + 8 + header_len;
        if data_at + u64::from(data_len) > file.len() {
            return Ok(None);
        }
        Ok(Some(Record {
            header: header.to_vec(),
            data_at,
            data_len: u64::from(data_len),
        }))
    }

    fn read_index(&mut self, mut at: u64) -> Result<()> {
        let mut chunks = Vec::new();
        while at < self.chunks.file.len() {
            let truncated = |this: &Self| this.wrong(at, "of the index is truncated");
            let record = self.record(at)?.ok_or_else(|| truncated(self))?;
            let fields = Fields(&record.header);
            match fields.op() {
                Some(op::CONNECTION) => self.connection(at, &record)?,
                Some(op::CHUNK_INFO) => {
                    let chunk_at = fields.get("chunk_pos").and_then(|bytes| u64_at(bytes, 0));
                    chunks.push(chunk_at.ok_or_else(|| self.wrong(at, "tells of a chunk without its place"))?);
                }
                _ => {}
            }
            at = record.data_at + record.data_len;
        }
        for chunk_at in chunks {
            let record = self.record(chunk_at)?;
            let record = record.filter(|record| Fields(&record.header).op() == Some(op::CHUNK));
            let record = record.ok_or_else(|| self.wrong(chunk_at, "is no chunk, which the index says it is"))?;
            self.add_chunk(chunk_at, &record)?;
            let mut at = record.data_at + record.data_len;
            while let Some(record) = self.record(at)?.filter(|r| Fields(&r.header).op() == Some(op::INDEX)) {
                self.index(at, &record)?;
                at = record.data_at + record.data_len;
            }
        }
        Ok(())
    }

    /// Passes over a bag without an index, from chunk to chunk.
    fn scan(&mut self, mut at: u64) -> Result<()> {
        while let Some(record) = self.record(at)? {
            let next = record.data_at + record.data_len;
            match Fields(&record.header).op() {
                Some(op::CHUNK) => {
                    self.add_chunk(at, &record)?;
                    // Without its index a chunk was not finished.
                    if self.record(next)?.is_some() {
                        self.scan_chunk()?;
                    }
                }
                Some(op::CONNECTION) => self.connection(at, &record)?,
                _ => {}
            }
            at = next;
        }
        Ok(())
    }

    fn connection(&mut self, at: u64, record: &Record) -> Result<()> {
        if record.data_len > MAX_HEADER {
            return Err(self.wrong(at, format_args!("is a connection of {} bytes", record.data_len)));
        }
        let data = self.chunks.file.read(record.data_at, record.data_len)?;
        self.define(&Fields(&record.header), &Fields(&data))
            .ok_or_else(|| self.wrong(at, "is a connection without a topic or type"))
    }

    fn define(&mut self, fields: &Fields<'_>, told: &Fields<'_>) -> Option<()> {
        let (id, topic) = (fields.u32("conn")?, fields.text("topic")?);
        let (kind, schema) = (told.text("type")?, told.text("message_definition").unwrap_or_default());
        let channel = Channel::new(&topic, &kind, Encoding::Ros1, &schema);
        // Each publisher has a connection of its own.
        let same = self.channels.iter().position(|other| *other == channel);
        let number = same.unwrap_or_else(|| {
            self.channels.push(channel);
            self.entries.push(Vec::new());
            self.channels.len() - 1
        });
        self.numbers.insert(id, number);
        Some(())
    }

    fn add_chunk(&mut self, at: u64, record: &Record) -> Result<()> {
        let fields = Fields(&record.header);
        let name = fields.text("compression").unwrap_or_default();
        let compression = Compression::named(&name)
            .ok_or_else(|| self.wrong(at, format_args!("is compressed with {name:?}, which is not known")))?;
        let unpacked = fields
            .u32("size")
            .ok_or_else(|| self.wrong(at, "is a chunk without a size"))?;
        self.chunks.chunks.push(Chunk {
            begin: record.data_at,
            packed: record.data_len,
            unpacked: u64::from(unpacked),
            compression,
        });
        Ok(())
    }

    fn last_chunk(&self) -> u32 {
        u32::try_from(self.chunks.chunks.len())
            .unwrap_or(u32::MAX)
            .saturating_sub(1)
    }

    /// Takes in which messages of one connection the last chunk has.
    fn index(&mut self, at: u64, record: &Record) -> Result<()> {
        let data = self.chunks.file.read(record.data_at, record.data_len)?;
        let id = Fields(&record.header).u32("conn");
        let number = id.and_then(|id| self.numbers.get(&id).copied());
        let number = number.ok_or_else(|| self.wrong(at, "is of a connection that is not known"))?;
        let chunk = self.last_chunk();
        let entry = |message: &[u8; 12]| {
            Some(Entry {
                time_ns: time(message)?,
                part: 0,
                chunk,
                offset: u64::from(u32_at(message, 8)?),
            })
        };
        let entries = data.as_chunks::<12>().0.iter().filter_map(entry);
        if let Some(list) = self.entries.get_mut(number) {
            list.extend(entries);
        }
        Ok(())
    }

    fn scan_chunk(&mut self) -> Result<()> {
        let chunk = self.last_chunk();
        let content = self.chunks.unpacked(chunk)?;
        let mut at = 0;
        while let Some((header, data)) = split(&content, at) {
            let fields = Fields(header);
            match fields.op() {
                Some(op::CONNECTION) => {
                    let defined = self.define(&fields, &Fields(data));
                    defined
                        .ok_or_else(|| self.wrong(at as u64, "of a chunk is a connection without a topic or type"))?;
                }
                Some(op::MESSAGE) => {
                    let number = fields.u32("conn").and_then(|id| self.numbers.get(&id).copied());
                    let time_ns = fields.get("time").and_then(time);
                    let list = number.and_then(|number| self.entries.get_mut(number));
                    if let (Some(list), Some(time_ns)) = (list, time_ns) {
                        list.push(Entry {
                            time_ns,
                            part: 0,
                            chunk,
                            offset: at as u64,
                        });
                    }
                }
                _ => {}
            }
            at += 8 + header.len() + data.len();
        }
        Ok(())
    }
}

/// Header and data of the record at `at` in a chunk.
fn split(bytes: &[u8], at: usize) -> Option<(&[u8], &[u8])> {
    let rest = bytes.get(at..)?;
    let header_len = usize::try_from(u32_at(rest, 0)?).ok()?;
    let header = rest.get(4..4usize.checked_add(header_len)?)?;
    let data_len = usize::try_from(u32_at(rest, 4 + header_len)?).ok()?;
    let begin = 8 + header_len;
    Some((header, rest.get(begin..begin.checked_add(data_len)?)?))
}

impl Container for Bag1 {
    fn format(&self) -> &str {
        "ROS 1 bag"
    }

    fn channels(&self) -> &[Channel] {
        &self.channels
    }

    fn entries(&self, channel: usize) -> &[Entry] {
        self.entries.get(channel).map_or(&[], Vec::as_slice)
    }

    fn read(&self, entry: &Entry, limit: usize) -> Result<Data> {
        let Entry { chunk, offset, .. } = *entry;
        let no_message = || self.wrong(offset, format_args!("of chunk {chunk} is no message"));
        let head = self.chunks.read_up_to(chunk, offset, HEADER)?;
        let header_len = u32_at(&head, 0).map(|len| len as usize).filter(|&len| len < head.len());
        let header_len = header_len.ok_or_else(no_message)?;
        let header = Fields(head.get(4..4 + header_len).ok_or_else(no_message)?);
        let len = u32_at(&head, 4 + header_len).ok_or_else(no_message)?;
        if header.op() != Some(op::MESSAGE) {
            return Err(no_message());
        }
        let begin = offset.saturating_add(8 + header_len as u64);
        self.chunks.read(chunk, begin, u64::from(len).min(limit as u64))
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}
