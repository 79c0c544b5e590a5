//! What fuses: the CPU, or a GPU.

use std::fmt::{self, Display};
use std::str::FromStr;

use anyhow::Result;
use tsdfuse::fuse::Skipped;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse::render::{Camera, RenderConfig, Renderer, View};
use tsdfuse::{Mesh, Pose, Scan, SensorModel, VoxelMap};

use crate::config::RunConfig;

/// `--device`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) enum Device {
    #[default]
    Cpu,
    /// The best GPU, or the first whose name contains this.
    Gpu(Option<String>),
}

impl FromStr for Device {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "cpu" => Ok(Self::Cpu),
            None if text == "gpu" => Ok(Self::Gpu(None)),
            Some(("gpu", name)) if !name.is_empty() => Ok(Self::Gpu(Some(name.to_owned()))),
            _ => Err("cpu, gpu or gpu:NAME is wanted".to_owned()),
        }
    }
}

impl Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu(None) => f.write_str("gpu"),
            Self::Gpu(Some(name)) => write!(f, "gpu:{name}"),
        }
    }
}

/// Looks through a camera from a pose (`world_from_camera`).
pub(crate) type See<'a> = Box<dyn FnMut(&Camera, Pose) -> Result<View> + 'a>;

/// What became of a scan that a device fused.
pub(crate) struct Settled {
    pub(crate) fused: u64,
    pub(crate) skipped: Skipped,
    pub(crate) updated_blocks: usize,
}

/// Fusing on a device. Scans are settled some time after they were given, in order.
pub(crate) trait OnDevice {
    fn name(&self) -> String;
    fn fuse(&mut self, scan: &Scan) -> Result<Vec<Settled>>;
    /// Waits for all scans.
    fn finish(&mut self) -> Result<Vec<Settled>>;
    /// The map, with all scans that were settled.
    fn map(&self) -> Result<VoxelMap>;
    /// Its mesh.
    fn mesh(&self, config: &MeshConfig) -> Result<Mesh>;
}

impl Device {
    /// Opens the device; `None` for the CPU.
    #[cfg(feature = "gpu")]
    pub(crate) fn open(&self, config: &RunConfig, sensor: Option<&SensorModel>) -> Result<Option<Box<dyn OnDevice>>> {
        use tsdfuse_gpu::{DeviceMap, Fuser, Gpu};
        let Self::Gpu(name) = self else { return Ok(None) };
        let gpu = Gpu::open(name.as_deref())?;
        let map = DeviceMap::new(&gpu, config.map, pool(&gpu))?;
        let fuser = Fuser::new(map, config.method, &config.methods(), sensor)?;
        Ok(Some(Box::new(OnGpu { gpu, fuser })))
    }

    /// Opens the device; `None` for the CPU.
    #[cfg(not(feature = "gpu"))]
    pub(crate) fn open(&self, _: &RunConfig, _: Option<&SensorModel>) -> Result<Option<Box<dyn OnDevice>>> {
        self.check().map(|()| None)
    }

    /// The mesh of a map.
    pub(crate) fn mesh(&self, map: &VoxelMap, config: &MeshConfig) -> Result<Mesh> {
        self.check()?;
        match self {
            #[cfg(feature = "gpu")]
            Self::Gpu(name) => {
                use tsdfuse_gpu::{DeviceMap, Gpu, Mesher};
                let gpu = Gpu::open(name.as_deref())?;
                let map = DeviceMap::upload(&gpu, map, pool(&gpu))?;
                Ok(Mesher::new(&map)?.extract(&map, config)?)
            }
            _ => Ok(extract_with(map, config)?),
        }
    }

    /// What looks at a map.
    pub(crate) fn viewer<'a>(&self, renderer: &'a Renderer<'a>, config: &RenderConfig) -> Result<See<'a>> {
        self.check()?;
        match self {
            #[cfg(feature = "gpu")]
            Self::Gpu(name) => {
                use tsdfuse_gpu::{DeviceMap, Gpu};
                let gpu = Gpu::open(name.as_deref())?;
                let map = DeviceMap::upload(&gpu, renderer.map(), pool(&gpu))?;
                let mut renderer = tsdfuse_gpu::Renderer::new(&map, config)?;
                Ok(Box::new(move |camera, pose| Ok(renderer.view(&map, camera, pose)?)))
            }
            _ => Ok(Box::new(|camera, pose| Ok(renderer.view(camera, pose)?))),
        }
    }

    /// Whether this build knows the device.
    pub(crate) fn check(&self) -> Result<()> {
        if !cfg!(feature = "gpu") && *self != Self::Cpu {
            anyhow::bail!("this build has no part for GPUs: it was made without the feature gpu");
        }
        Ok(())
    }
}

/// As much as the device can address; a quarter of that where a CPU does as a GPU would.
#[cfg(feature = "gpu")]
pub(crate) fn pool(gpu: &tsdfuse_gpu::Gpu) -> tsdfuse_gpu::PoolConfig {
    let most = tsdfuse_gpu::PoolConfig::default();
    tsdfuse_gpu::PoolConfig {
        pages: if gpu.is_software() { most.pages / 4 } else { most.pages },
        ..most
    }
}

/// Whether a device had no room for more, but still has the scans before.
pub(crate) fn is_full(error: &anyhow::Error) -> bool {
    #[cfg(feature = "gpu")]
    if let Some(error) = error.downcast_ref() {
        use tsdfuse_gpu::GpuError;
        return matches!(
            error,
            GpuError::OutOfMemory { .. } | GpuError::TooManyBlocks { .. } | GpuError::TooLarge { .. }
        );
    }
    let _ = error;
    false
}

#[cfg(feature = "gpu")]
struct OnGpu {
    gpu: tsdfuse_gpu::Gpu,
    fuser: tsdfuse_gpu::Fuser,
}

#[cfg(feature = "gpu")]
impl From<tsdfuse_gpu::Fused> for Settled {
    fn from(done: tsdfuse_gpu::Fused) -> Self {
        Self {
            fused: done.fused_returns,
            skipped: done.skipped,
            updated_blocks: done.updated_blocks as usize,
        }
    }
}

#[cfg(feature = "gpu")]
impl OnDevice for OnGpu {
    fn name(&self) -> String {
        self.gpu.name()
    }

    fn fuse(&mut self, scan: &Scan) -> Result<Vec<Settled>> {
        Ok(self.fuser.integrate(scan)?.into_iter().map(Settled::from).collect())
    }

    fn finish(&mut self) -> Result<Vec<Settled>> {
        Ok(self.fuser.finish()?.into_iter().map(Settled::from).collect())
    }

    fn map(&self) -> Result<VoxelMap> {
        Ok(self.fuser.map().download()?)
    }

    fn mesh(&self, config: &MeshConfig) -> Result<Mesh> {
        let map = self.fuser.map();
        Ok(tsdfuse_gpu::Mesher::new(map)?.extract(map, config)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_read_back_as_they_were() {
        for text in ["cpu", "gpu", "gpu:llvm:pipe"] {
            assert_eq!(text.parse::<Device>().unwrap().to_string(), text);
        }
        for bad in ["", "tpu", "gpu:", "cpu:0"] {
            assert!(bad.parse::<Device>().is_err(), "{bad}");
        }
    }
}
