//! What a run tells those who watch it, and how they stop it.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tsdfuse::Scan;
use tsdfuse::glam::DVec3;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::Changes;

use crate::report::{LoadedMap, ScanReport, SkippedScan};

/// Something that happened during a run.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// The run begins, or goes on after `done` scans that a store holds already.
    Begun {
        /// How many scans will be read; not known of a stream.
        scans: Option<usize>,
        /// How many are done already.
        done: usize,
        /// The GPU that fuses, if one does.
        device: Option<&'a str>,
        /// Edge of the map's voxels, metres.
        voxel_size_m: f64,
    },
    /// A saved map was loaded and is now continued.
    MapLoaded(&'a LoadedMap),
    /// A scan was read; its invalid returns are dropped.
    ScanRead {
        /// Its number in the log.
        index: usize,
        /// The scan.
        scan: &'a Scan,
    },
    /// A scan is in the map. On a GPU, this arrives some scans later.
    ScanFused {
        /// Its number in the log.
        index: usize,
        /// What became of its points, and times.
        report: &'a ScanReport,
        /// The blocks that changed, each once.
        blocks: &'a [BlockIndex],
    },
    /// A scan could not be used, and bad scans are to be skipped. The map is as it was before.
    ScanSkipped {
        /// Its number in the log.
        index: usize,
        /// Its name and the reason.
        skipped: &'a SkippedScan,
    },
    /// Pieces of the surface changed ([`crate::Setup::follow_every`], [`Observer::surface_share`]).
    SurfaceChanged(&'a Changes),
    /// The mesh so far was written.
    MeshWritten(&'a Path),
    /// The map and the progress so far were committed: they survive a crash.
    MapStored {
        /// The store.
        path: &'a Path,
        /// Scans that are done, fused or skipped.
        done: usize,
        /// Scans that were asked for; not known of a stream.
        asked: Option<usize>,
    },
    /// What one scan can touch takes more memory than the limit allows. Sent again when it grows by a quarter.
    OverLimit {
        /// Memory of all blocks, bytes.
        bytes: usize,
    },
    /// Loops were closed: where the sensor was when it came by first, and when it came back (world).
    LoopsClosed(&'a [[DVec3; 2]]),
    /// A longer step begins, such as `extracting the surface`.
    Working(&'a str),
    /// A sentence about something unusual.
    Note(&'a str),
    /// The last scan is in the map, or the run was stopped.
    Done {
        /// Whether it was stopped before the last scan.
        stopped: bool,
    },
}

/// Whoever watches a run: a progress bar, a live view, a callback.
///
/// Closures are observers: `|event: Event<'_>| …`; [`Silent`] ignores everything.
pub trait Observer {
    /// Called on the thread that runs, between steps of the work.
    fn on(&mut self, event: Event<'_>);

    /// Whether it wants to be told what changed of the surface, without asking for it after a certain number of scans: it is then
    /// told as often as that takes, with all it does meanwhile, no more than this share of the time, and half of the time that is spent
    /// waiting for a live sensor. 0: not now, but maybe later.
    fn surface_share(&self) -> Option<f64> {
        None
    }
}

/// Two who watch the same run.
#[derive(Debug)]
pub struct Both<A, B>(pub A, pub B);

impl<A: Observer, B: Observer> Observer for Both<A, B> {
    fn on(&mut self, event: Event<'_>) {
        self.0.on(event);
        self.1.on(event);
    }

    fn surface_share(&self) -> Option<f64> {
        let shares = [self.0.surface_share(), self.1.surface_share()];
        shares.into_iter().flatten().reduce(f64::max)
    }
}

impl<F: FnMut(Event<'_>)> Observer for F {
    fn on(&mut self, event: Event<'_>) {
        self(event);
    }
}

/// Watches nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {
    fn on(&mut self, _: Event<'_>) {}
}

/// Stops a run between two scans, from any thread. Clones stop the same run.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Asks the run to stop after the scan that is being fused.
    pub fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it was asked to stop.
    pub fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// The flag itself, for signal handlers.
    pub fn flag(&self) -> Arc<AtomicBool> {
        self.0.clone()
    }
}
