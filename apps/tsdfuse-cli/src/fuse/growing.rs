//! Keeping the mesh file up to date while scans are fused.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Incremental, MeshConfig};
use tsdfuse::{Mesh, VoxelMap};

/// The mesh of the scans so far.
pub(super) struct Growing {
    every: usize,
    path: PathBuf,
    surface: Incremental,
    config: MeshConfig,
    scans: usize,
    pub(super) report: GrowthReport,
}

/// What was written before the last scan.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct GrowthReport {
    /// How often.
    pub(crate) meshes: usize,
    /// Extracting and writing them.
    pub(crate) seconds: f64,
}

impl Growing {
    /// Of a map that may hold something already.
    pub(super) fn new(every: usize, path: PathBuf, config: &MeshConfig, map: &VoxelMap) -> Self {
        let mut surface = Incremental::new(config);
        surface.note(&map.block_indices());
        Self {
            every,
            path,
            surface,
            config: *config,
            scans: 0,
            report: GrowthReport::default(),
        }
    }

    /// Takes up a scan that was fused, and writes the mesh that `extract` makes if it is time, and if there is any surface.
    pub(super) fn follow(
        &mut self,
        updated: &[BlockIndex],
        extract: impl FnOnce(&mut Incremental, &MeshConfig) -> Result<Mesh>,
    ) -> Result<()> {
        let start = Instant::now();
        self.surface.note(updated);
        self.scans += 1;
        if self.scans.is_multiple_of(self.every) {
            let mesh = extract(&mut self.surface, &self.config)?;
            if !mesh.triangles.is_empty() {
                tsdfuse_io::mesh::write(&self.path, &mesh)?;
                self.report.meshes += 1;
            }
        }
        self.report.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }
}
