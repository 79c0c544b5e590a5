//! What fuses: the CPU, or a GPU.

#[cfg(feature = "gpu")]
pub(crate) mod gpu;
#[cfg(not(feature = "gpu"))]
#[path = "device/no_gpu.rs"]
pub(crate) mod gpu;

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
    fn mesh(&mut self, config: &MeshConfig) -> Result<Mesh>;
    /// What looks at it.
    fn viewer<'a>(&'a self, config: &RenderConfig) -> Result<See<'a>>;
}

impl Device {
    /// Opens the device, to continue a map there; `None` for the CPU.
    pub(crate) fn open(
        &self,
        map: &VoxelMap,
        config: &RunConfig,
        sensor: Option<&SensorModel>,
    ) -> Result<Option<Box<dyn OnDevice>>> {
        match self {
            Self::Cpu => Ok(None),
            Self::Gpu(name) => gpu::open(name.as_deref(), map, config, sensor).map(Some),
        }
    }

    /// The mesh of a map.
    pub(crate) fn mesh(&self, map: &VoxelMap, config: &MeshConfig) -> Result<Mesh> {
        match self {
            Self::Cpu => Ok(extract_with(map, config)?),
            Self::Gpu(name) => gpu::mesh(name.as_deref(), map, config),
        }
    }

    /// What looks at a map.
    pub(crate) fn viewer<'a>(&self, renderer: &'a Renderer<'a>, config: &RenderConfig) -> Result<See<'a>> {
        match self {
            Self::Cpu => Ok(Box::new(|camera, pose| Ok(renderer.view(camera, pose)?))),
            Self::Gpu(name) => gpu::viewer(name.as_deref(), renderer.map(), config),
        }
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
