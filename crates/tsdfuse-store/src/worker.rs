//! The thread that reads and writes the file: what is asked of it first is done first.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::{Builder, JoinHandle};

use redb::Database;
use tsdfuse::index::RegionIndex;
use tsdfuse::map::{BlockPool, RegionBlocks};
use tsdfuse_io::map_file::pack;

use crate::error::{Result, StoreError};
use crate::file::{self, Packed, Regions, Sizes, State};

/// Requests that wait at most: what is asked beyond that waits for the disk.
const WAITING: usize = 64;

enum Request {
    /// To be kept; its memory is free then.
    Keep(RegionBlocks),
    Write(Packed),
    Read(RegionIndex),
    Commit(State),
}

/// What comes of requests.
pub(crate) enum Answer {
    Region(RegionBlocks),
    Kept(RegionIndex, Sizes),
    Committed,
}

/// The thread, from the outside.
#[derive(Debug)]
pub(crate) struct Worker {
    path: PathBuf,
    requests: Option<SyncSender<Request>>,
    answers: Receiver<Result<Answer>>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts it; regions that it reads have their memory from `pool`.
    pub(crate) fn start(path: &Path, database: Database, pool: BlockPool) -> Result<Self> {
        let (requests, asked) = sync_channel(WAITING);
        let (answer, answers) = channel();
        let own = path.to_owned();
        let work = move || {
            if let Err(error) = serve(&own, &database, &pool, &asked, &answer) {
                // Nobody is left to tell if this fails.
                let _ = answer.send(Err(error));
            }
        };
        let thread = Builder::new().name("store".into()).spawn(work);
        Ok(Self {
            path: path.to_owned(),
            requests: Some(requests),
            answers,
            thread: Some(thread.map_err(|e| StoreError::file(path)(redb::Error::Io(e)))?),
        })
    }

    pub(crate) fn keep(&self, region: RegionBlocks) -> Result<()> {
        self.ask(Request::Keep(region))
    }

    pub(crate) fn write(&self, packed: Packed) -> Result<()> {
        self.ask(Request::Write(packed))
    }

    pub(crate) fn read(&self, index: RegionIndex) -> Result<()> {
        self.ask(Request::Read(index))
    }

    pub(crate) fn commit(&self, state: State) -> Result<()> {
        self.ask(Request::Commit(state))
    }

    fn ask(&self, request: Request) -> Result<()> {
        let sent = self
            .requests
            .as_ref()
            .is_some_and(|requests| requests.send(request).is_ok());
        match sent {
            true => Ok(()),
            // It ended: its last answers tell why.
            false => loop {
                self.answer()?;
            },
        }
    }

    /// Waits for an answer.
    pub(crate) fn answer(&self) -> Result<Answer> {
        self.answers.recv().unwrap_or_else(|_| {
            Err(StoreError::File {
                path: self.path.clone(),
                reason: "the thread that reads and writes it has died".to_owned(),
            })
        })
    }

    /// An answer that is there already.
    pub(crate) fn answer_now(&self) -> Option<Result<Answer>> {
        self.answers.try_recv().ok()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // It has told what went wrong.
            let _ = thread.join();
        }
    }
}

fn serve(
    path: &Path,
    database: &Database,
    pool: &BlockPool,
    asked: &Receiver<Request>,
    answer: &Sender<Result<Answer>>,
) -> Result<()> {
    let wrong = StoreError::file(path);
    let tell = |what| answer.send(Ok(what)).is_ok();
    loop {
        let transaction = file::begin(database).map_err(&wrong)?;
        let mut regions = Regions::of(&transaction).map_err(&wrong)?;
        let state = loop {
            // What was not committed by the end is forgotten.
            let Ok(request) = asked.recv() else { return Ok(()) };
            match request {
                Request::Keep(region) => {
                    let packed = packed(&region);
                    drop(region);
                    regions.write(&packed).map_err(&wrong)?;
                    tell(Answer::Kept(packed.index, packed.sizes));
                }
                Request::Write(packed) => regions.write(&packed).map_err(&wrong)?,
                Request::Read(index) => {
                    let region = regions.read(index, pool, path)?;
                    tell(Answer::Region(region));
                }
                Request::Commit(state) => break state,
            }
        };
        drop(regions);
        file::commit(transaction, &state).map_err(&wrong)?;
        tell(Answer::Committed);
    }
}

/// The blocks of a region, in order, as they are stored.
pub(crate) fn packed(region: &RegionBlocks) -> Packed {
    let mut blocks: Vec<_> = region.blocks().collect();
    blocks.sort_unstable_by_key(|(index, _)| *index);
    packed_blocks(region.index(), &blocks)
}

/// As [`packed`], of a region that is still in its map.
pub(crate) fn packed_blocks(
    index: RegionIndex,
    blocks: &[(tsdfuse::index::BlockIndex, &tsdfuse::map::Block)],
) -> Packed {
    let observed =
        |(_, block): &(_, &tsdfuse::map::Block)| block.voxels.iter().filter(|v| v.weight_sum > 0).count() as u64;
    Packed {
        index,
        sizes: Sizes {
            blocks: blocks.len() as u64,
            observed_voxels: blocks.iter().map(observed).sum(),
        },
        bytes: pack(blocks.iter().copied()),
    }
}
