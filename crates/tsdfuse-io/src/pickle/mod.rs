//! Pickled pandas DataFrames, read without executing anything.
//!
//! A pickle is a program for a stack machine. [`machine`] runs it, but where Python would call a function it only records
//! "this class, these arguments, this state" in a [`graph`]. Classes that a DataFrame does not need are refused by
//! name. [`frame`] then finds the columns in that graph, in any of the layouts pandas has used (0.25 to 3.0), and [`array`]
//! reads the numbers in place.
//!
//! Every operation takes at least one byte of input and makes at most one value. The number of operations is bounded, and so is
//! the size of the decompressed file.

mod array;
mod frame;
mod graph;
mod machine;
#[cfg(test)]
mod tests;

use std::io::Read;
use std::path::Path;

pub(crate) use frame::DataFrame;

use crate::error::{Error, Result};

/// The most bytes that a pickle may have, also after decompression. A PandaSet sweep has some 10 MB; the largest table that
/// [`frame`] accepts fits. A gzip file of one megabyte can decompress to a gigabyte.
const MAX_BYTES: u64 = 1 << 28;

/// Reads a pickle, and decompresses it if it is a gzip file.
pub(crate) fn load(path: &Path) -> Result<Vec<u8>> {
    let file = std::fs::File::open(path).map_err(Error::io(path))?;
    let stored = read_at_most(file, MAX_BYTES, 0).map_err(|reason| Error::format(path, reason))?;
    if !stored.starts_with(&[0x1f, 0x8b]) {
        return Ok(stored);
    }
    let gz = flate2::bufread::MultiGzDecoder::new(stored.as_slice());
    read_at_most(gz, MAX_BYTES, 2 * stored.len()).map_err(|reason| Error::format(path, reason))
}

fn read_at_most(reader: impl Read, max_bytes: u64, expected: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(expected);
    let read = reader.take(max_bytes + 1).read_to_end(&mut bytes);
    match read {
        Err(e) => Err(format!("cannot be read after {} bytes: {e}", bytes.len())),
        Ok(_) if bytes.len() as u64 > max_bytes => {
            Err(format!("grows beyond {max_bytes} bytes: no scan is that large"))
        }
        Ok(_) => Ok(bytes),
    }
}
