//! The work of `--device gpu`.

use anyhow::Result;
use tsdfuse::mesh::MeshConfig;
use tsdfuse::render::RenderConfig;
use tsdfuse::{Mesh, Scan, SensorModel, VoxelMap};
use tsdfuse_gpu::{DeviceMap, Fused, Fuser, Gpu, GpuError, Mesher, PoolConfig, Renderer};

use super::{OnDevice, See, Settled};
use crate::config::RunConfig;

pub(super) fn open(
    name: Option<&str>,
    map: &VoxelMap,
    config: &RunConfig,
    sensor: Option<&SensorModel>,
) -> Result<Box<dyn OnDevice>> {
    let gpu = Gpu::open(name)?;
    let map = DeviceMap::upload(&gpu, map, pool(&gpu))?;
    let fuser = Fuser::new(map, config.method, &config.methods(), sensor)?;
    Ok(Box::new(OnGpu {
        gpu,
        fuser,
        mesher: None,
    }))
}

pub(super) fn mesh(name: Option<&str>, map: &VoxelMap, config: &MeshConfig) -> Result<Mesh> {
    let map = upload(name, map)?;
    Ok(Mesher::new(&map)?.extract(&map, config)?)
}

pub(super) fn viewer<'a>(name: Option<&str>, map: &VoxelMap, config: &RenderConfig) -> Result<See<'a>> {
    let map = upload(name, map)?;
    let mut renderer = Renderer::new(&map, config)?;
    Ok(Box::new(move |camera, pose| Ok(renderer.view(&map, camera, pose)?)))
}

/// Whether a device had no room for more, but still has the scans before.
pub(crate) fn is_full(error: &anyhow::Error) -> bool {
    matches!(
        error.downcast_ref(),
        Some(GpuError::OutOfMemory { .. } | GpuError::TooManyBlocks { .. } | GpuError::TooLarge { .. })
    )
}

/// As much as the device can address; a quarter of that where a CPU does as a GPU would.
pub(crate) fn pool(gpu: &Gpu) -> PoolConfig {
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

struct OnGpu {
    gpu: Gpu,
    fuser: Fuser,
    /// Once there was a mesh.
    mesher: Option<Mesher>,
}

fn settled(done: Vec<Fused>) -> Vec<Settled> {
    let of = |done: Fused| Settled {
        fused: done.fused_returns,
        skipped: done.skipped,
        updated_blocks: done.updated_blocks as usize,
    };
    done.into_iter().map(of).collect()
}

impl OnDevice for OnGpu {
    fn name(&self) -> String {
        self.gpu.name()
    }

    fn fuse(&mut self, scan: &Scan) -> Result<Vec<Settled>> {
        Ok(settled(self.fuser.integrate(scan)?))
    }

    fn finish(&mut self) -> Result<Vec<Settled>> {
        Ok(settled(self.fuser.finish()?))
    }

    fn map(&self) -> Result<VoxelMap> {
        Ok(self.fuser.map().download()?)
    }

    fn mesh(&mut self, config: &MeshConfig) -> Result<Mesh> {
        let map = self.fuser.map();
        let mesher = match &mut self.mesher {
            Some(mesher) => mesher,
            none => none.insert(Mesher::new(map)?),
        };
        Ok(mesher.extract(map, config)?)
    }

    fn viewer<'a>(&'a self, config: &RenderConfig) -> Result<See<'a>> {
        let map = self.fuser.map();
        let mut renderer = Renderer::new(map, config)?;
        Ok(Box::new(move |camera, pose| Ok(renderer.view(map, camera, pose)?)))
    }
}
