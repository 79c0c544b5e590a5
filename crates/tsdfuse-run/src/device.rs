//! What fuses: the CPU, or a GPU.

use std::fmt::{self, Display};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use tsdfuse::VoxelMap;
use tsdfuse::mesh::{Mesh, MeshConfig};
use tsdfuse::render::{RenderConfig, Renderer};

use crate::error::Result;
use crate::gpu;
use crate::view::Look;

/// What fuses, extracts or renders: `cpu`, `gpu`, or `gpu:NAME`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Device {
    /// All cores of the current rayon pool.
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

impl TryFrom<String> for Device {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Device> for String {
    fn from(device: Device) -> Self {
        device.to_string()
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

impl Device {
    /// The mesh of a map.
    ///
    /// # Errors
    /// If there is no such device, or it fails.
    pub fn mesh(&self, map: &VoxelMap, config: &MeshConfig) -> Result<Mesh> {
        match self {
            Self::Cpu => Ok(tsdfuse::mesh::extract_with(map, config)?),
            Self::Gpu(name) => gpu::mesh(name.as_deref(), map, config),
        }
    }

    /// What looks at a map.
    ///
    /// # Errors
    /// If there is no such device, or it fails.
    pub fn look<'a>(&self, renderer: &'a Renderer<'a>, config: &RenderConfig) -> Result<Look<'a>> {
        match self {
            Self::Cpu => Ok(Box::new(|camera, pose| Ok(renderer.view(camera, pose)?))),
            Self::Gpu(name) => gpu::look(name.as_deref(), renderer.map(), config),
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
