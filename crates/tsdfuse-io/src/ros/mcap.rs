//! MCAP: the index at the end of a file, or what a pass over a file without one finds.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::{ChunkIndex, Record, op};

use super::container::{
    Channel, Chunk, Chunks, Compression, Container, Data, Encoding, Entry, NO_CHUNK, RandomFile, u32_at, u64_at,
};
use crate::error::{Error, Result};

/// What a file begins and ends with.
pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Opcode and length of a record.
const RECORD: u64 = 1 + 8;
/// Channel, sequence and two times of a message.
const MESSAGE: u64 = 2 + 4 + 8 + 8;
/// A chunk's own header is shorter than this.
const CHUNK_HEADER: u64 = 256;
/// Records other than chunks and messages are read whole; larger ones are refused.
const MAX_RECORD: u64 = 1 << 28;

/// The index of an MCAP file.
pub(crate) struct McapFile {
    chunks: Chunks,
    index: Index,
    notes: Vec<String>,
}

/// Schemas, channels and messages, as far as records told of them.
#[derive(Default)]
pub(crate) struct Index {
    /// Name, encoding and text of each schema.
    schemas: BTreeMap<u16, (String, String)>,
    /// Where each channel is in `channels`.
    numbers: BTreeMap<u16, usize>,
    channels: Vec<Channel>,
    entries: Vec<Vec<Entry>>,
}

impl Index {
    /// Takes a schema or channel in; whether `record` was one.
    pub(crate) fn define(&mut self, record: &Record<'_>) -> bool {
        match record {
            Record::Schema { header, data } => {
                let text = if header.encoding == "ros2idl" {
                    String::new()
                } else {
                    String::from_utf8_lossy(data).into_owned()
                };
                self.schemas.insert(header.id, (header.name.clone(), text));
            }
            Record::Channel(channel) if !self.numbers.contains_key(&channel.id) => {
                let none = (String::new(), String::new());
                let (kind, schema) = self.schemas.get(&channel.schema_id).unwrap_or(&none);
                let encoding = match channel.message_encoding.as_str() {
                    "ros1" => Encoding::Ros1,
                    "cdr" => Encoding::Cdr,
                    _ => Encoding::Other,
                };
                self.numbers.insert(channel.id, self.channels.len());
                self.channels.push(Channel::new(&channel.topic, kind, encoding, schema));
                self.entries.push(Vec::new());
            }
            Record::Channel(_) => {}
            _ => return false,
        }
        true
    }

    /// The number of a channel by the file's own.
    pub(crate) fn number(&self, id: u16) -> Option<usize> {
        self.numbers.get(&id).copied()
    }

    fn add(&mut self, id: u16, entry: Entry) -> Option<()> {
        let number = self.number(id)?;
        self.entries.get_mut(number)?.push(entry);
        Some(())
    }
}

/// Whether a file begins like MCAP.
pub(crate) fn recognises(begin: &[u8]) -> bool {
    begin.starts_with(MAGIC)
}

fn wrong(path: &Path, at: u64, what: impl std::fmt::Display) -> Error {
    Error::format(path, format!("the record at byte {at} {what}"))
}

/// Parses the body of a record.
pub(crate) fn record<'a>(path: &Path, at: u64, opcode: u8, body: &'a [u8]) -> Result<Record<'a>> {
    mcap::parse_record(opcode, body).map_err(|e| wrong(path, at, format_args!("is damaged: {}", one_line(&e))))
}

fn one_line(error: &mcap::McapError) -> String {
    let text = match error {
        mcap::McapError::Parse(inner) => inner.to_string(),
        other => other.to_string(),
    };
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn time(ns: u64) -> i64 {
    i64::try_from(ns).unwrap_or(i64::MAX)
}

/// The chunk whose record begins at `at`.
fn chunk_header(file: &RandomFile, at: u64, len: u64) -> Result<Chunk> {
    let path = file.path();
    let begin = at + RECORD;
    let body = file.read_up_to(begin, len.min(CHUNK_HEADER))?;
    let no_chunk = || wrong(path, at, "is no chunk");
    let name_len = u64::from(u32_at(&body, 28).ok_or_else(no_chunk)?);
    let name = usize::try_from(name_len)
        .ok()
        .and_then(|len| body.get(32..32usize.checked_add(len)?));
    let name = String::from_utf8_lossy(name.ok_or_else(no_chunk)?).into_owned();
    let (unpacked, packed) = u64_at(&body, 16)
        .zip(u64_at(&body, 32 + name.len()))
        .ok_or_else(no_chunk)?;
    let begin = begin + 40 + name_len;
    let compression = Compression::named(&name).ok_or_else(|| {
        wrong(
            path,
            at,
            format_args!("is compressed with {name:?}, which is not known"),
        )
    })?;
    let end = begin.checked_add(packed);
    if end.is_none_or(|end| end > file.len() || end > at.saturating_add(RECORD).saturating_add(len)) {
        return Err(wrong(path, at, format_args!("is truncated: a chunk of {packed} bytes")));
    }
    Ok(Chunk {
        begin,
        packed,
        unpacked,
        compression,
    })
}

impl McapFile {
    /// Reads the index of a file.
    pub(crate) fn open(file: RandomFile) -> Result<Self> {
        if !file.read_up_to(0, MAGIC.len() as u64)?.starts_with(MAGIC) {
            return Err(Error::format(file.path(), "does not begin as an MCAP file"));
        }
        let mut this = Self {
            chunks: Chunks::new(file),
            index: Index::default(),
            notes: Vec::new(),
        };
        if !this.read_summary()? {
            (this.index, this.chunks.chunks) = (Index::default(), Vec::new());
            this.scan()?;
        }
        this.index.entries.iter_mut().for_each(|entries| entries.sort());
        Ok(this)
    }

    fn path(&self) -> &Path {
        self.chunks.file.path()
    }

    /// Reads the index at the end; whether there is a complete one.
    fn read_summary(&mut self) -> Result<bool> {
        let file = &self.chunks.file;
        let footer_len = RECORD + 8 + 8 + 4;
        let Some(footer_at) = file.len().checked_sub(footer_len + MAGIC.len() as u64) else {
            return Ok(false);
        };
        let footer = file.read_up_to(footer_at, u64::MAX)?;
        let summary_at = u64_at(&footer, RECORD as usize).unwrap_or_default();
        let is_footer = footer.first() == Some(&op::FOOTER) && footer.ends_with(MAGIC);
        if !is_footer || summary_at < MAGIC.len() as u64 || summary_at > footer_at {
            return Ok(false);
        }
        let summary = file.read(summary_at, footer_at - summary_at)?;
        let mut chunks: Vec<ChunkIndex> = Vec::new();
        let mut messages = 0;
        for (at, opcode, body) in Records::new(&summary, summary_at) {
            let body = body.ok_or_else(|| wrong(self.chunks.file.path(), at, "is truncated"))?;
            if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::CHUNK_INDEX | op::STATISTICS) {
                continue;
            }
            match record(self.chunks.file.path(), at, opcode, body)? {
                Record::ChunkIndex(chunk) => chunks.push(chunk),
                Record::Statistics(statistics) => messages = statistics.message_count,
                other => {
                    self.index.define(&other);
                }
            }
        }
        // Messages outside of chunks have no index, nor have files whose channels are not repeated in the summary.
        if messages > 0 && (chunks.is_empty() || self.index.channels.is_empty()) || chunks.is_empty() {
            return Ok(false);
        }
        for chunk in chunks {
            let len = chunk.chunk_length.saturating_sub(RECORD);
            self.add_chunk(chunk.chunk_start_offset, len)?;
            let index_at = chunk.chunk_start_offset.saturating_add(chunk.chunk_length);
            if chunk.message_index_length == 0 {
                self.scan_chunk()?;
            } else {
                let indexes = self.chunks.file.read(index_at, chunk.message_index_length)?;
                for (at, opcode, body) in Records::new(&indexes, index_at) {
                    let body = body.ok_or_else(|| wrong(self.path(), at, "is truncated"))?;
                    self.take_message_index(at, opcode, body)?;
                }
            }
        }
        Ok(true)
    }

    /// Passes over the whole file, as it has no index: from record to record.
    fn scan(&mut self) -> Result<()> {
        let mut at = MAGIC.len() as u64;
        // A chunk whose messages are not known yet.
        let mut pending = false;
        let mut is_complete = false;
        let end = self.chunks.file.len();
        while at < end {
            let head = self.chunks.file.read_up_to(at, RECORD)?;
            let (Some(&opcode), Some(len)) = (head.first(), u64_at(&head, 1)) else {
                break;
            };
            let begin = at + RECORD;
            let Some(next) = begin.checked_add(len).filter(|&next| next <= end) else {
                break;
            };
            if pending && opcode != op::MESSAGE_INDEX {
                self.scan_chunk()?;
                pending = false;
            }
            match opcode {
                op::CHUNK => {
                    self.add_chunk(at, len)?;
                    pending = true;
                }
                op::MESSAGE_INDEX if pending || !self.chunks.chunks.is_empty() => {
                    let body = self.small_record(begin, len)?;
                    if pending && self.has_unknown_channel(at, &body)? {
                        // The channel stands in the chunk; its messages are then all found there.
                        self.scan_chunk()?;
                        pending = false;
                        at = self.skip_indexes(next)?;
                        continue;
                    }
                    self.take_message_index(at, opcode, &body)?;
                    if self.chunks.file.read_up_to(next, 1)?.first() != Some(&op::MESSAGE_INDEX) {
                        pending = false;
                    }
                }
                op::MESSAGE => {
                    let head = self.chunks.file.read_up_to(begin, MESSAGE.min(len))?;
                    self.take_message(NO_CHUNK, at, &head)?;
                }
                op::SCHEMA | op::CHANNEL => {
                    let body = self.small_record(begin, len)?;
                    let record = record(self.chunks.file.path(), at, opcode, &body)?;
                    self.index.define(&record);
                }
                op::FOOTER | op::DATA_END => {
                    is_complete = true;
                    break;
                }
                _ => {}
            }
            at = next;
        }
        if pending {
            self.scan_chunk()?;
        }
        if !is_complete {
            let note = format!(
                "{}: was not closed, or is still being written: it has no index, and is read up to its last whole chunk",
                crate::files::name(self.path())
            );
            self.notes.push(note);
        }
        Ok(())
    }

    fn small_record(&self, begin: u64, len: u64) -> Result<Vec<u8>> {
        if len > MAX_RECORD {
            return Err(wrong(
                self.path(),
                begin,
                format_args!("has {len} bytes; more than {MAX_RECORD} are not read"),
            ));
        }
        self.chunks.file.read(begin, len)
    }

    fn skip_indexes(&self, mut at: u64) -> Result<u64> {
        loop {
            let head = self.chunks.file.read_up_to(at, RECORD)?;
            match (head.first(), u64_at(&head, 1)) {
                (Some(&op::MESSAGE_INDEX), Some(len)) => at = at.saturating_add(RECORD).saturating_add(len),
                _ => return Ok(at),
            }
        }
    }

    fn add_chunk(&mut self, at: u64, len: u64) -> Result<()> {
        let chunk = chunk_header(&self.chunks.file, at, len)?;
        self.chunks.chunks.push(chunk);
        Ok(())
    }

    /// The number of the chunk that was added last.
    fn last_chunk(&self) -> u32 {
        u32::try_from(self.chunks.chunks.len())
            .unwrap_or(NO_CHUNK)
            .saturating_sub(1)
    }

    fn has_unknown_channel(&self, at: u64, body: &[u8]) -> Result<bool> {
        match record(self.path(), at, op::MESSAGE_INDEX, body)? {
            Record::MessageIndex(index) => {
                Ok(self.index.number(index.channel_id).is_none() && !index.records.is_empty())
            }
            _ => Ok(false),
        }
    }

    fn take_message_index(&mut self, at: u64, opcode: u8, body: &[u8]) -> Result<()> {
        if opcode != op::MESSAGE_INDEX {
            return Ok(());
        }
        let path = self.chunks.file.path();
        let Record::MessageIndex(index) = record(path, at, opcode, body)? else {
            return Ok(());
        };
        let chunk = self.last_chunk();
        let unpacked = self.chunks.chunks.last().map_or(0, |chunk| chunk.unpacked);
        for message in index.records {
            if message.offset >= unpacked {
                return Err(wrong(
                    path,
                    at,
                    format_args!("points beyond its chunk, to byte {}", message.offset),
                ));
            }
            let entry = Entry {
                time_ns: time(message.log_time),
                part: 0,
                chunk,
                offset: message.offset,
            };
            let unknown = || {
                wrong(
                    path,
                    at,
                    format_args!("is of channel {}, which is not known", index.channel_id),
                )
            };
            self.index.add(index.channel_id, entry).ok_or_else(unknown)?;
        }
        Ok(())
    }

    /// Takes in what a pass over the last chunk finds.
    fn scan_chunk(&mut self) -> Result<()> {
        let chunk = self.last_chunk();
        let content = self.chunks.unpacked(chunk)?;
        for (at, opcode, body) in Records::new(&content, 0) {
            let body = body.ok_or_else(|| wrong(self.path(), at, format_args!("of chunk {chunk} is truncated")))?;
            match opcode {
                op::MESSAGE => self.take_message(chunk, at, body)?,
                op::SCHEMA | op::CHANNEL => {
                    let record = record(self.chunks.file.path(), at, opcode, body)?;
                    self.index.define(&record);
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn take_message(&mut self, chunk: u32, offset: u64, body: &[u8]) -> Result<()> {
        let id = body.first_chunk().map(|id| u16::from_le_bytes(*id));
        let (Some(id), Some(log_time)) = (id, u64_at(body, 6)) else {
            return Err(wrong(self.path(), offset, "is too short for a message"));
        };
        let entry = Entry {
            time_ns: time(log_time),
            part: 0,
            chunk,
            offset,
        };
        let unknown = || {
            wrong(
                self.chunks.file.path(),
                offset,
                format_args!("is of channel {id}, which is not known"),
            )
        };
        self.index.add(id, entry).ok_or_else(unknown)
    }
}

impl Container for McapFile {
    fn format(&self) -> &str {
        "MCAP"
    }

    fn channels(&self) -> &[Channel] {
        &self.index.channels
    }

    fn entries(&self, channel: usize) -> &[Entry] {
        self.index.entries.get(channel).map_or(&[], Vec::as_slice)
    }

    fn read(&self, entry: &Entry, limit: usize) -> Result<Data> {
        let Entry { chunk, offset, .. } = *entry;
        let head = self.chunks.read(chunk, offset, RECORD)?;
        let len = u64_at(&head, 1).and_then(|len| len.checked_sub(MESSAGE));
        let (Some(&op::MESSAGE), Some(len)) = (head.first(), len) else {
            return Err(wrong(
                self.path(),
                offset,
                format_args!("of chunk {chunk} is no message"),
            ));
        };
        let begin = offset.saturating_add(RECORD + MESSAGE);
        self.chunks.read(chunk, begin, len.min(limit as u64))
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// The records in a part of a file: where each begins, its opcode, and its body; no body if that is cut off.
pub(crate) struct Records<'a> {
    bytes: &'a [u8],
    at: usize,
    offset: u64,
}

impl<'a> Records<'a> {
    /// The records in `bytes`, which begin at `offset` in the file.
    pub(crate) fn new(bytes: &'a [u8], offset: u64) -> Self {
        Self { bytes, at: 0, offset }
    }
}

impl<'a> Iterator for Records<'a> {
    type Item = (u64, u8, Option<&'a [u8]>);

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.at;
        let opcode = *self.bytes.get(at)?;
        let begin = at + RECORD as usize;
        let len = u64_at(self.bytes, at + 1).and_then(|len| usize::try_from(len).ok());
        let body = len.and_then(|len| self.bytes.get(begin..begin.checked_add(len)?));
        self.at = body.map_or(self.bytes.len(), |body| begin + body.len());
        Some((self.offset + at as u64, opcode, body))
    }
}
