//! One timed run, from files to a mesh.

use std::time::Instant;

use serde::Serialize;
use tsdfuse_eval::stats::median;
use tsdfuse_run::{Input, Observer, RunConfig, Session, Setup};

use crate::error::{Error, Result};
use crate::results::scan_secs;

/// Seconds of wall time of each stage, summed over all scans.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Run {
    /// Reading and decoding, in the background.
    pub read: f64,
    /// Waiting for that.
    pub wait: f64,
    /// Leaving out invalid returns, placing the others, normals, ….
    pub prepare: f64,
    /// Finding out which parts of the map returns reach into.
    pub find: f64,
    /// Updating them.
    pub update: f64,
    /// What a method leaves to the end.
    pub finish: f64,
    /// Extracting the mesh.
    pub mesh: f64,
    /// Writing it.
    pub write: f64,
    /// From opening the log to the finished file.
    pub total: f64,
    /// Of the median scan, `prepare` to `update`, and its share of `finish`.
    pub scan: f64,
    /// Scans that were fused.
    pub scans: usize,
    /// Scans that could not be used.
    pub skipped_scans: usize,
    /// Points in the files.
    pub points: u64,
    /// Points that were fused.
    pub fused: u64,
    /// Blocks of the map.
    pub blocks: usize,
    /// Memory of the map.
    pub map_bytes: usize,
    /// Triangles of the mesh.
    pub triangles: usize,
}

impl Run {
    /// Does what `tsdfuse fuse` does, and removes the mesh.
    pub(crate) fn time(input: &Input, config: &RunConfig, observer: &mut dyn Observer) -> Result<Self> {
        let folder = tempfile::tempdir().map_err(Error::at(&std::env::temp_dir()))?;
        let start = Instant::now();
        let log = tsdfuse_io::open_with(&input.path, &input.options)?.with_correction(&config.sensor)?;
        let mut session = Session::begin(&log, setup(input, config), observer)?;
        session.run(observer)?;
        let mesh = session.write_surface(&folder.path().join("mesh.ply"))?;
        let total = start.elapsed().as_secs_f64();

        let (totals, map) = (session.totals(), session.map_report());
        let (sums, finish) = (totals.sums, totals.finish.seconds);
        Ok(Self {
            read: sums.read,
            wait: sums.wait,
            prepare: sums.prepare,
            find: sums.find,
            update: sums.fuse - sums.find,
            finish,
            mesh: mesh.seconds,
            write: mesh.write_seconds,
            total,
            scan: median(session.scans().iter().map(scan_secs)) + finish / totals.scans as f64,
            scans: totals.scans,
            skipped_scans: session.skipped().len(),
            points: sums.points,
            fused: sums.fused,
            blocks: map.blocks,
            map_bytes: map.bytes,
            triangles: mesh.triangles,
        })
    }

    /// What fusing takes, without reading and meshing.
    pub(crate) fn fusing(&self) -> f64 {
        self.prepare + self.find + self.update + self.finish
    }

    /// What has no name: opening the log, freeing scans, ….
    pub(crate) fn other(&self) -> f64 {
        self.total - self.wait - self.fusing() - self.mesh - self.write
    }
}

/// How the scans of an input are fused in memory.
pub(crate) fn setup(input: &Input, config: &RunConfig) -> Setup {
    Setup {
        config: config.clone(),
        selection: input.selection.clone(),
        skip_bad: input.skip_bad,
        ..Setup::default()
    }
}
