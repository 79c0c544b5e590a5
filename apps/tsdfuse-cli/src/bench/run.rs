//! One timed run, from files to a mesh.

use std::time::Instant;

use anyhow::{Context, Result};
use serde::Serialize;

use crate::config::{RunConfig, Suggested};
use crate::evaluate::results::median;
use crate::fuse::Fusion;
use crate::mesh::surface;
use crate::settings::Settings;

/// Seconds of wall time of each stage, summed over all scans.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Run {
    /// Reading and decoding, in the background.
    pub(super) read: f64,
    /// Waiting for that.
    pub(super) wait: f64,
    /// Leaving out invalid returns, placing the others, normals, ….
    pub(super) prepare: f64,
    /// Finding out which parts of the map returns reach into.
    pub(super) find: f64,
    /// Updating them.
    pub(super) update: f64,
    /// What a method leaves to the end.
    pub(super) finish: f64,
    pub(super) mesh: f64,
    pub(super) write: f64,
    /// From opening the data set to the finished file.
    pub(super) total: f64,
    /// Of the median scan, `prepare` to `update`, and its share of `finish`.
    pub(super) scan: f64,
    pub(super) scans: usize,
    pub(super) skipped_scans: usize,
    /// In the files.
    pub(super) points: u64,
    pub(super) fused: u64,
    pub(super) blocks: usize,
    pub(super) map_bytes: usize,
    pub(super) triangles: usize,
}

impl Run {
    /// Does what `tsdfuse fuse` does.
    pub(super) fn time(settings: &Settings, config: &RunConfig, indices: &[usize]) -> Result<Self> {
        let folder = tempfile::tempdir().context("no folder for a mesh can be made")?;
        let start = Instant::now();
        let dataset = tsdfuse_io::open_with(&settings.dataset, &settings.open_options())?;
        let mut fusion = Fusion::new(settings, config, Suggested::by(&dataset).sensor.as_ref())?;
        fusion.fuse_all(&dataset, indices.to_vec())?;
        let finish = fusion.finish().seconds;
        let mesh = surface(&fusion.map, &config.mesh, &folder.path().join("mesh.ply"))?;
        let total = start.elapsed().as_secs_f64();

        let (sums, scans) = (fusion.sums(), fusion.scans.len());
        let scan_secs = fusion.scans.iter().map(|scan| scan.sums.prepare + scan.sums.fuse);
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
            scan: median(scan_secs.collect()) + finish / scans as f64,
            scans,
            skipped_scans: fusion.skipped.len(),
            points: sums.points,
            fused: sums.fused,
            blocks: fusion.map.block_count(),
            map_bytes: fusion.map.memory_bytes(),
            triangles: mesh.triangles,
        })
    }

    /// What fusing takes, without reading and meshing.
    pub(super) fn fusing(&self) -> f64 {
        self.prepare + self.find + self.update + self.finish
    }

    /// What has no name: opening the data set, freeing scans, ….
    pub(super) fn other(&self) -> f64 {
        self.total - self.wait - self.fusing() - self.mesh - self.write
    }
}
