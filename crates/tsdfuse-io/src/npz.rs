//! NumPy's `.npz`: arrays for `numpy.load`, and the observed voxels of a map as such.
//!
//! What [`write()`] writes of a map:
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
    let distance_m = |voxel: Voxel| voxel.distance().unwrap_or_default() * truncation_m;
    let mut arrays = Arrays::new(out);
    arrays.add(
        "voxels",
        &[count, 3],
        voxels(map).flat_map(|(place, _)| place.to_array()),
    )?;
    arrays.add("distances_m", &[count], voxels(map).map(|(_, voxel)| distance_m(voxel)))?;
    arrays.add("weights", &[count], voxels(map).map(|(_, voxel)| voxel.weight()))?;
    arrays.add("voxel_size_m", &[], [config.voxel_size_m])?;
    arrays.add("truncation_m", &[], [config.truncation_m])?;
    arrays.finish()
}

fn voxels(map: &VoxelMap) -> impl Iterator<Item = (IVec3, Voxel)> {
    let blocks = map.regions().into_iter().flat_map(|region| map.blocks_of(region));
    blocks.flat_map(|(index, block)| {
        let observed = block
            .voxels
            .iter()
            .copied()
            .enumerate()
            .filter(|(_, v)| v.weight_sum > 0);
        observed.map(move |(number, voxel)| (voxel_at(index, number), voxel))
    })
}

/// A number that arrays are made of.
pub trait Number: Copy {
    /// NumPy's name of the type.
    const KIND: &'static str;

    /// Writes it, little-endian.
    ///
    /// # Errors
    /// What the system says.
    fn write_to(self, out: &mut impl Write) -> io::Result<()>;
}

macro_rules! numbers {
    ($($number:ty: $kind:literal),*) => {$(
        impl Number for $number {
            const KIND: &'static str = $kind;

            fn write_to(self, out: &mut impl Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }
        }
    )*};
}

numbers!(u8: "|u1", i32: "<i4", f32: "<f4", f64: "<f8");

/// A file of arrays in the making.
#[derive(Debug)]
pub struct Arrays<W: Write>(ZipWriter<StreamWriter<W>>);

impl<W: Write> Arrays<W> {
    /// Without arrays so far.
    pub fn new(out: W) -> Self {
        Self(ZipWriter::new_stream(out))
    }

    /// Adds an array in C order; without a shape, it is a single number.
    ///
    /// # Errors
    /// What the system says; `InvalidInput` if there are more or fewer values than the shape says.
    pub fn add<T: Number>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        let wanted: usize = shape.iter().product();
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::DEFAULT)
            .large_file((wanted * size_of::<T>()) as u64 > u64::from(u32::MAX) - (1 << 16));
        self.0.start_file(format!("{name}.npy"), options)?;
        self.0.write_all(&npy_header(T::KIND, shape))?;
        let mut count = 0;
        for value in values {
            value.write_to(&mut self.0)?;
            count += 1;
        }
        if count == wanted {
            return Ok(());
        }
        let told = format!("{name}: {count} values for an array of {wanted}");
        Err(io::Error::new(io::ErrorKind::InvalidInput, told))
    }

    /// Writes the end.
    ///
    /// # Errors
    /// What the system says.
    pub fn finish(self) -> io::Result<()> {
        self.0.finish()?;
        Ok(())
    }
}

/// What stands before the numbers of an array (NumPy's format 1.0), 64 bytes or a multiple.
fn npy_header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let shape: String = match shape {
        [one] => format!("({one},)"),
        all => format!("({})", all.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    };
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

    #[test]
    fn arrays_are_as_long_as_their_shape_says() {
        let add = |count: u8| Arrays::new(Vec::new()).add("a", &[2, 3], 0..count);
        assert!(add(6).is_ok());
        assert_eq!(add(5).unwrap_err().to_string(), "a: 5 values for an array of 6");
        assert!(add(7).is_err());
    }
}
