//! A map on a GPU.

use std::path::Path;

use tsdfuse::fuse::FuseError;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Changes, Incremental, Mesh, MeshConfig, Nearby};
use tsdfuse::render::RenderConfig;
use tsdfuse::{Scan, SensorModel, VoxelMap};
use tsdfuse_gpu::{DeviceMap, Fused, Fuser, Gpu, GpuError, Mesher, PoolConfig, Renderer};
use tsdfuse_io::map_file::{self, FusedPose};
use tsdfuse_view::Scene;

use crate::backend::{Backend, Failed, Settled, follow};
use crate::config::RunConfig;
use crate::error::{Result, RunError};
use crate::layers::Layers;
use crate::report::{MapReport, MeshReport, SavedMap};
use crate::surface;
use crate::view::{self, Look, See};

/// Opens a GPU, to continue a map there.
pub(crate) fn open(
    name: Option<&str>,
    map: &VoxelMap,
    config: &RunConfig,
    sensors: &[Option<SensorModel>],
) -> Result<Box<dyn Backend>> {
    let [sensor] = sensors else {
        return Err(RunError::config(
            "a GPU fuses one sensor at a time: choose it with --sensor, or leave out --device",
        ));
    };
    let gpu = Gpu::open(name)?;
    let device_map = DeviceMap::upload(&gpu, map, pool(&gpu))?;
    let fuser = Fuser::new(device_map, config.method, &config.methods(), sensor.as_ref());
    let fuser = fuser.map_err(|error| match error {
        GpuError::Unsupported(reason) => RunError::Config(reason),
        error => error.into(),
    })?;
    Ok(Box::new(OnGpu {
        gpu,
        fuser,
        needs_sensor: config.method.build(&config.methods(), None).needs_sensor(),
        mesher: None,
        config: config.mesh,
        host: None,
        surface: None,
    }))
}

/// The mesh of a map.
pub(crate) fn mesh(name: Option<&str>, map: &VoxelMap, config: &MeshConfig) -> Result<Mesh> {
    let map = upload(name, map)?;
    Ok(Mesher::new(&map)?.extract(&map, config)?)
}

/// What looks at a map.
pub(crate) fn look<'a>(name: Option<&str>, map: &VoxelMap, config: &RenderConfig) -> Result<Look<'a>> {
    let map = upload(name, map)?;
    let mut renderer = Renderer::new(&map, config)?;
    Ok(Box::new(move |camera, pose| Ok(renderer.view(&map, camera, pose)?)))
}

/// As much as the device can address; a quarter of that where a CPU does as a GPU would.
pub fn pool(gpu: &Gpu) -> PoolConfig {
    let most = PoolConfig::default();
    PoolConfig {
        pages: if gpu.is_software() { most.pages / 4 } else { most.pages },
        ..most
    }
}

fn upload(name: Option<&str>, map: &VoxelMap) -> Result<DeviceMap> {
    let gpu = Gpu::open(name)?;
    Ok(DeviceMap::upload(&gpu, map, pool(&gpu))?)
}

pub(crate) struct OnGpu {
    gpu: Gpu,
    fuser: Fuser,
    needs_sensor: bool,
    /// Once there was a mesh.
    mesher: Option<Mesher>,
    config: MeshConfig,
    /// The map here, once its surface is followed, and what is known of that.
    host: Option<VoxelMap>,
    surface: Option<Incremental>,
}

fn settled(done: Vec<Fused>) -> Vec<Settled> {
    let of = |done: Fused| Settled {
        fused: done.fused_returns,
        skipped: done.skipped,
        updated_blocks: done.updated_blocks,
        ..Settled::default()
    };
    done.into_iter().map(of).collect()
}

fn failed(error: GpuError) -> RunError {
    if error.is_full() {
        return RunError::Full(error.to_string());
    }
    error.into()
}

impl Backend for OnGpu {
    fn device(&self) -> Option<String> {
        Some(self.gpu.name())
    }

    fn fuse(&mut self, _: usize, scan: &Scan) -> Result<Vec<Settled>, Failed> {
        match self.fuser.integrate(scan) {
            Ok(done) => Ok(settled(done)),
            Err(GpuError::Fuse(FuseError::Config(reason))) => Err(RunError::Config(reason).into()),
            Err(error) if error.is_bad_scan() => Err(Failed::Scan(error.to_string())),
            Err(error) => Err(Failed::Run(failed(error))),
        }
    }

    fn needs_sensor(&self) -> bool {
        self.needs_sensor
    }

    fn wait(&mut self) -> Result<Vec<Settled>> {
        self.fuser.finish().map(settled).map_err(failed)
    }

    fn finish(&mut self) -> Result<Vec<BlockIndex>> {
        Ok(Vec::new()) // no method that collects scans runs here
    }

    fn follow(&mut self, updated: &[BlockIndex], nearby: Option<&Nearby>, changes: &mut Changes) -> Result<()> {
        let host = match &mut self.host {
            Some(host) => {
                for (index, block) in self.fuser.map().download_blocks(updated)? {
                    host.replace_block(index, block)?;
                }
                host
            }
            none => none.insert(self.fuser.map().download()?),
        };
        follow(&mut self.surface, &self.config, host, updated, nearby, changes);
        Ok(())
    }

    fn mesh(&mut self, config: &MeshConfig) -> Result<Mesh> {
        let map = self.fuser.map();
        let mesher = match &mut self.mesher {
            Some(mesher) => mesher,
            none => none.insert(Mesher::new(map)?),
        };
        Ok(mesher.extract(map, config)?)
    }

    fn write_surface(
        &mut self,
        config: &MeshConfig,
        path: &Path,
        scene: &Scene,
        layers: &Layers,
    ) -> Result<MeshReport> {
        if surface::is_tileset(path) {
            return surface::write(&self.fuser.map().download()?, config, path, scene);
        }
        let blocks = self.fuser.map().block_count()? as usize;
        surface::write_mesh(|| self.mesh(config), blocks, config, path, scene, layers)
    }

    fn save(&mut self, path: &Path, poses: &[FusedPose]) -> Result<SavedMap> {
        let start = std::time::Instant::now();
        map_file::write_with_poses(path, &self.fuser.map().download()?, poses)?;
        Ok(SavedMap::written(path, start))
    }

    fn viewer(&mut self, min_weight: f32, look: &mut dyn FnMut(See<'_>) -> Result<()>) -> Result<()> {
        let map = self.fuser.map();
        let config = RenderConfig {
            min_weight,
            ..Default::default()
        };
        let host = map.download()?;
        let renderer = view::renderer(&host, &config)?;
        let mut on_device = Renderer::new(map, &config)?;
        look(See {
            renderer: &renderer,
            look: Box::new(move |camera, pose| Ok(on_device.view(map, camera, pose)?)),
        })
    }

    fn report(&self) -> MapReport {
        // What cannot be downloaded was reported where it was fused.
        self.fuser
            .map()
            .download()
            .map_or_else(|_| MapReport::default(), |map| MapReport::of(&map))
    }
}
