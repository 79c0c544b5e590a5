//! The bytes of a store.
//!
//! ```text
//!   page 0   header                 4 KiB each, both the same but while a commit is being written
//!   page 1   header, second copy
//!   page 2…  regions, and the index of the last commit (twice), each on pages of its own
//! ```
//!
//! The headers name the index; the index names the regions, and holds what the caller wants to find again. All of them
//! end with, or begin with, a checksum, and begin with a mark, so that they can be found even if what names them is
//! lost ([`crate::Salvage`]). Numbers are little-endian.

use std::ops::{AddAssign, Range};

use tsdfuse::MapConfig;
use tsdfuse::glam::IVec3;
use tsdfuse::index::{BLOCK_VOXELS, RegionIndex};

/// Everything begins on a page, so that writing one thing never touches the bytes of another, not even if the power
/// fails.
pub(crate) const PAGE: u64 = 4096;

/// How a header begins.
pub(crate) const MAGIC: [u8; 8] = *b"TSDFSTO\n";
const VERSION: u32 = 1;
/// How an index begins.
pub(crate) const INDEX_MARK: [u8; 8] = *b"TSDFIDX\n";
/// How a region begins.
pub(crate) const REGION_MARK: [u8; 8] = *b"TSDFREG\n";

/// Mark, sequence, three coordinates, blocks, observed voxels, length of what follows; the checksum of these and what
/// follows.
pub(crate) const REGION_HEADER: usize = 40 + 4;
/// Blocks in a region.
const REGION_BLOCKS: u64 = 512;
/// No region takes more: all blocks, not compressed.
const MAX_REGION: u32 = 3 << 20;
/// No map has regions farther out.
const MAX_COORDINATE: u32 = 1 << 25;
/// Coordinates, blocks, observed voxels, offset, length.
const ROW: usize = 12 + 8 + 8 + 4;
/// Mark, sequence, configuration and integrations, numbers of regions and of the checkpoint's bytes.
pub(crate) const INDEX_HEADER: usize = 16 + STATE + 16;
/// Voxel size, truncation, largest weight, integrations.
const STATE: usize = 24;
/// Magic, version, sequence, configuration and integrations, the index's length and offsets; their checksum.
pub(crate) const HEADER: usize = 12 + 8 + STATE + 24 + 4;

/// How much a region, or a map, holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Blocks.
    pub blocks: u64,
    /// Voxels that were observed.
    pub observed_voxels: u64,
}

impl AddAssign for Sizes {
    fn add_assign(&mut self, other: Self) {
        self.blocks += other.blocks;
        self.observed_voxels += other.observed_voxels;
    }
}

/// Consecutive bytes of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Extent {
    pub(crate) offset: u64,
    pub(crate) length: u64,
}

impl Extent {
    /// The pages that it lies on.
    pub(crate) fn pages(self) -> Range<u64> {
        self.offset / PAGE..self.offset.saturating_add(self.length).div_ceil(PAGE)
    }
}

/// A region's blocks as they are stored.
#[derive(Debug)]
pub(crate) struct Packed {
    pub(crate) index: RegionIndex,
    pub(crate) sizes: Sizes,
    pub(crate) bytes: Vec<u8>,
}

/// What is known of the map as a whole.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) config: MapConfig,
    pub(crate) integrations: u32,
    pub(crate) checkpoint: Vec<u8>,
}

/// Where the index is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    /// The number of the commit.
    pub(crate) sequence: u64,
    pub(crate) config: MapConfig,
    pub(crate) integrations: u32,
    /// Both copies of the index.
    pub(crate) index: [Extent; 2],
}

/// A commit: all of the map but the voxels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Index {
    pub(crate) sequence: u64,
    pub(crate) state: State,
    /// Sorted.
    pub(crate) regions: Vec<Row>,
}

/// A region in the index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Row {
    pub(crate) index: RegionIndex,
    pub(crate) sizes: Sizes,
    pub(crate) extent: Extent,
}

/// What a region begins with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RegionHeader {
    /// The number of the commit that it belongs to.
    pub(crate) sequence: u64,
    pub(crate) index: RegionIndex,
    pub(crate) sizes: Sizes,
    /// Bytes that follow.
    pub(crate) length: u32,
    checksum: u32,
}

impl Header {
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        put_state(&mut bytes, &self.config, self.integrations);
        let [a, b] = self.index;
        for field in [a.length, a.offset, b.offset] {
            bytes.extend(field.to_le_bytes());
        }
        with_checksum(bytes)
    }

    /// # Errors
    /// What is wrong with it.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut fields = Fields(bytes);
        if fields.array()? != MAGIC {
            return Err("this is no store of tsdfuse".to_owned());
        }
        let version = fields.u32()?;
        if version != VERSION {
            return Err(format!("it has version {version}, read is version {VERSION}"));
        }
        check(bytes, HEADER)?;
        let sequence = fields.sequence()?;
        let (config, integrations) = fields.state()?;
        let length = fields.u64()?;
        let mut extent = || fields.u64().map(|offset| Extent { offset, length });
        Ok(Self {
            sequence,
            config,
            integrations,
            index: [extent()?, extent()?],
        })
    }
}

impl Index {
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let Self {
            sequence,
            state,
            regions,
        } = self;
        let mut bytes = INDEX_MARK.to_vec();
        bytes.extend(sequence.to_le_bytes());
        put_state(&mut bytes, &state.config, state.integrations);
        bytes.extend((regions.len() as u64).to_le_bytes());
        bytes.extend((state.checkpoint.len() as u64).to_le_bytes());
        for row in regions {
            put_key(&mut bytes, row.index, row.sizes);
            bytes.extend(row.extent.offset.to_le_bytes());
            bytes.extend((row.extent.length as u32).to_le_bytes());
        }
        bytes.extend(&state.checkpoint);
        with_checksum(bytes)
    }

    /// How many bytes an index has that begins with these.
    pub(crate) fn length(start: &[u8]) -> Result<u64, String> {
        let mut fields = Fields(start.get(INDEX_HEADER - 16..).unwrap_or_default());
        let rows = fields.u64()?.checked_mul(ROW as u64);
        let length = rows.and_then(|rows| rows.checked_add(INDEX_HEADER as u64 + 4));
        let length = length.zip(Some(fields.u64()?));
        let length = length.and_then(|(length, checkpoint)| length.checked_add(checkpoint));
        length.ok_or_else(|| "its length is impossible".to_owned())
    }

    /// # Errors
    /// What is wrong with it.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        if Self::length(bytes)? != bytes.len() as u64 {
            return Err("its length is another".to_owned());
        }
        check(bytes, bytes.len())?;
        let mut fields = Fields(bytes);
        if fields.array()? != INDEX_MARK {
            return Err("no index begins there".to_owned());
        }
        let sequence = fields.sequence()?;
        let (config, integrations) = fields.state()?;
        let (count, checkpoint) = (fields.u64()?, fields.u64()?);
        let regions = (0..count).map(|_| fields.row()).collect::<Result<_, _>>()?;
        let checkpoint = fields.bytes(checkpoint as usize)?.to_owned();
        Ok(Self {
            sequence,
            state: State {
                config,
                integrations,
                checkpoint,
            },
            regions,
        })
    }
}

impl RegionHeader {
    /// A region as it is written.
    pub(crate) fn record(sequence: u64, packed: &Packed) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(REGION_HEADER + packed.bytes.len());
        bytes.extend(REGION_MARK);
        bytes.extend(sequence.to_le_bytes());
        put_key(&mut bytes, packed.index, packed.sizes);
        bytes.extend((packed.bytes.len() as u32).to_le_bytes());
        let checksum = crc32(&[&bytes, &packed.bytes]);
        bytes.extend(checksum.to_le_bytes());
        bytes.extend(&packed.bytes);
        bytes
    }

    /// # Errors
    /// What is wrong with it; its checksum is not checked yet.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut fields = Fields(bytes);
        if fields.array()? != REGION_MARK {
            return Err("it does not begin where it should".to_owned());
        }
        let header = Self {
            sequence: fields.sequence()?,
            index: fields.region()?,
            sizes: fields.sizes()?,
            length: fields.u32()?,
            checksum: fields.u32()?,
        };
        if header.length > MAX_REGION {
            return Err("its length is impossible".to_owned());
        }
        Ok(header)
    }

    /// Checks a record that begins with this header; returns the packed blocks.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn packed<'a>(&self, record: &'a [u8]) -> Result<&'a [u8], String> {
        let (header, packed) = record.split_at_checked(REGION_HEADER).ok_or(SHORT)?;
        let is_same =
            packed.len() == self.length as usize && crc32(&[&header[..REGION_HEADER - 4], packed]) == self.checksum;
        is_same.then_some(packed).ok_or_else(|| CHANGED.to_owned())
    }
}

const CHANGED: &str = "the checksum is another: bytes were changed or lost";
const SHORT: &str = "it ends early";

fn crc32(parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.extend(crc32(&[&bytes]).to_le_bytes());
    bytes
}

/// Checks that the first `length` bytes end with the checksum of those before.
fn check(bytes: &[u8], length: usize) -> Result<(), String> {
    let (bytes, checksum) = bytes
        .get(..length)
        .and_then(|all| all.split_last_chunk())
        .ok_or(SHORT)?;
    let is_same = crc32(&[bytes]) == u32::from_le_bytes(*checksum);
    is_same.then_some(()).ok_or_else(|| CHANGED.to_owned())
}

fn put_state(bytes: &mut Vec<u8>, config: &MapConfig, integrations: u32) {
    bytes.extend(config.voxel_size_m.to_le_bytes());
    bytes.extend(config.truncation_m.to_le_bytes());
    bytes.extend(config.max_weight.to_le_bytes());
    bytes.extend(integrations.to_le_bytes());
}

fn put_key(bytes: &mut Vec<u8>, RegionIndex(index): RegionIndex, sizes: Sizes) {
    for field in index.to_array() {
        bytes.extend(field.to_le_bytes());
    }
    // A region has 512 blocks of 512 voxels.
    for field in [sizes.blocks, sizes.observed_voxels] {
        bytes.extend((field as u32).to_le_bytes());
    }
}

/// Reads one field after the other.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (field, rest) = self.0.split_first_chunk().ok_or(SHORT)?;
        self.0 = rest;
        Ok(*field)
    }

    fn bytes(&mut self, length: usize) -> Result<&'a [u8], String> {
        let (field, rest) = self.0.split_at_checked(length).ok_or(SHORT)?;
        self.0 = rest;
        Ok(field)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_le_bytes)
    }

    fn sequence(&mut self) -> Result<u64, String> {
        let sequence = self.u64()?;
        let is_possible = sequence < u64::MAX / 2;
        is_possible
            .then_some(sequence)
            .ok_or_else(|| "its number is impossible".to_owned())
    }

    fn state(&mut self) -> Result<(MapConfig, u32), String> {
        let config = MapConfig {
            voxel_size_m: self.array().map(f64::from_le_bytes)?,
            truncation_m: self.array().map(f64::from_le_bytes)?,
            max_weight: self.array().map(f32::from_le_bytes)?,
        };
        Ok((config, self.u32()?))
    }

    fn region(&mut self) -> Result<RegionIndex, String> {
        let mut field = || self.array().map(i32::from_le_bytes);
        let index = IVec3::new(field()?, field()?, field()?);
        if index.to_array().iter().any(|i| i.unsigned_abs() > MAX_COORDINATE) {
            return Err(format!("region {:?} lies outside of the grid", index.to_array()));
        }
        Ok(RegionIndex(index))
    }

    fn sizes(&mut self) -> Result<Sizes, String> {
        let sizes = Sizes {
            blocks: self.u32()?.into(),
            observed_voxels: self.u32()?.into(),
        };
        let is_possible = sizes.blocks <= REGION_BLOCKS && sizes.observed_voxels <= sizes.blocks * BLOCK_VOXELS as u64;
        is_possible
            .then_some(sizes)
            .ok_or_else(|| "its sizes are impossible".to_owned())
    }

    fn row(&mut self) -> Result<Row, String> {
        Ok(Row {
            index: self.region()?,
            sizes: self.sizes()?,
            extent: Extent {
                offset: self.u64()?,
                length: self.u32()?.into(),
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn index_of(regions: Vec<Row>) -> Index {
        let state = State {
            config: MapConfig::default(),
            integrations: 7,
            checkpoint: b"scan 7".to_vec(),
        };
        Index {
            sequence: 3,
            state,
            regions,
        }
    }

    fn row(x: i32, blocks: u64) -> Row {
        Row {
            index: RegionIndex(IVec3::new(x, -2, 3)),
            sizes: Sizes {
                blocks,
                observed_voxels: blocks,
            },
            extent: Extent {
                offset: 4 * PAGE,
                length: 77,
            },
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let index = index_of(vec![row(1, 2), row(2, 512)]);
        assert_eq!(Index::parse(&index.to_bytes()), Ok(index));
        let header = Header {
            sequence: 9,
            config: MapConfig::default(),
            integrations: 3,
            index: [4, 5].map(|page| Extent {
                offset: page * PAGE,
                length: 100,
            }),
        };
        let bytes = header.to_bytes();
        assert_eq!((bytes.len(), Header::parse(&bytes)), (HEADER, Ok(header)));
    }

    #[test]
    fn what_no_map_has_is_refused_although_the_checksums_are_right() {
        let refused = |regions| Index::parse(&index_of(regions).to_bytes()).unwrap_err();
        assert_eq!(
            refused(vec![row(i32::MAX, 1)]),
            "region [2147483647, -2, 3] lies outside of the grid"
        );
        assert_eq!(
            refused(vec![row(i32::MIN, 1)]),
            "region [-2147483648, -2, 3] lies outside of the grid"
        );
        assert_eq!(refused(vec![row(0, 513)]), "its sizes are impossible");
        let mut late = index_of(Vec::new());
        late.sequence = u64::MAX;
        assert_eq!(Index::parse(&late.to_bytes()).unwrap_err(), "its number is impossible");
        let mut start = index_of(Vec::new()).to_bytes();
        start[INDEX_HEADER - 16..INDEX_HEADER].fill(0xff);
        assert_eq!(Index::parse(&start).unwrap_err(), "its length is impossible");
    }
}
