//! A map in memory, fused by the CPU.

use std::path::Path;
use std::time::Instant;

use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Changes, Incremental, Mesh, MeshConfig, extract_with};
use tsdfuse::{Scan, VoxelMap};
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_view::Scene;

use crate::backend::{Backend, Failed, Integrators, Settled, follow};
use crate::error::{Result, RunError};
use crate::layers::Layers;
use crate::report::{MapReport, MeshReport, SavedMap};
use crate::surface;
use crate::view::{self, See};

pub(crate) struct InMemory {
    map: VoxelMap,
    integrators: Integrators,
    /// Once the surface is followed.
    surface: Option<Incremental>,
    config: MeshConfig,
}

impl InMemory {
    pub(crate) fn new(map: VoxelMap, integrators: Integrators, config: MeshConfig) -> Self {
        Self {
            map,
            integrators,
            surface: None,
            config,
        }
    }
}

impl Backend for InMemory {
    fn fuse(&mut self, sensor: usize, scan: &Scan) -> Result<Vec<Settled>, Failed> {
        let done = self.integrators.of(sensor).integrate(&mut self.map, scan);
        Ok(vec![done.map_err(Failed::of)?.into()])
    }

    fn needs_sensor(&self) -> bool {
        self.integrators.needs_sensor()
    }

    fn finish(&mut self) -> Result<Vec<BlockIndex>> {
        let mut updated = Vec::new();
        for method in self.integrators.all() {
            let done = method
                .finish(&mut self.map)
                .map_err(|error| RunError::Full(error.to_string()))?;
            updated.extend(done.updated_blocks);
        }
        Ok(updated)
    }

    fn follow(&mut self, updated: &[BlockIndex], changes: &mut Changes) -> Result<()> {
        follow(&mut self.surface, &self.config, &self.map, updated, changes);
        Ok(())
    }

    fn mesh(&mut self, config: &MeshConfig) -> Result<Mesh> {
        Ok(extract_with(&self.map, config)?)
    }

    fn write_surface(
        &mut self,
        config: &MeshConfig,
        path: &Path,
        scene: &Scene,
        layers: &Layers,
    ) -> Result<MeshReport> {
        let extract = || Ok(extract_with(&self.map, config)?);
        surface::write_by(extract, &self.map, config, path, scene, layers)
    }

    fn save(&mut self, path: &Path, poses: &[FusedPose]) -> Result<SavedMap> {
        let start = Instant::now();
        map_file::write_with_poses(path, &self.map, poses)?;
        Ok(SavedMap::written(path, start))
    }

    fn viewer(&mut self, min_weight: f32, look: &mut dyn FnMut(See<'_>) -> Result<()>) -> Result<()> {
        view::on_cpu(&self.map, min_weight, look)
    }

    fn report(&self) -> MapReport {
        MapReport::of(&self.map)
    }

    fn map(&self) -> Option<&VoxelMap> {
        Some(&self.map)
    }
}
