//! The file: regions of the last commit and of the one that is being made.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::{Block, BlockPool, MapError, RegionBlocks};
use tsdfuse_io::map_file::unpack;

use crate::error::{Result, StoreError};
use crate::format::{Extent, HEADER, Header, Index, MAGIC, PAGE, Packed, RegionHeader, Row, Sizes, State};
use crate::space::Space;

/// An open store. Nothing that belongs to the last commit is ever overwritten.
#[derive(Debug)]
pub(crate) struct StoreFile {
    path: PathBuf,
    file: File,
    /// The number of the last commit.
    sequence: u64,
    index: [Extent; 2],
    regions: HashMap<RegionIndex, Stored, FxBuildHasher>,
    space: Space,
    /// Parts of the last commit that the next one does not need.
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

/// Whether a file looks like a store, from its first bytes; those of earlier versions are stores that cannot be read.
pub fn recognises(path: impl AsRef<Path>) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && (start == MAGIC || is_earlier(&start))
}

/// Stores were files of this database.
fn is_earlier(start: &[u8]) -> bool {
    start.starts_with(b"redb")
}

/// Removes a store that no process has open; returns whether it did. What is no store stays.
pub fn remove_unused(path: impl AsRef<Path>) -> bool {
    let path = path.as_ref();
    let open = || OpenOptions::new().read(true).write(true).open(path);
    // While it is locked here, nobody else can open it.
    let locked = recognises(path).then(open).and_then(Result::ok);
    locked.is_some_and(|file| file.try_lock().is_ok() && header(&file).is_ok() && std::fs::remove_file(path).is_ok())
}

/// How often, and how many milliseconds apart, it is tried whether a process that was killed has let go of its store.
const TRIES: u32 = 40;
const BETWEEN_MS: u64 = 50;

/// Locks a store: for writing nobody else may have it open, for reading nobody else may write.
pub(crate) fn lock(file: &File, is_written: bool) -> io::Result<()> {
    let lock = || {
        if is_written {
            file.try_lock()
        } else {
            file.try_lock_shared()
        }
    };
    for _ in 0..TRIES {
        match lock() {
            Ok(()) => return Ok(()),
            Err(TryLockError::Error(error)) => return Err(error),
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(BETWEEN_MS)),
        }
    }
    Err(io::Error::other("another process has it open"))
}

impl StoreFile {
    /// Makes a store, which appears with its first commit.
    pub(crate) fn create(path: &Path, state: State) -> Result<Self> {
        let wrong = StoreError::file(path);
        if path.exists() {
            return Err(wrong(io::Error::other("is there already")));
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
        let make = || {
            let mut options = OpenOptions::new();
            let file = options.read(true).write(true).create(true).truncate(true).open(&temporary);
            let file = file.map_err(&wrong)?;
            lock(&file, true).map_err(&wrong)?;
            let mut store = Self {
                path: path.to_owned(),
                file,
                sequence: 0,
                index: [Extent { offset: 0, length: 0 }; 2],
                regions: HashMap::default(),
                space: Space::without(FIRST_PAGE, []).ok_or_else(|| wrong(io::ErrorKind::Other.into()))?,
                replaced: Vec::new(),
            };
            store.commit(state)?;
            std::fs::rename(&temporary, path).map_err(&wrong)?;
            Ok(store)
        };
        let made = make();
        if made.is_err() {
            // It may never have been created.
            let _ = std::fs::remove_file(&temporary);
        }
        made
    }

    /// Opens a store as it was committed last.
    pub(crate) fn open(path: &Path, is_written: bool) -> Result<(Self, State)> {
        let wrong = StoreError::file(path);
        let file = OpenOptions::new().read(true).write(is_written).open(path);
        let file = file.map_err(&wrong)?;
        lock(&file, is_written).map_err(&wrong)?;
        let damaged = |reason: String| StoreError::Damaged {
            path: path.to_owned(),
            reason,
        };
        let (header, is_whole) = header(&file).map_err(damaged)?;
        let index = read_index(&file, &header).map_err(|reason| damaged(format!("its index: {reason}")))?;
        let extents = index.regions.iter().map(|row| row.extent).chain(header.index);
        let space = Space::without(FIRST_PAGE, extents).ok_or_else(|| damaged("its index contradicts itself".to_owned()))?;
        let stored = |&row: &Row| {
            let is_committed = true;
            (row.index, Stored { row, is_committed })
        };
        let store = Self {
            path: path.to_owned(),
            file,
            sequence: header.sequence,
            index: header.index,
            regions: index.regions.iter().map(stored).collect(),
            space,
            replaced: Vec::new(),
        };
        if is_written && !is_whole {
            // The next commit writes over the first copy, and must find the second one as it should be.
            for at in HEADERS {
                store.write_at(at, &header.to_bytes())?;
            }
            store.file.sync_data().map_err(&wrong)?;
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

    /// Writes a region; nobody sees it before [`StoreFile::commit`].
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

    /// Reads a region, which must be there.
    pub(crate) fn read(&self, index: RegionIndex, pool: &BlockPool) -> Result<RegionBlocks> {
        let wrong = |reason: String| StoreError::Region {
            path: self.path.clone(),
            region: index,
            reason,
        };
        let stored = self.regions.get(&index).ok_or_else(|| wrong("is not there".to_owned()))?;
        let mut blocks = RegionBlocks::new(index, pool);
        read_region(&self.file, &stored.row, |index, block| blocks.insert(index, &block)).map_err(wrong)?;
        Ok(blocks)
    }

    /// Makes everything that was written the state of the map. When this returns, no crash takes it away; until then, the last commit is there.
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
        let bytes = index.to_bytes();
        let header = Header {
            sequence: index.sequence,
            config: index.state.config,
            integrations: index.state.integrations,
            index: [self.append(&bytes)?, self.append(&bytes)?],
        };
        // What the header names must be there before the header is.
        self.file.sync_data().map_err(&wrong)?;
        self.write_at(HEADERS[0], &header.to_bytes())?;
        self.file.sync_data().map_err(&wrong)?;
        // The first copy holds from here on. The second one is for damage.
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
        let mut file = &self.file;
        let written = file.seek(SeekFrom::Start(offset)).and_then(|_| file.write_all(bytes));
        written.map_err(StoreError::file(&self.path))
    }
}

/// The header of the last commit, and whether both copies of it are there.
///
/// # Errors
/// What is wrong with the first copy, if there is none.
pub(crate) fn header(file: &File) -> Result<(Header, bool), String> {
    let read = |offset| {
        let length = HEADER as u64;
        let bytes = read_bytes(file, Extent { offset, length });
        bytes.and_then(|bytes| Header::parse(&bytes))
    };
    let mut start = [0; 4];
    let mut reader = file;
    let read_start = reader.seek(SeekFrom::Start(0)).and_then(|_| reader.read_exact(&mut start));
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

/// The index that a header names, from whichever copy is intact.
///
/// # Errors
/// What is wrong with the first copy, if neither is.
pub(crate) fn read_index(file: &File, header: &Header) -> Result<Index, String> {
    let read = |extent| {
        let index = read_bytes(file, extent).and_then(|bytes| Index::parse(&bytes))?;
        let is_right = index.sequence == header.sequence;
        is_right.then_some(index).ok_or_else(|| "it belongs to another commit".to_owned())
    };
    let [first, second] = header.index;
    read(first).or_else(|reason| read(second).map_err(|_| reason))
}

/// Hands out the blocks of a region.
///
/// # Errors
/// What is wrong with its bytes, or why `take` did not want a block.
pub(crate) fn read_region(
    file: &File,
    row: &Row,
    mut take: impl FnMut(BlockIndex, Block) -> Result<(), MapError>,
) -> Result<(), String> {
    let record = read_bytes(file, row.extent)?;
    let header = RegionHeader::parse(&record)?;
    if (header.index, header.sizes) != (row.index, row.sizes) {
        return Err("another region is in its place".to_owned());
    }
    let mut blocks = 0;
    let counted = |index, block| {
        blocks += 1;
        take(index, block)
    };
    unpack(header.packed(&record)?, counted).map_err(|e| e.to_string())?;
    let is_whole = blocks == row.sizes.blocks;
    is_whole.then_some(()).ok_or_else(|| "blocks are missing".to_owned())
}

/// Reads a part of the file. What a damaged store says of its length is not believed.
pub(crate) fn read_bytes(mut file: &File, extent: Extent) -> Result<Vec<u8>, String> {
    let system = |e: io::Error| e.to_string();
    let end = file.metadata().map_err(system)?.len();
    if extent.offset.checked_add(extent.length).is_none_or(|last| last > end) {
        return Err("the file ends before it".to_owned());
    }
    let mut bytes = Vec::new();
    let length = extent.length as usize;
    bytes.try_reserve_exact(length).map_err(|e| e.to_string())?;
    bytes.resize(length, 0);
    let read = file.seek(SeekFrom::Start(extent.offset)).and_then(|_| file.read_exact(&mut bytes));
    read.map_err(system).map(|()| bytes)
}
