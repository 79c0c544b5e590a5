//! A recording as it lies on disk: one file, or a folder with the files of a split one; recognised by content.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use tempfile::TempPath;

use super::bag1::{self, Bag1};
use super::container::{Channel, Compression, Container, Data, Entry, MAX_MESSAGE, RandomFile};
#[cfg(feature = "db3")]
use super::db3::Db3;
use super::mcap::{self, McapFile};
use crate::error::{Error, Result};
use crate::files;

const ZSTD: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
const SQLITE: &[u8] = b"SQLite format 3\0";
/// A file that unpacks to more than this many times its size is refused.
const MAX_RATIO: u64 = 200;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Mcap,
    Bag1,
    Db3,
    Zstd,
}

fn kind_of(begin: &[u8]) -> Option<Kind> {
    match begin {
        b if mcap::recognises(b) => Some(Kind::Mcap),
        b if bag1::recognises(b) => Some(Kind::Bag1),
        b if b.starts_with(SQLITE) => Some(Kind::Db3),
        b if b.starts_with(ZSTD) => Some(Kind::Zstd),
        _ => None,
    }
}

fn kind(path: &Path) -> Option<Kind> {
    let mut begin = Vec::new();
    File::open(path).ok()?.take(16).read_to_end(&mut begin).ok()?;
    kind_of(&begin)
}

/// The files of a recording in order; empty if `path` is none.
fn parts(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return Vec::from_iter(kind(path).map(|_| path.to_owned()));
    }
    let mut names = files::names(path).unwrap_or_default();
    names.retain(|name| {
        let name = name.to_ascii_lowercase();
        let name = name.trim_end_matches(".zstd").trim_end_matches(".zst");
        [".bag", ".mcap", ".db3"].iter().any(|end| name.ends_with(end))
    });
    names.sort_by(|a, b| files::natural_order(a, b));
    let paths = names.into_iter().map(|name| path.join(name));
    paths.filter(|path| path.is_file() && kind(path).is_some()).collect()
}

/// Whether there is a recording.
pub(crate) fn recognises(path: &Path) -> bool {
    !parts(path).is_empty()
}

/// One or several files as one recording.
pub(crate) struct Bag {
    format: String,
    parts: Vec<Box<dyn Container>>,
    channels: Vec<Channel>,
    entries: Vec<Vec<Entry>>,
    notes: Vec<String>,
    /// Files that were unpacked. They are removed at the end.
    _unpacked: Vec<TempPath>,
}

impl Bag {
    /// Opens the index of a recording.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let mut bag = Self {
            format: String::new(),
            parts: Vec::new(),
            channels: Vec::new(),
            entries: Vec::new(),
            notes: Vec::new(),
            _unpacked: Vec::new(),
        };
        let files = parts(path);
        bag.note_missing(path, &files);
        for file in &files {
            let part = match kind(file) {
                Some(Kind::Zstd) => {
                    let unpacked = unpack(file)?;
                    let part = open_plain(&unpacked).map_err(|e| of(file, e))?;
                    bag._unpacked.push(unpacked);
                    part
                }
                _ => open_plain(file)?,
            };
            bag.add(part);
        }
        bag.entries.iter_mut().for_each(|entries| entries.sort());
        bag.format = bag.parts.first().map_or(String::new(), |part| part.format().to_owned());
        if bag.format == "MCAP" && path.join("metadata.yaml").is_file() {
            bag.format = "ROS 2 bag (MCAP)".to_owned();
        }
        if files.len() > 1 {
            bag.format += &format!(", {} files", files.len());
        }
        Ok(bag)
    }

    fn add(&mut self, container: Box<dyn Container>) {
        let part = u32::try_from(self.parts.len()).unwrap_or(u32::MAX);
        for (number, channel) in container.channels().iter().enumerate() {
            let same = |other: &Channel| other.topic == channel.topic && other.kind == channel.kind;
            let at = self.channels.iter().position(same).unwrap_or_else(|| {
                self.channels.push(channel.clone());
                self.entries.push(Vec::new());
                self.channels.len() - 1
            });
            if let Some(list) = self.entries.get_mut(at) {
                list.extend(container.entries(number).iter().map(|entry| Entry { part, ..*entry }));
            }
        }
        self.notes.extend_from_slice(container.notes());
        self.parts.push(container);
    }

    /// Notes files that `metadata.yaml` lists and that are not there.
    fn note_missing(&mut self, path: &Path, files: &[PathBuf]) {
        let Ok(text) = std::fs::read_to_string(path.join("metadata.yaml")) else {
            return;
        };
        let lines = text.lines().map(str::trim);
        let listed = lines
            .skip_while(|line| !line.starts_with("relative_file_paths"))
            .skip(1);
        for line in listed.take_while(|line| line.starts_with('-')) {
            let name = line.trim_start_matches(['-', ' ']).trim_matches(['"', '\'']);
            let stem = Path::new(name)
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let is_there =
                |file: &PathBuf| files::name(file).starts_with(&stem) || stem.starts_with(&files::name(file));
            if !files.iter().any(is_there) {
                self.notes
                    .push(format!("metadata.yaml lists {name}, which is not there"));
            }
        }
    }

    pub(crate) fn format(&self) -> &str {
        &self.format
    }

    pub(crate) fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// The messages of a channel, in order of the times at which they were recorded.
    pub(crate) fn entries(&self, channel: usize) -> &[Entry] {
        self.entries.get(channel).map_or(&[], Vec::as_slice)
    }

    pub(crate) fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The bytes of a message, or at least its first `limit` ones.
    pub(crate) fn read(&self, entry: &Entry, limit: usize) -> Result<Data> {
        let part = self.parts.get(entry.part as usize);
        let part = part.ok_or_else(|| Error::dataset(&self.format, "has no such file"))?;
        let data = part.read(entry, limit)?;
        if !data.starts_with(ZSTD) {
            return Ok(data);
        }
        // Compressed message by message: no message of ROS begins like that.
        let packed = if data.len() < limit {
            data
        } else {
            part.read(entry, usize::MAX)?
        };
        let limit = (limit as u64)
            .min(MAX_MESSAGE)
            .min((packed.len() as u64).saturating_mul(MAX_RATIO) + (1 << 20));
        let unpacked = Compression::Zstd.unpack_up_to(&packed, limit);
        let wrong =
            |why: String| Error::dataset(&self.format, format!("a message that was compressed by itself {why}"));
        Ok(Data::Own(unpacked.map_err(wrong)?))
    }
}

fn of(path: &Path, error: Error) -> Error {
    match error {
        Error::Format { reason, .. } => Error::format(path, reason),
        other => other,
    }
}

fn open_plain(path: &Path) -> Result<Box<dyn Container>> {
    Ok(match kind(path) {
        Some(Kind::Mcap) => Box::new(McapFile::open(RandomFile::open(path)?)?),
        Some(Kind::Bag1) => Box::new(Bag1::open(RandomFile::open(path)?)?),
        Some(Kind::Db3) => db3(path)?,
        Some(Kind::Zstd) | None => return Err(Error::format(path, "is neither a ROS bag nor MCAP")),
    })
}

#[cfg(feature = "db3")]
fn db3(path: &Path) -> Result<Box<dyn Container>> {
    Ok(Box::new(Db3::open(path)?))
}

#[cfg(not(feature = "db3"))]
fn db3(path: &Path) -> Result<Box<dyn Container>> {
    let reason = "is a ROS 2 bag in SQLite, which this program was built without: build it with `--features db3`";
    Err(Error::format(path, reason))
}

/// Unpacks a whole compressed file into a temporary one.
fn unpack(path: &Path) -> Result<TempPath> {
    let file = File::open(path).map_err(Error::io(path))?;
    let limit = file
        .metadata()
        .map_err(Error::io(path))?
        .len()
        .saturating_mul(MAX_RATIO)
        + (1 << 20);
    let damaged = |e: &dyn std::fmt::Display| Error::format(path, format!("is damaged: {e}"));
    let mut packed = ruzstd::decoding::StreamingDecoder::new(std::io::BufReader::new(file)).map_err(|e| damaged(&e))?;
    let mut unpacked = tempfile::Builder::new()
        .prefix("tsdfuse-bag-")
        .tempfile()
        .map_err(Error::io(path))?;
    let mut buffer = vec![0; 1 << 16];
    let mut total = 0;
    loop {
        let count = packed.read(&mut buffer).map_err(|e| damaged(&e))?;
        let Some(bytes) = buffer.get(..count).filter(|bytes| !bytes.is_empty()) else {
            break;
        };
        total += count as u64;
        if total > limit {
            return Err(Error::format(
                path,
                format!("unpacks to more than {limit} bytes, which is not believed"),
            ));
        }
        unpacked.write_all(bytes).map_err(Error::io(path))?;
    }
    Ok(unpacked.into_temp_path())
}
