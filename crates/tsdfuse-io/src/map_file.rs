//! Saved maps: groups of blocks, each compressed, marked and with checksums. `docs/map-format.md` describes every byte.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

use tsdfuse::{MapConfig, VoxelMap};

use crate::error::{Error, Result};

mod format;
mod fused;
mod group;
mod layout;
mod pack;
mod reader;
mod repair;
mod writer;

pub use fused::{FusedPose, pack_poses, unpack_poses};
pub use pack::{pack, unpack};
pub use reader::Reader;
pub use repair::{Damage, Repaired, repair, repair_bytes};
pub use writer::Writer;

/// Whether a file begins as a saved map does.
pub fn recognises(path: impl AsRef<Path>) -> bool {
    let mut start = [0; format::MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == format::MAGIC
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
    write_with_poses(path, map, &[])
}

/// Saves a map with the poses of its scans, in the order in which they were fused; otherwise as [`write()`].
///
/// # Errors
/// As [`write()`].
pub fn write_with_poses(path: impl AsRef<Path>, map: &VoxelMap, poses: &[FusedPose]) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, map, poses))
}

/// Writes a map and the poses of its scans. This takes memory for one group of blocks only.
///
/// # Errors
/// What the system says.
pub fn write_to(out: impl Write, map: &VoxelMap, poses: &[FusedPose]) -> io::Result<()> {
    let mut writer = Writer::with_poses(out, map.config(), map.integrations(), poses)?;
    for region in map.regions() {
        map.blocks_of(region)
            .try_for_each(|(index, block)| writer.block(index, block))?;
    }
    writer.finish().map(drop)
}

/// Reads a saved map.
///
/// # Errors
/// Names the file, and the group of blocks that is not as it was written.
pub fn read(path: impl AsRef<Path>) -> Result<VoxelMap> {
    Reader::open(path)?.map()
}

/// Reads a saved map and the poses of its scans; none where the file does not tell them.
///
/// # Errors
/// As [`read`].
pub fn read_with_poses(path: impl AsRef<Path>) -> Result<(VoxelMap, Vec<FusedPose>)> {
    whole(Reader::open(path)?)
}

/// Reads a map and its poses from bytes.
pub(crate) fn parse(path: &Path, bytes: impl Read) -> Result<(VoxelMap, Vec<FusedPose>)> {
    whole(Reader::new(path, bytes)?)
}

fn whole(mut reader: Reader<impl Read>) -> Result<(VoxelMap, Vec<FusedPose>)> {
    let poses = reader.take_poses();
    Ok((reader.map()?, poses))
}

/// For fuzzing: a file with correct checksums whose groups are made of any bytes. For each group, the first byte says how many blocks
/// it claims, and the next two how many bytes follow.
pub(crate) fn forged(mut bytes: &[u8]) -> Vec<u8> {
    let header = format::Header::bytes(format::WITHOUT_POSES, &MapConfig::default(), 0);
    let mut file = [&header[..], &format::checksum(&[&header]).to_le_bytes()].concat();
    let (mut blocks, mut number) = (0, 0);
    while let [promised, low, high, rest @ ..] = bytes {
        let (packed, rest) = rest.split_at(usize::from(u16::from_le_bytes([*low, *high])).min(rest.len()));
        let layout = [layout::Layout::Planes, layout::Layout::Blocks][number as usize % 2];
        file.extend(group::GroupHeader::bytes(
            layout,
            number,
            usize::from(*promised),
            packed,
        ));
        file.extend(packed);
        (blocks, number, bytes) = (blocks + u64::from(*promised), number + 1, rest);
    }
    file.extend(format::end_bytes(&header, blocks));
    file
}

/// For fuzzing: a file without blocks whose poses are any bytes, with correct checksums.
pub(crate) fn forged_poses(bytes: &[u8]) -> Vec<u8> {
    let header = format::Header::bytes(format::VERSION, &MapConfig::default(), 0);
    let mut file = [&header[..], &format::checksum(&[&header]).to_le_bytes()].concat();
    let mut poses = format::POSES_MARK.to_vec();
    poses.extend((bytes.len() as u32 / 64).to_le_bytes());
    poses.extend(format::checksum(&[&bytes[..bytes.len() / 64 * 64]]).to_le_bytes());
    poses.extend(format::checksum(&[&poses]).to_le_bytes());
    file.extend(poses);
    file.extend(&bytes[..bytes.len() / 64 * 64]);
    file.extend(format::end_bytes(&header, 0));
    file
}

/// For fuzzing: the groups of a [`forged`] file.
pub(crate) fn groups(file: &[u8]) -> &[u8] {
    file.get(format::HEADER + 4..file.len() - (format::END + 4))
        .unwrap_or_default()
}

/// For fuzzing: gives groups the checksums that fit their bytes.
pub fn with_group_checksums(mut groups: &mut [u8]) {
    while let Some((header, rest)) = groups.split_at_mut_checked(format::GROUP_HEADER + 4) {
        let length = header[16..]
            .first_chunk()
            .map_or(0, |length| u32::from_le_bytes(*length));
        let Some((packed, rest)) = rest.split_at_mut_checked(length as usize) else {
            return;
        };
        header[20..24].copy_from_slice(&format::checksum(&[packed]).to_le_bytes());
        let own = format::checksum(&[&header[..format::GROUP_HEADER]]);
        header[format::GROUP_HEADER..].copy_from_slice(&own.to_le_bytes());
        groups = rest;
    }
}

impl Reader<BufReader<File>> {
    /// Opens a saved map and reads its header.
    ///
    /// # Errors
    /// Names the file and what is wrong.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file = File::open(path).map_err(Error::io(path))?;
        Self::new(path, BufReader::with_capacity(1 << 16, file))
    }
}

#[cfg(test)]
mod tests;
