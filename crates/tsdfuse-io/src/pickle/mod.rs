//! Pickled pandas DataFrames, read without executing anything.
//!
//! A pickle is a program for a stack machine. [`machine`] runs it, but where Python would call a function it only notes
//! down "this class, these arguments, this state" in a [`graph`]; classes that a DataFrame does not need are refused by
//! name. [`frame`] then finds the columns in that graph, in any of the layouts pandas has used (0.25 to 3.0), and [`array`]
//! reads numbers from the bytes where they lie.
//!
//! Every operation takes at least one byte of input and makes at most one value; their number is bounded, as is the
//! size to which a compressed file may grow.

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

/// A scan has some 10 MB. More than this is no scan.
const MAX_BYTES: u64 = 1 << 30;

/// The bytes of a pickle, decompressed if it is a gzip file.
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
