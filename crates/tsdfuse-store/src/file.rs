//! The file: a database of regions, each packed as a map file's groups are, and one note.

use std::fs::File;
use std::io::Read;
use std::ops::AddAssign;
use std::path::Path;
use std::time::Duration;

use redb::{Builder, Database, ReadableDatabase, ReadableTable, Table, TableDefinition, WriteTransaction};
use tsdfuse::MapConfig;
use tsdfuse::glam::IVec3;
use tsdfuse::index::RegionIndex;
use tsdfuse::map::{BlockPool, RegionBlocks};
use tsdfuse_io::map_file::unpack;

use crate::error::{Result, StoreError};

/// By z, y, x: how many blocks and observed voxels, and the blocks.
const REGIONS: TableDefinition<'_, Key, (u32, u32, &[u8])> = TableDefinition::new("regions");
/// One row: voxel size, truncation, largest weight, integrations, and the caller's note.
const STATE: TableDefinition<'_, (), Row<'_>> = TableDefinition::new("state");

type Key = (i32, i32, i32);
type Row<'a> = (f64, f64, f32, u32, &'a [u8]);

/// How much a region, or a map, holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Blocks.
    pub blocks: u64,
    /// Voxels that were observed.
    pub observed_voxels: u64,
}

impl AddAssign for Sizes {
    fn add_assign(&mut self, other: Self) {
        self.blocks += other.blocks;
        self.observed_voxels += other.observed_voxels;
    }
}

/// A region's blocks as they are stored.
#[derive(Debug)]
pub(crate) struct Packed {
    pub(crate) index: RegionIndex,
    pub(crate) sizes: Sizes,
    pub(crate) bytes: Vec<u8>,
}

/// What is known of the map as a whole.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) config: MapConfig,
    pub(crate) integrations: u32,
    pub(crate) note: Vec<u8>,
}

fn key(RegionIndex(i): RegionIndex) -> Key {
    (i.z, i.y, i.x)
}

/// A cache of this many bytes belongs to the database; what is written waits there, too.
const CACHE_BYTES: usize = 32 << 20;

/// A new store, which appears with its first commit.
pub(crate) fn create(path: &Path, state: &State) -> Result<Database> {
    let wrong = StoreError::file(path);
    let system = |e| StoreError::file(path)(redb::Error::Io(e));
    if path.exists() {
        return Err(system(std::io::Error::other("is there already")));
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
    let make = || {
        let database = Builder::new().set_cache_size(CACHE_BYTES).create(&temporary)?;
        let transaction = begin(&database)?;
        drop(Regions::of(&transaction)?);
        commit(transaction, state)?;
        Ok(database)
    };
    let made = make().map_err(&wrong);
    let made = made.and_then(|database| {
        std::fs::rename(&temporary, path).map_err(system)?;
        Ok(database)
    });
    if made.is_err() {
        // It may never have come to be.
        let _ = std::fs::remove_file(&temporary);
    }
    made
}

/// How a database begins.
const MAGIC: [u8; 4] = *b"redb";

/// Whether a file looks like a store, from its first bytes.
pub fn recognises(path: impl AsRef<Path>) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == MAGIC
}

/// Removes a store that no process has open; tells whether it did. What is no store stays.
pub fn remove_unused(path: impl AsRef<Path>) -> bool {
    let path = path.as_ref();
    // While it is open here, nobody else can open it.
    let open = recognises(path).then(|| Builder::new().set_cache_size(CACHE_BYTES).open(path));
    matches!(open, Some(Ok(_))) && std::fs::remove_file(path).is_ok()
}

/// How often, and how many milliseconds apart, it is seen whether a process that was killed has let go of its store.
const TRIES: u32 = 40;
const BETWEEN_MS: u64 = 50;

/// A store that is there.
pub(crate) fn open(path: &Path) -> Result<Database> {
    let open = || Builder::new().set_cache_size(CACHE_BYTES).open(path);
    let mut opened = open();
    for _ in 0..TRIES {
        if !matches!(opened, Err(redb::DatabaseError::DatabaseAlreadyOpen)) {
            break;
        }
        std::thread::sleep(Duration::from_millis(BETWEEN_MS));
        opened = open();
    }
    opened.map_err(|e| StoreError::file(path)(e.into()))
}

/// What a store holds: its state, and how much each region has.
pub(crate) type Contents = (State, Vec<(RegionIndex, Sizes)>);

/// What was committed last; `None` if nothing was ever committed.
pub(crate) fn contents(database: &Database) -> Result<Option<Contents>, redb::Error> {
    let read = database.begin_read()?;
    let state = match read.open_table(STATE) {
        Ok(state) => state,
        Err(redb::TableError::TableDoesNotExist(_)) => return Ok(None),
        Err(e) => return Err(e.into()),
    };
    let Some(row) = state.get(())? else { return Ok(None) };
    let (voxel_size_m, truncation_m, max_weight, integrations, note) = row.value();
    let state = State {
        config: MapConfig {
            voxel_size_m,
            truncation_m,
            max_weight,
        },
        integrations,
        note: note.to_owned(),
    };
    let mut regions = Vec::new();
    for row in read.open_table(REGIONS)?.iter()? {
        let (key, value) = row?;
        let ((z, y, x), (blocks, observed, _)) = (key.value(), value.value());
        let sizes = Sizes {
            blocks: blocks.into(),
            observed_voxels: observed.into(),
        };
        regions.push((RegionIndex(IVec3::new(x, y, z)), sizes));
    }
    Ok(Some((state, regions)))
}

/// Begins to write; nobody sees it before [`commit`].
pub(crate) fn begin(database: &Database) -> Result<WriteTransaction, redb::Error> {
    let mut transaction = database.begin_write()?;
    // So that a file that was left open is opened at once.
    transaction.set_quick_repair(true);
    Ok(transaction)
}

/// The regions as they are within a transaction.
pub(crate) struct Regions<'a>(Table<'a, Key, (u32, u32, &'static [u8])>);

impl<'a> Regions<'a> {
    pub(crate) fn of(transaction: &'a WriteTransaction) -> Result<Self, redb::Error> {
        Ok(Self(transaction.open_table(REGIONS)?))
    }

    pub(crate) fn write(&mut self, packed: &Packed) -> Result<(), redb::Error> {
        let Sizes {
            blocks,
            observed_voxels,
        } = packed.sizes;
        // A region has 512 blocks at most.
        let value = (blocks as u32, observed_voxels as u32, packed.bytes.as_slice());
        self.0.insert(key(packed.index), value)?;
        Ok(())
    }

    /// Reads a region, which must be there.
    pub(crate) fn read(&self, index: RegionIndex, pool: &BlockPool, path: &Path) -> Result<RegionBlocks> {
        let wrong = |reason: String| StoreError::Region {
            path: path.to_owned(),
            region: index,
            reason,
        };
        let row = self.0.get(key(index)).map_err(|e| StoreError::file(path)(e.into()))?;
        let row = row.ok_or_else(|| wrong("is not there".to_owned()))?;
        let mut region = RegionBlocks::new(index, pool);
        let (.., bytes) = row.value();
        unpack(bytes, |index, block| region.insert(index, &block)).map_err(|e| wrong(e.to_string()))?;
        Ok(region)
    }
}

/// Makes all that was written last, at once.
pub(crate) fn commit(transaction: WriteTransaction, state: &State) -> Result<(), redb::Error> {
    let State {
        config,
        integrations,
        note,
    } = state;
    let row = (
        config.voxel_size_m,
        config.truncation_m,
        config.max_weight,
        *integrations,
        note.as_slice(),
    );
    transaction.open_table(STATE)?.insert((), row)?;
    transaction.commit()?;
    Ok(())
}
