//! Saved maps: blocks in groups, each compressed and with a checksum. `docs/map-format.md` describes every byte.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

use lz4_flex::block::{compress_into, decompress_into, get_maximum_output_size};
use tsdfuse::glam::IVec3;
use tsdfuse::index::{BLOCK_VOXELS, BlockIndex};
use tsdfuse::map::{Block, MapConfig, Voxel, VoxelMap, WEIGHT_SCALE};

use crate::error::{Error, Result};

const MAGIC: [u8; 8] = *b"TSDFMAP\n";
const VERSION: u32 = 1;
/// Magic, version, weight scale, voxel size, truncation, largest weight, number of blocks; then the checksum of these.
const HEADER: usize = 44;
/// Blocks in a group; the last one may hold fewer.
const GROUP: usize = 256;
/// Three coordinates, then two sums for each voxel.
const BLOCK: usize = 12 + 8 * BLOCK_VOXELS;

/// Whether a file begins as a saved map does.
pub fn recognises(path: impl AsRef<Path>) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == MAGIC
}

/// Saves a map to a file, which appears when it is complete. Equal maps give equal bytes.
///
/// # Errors
/// Names the file and what the system says.
///
/// # Examples
/// ```
/// use tsdfuse::{MapConfig, VoxelMap};
/// # let dir = tempfile::tempdir().unwrap();
/// let path = dir.path().join("street.tsdf");
/// let map = VoxelMap::new(MapConfig::default()).unwrap();
/// tsdfuse_io::map_file::write(&path, &map)?;
/// assert_eq!(tsdfuse_io::map_file::read(&path)?, map);
/// # Ok::<(), tsdfuse_io::Error>(())
/// ```
pub fn write(path: impl AsRef<Path>, map: &VoxelMap) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, map))
}

/// Writes a map; beside it there is never more than one group of blocks in memory.
///
/// # Errors
/// What the system says.
pub fn write_to(mut out: impl Write, map: &VoxelMap) -> io::Result<()> {
    let indices = map.block_indices();
    let mut header = Vec::with_capacity(HEADER + 4);
    header.extend(MAGIC);
    header.extend(VERSION.to_le_bytes());
    header.extend(WEIGHT_SCALE.to_le_bytes());
    header.extend(map.config().voxel_size_m.to_le_bytes());
    header.extend(map.config().truncation_m.to_le_bytes());
    header.extend(map.config().max_weight.to_le_bytes());
    header.extend((indices.len() as u64).to_le_bytes());
    header.extend(crc32fast::hash(&header).to_le_bytes());
    out.write_all(&header)?;

    let mut plain = Vec::with_capacity(GROUP * BLOCK);
    let mut packed = vec![0; get_maximum_output_size(GROUP * BLOCK)];
    for group in indices.chunks(GROUP) {
        plain.clear();
        for (index, block) in group.iter().filter_map(|&i| Some((i, map.block(i)?))) {
            index.0.to_array().iter().for_each(|c| plain.extend(c.to_le_bytes()));
            for voxel in &block.voxels {
                plain.extend(voxel.weight_sum.to_le_bytes());
                plain.extend(voxel.distance_sum.to_le_bytes());
            }
        }
        let length = compress_into(&plain, &mut packed).map_err(io::Error::other)?;
        let packed = packed.get(..length).unwrap_or_default();
        let length = (length as u32).to_le_bytes();
        out.write_all(&length)?;
        out.write_all(&checksum(length, packed).to_le_bytes())?;
        out.write_all(packed)?;
    }
    Ok(())
}

/// Reads a saved map.
///
/// # Errors
/// Names the file and, where its bytes are not as they were written, the group of blocks.
pub fn read(path: impl AsRef<Path>) -> Result<VoxelMap> {
    let path = path.as_ref();
    let file = File::open(path).map_err(Error::io(path))?;
    parse(path, BufReader::with_capacity(1 << 16, file))
}

/// Reads a map from bytes. No more memory is taken than the bytes there can fill: LZ4 makes at most 255 of one.
pub(crate) fn parse(path: &Path, mut bytes: impl Read) -> Result<VoxelMap> {
    let (mut map, count) = header(&mut bytes).map_err(|e| e.at(path, "its header"))?;
    let groups = count.div_ceil(GROUP as u64);
    let mut buffers = Buffers::default();
    let mut last = None;
    for group in 0..groups {
        let blocks = (count - group * GROUP as u64).min(GROUP as u64) as usize;
        let part = || format!("group {} of {groups} ({blocks} of {count} blocks)", group + 1);
        let plain = buffers.unpack(&mut bytes, blocks).map_err(|e| e.at(path, &part()))?;
        for bytes in plain.chunks_exact(BLOCK) {
            insert(&mut map, &mut last, bytes).map_err(|e| e.at(path, &part()))?;
        }
    }
    match bytes.read(&mut [0]).map_err(Error::io(path))? {
        0 => Ok(map),
        _ => Err(Error::format(path, format!("bytes follow the last of {count} blocks"))),
    }
}

/// Why a part of the file cannot be read.
enum Wrong {
    System(io::Error),
    Reason(String),
}

impl Wrong {
    fn at(self, path: &Path, part: &str) -> Error {
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

fn wrong<T>(reason: impl Into<String>) -> Result<T, Wrong> {
    Err(Wrong::Reason(reason.into()))
}

const CHANGED: &str = "the checksum is another: bytes were changed or lost";

/// An empty map, and the number of blocks that are to follow.
fn header(bytes: &mut impl Read) -> Result<(VoxelMap, u64), Wrong> {
    let header: [u8; HEADER] = array(bytes)?;
    let mut fields = header.as_slice();
    if array(&mut fields)? != MAGIC {
        return wrong("this is no map saved by tsdfuse");
    }
    let version = u32::from_le_bytes(array(&mut fields)?);
    if version != VERSION {
        return wrong(format!("it has version {version}, read is version {VERSION}"));
    }
    if u32::from_le_bytes(array(bytes)?) != crc32fast::hash(&header) {
        return wrong(CHANGED);
    }
    let scale = u32::from_le_bytes(array(&mut fields)?);
    if scale != WEIGHT_SCALE {
        return wrong(format!("a weight of 1 is {scale}, not {WEIGHT_SCALE}"));
    }
    let config = MapConfig {
        voxel_size_m: f64::from_le_bytes(array(&mut fields)?),
        truncation_m: f64::from_le_bytes(array(&mut fields)?),
        max_weight: f32::from_le_bytes(array(&mut fields)?),
    };
    let count = u64::from_le_bytes(array(&mut fields)?);
    VoxelMap::new(config).map_or_else(|e| wrong(e.to_string()), |map| Ok((map, count)))
}

/// One group as it lies in the file, and unpacked.
#[derive(Default)]
struct Buffers {
    packed: Vec<u8>,
    plain: Vec<u8>,
}

impl Buffers {
    /// Reads a group and unpacks its blocks.
    fn unpack(&mut self, bytes: &mut impl Read, blocks: usize) -> Result<&[u8], Wrong> {
        let length: [u8; 4] = array(bytes)?;
        let expected = u32::from_le_bytes(array(bytes)?);
        let size = u32::from_le_bytes(length) as usize;
        if size > get_maximum_output_size(blocks * BLOCK) {
            return wrong(format!("{size} bytes are more than its blocks can take"));
        }
        self.packed.resize(size, 0);
        bytes.read_exact(&mut self.packed)?;
        if checksum(length, &self.packed) != expected {
            return wrong(CHANGED);
        }
        self.plain.resize(blocks * BLOCK, 0);
        match decompress_into(&self.packed, &mut self.plain) {
            Ok(n) if n == self.plain.len() => Ok(&self.plain),
            Ok(n) => wrong(format!("{n} bytes instead of {}", self.plain.len())),
            Err(e) => wrong(e.to_string()),
        }
    }
}

/// The checksum of a group: of its length and its compressed bytes.
fn checksum(length: [u8; 4], packed: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&length);
    hasher.update(packed);
    hasher.finalize()
}

/// Puts a block into the map, which must come after the `last` one.
fn insert(map: &mut VoxelMap, last: &mut Option<BlockIndex>, mut bytes: &[u8]) -> Result<(), Wrong> {
    let mut coordinate = || array(&mut bytes).map(i32::from_le_bytes);
    let index = BlockIndex(IVec3::new(coordinate()?, coordinate()?, coordinate()?));
    if last.is_some_and(|last| last >= index) {
        return wrong(format!("block {:?} is not in order", index.0.to_array()));
    }
    *last = Some(index);
    let mut block = Block {
        voxels: [Voxel::default(); BLOCK_VOXELS],
    };
    let (sums, _) = bytes.as_chunks::<4>();
    let (sums, _) = sums.as_chunks::<2>();
    for (voxel, &[weight, distance]) in block.voxels.iter_mut().zip(sums) {
        *voxel = Voxel {
            weight_sum: u32::from_le_bytes(weight),
            distance_sum: i32::from_le_bytes(distance),
        };
    }
    map.insert_block(index, block).or_else(|e| wrong(e.to_string()))
}

fn array<const N: usize>(bytes: &mut impl Read) -> io::Result<[u8; N]> {
    let mut array = [0; N];
    bytes.read_exact(&mut array)?;
    Ok(array)
}

#[cfg(test)]
mod tests;
