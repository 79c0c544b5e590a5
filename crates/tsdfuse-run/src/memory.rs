//! A map in memory, fused by the CPU.

use std::path::Path;
use std::time::Instant;

use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Changes, Incremental, Mesh, MeshConfig, Nearby, extract_with};
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
    /// Once the surface is followed, and whether it knows all that was fused.
    surface: Option<Incremental>,
    is_current: bool,
    config: MeshConfig,
}

impl InMemory {
    pub(crate) fn new(map: VoxelMap, integrators: Integrators, config: MeshConfig) -> Self {
        Self {
            map,
            integrators,
            surface: None,
            is_current: false,
            config,
        }
    }

    /// The map, and what following its surface told, if that is all that was fused.
    fn known(&mut self, config: &MeshConfig) -> (&VoxelMap, Option<&mut Incremental>) {
        let is_known = self.is_current && *config == self.config;
        (&self.map, self.surface.as_mut().filter(|_| is_known))
    }
}

/// The mesh of a map; what is known of its surface need not be found again.
fn extract(map: &VoxelMap, known: Option<&mut Incremental>, config: &MeshConfig) -> Result<Mesh> {
    Ok(match known {
        Some(surface) => surface.mesh(map)?,
        None => extract_with(map, config)?,
    })
}

impl Backend for InMemory {
    fn fuse(&mut self, sensor: usize, scan: &Scan) -> Result<Vec<Settled>, Failed> {
        self.is_current = false;
        let done = self.integrators.of(sensor).integrate(&mut self.map, scan);
        Ok(vec![done.map_err(Failed::of)?.into()])
    }

    fn needs_sensor(&self) -> bool {
        self.integrators.needs_sensor()
    }

    fn finish(&mut self) -> Result<Vec<BlockIndex>> {
        self.is_current = false;
        let mut updated = Vec::new();
        for method in self.integrators.all() {
            let done = method
                .finish(&mut self.map)
                .map_err(|error| RunError::Full(error.to_string()))?;
            updated.extend(done.updated_blocks);
        }
        Ok(updated)
    }

    fn follow(&mut self, updated: &[BlockIndex], nearby: Option<&Nearby>, changes: &mut Changes) -> Result<()> {
        follow(&mut self.surface, &self.config, &self.map, updated, nearby, changes);
        self.is_current = true;
        Ok(())
    }

    fn mesh(&mut self, config: &MeshConfig) -> Result<Mesh> {
        let (map, known) = self.known(config);
        extract(map, known, config)
    }

    fn write_surface(
        &mut self,
        config: &MeshConfig,
        path: &Path,
        scene: &Scene,
        layers: &Layers,
    ) -> Result<MeshReport> {
        let (map, known) = self.known(config);
        surface::write_by(|| extract(map, known, config), map, config, path, scene, layers)
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
