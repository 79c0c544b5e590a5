//! What all containers of messages are made of: channels, and entries of an index from which single messages are read.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

pub(crate) use crate::compression::Compression;
use crate::error::{Error, Result};

/// A message larger than this is refused: 16 times a sweep of the largest sensors.
pub(crate) const MAX_MESSAGE: u64 = 1 << 28;
/// How messages are serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// ROS 1: packed, little-endian.
    Ros1,
    /// ROS 2: CDR, aligned, with a header that tells the order of bytes.
    Cdr,
    /// Something else, which is not read.
    Other,
}

/// Messages of one type under one name.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Channel {
    pub(crate) topic: String,
    /// `sensor_msgs/PointCloud2`: package and name.
    pub(crate) kind: String,
    pub(crate) encoding: Encoding,
    /// The definition that the container has; empty where it has none.
    pub(crate) schema: String,
}

impl Channel {
    /// A channel; `kind` may be written as in ROS 2, `sensor_msgs/msg/PointCloud2`.
    pub(crate) fn new(topic: &str, kind: &str, encoding: Encoding, schema: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            kind: kind
                .replace("/msg/", "/")
                .replace("::msg::dds_::", "/")
                .replace("::msg::", "/"),
            encoding,
            schema: schema.to_owned(),
        }
    }

    /// The name of its type without the package.
    pub(crate) fn short_kind(&self) -> &str {
        self.kind.rsplit('/').next().unwrap_or_default()
    }
}

/// Where a message lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Entry {
    /// When it was recorded, nanoseconds.
    pub(crate) time_ns: i64,
    /// Which file of a split recording.
    pub(crate) part: u32,
    /// Which chunk of that file, or [`NO_CHUNK`].
    pub(crate) chunk: u32,
    /// Offset in the chunk or file, or row.
    pub(crate) offset: u64,
}

/// The message lies outside of chunks.
pub(crate) const NO_CHUNK: u32 = u32::MAX;

/// Messages that can be read in any order. The index is in memory, the messages are not.
pub(crate) trait Container: Send + Sync {
    /// The format's name for people.
    fn format(&self) -> &str;

    /// All channels.
    fn channels(&self) -> &[Channel];

    /// The messages of a channel, in order of the times at which they were recorded.
    fn entries(&self, channel: usize) -> &[Entry];

    /// The bytes of a message, or at least its first `limit` ones.
    fn read(&self, entry: &Entry, limit: usize) -> Result<Data>;

    /// What is missing or odd, one sentence each.
    fn notes(&self) -> &[String];
}

/// Bytes of a message: read for it alone, or part of a chunk.
pub(crate) enum Data {
    Own(Vec<u8>),
    Part(Arc<Vec<u8>>, Range<usize>),
}

impl Deref for Data {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Own(bytes) => bytes,
            Self::Part(bytes, range) => bytes.get(range.clone()).unwrap_or_default(),
        }
    }
}

/// What can be read here and there.
trait Seekable: Read + Seek + Send {}

impl<T: Read + Seek + Send> Seekable for T {}

/// A file that is read here and there, from several threads.
pub(crate) struct RandomFile {
    path: PathBuf,
    file: Mutex<Box<dyn Seekable>>,
    len: u64,
}

impl RandomFile {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path))?;
        let len = file.metadata().map_err(Error::io(path))?.len();
        Ok(Self {
            path: path.to_owned(),
            file: Mutex::new(Box::new(file)),
            len,
        })
    }

    /// A file that is in memory.
    pub(crate) fn of_bytes(path: &Path, bytes: Vec<u8>) -> Self {
        Self {
            path: path.to_owned(),
            len: bytes.len() as u64,
            file: Mutex::new(Box::new(std::io::Cursor::new(bytes))),
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// The bytes of a range, or an error that says that the file is truncated.
    pub(crate) fn read(&self, begin: u64, len: u64) -> Result<Vec<u8>> {
        let end = begin.checked_add(len).filter(|&end| end <= self.len);
        let (Some(_), Ok(count)) = (end, usize::try_from(len)) else {
            let reason = format!("is truncated: {len} bytes at {begin} are beyond its {} bytes", self.len);
            return Err(Error::format(&self.path, reason));
        };
        let mut bytes = vec![0; count];
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(begin)).map_err(Error::io(&self.path))?;
        file.read_exact(&mut bytes).map_err(Error::io(&self.path))?;
        Ok(bytes)
    }

    /// The bytes from `begin` on, at most `len` of them.
    pub(crate) fn read_up_to(&self, begin: u64, len: u64) -> Result<Vec<u8>> {
        self.read(begin, len.min(self.len.saturating_sub(begin)))
    }
}

/// A chunk of a file: many messages, compressed together or not at all.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chunk {
    /// Where its (compressed) content begins.
    pub(crate) begin: u64,
    pub(crate) packed: u64,
    pub(crate) unpacked: u64,
    pub(crate) compression: Compression,
}

/// An unpacked chunk, as soon as it is; or why it cannot be.
type Slot = Arc<OnceLock<Result<Arc<Vec<u8>>, String>>>;

/// The chunks of a file. The two that were used last are kept unpacked, as two threads read.
pub(crate) struct Chunks {
    pub(crate) file: RandomFile,
    pub(crate) chunks: Vec<Chunk>,
    last: Mutex<Vec<(u32, Slot)>>,
}

impl Chunks {
    pub(crate) fn new(file: RandomFile) -> Self {
        Self {
            file,
            chunks: Vec::new(),
            last: Mutex::new(Vec::new()),
        }
    }

    fn chunk(&self, number: u32) -> Result<Chunk> {
        let chunk = self.chunks.get(number as usize).copied();
        chunk.ok_or_else(|| self.wrong(number, "is missing"))
    }

    fn wrong(&self, number: u32, what: &str) -> Error {
        Error::format(self.file.path(), format!("chunk {number} {what}"))
    }

    /// The whole content of a chunk. Threads that want the same chunk wait for one of them, others do not.
    pub(crate) fn unpacked(&self, number: u32) -> Result<Arc<Vec<u8>>> {
        let chunk = self.chunk(number)?;
        let slot = self.slot(number);
        let unpack = || {
            let packed = self
                .file
                .read(chunk.begin, chunk.packed)
                .map_err(|e| format!("cannot be read: {e}"))?;
            chunk.compression.unpack(packed, chunk.unpacked).map(Arc::new)
        };
        slot.get_or_init(unpack).clone().map_err(|why| self.wrong(number, &why))
    }

    fn slot(&self, number: u32) -> Slot {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = last.iter().position(|(kept, _)| *kept == number);
        let slot = match kept {
            Some(at) => last.remove(at).1,
            None => Slot::default(),
        };
        if last.len() > 1 {
            last.remove(0);
        }
        last.push((number, slot.clone()));
        slot
    }

    /// A part of a chunk, or of the file outside of chunks, at most `len` bytes of it.
    pub(crate) fn read_up_to(&self, number: u32, begin: u64, len: u64) -> Result<Data> {
        if number == NO_CHUNK {
            return self.file.read_up_to(begin, len).map(Data::Own);
        }
        let chunk = self.chunk(number)?;
        let len = len.min(chunk.unpacked.saturating_sub(begin));
        if chunk.compression == Compression::None {
            let begin = chunk.begin.saturating_add(begin);
            return self.file.read(begin, len).map(Data::Own);
        }
        let bytes = self.unpacked(number)?;
        let begin = usize::try_from(begin).unwrap_or(usize::MAX).min(bytes.len());
        let end = begin + usize::try_from(len).unwrap_or(usize::MAX).min(bytes.len() - begin);
        Ok(Data::Part(bytes, begin..end))
    }

    /// A part of a chunk, or of the file outside of chunks.
    pub(crate) fn read(&self, number: u32, begin: u64, len: u64) -> Result<Data> {
        if len > MAX_MESSAGE {
            return Err(self.wrong(
                number,
                &format!("has a message of {len} bytes; more than {MAX_MESSAGE} are not read"),
            ));
        }
        let data = self.read_up_to(number, begin, len)?;
        if data.len() as u64 == len {
            Ok(data)
        } else {
            Err(self.wrong(number, &format!("ends within a message of {len} bytes")))
        }
    }
}

/// Little-endian numbers at the begin of bytes.
pub(crate) fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// As [`u32_at`].
pub(crate) fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}
