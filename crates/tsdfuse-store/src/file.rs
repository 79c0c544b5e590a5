//! The store's file: the last commit, and the regions written since.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::index::RegionIndex;
use tsdfuse::map::{BlockPool, RegionBlocks};
use tsdfuse_io::map_file::unpack;

use crate::disk::{Disk, sync_folder};
use crate::error::{Result, StoreError};
use crate::format::{Extent, HEADER, Header, Index, MAGIC, PAGE, Packed, RegionHeader, Row, Sizes, State};
use crate::space::Space;

/// An open store. Bytes of the last commit are never overwritten.
#[derive(Debug)]
pub(crate) struct StoreFile {
    path: PathBuf,
    disk: Disk,
    /// The number of the last commit.
    sequence: u64,
    index: [Extent; 2],
    regions: HashMap<RegionIndex, Stored, FxBuildHasher>,
    space: Space,
    /// Extents of the last commit that the next one does not use. They become free with it.
    replaced: Vec<Extent>,
}

/// Where a region is.
#[derive(Clone, Copy, Debug)]
struct Stored {
    row: Row,
    /// Whether it belongs to the last commit.
    is_committed: bool,
}

/// Where the headers are.
pub(crate) const HEADERS: [u64; 2] = [0, PAGE];
/// The first page after them.
const FIRST_PAGE: u64 = 2;

/// Whether a file looks like a store, judged by its first bytes. Stores of earlier versions are recognised, but cannot
/// be opened.
pub fn recognises(path: impl AsRef<Path>) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && (start == MAGIC || is_earlier(&start))
}

/// Earlier versions kept stores in this database.
fn is_earlier(start: &[u8]) -> bool {
    start.starts_with(b"redb")
}

/// Removes a store unless a process has it open. Returns whether it was removed; other files are left alone.
pub fn remove_unused(path: impl AsRef<Path>) -> bool {
    let path = path.as_ref();
    // As long as it is locked here, no other process can open it.
    let locked = recognises(path).then(|| Disk::open_unused(path)).and_then(Result::ok);
    locked.is_some_and(|disk| header(&disk).is_ok() && std::fs::remove_file(path).is_ok())
}

impl StoreFile {
    /// Creates a store. The file appears under its name once the first commit is complete.
    pub(crate) fn create(path: &Path, state: State) -> Result<Self> {
        if path.exists() {
            return Err(StoreError::file(path)(io::Error::other("is there already")));
        }
        Self::replace(path, state)
    }

    /// The same in the place of a store that may be there, and that stays until then.
    pub(crate) fn replace(path: &Path, state: State) -> Result<Self> {
        let wrong = StoreError::file(path);
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
        let make = || {
            let mut store = Self {
                path: path.to_owned(),
                disk: Disk::create(&temporary).map_err(&wrong)?,
                sequence: 0,
                index: [Extent { offset: 0, length: 0 }; 2],
                regions: HashMap::default(),
                space: Space::without(FIRST_PAGE, []).ok_or_else(|| wrong(io::ErrorKind::Other.into()))?,
                replaced: Vec::new(),
            };
            store.commit(state)?;
            std::fs::rename(&temporary, path).map_err(&wrong)?;
            sync_folder(path);
            Ok(store)
        };
        let made = make();
        if made.is_err() {
            // The file may not exist.
            let _ = std::fs::remove_file(&temporary);
        }
        made
    }

    /// Opens a store at its last commit.
    pub(crate) fn open(path: &Path, is_written: bool) -> Result<(Self, State)> {
        let wrong = StoreError::file(path);
        let disk = Disk::open(path, is_written).map_err(&wrong)?;
        let damaged = |reason: String| StoreError::Damaged {
            path: path.to_owned(),
            reason,
        };
        let (header, is_whole) = header(&disk).map_err(damaged)?;
        let index = read_index(&disk, &header).map_err(|reason| damaged(format!("its index: {reason}")))?;
        let extents = index.regions.iter().map(|row| row.extent).chain(header.index);
        let end = extents
            .clone()
            .map(|extent| extent.offset.saturating_add(extent.length))
            .max();
        if end > Some(disk.length().map_err(&wrong)?) {
            return Err(damaged("the file ends early".to_owned()));
        }
        let space =
            Space::without(FIRST_PAGE, extents).ok_or_else(|| damaged("its index contradicts itself".to_owned()))?;
        let stored = |&row: &Row| {
            let is_committed = true;
            (row.index, Stored { row, is_committed })
        };
        let store = Self {
            path: path.to_owned(),
            disk,
            sequence: header.sequence,
            index: header.index,
            regions: index.regions.iter().map(stored).collect(),
            space,
            replaced: Vec::new(),
        };
        if is_written && !is_whole {
            // The next commit overwrites the first copy, so the second one must be valid before that.
            for at in HEADERS {
                store.write_at(at, &header.to_bytes())?;
            }
            store.disk.sync().map_err(&wrong)?;
        }
        Ok((store, index.state))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The regions of the map and how much they hold, in any order.
    pub(crate) fn regions(&self) -> impl Iterator<Item = (RegionIndex, Sizes)> {
        self.regions.values().map(|stored| (stored.row.index, stored.row.sizes))
    }

    /// Writes a region. It counts from the next [`StoreFile::commit`] on.
    pub(crate) fn write(&mut self, packed: &Packed) -> Result<()> {
        let record = RegionHeader::record(self.sequence + 1, packed);
        let extent = self.append(&record)?;
        let stored = Stored {
            row: Row {
                index: packed.index,
                sizes: packed.sizes,
                extent,
            },
            is_committed: false,
        };
        match self.regions.insert(packed.index, stored) {
            Some(before) if before.is_committed => self.replaced.push(before.row.extent),
            Some(before) => self.space.give_back(before.row.extent),
            None => {}
        }
        Ok(())
    }

    /// Reads a region, which must exist.
    pub(crate) fn read(&self, index: RegionIndex, pool: &BlockPool) -> Result<RegionBlocks> {
        let wrong = |reason: String| StoreError::Region {
            path: self.path.clone(),
            region: index,
            reason,
        };
        let stored = self
            .regions
            .get(&index)
            .ok_or_else(|| wrong("is not there".to_owned()))?;
        read_region(&self.disk, &stored.row, pool).map_err(wrong)
    }

    /// Commits everything written so far. Once this returns, it survives a crash; a crash before that leaves the last
    /// commit or this one.
    pub(crate) fn commit(&mut self, state: State) -> Result<()> {
        let path = self.path.clone();
        let wrong = StoreError::file(&path);
        let mut rows: Vec<Row> = self.regions.values().map(|stored| stored.row).collect();
        rows.sort_unstable_by_key(|row| row.index);
        let index = Index {
            sequence: self.sequence + 1,
            state,
            regions: rows,
        };
        let bytes = index.to_bytes().map_err(&wrong)?;
        let header = Header {
            sequence: index.sequence,
            config: index.state.config,
            integrations: index.state.integrations,
            index: [self.append(&bytes)?, self.append(&bytes)?],
        };
        // Everything the header refers to must be on the disk before the header is written.
        self.disk.sync().map_err(&wrong)?;
        self.write_at(HEADERS[0], &header.to_bytes())?;
        self.disk.sync().map_err(&wrong)?;
        // From here on the commit is valid. The second copy is a spare in case the first is damaged.
        self.write_at(HEADERS[1], &header.to_bytes())?;
        let old_index = std::mem::replace(&mut self.index, header.index);
        if self.sequence > 0 {
            self.replaced.extend(old_index);
        }
        self.sequence = header.sequence;
        self.regions.values_mut().for_each(|stored| stored.is_committed = true);
        for extent in std::mem::take(&mut self.replaced) {
            self.space.give_back(extent);
        }
        Ok(())
    }

    /// Writes bytes to free pages.
    fn append(&mut self, bytes: &[u8]) -> Result<Extent> {
        let extent = self.space.take(bytes.len() as u64);
        self.write_at(extent.offset, bytes)?;
        Ok(extent)
    }

    fn write_at(&self, offset: u64, bytes: &[u8]) -> Result<()> {
        self.disk.write(offset, bytes).map_err(StoreError::file(&self.path))
    }
}

/// The header of the last commit, and whether both copies of it are intact.
///
/// # Errors
/// What is wrong with the first copy, if both are damaged.
pub(crate) fn header(disk: &Disk) -> Result<(Header, bool), String> {
    let read = |offset| {
        let length = HEADER as u64;
        let bytes = disk.read(Extent { offset, length });
        bytes.and_then(|bytes| Header::parse(&bytes))
    };
    let mut start = [0; 4];
    let read_start = disk.read_exact(0, &mut start);
    if read_start.is_ok() && is_earlier(&start) {
        return Err("this store was written by an earlier version of tsdfuse; run it again".to_owned());
    }
    match HEADERS.map(read) {
        [Ok(a), Ok(b)] if a == b => Ok((a, true)),
        [Ok(a), Ok(b)] => Ok((if b.sequence > a.sequence { b } else { a }, false)),
        [Ok(header), Err(_)] | [Err(_), Ok(header)] => Ok((header, false)),
        [Err(reason), Err(_)] => Err(format!("its header: {reason}")),
    }
}

/// The index that a header refers to, from whichever copy is intact.
///
/// # Errors
/// What is wrong with the first copy, if both are damaged.
pub(crate) fn read_index(disk: &Disk, header: &Header) -> Result<Index, String> {
    let read = |extent| {
        let index = disk.read(extent).and_then(|bytes| Index::parse(&bytes))?;
        let is_right = index.sequence == header.sequence;
        is_right
            .then_some(index)
            .ok_or_else(|| "it belongs to another commit".to_owned())
    };
    let [first, second] = header.index;
    read(first).or_else(|reason| read(second).map_err(|_| reason))
}

/// Reads a region.
///
/// # Errors
/// What is wrong with its bytes or its blocks.
pub(crate) fn read_region(disk: &Disk, row: &Row, pool: &BlockPool) -> Result<RegionBlocks, String> {
    let record = disk.read(row.extent)?;
    let header = RegionHeader::parse(&record)?;
    if (header.index, header.sizes) != (row.index, row.sizes) {
        return Err("another region is in its place".to_owned());
    }
    let mut blocks = RegionBlocks::new(row.index, pool);
    unpack(header.packed(&record)?, |index, block| blocks.insert(index, &block)).map_err(|e| e.to_string())?;
    let is_whole = blocks.block_count() as u64 == row.sizes.blocks;
    is_whole
        .then_some(blocks)
        .ok_or_else(|| "it has more or fewer blocks than it says".to_owned())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;
    use tsdfuse::MapConfig;
    use tsdfuse::glam::IVec3;

    use super::*;
    use crate::disk::Step;

    /// The bytes of regions.
    type Contents = BTreeMap<i32, Vec<u8>>;

    fn contents(store: &StoreFile) -> Contents {
        let of = |stored: &Stored| {
            let record = store.disk.read(stored.row.extent).unwrap();
            let header = RegionHeader::parse(&record).unwrap();
            assert_eq!(header.index, stored.row.index);
            (header.index.0.x, header.packed(&record).unwrap().to_vec())
        };
        store.regions.values().map(of).collect()
    }

    fn state(number: u8) -> State {
        State {
            config: MapConfig::default(),
            integrations: 0,
            checkpoint: vec![number],
            poses: Vec::new(),
        }
    }

    /// What happens to a store.
    #[derive(Clone, Debug)]
    enum Act {
        Write(i32, usize),
        Commit,
        /// The power fails, with these [`after_failure`], and the store is opened again.
        Fail(Vec<u16>),
    }

    fn fates() -> impl Strategy<Value = Vec<u16>> {
        prop::collection::vec(any::<u16>(), 1..20)
    }

    fn acts() -> impl Strategy<Value = Vec<Act>> {
        let act = prop_oneof![
            6 => (0..6, 1..20_000_usize).prop_map(|(x, length)| Act::Write(x, length)),
            2 => Just(Act::Commit),
            1 => fates().prop_map(Act::Fail),
        ];
        prop::collection::vec(act, 1..60)
    }

    /// What is on the disk if the power fails after some steps: everything up to the last sync, and of the rest, for
    /// each write, nothing, all, or some of it.
    fn after_failure(steps: &[Step], fates: &[u16]) -> Vec<u8> {
        let synced = steps.iter().rposition(|step| matches!(step, Step::Sync)).unwrap_or(0);
        let mut disk = Vec::new();
        for ((number, step), fate) in steps.iter().enumerate().zip(fates.iter().cycle()) {
            let Step::Write(offset, bytes) = step else { continue };
            let written = match fate % 3 {
                _ if number < synced => bytes.len(),
                0 => 0,
                1 => bytes.len(),
                _ => usize::from(*fate) % (bytes.len() + 1),
            };
            let end = *offset as usize + written;
            if disk.len() < end {
                disk.resize(end, 0);
            }
            disk[*offset as usize..end].copy_from_slice(&bytes[..written]);
        }
        disk
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(32) })]

        #[test]
        fn after_a_power_failure_the_last_commit_is_there_all_of_it(
            acts in acts(),
            failures in prop::collection::vec((any::<prop::sample::Index>(), fates()), 20),
        ) {
            let dir = tempfile::tempdir().unwrap();
            let (path, failed) = (dir.path().join("a"), dir.path().join("b"));
            let mut store = StoreFile::create(&path, state(0)).unwrap();
            let mut now = Contents::new();
            // The checkpoint and the contents of each commit, and the step with which it was done.
            let mut steps = store.disk.steps.take();
            let mut commits = vec![(steps.len(), 0, now.clone())];
            let mut first = steps.len();
            for (number, act) in (1..).zip(acts) {
                match act {
                    Act::Write(x, length) => {
                        let bytes = vec![number; length];
                        now.insert(x, bytes.clone());
                        let index = RegionIndex(IVec3::new(x, 0, 0));
                        store.write(&Packed { index, sizes: Sizes::default(), bytes }).unwrap();
                        steps.append(&mut store.disk.steps.take());
                    }
                    Act::Commit => {
                        store.commit(state(number)).unwrap();
                        steps.append(&mut store.disk.steps.take());
                        commits.push((steps.len(), number, now.clone()));
                    }
                    Act::Fail(fates) => {
                        drop(store);
                        let bytes = after_failure(&steps, &fates);
                        std::fs::write(&path, &bytes).unwrap();
                        let (opened, last) = StoreFile::open(&path, true).unwrap();
                        store = opened;
                        prop_assert_eq!(&last.checkpoint, &[commits.last().unwrap().1]);
                        now = commits.last().unwrap().2.clone();
                        steps = vec![Step::Write(0, bytes), Step::Sync];
                        first = steps.len();
                        commits = vec![(first, last.checkpoint[0], now.clone())];
                        steps.append(&mut store.disk.steps.take());
                    }
                }
            }
            prop_assert_eq!(contents(&store), now);
            drop(store);
            for (at, fates) in failures {
                let at = first + at.index(steps.len() - first + 1);
                std::fs::write(&failed, after_failure(&steps[..at], &fates)).unwrap();
                let (opened, found) = StoreFile::open(&failed, true).unwrap();
                // The last one that was done, or the one that was being made.
                let done = commits.iter().rposition(|(after, ..)| *after <= at).unwrap();
                let possible = &commits[done..(done + 2).min(commits.len())];
                let is_right = |(_, number, then): &(usize, u8, Contents)| {
                    found.checkpoint == [*number] && contents(&opened) == *then
                };
                prop_assert!(possible.iter().any(is_right), "{at} {:?}", found.checkpoint);
            }
        }
    }
}
