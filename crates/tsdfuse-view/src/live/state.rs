//! What viewers are to know, and what one of them does not know yet.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Serialize;
use tsdfuse::glam::{DVec3, IVec3};

use crate::chunks::Lattice;
use crate::scene::Channel;

/// A message holds about so many bytes of pieces, and as many times more as a viewer asks for, at most [`MOST_BATCHES`]. One that draws slowly, without a
/// GPU, asks for more.
const BATCH: usize = 1 << 19;
const MOST_BATCHES: usize = 16;

/// The state, and those who wait for it to change.
#[derive(Debug)]
pub(super) struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

impl Shared {
    pub(super) fn new(state: State) -> Self {
        let state = Mutex::new(state);
        Self {
            state,
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // What a thread that panicked had done is whole: each change is of one field after the other.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn look<T>(&self, look: impl FnOnce(&State) -> T) -> T {
        look(&self.lock())
    }

    pub(super) fn change(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.lock();
        change(&mut state);
        state.changes += 1;
        drop(state);
        self.changed.notify_all();
    }

    /// Appends the next message for a viewer; waits for news, but not longer than this. Whether there were any.
    pub(super) fn next(&self, seen: &mut Seen, at_most: Duration, message: &mut Vec<u8>) -> bool {
        let state = self.lock();
        let (state, _) = self
            .changed
            .wait_timeout_while(state, at_most, |state| seen.changes == state.changes && !state.closing)
            .unwrap_or_else(PoisonError::into_inner);
        let is_new = seen.changes != state.changes;
        if is_new {
            state.news(seen, message);
        }
        is_new
    }

    /// Ends all waiting for good.
    pub(super) fn close(&self) {
        self.change(|state| state.closing = true);
    }

    /// Whether more will come.
    pub(super) fn grows(&self) -> bool {
        self.look(|state| !state.scene.1.ended)
    }

    pub(super) fn is_closing(&self) -> bool {
        self.look(|state| state.closing)
    }
}

/// How far a viewer has been told.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// How many times [`BATCH`] it wants at once; 0 until it answered, for one.
    batches: usize,
    changes: u64,
    scene: u64,
    piece: u64,
    path: usize,
    path_epoch: u64,
    seconds: usize,
    sweep: u64,
    loops: u64,
    figures: u64,
}

impl Seen {
    /// What a viewer says when it has shown a message: `ok`, or `ok N` if it wants N times [`BATCH`].
    pub(super) fn answered(&mut self, answer: &str) {
        let batches: Option<usize> = answer.strip_prefix("ok ").and_then(|number| number.parse().ok());
        self.batches = batches.unwrap_or(1).min(MOST_BATCHES);
    }
}

/// All that viewers are to know.
#[derive(Debug, Default)]
pub(super) struct State {
    /// Counts changes of any kind.
    changes: u64,
    closing: bool,
    lattice: Option<Lattice>,
    scene: (u64, Told),
    /// The bytes of each piece, and its place in `order`. No bytes: it is no more.
    pieces: HashMap<IVec3, (u64, Arc<[u8]>)>,
    /// Pieces as they changed last.
    order: BTreeMap<u64, IVec3>,
    next_piece: u64,
    path: Vec<DVec3>,
    path_epoch: u64,
    seconds: Vec<f32>,
    sweep: (u64, Arc<[u8]>),
    /// Both ends of each loop that was closed.
    loops: (u64, Vec<[DVec3; 2]>),
    figures: (u64, Vec<(String, String)>),
}

/// What there is before the first piece.
#[derive(Clone, Debug, Default, Serialize)]
struct Told {
    title: String,
    origin: [f64; 3],
    step: f64,
    /// Whether pieces are of blocks, named by their index; else each is for itself.
    blocks: bool,
    colored: bool,
    channels: Vec<Channel>,
    heights: Option<[f64; 2]>,
    ended: bool,
}

/// The head of a message; what it counts follows as bytes: first pieces, then the sweep.
#[derive(Default, Serialize)]
struct Head<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    scene: Option<&'a Told>,
    /// The index of each piece and its bytes: x, y, z, length.
    pieces: Vec<[i64; 4]>,
    /// Whether more pieces follow in the next message.
    more: bool,
    /// How many places were told before those that follow.
    path_from: usize,
    path: Vec<f64>,
    seconds: &'a [f32],
    /// All loops that were closed: x, y, z of both ends.
    #[serde(skip_serializing_if = "Option::is_none")]
    loops: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    figures: Option<&'a [(String, String)]>,
    /// Bytes of the sweep: x, y, z of each return.
    sweep: Option<usize>,
}

impl State {
    pub(super) fn new(title: &str) -> Self {
        let mut state = Self::default();
        state.scene.1.title = title.to_owned();
        // Whoever comes first is told the title at once.
        (state.changes, state.scene.0) = (1, 1);
        state
    }

    pub(super) fn lattice(&self) -> Option<Lattice> {
        self.lattice
    }

    pub(super) fn begin(&mut self, lattice: Lattice, blocks: bool) {
        self.lattice = Some(lattice);
        self.tell(|told| {
            told.origin = lattice.origin.to_array();
            told.step = lattice.step_m;
            told.blocks = blocks;
        });
    }

    pub(super) fn paint(&mut self, colored: bool, channels: Vec<Channel>, heights: [f64; 2]) {
        self.tell(|told| {
            told.colored = colored;
            told.channels = channels;
            told.heights = Some(heights);
        });
    }

    pub(super) fn end(&mut self) {
        self.tell(|told| told.ended = true);
    }

    fn tell(&mut self, tell: impl FnOnce(&mut Told)) {
        let (version, told) = &mut self.scene;
        *version += 1;
        tell(told);
    }

    pub(super) fn put(&mut self, pieces: Vec<(IVec3, Arc<[u8]>)>) {
        for (index, bytes) in pieces {
            self.next_piece += 1;
            if let Some((before, _)) = self.pieces.insert(index, (self.next_piece, bytes)) {
                self.order.remove(&before);
            }
            self.order.insert(self.next_piece, index);
        }
    }

    pub(super) fn path(&mut self, places: &[DVec3]) {
        if !places.starts_with(&self.path) {
            self.path_epoch += 1;
            self.path.clear();
        }
        self.path.extend_from_slice(&places[self.path.len()..]);
    }

    pub(super) fn scan(&mut self, place: Option<DVec3>, seconds: f64) {
        self.path.extend(place);
        self.seconds.push(seconds as f32);
    }

    pub(super) fn sweep(&mut self, bytes: Arc<[u8]>) {
        self.sweep = (self.sweep.0 + 1, bytes);
    }

    pub(super) fn loops(&mut self, ends: &[[DVec3; 2]]) {
        self.loops = (self.loops.0 + 1, ends.to_vec());
    }

    pub(super) fn figures(&mut self, figures: Vec<(String, String)>) {
        self.figures = (self.figures.0 + 1, figures);
    }

    /// Appends what a viewer does not know yet, or the first part of it.
    fn news(&self, seen: &mut Seen, message: &mut Vec<u8>) {
        let mut head = Head::default();
        let mut body: Vec<&[u8]> = Vec::new();
        let mut length = 0;
        if seen.scene != self.scene.0 {
            head.scene = Some(&self.scene.1);
            seen.scene = self.scene.0;
        }
        let mut untold = self.order.range(seen.piece + 1..);
        for (&version, index) in untold.by_ref() {
            let Some((_, bytes)) = self.pieces.get(index) else {
                continue;
            };
            let [x, y, z] = index.to_array().map(i64::from);
            head.pieces.push([x, y, z, bytes.len() as i64]);
            body.push(bytes);
            length += bytes.len();
            seen.piece = version;
            if length >= BATCH * seen.batches.max(1) {
                break;
            }
        }
        head.more = untold.next().is_some();
        if seen.path_epoch != self.path_epoch {
            (seen.path_epoch, seen.path) = (self.path_epoch, 0);
        }
        if let Some(lattice) = self.lattice {
            let relative = |place: &DVec3| (((*place - lattice.origin) * 1e3).round() / 1e3).to_array();
            head.path = self.path[seen.path..].iter().flat_map(relative).collect();
            head.path_from = seen.path;
            seen.path = self.path.len();
            if seen.loops != self.loops.0 {
                head.loops = Some(self.loops.1.iter().flatten().flat_map(relative).collect());
                seen.loops = self.loops.0;
            }
        }
        head.seconds = &self.seconds[seen.seconds..];
        seen.seconds = self.seconds.len();
        if seen.figures != self.figures.0 {
            head.figures = Some(&self.figures.1);
            seen.figures = self.figures.0;
        }
        if seen.sweep != self.sweep.0 {
            head.sweep = Some(self.sweep.1.len());
            body.push(&self.sweep.1);
            seen.sweep = self.sweep.0;
        }
        if !head.more {
            seen.changes = self.changes;
        }
        // Plain data cannot fail to become JSON.
        let json = serde_json::to_vec(&head).unwrap_or_default();
        message.extend((json.len() as u32).to_le_bytes());
        message.extend_from_slice(&json);
        body.iter().for_each(|bytes| message.extend_from_slice(bytes));
    }
}
