//! The bytes of a saved map.

use std::io::{self, Read};
use std::path::Path;

use tsdfuse::map::{MapConfig, MapError, WEIGHT_SCALE};

use crate::error::Error;

/// How meshes begin: .ply, .glb and .obj.
const MESHES: [&[u8]; 5] = [b"ply\n", b"ply\r", b"glTF", b"v ", b"# tsdfuse"];

pub(super) const MAGIC: [u8; 8] = *b"TSDFMAP\n";
/// The version that is written.
pub(super) const VERSION: u32 = 4;
/// The last version without the poses of the scans.
pub(super) const WITHOUT_POSES: u32 = 2;
/// Marks the poses of the scans.
pub(super) const POSES_MARK: [u8; 8] = *b"TSDFPOS\n";
/// Marks the end of the groups.
pub(super) const END_MARK: [u8; 8] = *b"TSDFEND\n";
/// Bytes of magic, version, weight scale, voxel size, truncation, largest weight and number of integrations. Their checksum
/// follows.
pub(super) const HEADER: usize = 40;
/// The same in version 1, which has the number of blocks instead of that of integrations.
pub(super) const HEADER_1: usize = 44;
/// Bytes of mark, number, blocks, length of the compressed bytes, and their checksum. The checksum of these follows.
pub(super) const GROUP_HEADER: usize = 24;
/// Bytes of mark, number of poses and their checksum. The checksum of these follows.
pub(super) const POSES_HEADER: usize = 16;
/// Bytes of mark, header and number of blocks. Their checksum follows.
pub(super) const END: usize = 16 + HEADER;
/// Blocks in a group; the last one may hold fewer.
pub(super) const GROUP: usize = 256;

/// Why a part of the file cannot be read.
#[derive(Debug)]
pub(super) enum Wrong {
    System(io::Error),
    Reason(String),
}

impl Wrong {
    pub(super) fn at(self, path: &Path, part: &str) -> Error {
        match self {
            Self::System(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                Error::format(path, format!("the file ends within {part}"))
            }
            Self::System(e) => Error::io(path)(e),
            Self::Reason(reason) => Error::format(path, format!("{part}: {reason}")),
        }
    }
}

impl From<io::Error> for Wrong {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

impl From<MapError> for Wrong {
    fn from(error: MapError) -> Self {
        match error {
            // The file is not to blame.
            MapError::OutOfMemory(e) => Self::System(io::Error::new(io::ErrorKind::OutOfMemory, e)),
            error => Self::Reason(error.to_string()),
        }
    }
}

pub(super) fn wrong<T>(reason: impl Into<String>) -> Result<T, Wrong> {
    Err(Wrong::Reason(reason.into()))
}

pub(super) const CHANGED: &str = "the checksum does not match: bytes were changed or lost";

/// What precedes the groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Header {
    pub(super) version: u32,
    pub(super) config: MapConfig,
    pub(super) integrations: u32,
    /// Only in version 1.
    pub(super) blocks: Option<u64>,
}

impl Header {
    /// Whether the poses of the scans follow it.
    pub(super) fn has_poses(&self) -> bool {
        self.version > WITHOUT_POSES
    }

    /// The bytes of version 2 or later, without their checksum.
    pub(super) fn bytes(version: u32, config: &MapConfig, integrations: u32) -> [u8; HEADER] {
        let mut header = Vec::with_capacity(HEADER);
        header.extend(MAGIC);
        header.extend(version.to_le_bytes());
        header.extend(WEIGHT_SCALE.to_le_bytes());
        header.extend(config.voxel_size_m.to_le_bytes());
        header.extend(config.truncation_m.to_le_bytes());
        header.extend(config.max_weight.to_le_bytes());
        header.extend(integrations.to_le_bytes());
        header.try_into().unwrap_or([0; HEADER]) // they are as many
    }

    /// Reads it with its checksum.
    pub(super) fn read(bytes: &mut impl Read) -> Result<Self, Wrong> {
        let start: [u8; HEADER] = array(bytes)?;
        if start[..8] != MAGIC {
            let is_mesh = MESHES.iter().any(|first| start.starts_with(first));
            return wrong(match is_mesh {
                true => "this is a mesh, not a map; `tsdfuse view` shows it",
                false => "this is no map saved by tsdfuse",
            });
        }
        let version = u32::from_le_bytes(array(&mut &start[8..])?);
        if !(1..=VERSION).contains(&version) {
            return wrong(format!("it has version {version}, read are versions up to {VERSION}"));
        }
        let rest = match version {
            1 => array::<{ HEADER_1 - HEADER }>(bytes)?.to_vec(),
            _ => Vec::new(),
        };
        if u32::from_le_bytes(array(bytes)?) != checksum(&[&start, &rest]) {
            return wrong(CHANGED);
        }
        Self::parse(&[&start[..], &rest].concat())
    }

    /// Reads it without its checksum.
    pub(super) fn parse(mut fields: &[u8]) -> Result<Self, Wrong> {
        let fields = &mut fields;
        let _: [u8; 8] = array(fields)?;
        let version = u32::from_le_bytes(array(fields)?);
        let scale = u32::from_le_bytes(array(fields)?);
        if scale != WEIGHT_SCALE {
            return wrong(format!("a weight of 1 is {scale}, not {WEIGHT_SCALE}"));
        }
        let config = MapConfig {
            voxel_size_m: f64::from_le_bytes(array(fields)?),
            truncation_m: f64::from_le_bytes(array(fields)?),
            max_weight: f32::from_le_bytes(array(fields)?),
        };
        config.validate()?;
        let (integrations, blocks) = match version {
            1 => (0, Some(u64::from_le_bytes(array(fields)?))),
            _ => (u32::from_le_bytes(array(fields)?), None),
        };
        Ok(Self {
            version,
            config,
            integrations,
            blocks,
        })
    }
}

/// The bytes of the end, with their checksum.
pub(super) fn end_bytes(header: &[u8; HEADER], blocks: u64) -> Vec<u8> {
    let mut bytes = END_MARK.to_vec();
    bytes.extend(header);
    bytes.extend(blocks.to_le_bytes());
    bytes.extend(checksum(&[&bytes]).to_le_bytes());
    bytes
}

/// Reads what follows the mark of the end: a copy of the header, and the number of blocks.
pub(super) fn read_end(bytes: &mut impl Read) -> Result<(Header, u64), Wrong> {
    let fields: [u8; END - 8] = array(bytes)?;
    if u32::from_le_bytes(array(bytes)?) != checksum(&[&END_MARK, &fields]) {
        return wrong(CHANGED);
    }
    let (header, mut blocks) = fields.split_at(HEADER);
    Ok((Header::parse(header)?, u64::from_le_bytes(array(&mut blocks)?)))
}

/// The CRC-32 of some parts, one after the other.
pub(super) fn checksum(parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

pub(super) fn array<const N: usize>(bytes: &mut impl Read) -> io::Result<[u8; N]> {
    let mut array = [0; N];
    bytes.read_exact(&mut array)?;
    Ok(array)
}
