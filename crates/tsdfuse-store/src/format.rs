//! The file format of stores.
//!
//! ```text
//!   page 0   header                 4 KiB each; they differ only while a commit is being written
//!   page 1   header, second copy
//!   page 2…  regions, and the index of the last commit (twice), each on pages of its own
//! ```
//!
//! A header locates the index; the index locates the regions and contains the caller's checkpoint and the poses of the
//! scans: 64 bytes a scan, against some 160 for the regions that a scan of a drive adds. Each of them has a
//! checksum, and begins with a mark, so that it can be found by a search even if its locator is lost
//! ([`crate::Salvage`]). Numbers are little-endian.

use std::io;
use std::ops::{AddAssign, Range};

use tsdfuse::glam::IVec3;
use tsdfuse::index::{BLOCK_VOXELS, RegionIndex};
use tsdfuse::{MapConfig, VoxelMap};
use tsdfuse_io::map_file::{FusedPose, pack_poses, unpack_poses};

/// Every record begins on a page of its own, so that writing one record cannot harm another, not even if the power
/// fails.
pub(crate) const PAGE: u64 = 4096;

/// The first bytes of a header.
pub(crate) const MAGIC: [u8; 8] = *b"TSDFSTO\n";
/// Version 2 has its blocks as maps of version 3 have them, version 1 no poses, either; both are read.
const VERSION: u32 = 3;
/// The first bytes of an index.
const INDEX_MARK: [u8; 8] = *b"TSDFID2\n";
/// The same in version 1.
const INDEX_MARK_1: [u8; 8] = *b"TSDFIDX\n";
/// The first bytes of a region.
pub(crate) const REGION_MARK: [u8; 8] = *b"TSDFREG\n";

/// Mark, sequence, three coordinates, blocks, observed voxels, length of what follows; the checksum of these and what
/// follows.
pub(crate) const REGION_HEADER: usize = 40 + 4;
/// Blocks in a region.
const REGION_BLOCKS: u64 = 512;
/// Upper limit of a packed region: all blocks, not compressible.
const MAX_REGION: u32 = 3 << 20;
/// Regions of a map have smaller coordinates than this.
const MAX_COORDINATE: u32 = 1 << 25;
/// Coordinates, blocks, observed voxels, offset, length.
const ROW: usize = 12 + 8 + 8 + 4;
/// Mark, sequence, configuration and integrations, numbers of regions, of the checkpoint's bytes and of the poses'.
pub(crate) const INDEX_HEADER: usize = INDEX_HEADER_1 + 8;
/// The same in version 1, without the last number.
const INDEX_HEADER_1: usize = 16 + STATE + 16;
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

/// The map without its voxels, as the caller sees it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) config: MapConfig,
    pub(crate) integrations: u32,
    pub(crate) checkpoint: Vec<u8>,
    /// Of the scans that were fused, in that order.
    pub(crate) poses: Vec<FusedPose>,
}

impl State {
    /// Of a map of which nothing is stored yet.
    pub(crate) fn begun(map: &VoxelMap, checkpoint: &[u8]) -> Self {
        Self {
            config: *map.config(),
            integrations: 0,
            checkpoint: checkpoint.to_owned(),
            poses: Vec::new(),
        }
    }
}

/// The root of the file: locates the index.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    /// The number of the commit.
    pub(crate) sequence: u64,
    pub(crate) config: MapConfig,
    pub(crate) integrations: u32,
    /// Both copies of the index.
    pub(crate) index: [Extent; 2],
}

/// A commit: everything except the voxels, and where these are.
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

/// The beginning of a stored region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RegionHeader {
    /// The number of the commit that it belongs to.
    pub(crate) sequence: u64,
    pub(crate) index: RegionIndex,
    pub(crate) sizes: Sizes,
    /// Number of bytes that follow.
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
        if !(1..=VERSION).contains(&version) {
            return Err(format!("it has version {version}, read are versions up to {VERSION}"));
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
    /// # Errors
    /// What poses cannot be written.
    pub(crate) fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let Self {
            sequence,
            state,
            regions,
        } = self;
        let poses = pack_poses(&state.poses)?;
        let mut bytes = INDEX_MARK.to_vec();
        bytes.extend(sequence.to_le_bytes());
        put_state(&mut bytes, &state.config, state.integrations);
        bytes.extend((regions.len() as u64).to_le_bytes());
        bytes.extend((state.checkpoint.len() as u64).to_le_bytes());
        bytes.extend((poses.len() as u64).to_le_bytes());
        for row in regions {
            put_key(&mut bytes, row.index, row.sizes);
            bytes.extend(row.extent.offset.to_le_bytes());
            bytes.extend((row.extent.length as u32).to_le_bytes());
        }
        bytes.extend(&state.checkpoint);
        bytes.extend(&poses);
        Ok(with_checksum(bytes))
    }

    /// Whether an index begins with these bytes.
    pub(crate) fn begins(start: &[u8]) -> bool {
        start.starts_with(&INDEX_MARK) || start.starts_with(&INDEX_MARK_1)
    }

    /// The length of an index that begins with these bytes.
    pub(crate) fn length(start: &[u8]) -> Result<u64, String> {
        let mut fields = Fields(start.get(INDEX_HEADER_1 - 16..).unwrap_or_default());
        let (rows, checkpoint) = (fields.u64()?, fields.u64()?);
        let (header, poses) = if start.starts_with(&INDEX_MARK) {
            (INDEX_HEADER, fields.u64()?)
        } else {
            (INDEX_HEADER_1, 0)
        };
        let parts = [
            Some(header as u64 + 4),
            rows.checked_mul(ROW as u64),
            Some(checkpoint),
            Some(poses),
        ];
        let length = parts.into_iter().try_fold(0u64, |sum, part| sum.checked_add(part?));
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
        if !Self::begins(bytes) {
            return Err("no index begins there".to_owned());
        }
        let has_poses = fields.array()? == INDEX_MARK;
        let sequence = fields.sequence()?;
        let (config, integrations) = fields.state()?;
        let (count, checkpoint) = (fields.u64()?, fields.u64()?);
        let poses = has_poses.then(|| fields.u64()).transpose()?;
        let regions = (0..count).map(|_| fields.row()).collect::<Result<Vec<_>, _>>()?;
        if !regions.is_sorted_by(|a, b| a.index < b.index) {
            return Err("its regions are not sorted".to_owned());
        }
        let checkpoint = fields.bytes(checkpoint as usize)?.to_owned();
        let poses = poses.map(|length| unpack_poses(fields.bytes(length as usize)?).map_err(|e| e.to_string()));
        Ok(Self {
            sequence,
            state: State {
                config,
                integrations,
                checkpoint,
                poses: poses.transpose()?.unwrap_or_default(),
            },
            regions,
        })
    }
}

impl RegionHeader {
    /// The bytes of a region.
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
    /// What is wrong with it. The checksum is not checked yet.
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

/// The CRC-32 of some parts, one after the other.
pub(crate) fn crc32(parts: &[&[u8]]) -> u32 {
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

/// Reads fields in order.
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
        config.validate().map_err(|e| e.to_string())?;
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
    use tsdfuse::Pose;

    use super::*;

    fn index_of(regions: Vec<Row>) -> Index {
        let state = State {
            config: MapConfig::default(),
            integrations: 7,
            checkpoint: b"scan 7".to_vec(),
            poses: vec![
                FusedPose {
                    time_ns: Some(7),
                    pose: Pose::IDENTITY,
                };
                7
            ],
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
        assert_eq!(Index::parse(&index.to_bytes().unwrap()), Ok(index));
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

    /// The index of version 1.
    fn index_1(index: &Index) -> Vec<u8> {
        let mut bytes = index.to_bytes().unwrap();
        let poses = pack_poses(&index.state.poses).unwrap().len();
        bytes.truncate(bytes.len() - poses - 4);
        bytes.drain(INDEX_HEADER_1..INDEX_HEADER);
        bytes[..8].copy_from_slice(&INDEX_MARK_1);
        with_checksum(bytes)
    }

    #[test]
    fn the_first_version_is_read() {
        let mut index = index_of(vec![row(1, 2), row(2, 512)]);
        let bytes = index_1(&index);
        index.state.poses.clear();
        assert_eq!(Index::parse(&bytes), Ok(index));
    }

    #[test]
    fn what_no_map_has_is_refused_although_the_checksums_are_right() {
        let refused = |regions| Index::parse(&index_of(regions).to_bytes().unwrap()).unwrap_err();
        assert_eq!(
            refused(vec![row(i32::MAX, 1)]),
            "region [2147483647, -2, 3] lies outside of the grid"
        );
        assert_eq!(
            refused(vec![row(i32::MIN, 1)]),
            "region [-2147483648, -2, 3] lies outside of the grid"
        );
        assert_eq!(refused(vec![row(0, 513)]), "its sizes are impossible");
        assert_eq!(refused(vec![row(2, 1), row(2, 1)]), "its regions are not sorted");
        let mut late = index_of(Vec::new());
        late.sequence = u64::MAX;
        assert_eq!(
            Index::parse(&late.to_bytes().unwrap()).unwrap_err(),
            "its number is impossible"
        );
        let mut start = index_of(Vec::new()).to_bytes().unwrap();
        start[INDEX_HEADER - 24..INDEX_HEADER].fill(0xff);
        assert_eq!(Index::parse(&start).unwrap_err(), "its length is impossible");
    }
}
