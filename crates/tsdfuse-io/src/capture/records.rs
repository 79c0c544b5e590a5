//! The records of a capture file, PCAP or pcapng, from any of them on.

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use pcap_parser::pcapng::{Block, parse_block_be, parse_block_le};
use pcap_parser::traits::PcapNGPacketBlock;
use pcap_parser::{parse_pcap_frame, parse_pcap_frame_be, parse_pcap_header};

use super::parts::{PCAPNG, Parts};
use crate::error::{Error, Result};

/// Longer records are damage: no packet is longer than 64 KiB.
const MAX_RECORD: usize = 1 << 18;
/// More interfaces than any capture has.
const MAX_INTERFACES: usize = 4096;
/// Bytes that are read at once.
const CHUNK: usize = 1 << 18;

/// What must be known of a capture to read it from its middle on.
#[derive(Clone, Debug)]
pub(crate) enum Layout {
    Pcap {
        is_big: bool,
        nanos_per_tick: i64,
        link: i32,
    },
    PcapNg(Vec<Section>),
}

impl Layout {
    /// Where the first record begins.
    pub(crate) fn begin(&self) -> u64 {
        match self {
            Self::Pcap { .. } => 24,
            Self::PcapNg(_) => 0,
        }
    }
}

/// A part of a pcapng with its own byte order and interfaces.
#[derive(Clone, Debug)]
pub(crate) struct Section {
    begin: u64,
    is_big: bool,
    interfaces: Vec<Interface>,
}

#[derive(Clone, Copy, Debug)]
struct Interface {
    link: i32,
    ticks_per_sec: u64,
    offset_secs: i64,
}

/// What was captured of one frame of the network.
#[derive(Debug)]
pub(crate) struct Record<'a> {
    /// Where the record begins in the file.
    pub(crate) offset: u64,
    /// When it was received, nanoseconds since 1970.
    pub(crate) received_ns: i64,
    /// What the frame begins with: a number of the registry of link types.
    pub(crate) link: i32,
    pub(crate) frame: &'a [u8],
}

/// Reads one record after the other.
pub(crate) struct Records<R> {
    path: PathBuf,
    input: BufReader<R>,
    layout: Layout,
    offset: u64,
    block: Vec<u8>,
    /// Bytes of the next block that were read already.
    begun: usize,
    /// Why there is no more, if that is not the file's end.
    damage: Option<String>,
}

impl Records<Parts> {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        Self::new(path, Parts::open(path).map_err(Error::io(path))?)
    }

    /// From the record at an offset on, of a capture whose layout is known.
    pub(crate) fn resume(path: &Path, layout: &Layout, offset: u64) -> Result<Self> {
        let mut file = Parts::open(path).map_err(Error::io(path))?;
        file.go_to(offset);
        Ok(Self {
            path: path.to_owned(),
            input: BufReader::with_capacity(CHUNK, file),
            layout: layout.clone(),
            offset,
            block: Vec::new(),
            begun: 0,
            damage: None,
        })
    }
}

impl<R: Read> Records<R> {
    pub(crate) fn new(path: &Path, input: R) -> Result<Self> {
        let mut records = Self {
            path: path.to_owned(),
            input: BufReader::with_capacity(CHUNK, input),
            layout: Layout::PcapNg(Vec::new()),
            offset: 0,
            block: Vec::new(),
            begun: 0,
            damage: None,
        };
        let mut head = [0; 24];
        let read = records.fill(&mut head[..4])?;
        if read < 4 {
            return Err(Error::format(path, "is too short for a capture"));
        }
        if head[..4] == PCAPNG {
            records.block.extend(&head[..4]);
            records.begun = 4;
            return Ok(records);
        }
        let read = records.fill(&mut head[4..])?;
        let header = parse_pcap_header(&head).ok().filter(|_| read == 20);
        let (_, header) = header.ok_or_else(|| Error::format(path, "has no header of a capture"))?;
        records.offset = 24;
        records.layout = Layout::Pcap {
            is_big: header.is_bigendian(),
            nanos_per_tick: if header.is_nanosecond_precision() { 1 } else { 1000 },
            // The upper bits tell of checksums at the end of frames.
            link: header.network.0 & 0xFFFF,
        };
        Ok(records)
    }

    /// As many bytes as there are, up to the buffer's length.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let mut filled = 0;
        while filled < buffer.len() {
            match self.input.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(read) => filled += read,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => return Err(Error::io(&self.path)(e)),
            }
        }
        Ok(filled)
    }

    /// Reads so many bytes more into the block; false at the file's end.
    fn extend(&mut self, count: usize) -> Result<bool> {
        let mut block = std::mem::take(&mut self.block);
        let begin = block.len();
        block.resize(begin + count, 0);
        let read = self.fill(&mut block[begin..]);
        self.block = block;
        let read = read?;
        self.block.truncate(begin + read);
        Ok(read == count)
    }

    /// How the records are to be read, as far as is known by now.
    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Why the capture ends before the file does.
    pub(crate) fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    /// The next record with a frame of the network; `None` at the end, or where the file is damaged.
    pub(crate) fn next(&mut self) -> Result<Option<Record<'_>>> {
        if self.damage.is_some() {
            return Ok(None);
        }
        match self.layout {
            Layout::Pcap { .. } => self.next_pcap(),
            Layout::PcapNg(_) => self.next_pcapng(),
        }
    }

    fn ends(&mut self, why: &str) -> Result<Option<Record<'_>>> {
        self.damage = Some(format!("{why} at byte {}", self.offset));
        Ok(None)
    }

    fn next_pcap(&mut self) -> Result<Option<Record<'_>>> {
        let Layout::Pcap {
            is_big,
            nanos_per_tick,
            link,
        } = self.layout
        else {
            return Ok(None);
        };
        self.block.clear();
        if !self.extend(16)? {
            return if self.block.is_empty() {
                Ok(None)
            } else {
                self.ends("ends within a record")
            };
        }
        let length = self.u32_at(8, is_big) as usize;
        if length > MAX_RECORD {
            return self.ends(&format!("has a record of {length} bytes"));
        }
        if !self.extend(length)? {
            return self.ends("ends within a record");
        }
        let offset = self.offset;
        self.offset += 16 + length as u64;
        let parse = if is_big { parse_pcap_frame_be } else { parse_pcap_frame };
        let Ok((_, frame)) = parse(&self.block) else {
            self.damage = Some(format!("has no record at byte {offset}"));
            return Ok(None);
        };
        let fraction_ns = i64::from(frame.ts_usec) * nanos_per_tick;
        Ok(Some(Record {
            offset,
            received_ns: i64::from(frame.ts_sec) * 1_000_000_000 + fraction_ns,
            link,
            frame: frame.data,
        }))
    }

    fn next_pcapng(&mut self) -> Result<Option<Record<'_>>> {
        loop {
            // The first four bytes of the first block are read already.
            let begun = std::mem::take(&mut self.begun);
            self.block.truncate(begun);
            if !self.extend(12 - begun)? {
                return if self.block.is_empty() {
                    Ok(None)
                } else {
                    self.ends("ends within a block")
                };
            }
            let is_section = self.block.starts_with(&PCAPNG);
            let is_big = match &self.layout {
                _ if is_section => self.block[8..12] == [0x1A, 0x2B, 0x3C, 0x4D],
                Layout::PcapNg(sections) => {
                    let offset = self.offset;
                    let section = sections.iter().rev().find(|section| section.begin <= offset);
                    let Some(section) = section else {
                        return self.ends("has a block before its section's header");
                    };
                    section.is_big
                }
                Layout::Pcap { .. } => return Ok(None),
            };
            let length = self.u32_at(4, is_big) as usize;
            if !(12..=MAX_RECORD).contains(&length) || !length.is_multiple_of(4) {
                return self.ends(&format!("has a block of {length} bytes"));
            }
            if !self.extend(length - 12)? {
                return self.ends("ends within a block");
            }
            let offset = self.offset;
            self.offset += length as u64;
            // Borrowed only where it is handed out.
            if let Some((received_ns, link, frame)) = self.packet(offset, is_big, is_section) {
                return Ok(Some(Record {
                    offset,
                    received_ns,
                    link,
                    frame: &self.block[frame],
                }));
            }
            if self.damage.is_some() {
                return Ok(None);
            }
        }
    }

    /// Takes the block; where it is a packet: time, kind of link, and where in the block it is.
    fn packet(&mut self, offset: u64, is_big: bool, is_section: bool) -> Option<(i64, i32, std::ops::Range<usize>)> {
        let Layout::PcapNg(sections) = &mut self.layout else {
            return None;
        };
        let parse = if is_big { parse_block_be } else { parse_block_le };
        let Ok((_, block)) = parse(&self.block) else {
            self.damage = Some(format!("has a block that cannot be read at byte {offset}"));
            return None;
        };
        if is_section {
            if sections.iter().all(|section| section.begin != offset) {
                let interfaces: usize = sections.iter().map(|section| section.interfaces.len() + 1).sum();
                if interfaces >= MAX_INTERFACES {
                    self.damage = Some(format!("has too many sections at byte {offset}"));
                    return None;
                }
                sections.push(Section {
                    begin: offset,
                    is_big,
                    interfaces: Vec::new(),
                });
            }
            return None;
        }
        let section = sections.iter_mut().rev().find(|section| section.begin <= offset)?;
        let place = |part: &[u8]| {
            let begin = part.as_ptr() as usize - self.block.as_ptr() as usize;
            begin..begin + part.len()
        };
        match block {
            Block::InterfaceDescription(block) => {
                if section.interfaces.len() < MAX_INTERFACES {
                    let ticks_per_sec = match block.if_tsresol {
                        exponent if exponent & 0x80 != 0 => 1_u64.checked_shl(u32::from(exponent & 0x7F)),
                        exponent => 10_u64.checked_pow(u32::from(exponent)),
                    };
                    section.interfaces.push(Interface {
                        link: block.linktype.0,
                        ticks_per_sec: ticks_per_sec.unwrap_or(1_000_000),
                        offset_secs: block.if_tsoffset,
                    });
                }
                None
            }
            Block::EnhancedPacket(block) => {
                let interface = section.interfaces.get(block.if_id as usize)?;
                let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
                let ns = i128::from(ticks) * 1_000_000_000 / i128::from(interface.ticks_per_sec.max(1))
                    + i128::from(interface.offset_secs) * 1_000_000_000;
                let received_ns = i64::try_from(ns).unwrap_or(i64::MAX);
                Some((received_ns, interface.link, place(block.packet_data())))
            }
            // Without a time.
            Block::SimplePacket(block) => {
                let interface = section.interfaces.first()?;
                Some((0, interface.link, place(block.packet_data())))
            }
            _ => None,
        }
    }

    fn u32_at(&self, at: usize, is_big: bool) -> u32 {
        let bytes = self.block.get(at..at + 4).and_then(|bytes| bytes.try_into().ok());
        let bytes = bytes.unwrap_or_default();
        if is_big {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        }
    }
}
