//! NumPy's `.npz`: the observed voxels of a map as arrays, for `numpy.load`.
//!
//! | array | type and shape | what |
//! |---|---|---|
//! | `voxels` | i4 (n, 3) | integer coordinates; voxel i has its centre at (i + ½) · `voxel_size_m` |
//! | `distances_m` | f4 (n) | signed distance, positive on the sensor's side, at most `truncation_m` |
//! | `weights` | f4 (n) | W |
//! | `voxel_size_m`, `truncation_m` | f8 () | |
//!
//! The file is a zip archive whose members are not compressed, written from front to back.

use std::io::{self, Error, ErrorKind, Write};
use std::path::Path;

use tsdfuse::VoxelMap;
use tsdfuse::glam::IVec3;
use tsdfuse::index::voxel_at;
use tsdfuse::map::Voxel;

use crate::error::Result;

/// Writes the observed voxels to a file, which appears when it is complete. They are sorted as the blocks of a saved map are.
///
/// # Errors
/// Names the file and what the system says; also for more than 357 million voxels, whose array a plain zip archive cannot hold.
pub fn write(path: impl AsRef<Path>, map: &VoxelMap) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, map))
}

/// As [`write()`], to anything that takes bytes.
///
/// # Errors
/// What the system says.
pub fn write_to(out: impl Write, map: &VoxelMap) -> io::Result<()> {
    let config = *map.config();
    let truncation_m = config.truncation_m as f32;
    let count = map.observed_voxel_count();
    let mut archive = Archive::new(out);
    archive.member("voxels", "<i4", &format!("({count}, 3)"), 12 * count, |out| {
        for_each_voxel(map, |place, _| {
            place
                .to_array()
                .iter()
                .try_for_each(|c| out.write_all(&c.to_le_bytes()))
        })
    })?;
    let shape = format!("({count},)");
    archive.member("distances_m", "<f4", &shape, 4 * count, |out| {
        for_each_voxel(map, |_, voxel| {
            let distance_m = voxel.distance().unwrap_or_default() * truncation_m;
            out.write_all(&distance_m.to_le_bytes())
        })
    })?;
    archive.member("weights", "<f4", &shape, 4 * count, |out| {
        for_each_voxel(map, |_, voxel| out.write_all(&voxel.weight().to_le_bytes()))
    })?;
    for (name, value) in [
        ("voxel_size_m", config.voxel_size_m),
        ("truncation_m", config.truncation_m),
    ] {
        archive.member(name, "<f8", "()", 8, |out| out.write_all(&value.to_le_bytes()))?;
    }
    archive.finish()
}

fn for_each_voxel(map: &VoxelMap, mut take: impl FnMut(IVec3, Voxel) -> io::Result<()>) -> io::Result<()> {
    for (index, block) in map.regions().into_iter().flat_map(|region| map.blocks_of(region)) {
        for (number, &voxel) in block.voxels.iter().enumerate().filter(|(_, v)| v.weight_sum > 0) {
            take(voxel_at(index, number), voxel)?;
        }
    }
    Ok(())
}

/// A zip archive (APPNOTE 6.3.10) in the making.
struct Archive<W> {
    out: W,
    /// Bytes written so far.
    at: u64,
    /// The entries of the list at the end.
    list: Vec<u8>,
    members: u16,
}

/// Zip's words: the beginnings of a member, of an entry of the list, and of its end.
const MEMBER: u32 = 0x0403_4b50;
const ENTRY: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;
const DESCRIPTOR: u32 = 0x0807_4b50;
/// Version 2.0; the length and the checksum follow the bytes; the first of January 1980.
const COMMON: [u16; 5] = [20, 1 << 3, 0, 0, 0x21];

/// Counts and checks what goes by.
struct Checked<'a, W> {
    out: &'a mut W,
    checksum: crc32fast::Hasher,
    count: u64,
}

impl<W: Write> Write for Checked<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.checksum.update(&bytes[..written]);
        self.count += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl<W: Write> Archive<W> {
    fn new(out: W) -> Self {
        Self {
            out,
            at: 0,
            list: Vec::new(),
            members: 0,
        }
    }

    /// Adds an array of `bytes` bytes.
    fn member(
        &mut self,
        name: &str,
        kind: &str,
        shape: &str,
        bytes: usize,
        write: impl FnOnce(&mut Checked<'_, W>) -> io::Result<()>,
    ) -> io::Result<()> {
        if bytes as u64 + self.at > u64::from(u32::MAX) - (1 << 16) {
            return Err(Error::new(
                ErrorKind::InvalidInput,
                "the arrays exceed the 4 GiB of a zip archive: crop the map",
            ));
        }
        let name = format!("{name}.npy");
        let start = self.at as u32;
        let mut header = words([MEMBER], COMMON);
        header.extend(words([0, 0, 0], [name.len() as u16, 0]));
        header.extend(name.bytes());
        self.out.write_all(&header)?;

        let mut checked = Checked {
            out: &mut self.out,
            checksum: crc32fast::Hasher::new(),
            count: 0,
        };
        checked.write_all(&npy_header(kind, shape))?;
        write(&mut checked)?;
        let (count, checksum) = (checked.count as u32, checked.checksum.finalize());
        let descriptor = words([DESCRIPTOR, checksum, count, count], []);
        self.out.write_all(&descriptor)?;
        self.at += header.len() as u64 + u64::from(count) + descriptor.len() as u64;

        self.list.extend(words([ENTRY], [20]));
        self.list.extend(words([], COMMON));
        self.list
            .extend(words([checksum, count, count], [name.len() as u16, 0, 0, 0, 0]));
        self.list.extend(words([0, start], []));
        self.list.extend(name.bytes());
        self.members += 1;
        Ok(())
    }

    fn finish(mut self) -> io::Result<()> {
        self.out.write_all(&self.list)?;
        let mut end = words([END], [0, 0, self.members, self.members]);
        end.extend(words([self.list.len() as u32, self.at as u32], [0]));
        self.out.write_all(&end)
    }
}

/// Words of four bytes, then of two.
fn words<const N: usize, const M: usize>(long: [u32; N], short: [u16; M]) -> Vec<u8> {
    let long = long.into_iter().flat_map(u32::to_le_bytes);
    long.chain(short.into_iter().flat_map(u16::to_le_bytes)).collect()
}

/// What stands before the numbers of an array (NumPy's format 1.0), 64 bytes or a multiple.
fn npy_header(kind: &str, shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    let length = (text.len() + 11).next_multiple_of(64) - 10;
    text.extend(std::iter::repeat_n(' ', length - text.len() - 1));
    text.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend((text.len() as u16).to_le_bytes());
    header.extend(text.bytes());
    header
}

#[cfg(test)]
mod tests {
    use tsdfuse::MapConfig;
    use tsdfuse::index::BlockIndex;
    use tsdfuse::map::Block;

    use super::*;

    #[test]
    fn arrays_lie_where_the_list_says() {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let mut block = Block::EMPTY;
        block.voxels[9] = Voxel {
            weight_sum: 65_536,
            distance_sum: -32_768,
        };
        map.insert_block(BlockIndex(IVec3::new(-1, 0, 2)), block).unwrap();
        let mut bytes = Vec::new();
        write_to(&mut bytes, &map).unwrap();
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let end = bytes.len() - 22;
        assert_eq!(u32_at(end), END as usize);
        let (mut at, mut seen) = (u32_at(end + 16), Vec::new());
        assert_eq!(at + u32_at(end + 12), end);
        while at < end {
            let (checksum, length, start) = (u32_at(at + 16), u32_at(at + 20), u32_at(at + 42));
            let name_length = usize::from(bytes[at + 28]);
            let name = std::str::from_utf8(&bytes[at + 46..at + 46 + name_length]).unwrap();
            let member = &bytes[start + 30 + name_length..][..length];
            assert_eq!(u32_at(start), MEMBER as usize);
            assert_eq!(crc32fast::hash(member) as usize, checksum);
            assert!(member.starts_with(b"\x93NUMPY\x01\x00v\x00{'descr': '<"));
            seen.push((name.to_owned(), member[128..].to_vec()));
            at += 46 + name_length;
        }
        let expected = [
            ("voxels.npy", [-7i32, 1, 16].map(i32::to_le_bytes).concat()),
            ("distances_m.npy", (-0.1f32).to_le_bytes().to_vec()),
            ("weights.npy", 2f32.to_le_bytes().to_vec()),
            ("voxel_size_m.npy", 0.05f64.to_le_bytes().to_vec()),
            ("truncation_m.npy", 0.20f64.to_le_bytes().to_vec()),
        ];
        assert_eq!(seen, expected.map(|(name, bytes)| (name.to_owned(), bytes)));
    }
}
