//! The thread that reads and writes the file. It serves requests in the order in which they come.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::{Builder, JoinHandle};

use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::{Block, BlockPool, RegionBlocks};
use tsdfuse_io::map_file::pack;

use crate::error::{Result, StoreError};
use crate::file::StoreFile;
use crate::format::{Packed, Sizes, State};

/// Requests that wait at most; whoever asks for more waits for the disk.
const WAITING: usize = 64;

enum Request {
    /// Packs and writes a region, whose memory is free then.
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
    /// Starts the thread; regions that it reads take their memory from `pool`.
    pub(crate) fn start(mut file: StoreFile, pool: BlockPool) -> Result<Self> {
        let (requests, asked) = sync_channel(WAITING);
        let (answer, answers) = channel();
        let path = file.path().to_owned();
        let work = move || {
            if let Err(error) = serve(&mut file, &pool, &asked, &answer) {
                // Nobody is left to be told if this fails.
                let _ = answer.send(Err(error));
            }
        };
        let thread = Builder::new().name("store".into()).spawn(work);
        let thread = thread.map_err(StoreError::file(&path))?;
        Ok(Self {
            path,
            requests: Some(requests),
            answers,
            thread: Some(thread),
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
        let requests = self.requests.as_ref();
        if requests.is_some_and(|requests| requests.send(request).is_ok()) {
            return Ok(());
        }
        // It ended: its last answer says why.
        loop {
            self.answer()?;
        }
    }

    /// Waits for an answer.
    pub(crate) fn answer(&self) -> Result<Answer> {
        self.answers.recv().unwrap_or_else(|_| Err(stopped(&self.path)))
    }

    /// An answer that is there already.
    pub(crate) fn answer_now(&self) -> Option<Result<Answer>> {
        self.answers.try_recv().ok()
    }
}

/// The thread tells its error before it ends, and [`crate::PagedMap`] asks nothing of it afterwards; so only a bug gets
/// here.
fn stopped(path: &Path) -> StoreError {
    StoreError::File {
        path: path.to_owned(),
        reason: "the thread that reads and writes it has stopped".to_owned(),
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
    file: &mut StoreFile,
    pool: &BlockPool,
    asked: &Receiver<Request>,
    answer: &Sender<Result<Answer>>,
) -> Result<()> {
    // What is not committed when the requests end is forgotten.
    while let Ok(request) = asked.recv() {
        let done = match request {
            Request::Keep(region) => {
                let packed = packed(&region);
                drop(region);
                file.write(&packed)?;
                Answer::Kept(packed.index, packed.sizes)
            }
            Request::Write(packed) => {
                file.write(&packed)?;
                continue;
            }
            Request::Read(index) => Answer::Region(file.read(index, pool)?),
            Request::Commit(state) => {
                file.commit(state)?;
                Answer::Committed
            }
        };
        // Nobody listens any more while the map is being dropped.
        let _ = answer.send(Ok(done));
    }
    Ok(())
}

/// The blocks of a region, sorted, as they are stored.
fn packed(region: &RegionBlocks) -> Packed {
    let mut blocks: Vec<_> = region.blocks().collect();
    blocks.sort_unstable_by_key(|(index, _)| *index);
    packed_blocks(region.index(), &blocks)
}

/// As [`packed`], of a region that is still in its map.
pub(crate) fn packed_blocks(index: RegionIndex, blocks: &[(BlockIndex, &Block)]) -> Packed {
    let observed = |(_, block): &(_, &Block)| block.voxels.iter().filter(|v| v.weight_sum > 0).count() as u64;
    Packed {
        index,
        sizes: Sizes {
            blocks: blocks.len() as u64,
            observed_voxels: blocks.iter().map(observed).sum(),
        },
        bytes: pack(blocks.iter().copied()),
    }
}
