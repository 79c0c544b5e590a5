//! Recovers from a damaged map every group that is intact.

use std::io::ErrorKind;
use std::path::Path;

use serde::Serialize;
use tsdfuse::{MapConfig, VoxelMap};

use super::format::{END, END_MARK, GROUP_HEADER, HEADER, Header, Wrong, read_end, wrong};
use super::fused::{FusedPose, read_poses};
use super::group::GroupHeader;
use super::layout::Layout;
use super::reader::Reader;
use crate::error::{Error, Result};

/// What was recovered of a saved map.
#[derive(Debug)]
pub struct Repaired {
    /// The blocks of all groups that are intact.
    pub map: VoxelMap,
    /// The poses of its scans; none if the file does not tell them, or not any more.
    pub poses: Vec<FusedPose>,
    /// What could not be recovered.
    pub damage: Damage,
}

/// What is wrong with a saved map.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Damage {
    /// A sentence for each damaged place, in the order of the file.
    pub places: Vec<String>,
    /// How many blocks are lost; `None` if the end of the file is, which tells how many there were.
    pub lost_blocks: Option<u64>,
}

/// Recovers what is intact of a saved map.
///
/// # Errors
/// Names the file if neither its header nor the copy at the end is intact, if its version is 1 and it is damaged (such files have
/// no marks from which to go on), or if there is no memory for its blocks.
pub fn repair(path: impl AsRef<Path>) -> Result<Repaired> {
    let path = path.as_ref();
    repair_bytes(path, &std::fs::read(path).map_err(Error::io(path))?)
}

/// Like [`repair`], but of bytes; `path` is for messages.
///
/// # Errors
/// As [`repair`].
pub fn repair_bytes(path: &Path, bytes: &[u8]) -> Result<Repaired> {
    into(path, bytes, |config| {
        VoxelMap::new(*config).map_err(|e| Error::format(path, e.to_string()))
    })
}

/// Like [`repair_bytes`], into the map that `new` makes.
pub(super) fn into(path: &Path, bytes: &[u8], new: impl Fn(&MapConfig) -> Result<VoxelMap>) -> Result<Repaired> {
    let mut damage = Damage::default();
    let end = last_end(bytes);
    let header = match (Header::read(&mut &bytes[..]), &end) {
        (Ok(header), _) if header.version == 1 => {
            let map = Reader::new(path, bytes)?.map()?;
            damage.lost_blocks = Some(0);
            let poses = Vec::new();
            return Ok(Repaired { map, poses, damage });
        }
        (Ok(header), _) => header,
        (Err(wrong), Some((header, ..))) => {
            damage
                .places
                .push(format!("{}; its copy is used", reason(wrong, "the header")));
            *header
        }
        (Err(wrong), None) => return Err(wrong.at(path, "its header")),
    };
    let mut map = new(&header.config)?;
    map.set_integrations(header.integrations);

    let (mut at, mut expected) = (HEADER + 4, 0);
    let stop = end.map_or(bytes.len(), |(.., at)| at);
    let next_group = |from| {
        find(bytes, from, |mark| Layout::of(mark).is_some())
            .filter(|&next| next < stop)
            .unwrap_or(stop)
    };
    let mut poses = Vec::new();
    if header.has_poses() {
        let mut rest = bytes.get(at..).unwrap_or_default();
        match read_poses(&mut rest) {
            Ok(read) => (poses, at) = (read, bytes.len() - rest.len()),
            Err(wrong) => {
                let next = next_group(at);
                let what = reason(wrong, &format!("bytes {at} to {}", next.saturating_sub(1)));
                damage.places.push(format!("{what}; the trajectory is lost"));
                at = next;
            }
        }
    }
    while at < stop {
        match group(bytes, at, &mut map) {
            Ok((number, next)) => {
                if number != expected {
                    damage.places.push(missing(expected, number));
                }
                (at, expected) = (next, number.saturating_add(1));
            }
            Err(Wrong::System(e)) if e.kind() == ErrorKind::OutOfMemory => return Err(Error::io(path)(e)),
            Err(wrong) => {
                let next = next_group(at + 1);
                let what = reason(wrong, &format!("bytes {at} to {}", next - 1));
                damage.places.push(what);
                at = next;
            }
        }
    }
    match end {
        Some((_, blocks, at)) => {
            let kept = map.block_count() as u64;
            damage.lost_blocks = Some(blocks.saturating_sub(kept));
            if at + END + 4 < bytes.len() {
                damage.places.push("bytes follow the end".to_owned());
            }
        }
        None => damage.places.push("the end is missing".to_owned()),
    }
    Ok(Repaired { map, poses, damage })
}

/// Says which groups are missing, counted from 1 as in all messages.
fn missing(expected: u32, number: u32) -> String {
    let (first, last) = (u64::from(expected) + 1, u64::from(number));
    if first >= last {
        format!("group {first} is lost")
    } else {
        format!("groups {first} to {last} are lost")
    }
}

/// Puts the group that begins at a byte into the map. Returns its number, and where the next one begins.
fn group(bytes: &[u8], at: usize, map: &mut VoxelMap) -> Result<(u32, usize), Wrong> {
    let rest = bytes.get(at..).unwrap_or_default();
    let Some((mark, fields)) = rest.split_first_chunk::<8>() else {
        return wrong("the file ends within them");
    };
    let Some(layout) = Layout::of(mark) else {
        return wrong("no group begins there");
    };
    let header = GroupHeader::read(layout, &mut &*fields)?;
    let start = GROUP_HEADER + 4;
    let Some(packed) = rest.get(start..start + header.length) else {
        return wrong("the file ends within them");
    };
    header.unpack(packed, &mut Vec::new(), |index, block| {
        Ok(map.insert_block(index, block)?)
    })?;
    Ok((header.number, at + start + header.length))
}

/// Finds the last intact end: the copy of the header, the number of blocks, and where the end begins.
fn last_end(bytes: &[u8]) -> Option<(Header, u64, usize)> {
    let mut found = None;
    // First where it should be, otherwise anywhere.
    let mut at = bytes.len().checked_sub(END + 4)?;
    if !bytes[at..].starts_with(&END_MARK) {
        at = 0;
    }
    while let Some(next) = find(bytes, at, |mark| mark == END_MARK) {
        if let Ok((header, blocks)) = read_end(&mut &bytes[next + END_MARK.len()..]) {
            found = Some((header, blocks, next));
        }
        at = next + 1;
    }
    found
}

/// The next place of such a mark.
fn find(bytes: &[u8], from: usize, is_it: impl Fn(&[u8]) -> bool) -> Option<usize> {
    let rest = bytes.get(from..)?;
    rest.windows(END_MARK.len()).position(is_it).map(|at| from + at)
}

fn reason(wrong: Wrong, part: &str) -> String {
    match wrong {
        Wrong::Reason(reason) => format!("{part}: {reason}"),
        Wrong::System(_) => format!("{part}: the file ends within them"),
    }
}
