//! Where the map is while scans are fused: in memory, paged, or on a GPU.

use std::path::Path;

use tsdfuse::fuse::{FuseError, Skipped};
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Changes, Incremental, Mesh, MeshConfig, Nearby};
use tsdfuse::{Integration, Integrator, Pose, Scan, SensorModel, VoxelMap};
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_view::Scene;

use crate::config::RunConfig;
use crate::error::{Result, RunError};
use crate::layers::Layers;
use crate::report::{MapReport, MeshReport, PagingReport, SavedMap};
use crate::view::See;

/// What became of a scan.
#[derive(Debug, Default)]
pub(crate) struct Settled {
    pub(crate) fused: u64,
    pub(crate) skipped: Skipped,
    pub(crate) updated_blocks: Vec<BlockIndex>,
    pub(crate) prepare_secs: f64,
    pub(crate) find_secs: f64,
}

impl From<Integration> for Settled {
    fn from(done: Integration) -> Self {
        Self {
            fused: done.fused_returns,
            skipped: done.skipped,
            updated_blocks: done.updated_blocks,
            prepare_secs: done.prepare_secs,
            find_secs: done.find_secs,
        }
    }
}

/// Why a scan is not in the map.
#[derive(Debug)]
pub(crate) enum Failed {
    /// The scan cannot be used; the map is as it was before.
    Scan(String),
    /// The run cannot go on.
    Run(RunError),
}

impl<E: Into<RunError>> From<E> for Failed {
    fn from(error: E) -> Self {
        Self::Run(error.into())
    }
}

impl Failed {
    /// Tells a bad scan from options that no scan can be fused with, and from memory that is full.
    pub(crate) fn of(error: FuseError) -> Self {
        match error {
            FuseError::Config(reason) => Self::Run(RunError::Config(reason)),
            FuseError::OutOfMemory(error) => Self::Run(RunError::Full(error.to_string())),
            error => Self::Scan(error.to_string()),
        }
    }
}

/// A map that scans are fused into.
pub(crate) trait Backend: Send {
    /// The GPU's name, if it is one.
    fn device(&self) -> Option<String> {
        None
    }

    /// Fuses a scan, and returns the outcome of the oldest scans still in flight: of this one, or of some before.
    fn fuse(&mut self, sensor: usize, scan: &Scan) -> Result<Vec<Settled>, Failed>;

    /// Tells where the next scans will be, so that what they touch can be loaded meanwhile.
    fn prefetch(&mut self, _next: &[Pose]) -> Result<()> {
        Ok(())
    }

    /// Whether the method wants to know the sensor's beams.
    fn needs_sensor(&self) -> bool;

    /// Waits for all scans.
    fn wait(&mut self) -> Result<Vec<Settled>> {
        Ok(Vec::new())
    }

    /// Lets methods that collect scans fuse them; the blocks that changed.
    fn finish(&mut self) -> Result<Vec<BlockIndex>>;

    /// Pieces of the surface that changed since this was asked last, or since the map was empty, where these blocks were
    /// updated. What is not near may be told later.
    fn follow(&mut self, updated: &[BlockIndex], nearby: Option<&Nearby>, changes: &mut Changes) -> Result<()>;

    /// The whole surface, once all scans are in the map.
    fn mesh(&mut self, config: &MeshConfig) -> Result<Mesh>;

    /// As [`Self::mesh`], also of a map that is not all in memory; then vertices come cube by cube.
    fn whole_mesh(&mut self, config: &MeshConfig) -> Result<Mesh> {
        self.mesh(config)
    }

    /// Extracts the surface, which must not be empty, and writes it with what layers tell of it; `scene` is what a page shows beside it.
    fn write_surface(&mut self, config: &MeshConfig, path: &Path, scene: &Scene, layers: &Layers)
    -> Result<MeshReport>;

    /// Writes the map and the poses of its scans.
    fn save(&mut self, path: &Path, poses: &[FusedPose]) -> Result<SavedMap>;

    /// What looks at the whole map, once all scans are in it.
    fn viewer(&mut self, min_weight: f32, look: &mut dyn FnMut(See<'_>) -> Result<()>) -> Result<()>;

    /// How much the whole map holds.
    fn report(&self) -> MapReport;

    /// Makes the map, `checkpoint` and the poses of its scans what is there after a crash; whether there is a store for that. The
    /// poses begin with those of the commit before.
    fn commit(&mut self, _checkpoint: &[u8], _poses: &[FusedPose]) -> Result<bool> {
        Ok(false)
    }

    /// What was done for a map that is not all in memory.
    fn paging(&self) -> Option<PagingReport> {
        None
    }

    /// Memory of all blocks, if that is over the limit and the caller was not told yet.
    fn over_limit(&mut self) -> Option<usize> {
        None
    }

    /// What of the map is in memory: at least what the last scan has touched.
    fn map_around(&self) -> Option<&VoxelMap> {
        self.map()
    }

    /// The map, if it is whole and in memory.
    fn map(&self) -> Option<&VoxelMap> {
        None
    }
}

/// One integrator for each sensor.
pub(crate) struct Integrators(Vec<Box<dyn Integrator>>);

impl Integrators {
    pub(crate) fn new(config: &RunConfig, sensors: &[Option<SensorModel>]) -> Self {
        let methods = config.methods();
        let build = |sensor: &Option<_>| config.method.build(&methods, sensor.as_ref());
        Self(sensors.iter().map(build).collect())
    }

    pub(crate) fn of(&mut self, sensor: usize) -> &mut dyn Integrator {
        let last = self.0.len() - 1;
        &mut *self.0[sensor.min(last)]
    }

    pub(crate) fn needs_sensor(&self) -> bool {
        self.0.iter().any(|method| method.needs_sensor())
    }

    pub(crate) fn all(&mut self) -> impl Iterator<Item = &mut Box<dyn Integrator>> {
        self.0.iter_mut()
    }
}

/// The pieces of a map's surface that changed; `surface` is what is known of it once it is followed.
pub(crate) fn follow(
    surface: &mut Option<Incremental>,
    config: &MeshConfig,
    map: &VoxelMap,
    updated: &[BlockIndex],
    nearby: Option<&Nearby>,
    changes: &mut Changes,
) {
    let surface = surface.get_or_insert_with(|| {
        let mut surface = Incremental::new(config);
        surface.note(&map.block_indices());
        surface
    });
    surface.note(updated);
    match nearby {
        Some(nearby) => surface.changes_near(map, nearby, changes),
        None => surface.changes(map, changes),
    }
}
