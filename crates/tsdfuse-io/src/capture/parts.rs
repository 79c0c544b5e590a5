//! The files of a capture as one: a file, or the files of a folder into which `tcpdump -C` or Wireshark split it.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::files;

pub(super) const PCAPNG: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];
/// Bytes of a PCAP file's header. A pcapng file may hold several sections, so there nothing comes off.
const PCAP_HEADER: u64 = 24;

/// Whether a file begins as a capture does.
fn is_capture(head: [u8; 4]) -> bool {
    let micros_or_nanos = [0xA1B2_C3D4_u32, 0xA1B2_3C4D];
    head == PCAPNG
        || micros_or_nanos.contains(&u32::from_le_bytes(head))
        || micros_or_nanos.contains(&u32::from_be_bytes(head))
}

/// Several files, one after the other, with the header of the first one.
#[derive(Debug)]
pub(crate) struct Parts {
    parts: Vec<Part>,
    /// Where the next byte is read, and in which part that is.
    at: u64,
    open: Option<(usize, File)>,
}

#[derive(Debug)]
struct Part {
    path: PathBuf,
    /// Where its content begins in the whole, and in its file.
    begin: u64,
    skipped: u64,
    length: u64,
}

/// The captures of a folder in natural order, or the one file; empty if it is none.
pub(crate) fn paths(path: &Path) -> Vec<PathBuf> {
    let is_one = |path: &PathBuf| {
        path.is_file() && head(path).is_ok_and(|head| is_capture([head[0], head[1], head[2], head[3]]))
    };
    if !path.is_dir() {
        return vec![path.to_owned()].into_iter().filter(is_one).collect();
    }
    let mut names = files::names(path).unwrap_or_default();
    names.sort_by(|a, b| files::natural_order(a, b));
    names.into_iter().map(|name| path.join(name)).filter(is_one).collect()
}

fn head(path: &Path) -> Result<[u8; PCAP_HEADER as usize]> {
    let mut head = [0; PCAP_HEADER as usize];
    let mut file = File::open(path)?.take(PCAP_HEADER);
    // Shorter files are told by whoever reads them.
    let mut read = 0;
    while read < head.len() {
        match file.read(&mut head[read..])? {
            0 => break,
            n => read += n,
        }
    }
    Ok(head)
}

impl Parts {
    /// Opens them.
    ///
    /// # Errors
    /// If one cannot be read, or is of another kind than the first.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let mut parts: Vec<Part> = Vec::new();
        let mut first = [0; PCAP_HEADER as usize];
        for path in paths(path) {
            let (head, length) = (head(&path)?, std::fs::metadata(&path)?.len());
            let Some(before) = parts.last() else {
                first = head;
                parts.push(Part {
                    path,
                    begin: 0,
                    skipped: 0,
                    length,
                });
                continue;
            };
            let is_ng = head[..4] == PCAPNG;
            // All but the fields that no reader uses.
            let is_alike = |range: std::ops::Range<usize>| head[range.clone()] == first[range];
            if !(is_alike(0..4) && (is_ng || is_alike(20..24))) {
                let reason = format!(
                    "{} is a capture of another kind than {}",
                    path.display(),
                    parts[0].path.display()
                );
                return Err(Error::new(ErrorKind::InvalidData, reason));
            }
            let skipped = if is_ng { 0 } else { PCAP_HEADER.min(length) };
            parts.push(Part {
                path,
                begin: before.begin + before.length,
                skipped,
                length: length - skipped,
            });
        }
        if parts.is_empty() {
            // The system's own words, if it is no file at all.
            File::open(path)?;
            return Err(Error::new(ErrorKind::InvalidData, "is no capture"));
        }
        Ok(Self {
            parts,
            at: 0,
            open: None,
        })
    }
}

impl Read for Parts {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let ends_after = |part: &Part| part.begin + part.length <= self.at;
        let number = self.parts.partition_point(ends_after);
        let Some(part) = self.parts.get(number) else {
            return Ok(0);
        };
        let within = self.at - part.begin;
        let file = match &mut self.open {
            Some((open, file)) if *open == number => file,
            open => {
                let mut file = File::open(&part.path)?;
                file.seek(SeekFrom::Start(part.skipped + within))?;
                &mut open.insert((number, file)).1
            }
        };
        let left = usize::try_from(part.length - within)
            .unwrap_or(usize::MAX)
            .min(buffer.len());
        let read = file.read(&mut buffer[..left])?;
        if read == 0 && left > 0 {
            return Err(Error::new(ErrorKind::UnexpectedEof, "has become shorter"));
        }
        self.at += read as u64;
        Ok(read)
    }
}

impl Parts {
    /// Goes on reading there.
    pub(crate) fn go_to(&mut self, offset: u64) {
        (self.at, self.open) = (offset, None);
    }
}
