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

use std::io::{self, Write};
use std::path::Path;

use tsdfuse::VoxelMap;
use tsdfuse::glam::IVec3;
use tsdfuse::index::voxel_at;
use tsdfuse::map::Voxel;
use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::error::Result;

/// Writes the observed voxels to a file, which appears when it is complete. They are sorted as the blocks of a saved map are.
///
/// # Errors
/// Names the file and what the system says.
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
    let mut archive = Archive(ZipWriter::new_stream(out));
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
    archive.0.finish()?;
    Ok(())
}

fn for_each_voxel(map: &VoxelMap, mut take: impl FnMut(IVec3, Voxel) -> io::Result<()>) -> io::Result<()> {
    for (index, block) in map.regions().into_iter().flat_map(|region| map.blocks_of(region)) {
        for (number, &voxel) in block.voxels.iter().enumerate().filter(|(_, v)| v.weight_sum > 0) {
            take(voxel_at(index, number), voxel)?;
        }
    }
    Ok(())
}

/// An archive in the making.
struct Archive<W: Write>(ZipWriter<StreamWriter<W>>);

impl<W: Write> Archive<W> {
    /// Adds an array of `bytes` bytes.
    fn member(
        &mut self,
        name: &str,
        kind: &str,
        shape: &str,
        bytes: usize,
        write: impl FnOnce(&mut ZipWriter<StreamWriter<W>>) -> io::Result<()>,
    ) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::DEFAULT)
            .large_file(bytes as u64 > u64::from(u32::MAX) - (1 << 16));
        self.0.start_file(format!("{name}.npy"), options)?;
        self.0.write_all(&npy_header(kind, shape))?;
        write(&mut self.0)
    }
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
    use std::io::{Cursor, Read};

    use tsdfuse::MapConfig;
    use tsdfuse::index::BlockIndex;
    use tsdfuse::map::Block;
    use zip::ZipArchive;

    use super::*;

    #[test]
    fn arrays_hold_what_the_map_does() {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let mut block = Block::EMPTY;
        block.voxels[9] = Voxel {
            weight_sum: 65_536,
            distance_sum: -32_768,
        };
        map.insert_block(BlockIndex(IVec3::new(-1, 0, 2)), block).unwrap();
        let mut bytes = Vec::new();
        write_to(&mut bytes, &map).unwrap();
        let mut archive = ZipArchive::new(Cursor::new(bytes)).unwrap();
        let mut seen = Vec::new();
        for i in 0..archive.len() {
            let mut member = archive.by_index(i).unwrap();
            let (name, mut bytes) = (member.name().unwrap().into_owned(), Vec::new());
            member.read_to_end(&mut bytes).unwrap(); // checks the checksum
            assert!(bytes.starts_with(b"\x93NUMPY\x01\x00v\x00{'descr': '<"));
            seen.push((name, bytes[128..].to_vec()));
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
